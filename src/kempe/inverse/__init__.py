"""Configurations that reach a target: one, all, along a path, a velocity at a time."""
