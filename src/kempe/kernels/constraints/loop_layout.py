"""Where the numbers of packed loop closures lie. Needs no compiler, as `table_layout`.

Besides the primitive table, whose outputs 2k and 2k + 1 are the frames A and B of tie k, there are
`plan` (int64) and `weights` (float64):

    plan     head, then, from the places that the head gives:
             a tie:      MASK, TURNS, ROWS, FIRST_ROW, ENTRIES, ENTRY, LOCALS, LOCAL, BLOCK, PIN, LENGTHS, NUMBER,
                         BOUND, CENTRE, DATA
             an entry:   row of the table, local column of the tie
             a local:    velocity coordinate, or for a LINEAR tie its place in q
             a velocity: where its uses begin; a use: tie, local column
             a matrix row: its first column and where it begins in the envelope
             a reading:  code, place in q, tie; a velocity: place in q, sort, held
    weights  1/length, length; scales, lower, upper, low and high ends to draw from of all velocities; a number for each
             tie; a factor for each entry (for a LINEAR tie for each local); low and high of each
             row of a tie with BOUND; for each CENTRE and each row of the table its mass, first
             moment (3) in its axes and the mass of all that it moves, then the first moment (3) of
             what stands
    pins     (an argument) the poses (3x4) of pinned ties, then the numbers of ties with NUMBER
"""

import numpy as np

N_TIES = 0
N_ROWS = 1
N_READINGS = 2
N_PINS = 3
BLOCKS = 4
ENVELOPE = 5
AT_TIES = 6
AT_ENTRIES = 7
AT_LOCALS = 8
AT_VARS = 9
AT_USES = 10
AT_ROWS = 11
AT_READINGS = 12
AT_PLACES = 13
AT_NUMBERS = 14
AT_FACTORS = 15
AT_BOUNDS = 16
AT_CENTRES = 17
BASE_TIE = 18
BASE_ROW = 19
HEAD = 20
"""Places in the head of `plan`, and its size."""

MASK = 0
TURNS = 1
ROWS = 2
FIRST_ROW = 3
ENTRIES = 4
ENTRY = 5
LOCALS = 6
LOCAL = 7
BLOCK = 8
PIN = 9
LENGTHS = 10
NUMBER = 11
BOUND = 12
CENTRE = 13
DATA = 14
TIE_INTS = 15
ENTRY_INTS = 2
USE_INTS = 2
ENVELOPE_INTS = 2
READING_INTS = 3
PLACE_INTS = 3
"""A tie: LENGTHS counts its first rows, which are lengths; NUMBER, BOUND and CENTRE are -1 where it
has none; DATA is the velocity coordinate of an OWN tie, the address of the function of a FUNCTION
tie, what a TAPE tie reads."""

CENTRE_FLOATS = 5

INVERSE_LENGTH = 0
LENGTH = 1
SCALES = 2
"""Places in `weights`; the five lists of velocities follow from SCALES on."""


def view_velocity_lists(weights: np.ndarray, nv: int) -> np.ndarray:
    """Return the scales, lower and upper limits, and low and high ends of random starts (5, nv) of
    all velocities, as a view.
    """
    return weights[SCALES : SCALES + 5 * nv].reshape(5, nv)


SLIDE = 0
BOUND_TURN = 1
CIRCLE = 2
BALL_FIRST = 3
BALL_MORE = 4
"""Sorts of velocity coordinates: a slide; an angle; one that a turn brings back; the first and the
others of a ball."""

NO_TURN, ANGLE, ALIGN, CROSS, FULL, DISTANCE, LINEAR, LOOK, OWN, FUNCTION, TAPE = range(11)
"""What of the rotation of B in A a tie holds: nothing; the angle about z; z parallel to z; y of B
normal to x of A; all. LOOK: z of B towards the origin of A. The others are of another kind:
DISTANCE and LINEAR have one row each; OWN holds one coordinate, or a quaternion, at given values;
FUNCTION has the rows of a function of q, TAPE those of a recorded expression (`tape_layout`) of the
pose of B in A and of coordinates."""

TAPE_INTS = 0
TAPE_FLOATS = 1
TAPE_WORK = 2
TAPE_INPUTS = 3
INPUT_INTS = 3
"""What DATA of a TAPE tie leads to: where the integers and the numbers of its tape lie, where its
work area begins (in `jet` only), then for each input three integers: what it is, and for a
coordinate its place in q and its column. The rows of the tie are the outputs of the tape in their
order."""
PLACE = 0
COORDINATE = 12
GIVEN = 13
"""What an input is: the place (3) of B in A and the entries (9) of its rotation row by row, from
PLACE on; a coordinate; a number that comes with the call, counted from NUMBER on."""

(
    READ_X,
    READ_Y,
    READ_Z,
    READ_ANGLE,
    READ_RX,
    READ_RY,
    READ_QUATERNION,
    READ_YAW,
    READ_PITCH,
    READ_ROLL,
) = range(10)
"""How a coordinate of a cut joint follows from the pose of B in A: a slide, the turn about z, the
turns of a cross about x and y, a quaternion, the three turns about z, y', x''."""

DAMPING = 0.6
MOST_DAMPING = 0.1
"""Damping of a step that closes loops, by the mean square of the equations, and the most of it."""
LONGEST = 0.5
"""Longest step of a turn [rad]."""
WIDER = 0.15
"""Part of the coordinates' ranges by which each further start may be farther from the first."""
