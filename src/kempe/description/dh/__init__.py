"""Chains from Denavit-Hartenberg tables and from screw axes."""
