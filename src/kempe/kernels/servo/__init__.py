"""One step of velocities of a frame, towards a pose or for a twist, within limits."""
