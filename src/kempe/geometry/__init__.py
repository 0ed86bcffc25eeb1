"""Distances between bodies by their collision shapes."""
