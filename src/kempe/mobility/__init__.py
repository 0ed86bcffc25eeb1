"""Degrees of freedom of mechanisms, and kinds of constraints."""
