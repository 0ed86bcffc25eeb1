"""Planar mechanisms made of dyads, as programs of closed forms."""
