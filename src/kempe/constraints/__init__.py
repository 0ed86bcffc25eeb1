"""Constraints: what holds parts of a system, declared in one vocabulary."""
