"""Velocity constraints: recorded rows A(q) v = b(q, t)."""
