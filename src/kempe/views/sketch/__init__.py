"""A planar mechanism as it is drawn by mouse: pins, bars, sliders, the ground, and the crank."""
