"""Codes and places that searches answer with. Imports nothing, like `table_layout`."""

SOLVED, NOT_FOUND, BAD_INPUT = 0, 1, 2
"""Status: within tolerances and limits; not found, q is the nearest; not finite, or no rotation."""
LATE = 4
"""Added to the status of several tasks where the time was up before all was done."""

LINEAR, ANGULAR, STATUS, STEPS, STARTS, ANSWER = 0, 1, 2, 3, 4, 5
"""What follows the configuration in the answer for one frame, and how many numbers."""

NOTHING, AHEAD = 0, 1
"""What is lowered when all tasks are held: nothing; the way to a goal in the coordinates. Else a function's address."""

ROTATION_TOLERANCE = 1e-6
"""Largest entry of R^T R - I that a goal's rotation may have."""

LARGEST = 1e100
"""Size from which a number is no coordinate and a limit no limit: squares of such numbers overflow."""
