"""Mechanism -> System: spanning tree, coordinates, primitive table."""
