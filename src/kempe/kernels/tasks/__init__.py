"""Several tasks at once, in levels, under bounds."""
