"""The version of Kempe."""

__version__ = "0.1.0"
