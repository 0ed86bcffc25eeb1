"""The numerical inverse model of one frame: residual, steps, starts, and their schedule."""
