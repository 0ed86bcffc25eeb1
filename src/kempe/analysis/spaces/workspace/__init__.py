"""Workspaces by samples: maps of counts, their measures, files, and work on many machines."""
