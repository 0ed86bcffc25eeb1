"""Manoeuvres of what rolls without slipping."""
