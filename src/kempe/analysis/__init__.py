"""Answers about a system as a whole."""
