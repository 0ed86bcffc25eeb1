"""Equations of loops, and of all that holds frames and coordinates: values, Jacobians, and how they
are solved."""
