"""Where the numbers of a plan of the analytical inverse model lie. Imports nothing, like
`table_layout`.

    ints    header (see the places below), kind of each line, then 1 for each joint of the chain that is unknown
    floats  rows of the tip's pose (12), rows of the task (6), length, origin (3), the lines (LINE_STRIDE each), then
            for each joint of the chain: offset, multiplier, lower and upper limit

Lines are scaled by the length, and seen from the origin. The joints of the chain come first; the
others complete it to six, and belong to nobody: the target must leave those marked REST at zero,
those marked FREE may take any value.
"""

N_LINES = 0
N_JOINTS = 1
INNER = 2
WHAT = 3
MODE = 4
MEASURE = 5
OPTION = 6
N_LOCKED = 7
N_FORMS = 8
"""Places in the header of `ints`."""

ORDER = 10
ROLES = 16
FORMS = 22
PLAN_HEADER = 32
"""Places in the header: which line stands at each of the six places, its role, the formulations of
an elimination."""

JOINT = 0
REST = 1
FREE = 2
"""Roles of the six: a joint of the chain; one that must stay at zero; one that may be anywhere."""

TIP = 0
TASK = 12
LENGTH = 18
ORIGIN = 19
LINES = 22
"""Places in `floats`."""

OFFSET = 0
FACTOR = 1
LOW = 2
HIGH = 3
JOINT_FLOATS = 4
"""Places in the numbers of a joint."""

POINT = 0
PLANE = 1
"""What the inner three joints leave in place: WHAT in the header."""

X_FIRST = 0
Z_FIRST = 1
COUPLED = 2
AT_REST = 3
"""How the outer equations are solved, MODE in the header: one of them has x alone, or z alone, or
none; AT_REST: the joints do not move."""

FORMULATIONS = 36
"""Ways to write the elimination of a chain."""

LANES = 8
"""Targets that are solved side by side, at most."""

SLOTS = 16
"""Rows of an answer."""

ERROR = 0
CODE = 1
INFO = 2
"""Places after a solution's coordinates: the norm of its errors [m, rad], and its code."""

UNUSED = -1.0
INSIDE_BIT = 1.0
WEAK_BIT = 2.0
SLOT_UNIT = 4.0
MULTIPLICITY_UNIT = 128.0
"""A code: UNUSED, or INSIDE_BIT inside the limits + WEAK_BIT near a singularity + SLOT_UNIT (slot +
1, 0 for none) + MULTIPLICITY_UNIT times how many roots it is (0: a sample of a family)."""
