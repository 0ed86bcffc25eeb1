"""Workspaces of a frame: sampled maps, exact regions, reach studies, and files."""
