"""Exact workspaces in the plane."""
