"""Compilation of a mechanism to a system: spanning tree, coordinates, primitive table."""
