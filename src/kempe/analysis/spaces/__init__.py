"""Spaces of configurations and of tasks: what they are, what is reached, and where it is singular."""
