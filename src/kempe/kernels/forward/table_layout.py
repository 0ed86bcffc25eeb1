"""Where the numbers of a primitive table lie.

A table is a pair of flat arrays, `ints` (int64) and `floats` (float64):

    ints    n_rows, n_out, nq, nv, is_chain, has_quaternion, size, frame (the last two: see `fuse_table`, else 0)
            a row:     kind, parent row (-1: ground), index in q, index in v, form, 0
            an output: row (-1: ground), particle flag
    floats  a row:     placement 3x4, cos and sin of the offset, multiplier, 0
            an output: placement 3x4

Pose of a row = pose of its parent @ placement @ motion. Motions: TURN about z by offset +
multiplier * q, SLIDE along z by multiplier * q, BALL by the unit quaternion wxyz at q, inverted for
a negative multiplier.
"""

import numpy as np

HEADER = 8
ROW_INTS = 6
OUTPUT_INTS = 2
ROW_FLOATS = 16
OUTPUT_FLOATS = 12

N_ROWS = 0
N_OUT = 1
NQ = 2
NV = 3
IS_CHAIN = 4
HAS_QUATERNION = 5
SIZE = 6
FRAME = 7
"""Places in the header of `ints`."""

KIND = 0
PARENT = 1
Q_INDEX = 2
V_INDEX = 3
FORM = 4
"""Places in a row of `ints`."""

COS_OFFSET = 12
SIN_OFFSET = 13
MULTIPLIER = 14
"""Places in a row of `floats`, after the placement."""

ROW = 0
PARTICLE = 1
"""Places in an output of `ints`."""

TURN = 0
SLIDE = 1
BALL = 2
"""Kinds of rows."""

GENERAL = 0
RX = 1
RX_FLAT = 2
"""Forms of placements: any; exactly [Rx(alpha) | p]; the same with p_y = 0."""

WORLD_ALIGNED = 0
WORLD = 1
BODY = 2
"""Frames of expression of a Jacobian: frame's origin, ground axes; ground's origin and axes; the
frame's."""


def fuse_table(ints: np.ndarray, floats: np.ndarray, frame: int = WORLD_ALIGNED) -> np.ndarray:
    """Return the table as one float64 array, integers first as the same bytes, for Jacobians in the
    given frame.
    """
    ints = ints.copy()
    ints[SIZE] = len(ints)
    ints[FRAME] = frame
    return np.concatenate([ints.view(np.float64), floats])


def get_row_integers(ints: np.ndarray) -> np.ndarray:
    """Return the integers (n_rows, ROW_INTS) of the rows as a view, with the columns KIND, PARENT,
    ...
    """
    n = int(ints[N_ROWS])
    return ints[HEADER : HEADER + ROW_INTS * n].reshape(n, ROW_INTS)


def get_row_numbers(ints: np.ndarray, floats: np.ndarray) -> np.ndarray:
    """Return the numbers (n_rows, ROW_FLOATS) of the rows as a view, with the columns placement,
    COS_OFFSET, ...
    """
    n = int(ints[N_ROWS])
    return floats[: ROW_FLOATS * n].reshape(n, ROW_FLOATS)


def get_tip_placement(ints: np.ndarray, floats: np.ndarray) -> np.ndarray:
    """Return the placement (3, 4) of the first output on its row, as a view."""
    return floats[ROW_FLOATS * int(ints[N_ROWS]) :][:OUTPUT_FLOATS].reshape(3, 4)


def copy_placements(ints: np.ndarray, floats: np.ndarray) -> np.ndarray:
    """Return the placements (n_rows + 1, 3, 4) of the rows and of the first output, as a copy."""
    rows = get_row_numbers(ints, floats)[:, :OUTPUT_FLOATS]
    return np.concatenate([rows.reshape(-1, 3, 4), get_tip_placement(ints, floats)[None]])
