"""All constraint equations at one configuration: of frames (`constraint_rows`), rods, relations,
coordinates, functions, and centres of mass.
"""

from __future__ import annotations

import math

from llvmlite import ir
from numba import types

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import FLOATS, extract_entry, intrinsic
from kempe.kernels.constraints import loop_layout as L
from kempe.kernels.constraints.constraint_rows import (
    add_twist_rates,
    compute_relative_rotation,
    compute_vector_rate,
    fill_block,
    fill_rod_block,
    read_tie_ends,
    rotate_vector_back,
    write_error,
)
from kempe.kernels.constraints.tape_evaluation import evaluate_nodes, write_gradient
from kempe.kernels.constraints.tape_layout import N_INPUTS, N_NODES, TAPE_HEAD
from kempe.kernels.forward.table_layout import HEADER, OUTPUT_FLOATS, PARENT, ROW_INTS
from kempe.kernels.forward.table_rows import read_placement


@intrinsic
def call_address(typingctx, address, q, out, columns, flag):
    """Call the C function void(double*, double*, double*, int64) at an address."""

    def emit_code(context, builder, sig, args):
        kinds = [context.get_value_type(t) for t in sig.args[1:]]
        function = ir.FunctionType(ir.VoidType(), kinds).as_pointer()
        builder.call(builder.inttoptr(args[0], function), args[1:])
        return context.get_dummy_value()

    return types.void(types.int64, FLOATS, FLOATS, FLOATS, types.int64), emit_code


@routine
def is_late(loops, stop, flag, spare):
    """Return whether the work must end, as the function at the address `stop` writes to `flag`;
    address 0 is no function.
    """
    flag[0] = 0.0
    if stop != 0:
        call_address(stop, loops.q, flag, spare, 0)
    return flag[0] != 0.0


@device
def read_given_number(loops, k):
    """Return the given number of tie k: a target or a length."""
    at = loops.plan[loops.plan[L.AT_TIES] + L.TIE_INTS * k + L.NUMBER]
    if at >= 0:
        return loops.pins[12 * loops.plan[L.N_PINS] + at]
    return loops.weights[loops.plan[L.AT_NUMBERS] + k]


@routine
def compute_centre(loops, centre):
    """Return the centre of mass; write the first moment of all that a row moves to scratch[3 *
    row:], where angles were.
    """
    n = loops.n_rows
    w = loops.weights
    s = loops.scratch
    at = loops.plan[L.AT_CENTRES] + (L.CENTRE_FLOATS * n + 3) * centre
    for row in range(n):
        k = at + L.CENTRE_FLOATS * row
        a, b, c = read_placement(loops.poses, OUTPUT_FLOATS * row)
        mass = w[k]
        x = w[k + 1]
        y = w[k + 2]
        z = w[k + 3]
        s[3 * row] = (
            mass * extract_entry(a, 3)
            + x * extract_entry(a, 0)
            + y * extract_entry(a, 1)
            + z * extract_entry(a, 2)
        )
        s[3 * row + 1] = (
            mass * extract_entry(b, 3)
            + x * extract_entry(b, 0)
            + y * extract_entry(b, 1)
            + z * extract_entry(b, 2)
        )
        s[3 * row + 2] = (
            mass * extract_entry(c, 3)
            + x * extract_entry(c, 0)
            + y * extract_entry(c, 1)
            + z * extract_entry(c, 2)
        )
    k = at + L.CENTRE_FLOATS * n
    x = w[k]
    y = w[k + 1]
    z = w[k + 2]
    for i in range(n):
        row = n - 1 - i
        parent = loops.ints[HEADER + ROW_INTS * row + PARENT]
        if parent >= 0:
            for j in range(3):
                s[3 * parent + j] += s[3 * row + j]
        else:
            x = x + s[3 * row]
            y = y + s[3 * row + 1]
            z = z + s[3 * row + 2]
    return x, y, z


@device
def find_end_point(loops, k, p_b):
    """Return the position of the end B of tie k: its origin p_b, or a centre of mass."""
    centre = loops.plan[loops.plan[L.AT_TIES] + L.TIE_INTS * k + L.CENTRE]
    return compute_centre(loops, centre) if centre >= 0 else p_b


@routine
def fill_distance(loops, k, at, with_blocks):
    """Write the equation of a rod, (|p_B - p_A| - length) / L, and its block of the Jacobian."""
    short = loops.weights[L.INVERSE_LENGTH]
    _, p_a, _, p_b = read_tie_ends(loops, k)
    p_b = find_end_point(loops, k, p_b)
    d = (p_b[0] - p_a[0], p_b[1] - p_a[1], p_b[2] - p_a[2])
    far = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    loops.error[at] = (far - read_given_number(loops, k)) * short
    if with_blocks:
        far = max(far, 1e-300)
        x = d[0] / far
        y = d[1] / far
        z = d[2] / far
        # the rate of the distance is the first row of a frame whose x points from A to B
        fill_rod_block(loops, k, (x, y, z), p_b)


@routine
def fill_linear(loops, k, at, with_blocks):
    """Write the equation of a linear relation of coordinates, and its block of the Jacobian."""
    plan = loops.plan
    weights = loops.weights
    tie = plan[L.AT_TIES] + L.TIE_INTS * k
    entry_at = plan[tie + L.ENTRY]
    local = plan[L.AT_LOCALS] + plan[tie + L.LOCAL]
    value = -weights[plan[L.AT_NUMBERS] + k]
    for i in range(plan[tie + L.ENTRIES]):
        factor = weights[plan[L.AT_FACTORS] + entry_at + i]
        value += factor * loops.q[plan[plan[L.AT_ENTRIES] + L.ENTRY_INTS * (entry_at + i)]]
        if with_blocks:
            loops.blocks[plan[tie + L.BLOCK] + i] = factor * weights[L.SCALES + plan[local + i]]
    loops.error[at] = value


@routine
def fill_coordinate(loops, k, at, with_blocks):
    """Write the equations that hold a coordinate at a number, or a ball at a quaternion, and their
    block of the Jacobian.
    """
    plan = loops.plan
    q = loops.q
    tie = plan[L.AT_TIES] + L.TIE_INTS * k
    v = plan[tie + L.DATA]
    block = plan[tie + L.BLOCK]
    place = plan[L.AT_PLACES] + L.PLACE_INTS * v
    i = plan[place]
    sort = plan[place + 1]
    if sort != L.BALL_FIRST:
        x = q[i] - read_given_number(loops, k)
        if sort == L.CIRCLE:
            x -= 2.0 * math.pi * math.floor(x / (2.0 * math.pi) + 0.5)
        loops.error[at] = x / loops.weights[L.SCALES + v]
        loops.blocks[block] = 1.0
        return
    to = advance_pointer(loops.pins, 12 * plan[L.N_PINS] + plan[tie + L.NUMBER])
    w = to[0] * q[i] + to[1] * q[i + 1] + to[2] * q[i + 2] + to[3] * q[i + 3]
    x = to[0] * q[i + 1] - to[1] * q[i] - to[2] * q[i + 3] + to[3] * q[i + 2]
    y = to[0] * q[i + 2] - to[2] * q[i] - to[3] * q[i + 1] + to[1] * q[i + 3]
    z = to[0] * q[i + 3] - to[3] * q[i] - to[1] * q[i + 2] + to[2] * q[i + 1]
    sine = math.sqrt(x * x + y * y + z * z)
    f = math.copysign(2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, abs(w)) / sine, w)
    phi = (f * x, f * y, f * z)
    loops.error[at], loops.error[at + 1], loops.error[at + 2] = phi
    if with_blocks:
        for n in range(3):
            unit = (1.0 if n == 0 else 0.0, 1.0 if n == 1 else 0.0, 1.0 if n == 2 else 0.0)
            # the ball turns in its own axes: the rate from the right is that from the left of the
            # opposite vector
            rate = compute_vector_rate((-phi[0], -phi[1], -phi[2]), unit)
            for j in range(3):
                loops.blocks[block + 3 * n + j] = rate[j]


@routine
def write_tape_inputs(loops, k, data, p, r, work):
    """Write the inputs of the tape of tie k: the pose (p, R) of B in A, coordinates, numbers of the
    call.
    """
    plan = loops.plan
    n = loops.plan[loops.plan[data + L.TAPE_INTS] + N_INPUTS]
    for i in range(n):
        at = data + L.TAPE_INPUTS + L.INPUT_INTS * i
        what = plan[at]
        if what < 3:
            work[i] = p[what]
        elif what < L.COORDINATE:
            work[i] = r[what - 3]
        elif what == L.COORDINATE:
            work[i] = loops.q[plan[at + 1]]
        else:
            tie = plan[L.AT_TIES] + L.TIE_INTS * k
            work[i] = loops.pins[12 * plan[L.N_PINS] + plan[tie + L.NUMBER] + plan[at + 1]]


@routine
def fill_tape(loops, k, at, with_blocks):
    """Write the equations of a recorded expression, and their block of the Jacobian."""
    plan = loops.plan
    weights = loops.weights
    tie = plan[L.AT_TIES] + L.TIE_INTS * k
    data = plan[tie + L.DATA]
    rows = plan[tie + L.ROWS]
    block = plan[tie + L.BLOCK]
    work = advance_pointer(loops.blocks, block + rows * plan[tie + L.LOCALS])
    tape = plan[data + L.TAPE_INTS]
    floats = plan[data + L.TAPE_FLOATS]
    adjoint = advance_pointer(work, plan[tape + N_NODES])
    unit = weights[L.INVERSE_LENGTH] if plan[tie + L.LENGTHS] > 0 else 1.0
    r_a, p_a, r_b, p_b = read_tie_ends(loops, k)
    p = rotate_vector_back(r_a, p_b[0] - p_a[0], p_b[1] - p_a[1], p_b[2] - p_a[2])
    r = compute_relative_rotation(r_a, r_b)
    write_tape_inputs(loops, k, data, p, r, work)
    evaluate_nodes(plan, tape, weights, floats, work)
    for o in range(rows):
        loops.error[at + o] = work[plan[tape + TAPE_HEAD + o]] * unit
    if not with_blocks:
        return
    for i in range(rows * plan[tie + L.LOCALS]):
        loops.blocks[block + i] = 0.0
    local = plan[L.AT_LOCALS] + plan[tie + L.LOCAL]
    for o in range(rows):
        write_gradient(plan, tape, weights, floats, o, work, adjoint)
        v0 = 0.0
        v1 = 0.0
        v2 = 0.0
        w0 = 0.0
        w1 = 0.0
        w2 = 0.0
        for i in range(plan[tape + N_INPUTS]):
            entry_at = data + L.TAPE_INPUTS + L.INPUT_INTS * i
            what = plan[entry_at]
            g = unit * adjoint[i]
            if what == 0:
                v0 += g
            elif what == 1:
                v1 += g
            elif what == 2:
                v2 += g
            elif what < L.COORDINATE:  # the rate of column c of R is w x c
                row = (what - 3) // 3
                column = (what - 3) % 3
                x = r[column]
                y = r[3 + column]
                z = r[6 + column]
                if row == 0:
                    w1 = w1 + g * z
                    w2 = w2 - g * y
                elif row == 1:
                    w0 = w0 - g * z
                    w2 = w2 + g * x
                else:
                    w0 = w0 + g * y
                    w1 = w1 - g * x
            elif what == L.COORDINATE and plan[entry_at + 2] >= 0:
                column = plan[entry_at + 2]
                loops.blocks[block + rows * column + o] += (
                    g * weights[L.SCALES + plan[local + column]]
                )
        add_twist_rates(loops, k, r_a, p_b, (v0, v1, v2), (w0, w1, w2), o)


@routine
def fill_equations(loops, with_blocks):
    """Write the residual at the poses last written and, if requested, the Jacobian's blocks; return
    the residual's square.
    """
    plan = loops.plan
    for k in range(plan[L.N_TIES]):
        tie = plan[L.AT_TIES] + L.TIE_INTS * k
        at = plan[tie + L.FIRST_ROW]
        turns = plan[tie + L.TURNS]
        if turns == L.LINEAR:
            fill_linear(loops, k, at, with_blocks)
        elif turns == L.DISTANCE:
            fill_distance(loops, k, at, with_blocks)
        elif turns == L.OWN:
            fill_coordinate(loops, k, at, with_blocks)
        elif turns == L.TAPE:
            fill_tape(loops, k, at, with_blocks)
        elif turns == L.FUNCTION:
            block = advance_pointer(loops.blocks, plan[tie + L.BLOCK])
            call_address(
                plan[tie + L.DATA],
                loops.q,
                advance_pointer(loops.error, at),
                block,
                int(with_blocks),
            )
        else:
            r_a, p_a, r_b, p_b = read_tie_ends(loops, k)
            p_b = find_end_point(loops, k, p_b)
            p = rotate_vector_back(r_a, p_b[0] - p_a[0], p_b[1] - p_a[1], p_b[2] - p_a[2])
            r = compute_relative_rotation(r_a, r_b)
            phi = write_error(loops, tie, at, p, r)
            if with_blocks:
                fill_block(loops, k, r_a, p_b, r, phi)
    square = 0.0
    for i in range(plan[L.N_ROWS]):
        square += loops.error[i] * loops.error[i]
    return square
