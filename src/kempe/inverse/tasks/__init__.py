"""Several tasks at once, with priorities, numerically."""
