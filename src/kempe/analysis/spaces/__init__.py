"""Spaces of a system as sets: what of the task space is reached."""
