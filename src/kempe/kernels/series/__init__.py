"""Taylor series of constraints, projection onto them, and iterated Lie brackets."""
