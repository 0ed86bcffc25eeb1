"""Closing loops: one configuration, all modes, and the nearest mechanism that closes exactly."""
