"""All postures of a chain of six joints that reach a pose: the complete solver for general
geometry.

`eliminate` solves E_1 ... E_6 = G by one of 36 formulations: equations without the removed joint
and without the pair (`elimination_loop`), a 16x16 or 24x24 matrix whose eigenvalues are the hidden
joint's values (`elimination_pencil`), null vectors that give the other two joints of the triple
(`elimination_null`), then the pair and the removed joint (`elimination_pair`), and a few Newton
steps (`elimination_polish`).

What special geometry does to a formulation: two postures may share the hidden joint's value (the
null space is a plane, and `split` finds both), roots without postures may appear, or the equations
may become dependent, so that it is useless. `elimination_score` tells which formulations suit a
chain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.eigen import EIGEN_SCRATCH, balance, hessenberg, shifted_qr
from kempe.kernels.base.scratch import beyond
from kempe.kernels.elimination.elimination_accept import (
    CLAIMED,
    FOUND,
    KNOWN,
    RAW_ERROR,
    START,
    accept,
    is_singular,
    twin,
)
from kempe.kernels.elimination.elimination_cluster import CLUSTER_SCRATCH, MOST, postures_at
from kempe.kernels.elimination.elimination_loop import (
    EQUATIONS,
    FANS_SIZE,
    IS_SLIDE,
    LINE_STRIDE,
    LOOP_SIZE,
    NUMBER,
    SAMPLE_STRIDE,
    TRIPLE,
    arrange,
    hidden_of,
    remove_pair,
    removed_of,
    sample,
)
from kempe.kernels.elimination.elimination_null import angles_of, null_vectors, split
from kempe.kernels.elimination.elimination_pair import PAIR_SIZE, pair_of, removed_turn
from kempe.kernels.elimination.elimination_pencil import (
    FORMS,
    LOST,
    ROW,
    SIZE,
    STRIDE,
    WIDE,
    assemble,
    companion,
    lead,
    matrix_at,
    null_at_i,
    pivot_ratio,
)
from kempe.kernels.elimination.elimination_polish import disturb, wrapped
from kempe.kernels.elimination.elimination_roots import (
    ANGLE,
    DOUBT,
    IMAGINARY,
    NEARLY,
    REAL,
    ROOT,
    TOGETHER,
    at_infinity,
    expected,
    matched,
    stand_for,
    together,
    write_roots,
)

CANDIDATES = 24
"""Candidates at most; 16 postures are possible."""

(
    ODD,
    NEARLY_REAL,
    NO_EIGENVALUES,
    ILL_LEAD,
    ILL_NULL,
    ASTRAY,
    TWICE,
    UNUSABLE,
    SINGULAR,
    FREE,
    UNMATCHED,
    SHARED,
) = (2**k for k in range(12))
"""Bits of `suspect`: an odd number of candidates; a pair of roots so nearly real that two postures
may have been lost; eigenvalues not found; leading matrix nearly singular; fewer null vectors than
roots, some that cannot be distinguished, or too many candidates; a real root that led to no
posture; two that led to the same; no independent equations; a singular posture, where others may
merge with it or be connected with it by a self-motion; a hidden joint that is nearly free, as on a
self-motion, or near one, where the eigenvalues are those of noise; a real root without a posture of
its own that has its value of the hidden joint, or a posture without a root; a triple that does not
determine the pair, so that two postures may share it."""

DEGENERATE = NO_EIGENVALUES | ILL_LEAD | ILL_NULL | UNUSABLE
"""Bits of doubts that a goal nearby may not raise."""

UNSOUND = DEGENERATE | UNMATCHED | SHARED
"""Bits of doubts that do not vanish where another formulation finds the same."""

WIDER = 100.0
"""How much larger the imaginary parts of postures that merge are at a disturbed goal: as its
root."""

NEARLY_FREE = 1e-5
CLOSE = 0.1
"""Pivot ratio of the leading matrix below which all values of the hidden joint are roots, or
nearly; error before Newton's steps up to which a candidate that they lead astray is a stray."""

BLURRED = 1e-2
SURELY = 10.0
"""Error of a null space from which it means nothing; how many times that it must be away from
having more postures."""

DETERMINED = 1e-6
"""Least sine between columns of the pair's equations below which these have more than one
solution."""

NOISE = 1e-7
SIMPLE = 1e-5
"""Error of a matrix up to which its null vector may be that of a posture; last but one pivot of a
simple root."""

NULL = 1e-9
"""Third last pivot, relative to the first, below which there are more than two null vectors."""

SEPARATE = 1e-8
"""Separation below which two postures cannot be distinguished."""

NO_MATRIX = 1e-12
GOOD_LEAD = 1e-7
"""Pivot ratio of the leading matrix: below the first the equations are dependent, below the second
they are suspect."""

REFERENCES = 4
GOOD_REFERENCE = 1e-3
"""Zeros of the hidden joint that are tried, and the pivot ratio of the leading matrix that is good
enough."""

_LOOP = 0
_FANS = _LOOP + LOOP_SIZE
_TABLE = _FANS + FANS_SIZE
_FORMS = _TABLE + EQUATIONS * SAMPLE_STRIDE
_RE = _FORMS + FORMS
_IM = _RE + SIZE * ROW
_MASK = _IM + SIZE * ROW
_FREE = _MASK + 2 * ROW
_WIDE = _FREE + 2 * SIZE
_MATRIX = _WIDE + SIZE * WIDE
_REAL_PARTS = _MATRIX + STRIDE * STRIDE
_IMAGINARY_PARTS = _REAL_PARTS + STRIDE
_EIGEN = _IMAGINARY_PARTS + STRIDE
_VECTORS = _EIGEN + EIGEN_SCRATCH
_GOAL = _VECTORS + MOST * ROW
_WORK = _GOAL + 12
_CLUSTER = _WORK + PAIR_SIZE
_ROOTS = _CLUSTER + CLUSTER_SCRATCH
FOUNDLINGS = _ROOTS + ROOT * STRIDE
"""Place of the candidates in scratch."""
ELIMINATION_SCRATCH = FOUNDLINGS + FOUND * (CANDIDATES + 2)
"""Numbers of scratch that `eliminate` needs."""


@routine
def matrix_of(kinds, lines, goal, formulation, w):
    """(rows, half the angle of zero, pivot ratio); writes the matrix with the hidden joint's roots
    t as eigenvalues.
    """
    table = beyond(w, _TABLE)
    forms = beyond(w, _FORMS)
    re = beyond(w, _RE)
    im = beyond(w, _IM)
    free = beyond(w, _FREE)
    wide = beyond(w, _WIDE)
    m = beyond(w, _MATRIX)
    fans = beyond(w, _FANS)
    arrange(kinds, lines, goal, formulation, w)
    sample(w, fans, table)
    remove_pair(table, fans)
    hidden = hidden_of(formulation)
    assemble(table, w, hidden, forms)
    lost = 0
    if (
        hidden == 0
        and w[TRIPLE + IS_SLIDE] == 0.0
        and null_at_i(forms, re, im, free, beyond(w, _MASK))
    ):
        lost = LOST
    for i in range(SIZE if lost == 0 else 0):
        free[2 * i] = float(i)
    half = 0.0
    best = -1.0
    for k in range(REFERENCES):
        angle = 0.35 + k * math.pi / REFERENCES
        matrix_at(forms, -math.sin(angle), math.cos(angle), m)
        ratio = pivot_ratio(m)
        if ratio > best:
            half = angle
            best = ratio
        if ratio > GOOD_REFERENCE:
            break
    ratio = lead(forms, math.cos(half), math.sin(half), free, SIZE - lost, wide)
    if ratio > NO_MATRIX:
        companion(wide, re, im, free, lost, m)
    return 2 * (SIZE - lost), half, ratio


@device
def _coordinate(w, place, angle):
    """The joint's coordinate: the angle, or the slide that it stands for."""
    return angle if w[place + IS_SLIDE] == 0.0 else math.tan(0.5 * angle)


@device
def _eigenvalues(n, w):
    """Eigenvalues of the hidden joint's matrix that were not found; writes the others."""
    m = beyond(w, _MATRIX)
    scratch = beyond(w, _EIGEN)
    balance(m, n, STRIDE)
    hessenberg(m, n, STRIDE, scratch)
    return shifted_qr(m, n, STRIDE, beyond(w, _REAL_PARTS), beyond(w, _IMAGINARY_PARTS), scratch)


@device
def _vectors_at(angle, alike, w):
    """(vectors, suspicion, proven, last but one pivot over the first); writes the null vectors of
    `alike` roots.

    Proven is that there are no more postures than vectors.
    """
    m = beyond(w, _MATRIX)
    x = beyond(w, _VECTORS)
    matrix_at(beyond(w, _FORMS), math.cos(0.5 * angle), math.sin(0.5 * angle), m)
    if alike > MOST:
        return 0, ILL_NULL, False, 0.0
    if alike > 2:
        vectors, error, margin = postures_at(
            m, alike, beyond(w, _MASK), beyond(w, _FREE), x, beyond(w, _CLUSTER)
        )
        return vectors, 0 if error < BLURRED else ILL_NULL, SURELY * error < margin, 0.0
    vectors, third, second = null_vectors(m, beyond(w, _MASK), beyond(w, _FREE), x)
    if vectors < 2:
        return vectors, 0 if vectors == 1 else ILL_NULL, False, second
    vectors, separation = split(x, beyond(w, _WORK))
    ill = 0 if third > NULL and separation > SEPARATE else ILL_NULL
    return vectors, ill, min(separation, 1.0) * third > SURELY * (second + NULL), second


@routine
def _posture(s, angle, k, theta):
    """(how far null vector k is from one of a posture, infinite at infinity; how well it determines
    the pair).

    Writes the six coordinates.
    """
    w = s.w
    work = beyond(s.w, _WORK)
    hidden = hidden_of(s.formulation)
    removed = removed_of(s.formulation)
    first, second, defect = angles_of(beyond(w, _VECTORS + ROW * k))
    for joint in range(3):
        place = TRIPLE + LINE_STRIDE * joint
        x = angle if joint == hidden else first if joint == (1 if hidden == 0 else 0) else second
        if at_infinity(w[place + IS_SLIDE] != 0.0, x):
            return math.inf, 1.0
        theta[int(w[place + NUMBER])] = _coordinate(w, place, x)
    quality = pair_of(w, theta, work)
    theta[removed] = removed_turn(s.kinds, s.lines, s.near, removed, theta, work)
    return defect, quality


class EliminationScratch(NamedTuple):
    """A chain with its goal, the goal whose roots are taken, the formulation, scratch and result;
    pointers.
    """

    kinds: object
    lines: object
    goal: object
    near: object
    w: object
    out: object
    formulation: int


@device
def _hidden_value(s, k):
    """The hidden joint's value in posture k as an angle."""
    place = TRIPLE + LINE_STRIDE * hidden_of(s.formulation)
    x = s.w[FOUNDLINGS + FOUND * k + int(s.w[place + NUMBER])]
    return x if s.w[place + IS_SLIDE] == 0.0 else 2.0 * math.atan2(x, 1.0)


@device
def _claimed_twice(s, k, angle):
    """Whether posture k is that of a root with this value of the hidden joint, and was that of
    another one before.
    """
    posture = beyond(s.w, FOUNDLINGS + FOUND * k)
    here = abs(wrapped(_hidden_value(s, k) - angle)) < NEARLY
    before = posture[CLAIMED] != 0.0
    posture[CLAIMED] = 1.0 if here else posture[CLAIMED]
    return here and before


@device
def _unmatched(s, n, count):
    """Whether a root that is expected to have a posture, or a posture, has no partner; a singular
    posture has two.
    """
    roots = beyond(s.w, _ROOTS)
    alone = False
    for again in range(2):
        for k in range(count):
            if again == 0:
                alone = alone or not matched(roots, n, _hidden_value(s, k))
            elif is_singular(beyond(s.w, FOUNDLINGS), k):
                matched(roots, n, _hidden_value(s, k))
    return alone or expected(roots, n) > 0


@routine
def _add(s, i, n, twins, count, strays):
    """(postures, strays, suspicion) with those of root i of n added.

    A stray is a start that was close, but Newton's steps led astray: written to `out`, from its
    end.
    """
    found = beyond(s.w, FOUNDLINGS)
    work = beyond(s.w, _WORK)
    roots = beyond(s.w, _ROOTS)
    imaginary = roots[ROOT * i + IMAGINARY]
    angle = roots[ROOT * i + ANGLE]
    none = 0
    alike, met, aside = together(roots, n, i) if imaginary < TOGETHER else (1, False, 0.0)
    if alike > 2 and met:
        return count, strays, 0
    angle += aside if alike > 2 else 0.0
    vectors, suspect, proven, second = _vectors_at(angle, alike, s.w)
    proven = suspect == 0 and imaginary < TOGETHER and (proven or vectors == 1)
    for k in range(vectors):
        if count == CANDIDATES:
            return count, strays, suspect | ILL_NULL
        theta = beyond(found, FOUND * count)
        defect, quality = _posture(s, angle, k, theta)
        other = vectors == 1 and second > SIMPLE and imaginary == 0.0 and defect * second > NOISE
        none += int(other or defect == math.inf)
        if defect == math.inf:
            continue
        state = accept(s.kinds, s.lines, s.goal, found, count, work)
        suspect |= SINGULAR if state > 0 and is_singular(found, count) else 0
        suspect |= SHARED if state >= 0 and quality < DETERMINED else 0
        if state < 0 and not other:
            suspect |= ASTRAY if imaginary < REAL else (NEARLY_REAL if imaginary < DOUBT else 0)
            if theta[RAW_ERROR] < CLOSE and strays < CANDIDATES:
                strays += 1
                for j in range(6):
                    s.out[6 * (CANDIDATES - strays) + j] = theta[START + j]
        if state < 0 or other:
            count += max(state, 0)
            continue
        again = _claimed_twice(s, int(theta[KNOWN]), angle) and twins
        merging = vectors == 1 and (imaginary > 0.0 or again)
        source = count
        count = count + state
        if merging and count < CANDIDATES:
            state = twin(s.kinds, s.lines, s.goal, found, source, count, work)
            suspect |= SINGULAR if state > 0 and is_singular(found, count) else 0
            suspect |= TWICE if state < 1 and imaginary < DOUBT else 0
            count += max(state, 0)
    if proven and (alike > 2 or none > 0 or vectors == 0):
        stand_for(roots, n, i, vectors - none)
    return count, strays, suspect


@routine
def _postures(s, n, half, disturbed, count, strays):
    """(postures, strays, suspicion) with those of the n roots added; of a pair of conjugates the
    first is enough.
    """
    suspect = 0
    roots = beyond(s.w, _ROOTS)
    narrower = 1.0 if disturbed == 0 else WIDER
    slides = s.w[TRIPLE + LINE_STRIDE * hidden_of(s.formulation) + IS_SLIDE] != 0.0
    write_roots(
        beyond(s.w, _REAL_PARTS), beyond(s.w, _IMAGINARY_PARTS), n, half, narrower, slides, roots
    )
    for i in range(n):
        if 0.0 <= roots[ROOT * i + IMAGINARY] < NEARLY and not at_infinity(
            slides, roots[ROOT * i + ANGLE]
        ):
            count, strays, doubt = _add(s, i, n, disturbed == 0, count, strays)
            suspect |= doubt
    lost = _unmatched(s, n, count) if disturbed == 0 else expected(roots, n) != count
    return count, strays, suspect | (UNMATCHED if lost else 0)


@routine
def eliminate(kinds, lines, goal, formulation, w, out):
    """(count, strays, suspect); writes `count` candidates, six coordinates each, angles in (-pi,
    pi].

    kinds, lines: the chain, LINE_STRIDE numbers a joint. goal: rows of G (12 numbers). w:
    ELIMINATION_SCRATCH numbers. out: room for CANDIDATES candidates. Each candidate fulfils the
    equation to ACCEPT, and no two are the same; after them follow `strays` starts near which
    Newton's steps found nothing, though more careful ones may. `suspect` is 0 or tells by its bits
    (ODD and others) why postures may be missing: then another formulation may find them. A chain or
    goal that is not finite gives no candidates.

    A goal can make the equations dependent, or give several postures the same hidden coordinate,
    though hardly any goal nearby does. Then a disturbed goal's postures are where Newton's steps
    begin.
    """
    found = beyond(w, FOUNDLINGS)
    count = 0
    strays = 0
    suspect = DEGENERATE
    least = 1.0
    for disturbed in range(2):
        if suspect & DEGENERATE == 0:
            break
        near = goal
        if disturbed == 1:
            near = beyond(w, _GOAL)
            disturb(goal, near)
        s = EliminationScratch(kinds, lines, goal, near, w, out, formulation)
        n, half, ratio = matrix_of(kinds, lines, near, formulation, w)
        suspect = UNUSABLE | suspect & SINGULAR
        least = min(least, ratio)
        if not ratio > NO_MATRIX:
            continue
        suspect = suspect & SINGULAR | (0 if ratio > GOOD_LEAD else ILL_LEAD)
        suspect |= NO_EIGENVALUES if _eigenvalues(n, w) > 0 else 0
        count, strays, doubt = _postures(s, n, half, disturbed, count, strays)
        suspect |= doubt
    strays = min(strays, CANDIDATES - count)
    for k in range(strays):  # those that came first stand last
        for j in range(6):
            found[FOUND * (count + k) + j] = out[6 * (CANDIDATES - 1 - k) + j]
    for k in range(count + strays):
        for j in range(6):
            out[6 * k + j] = found[FOUND * k + j]
    return (
        count,
        strays,
        suspect | (ODD if count % 2 == 1 else 0) | (FREE if least < NEARLY_FREE else 0),
    )
