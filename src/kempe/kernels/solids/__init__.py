"""Distances of solids in closed form."""
