"""Curves of configurations: their steps, and what happens on them."""
