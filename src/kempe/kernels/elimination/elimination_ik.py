"""Every configuration that reaches a target, for chains of six joints without structure: by
elimination.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import FLOAT, INT, OUT, OUTI, F, I
from kempe.kernels.base.lines import turned
from kempe.kernels.base.random import mix, unit
from kempe.kernels.base.scratch import beyond
from kempe.kernels.base.vectors import keep, raw
from kempe.kernels.closed_form.analytic_layout import (
    FORMS,
    INFO,
    N_FORMS,
    N_JOINTS,
    ORDER,
    REST,
    ROLES,
)
from kempe.kernels.closed_form.candidates import CANDIDATE, SAMPLE
from kempe.kernels.closed_form.candidates import SLOT as CANDIDATE_SLOT
from kempe.kernels.closed_form.merging import (
    AGAIN,
    CLOSE,
    MERGED,
    MOST_SOLUTIONS,
    NEAR,
    ROOT,
    SOLUTION,
    TURNS,
    UNSURE,
    WEAKEST,
    add,
    distance,
    drop,
    gap,
    listed,
    split,
)
from kempe.kernels.closed_form.one_target import (
    begin,
    end,
    take_candidates,
    target_scratch,
    target_scratch_size,
)
from kempe.kernels.closed_form.polish import (
    AT_AXES,
    columns_at,
    error_at,
    normal_equations,
    polish,
    tangent,
)
from kempe.kernels.elimination.elimination import (
    CANDIDATES,
    ELIMINATION_SCRATCH,
    FREE,
    UNSOUND,
    eliminate,
)
from kempe.kernels.elimination.elimination_polish import polish as newton
from kempe.kernels.forward.table_layout import SLIDE

# ---- elimination confirm

# Answers of eliminations that are in doubt confirmed a second way: by goals aside, whose answers
# are beyond doubt.
#
# A goal whose solutions merge, or lie on curves, is hardly ever one at which the equations are in a
# general position; those a little aside are, and each of their solutions leads by Newton's steps to
# one of the goal. An isolated solution of the goal that is regular has one partner for each goal
# aside, and one in which roots have merged has partners on at least one of two opposite sides.


SIDES = 4
WIDE = 1e-3
NARROW = 1e-4
"""Goals aside, each two opposite; how far they are, in radians and lengths of the chain: the first
suits where roots have merged, the second where solutions are near each other."""

STEPS = 40
ASTRAY = 0.5
"""Newton steps from a solution of a goal aside; how far from it a regular solution may be to which
they lead."""

REGULAR = 1e-4
"""Bound of the smallest singular value squared above which a solution has one partner at each goal
aside."""

ALONG = 0.02
RELAXING = 14
RELAXED = 1e-12
"""How far along its tangent a singular solution is looked at; steps that bring the tip back from
there, and their damping: on curves all along which roots have merged they only halve the
distance."""

ON_A_CURVE = 1e-11
ISOLATED = 1e-8
FASTER = 10.0
"""The error after these steps up to which there is a curve of solutions, if they lead to none
nearer; from which, if it grows so much faster than by the smallest singular value, the solution is
isolated."""

JOINED = 1.0
"""How far from each other samples of a curve may be, in radians and lengths of the chain, for one
to stand for both."""

CURVE = 0
ALONE = 1
OPEN = 2
"""What a singular solution is: on a curve of solutions, isolated, or neither for sure."""

SEEN = 0
HITS = 1
MOST_HITS = 2
HIT = 3
"""Of each solution: sides that were followed to it so far, how often from the present side, how
often from any."""

AT_GOAL = ELIMINATION_SCRATCH + 6 * CANDIDATES
AT_HITS = ELIMINATION_SCRATCH + 6 * CANDIDATES + 12
CONFIRM_SCRATCH = AT_HITS + HIT * MOST_SOLUTIONS
"""Numbers of scratch that an elimination with all that confirms it needs."""


@routine
def goal_aside(goal, side, far, out):
    """Write the goal moved so far in a random direction, for odd sides opposite to the one before."""
    key = mix(np.uint64(1), np.uint64(side // 2))
    sign = 1.0 - 2.0 * (side % 2)
    x = 2.0 * unit(mix(key, np.uint64(0))) - 1.0
    y = 2.0 * unit(mix(key, np.uint64(1))) - 1.0
    z = 2.0 * unit(mix(key, np.uint64(2))) - 1.0
    size = math.sqrt(x * x + y * y + z * z) + 1e-300
    axis = (x / size, y / size, z / size)
    c = math.cos(far)
    s = sign * math.sin(far)
    for j in range(3):
        column = turned(axis, (goal[j], goal[4 + j], goal[8 + j]), c, s)
        out[j] = column[0]
        out[4 + j] = column[1]
        out[8 + j] = column[2]
    for i in range(3):
        out[4 * i + 3] = goal[4 * i + 3] + sign * far * (
            2.0 * unit(mix(key, np.uint64(3 + i))) - 1.0
        )


@routine
def relaxed(m, theta):
    """The error left after steps that bring the tip back, but hardly along what is nearly a
    self-motion.
    """
    step = beyond(m.scratch, AT_AXES + 12 * m.n + m.n * m.n)
    for _ in range(RELAXING):
        error_at(m, theta)
        n = columns_at(m)
        k = 0
        size = ALONG
        if not normal_equations(m, n, RELAXED):
            return math.inf
        for i in range(n):
            size = max(size, abs(step[i]))
        for i in range(m.n):
            if m.moves[i] != 0:
                theta[i] += step[k] * (ALONG / size)
                k += 1
    linear, angular = error_at(m, theta)
    return math.hypot(linear, angular)


@routine
def kind_aside(d, row, sign):
    """CURVE, ALONE or OPEN: what a singular solution (row of `Found`) seems to be by one side of
    its tangent.
    """
    m = d.found.model
    theta = d.theta
    here = beyond(row, SOLUTION)
    error_at(m, here)
    if not tangent(m, theta):
        return OPEN
    for i in range(m.n):
        theta[i] = here[i] + sign * ALONG * theta[i]
    aside = distance(m, theta, here)
    error = relaxed(m, theta)
    if distance(m, theta, here) < 0.5 * aside:
        return ALONE
    if error <= ON_A_CURVE:
        return CURVE
    return (
        ALONE if error > max(ISOLATED, FASTER * ALONG * math.sqrt(max(row[WEAKEST], 0.0))) else OPEN
    )


@routine
def kind_of(d, row):
    """CURVE, ALONE or OPEN, of a singular solution (row of `Found`)."""
    one = kind_aside(d, row, 1.0)
    other = kind_aside(d, row, -1.0)
    return one if one == other else OPEN


@routine
def joined(d, k):
    """Whether sample k is on one curve with a sample before it: halfway between them there is a
    solution as well.
    """
    m = d.found.model
    here = beyond(d.found.rows, (SOLUTION + d.n) * k + SOLUTION)
    for j in range(k):
        other = beyond(d.found.rows, (SOLUTION + d.n) * j)
        far = distance(m, beyond(other, SOLUTION), here)
        if other[TURNS] > 0.0 or far > JOINED:
            continue
        for i in range(m.n):
            d.theta[i] = other[SOLUTION + i] + 0.5 * gap(
                m.kinds[i] == SLIDE, here[i], other[SOLUTION + i]
            )
        if relaxed(m, d.theta) > ON_A_CURVE:
            continue
        one = distance(m, d.theta, here)
        two = distance(m, d.theta, beyond(other, SOLUTION))
        if max(one, two) < 0.75 * far:
            return True
    return False


@routine
def thinned(d, first, count):
    """New number of solutions: of those from `first` on, those on curves become samples, one each
    metre or radian.
    """
    k = first
    while k < count:
        row = beyond(d.found.rows, (SOLUTION + d.n) * k)
        if row[WEAKEST] < MERGED and row[TURNS] > 0.0 and kind_of(d, row) == CURVE:
            row[TURNS] = 0.0
        if row[TURNS] == 0.0 and joined(d, k):
            drop(d.found, count, k)
            count -= 1
        else:
            k += 1
    return count


@routine
def known_of(d, count):
    """Whether it is known of each singular solution that it is isolated, or a sample of a curve."""
    for k in range(count):
        row = beyond(d.found.rows, (SOLUTION + d.n) * k)
        if row[WEAKEST] < MERGED and row[TURNS] > 0.0 and kind_of(d, row) == OPEN:
            return False
    return True


@routine
def answer_aside(d, goal, scratch, thetas):
    """Number of candidates of the first formulation that leaves nothing in doubt about a goal, -1
    where all do.
    """
    for f in range(d.ints[N_FORMS]):
        k, _, suspect = eliminate(d.kinds, d.six, goal, d.ints[FORMS + f], scratch, thetas)
        if suspect == 0:
            return k
    return -1


@routine
def followed(d, scratch, thetas, candidates, count, side, hits):
    """(new number of solutions, whether all is well) after those of a goal aside were followed to
    the goal.

    All is well if each leads to a solution, and to a regular one that is near no more than one
    does.
    """
    m = d.found.model
    order = beyond(d.ints, ORDER)
    start = d.candidates
    well = True
    for k in range(candidates):
        for i in range(d.n):
            d.theta[i] = start[i] = d.fixed[i]
        for i in range(6):
            if order[i] < d.n:
                start[order[i]] = thetas[6 * k + i]
        newton(d.kinds, d.six, d.goal, beyond(thetas, 6 * k), scratch, STEPS)
        for i in range(6):
            if order[i] < d.n:
                d.theta[order[i]] = thetas[6 * k + i]
        before = count
        count = add(d.found, count, d.theta, -1.0, AGAIN)
        at = -1
        least = NEAR
        for j in range(count):
            far = distance(m, beyond(d.found.rows, (SOLUTION + d.n) * j + SOLUTION), d.theta)
            if far <= least:
                at = j
                least = far
        if at < 0 or count < before:
            well = False
            continue
        count = thinned(d, before, count)
        if at >= count:
            continue
        hit = beyond(hits, HIT * at)
        if beyond(d.found.rows, (SOLUTION + d.n) * at)[WEAKEST] > REGULAR:
            well = well and hit[SEEN] == side and distance(m, start, d.theta) < ASTRAY
        hit[HITS] = 1.0 if hit[SEEN] <= side else hit[HITS] + 1.0
        hit[SEEN] = side + 1.0
        hit[MOST_HITS] = max(hit[MOST_HITS], hit[HITS])
    return count, well


@routine
def confirmed_by(d, far, count, scratch, thetas):
    """(new number of solutions, whether goals so far aside confirm that these are all)."""
    goal = beyond(scratch, AT_GOAL)
    hits = beyond(scratch, AT_HITS)
    for k in range(HIT * MOST_SOLUTIONS):
        hits[k] = 0.0
    for side in range(SIDES):
        goal_aside(d.goal, side, far, goal)
        candidates = answer_aside(d, goal, scratch, thetas)
        if candidates < 0:
            return count, False
        count, well = followed(d, scratch, thetas, candidates, count, side, hits)
        for k in range(count):
            regular = beyond(d.found.rows, (SOLUTION + d.n) * k)[WEAKEST] > REGULAR
            well = well and (not regular or hits[HIT * k + SEEN] == side + 1.0)
        if not well or count == MOST_SOLUTIONS:
            return count, False
    known = known_of(d, count)
    for k in range(count):
        row = beyond(d.found.rows, (SOLUTION + d.n) * k)
        if known and row[WEAKEST] < MERGED and row[TURNS] > 0.0:
            row[TURNS] = max(hits[HIT * k + MOST_HITS], 1.0)
    return count, known


@routine
def confirmed(d, count, scratch, thetas):
    """(new number of solutions, whether goals aside confirm that these are all)."""
    count, sure = confirmed_by(d, WIDE, count, scratch, thetas)
    return (count, sure) if sure else confirmed_by(d, NARROW, count, scratch, thetas)


STARTS = 64
PACES = 40
PACE = 0.3
"""Starts where a joint is nearly free; steps of a walk along what is nearly a self-motion, and
their length."""

FOLD = 1e-4
"""Bound of the smallest singular value squared of a solution in which two roots may have merged."""

CROWDED = 16
"""More solutions than isolated ones are possible."""

EVEN = -1
UNEXPLAINED = -2
"""An even number of solutions; an odd one of which no solution is a double one."""


@routine
def searched(d, count):
    """New number of solutions after a few starts anywhere: it is hard to miss a self-motion."""
    for i in range(STARTS):
        row = beyond(d.candidates, CANDIDATE * i)
        key = mix(np.uint64(0), np.uint64(i))
        for j in range(6):
            x = 2.0 * unit(mix(key, np.uint64(j))) - 1.0
            row[j] = x if d.kinds[j] == SLIDE else math.pi * x
        row[CANDIDATE_SLOT] = -1.0
        row[SAMPLE] = 0.0
    return take_candidates(d, beyond(d.ints, ORDER), 0, STARTS, AGAIN, count)


@routine
def walked(d, count):
    """New number of solutions, those added that lie on the same nearly closed way of nearly
    singular postures.

    A goal next to one that has a curve of solutions has a few, anywhere along it: damped steps lead
    back to the curve, undamped ones along it. A true self-motion is left alone.
    """
    m = d.found.model
    k = 0
    here = d.candidates
    ahead = beyond(d.candidates, d.n)
    before = beyond(d.candidates, 2 * d.n)
    while k < count:
        row = beyond(d.found.rows, (SOLUTION + d.n) * k)
        k += 1
        for i in range(d.n if row[WEAKEST] < MERGED else 0):
            here[i] = row[SOLUTION + i]
            before[i] = 0.0
        for pace in range(PACES if row[WEAKEST] < MERGED else 0):
            error_at(m, here)
            if not tangent(m, ahead):
                break
            cosine = 0.0
            for i in range(d.n):
                cosine += ahead[i] * before[i]
            for i in range(d.n):
                before[i] = -ahead[i] if cosine < 0.0 else ahead[i]
                d.theta[i] = here[i] + PACE * before[i]
            linear, angular = polish(m, d.theta)
            moved = distance(m, d.theta, here)
            if not UNSURE < max(linear, angular) < CLOSE or not 0.2 * PACE < moved < 2.0 * PACE:
                break
            for i in range(d.n):
                here[i] = d.theta[i]
            count = add(d.found, count, d.theta, -1.0, AGAIN)
            if pace > 1 and distance(m, here, beyond(row, SOLUTION)) < 0.5 * PACE:
                break
    return count


@device
def rests(d):
    """Whether lines must stay at rest: then most roots are no solutions."""
    for i in range(6):
        if d.ints[ROLES + i] == REST:
            return True
    return False


@routine
def parity(d, count):
    """Place of the one solution where two roots have merged, which explains an odd number; or EVEN,
    or UNEXPLAINED.

    Where lines must stay at rest, most roots are no solutions, and any number is right.
    """
    total = 0.0
    folds = 0
    at = 0
    if rests(d):
        return EVEN
    for k in range(count):
        row = beyond(d.found.rows, (SOLUTION + d.n) * k)
        total += row[TURNS]
        if row[WEAKEST] < FOLD and row[TURNS] == 1.0 and kind_of(d, row) == ALONE:
            folds += 1
            at = k
    if total % 2.0 == 0.0:
        return EVEN
    return at if folds == 1 else UNEXPLAINED


@routine
def mark_fold(d, count):
    """Whether the number of solutions is even, or is explained: a solution where two roots have
    merged counts twice.
    """
    at = parity(d, count)
    if at >= 0:
        beyond(d.found.rows, (SOLUTION + d.n) * at)[TURNS] = 2.0
    return at != UNEXPLAINED


@routine
def eliminated(d, scratch, thetas):
    """(number of solutions, doubt): formulations are tried until the answer of one of them is
    beyond doubt.

    It is where each root of one formulation has a solution of its own, or of two, except for
    singular solutions.
    """
    count = 0
    doubt = 1
    free = False
    crowded = False
    witnesses = 0
    resting = rests(d)
    for f in range(d.ints[N_FORMS]):
        k, strays, suspect = eliminate(d.kinds, d.six, d.goal, d.ints[FORMS + f], scratch, thetas)
        for i in range(k + strays):
            row = beyond(d.candidates, CANDIDATE * i)
            for j in range(6):
                row[j] = thetas[6 * i + j]
            row[CANDIDATE_SLOT] = -1.0
            row[SAMPLE] = 0.0
        before = count
        free = free or suspect & FREE != 0
        count = take_candidates(d, beyond(d.ints, ORDER), 0, k, ROOT if f == 0 else AGAIN, count)
        count = take_candidates(d, beyond(d.ints, ORDER), k, k + strays, AGAIN, count)
        if count > CROWDED:
            crowded = True
            count = thinned(d, 0, count)
        enough = count > 0 or f >= 2  # that there is no solution has to be said thrice
        each = (
            resting or count == k
        )  # no two were the same in the end, and none was missed that is known
        clean = suspect == 0 or (
            count == 0 and suspect == FREE
        )  # far away the leading matrix is small
        if clean and enough and (f == 0 or count == before) and each:
            doubt = 0
            break
        witnesses = (witnesses if count == before else 0) + int(suspect & UNSOUND == 0 and each)
        if (
            witnesses > 1
            and not crowded
            and count == before
            and enough
            and each
            and parity(d, count) != UNEXPLAINED
        ):
            doubt = 0
            break
    count = walked(d, searched(d, count)) if free else count
    return count, doubt if count < MOST_SOLUTIONS else 1


@kernel(
    I("_"),
    F("_"),
    F("N", 4, 4),
    F("1|N", "n"),
    F("1|N", "n"),
    FLOAT,
    FLOAT,
    INT,
    I("_"),
    OUT("N", "_", f"n+{INFO}"),
    OUTI("N", 2),
    returns=False,
)
def general(ints, floats, targets, near, locked, tol_linear, tol_angular, sort, which, out, counts):
    """Find all solutions by elimination, arguments as of `every_solution.closed`; counts[:, 1] is 1
    in doubt.
    """
    n = ints[N_JOINTS]
    slots = out.shape[1]
    block = np.empty(target_scratch_size(n) + CONFIRM_SCRATCH)
    flags = np.empty(6 + slots, np.int64)
    d = target_scratch(raw(ints), raw(floats), raw(block), raw(flags), tol_linear, tol_angular)
    scratch = beyond(raw(block), target_scratch_size(n))
    for i in which:
        close_to = beyond(raw(near), n * i if near.shape[0] > 1 else 0)
        held = beyond(raw(locked), n * i if locked.shape[0] > 1 else 0)
        sound = begin(d, beyond(raw(targets), 16 * i), close_to, held)
        count = 0
        doubt = 0
        if sound:
            count, doubt = eliminated(d, scratch, beyond(scratch, ELIMINATION_SCRATCH))
            count = split(d.found, count)
            if not mark_fold(d, count):
                doubt = 1
            if doubt == 1 or listed(d.found, count) > slots:
                count = thinned(d, 0, count)
            if doubt == 1 and not rests(d):
                count, sure = confirmed(d, count, scratch, beyond(scratch, ELIMINATION_SCRATCH))
                doubt = 0 if sure else 1
            if listed(d.found, count) > slots:
                doubt = 1
        written = end(d, count, close_to, beyond(raw(out), slots * (n + INFO) * i), slots, sort)
        counts[i, 0] = written if sound else -1
        counts[i, 1] = doubt
    keep(block)
    keep(flags)
