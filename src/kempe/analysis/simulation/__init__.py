"""Motion in time without masses."""
