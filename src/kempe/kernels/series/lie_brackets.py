"""Iterated Lie brackets of the fields in the kernel of A(q), which is recorded as a tape
(`tape_layout`).

The fields are X_c(q), c in R^m: velocities with A(q) v = 0 whose free coordinates are c, as motions
of the entries of q; a quaternion moves by q' = q (0, w) / 2. For fields X_1 ... X_k and Y the
fields W_(k+1) = Y and

    W_j = [X_j, W_(j+1)] = DW_(j+1) X_j - DX_j W_(j+1)

are directional derivatives, so W_j at q needs W_(j+1) at p + t_j X_j(p) to first order in t_j. All
of this happens in the algebra of polynomials in t_1 ... t_k with every t_i^2 = 0, whose elements
are 2^k numbers, one for each subset of the letters, and whose product sums over all ways to part a
subset in two (3^k multiplications). Nothing is symbolic and no step is finite, so the words are
exact but for rounding. In levels, t_1 first: what depends on t_j has a `top` half that multiplies
t_j, and the top of a function is its derivative's low half times the top of its operand, wherefore
a tape holds derivatives as nodes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kempe.kernels.base._jit import kernel, routine
from kempe.kernels.base.declare import OUT, F, I
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.constraints.tape_evaluation import evaluate_nodes, locate_node
from kempe.kernels.constraints.tape_layout import (
    ADD,
    ATAN2,
    DIV,
    LEFT,
    LOOKUP,
    MUL,
    N_INPUTS,
    N_NODES,
    NEAREST,
    NEG,
    NODE_INTS,
    NUMBER,
    OP,
    PARTIALS,
    RIGHT,
    SUB,
)

EPSILON = 2.3e-16
"""Rounding of one operation."""


@routine
def add_product(work, n, a, b, out, factor):
    """Add factor times the product of the elements at a and b, of size n, to the one at out."""
    for s in range(n):
        total = work[a] * work[b + s]
        part = s
        while part > 0:
            total += work[a + part] * work[b + (s ^ part)]
            part = (part - 1) & s
        work[out + s] += factor * total


@routine
def divide_element(work, n, a, b):
    """Divide the element at a by the one at b, of size n, in place."""
    for s in range(n):
        total = work[a + s]
        part = s
        while part > 0:
            total -= work[b + part] * work[a + (s ^ part)]
            part = (part - 1) & s
        work[a + s] = total / work[b]


@routine
def write_top_halves(ints, order, n_order, work, n, width, top, step):
    """Write the top halves of nodes, work[top + step * place :], of size n, from their low halves
    at width * place.

    `order` are the places of the nodes that are needed; the top halves of the inputs are there.
    """
    for o in range(n_order):
        i = order[o]
        p = locate_node(ints, 0, i)
        op = ints[p + OP]
        left = ints[p + LEFT]
        right = ints[p + RIGHT]
        y = top + step * i
        a = top + step * left
        b = top + step * right
        if op == ADD or op == SUB:
            sign = 1.0 if op == ADD else -1.0
            for s in range(n):
                work[y + s] = work[a + s] + sign * work[b + s]
            continue
        for s in range(n):
            work[y + s] = -work[a + s] if op == NEG else 0.0
        if op == MUL:
            add_product(work, n, width * left, b, y, 1.0)
            add_product(work, n, width * right, a, y, 1.0)
        elif op == DIV:
            add_product(work, n, width * i, b, y, -1.0)
            for s in range(n):
                work[y + s] += work[a + s]
            divide_element(work, n, y, width * right)
        elif ATAN2 <= op <= NEAREST:
            add_product(work, n, width * ints[p + NODE_INTS + LEFT], a, y, 1.0)
            add_product(work, n, width * ints[p + NODE_INTS + RIGHT], b, y, 1.0)
        elif op > NEAREST:
            add_product(work, n, width * right, a, y, 1.0)


class Fields(NamedTuple):
    """Packed rows, the way to solve them, and the scratch of words of one length; all fields but
    the numbers are pointers.

    Elements of nodes lie at `width` times their place, those of slots from `state` on, of their
    motion from `moves` on. Coefficients of letter j, 0 ... k, of size 2^j, from own + columns (2^j
    - 1) on.
    """

    ints: object
    order: object
    entries: object
    pivots: object
    inverse: object
    slots: object
    balls: object
    units: object
    work: object
    n_order: int
    n_entries: int
    columns: int
    rank: int
    n_slots: int
    n_balls: int
    nodes: int
    letters: int
    width: int
    half: int
    state: int
    moves: int
    own: int
    changed: int
    """Changes of a letter's coefficients,"""
    others: int
    """of the nodes"""
    drift: int
    """and of motions, by another motion than the letter's: elements are `half` numbers apart."""
    error: int
    right: int
    sizes: int


@routine
def fill_velocities(f, n, v, step, u, top):
    """Solve A v = -B u for the pivots among the elements v + step * column, of size n; the free
    velocities u are known.

    The nodes of A lie at width * place, those of B at top + half * place; without B, top is
    negative. u lies at u + n * column.
    """
    work = f.work
    width = f.width
    for s in range(n):
        for r in range(f.rank):
            work[f.right + r] = 0.0
        for e in range(f.n_entries):
            row = f.entries[3 * e]
            column = f.entries[3 * e + 1]
            node = f.entries[3 * e + 2]
            x = v + step * column
            a = width * node
            total = 0.0
            if f.pivots[column] < 0:
                total = work[a] * work[x + s]
            part = s
            while part > 0:
                total += work[a + part] * work[x + (s ^ part)]
                part = (part - 1) & s
            if top >= 0:
                y = u + n * column
                b = top + f.half * node
                total += work[b] * work[y + s]
                part = s
                while part > 0:
                    total += work[b + part] * work[y + (s ^ part)]
                    part = (part - 1) & s
            work[f.right + row] -= total
        for column in range(f.columns):
            k = f.pivots[column]
            if k >= 0:
                total = 0.0
                for r in range(f.rank):
                    total += f.inverse[k * f.rank + r] * work[f.right + r]
                work[v + step * column + s] = total


@routine
def add_half_turns(work, n, q, qstep, w, wstep, out, ostep):
    """Add q (0, w) / 2 to the four elements at out, out + ostep, ..."""
    for i in range(3):
        j = (i + 1) % 3 + 1
        k = (i + 2) % 3 + 1
        x = w + wstep * i
        add_product(work, n, q + qstep * (i + 1), x, out, -0.5)
        add_product(work, n, q, x, out + ostep * (i + 1), 0.5)
        add_product(work, n, q + qstep * k, x, out + ostep * j, 0.5)
        add_product(work, n, q + qstep * j, x, out + ostep * k, -0.5)


@routine
def write_motion(f, n, v, step, out, ostep):
    """Write the motion of the slots, at out + ostep * slot, under the velocities v + step * column."""
    for i in range(f.n_slots):
        column = f.slots[2 * i]
        for s in range(n):
            f.work[out + ostep * i + s] = f.work[v + step * column + s] if column >= 0 else 0.0
    for i in range(f.n_balls):
        slot = f.balls[2 * i]
        column = f.balls[2 * i + 1]
        add_half_turns(
            f.work,
            n,
            f.state + f.width * slot,
            f.width,
            v + step * column,
            step,
            out + ostep * slot,
            ostep,
        )


@routine
def write_word(f, out, to):
    """Write to out[to:] the velocities, in units, that move the state as the first numbers of
    `moves` do.
    """
    work = f.work
    d = f.width
    for i in range(f.n_slots):
        column = f.slots[2 * i]
        if column >= 0:
            out[to + column] = work[f.moves + d * i] / f.units[column]
    for i in range(f.n_balls):
        at = f.state + d * f.balls[2 * i]
        by = f.moves + d * f.balls[2 * i]
        column = f.balls[2 * i + 1]
        a = work[at]
        x = work[at + d]
        y = work[at + 2 * d]
        z = work[at + 3 * d]
        da = work[by]
        dx = work[by + d]
        dy = work[by + 2 * d]
        dz = work[by + 3 * d]
        per = 2.0 / (a * a + x * x + y * y + z * z)
        out[to + column] = per * (a * dx - x * da - y * dz + z * dy) / f.units[column]
        out[to + column + 1] = per * (a * dy - y * da - z * dx + x * dz) / f.units[column + 1]
        out[to + column + 2] = per * (a * dz - z * da - x * dy + y * dx) / f.units[column + 2]


@routine
def find_largest_number(f, s, w, step):
    """Return the largest of the numbers s of the elements at w + step * slot, in units."""
    most = 0.0
    for i in range(f.n_slots):
        column = f.slots[2 * i]
        most = max(most, abs(f.work[w + step * i + s]) / (f.units[column] if column >= 0 else 1.0))
    return most


@routine
def write_inputs(f, n, source, target, step):
    """Copy the elements of slots, `width` apart, to those of the inputs of the tape."""
    for i in range(f.n_slots):
        place = f.slots[2 * i + 1]
        if place >= 0:
            for s in range(n):
                f.work[target + step * place + s] = f.work[source + f.width * i + s]


@routine
def write_magnitudes(f, n_inputs):
    """Write for all nodes the sum of the absolute values of the terms of their rates, by the first
    letter alone.
    """
    ints = f.ints
    work = f.work
    width = f.width
    out = f.sizes
    for i in range(n_inputs):
        work[out + i] = abs(work[width * i + 1])
    for o in range(f.n_order):
        i = f.order[o]
        p = locate_node(ints, 0, i)
        op = ints[p + OP]
        left = ints[p + LEFT]
        right = ints[p + RIGHT]
        if op == NUMBER or PARTIALS <= op <= LOOKUP:
            work[out + i] = 0.0
            continue
        first = work[out + left]
        second = 0.0
        if op == ADD or op == SUB:
            second = work[out + right]
        elif op == MUL:
            first = first * abs(work[width * right])
            second = work[out + right] * abs(work[width * left])
        elif op == DIV:
            by = abs(work[width * right])
            first = first / by
            second = work[out + right] * abs(work[width * i]) / by
        elif ATAN2 <= op <= NEAREST:
            first *= abs(work[width * ints[p + NODE_INTS + LEFT]])
            second = work[out + right] * abs(work[width * ints[p + NODE_INTS + RIGHT]])
        elif op != NEG:
            first *= abs(work[width * right])
        work[out + i] = first + second


@routine
def compute_steepness(f):
    """Return a bound of how fast the first letter's coefficients change along it, in units."""
    work = f.work
    for r in range(f.rank):
        work[f.right + r] = 0.0
    for e in range(f.n_entries):
        row = f.entries[3 * e]
        column = f.entries[3 * e + 1]
        node = f.entries[3 * e + 2]
        work[f.right + row] += work[f.sizes + node] * abs(work[f.own + column])
    most = 0.0
    for column in range(f.columns):
        k = f.pivots[column]
        if k >= 0:
            total = 0.0
            for r in range(f.rank):
                total += abs(f.inverse[k * f.rank + r]) * work[f.right + r]
            most = max(most, total / f.units[column])
    return most


@routine
def fill_coefficients(f, letters, at):
    """Write the coefficients of all letters, read from letters[at:], the nodes, and the motion of
    the last letter.
    """
    for j in range(f.letters):
        n = 1 << j
        v = f.own + f.columns * (n - 1)
        for i in range(f.columns):
            for s in range(n):
                f.work[v + i * n + s] = 0.0
            if f.pivots[i] < 0:
                f.work[v + i * n] = letters[at + j * f.columns + i] * f.units[i]
        fill_velocities(f, n, v, n, 0, -1)
        last = j == f.letters - 1
        to = f.moves if last else f.state + n
        write_motion(f, n, v, n, to, f.width)
        if not last:
            write_inputs(f, n, to, n, f.width)
            write_top_halves(f.ints, f.order, f.n_order, f.work, n, f.width, n, f.width)


@routine
def write_brackets(f, j):
    """Replace the motions W by their brackets [X_j, W], and their rounding errors by those of the
    brackets.
    """
    n = 1 << j
    work = f.work
    v = f.own + f.columns * (n - 1)
    write_inputs(f, n, f.moves, f.others, f.half)
    write_top_halves(f.ints, f.order, f.n_order, work, n, f.width, f.others, f.half)
    for i in range(f.columns * f.half):
        work[f.changed + i] = 0.0
    fill_velocities(f, n, f.changed, f.half, v, f.others)
    write_motion(f, n, f.changed, f.half, f.drift, f.half)
    for i in range(f.n_balls):
        slot = f.balls[2 * i]
        column = f.balls[2 * i + 1]
        add_half_turns(
            work,
            n,
            f.moves + f.width * slot,
            f.width,
            v + n * column,
            n,
            f.drift + f.half * slot,
            f.half,
        )
    before = find_largest_number(f, 0, f.moves, f.width)
    gain = find_largest_number(f, 0, f.drift, f.half) / before if before > 0.0 else 0.0
    for s in range(n):
        terms = find_largest_number(f, n + s, f.moves, f.width) + find_largest_number(
            f, s, f.drift, f.half
        )
        work[f.error + s] = work[f.error + n + s] + gain * work[f.error + s] + EPSILON * terms
    for i in range(f.n_slots):
        for s in range(n):
            at = f.moves + i * f.width + s
            work[at] = work[at + n] - work[f.drift + i * f.half + s]


@kernel(
    I("_"),
    F("_"),
    I("_"),
    I("e", 3),
    I("c"),
    F("r", "r"),
    I("s", 2),
    I("_", 2),
    F("s"),
    F("n"),
    F("c"),
    F("N", "l", "c"),
    OUT("N", "l", "c"),
    OUT("N", "l"),
    returns=False,
)
def evaluate_words(
    ints,
    floats,
    order,
    entries,
    pivots,
    inverse,
    slots,
    balls,
    q,
    inputs,
    units,
    letters,
    found,
    noise,
):
    """Write the brackets of the last 1 ... l letters of N words of l letters, the longest first,
    and their rounding errors.

    `ints`, `floats` hold a tape, `order` the places of its nodes that the `entries` (row, column,
    place) of A need. `pivots` gives for each column of A the row of the `inverse` of A's dependent
    columns, -1 where it is free. `slots` are for each entry of the state its column, -1 in a
    quaternion, and its place among the tape's inputs, -1 if it has none; `balls` the first slot and
    the first column of quaternions. `q` is the state, `inputs` are those of the tape. The free
    entries of `letters` are the letters' coefficients, in `units` of the columns; the last letter
    is Y.
    """
    count = letters.shape[1]
    columns = len(pivots)
    rank = len(inverse)
    n_slots = len(slots)
    nodes = ints[N_NODES]
    width = 1 << (count - 1)
    half = max(width // 2, 1)
    state = nodes * width
    moves = state + n_slots * width
    own = moves + n_slots * width
    changed = own + columns * 2 * width
    others = changed + columns * half
    drift = others + nodes * half
    error = drift + n_slots * half
    right = error + width
    sizes = right + rank + 1
    block = np.zeros(sizes + nodes)
    f = Fields(
        get_pointer(ints),
        get_pointer(order),
        get_pointer(entries),
        get_pointer(pivots),
        get_pointer(inverse),
        get_pointer(slots),
        get_pointer(balls),
        get_pointer(units),
        get_pointer(block),
        len(order),
        len(entries),
        columns,
        rank,
        n_slots,
        len(balls),
        nodes,
        count,
        width,
        half,
        state,
        moves,
        own,
        changed,
        others,
        drift,
        error,
        right,
        sizes,
    )
    for i in range(ints[N_INPUTS]):
        block[i] = inputs[i]
    evaluate_nodes(f.ints, 0, get_pointer(floats), 0, f.work)
    for i in range(nodes - 1, -1, -1):
        value = block[i]
        for s in range(width):
            block[i * width + s] = value if s == 0 else 0.0
    for i in range(n_slots):
        block[state + i * width] = q[i]
    for b in range(letters.shape[0]):
        fill_coefficients(f, get_pointer(letters), b * count * columns)
        steep = 0.0
        if count > 1:
            write_magnitudes(f, ints[N_INPUTS])
            steep = compute_steepness(f)
        for s in range(width):
            block[error + s] = EPSILON * find_largest_number(f, s, moves, width)
        for j in range(count - 1, -1, -1):
            if j < count - 1:
                write_brackets(f, j)
            write_word(f, get_pointer(found), (b * count + j) * columns)
            noise[b, j] = max(
                block[error], EPSILON * steep ** (count - 1 - j)
            )  # sums that cancel all the way
    keep_alive(block)
