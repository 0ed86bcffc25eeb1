"""Constraints as what is asked of a configuration."""
