"""One target of the analytical inverse model from the plan's arrays to the rows of its answer."""

from __future__ import annotations

import math
from typing import NamedTuple

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.lines import (
    LINE_STRIDE,
    append_motion,
    dot,
    read_translation,
    read_vector,
    rotate_vector,
    subtract_vectors,
    transform_point,
    write_identity,
    write_vector,
)
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.closed_form.analytic_layout import (
    CODE,
    FACTOR,
    INFO,
    INSIDE_BIT,
    JOINT,
    JOINT_FLOATS,
    LENGTH,
    LINES,
    MULTIPLICITY_UNIT,
    N_JOINTS,
    N_LINES,
    OFFSET,
    ORDER,
    ORIGIN,
    PLAN_HEADER,
    REST,
    ROLES,
    SLOT_UNIT,
    TASK,
    TIP,
    UNUSED,
    WEAK_BIT,
)
from kempe.kernels.closed_form.analytic_layout import ERROR as ERROR_AT
from kempe.kernels.closed_form.arm_part import REPEATED
from kempe.kernels.closed_form.candidates import CANDIDATE, MOST_CANDIDATES, SAMPLE
from kempe.kernels.closed_form.candidates import SLOT as CANDIDATE_SLOT
from kempe.kernels.closed_form.merging import (
    AGAIN,
    ERROR,
    MERGED,
    MOST_SOLUTIONS,
    OPENED,
    SAMPLED,
    SIGNS,
    SOLUTION,
    TURNS,
    WEAKEST,
    FoundSolutions,
    add_solution,
    sort_rows,
    unite_solutions,
    write_coordinates,
)
from kempe.kernels.closed_form.polish import Model, count_model_scratch
from kempe.kernels.forward.table_layout import SLIDE

OFF_ZERO = 0.2
"""How far from zero a joint that must rest there may be in a candidate: polishing may still bring
it to a solution."""

WEAK = 1e-6
"""Bound of the smallest singular value squared below which a solution is near a singularity."""

ROTATION_TOLERANCE = 1e-6
"""Largest entry of R^T R - 1 that a target's rotation may have."""


@routine
def read_target(targets, k, floats, out):
    """Read the 4x4 pose at targets[k:], seen from the plan's origin in units of its length; return
    whether it is a valid pose.
    """
    sound = True
    for i in range(3):
        for j in range(4):
            out[4 * i + j] = targets[k + 4 * i + j]
        out[4 * i + 3] = (out[4 * i + 3] - floats[ORIGIN + i]) / floats[LENGTH]
        sound = sound and abs(out[4 * i + 3]) < 1e100
    for i in range(3):
        for j in range(3):
            product = out[i] * out[j] + out[4 + i] * out[4 + j] + out[8 + i] * out[8 + j]
            sound = sound and abs(product - (1.0 if i == j else 0.0)) <= ROTATION_TOLERANCE
    z = out[0] * out[5] - out[1] * out[4]
    det = (
        out[10] * z
        + out[6] * (out[1] * out[8] - out[0] * out[9])
        + out[2] * (out[4] * out[9] - out[5] * out[8])
    )
    return sound and det > 0.0


@device
def write_goal(target, tip, goal):
    """Write the goal G = T M^-1 of the target T and the tip's pose M."""
    for i in range(3):
        row = read_vector(target, 4 * i)
        for j in range(3):
            goal[4 * i + j] = dot(row, read_vector(tip, 4 * j))
    p = subtract_vectors(read_translation(target), rotate_vector(goal, read_translation(tip)))
    goal[3] = p[0]
    goal[7] = p[1]
    goal[11] = p[2]


@routine
def write_six_lines(ints, floats, moves, theta, goal, shift, six, kinds):
    """Write the six lines of the plan, with the locked joints at their values, and the goal without
    the locked joints.

    A locked joint carries all lines that follow it: E_1 E_l E_2 = E_1 (E_l E_2 E_l^-1) E_l.
    """
    n = ints[N_JOINTS]
    write_identity(shift)
    for i in range(ints[N_LINES]):
        at = LINES + LINE_STRIDE * i
        h = read_vector(floats, at)
        o = read_vector(floats, at + 4)
        if i < n and moves[i] == 0:
            slides = ints[PLAN_HEADER + i] == SLIDE
            append_motion(shift, h, o, slides, theta[i], math.cos(theta[i]), math.sin(theta[i]))
            continue
        for k in range(6):
            if ints[ORDER + k] == i:
                kinds[k] = ints[PLAN_HEADER + i]
                write_vector(six, LINE_STRIDE * k, rotate_vector(shift, h))
                write_vector(six, LINE_STRIDE * k + 4, transform_point(shift, o))
    # goal A^-1: its rotation R A_R^T, and what is left of its translation
    p = read_translation(goal)
    for i in range(3):
        row = read_vector(goal, 4 * i)
        for j in range(3):
            goal[4 * i + j] = dot(row, read_vector(shift, 4 * j))
    p = subtract_vectors(p, rotate_vector(goal, read_translation(shift)))
    goal[3] = p[0]
    goal[7] = p[1]
    goal[11] = p[2]


@device
def rank_solution(row):
    """Return 0 for a solution that is certainly isolated, 1 for one that may lie on a curve of
    solutions, 2 for a sample of a curve.
    """
    if row[TURNS] == 0.0:
        return 2
    return 1 if row[WEAKEST] < MERGED else 0


@routine
def write_solutions(found, floats, joints, count, near, out, slots, placed):
    """Write each solution to the row of its slot where that is free, else to the first free row;
    return the number of rows.
    """
    m = found.model
    stride = SOLUTION + found.model.n
    width = found.model.n + INFO
    for k in range(slots):
        placed[k] = 0
        for i in range(m.n):
            out[width * k + i] = math.nan
        out[width * k + m.n + CODE] = UNUSED
    written = 0
    for rank in range(
        3
        # what may lie on a curve of solutions comes after the isolated ones, as far as there is
        # room
    ):
        for k in range(count):
            row = advance_pointer(found.rows, stride * k)
            sampled = int(rank == 2)
            if rank_solution(row) != rank or written == slots:
                continue
            at = int(row[SIGNS]) if sampled == 0 else 0
            if at < 0 or at >= slots:
                at = 0
            while placed[at] != 0:
                at = (at + 1) % slots
            placed[at] = 1
            q = advance_pointer(out, width * at)
            inside = write_coordinates(found, joints, row, near, q)
            code = MULTIPLICITY_UNIT * row[TURNS] + SLOT_UNIT * (
                max(row[SIGNS] + 1.0, 0.0) if sampled == 0 else 0.0
            )
            code += (INSIDE_BIT if inside else 0.0) + (WEAK_BIT if row[WEAKEST] < WEAK else 0.0)
            q[m.n + ERROR_AT] = math.hypot(row[ERROR] * floats[LENGTH], row[ERROR + 1])
            q[m.n + CODE] = code
            written += 1
    return written


class TargetScratch(NamedTuple):
    """Pointers to the plan, the scratch and the results of the work on one target after the other."""

    ints: object
    floats: object
    moves: object
    joints: object
    goal: object
    shift: object
    six: object
    theta: object
    fixed: object
    candidates: object
    kinds: object
    placed: object
    found: FoundSolutions
    n: int


@device
def count_target_scratch(n):
    """Return the number of floats of scratch that a target needs."""
    return (
        CANDIDATE * MOST_CANDIDATES
        + (SOLUTION + n) * (MOST_SOLUTIONS + 1)
        + count_model_scratch(n)
        + 2 * n
        + 96
    )


@device
def make_target_scratch(ints, floats, block, flags, tol_linear, tol_angular):
    """Divide a block of `count_target_scratch` floats and 6 + SLOTS flags into the scratch of one
    target.
    """
    n = ints[N_JOINTS]
    goal = block
    stride = SOLUTION + n
    theta = advance_pointer(goal, 96)
    fixed = advance_pointer(goal, 96 + n)
    candidates = advance_pointer(fixed, n)
    rows = advance_pointer(candidates, CANDIDATE * MOST_CANDIDATES)
    moves = advance_pointer(ints, PLAN_HEADER + ints[N_LINES])
    joints = advance_pointer(floats, LINES + LINE_STRIDE * ints[N_LINES])
    model = Model(
        advance_pointer(ints, PLAN_HEADER),
        advance_pointer(floats, LINES),
        moves,
        advance_pointer(floats, TIP),
        advance_pointer(floats, TASK),
        advance_pointer(goal, 12),
        advance_pointer(rows, stride * (MOST_SOLUTIONS + 1)),
        n,
    )
    found = FoundSolutions(model, rows, tol_linear / floats[LENGTH], tol_angular)
    return TargetScratch(
        ints,
        floats,
        moves,
        joints,
        goal,
        advance_pointer(goal, 24),
        advance_pointer(goal, 36),
        theta,
        fixed,
        candidates,
        flags,
        advance_pointer(flags, 6),
        found,
        n,
    )


@routine
def begin_target(d, target, near, locked):
    """Prepare goal and lines of a target; return whether it is a valid pose."""
    sound = read_target(target, 0, d.floats, d.found.model.target)
    for j in range(d.n):
        at = JOINT_FLOATS * j
        d.fixed[j] = (
            d.joints[at + FACTOR] * locked[j] + d.joints[at + OFFSET] if d.moves[j] == 0 else 0.0
        )
        sound = sound and abs(d.fixed[j]) < 1e15 and abs(near[j]) < 1e15
    if sound:
        write_goal(d.found.model.target, d.found.model.tip, d.goal)
        write_six_lines(d.ints, d.floats, d.moves, d.fixed, d.goal, d.shift, d.six, d.kinds)
    return sound


@routine
def finish_target(d, count, near, out, slots, sort):
    """Write the answer of a target; return the number of rows."""
    count = unite_solutions(d.found, count)
    for i in range(6):
        if (
            d.ints[ROLES + i] != JOINT
        ):  # lines that stand for no joint have double zeros, or two ways, of their own
            for k in range(count):
                row = advance_pointer(d.found.rows, (SOLUTION + d.n) * k)
                row[TURNS] = min(row[TURNS], 2.0)
    written = write_solutions(d.found, d.floats, d.joints, count, near, out, slots, d.placed)
    if sort != 0:
        sort_rows(d.n, d.joints, near, out, slots)
    return written


@routine
def add_candidates(d, order, first, last, kind, count):
    """Add the solutions of candidates `first` to `last` - 1; return their new number. `kind`: as in
    `merging.add_solution`.
    """
    for k in range(first, last):
        row = advance_pointer(d.candidates, CANDIDATE * k)
        for i in range(d.n):
            d.theta[i] = d.fixed[i]
        sound = True
        sampled = row[SAMPLE] > REPEATED
        of = kind
        if sampled:
            of = SAMPLED if row[SAMPLE] == 1.0 else OPENED
        elif row[SAMPLE] == REPEATED:
            of = AGAIN
        for i in range(6):
            j = order[i]
            if j < d.n:
                d.theta[j] = row[i]
            elif d.ints[ROLES + i] == REST and not sampled:
                sound = sound and abs(row[i]) <= OFF_ZERO
            sound = sound and abs(row[i]) < 1e15
        if sound:
            count = add_solution(d.found, count, d.theta, row[CANDIDATE_SLOT], of)
    return count
