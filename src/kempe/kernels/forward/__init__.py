"""Poses and Jacobians from primitive tables."""
