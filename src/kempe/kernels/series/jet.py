"""Truncated Taylor series (jets) of poses through a primitive table, and of the errors of ties
between frames.

Along a curve q(t) = q0 (+) v(t), v(t) = v_1 t + v_2 t^2 + ..., every entry of every pose is a power
series in t. Sums and products of series are exact up to the order kept, sine and cosine of a series
follow from their differential equation (Moore, 1966; Griewank, Walther, 2008, section 13.2), and a
ball turns by R(w) = I + A [w] + B [w]^2 (Rodrigues, 1840), A and B being power series in |w|^2.
Orders are computed one after the other, so a caller can choose v_k after it has seen what v_1 ...
v_(k-1) lead to.

Ties, packed in `ties` (int64) and `numbers` (float64), as `loop_layout` names what they hold of
frame B in frame A:

    ties     count; then for each: MASK, TURNS, ROWS, FIRST_ROW, ENTRIES, ENTRY, DATA; then entries: place in q, in v;
             then what TAPE ties read, and their tapes
    numbers  1/length; then a number for each tie; then a factor for each entry

Equations are algebraic in the poses: coordinates of the origin of B in A over the length, and for
orientations the vector of the skew part of R_AB, which vanishes near R_AB = 1 only there. A
distance gives (d.d - l^2) / (2 l length).
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import kernel, routine
from kempe.kernels.base.declare import INT, OUT, F, I
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import get_pointer
from kempe.kernels.constraints.loop_layout import (
    ALIGN,
    ANGLE,
    COORDINATE,
    CROSS,
    DISTANCE,
    FULL,
    INPUT_INTS,
    LINEAR,
    TAPE,
    TAPE_FLOATS,
    TAPE_INPUTS,
    TAPE_INTS,
    TAPE_WORK,
)
from kempe.kernels.constraints.tape_evaluation import write_tape_order
from kempe.kernels.constraints.tape_layout import N_INPUTS, TAPE_HEAD
from kempe.kernels.forward.table_layout import (
    COS_OFFSET,
    HEADER,
    KIND,
    MULTIPLIER,
    N_OUT,
    N_ROWS,
    OUTPUT_FLOATS,
    OUTPUT_INTS,
    PARENT,
    PARTICLE,
    Q_INDEX,
    ROW,
    ROW_FLOATS,
    ROW_INTS,
    SIN_OFFSET,
    SLIDE,
    TURN,
    V_INDEX,
)
from kempe.kernels.forward.table_rows import make_rotation, read_unit_quaternion
from kempe.kernels.series.jet_layout import (
    AFTER,
    BEFORE,
    DATA,
    ENTRIES,
    ENTRY,
    FIRST_ROW,
    MASK,
    OUTER,
    POSE_SIZE,
    POWERS,
    ROWS,
    TIE_INTS,
    TURNED,
    TURNS,
    WEIGHT_1,
    WEIGHT_2,
)


@routine
def _multiply_constant(source, b, r, k, at, target, s, to, floats, f):
    """Write pose (source[b, r, k, at:]) @ X to target[b, s, k, to:], X the 3x4 placement at
    floats[f:].
    """
    for i in range(3):
        x = source[b, r, k, at + 3 * i]
        y = source[b, r, k, at + 3 * i + 1]
        z = source[b, r, k, at + 3 * i + 2]
        for j in range(3):
            target[b, s, k, to + 3 * i + j] = (
                x * floats[f + j] + y * floats[f + 4 + j] + z * floats[f + 8 + j]
            )
        p = x * floats[f + 3] + y * floats[f + 7] + z * floats[f + 11]
        target[b, s, k, to + 9 + i] = p + source[b, r, k, at + 9 + i]


@routine
def _write_constant(target, b, s, k, to, floats, f):
    """Write the placement at floats[f:] to target[b, s, k, to:] as a constant series."""
    for i in range(3):
        for j in range(3):
            target[b, s, k, to + 3 * i + j] = floats[f + 4 * i + j] if k == 0 else 0.0
        target[b, s, k, to + 9 + i] = floats[f + 4 * i + 3] if k == 0 else 0.0


@routine
def _write_turn_order(v, b, r, k, iv, multiplier, poses, extra):
    """Write coefficient k of a turn about z; coefficients 0 of sine and cosine are known."""
    if k > 0:
        s = 0.0
        c = 0.0
        for j in range(1, k + 1):
            d = j * multiplier * v[b, j, iv]
            s += d * extra[b, r, k - j, 1]
            c -= d * extra[b, r, k - j, 0]
        extra[b, r, k, 0], extra[b, r, k, 1] = s / k, c / k
    for i in range(3):
        x = 0.0
        y = 0.0
        for j in range(k + 1):
            s = extra[b, r, j, 0]
            c = extra[b, r, j, 1]
            x0 = poses[b, r, k - j, BEFORE + 3 * i]
            y0 = poses[b, r, k - j, BEFORE + 3 * i + 1]
            x += c * x0 + s * y0
            y += c * y0 - s * x0
        poses[b, r, k, AFTER + 3 * i] = x
        poses[b, r, k, AFTER + 3 * i + 1] = y
        poses[b, r, k, AFTER + 3 * i + 2] = poses[b, r, k, BEFORE + 3 * i + 2]
        poses[b, r, k, AFTER + 9 + i] = poses[b, r, k, BEFORE + 9 + i]


@routine
def _write_slide_order(v, b, r, k, iv, multiplier, start, poses):
    """Write coefficient k of a slide along z, of length `start` at coefficient 0."""
    for i in range(9):
        poses[b, r, k, AFTER + i] = poses[b, r, k, BEFORE + i]
    for i in range(3):
        p = poses[b, r, k, BEFORE + 9 + i] + start * poses[b, r, k, BEFORE + 3 * i + 2]
        for j in range(1, k + 1):
            p += multiplier * v[b, j, iv] * poses[b, r, k - j, BEFORE + 3 * i + 2]
        poses[b, r, k, AFTER + 9 + i] = p


@routine
def _write_rotation_order(v, b, r, k, iv, extra):
    """Write coefficient k of the rotation by the vector w(t) = v[b, :, iv : iv + 3], w(0) = 0."""
    for i in range(6):
        extra[b, r, k, OUTER + i] = 0.0
    for j in range(1, k):
        x = v[b, j, iv]
        y = v[b, j, iv + 1]
        z = v[b, j, iv + 2]
        a = v[b, k - j, iv]
        d = v[b, k - j, iv + 1]
        e = v[b, k - j, iv + 2]
        extra[b, r, k, OUTER] += x * a
        extra[b, r, k, OUTER + 1] += y * d
        extra[b, r, k, OUTER + 2] += z * e
        extra[b, r, k, OUTER + 3] += x * d
        extra[b, r, k, OUTER + 4] += x * e
        extra[b, r, k, OUTER + 5] += y * e
    square = extra[b, r, k, OUTER] + extra[b, r, k, OUTER + 1] + extra[b, r, k, OUTER + 2]
    extra[b, r, k, POWERS] = square
    one, two = (1.0, 0.5) if k == 0 else (0.0, 0.0)
    factor = 1.0
    for n in range(1, k // 2 + 1):  # w.w begins at order 2, its nth power at order 2n
        if n > 1:
            power = 0.0
            for j in range(2, k + 1):
                if k - j >= 2 * (n - 1):
                    power += extra[b, r, j, POWERS] * extra[b, r, k - j, POWERS + n - 2]
            extra[b, r, k, POWERS + n - 1] = power
        factor = -factor / (2 * n * (2 * n + 1))
        one += factor * extra[b, r, k, POWERS + n - 1]
        two += factor / (2 * n + 2) * extra[b, r, k, POWERS + n - 1]
    extra[b, r, k, WEIGHT_1] = one
    extra[b, r, k, WEIGHT_2] = two
    for i in range(9):
        extra[b, r, k, TURNED + i] = 1.0 if k == 0 and i % 4 == 0 else 0.0
    for j in range(1, k + 1):
        a = extra[b, r, k - j, WEIGHT_1]
        d = extra[b, r, k - j, WEIGHT_2]
        x = v[b, j, iv]
        y = v[b, j, iv + 1]
        z = v[b, j, iv + 2]
        o = OUTER
        xx = extra[b, r, j, o]
        yy = extra[b, r, j, o + 1]
        zz = extra[b, r, j, o + 2]
        xy = extra[b, r, j, o + 3]
        xz = extra[b, r, j, o + 4]
        yz = extra[b, r, j, o + 5]
        extra[b, r, k, 0] -= d * (yy + zz)
        extra[b, r, k, 4] -= d * (xx + zz)
        extra[b, r, k, 8] -= d * (xx + yy)
        extra[b, r, k, 1] += d * xy - a * z
        extra[b, r, k, 3] += d * xy + a * z
        extra[b, r, k, 2] += d * xz + a * y
        extra[b, r, k, 6] += d * xz - a * y
        extra[b, r, k, 5] += d * yz - a * x
        extra[b, r, k, 7] += d * yz + a * x


@routine
def _write_ball_order(v, b, r, k, iv, multiplier, turn, poses, extra):
    """Write coefficient k of a ball joint whose rotation at coefficient 0 is `turn` (the inverse
    for a reversed joint).
    """
    _write_rotation_order(v, b, r, k, iv, extra)
    forward = multiplier > 0.0
    for i in range(3):
        poses[b, r, k, AFTER + 9 + i] = poses[b, r, k, BEFORE + 9 + i]
        x = poses[b, r, k, BEFORE + 3 * i]
        y = poses[b, r, k, BEFORE + 3 * i + 1]
        z = poses[b, r, k, BEFORE + 3 * i + 2]
        if forward:  # the constant turn comes first
            for j in range(3):
                poses[b, r, k, BEFORE + 3 * i + j] = x * turn[j] + y * turn[3 + j] + z * turn[6 + j]
    for i in range(3):
        a0 = 0.0
        a1 = 0.0
        a2 = 0.0
        for j in range(k + 1):
            m = k - j
            o = BEFORE + 3 * i
            x = poses[b, r, j, o]
            y = poses[b, r, j, o + 1]
            z = poses[b, r, j, o + 2]
            if forward:
                a0 += x * extra[b, r, m, 0] + y * extra[b, r, m, 3] + z * extra[b, r, m, 6]
                a1 += x * extra[b, r, m, 1] + y * extra[b, r, m, 4] + z * extra[b, r, m, 7]
                a2 += x * extra[b, r, m, 2] + y * extra[b, r, m, 5] + z * extra[b, r, m, 8]
            else:
                a0 += x * extra[b, r, m, 0] + y * extra[b, r, m, 1] + z * extra[b, r, m, 2]
                a1 += x * extra[b, r, m, 3] + y * extra[b, r, m, 4] + z * extra[b, r, m, 5]
                a2 += x * extra[b, r, m, 6] + y * extra[b, r, m, 7] + z * extra[b, r, m, 8]
        if not forward:  # the constant turn comes last
            a0, a1, a2 = (
                a0 * turn[0] + a1 * turn[3] + a2 * turn[6],
                a0 * turn[1] + a1 * turn[4] + a2 * turn[7],
                a0 * turn[2] + a1 * turn[5] + a2 * turn[8],
            )
        poses[b, r, k, AFTER + 3 * i] = a0
        poses[b, r, k, AFTER + 3 * i + 1] = a1
        poses[b, r, k, AFTER + 3 * i + 2] = a2


@routine
def sweep_order(ints, floats, q, start, v, b, k, poses, extra):
    """Write Taylor coefficient k of the poses of all rows."""
    for r in range(ints[N_ROWS]):
        h = HEADER + ROW_INTS * r
        f = ROW_FLOATS * r
        kind = ints[h + KIND]
        parent = ints[h + PARENT]
        iv = ints[h + V_INDEX]
        multiplier = floats[f + MULTIPLIER]
        at = start + ints[h + Q_INDEX]
        if parent < 0:
            _write_constant(poses, b, r, k, BEFORE, floats, f)
        else:
            _multiply_constant(poses, b, parent, k, AFTER, poses, r, BEFORE, floats, f)
        if kind == TURN:
            if k == 0:
                theta = multiplier * q[at]
                s = math.sin(theta)
                c = math.cos(theta)
                extra[b, r, 0, 0] = s * floats[f + COS_OFFSET] + c * floats[f + SIN_OFFSET]
                extra[b, r, 0, 1] = c * floats[f + COS_OFFSET] - s * floats[f + SIN_OFFSET]
            _write_turn_order(v, b, r, k, iv, multiplier, poses, extra)
        elif kind == SLIDE:
            _write_slide_order(v, b, r, k, iv, multiplier, multiplier * q[at], poses)
        else:
            w, x, y, z = read_unit_quaternion(q, at, multiplier)
            _write_ball_order(v, b, r, k, iv, multiplier, make_rotation(w, x, y, z), poses, extra)


@routine
def write_output_order(ints, floats, b, k, poses, frames):
    """Write Taylor coefficient k of the poses of all outputs, from those of the rows."""
    n = ints[N_ROWS]
    for i in range(ints[N_OUT]):
        h = HEADER + ROW_INTS * n + OUTPUT_INTS * i
        f = ROW_FLOATS * n + OUTPUT_FLOATS * i
        row = ints[h + ROW]
        if row < 0:
            _write_constant(frames, b, i, k, 0, floats, f)
        else:
            _multiply_constant(poses, b, row, k, AFTER, frames, i, 0, floats, f)
        if ints[h + PARTICLE] != 0:  # a particle does not turn
            for j in range(9):
                frames[b, i, k, j] = 1.0 if k == 0 and j % 4 == 0 else 0.0


@routine
def compute_relative_entry(frames, b, a, k, i, j):
    """Return coefficient k of the entry (i, j) of R_AB, A being output a and B the next one."""
    total = 0.0
    for m in range(k + 1):
        for row in range(0, 9, 3):
            total += frames[b, a, m, row + i] * frames[b, a + 1, k - m, row + j]
    return total


@routine
def _compute_linear_order(ties, numbers, q, start, v, b, k, tie):
    """Return coefficient k of a linear relation of coordinates."""
    n = ties[0]
    t = 1 + TIE_INTS * tie
    total = -numbers[1 + tie] if k == 0 else 0.0
    for e in range(ties[t + ENTRY], ties[t + ENTRY] + ties[t + ENTRIES]):
        at = 1 + TIE_INTS * n + 2 * e
        total += numbers[1 + n + e] * (q[start + ties[at]] if k == 0 else v[b, k, ties[at + 1]])
    return total


@routine
def compute_origin_order(frames, b, a, k, i):
    """Return coefficient k of the coordinate i of the origin of B in A."""
    total = 0.0
    for j in range(k + 1):
        for c in range(3):
            d = frames[b, a + 1, k - j, 9 + c] - frames[b, a, k - j, 9 + c]
            total += frames[b, a, j, 3 * c + i] * d
    return total


@routine
def _write_tape_order(ties, numbers, q, start, v, b, k, frames, tie, series, width, out):
    """Write coefficient k of the equations of a recorded expression; `series` holds the lower
    coefficients of its nodes.
    """
    t = 1 + TIE_INTS * tie
    a = 2 * tie
    data = ties[t + DATA]
    tape = ties[data + TAPE_INTS]
    work = advance_pointer(series, width * ties[data + TAPE_WORK])
    for i in range(ties[tape + N_INPUTS]):
        at = data + TAPE_INPUTS + INPUT_INTS * i
        what = ties[at]
        if what < 3:
            x = compute_origin_order(frames, b, a, k, what)
        elif what < COORDINATE:
            x = compute_relative_entry(frames, b, a, k, (what - 3) // 3, (what - 3) % 3)
        else:
            x = q[start + ties[at + 1]] if k == 0 else v[b, k, ties[at + 2]]
        work[width * i + k] = x
    write_tape_order(ties, tape, numbers, ties[data + TAPE_FLOATS], k, width, work)
    unit = numbers[1 + tie]
    for o in range(ties[t + ROWS]):
        out[b, k, ties[t + FIRST_ROW] + o] = work[width * ties[tape + TAPE_HEAD + o] + k] * unit


@routine
def write_violation_order(ties, numbers, q, start, v, b, k, frames, series, width, out):
    """Write Taylor coefficient k of the errors of all equations."""
    per_length = numbers[0]
    for tie in range(ties[0]):
        t = 1 + TIE_INTS * tie
        mask = ties[t + MASK]
        turns = ties[t + TURNS]
        row = ties[t + FIRST_ROW]
        a = 2 * tie
        if turns == LINEAR:
            out[b, k, row] = _compute_linear_order(ties, numbers, q, start, v, b, k, tie)
            continue
        if turns == TAPE:
            _write_tape_order(ties, numbers, q, start, v, b, k, frames, tie, series, width, out)
            continue
        if turns == DISTANCE:
            size = numbers[1 + tie]
            total = -size * size if k == 0 else 0.0
            for i in range(9, 12):
                for j in range(k + 1):
                    d = frames[b, a + 1, j, i] - frames[b, a, j, i]
                    total += d * (frames[b, a + 1, k - j, i] - frames[b, a, k - j, i])
            out[b, k, row] = total * 0.5 * per_length / size
            continue
        for i in range(3):
            if mask >> i & 1:
                out[b, k, row] = compute_origin_order(frames, b, a, k, i) * per_length
                row += 1
        if turns == FULL or turns == ANGLE:
            for i in range(0 if turns == FULL else 2, 3):
                g = (i + 1) % 3
                h = (i + 2) % 3
                out[b, k, row] = 0.5 * (
                    compute_relative_entry(frames, b, a, k, h, g)
                    - compute_relative_entry(frames, b, a, k, g, h)
                )
                row += 1
        if turns == ALIGN:
            out[b, k, row] = -compute_relative_entry(frames, b, a, k, 1, 2)
            out[b, k, row + 1] = compute_relative_entry(frames, b, a, k, 0, 2)
        if turns == CROSS:
            out[b, k, row] = compute_relative_entry(frames, b, a, k, 0, 1)


@kernel(
    I("_"),
    F("_"),
    I("_"),
    F("_"),
    F("N", "_"),
    F("N", "k", "_"),
    INT,
    INT,
    OUT("N", "_", "k", POSE_SIZE),
    OUT("N", "_", "k", "_"),
    OUT("N", "_", "k", 12),
    OUT("N", "_", "k"),
    OUT("N", "k", "_"),
    returns=False,
)
def compute_jets(ints, floats, ties, numbers, q, v, first, last, poses, extra, frames, series, out):
    """Write coefficients first ... last of the Taylor series along N curves; lower coefficients are
    known from earlier calls.

    q: where the curves begin (N, nq); v: their series (N, K + 1, nv), v[:, 0] unused. Scratch that
    is kept between calls: poses (N, n_rows, K + 1, 24), extra (N, n_rows, K + 1, scratch_width(K)).
    Of the nodes of all tapes: series (N, n_nodes, K + 1).
    frames: (N, n_out, K + 1, 12), rotations row by row and positions; out: equations (N, K + 1, m).
    """
    q_ = get_pointer(q)
    nq = q.shape[1]
    width = series.shape[2]
    size = series.shape[1] * series.shape[2]
    ties_ = get_pointer(ties)
    numbers_ = get_pointer(numbers)
    series_ = get_pointer(series)
    for b in range(q.shape[0]):
        for k in range(first, last + 1):
            sweep_order(ints, floats, q_, b * nq, v, b, k, poses, extra)
            write_output_order(ints, floats, b, k, poses, frames)
            work = advance_pointer(series_, b * size)
            write_violation_order(ties_, numbers_, q_, b * nq, v, b, k, frames, work, width, out)
