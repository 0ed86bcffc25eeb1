"""Descriptions of mechanisms: files, texts and builder calls, without kinematics."""
