"""URDF and xacro: reading and writing."""
