"""The spanning tree: bodies, coordinates, and the table of primitive motions."""
