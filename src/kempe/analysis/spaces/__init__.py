"""Spaces of configurations and of tasks: workspaces, singular configurations, what of a list of poses is reached."""
