"""Where the numbers of a plan of the analytical inverse model lie. Imports nothing, like `table_layout`.

    ints    header (see the places below), kind of each line, then 1 for each joint of the chain that is unknown
    floats  rows of the tip's pose (12), rows of the task (6), length, origin (3), the lines (LINE_STRIDE each), then
            for each joint of the chain: offset, multiplier, lower and upper limit

Lines are scaled by the length, and seen from the origin. The joints of the chain come first; the others complete it to
six, and belong to nobody: the target must leave those marked REST at zero, those marked FREE may take any value.
"""

N_LINES, N_JOINTS, INNER, WHAT, MODE, MEASURE, OPTION, N_LOCKED, N_FORMS = 0, 1, 2, 3, 4, 5, 6, 7, 8
"""Places in the header of `ints`."""

ORDER, ROLES, FORMS, PLAN_HEADER = 10, 16, 22, 32
"""Places in the header: which line stands at each of the six places, its role, the formulations of an elimination."""

JOINT, REST, FREE = 0, 1, 2
"""Roles of the six: a joint of the chain; one that must stay at zero; one that may be anywhere."""

TIP, TASK, LENGTH, ORIGIN, LINES = 0, 12, 18, 19, 22
"""Places in `floats`."""

OFFSET, FACTOR, LOW, HIGH, JOINT_FLOATS = 0, 1, 2, 3, 4
"""Places in the numbers of a joint."""

POINT, PLANE = 0, 1
"""What the inner three joints leave in place: WHAT in the header."""

X_FIRST, Z_FIRST, COUPLED, AT_REST = 0, 1, 2, 3
"""How the outer equations are solved, MODE in the header: one of them has x alone, or z alone, or none; AT_REST: the
joints do not move."""

FORMULATIONS = 36
"""Ways to write the elimination of a chain."""

LANES = 8
"""Targets that are solved side by side, at most."""

SLOTS = 16
"""Rows of an answer."""

ERROR, CODE, INFO = 0, 1, 2
"""Places after a solution's coordinates: the norm of its errors [m, rad], and its code."""

UNUSED, INSIDE_BIT, WEAK_BIT, SLOT_UNIT, MULTIPLICITY_UNIT = -1.0, 1.0, 2.0, 4.0, 128.0
"""A code: UNUSED, or INSIDE_BIT inside the limits + WEAK_BIT near a singularity + SLOT_UNIT (slot + 1, 0 for none) +
MULTIPLICITY_UNIT times how many roots it is (0: a sample of a family)."""
