"""Where the numbers of packed loop closures lie. Needs no compiler, as `table_layout`.

Besides the primitive table, whose outputs 2k and 2k + 1 are the frames A and B of tie k, there are `plan` (int64) and
`weights` (float64):

    plan     head, then, from the places that the head gives:
             a tie:      MASK, TURNS, ROWS, FIRST_ROW, ENTRIES, ENTRY, LOCALS, LOCAL, BLOCK, PIN, LENGTHS, NUMBER,
                         BOUND, CENTRE, DATA
             an entry:   row of the table, local column of the tie
             a local:    velocity coordinate, or for a LINEAR tie its place in q
             a velocity: where its uses begin; a use: tie, local column
             a matrix row: its first column and where it begins in the envelope
             a reading:  code, place in q, tie; a velocity: place in q, sort, held
    weights  1/length, length; scales, lower, upper, low and high ends to draw from of all velocities; a number for each
             tie; a factor for each entry (for a LINEAR tie for each local); low and high of each row of a tie with
             BOUND; for each CENTRE and each row of the table its mass, first moment (3) in its axes and the mass of all
             that it moves, then the first moment (3) of what stands
    pins     (an argument) the poses (3x4) of pinned ties, then the numbers of ties with NUMBER
"""

import numpy as np

N_TIES, N_ROWS, N_READINGS, N_PINS, BLOCKS, ENVELOPE = 0, 1, 2, 3, 4, 5
AT_TIES, AT_ENTRIES, AT_LOCALS, AT_VARS, AT_USES, AT_ROWS, AT_READINGS, AT_PLACES = 6, 7, 8, 9, 10, 11, 12, 13
AT_NUMBERS, AT_FACTORS, AT_BOUNDS, AT_CENTRES, BASE_TIE, BASE_ROW = 14, 15, 16, 17, 18, 19
HEAD = 20
"""Places in the head of `plan`, and its size."""

MASK, TURNS, ROWS, FIRST_ROW, ENTRIES, ENTRY, LOCALS, LOCAL, BLOCK, PIN = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
LENGTHS, NUMBER, BOUND, CENTRE, DATA = 10, 11, 12, 13, 14
TIE_INTS, ENTRY_INTS, USE_INTS, ENVELOPE_INTS, READING_INTS, PLACE_INTS = 15, 2, 2, 2, 3, 3
"""A tie: LENGTHS counts its first rows, which are lengths; NUMBER, BOUND and CENTRE are -1 where it has none; DATA is
the velocity coordinate of an OWN tie, the address of the function of a FUNCTION tie, what a TAPE tie reads."""

CENTRE_FLOATS = 5

INVERSE_LENGTH, LENGTH, SCALES = 0, 1, 2
"""Places in `weights`; the five lists of velocities follow from SCALES on."""


def velocity_lists(weights: np.ndarray, nv: int) -> np.ndarray:
    """Scales, lower and upper limits, low and high ends to draw from (5, nv) of all velocities; a view."""
    return weights[SCALES : SCALES + 5 * nv].reshape(5, nv)


SLIDE, BOUND_TURN, CIRCLE, BALL_FIRST, BALL_MORE = 0, 1, 2, 3, 4
"""Sorts of velocity coordinates: a slide; an angle; one that a turn brings back; the first and the others of a ball."""

NO_TURN, ANGLE, ALIGN, CROSS, FULL, DISTANCE, LINEAR, LOOK, OWN, FUNCTION, TAPE = range(11)
"""What of the rotation of B in A a tie holds: nothing; the angle about z; z parallel to z; y of B normal to x of A;
all. LOOK: z of B towards the origin of A. The others are of another kind: DISTANCE and LINEAR have one row each; OWN
holds one coordinate, or a quaternion, at given values; FUNCTION has the rows of a function of q, TAPE those of a
recorded expression (`tape_layout`) of the pose of B in A and of coordinates."""

TAPE_INTS, TAPE_FLOATS, TAPE_WORK, TAPE_INPUTS, INPUT_INTS = 0, 1, 2, 3, 3
"""What DATA of a TAPE tie leads to: where the integers and the numbers of its tape lie, where its work area begins
(in `jet` only), then for each input three integers: what it is, and for a coordinate its place in q and its column.
The rows of the tie are the outputs of the tape in their order."""
PLACE, COORDINATE, GIVEN = 0, 12, 13
"""What an input is: the place (3) of B in A and the entries (9) of its rotation row by row, from PLACE on; a
coordinate; a number that comes with the call, counted from NUMBER on."""

READ_X, READ_Y, READ_Z, READ_ANGLE, READ_RX, READ_RY, READ_QUATERNION, READ_YAW, READ_PITCH, READ_ROLL = range(10)
"""How a coordinate of a cut joint follows from the pose of B in A: a slide, the turn about z, the turns of a cross
about x and y, a quaternion, the three turns about z, y', x''."""

DAMPING, MOST_DAMPING = 0.6, 0.1
"""Damping of a step that closes loops, by the mean square of the equations, and the most of it."""
LONGEST = 0.5
"""Longest step of a turn [rad]."""
WIDER = 0.15
"""Part of the coordinates' ranges by which each further start may be farther from the first."""
