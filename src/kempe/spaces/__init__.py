"""Configuration space, task space, singularities."""
