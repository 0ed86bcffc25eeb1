"""TOML, the format of our own: reading and writing."""
