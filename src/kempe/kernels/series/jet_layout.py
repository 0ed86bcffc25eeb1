"""Where the numbers of Taylor series lie. Imports nothing, like `table_layout`."""

MASK, TURNS, ROWS, FIRST_ROW, ENTRIES, ENTRY, DATA, TIE_INTS = 0, 1, 2, 3, 4, 5, 6, 7
"""Places of a tie in `ties`, and its size; DATA leads to what a TAPE tie reads, as in `loop_layout`."""

BEFORE, AFTER, POSE_SIZE = 0, 12, 24
"""A row's poses before and after its motion: rotation (9, row by row) and position (3) each."""

TURNED, WEIGHT_1, WEIGHT_2, OUTER, POWERS = 0, 9, 10, 11, 17
"""A ball's series: the rotation by w, A and B of it, the six entries of w w^T (xx, yy, zz, xy, xz, yz), powers of w.w.

A turn keeps its sine and cosine at 0 and 1."""


def scratch_width(order: int) -> int:
    """Numbers that a row needs for each order besides its poses."""
    return POWERS + order // 2 + 1
