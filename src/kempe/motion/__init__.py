"""Motions of a system: traced, driven, rolling and simulated ones."""
