"""One frame at the end of a chain, numerically."""
