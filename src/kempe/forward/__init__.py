"""Forward kinematics of bodies and frames, in numbers and in symbols."""
