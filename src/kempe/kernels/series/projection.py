"""Equations of ties with their Jacobian, and the projection of configurations onto their solution
set.

Equations and packed arrays are those of `jet`; Jacobian columns of rows follow from the axes of the
rows (geometric Jacobian), so one configuration costs one sweep. Only what moves B against A counts:
of a particle, ties hold neither its orientation nor anything in its axes.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import kernel, routine
from kempe.kernels.base.declare import FLOAT, INT, OUT, F, I
from kempe.kernels.base.linear import factor_matrix, substitute_back
from kempe.kernels.base.rotations import turn_quaternion
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.constraints.loop_layout import (
    ALIGN,
    ANGLE,
    COORDINATE,
    CROSS,
    DISTANCE,
    FULL,
    INPUT_INTS,
    LINEAR,
    NO_TURN,
    TAPE,
    TAPE_FLOATS,
    TAPE_INPUTS,
    TAPE_INTS,
    TAPE_WORK,
)
from kempe.kernels.constraints.tape_evaluation import write_gradient
from kempe.kernels.constraints.tape_layout import N_INPUTS, N_NODES
from kempe.kernels.forward.table_layout import (
    HEADER,
    KIND,
    MULTIPLIER,
    N_OUT,
    N_ROWS,
    OUTPUT_INTS,
    PARENT,
    ROW_FLOATS,
    ROW_INTS,
    SLIDE,
    TURN,
    V_INDEX,
)
from kempe.kernels.series.jet import (
    compute_relative_entry,
    sweep_order,
    write_output_order,
    write_violation_order,
)
from kempe.kernels.series.jet_layout import (
    AFTER,
    BEFORE,
    DATA,
    ENTRIES,
    ENTRY,
    FIRST_ROW,
    MASK,
    POSE_SIZE,
    POWERS,
    ROWS,
    TIE_INTS,
    TURNS,
)

DAMPING_LEAST = 1e-14
DAMPING_FIRST = 1e-4
DAMPING_MOST = 1e4
"""Levenberg-Marquardt damping, as a part of the mean square of the Jacobian's columns."""
STUCK = 0.98
"""Part of the squared residual that an undamped step leaves where it is no use to go on."""
ENOUGH2 = 1e-32
SHORTEST = 1e-14
"""Square of the residual, and length of a step, from which more iterations change nothing."""


@routine
def _add_column(ties, numbers, tie, frames, M, rates, x, y, z, px, py, pz, J, b, column):
    """Add the rates of the equations of a tie under a unit velocity: B turns by (x, y, z) and moves
    by (px, py, pz).

    M: the nine entries of R_AB; rates: for each row of a TAPE tie what the twist of B against A, in
    axes of A, does.
    """
    t = 1 + TIE_INTS * tie
    a = 2 * tie
    mask = ties[t + MASK]
    turns = ties[t + TURNS]
    row = ties[t + FIRST_ROW]
    if turns == DISTANCE:
        total = 0.0
        total += px * (frames[0, a + 1, 0, 9] - frames[0, a, 0, 9])
        total += py * (frames[0, a + 1, 0, 10] - frames[0, a, 0, 10])
        total += pz * (frames[0, a + 1, 0, 11] - frames[0, a, 0, 11])
        J[b, row, column] += total * numbers[0] / numbers[1 + tie]
        return
    if turns == TAPE:
        for o in range(ties[t + ROWS]):
            for i in range(3):
                d = (
                    frames[0, a, 0, i] * px
                    + frames[0, a, 0, 3 + i] * py
                    + frames[0, a, 0, 6 + i] * pz
                )
                w = frames[0, a, 0, i] * x + frames[0, a, 0, 3 + i] * y + frames[0, a, 0, 6 + i] * z
                J[b, row + o, column] += rates[6 * o + i] * d + rates[6 * o + 3 + i] * w
        return
    for i in range(3):
        if mask >> i & 1:
            d = frames[0, a, 0, i] * px + frames[0, a, 0, 3 + i] * py + frames[0, a, 0, 6 + i] * pz
            J[b, row, column] += numbers[0] * d
            row += 1
    if turns == NO_TURN:
        return
    wx = frames[0, a, 0, 0] * x + frames[0, a, 0, 3] * y + frames[0, a, 0, 6] * z
    wy = frames[0, a, 0, 1] * x + frames[0, a, 0, 4] * y + frames[0, a, 0, 7] * z
    wz = frames[0, a, 0, 2] * x + frames[0, a, 0, 5] * y + frames[0, a, 0, 8] * z
    # dR_AB = [w] R_AB, and [w] X + X^T [w] = [(tr X - X) w]
    if turns == FULL:
        J[b, row, column] += 0.5 * ((M[4] + M[8]) * wx - M[1] * wy - M[2] * wz)
        J[b, row + 1, column] += 0.5 * ((M[0] + M[8]) * wy - M[3] * wx - M[5] * wz)
        row += 2
    if turns == FULL or turns == ANGLE:
        J[b, row, column] += 0.5 * ((M[0] + M[4]) * wz - M[6] * wx - M[7] * wy)
    if turns == ALIGN:
        J[b, row, column] -= wz * M[2] - wx * M[8]
        J[b, row + 1, column] += wy * M[8] - wz * M[5]
    if turns == CROSS:
        J[b, row, column] += wy * M[7] - wz * M[4]


@routine
def _add_columns(ints, floats, ties, numbers, tie, poses, frames, M, rates, row, sign, J, b):
    """Add the columns of one row of the table, which moves B against A in the direction `sign`."""
    h = HEADER + ROW_INTS * row
    f = ROW_FLOATS * row
    kind = ints[h + KIND]
    iv = ints[h + V_INDEX]
    multiplier = floats[f + MULTIPLIER]
    o = 2 * tie + 1
    dx = frames[0, o, 0, 9] - poses[0, row, 0, AFTER + 9]
    dy = frames[0, o, 0, 10] - poses[0, row, 0, AFTER + 10]
    dz = frames[0, o, 0, 11] - poses[0, row, 0, AFTER + 11]
    for i in range(3):
        column = iv
        at = AFTER + 2
        factor = sign * multiplier
        if kind != TURN and kind != SLIDE:
            column = iv + i
            at = (AFTER if multiplier > 0.0 else BEFORE) + i
            factor = sign * multiplier
        elif i > 0:
            break
        x = factor * poses[0, row, 0, at]
        y = factor * poses[0, row, 0, at + 3]
        z = factor * poses[0, row, 0, at + 6]
        px = y * dz - z * dy
        py = z * dx - x * dz
        pz = x * dy - y * dx
        if kind == SLIDE:
            px = x
            py = y
            pz = z
            x = 0.0
            y = 0.0
            z = 0.0
        _add_column(ties, numbers, tie, frames, M, rates, x, y, z, px, py, pz, J, b, column)


@routine
def _write_rates(ties, numbers, tie, M, work, rates, J, b):
    """Write the rates of the equations of a TAPE tie under the twist; add the rates by coordinates
    to J[b].

    `work` holds the values of all nodes, M the entries of R_AB.
    """
    t = 1 + TIE_INTS * tie
    data = ties[t + DATA]
    unit = numbers[1 + tie]
    tape = ties[data + TAPE_INTS]
    adjoint = advance_pointer(work, ties[tape + N_NODES])
    for o in range(ties[t + ROWS]):
        write_gradient(ties, tape, numbers, ties[data + TAPE_FLOATS], o, work, adjoint)
        for i in range(6):
            rates[6 * o + i] = 0.0
        for i in range(ties[tape + N_INPUTS]):
            at = data + TAPE_INPUTS + INPUT_INTS * i
            what = ties[at]
            g = unit * adjoint[i]
            if what < 3:
                rates[6 * o + what] += g
            elif what < COORDINATE:  # the rate of column c of R is w x c
                i0 = (what - 3) // 3
                j = (what - 3) % 3
                i1 = (i0 + 1) % 3
                i2 = (i0 + 2) % 3
                rates[6 * o + 3 + i1] += g * M[3 * i2 + j]
                rates[6 * o + 3 + i2] -= g * M[3 * i1 + j]
            else:
                J[b, ties[t + FIRST_ROW] + o, ties[at + 2]] += g


@routine
def _linearise_equations(
    ints, floats, tied, q, start, v, poses, extra, frames, value, M, rates, J, b
):
    """Write the equations at q[start:] to value[0, 0] and their Jacobian to J[b].

    tied: the ties, their numbers and room for their tapes.
    """
    ties, numbers, work = tied
    n = ints[N_ROWS]
    count = ties[0]
    sweep_order(ints, floats, q, start, v, 0, 0, poses, extra)
    write_output_order(ints, floats, 0, 0, poses, frames)
    write_violation_order(ties, numbers, q, start, v, 0, 0, frames, work, 1, value)
    for i in range(J.shape[1]):
        for j in range(J.shape[2]):
            J[b, i, j] = 0.0
    for tie in range(count):
        t = 1 + TIE_INTS * tie
        if ties[t + TURNS] == LINEAR:
            for e in range(ties[t + ENTRY], ties[t + ENTRY] + ties[t + ENTRIES]):
                J[b, ties[t + FIRST_ROW], ties[1 + TIE_INTS * count + 2 * e + 1]] += numbers[
                    1 + count + e
                ]
            continue
        h = HEADER + ROW_INTS * n + OUTPUT_INTS * 2 * tie
        left = ints[h]
        right = ints[h + OUTPUT_INTS]
        for i in range(9):
            M[i] = compute_relative_entry(frames, 0, 2 * tie, 0, i // 3, i % 3)
        if ties[t + TURNS] == TAPE:
            _write_rates(
                ties,
                numbers,
                tie,
                M,
                advance_pointer(work, ties[ties[t + DATA] + TAPE_WORK]),
                rates,
                J,
                b,
            )
        while (
            left != right
        ):  # a parent comes before its child: the common part of both ways is reached together
            row, sign = (left, -1.0) if left > right else (right, 1.0)
            _add_columns(ints, floats, ties, numbers, tie, poses, frames, M, rates, row, sign, J, b)
            above = ints[HEADER + ROW_INTS * row + PARENT]
            if left > right:
                left = above
            else:
                right = above


@routine
def _count_tape_numbers(ties):
    """Return the number of floats that the tapes of all ties need."""
    size = 0
    for tie in range(ties[0]):
        data = ties[1 + TIE_INTS * tie + DATA]
        if ties[1 + TIE_INTS * tie + TURNS] == TAPE:
            size = max(size, ties[data + TAPE_WORK] + 3 * ties[ties[data + TAPE_INTS] + N_NODES])
    return size


@routine
def _compute_squared_distance(places, scale, center, q, start, x):
    """Return the square of the scaled distance of q[start:] from `center`; write the tangent vector
    between them to x.

    places: for each velocity coordinate its place in q, -1 - place for the first of a ball, -1e9
    for its others.
    """
    total = 0.0
    j = 0
    while j < places.shape[0]:
        i = places[j]
        if i >= 0:
            x[j] = (q[start + i] - center[i]) / scale[j]
            total += x[j] * x[j]
            j += 1
            continue
        i = -1 - i
        a0 = center[i]
        a1 = center[i + 1]
        a2 = center[i + 2]
        a3 = center[i + 3]
        b0 = q[start + i]
        b1 = q[start + i + 1]
        b2 = q[start + i + 2]
        b3 = q[start + i + 3]
        w = a0 * b0 + a1 * b1 + a2 * b2 + a3 * b3
        u = a0 * b1 - a1 * b0 - a2 * b3 + a3 * b2
        v = a0 * b2 - a2 * b0 - a3 * b1 + a1 * b3
        z = a0 * b3 - a3 * b0 - a1 * b2 + a2 * b1
        sine = math.sqrt(u * u + v * v + z * z)
        f = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, abs(w)) / sine
        if w < 0.0:
            f = -f
        x[j] = f * u
        x[j + 1] = f * v
        x[j + 2] = f * z
        total += x[j] * x[j] + x[j + 1] * x[j + 1] + x[j + 2] * x[j + 2]
        j += 3
    return total


@routine
def _move_configuration(places, scale, q, start, x, target, at):
    """Write the configuration reached from q[start:] by the scaled step x to target[at:]."""
    j = 0
    while j < places.shape[0]:
        i = places[j]
        if i >= 0:
            target[at + i] = q[start + i] + scale[j] * x[j]
            j += 1
            continue
        i = -1 - i
        for k in range(i, i + 4):
            target[at + k] = q[start + k]
        turn_quaternion(target, at + i, x[j], x[j + 1], x[j + 2])
        j += 3


@routine
def _write_normal_equations(J, b, scale, value, x, radius, distance2, A, g, damping):
    """Write J^T J + damping and -J^T residual, with the equation of the sphere where radius > 0."""
    m = J.shape[1]
    n = J.shape[2]
    for i in range(n):
        s = 0.0
        for r in range(m):
            s -= J[b, r, i] * value[0, 0, r]
        g[i] = s * scale[i]
        for j in range(i + 1):
            s = 0.0
            for r in range(m):
                s += J[b, r, i] * J[b, r, j]
            A[i * n + j] = s * scale[i] * scale[j]
    if radius > 0.0:
        error = 0.5 * (distance2 - radius * radius) / radius
        for i in range(n):
            g[i] -= x[i] / radius * error
            for j in range(i + 1):
                A[i * n + j] += x[i] * x[j] / (radius * radius)
    trace = 0.0
    for i in range(n):
        trace += A[i * n + i]
    for i in range(n):
        A[i * n + i] += damping * trace / n + 1e-300


@routine
def _square_residual(value, m, radius, distance2):
    """Return the square of the residual, with the equation of the sphere."""
    total = 0.0
    for i in range(m):
        total += value[0, 0, i] * value[0, 0, i]
    if radius > 0.0:
        error = 0.5 * (distance2 - radius * radius) / radius
        total += error * error
    return total


@kernel(
    I("_"),
    F("_"),
    I("_"),
    F("_"),
    I("_"),
    F("_"),
    F("N", "nq"),
    OUT("N", "nq"),
    F("N"),
    INT,
    FLOAT,
    OUT("N", 3),
    OUT("N", "m"),
    OUT("N", "m", "_"),
    returns=False,
)
def project_configurations(
    ints,
    floats,
    ties,
    numbers,
    places,
    scale,
    centers,
    q,
    radius,
    iterations,
    longest,
    info,
    out,
    J,
):
    """Move each configuration of q (N, nq), in place, onto the solution set of the equations.

    Where radius[i] > 0 the point found is, if one is found, also at that distance from centers[i],
    in scaled tangent coordinates (places and scale as in `_compute_squared_distance`). Damped least
    squares (Levenberg, 1944; Marquardt, 1963) with steps no longer than `longest`. info (N, 3):
    residual of
    the equations (norm), distance from the center, iterations. out (N, m): the equations where it
    ends, J (N, m, nv): their Jacobian; with 0 iterations, those where it is.
    """
    m = J.shape[1]
    nv = J.shape[2]
    nq = q.shape[1]
    n = max(ints[N_ROWS], 1)
    v = np.zeros((1, 1, nv + 1))
    value = np.zeros((1, 1, m + 1))
    poses = np.zeros((1, n, 1, POSE_SIZE))
    extra = np.zeros((1, n, 1, POWERS + 1))
    frames = np.zeros((1, max(ints[N_OUT], 1), 1, 12))
    A = np.zeros(nv * nv)
    g = np.zeros(nv)
    x = np.zeros(nv)
    trial = np.zeros(nq)
    step = np.zeros(nv)
    M = np.zeros(9)
    work = np.zeros(_count_tape_numbers(ties) + 1)
    rates = np.zeros(6 * m + 1)
    tied = get_pointer(ties), get_pointer(numbers), get_pointer(work)
    A_ = get_pointer(A)
    g_ = get_pointer(g)
    q_ = get_pointer(q)
    trial_ = get_pointer(trial)
    for b in range(q.shape[0]):
        center = centers[b]
        damping = DAMPING_FIRST
        count = 0
        fresh = False
        size2 = np.inf
        distance2 = 0.0
        while True:
            if not fresh:
                _linearise_equations(
                    ints, floats, tied, q_, b * nq, v, poses, extra, frames, value, M, rates, J, b
                )
                distance2 = _compute_squared_distance(places, scale, center, q_, b * nq, x)
                size2 = _square_residual(value, m, radius[b], distance2)
                fresh = True
            if count >= iterations or not size2 > ENOUGH2 or damping > DAMPING_MOST:
                break
            count += 1
            _write_normal_equations(
                J, b, scale, value, x, radius[b], distance2, A, g, max(damping, DAMPING_LEAST)
            )
            if not factor_matrix(A_, nv):
                damping = max(10.0 * damping, DAMPING_LEAST)
                continue
            substitute_back(A_, nv, g_)
            length = 1e-300
            for j in range(nv):
                length += g[j] * g[j]
            length = math.sqrt(length)
            for j in range(nv):
                step[j] = g[j] * min(1.0, longest / length)
            _move_configuration(places, scale, q_, b * nq, step, trial_, 0)
            _linearise_equations(
                ints, floats, tied, trial_, 0, v, poses, extra, frames, value, M, rates, J, b
            )
            distance2 = _compute_squared_distance(places, scale, center, trial_, 0, x)
            new_size2 = _square_residual(value, m, radius[b], distance2)
            fresh = new_size2 < size2
            if fresh:
                for j in range(nq):
                    q[b, j] = trial[j]
                stuck = damping <= DAMPING_LEAST and new_size2 > STUCK * size2
                size2 = new_size2
                damping = max(0.02 * damping, DAMPING_LEAST)
            else:
                stuck = False
                damping = max(30.0 * damping, 1e-12)
            if length < SHORTEST or stuck:
                count = iterations
        for i in range(m):
            out[b, i] = value[0, 0, i]
        info[b, 0] = math.sqrt(_square_residual(value, m, 0.0, 0.0))
        info[b, 1] = math.sqrt(distance2)
        info[b, 2] = float(count)
    keep_alive(A)
    keep_alive(g)
    keep_alive(trial)
    keep_alive(work)
