"""Iterated Lie brackets of the fields in the kernel of A(q), and values of A(q) recorded as a tape (`tape_layout`).

The fields are X_c(q), c in R^m: velocities with A(q) v = 0 whose free coordinates are c, as motions of the entries of
q; a quaternion moves by q' = q (0, w) / 2. For fields X_1 ... X_k and Y the fields W_(k+1) = Y and

    W_j = [X_j, W_(j+1)] = DW_(j+1) X_j - DX_j W_(j+1)

are directional derivatives, so W_j at q needs W_(j+1) at p + t_j X_j(p) to first order in t_j. All of this happens in
the algebra of polynomials in t_1 ... t_k with every t_i^2 = 0, whose elements are 2^k numbers, one for each subset of
the letters, and whose product sums over all ways to part a subset in two (3^k multiplications). Nothing is symbolic and
no step is finite, so the words are exact but for rounding. In levels, t_1 first: what depends on t_j has a `top` half
that multiplies t_j, and the top of a function is its derivative's low half times the top of its operand, wherefore a
tape holds derivatives as nodes.
"""

from __future__ import annotations

import numpy as np

from kempe.kernels._jit import kernel, routine
from kempe.kernels.declare import OUT, F, I
from kempe.kernels.tape import node_at, tape_values
from kempe.kernels.tape_layout import (
    ADD,
    ATAN2,
    DIV,
    HYPOT,
    MUL,
    N_INPUTS,
    N_NODES,
    N_OUTPUTS,
    NEG,
    NODE_INTS,
    NUMBER,
    PARTIALS,
    SUB,
    TAPE_HEAD,
)
from kempe.kernels.vectors import keep, raw

EPSILON = 2.3e-16
"""Rounding of one operation."""


@routine
def product(work, n, a, b, out, factor):
    """Add factor times the product of the elements at a and b, of size n, to the one at out."""
    for s in range(n):
        total = work[a] * work[b + s]
        part = s
        while part > 0:
            total += work[a + part] * work[b + (s ^ part)]
            part = (part - 1) & s
        work[out + s] += factor * total


@routine
def quotient(work, n, a, b):
    """Divide the element at a by the one at b, of size n, in place."""
    for s in range(n):
        total = work[a + s]
        part = s
        while part > 0:
            total -= work[b + part] * work[a + (s ^ part)]
            part = (part - 1) & s
        work[a + s] = total / work[b]


@routine
def tops(ints, order, n_order, work, n, width, top, step):
    """Write the top halves of nodes, work[top + step * place :], of size n, from their low halves at width * place.

    `order` are the places of the nodes that are needed; the top halves of the inputs are there.
    """
    for o in range(n_order):
        i = order[o]
        p = node_at(ints, 0, i)
        op, left, right = ints[p], ints[p + 1], ints[p + 2]
        y, a, b = top + step * i, top + step * left, top + step * right
        if op == ADD or op == SUB:
            sign = 1.0 if op == ADD else -1.0
            for s in range(n):
                work[y + s] = work[a + s] + sign * work[b + s]
            continue
        for s in range(n):
            work[y + s] = -work[a + s] if op == NEG else 0.0
        if op == MUL:
            product(work, n, width * left, b, y, 1.0)
            product(work, n, width * right, a, y, 1.0)
        elif op == DIV:
            product(work, n, width * i, b, y, -1.0)
            for s in range(n):
                work[y + s] += work[a + s]
            quotient(work, n, y, width * right)
        elif op == ATAN2 or op == HYPOT:
            product(work, n, width * ints[p + NODE_INTS + 1], a, y, 1.0)
            product(work, n, width * ints[p + NODE_INTS + 2], b, y, 1.0)
        elif op != NEG and op != NUMBER and op != PARTIALS:
            product(work, n, width * right, a, y, 1.0)


@routine
def fill_velocities(
    entries, n_entries, pivots, columns, inverse, rank, work, n, width, v, step, u, ustep, top, tstep, right
):  # fmt: skip
    """Solve A v = -B u for the pivots among the elements v + step * column, of size n; the free ones are there.

    The nodes of A lie at width * place, those of B at top + tstep * place; without B, top is negative. u lies at
    u + ustep * column; work[right : right + rank] is scratch.
    """
    for s in range(n):
        for r in range(rank):
            work[right + r] = 0.0
        for e in range(n_entries):
            row, column, node = entries[3 * e], entries[3 * e + 1], entries[3 * e + 2]
            x, a, total = v + step * column, width * node, 0.0
            if pivots[column] < 0:
                total = work[a] * work[x + s]
            part = s
            while part > 0:
                total += work[a + part] * work[x + (s ^ part)]
                part = (part - 1) & s
            if top >= 0:
                y, b = u + ustep * column, top + tstep * node
                total += work[b] * work[y + s]
                part = s
                while part > 0:
                    total += work[b + part] * work[y + (s ^ part)]
                    part = (part - 1) & s
            work[right + row] -= total
        for column in range(columns):
            k = pivots[column]
            if k >= 0:
                total = 0.0
                for r in range(rank):
                    total += inverse[k * rank + r] * work[right + r]
                work[v + step * column + s] = total


@routine
def half_turns(work, n, q, qstep, w, wstep, out, ostep):
    """Add q (0, w) / 2 to the four elements at out, out + ostep, ..."""
    for i in range(3):
        j, k = (i + 1) % 3 + 1, (i + 2) % 3 + 1
        x = w + wstep * i
        product(work, n, q + qstep * (i + 1), x, out, -0.5)
        product(work, n, q, x, out + ostep * (i + 1), 0.5)
        product(work, n, q + qstep * k, x, out + ostep * j, 0.5)
        product(work, n, q + qstep * j, x, out + ostep * k, -0.5)


@routine
def rates_of(slots, n_slots, balls, n_balls, work, n, v, step, q, qstep, out, ostep):
    """Write the motion of the entries of q, at out + ostep * slot, under velocities v."""
    for i in range(n_slots):
        column = slots[2 * i]
        for s in range(n):
            work[out + ostep * i + s] = work[v + step * column + s] if column >= 0 else 0.0
    for i in range(n_balls):
        slot, column = balls[2 * i], balls[2 * i + 1]
        half_turns(work, n, q + qstep * slot, qstep, v + step * column, step, out + ostep * slot, ostep)


@routine
def write_word(slots, n_slots, balls, n_balls, units, work, q, qstep, w, wstep, out, to):
    """Write to out[to:] the velocities, in units, that move the state as the first numbers of the elements at w do."""
    for i in range(n_slots):
        column = slots[2 * i]
        if column >= 0:
            out[to + column] = work[w + wstep * i] / units[column]
    for i in range(n_balls):
        slot, column = balls[2 * i], balls[2 * i + 1]
        at, by = q + qstep * slot, w + wstep * slot
        a, x, y, z = work[at], work[at + qstep], work[at + 2 * qstep], work[at + 3 * qstep]
        da, dx, dy, dz = work[by], work[by + wstep], work[by + 2 * wstep], work[by + 3 * wstep]
        per = 2.0 / (a * a + x * x + y * y + z * z)
        out[to + column] = per * (a * dx - x * da - y * dz + z * dy) / units[column]
        out[to + column + 1] = per * (a * dy - y * da - z * dx + x * dz) / units[column + 1]
        out[to + column + 2] = per * (a * dz - z * da - x * dy + y * dx) / units[column + 2]


@routine
def size_of(slots, n_slots, units, work, s, w, wstep):
    """The largest of the numbers s of the elements at w, in units."""
    most = 0.0
    for i in range(n_slots):
        column = slots[2 * i]
        most = max(most, abs(work[w + wstep * i + s]) / (units[column] if column >= 0 else 1.0))
    return most


@routine
def copied(slots, n_slots, work, n, source, step, target, tstep):
    """Copy the elements of entries of q to those of the inputs of the tape."""
    for i in range(n_slots):
        place = slots[2 * i + 1]
        if place >= 0:
            for s in range(n):
                work[target + tstep * place + s] = work[source + step * i + s]


@routine
def magnitudes(ints, order, n_order, work, n_inputs, width, out):
    """Write for all nodes the sum of the sizes of what their rates are summed from, by the first letter alone."""
    for i in range(n_inputs):
        work[out + i] = abs(work[width * i + 1])
    for o in range(n_order):
        i = order[o]
        p = node_at(ints, 0, i)
        op, left, right = ints[p], ints[p + 1], ints[p + 2]
        if op == NUMBER or op == PARTIALS:
            work[out + i] = 0.0
            continue
        first, second = work[out + left], 0.0
        if op == ADD or op == SUB:
            second = work[out + right]
        elif op == MUL:
            first, second = first * abs(work[width * right]), work[out + right] * abs(work[width * left])
        elif op == DIV:
            by = abs(work[width * right])
            first, second = first / by, work[out + right] * abs(work[width * i]) / by
        elif op == ATAN2 or op == HYPOT:
            first *= abs(work[width * ints[p + NODE_INTS + 1]])
            second = work[out + right] * abs(work[width * ints[p + NODE_INTS + 2]])
        elif op != NEG:
            first *= abs(work[width * right])
        work[out + i] = first + second


@routine
def steepness(entries, n_entries, pivots, columns, inverse, rank, units, work, sizes, v, right):
    """How fast velocities v change, at most, in units: sums of the sizes of all terms, where `sizes` are of nodes."""
    for r in range(rank):
        work[right + r] = 0.0
    for e in range(n_entries):
        work[right + entries[3 * e]] += work[sizes + entries[3 * e + 2]] * abs(work[v + entries[3 * e + 1]])
    most = 0.0
    for column in range(columns):
        k = pivots[column]
        if k >= 0:
            total = 0.0
            for r in range(rank):
                total += abs(inverse[k * rank + r]) * work[right + r]
            most = max(most, total / units[column])
    return most


@kernel(
    I("_"), F("_"), I("_"), I("e", 3), I("c"), F("r", "r"), I("s", 2), I("_", 2), F("s"), F("n"), F("c"),
    F("N", "l", "c"), OUT("N", "l", "c"), OUT("N", "l"), returns=False,
)  # fmt: skip
def words(ints, floats, order, entries, pivots, inverse, slots, balls, q, inputs, units, letters, found, noise):
    """Write for N words of l letters the brackets of their last 1 ... l letters, the longest first, and their rounding.

    `ints`, `floats` hold a tape, `order` the places of its nodes that the `entries` (row, column, place) of A need.
    `pivots` gives for each column of A the row of the `inverse` of A's dependent columns, -1 where it is free. `slots`
    are for each entry of the state its column, -1 in a quaternion, and its place among the tape's inputs, -1 if it has
    none; `balls` the first slot and the first column of quaternions. `q` is the state, `inputs` are those of the tape.
    The free entries of `letters` are the letters' coefficients, in `units` of the columns; the last letter is Y.
    """
    count, columns, rank = letters.shape[1], pivots.shape[0], len(inverse)
    n_slots, n_balls = len(slots), len(balls)
    k, nodes = count - 1, ints[N_NODES]
    width = 1 << k
    half = max(width // 2, 1)
    state = nodes * width
    moves = state + n_slots * width
    own = moves + n_slots * width  # of letter j, 0 ... k, from columns * (2^j - 1) on
    changed = own + columns * 2 * width
    others = changed + columns * half
    drift = others + nodes * half
    error = drift + n_slots * half
    right = error + width
    sizes = right + rank + 1
    block = np.zeros(sizes + nodes)
    work, ints_, floats_, order_, entries_ = raw(block), raw(ints), raw(floats), raw(order), raw(entries)
    pivots_, inverse_, slots_, balls_, units_ = raw(pivots), raw(inverse), raw(slots), raw(balls), raw(units)
    found_ = raw(found)
    for i in range(ints[N_INPUTS]):
        work[i] = inputs[i]
    tape_values(ints_, 0, floats_, 0, work)
    for i in range(nodes - 1, -1, -1):
        value = work[i]
        for s in range(width):
            work[i * width + s] = value if s == 0 else 0.0
    for i in range(n_slots):
        work[state + i * width] = q[i]
    for b in range(letters.shape[0]):
        for j in range(count):
            n = 1 << j
            v = own + columns * (n - 1)
            for i in range(columns):
                for s in range(n):
                    work[v + i * n + s] = 0.0
                if pivots[i] < 0:
                    work[v + i * n] = letters[b, j, i] * units[i]
            fill_velocities(
                entries_, len(entries), pivots_, columns, inverse_, rank, work, n, width, v, n, 0, 0, -1, 0, right
            )
            to = state + n if j < k else moves
            rates_of(slots_, n_slots, balls_, n_balls, work, n, v, n, state, width, to, width)
            if j < k:
                copied(slots_, n_slots, work, n, to, width, n, width)
                tops(ints_, order_, len(order), work, n, width, n, width)
        steep = 0.0
        if k > 0:
            magnitudes(ints_, order_, len(order), work, ints[N_INPUTS], width, sizes)
            steep = steepness(
                entries_, len(entries), pivots_, columns, inverse_, rank, units_, work, sizes, own, right
            )  # fmt: skip
        for s in range(width):
            work[error + s] = EPSILON * size_of(slots_, n_slots, units_, work, s, moves, width)
        at = (b * count + k) * columns
        write_word(slots_, n_slots, balls_, n_balls, units_, work, state, width, moves, width, found_, at)
        noise[b, k] = work[error]
        for j in range(k - 1, -1, -1):
            n = 1 << j
            v = own + columns * (n - 1)
            copied(slots_, n_slots, work, n, moves, width, others, half)
            tops(ints_, order_, len(order), work, n, width, others, half)
            for i in range(columns * half):
                work[changed + i] = 0.0
            fill_velocities(
                entries_, len(entries), pivots_, columns, inverse_, rank, work, n, width, changed, half, v, n, others,
                half, right,
            )  # fmt: skip
            rates_of(slots_, n_slots, balls_, n_balls, work, n, changed, half, state, width, drift, half)
            for i in range(n_balls):
                slot, column = balls[i, 0], balls[i, 1]
                at = drift + half * slot
                half_turns(work, n, moves + width * slot, width, v + n * column, n, at, half)
            before = size_of(slots_, n_slots, units_, work, 0, moves, width)
            gain = size_of(slots_, n_slots, units_, work, 0, drift, half) / before if before > 0.0 else 0.0
            for s in range(n):
                terms = size_of(slots_, n_slots, units_, work, n + s, moves, width)
                terms += size_of(slots_, n_slots, units_, work, s, drift, half)
                work[error + s] = work[error + n + s] + gain * work[error + s] + EPSILON * terms
            for i in range(n_slots):
                for s in range(n):
                    work[moves + i * width + s] = work[moves + i * width + n + s] - work[drift + i * half + s]
            at = (b * count + j) * columns
            write_word(slots_, n_slots, balls_, n_balls, units_, work, state, width, moves, width, found_, at)
            noise[b, j] = max(work[error], EPSILON * steep ** (k - j))  # sums that cancel all the way
    keep(block)


@kernel(I("_"), F("_"), F("N", "n"), OUT("N", "m"), returns=False)
def tape_outputs(ints, floats, inputs, values):
    """Write the outputs of a tape at N points."""
    ints_, floats_, n = raw(ints), raw(floats), ints[N_INPUTS]
    block = np.empty(ints[N_NODES] + 1)
    work = raw(block)
    for b in range(inputs.shape[0]):
        for i in range(n):
            work[i] = inputs[b, i]
        tape_values(ints_, 0, floats_, 0, work)
        for o in range(ints[N_OUTPUTS]):
            values[b, o] = work[ints[TAPE_HEAD + o]]
    keep(block)
