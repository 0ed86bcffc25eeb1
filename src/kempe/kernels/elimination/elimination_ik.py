"""Elimination: every configuration that reaches a target, for chains of six joints in general
position.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import FLOAT, INT, OUT, OUTI, F, I
from kempe.kernels.base.lines import rotate_about_axis
from kempe.kernels.base.random import mix_bits, to_unit_interval
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import get_pointer, keep_alive
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
    add_solution,
    compute_gap,
    compute_largest_gap,
    count_listed_solutions,
    drop_solution,
    split_merged_roots,
)
from kempe.kernels.closed_form.one_target import (
    add_candidates,
    begin_target,
    count_target_scratch,
    finish_target,
    make_target_scratch,
)
from kempe.kernels.closed_form.polish import (
    AT_AXES,
    compute_error,
    find_tangent,
    polish_solution,
    solve_normal_equations,
    write_columns,
)
from kempe.kernels.elimination.elimination import (
    CANDIDATES,
    ELIMINATION_SCRATCH,
    FREE,
    UNSOUND,
    eliminate_unknowns,
)
from kempe.kernels.elimination.elimination_polish import polish_posture as newton
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
def write_shifted_goal(goal, side, far, out):
    """Write the goal turned and moved by `far` in a random direction; an odd side is opposite to
    the even side before.
    """
    key = mix_bits(np.uint64(1), np.uint64(side // 2))
    sign = 1.0 - 2.0 * (side % 2)
    x = 2.0 * to_unit_interval(mix_bits(key, np.uint64(0))) - 1.0
    y = 2.0 * to_unit_interval(mix_bits(key, np.uint64(1))) - 1.0
    z = 2.0 * to_unit_interval(mix_bits(key, np.uint64(2))) - 1.0
    size = math.sqrt(x * x + y * y + z * z) + 1e-300
    axis = (x / size, y / size, z / size)
    c = math.cos(far)
    s = sign * math.sin(far)
    for j in range(3):
        column = rotate_about_axis(axis, (goal[j], goal[4 + j], goal[8 + j]), c, s)
        out[j] = column[0]
        out[4 + j] = column[1]
        out[8 + j] = column[2]
    for i in range(3):
        out[4 * i + 3] = goal[4 * i + 3] + sign * far * (
            2.0 * to_unit_interval(mix_bits(key, np.uint64(3 + i))) - 1.0
        )


@routine
def relax_posture(m, theta):
    """Bring the tip back by steps that hardly move along a near self-motion; return the error left."""
    step = advance_pointer(m.scratch, AT_AXES + 12 * m.n + m.n * m.n)
    for _ in range(RELAXING):
        compute_error(m, theta)
        n = write_columns(m)
        k = 0
        size = ALONG
        if not solve_normal_equations(m, n, RELAXED):
            return math.inf
        for i in range(n):
            size = max(size, abs(step[i]))
        for i in range(m.n):
            if m.moves[i] != 0:
                theta[i] += step[k] * (ALONG / size)
                k += 1
    linear, angular = compute_error(m, theta)
    return math.hypot(linear, angular)


@routine
def classify_side(d, row, sign):
    """Classify a singular solution (row of `Found`) by one side of its tangent: CURVE, ALONE or
    OPEN.
    """
    m = d.found.model
    theta = d.theta
    here = advance_pointer(row, SOLUTION)
    compute_error(m, here)
    if not find_tangent(m, theta):
        return OPEN
    for i in range(m.n):
        theta[i] = here[i] + sign * ALONG * theta[i]
    aside = compute_largest_gap(m, theta, here)
    error = relax_posture(m, theta)
    if compute_largest_gap(m, theta, here) < 0.5 * aside:
        return ALONE
    if error <= ON_A_CURVE:
        return CURVE
    return (
        ALONE if error > max(ISOLATED, FASTER * ALONG * math.sqrt(max(row[WEAKEST], 0.0))) else OPEN
    )


@routine
def classify_solution(d, row):
    """Classify a singular solution (row of `Found`): CURVE, ALONE or OPEN."""
    one = classify_side(d, row, 1.0)
    other = classify_side(d, row, -1.0)
    return one if one == other else OPEN


@routine
def is_joined_sample(d, k):
    """Return whether sample k lies on one curve with a sample before it, since there is a solution
    halfway between them.
    """
    m = d.found.model
    here = advance_pointer(d.found.rows, (SOLUTION + d.n) * k + SOLUTION)
    for j in range(k):
        other = advance_pointer(d.found.rows, (SOLUTION + d.n) * j)
        far = compute_largest_gap(m, advance_pointer(other, SOLUTION), here)
        if other[TURNS] > 0.0 or far > JOINED:
            continue
        for i in range(m.n):
            d.theta[i] = other[SOLUTION + i] + 0.5 * compute_gap(
                m.kinds[i] == SLIDE, here[i], other[SOLUTION + i]
            )
        if relax_posture(m, d.theta) > ON_A_CURVE:
            continue
        one = compute_largest_gap(m, d.theta, here)
        two = compute_largest_gap(m, d.theta, advance_pointer(other, SOLUTION))
        if max(one, two) < 0.75 * far:
            return True
    return False


@routine
def thin_samples(d, first, count):
    """Replace the solutions from `first` on that lie on curves by samples, one each metre or
    radian; return the new number of solutions.
    """
    k = first
    while k < count:
        row = advance_pointer(d.found.rows, (SOLUTION + d.n) * k)
        if row[WEAKEST] < MERGED and row[TURNS] > 0.0 and classify_solution(d, row) == CURVE:
            row[TURNS] = 0.0
        if row[TURNS] == 0.0 and is_joined_sample(d, k):
            drop_solution(d.found, count, k)
            count -= 1
        else:
            k += 1
    return count


@routine
def are_kinds_known(d, count):
    """Return whether each singular solution is known to be isolated, or a sample of a curve."""
    for k in range(count):
        row = advance_pointer(d.found.rows, (SOLUTION + d.n) * k)
        if row[WEAKEST] < MERGED and row[TURNS] > 0.0 and classify_solution(d, row) == OPEN:
            return False
    return True


@routine
def solve_shifted_goal(d, goal, scratch, thetas):
    """Find the candidates of a goal by the first formulation without doubt; return their number, -1
    where all formulations are in doubt.
    """
    for f in range(d.ints[N_FORMS]):
        k, _, suspect = eliminate_unknowns(d.kinds, d.six, goal, d.ints[FORMS + f], scratch, thetas)
        if suspect == 0:
            return k
    return -1


@routine
def follow_candidates(d, scratch, thetas, candidates, count, side, hits):
    """Follow the solutions of a shifted goal to the goal itself; return the new number of
    solutions, and whether all were followed.

    All is well if each leads to a solution, and to a regular one that is near no more than one
    does.
    """
    m = d.found.model
    order = advance_pointer(d.ints, ORDER)
    start = d.candidates
    well = True
    for k in range(candidates):
        for i in range(d.n):
            d.theta[i] = start[i] = d.fixed[i]
        for i in range(6):
            if order[i] < d.n:
                start[order[i]] = thetas[6 * k + i]
        newton(d.kinds, d.six, d.goal, advance_pointer(thetas, 6 * k), scratch, STEPS)
        for i in range(6):
            if order[i] < d.n:
                d.theta[order[i]] = thetas[6 * k + i]
        before = count
        count = add_solution(d.found, count, d.theta, -1.0, AGAIN)
        at = -1
        least = NEAR
        for j in range(count):
            far = compute_largest_gap(
                m, advance_pointer(d.found.rows, (SOLUTION + d.n) * j + SOLUTION), d.theta
            )
            if far <= least:
                at = j
                least = far
        if at < 0 or count < before:
            well = False
            continue
        count = thin_samples(d, before, count)
        if at >= count:
            continue
        hit = advance_pointer(hits, HIT * at)
        if advance_pointer(d.found.rows, (SOLUTION + d.n) * at)[WEAKEST] > REGULAR:
            well = well and hit[SEEN] == side and compute_largest_gap(m, start, d.theta) < ASTRAY
        hit[HITS] = 1.0 if hit[SEEN] <= side else hit[HITS] + 1.0
        hit[SEEN] = side + 1.0
        hit[MOST_HITS] = max(hit[MOST_HITS], hit[HITS])
    return count, well


@routine
def confirm_at_distance(d, far, count, scratch, thetas):
    """Confirm by goals shifted by `far` that all solutions are found; return the new number of
    solutions, and whether it is confirmed.
    """
    goal = advance_pointer(scratch, AT_GOAL)
    hits = advance_pointer(scratch, AT_HITS)
    for k in range(HIT * MOST_SOLUTIONS):
        hits[k] = 0.0
    for side in range(SIDES):
        write_shifted_goal(d.goal, side, far, goal)
        candidates = solve_shifted_goal(d, goal, scratch, thetas)
        if candidates < 0:
            return count, False
        count, well = follow_candidates(d, scratch, thetas, candidates, count, side, hits)
        for k in range(count):
            regular = advance_pointer(d.found.rows, (SOLUTION + d.n) * k)[WEAKEST] > REGULAR
            well = well and (not regular or hits[HIT * k + SEEN] == side + 1.0)
        if not well or count == MOST_SOLUTIONS:
            return count, False
    known = are_kinds_known(d, count)
    for k in range(count):
        row = advance_pointer(d.found.rows, (SOLUTION + d.n) * k)
        if known and row[WEAKEST] < MERGED and row[TURNS] > 0.0:
            row[TURNS] = max(hits[HIT * k + MOST_HITS], 1.0)
    return count, known


@routine
def confirm_solutions(d, count, scratch, thetas):
    """Confirm by shifted goals that all solutions are found; return the new number of solutions,
    and whether it is confirmed.
    """
    count, sure = confirm_at_distance(d, WIDE, count, scratch, thetas)
    return (count, sure) if sure else confirm_at_distance(d, NARROW, count, scratch, thetas)


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
def search_self_motions(d, count):
    """Search for self-motions from a few random starts; return the new number of solutions."""
    for i in range(STARTS):
        row = advance_pointer(d.candidates, CANDIDATE * i)
        key = mix_bits(np.uint64(0), np.uint64(i))
        for j in range(6):
            x = 2.0 * to_unit_interval(mix_bits(key, np.uint64(j))) - 1.0
            row[j] = x if d.kinds[j] == SLIDE else math.pi * x
        row[CANDIDATE_SLOT] = -1.0
        row[SAMPLE] = 0.0
    return add_candidates(d, advance_pointer(d.ints, ORDER), 0, STARTS, AGAIN, count)


@routine
def walk_singular_curve(d, count):
    """Add the solutions that lie on the same nearly closed curve of nearly singular postures;
    return the new number of solutions.

    A goal next to one that has a curve of solutions has a few, anywhere along it: damped steps lead
    back to the curve, undamped ones along it. A true self-motion is left alone.
    """
    m = d.found.model
    k = 0
    here = d.candidates
    ahead = advance_pointer(d.candidates, d.n)
    before = advance_pointer(d.candidates, 2 * d.n)
    while k < count:
        row = advance_pointer(d.found.rows, (SOLUTION + d.n) * k)
        k += 1
        for i in range(d.n if row[WEAKEST] < MERGED else 0):
            here[i] = row[SOLUTION + i]
            before[i] = 0.0
        for pace in range(PACES if row[WEAKEST] < MERGED else 0):
            compute_error(m, here)
            if not find_tangent(m, ahead):
                break
            cosine = 0.0
            for i in range(d.n):
                cosine += ahead[i] * before[i]
            for i in range(d.n):
                before[i] = -ahead[i] if cosine < 0.0 else ahead[i]
                d.theta[i] = here[i] + PACE * before[i]
            linear, angular = polish_solution(m, d.theta)
            moved = compute_largest_gap(m, d.theta, here)
            if not UNSURE < max(linear, angular) < CLOSE or not 0.2 * PACE < moved < 2.0 * PACE:
                break
            for i in range(d.n):
                here[i] = d.theta[i]
            count = add_solution(d.found, count, d.theta, -1.0, AGAIN)
            if (
                pace > 1
                and compute_largest_gap(m, here, advance_pointer(row, SOLUTION)) < 0.5 * PACE
            ):
                break
    return count


@device
def has_resting_lines(d):
    """Return whether lines must stay at rest, so that most roots are no solutions."""
    for i in range(6):
        if d.ints[ROLES + i] == REST:
            return True
    return False


@routine
def find_merged_root(d, count):
    """Return the place of the one solution where two roots have merged, which explains an odd
    number; or EVEN, or UNEXPLAINED.

    Where lines must stay at rest, most roots are no solutions, and any number is right.
    """
    total = 0.0
    folds = 0
    at = 0
    if has_resting_lines(d):
        return EVEN
    for k in range(count):
        row = advance_pointer(d.found.rows, (SOLUTION + d.n) * k)
        total += row[TURNS]
        if row[WEAKEST] < FOLD and row[TURNS] == 1.0 and classify_solution(d, row) == ALONE:
            folds += 1
            at = k
    if total % 2.0 == 0.0:
        return EVEN
    return at if folds == 1 else UNEXPLAINED


@routine
def mark_fold(d, count):
    """Return whether the number of solutions is even, or odd with an explanation: a solution where
    two roots have merged counts twice.
    """
    at = find_merged_root(d, count)
    if at >= 0:
        advance_pointer(d.found.rows, (SOLUTION + d.n) * at)[TURNS] = 2.0
    return at != UNEXPLAINED


@routine
def try_formulations(d, scratch, thetas):
    """Try formulations until the answer of one of them is without doubt; return (number of
    solutions, doubt).

    It is where each root of one formulation has a solution of its own, or of two, except for
    singular solutions.
    """
    count = 0
    doubt = 1
    free = False
    crowded = False
    witnesses = 0
    resting = has_resting_lines(d)
    for f in range(d.ints[N_FORMS]):
        k, strays, suspect = eliminate_unknowns(
            d.kinds, d.six, d.goal, d.ints[FORMS + f], scratch, thetas
        )
        for i in range(k + strays):
            row = advance_pointer(d.candidates, CANDIDATE * i)
            for j in range(6):
                row[j] = thetas[6 * i + j]
            row[CANDIDATE_SLOT] = -1.0
            row[SAMPLE] = 0.0
        before = count
        free = free or suspect & FREE != 0
        count = add_candidates(
            d, advance_pointer(d.ints, ORDER), 0, k, ROOT if f == 0 else AGAIN, count
        )
        count = add_candidates(d, advance_pointer(d.ints, ORDER), k, k + strays, AGAIN, count)
        if count > CROWDED:
            crowded = True
            count = thin_samples(d, 0, count)
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
            and find_merged_root(d, count) != UNEXPLAINED
        ):
            doubt = 0
            break
    count = walk_singular_curve(d, search_self_motions(d, count)) if free else count
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
def find_general_solutions(
    ints, floats, targets, near, locked, tol_linear, tol_angular, sort, which, out, counts
):
    """Find all solutions by elimination, arguments as of
    `every_solution.find_closed_form_solutions`; counts[:, 1] is 1 in doubt.
    """
    n = ints[N_JOINTS]
    slots = out.shape[1]
    block = np.empty(count_target_scratch(n) + CONFIRM_SCRATCH)
    flags = np.empty(6 + slots, np.int64)
    d = make_target_scratch(
        get_pointer(ints),
        get_pointer(floats),
        get_pointer(block),
        get_pointer(flags),
        tol_linear,
        tol_angular,
    )
    scratch = advance_pointer(get_pointer(block), count_target_scratch(n))
    for i in which:
        close_to = advance_pointer(get_pointer(near), n * i if near.shape[0] > 1 else 0)
        held = advance_pointer(get_pointer(locked), n * i if locked.shape[0] > 1 else 0)
        sound = begin_target(d, advance_pointer(get_pointer(targets), 16 * i), close_to, held)
        count = 0
        doubt = 0
        if sound:
            count, doubt = try_formulations(
                d, scratch, advance_pointer(scratch, ELIMINATION_SCRATCH)
            )
            count = split_merged_roots(d.found, count)
            if not mark_fold(d, count):
                doubt = 1
            if doubt == 1 or count_listed_solutions(d.found, count) > slots:
                count = thin_samples(d, 0, count)
            if doubt == 1 and not has_resting_lines(d):
                count, sure = confirm_solutions(
                    d, count, scratch, advance_pointer(scratch, ELIMINATION_SCRATCH)
                )
                doubt = 0 if sure else 1
            if count_listed_solutions(d.found, count) > slots:
                doubt = 1
        written = finish_target(
            d,
            count,
            close_to,
            advance_pointer(get_pointer(out), slots * (n + INFO) * i),
            slots,
            sort,
        )
        counts[i, 0] = written if sound else -1
        counts[i, 1] = doubt
    keep_alive(block)
    keep_alive(flags)
