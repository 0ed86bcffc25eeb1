"""Closing loops: one way, all ways, and the nearest mechanism that closes exactly."""
