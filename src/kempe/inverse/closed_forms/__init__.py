"""Inverse kinematics of serial chains in closed form, by elimination, or by search for all."""
