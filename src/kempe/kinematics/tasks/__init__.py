"""Constraints as what is required of a configuration."""
