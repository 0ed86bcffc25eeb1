"""Paths of configurations that follow targets, and self-motions."""
