"""Candidates of the elimination: Newton's method makes each a new posture, one that is known, or
none.
"""

from __future__ import annotations

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.scratch import beyond
from kempe.kernels.elimination.elimination_polish import polish, wrapped
from kempe.kernels.forward.table_layout import SLIDE

FOUND = 16
RAW_ERROR = 6
PIVOTS = 7
START = 8
KNOWN = 14
CLAIMED = 15
"""Numbers of a candidate in scratch: coordinates, error before Newton's steps, pivot ratio of the
Jacobian after them, coordinates before them, which candidate it came to be, whether a root at its
value of the hidden joint led to it."""

STEPS = 12
"""Newton steps of a candidate at most; two or three are usual, where postures merge each halves the
distance."""

ACCEPT = 1e-9
"""Error up to which a candidate is kept."""

SINGULAR_RATIO = 1e-5
"""Pivot ratio of the Jacobian below which a posture counts as singular."""

APART = 1e-6
"""Coordinates that differ by less are the same posture."""


@routine
def accept(kinds, lines, goal, found, count, work):
    """Candidate `count` becomes a new posture (1), one of those before (0), or none (-1)."""
    theta = beyond(found, FOUND * count)
    for j in range(6):
        theta[START + j] = theta[j]
    begin, end, ratio = polish(kinds, lines, goal, theta, work, STEPS)
    theta[RAW_ERROR] = begin
    theta[PIVOTS] = ratio
    theta[KNOWN] = float(count)
    theta[CLAIMED] = 0.0
    if not end < ACCEPT:
        return -1
    for j in range(6):
        if kinds[j] != SLIDE:
            theta[j] = wrapped(theta[j])
    for k in range(count):
        far = 0.0
        for j in range(6):
            d = theta[j] - found[FOUND * k + j]
            far = max(far, abs(d if kinds[j] == SLIDE else wrapped(d)))
        if far < APART:
            theta[KNOWN] = float(k)
            return 0
    return 1


@routine
def twin(kinds, lines, goal, found, source, count, work):
    """What `accept` says of candidate `count`, begun at the mirror image of candidate `source`
    about its own start.

    Two postures that are about to merge lie on both sides of where their common root, or two close
    ones, point.
    """
    one = beyond(found, FOUND * source)
    other = beyond(found, FOUND * count)
    for j in range(6):
        d = one[j] - one[START + j]
        other[j] = one[START + j] - (d if kinds[j] == SLIDE else wrapped(d))
    return accept(kinds, lines, goal, found, count, work)


@device
def is_singular(found, k):
    """Whether candidate k is a singular posture."""
    return not found[FOUND * k + PIVOTS] > SINGULAR_RATIO
