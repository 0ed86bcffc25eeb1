"""Where the numbers of Taylor series lie. Imports nothing, like `table_layout`."""

MASK = 0
TURNS = 1
ROWS = 2
FIRST_ROW = 3
ENTRIES = 4
ENTRY = 5
DATA = 6
TIE_INTS = 7
"""Places of a tie in `ties`, and its size; DATA leads to what a TAPE tie reads, as in
`loop_layout`."""

BEFORE = 0
AFTER = 12
POSE_SIZE = 24
"""A row's poses before and after its motion: rotation (9, row by row) and position (3) each."""

TURNED = 0
WEIGHT_1 = 9
WEIGHT_2 = 10
OUTER = 11
POWERS = 17
"""A ball's series: the rotation by w, A and B of it, the six entries of w w^T (xx, yy, zz, xy, xz,
yz), powers of w.w.

A turn keeps its sine and cosine at 0 and 1."""


def compute_scratch_width(order: int) -> int:
    """Return how many numbers a row needs for each order besides its poses."""
    return POWERS + order // 2 + 1
