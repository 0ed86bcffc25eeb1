"""Planar mechanisms made of dyads, in closed form."""
