"""Workspaces of planar chains, exactly."""
