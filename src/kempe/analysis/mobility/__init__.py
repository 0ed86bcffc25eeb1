"""Degrees of freedom, and the kind of each constraint."""
