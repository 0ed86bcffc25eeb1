"""Reach studies: lists of poses, places of the base, capability maps."""
