"""Primitive tables of chains in an equivalent form that kernels evaluate fastest.

The frame that a row is written in may be turned about and slid along the row's axis without any
effect: the freedom of Denavit and Hartenberg (1955), used so that most placements become [Rx(alpha)
| p] with p_y = 0.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.forward.table_layout import (
    BALL,
    COS_OFFSET,
    FORM,
    GENERAL,
    HEADER,
    IS_CHAIN,
    KIND,
    N_ROWS,
    OUTPUT_FLOATS,
    ROW_FLOATS,
    ROW_INTS,
    RX,
    RX_FLAT,
    SIN_OFFSET,
    TURN,
)

PARALLEL = 2.0**-53
"""Largest sine of the angle between two axes that is rounding noise: parallel axes leave a turn
free."""

SKEW = 0.5
"""Smallest sine of the angle between two axes whose common normal is used: else it may be far
away."""


def _normalize_direction(c: float, s: float) -> tuple[float, float]:
    """Return the direction (c, s) scaled to length 1, or (1, 0) where it is zero."""
    length = math.hypot(c, s)
    return (c / length, s / length) if length > 0.0 else (1.0, 0.0)


def _make_rotation(c: float, s: float) -> np.ndarray:
    """Return the rotation (3, 3) about z by the angle with cosine c and sine s."""
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def split_turns(
    placement: np.ndarray,
) -> tuple[tuple[float, float], np.ndarray, tuple[float, float]]:
    """Factor a placement (3, 4) into Rz(a) M Rz(b) with M = [Rx(alpha) | p].

    Returned are (cos a, sin a), M (3, 4) and (cos b, sin b).

    Euler angles z, x, z, with sin(alpha) of either sign and cos(a) not negative. Where the axes are
    parallel, a is free and taken such that p_y = 0.
    """
    rotation = placement[:, :3]
    origin = placement[:, 3]
    sine = math.hypot(rotation[0, 2], rotation[1, 2])
    if sine > PARALLEL:
        sine = math.copysign(sine, -rotation[1, 2])
        a = _normalize_direction(-rotation[1, 2] / sine, rotation[0, 2] / sine)
    else:
        sine = 0.0
        a = _normalize_direction(origin[0], origin[1])
    rest = _make_rotation(*a).T @ placement
    b = _normalize_direction(rest[0, 0], -rest[0, 1])
    cosine, sine = _normalize_direction(rotation[2, 2], sine)
    middle = np.column_stack(
        [[[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]], rest[:, 3]]
    )
    if sine == 0.0:
        middle[:, 3] = math.hypot(origin[0], origin[1]), 0.0, origin[2]
    return a, middle, b


def _compute_flattening_slide(middle: np.ndarray) -> float:
    """Compute the slide of a frame along its z that makes p_y = 0 in `middle` = [Rx | p].

    The slide is in metres, and 0 where it would be far.
    """
    sine = middle[2, 1]
    cosine = middle[2, 2]
    if abs(sine) <= SKEW or middle[1, 3] == 0.0:
        return 0.0
    slide = middle[1, 3] / sine
    middle[1, 3] = 0.0
    middle[2, 3] += slide * cosine
    return slide


def regauge_table(ints: np.ndarray, floats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a table of the same chain with as many rows as possible in form RX or RX_FLAT.

    Poses and Jacobians are the same up to rounding, a few 1e-16 of the size of the robot. Turns
    about an axis are folded into the offsets of turning rows and carried on through sliding ones. A
    placement stays general where a turn is left over: after a slide or at the root (`a` has no
    gauge), before a ball (`b` has none).

    ints, floats: table of one chain (see `kempe.kernels.forward.table_layout`), not changed.
    ValueError for other tables.
    """
    if ints[IS_CHAIN] != 1:
        raise ValueError("only the table of a chain can be regauged")
    ints = ints.copy()
    floats = floats.copy()
    n_rows = int(ints[N_ROWS])
    row_ints = ints[HEADER : HEADER + ROW_INTS * n_rows].reshape(n_rows, ROW_INTS)
    rows = floats[: ROW_FLOATS * n_rows].reshape(n_rows, ROW_FLOATS)
    gauges = rows[:, COS_OFFSET] + 1j * rows[:, SIN_OFFSET]
    # turn and slide that stand before the next placement
    carried = (1.0, 0.0)
    slide = 0.0
    for r in range(n_rows):
        kind = row_ints[r, KIND]
        placement = _make_rotation(*carried) @ rows[r, :12].reshape(3, 4)
        placement[2, 3] -= slide
        carried = (1.0, 0.0)
        slide = 0.0
        form = GENERAL
        a, middle, b = split_turns(placement)
        after_turn = r > 0 and row_ints[r - 1, KIND] == TURN
        if (after_turn or a == (1.0, 0.0)) and (kind != BALL or b == (1.0, 0.0)):
            if after_turn:
                gauges[r - 1] *= complex(*a)
            if kind != BALL:
                slide = _compute_flattening_slide(middle)
            if kind == TURN:
                gauges[r] *= complex(*b)
            else:
                carried = b
            placement = middle
            form = RX_FLAT if middle[1, 3] == 0.0 else RX
        rows[r, :12] = placement.ravel()
        row_ints[r, FORM] = form
    output = floats[ROW_FLOATS * n_rows :][:OUTPUT_FLOATS].reshape(3, 4)
    output[:] = _make_rotation(*carried) @ output
    output[2, 3] -= slide
    turning = row_ints[:, KIND] == TURN
    gauges[turning] /= np.abs(gauges[turning])
    rows[:, COS_OFFSET] = gauges.real
    rows[:, SIN_OFFSET] = gauges.imag
    return ints, floats
