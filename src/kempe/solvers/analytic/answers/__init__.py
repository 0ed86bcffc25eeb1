"""Answers with all solutions: what is known of them, and why there are no more."""
