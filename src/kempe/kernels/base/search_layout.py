"""Codes and places that searches answer with. Imports nothing, like `table_layout`."""

SOLVED = 0
NOT_FOUND = 1
BAD_INPUT = 2
"""Status: within tolerances and limits; not found, q is the nearest; not finite, or no rotation."""
LATE = 4
"""Added to the status of several tasks where the time was up before all was done."""

LINEAR = 0
ANGULAR = 1
STATUS = 2
STEPS = 3
STARTS = 4
ANSWER = 5
"""What follows the configuration in the answer for one frame, and how many numbers."""

DESCENTS = 16
"""Descents to the configuration of one frame that is nearest to its target, at most as many as
starts.

The best of 16 is the best of 1000 for at least 95 of 100 goals out of reach of five real arms."""

UNFINISHED = -1
"""In place of the steps towards the nearest closed configuration: further starts follow."""

NOTHING = 0
AHEAD = 1
"""What is lowered when all tasks are held: nothing; the way to a goal in the coordinates. Else a
function's address."""

ROTATION_TOLERANCE = 1e-6
"""Largest entry of R^T R - I that a goal's rotation may have."""

LARGEST = 1e100
"""Size from which a number is no coordinate and a limit no limit: squares of such numbers
overflow."""
