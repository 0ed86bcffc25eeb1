"""Numerical inverse kinematics of one frame at the end of a serial chain."""
