"""Where the numbers of a frame's servo lie, for its kernel and for the code that packs them."""

HEAD = 6
"""Integers in front: coordinates q of the chain, its velocities, quaternions, coordinates q of the
system, its velocities, whether each velocity moves one row of the chain's table, in order."""

BALLS = 2
PLAIN = 5
"""Places of the number of quaternions in the head, and of whether each velocity moves one row."""

NEAR = 0
METRIC = 1
FLOATS = 7
"""Places of the numbers in front: singular values to be damped, weights of the error's rows."""

TWIST = 0
FRACTION = 6
ANSWER = 7
"""What follows q and the velocities in the answer, and how many numbers; then, for each velocity of
the chain, whether it is at a limit."""

BAD_CONFIGURATION = -1
BAD_MOTION = -2
WRONG_SHAPE = -3
"""What the kernel returns where it gives no step."""

TASK_HEAD = 3
"""Integers in front of the order of tasks: levels, quaternions, equations of hard levels. Then follow
the level of each row of ties (from 1 on, 0 for none), whether it is an equation, whether each level
is hard (from 0 on), the coordinate of each velocity (-1 for quaternions), and places of quaternions
in q and among velocities. The numbers are the scales of the velocities, their limits, and weights
and bounds of the rows."""
