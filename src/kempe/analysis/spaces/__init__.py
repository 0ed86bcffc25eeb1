"""Spaces: all configurations of a system, what of them is seen in a task, what can be reached."""
