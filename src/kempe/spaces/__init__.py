"""Configuration space, task space and singularities."""
