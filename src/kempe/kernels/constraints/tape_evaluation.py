"""Recorded expressions: values, gradients and Taylor series of a tape (`tape_layout`).

Gradients are one reverse sweep (Griewank, Walther, 2008, chapter 3). Orders of series follow the
recurrences of their chapter 13: a function y = f(x) whose derivative is the series g(t) obeys y' =
g x', hence k y_k = sum of j x_j g_(k-j) over j = 1 ... k, and a tape holds g as a node of its own.
What is not defined comes out as NaN or infinity.

Pointers `ints` and `floats` are read from the places `at` and `fat` on.
"""

from __future__ import annotations

import math

import numpy as np

from kempe.kernels.base._jit import device, kernel, routine
from kempe.kernels.base.declare import INT, OUT, F, I
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.constraints.tape_layout import (
    ACOS,
    ACOSH,
    ADD,
    ASIN,
    ASINH,
    ATAN,
    ATAN2,
    ATANH,
    COS,
    COSH,
    DIV,
    EXP,
    HYPOT,
    LEFT,
    LOG,
    LOOKUP,
    MUL,
    N_INPUTS,
    N_NODES,
    N_OUTPUTS,
    NEAREST,
    NEG,
    NODE_INTS,
    NUMBER,
    OP,
    PIECE,
    POW,
    RIGHT,
    SIN,
    SINH,
    SQRT,
    SUB,
    TABLE,
    TAN,
    TANH,
    TAPE_HEAD,
)

# ---- cubic pieces

# Points of curves made of cubic pieces: the nearest to a place, and entries of tables
# (`tape_layout`).


SAMPLES = 4
"""Parts of a piece in which the nearest point is looked for."""
REFINEMENTS = 60
"""Most steps of the refinement."""


@device
def find_piece(n, s):
    """Return the piece of a curve that a parameter lies on; the first or last piece beyond the
    ends.
    """
    return 0 if not s > 0.0 else n - 1 if s >= n else int(s)


@routine
def find_table_entry(floats, at, n, s):
    """Return the entry of a table of n numbers that belongs to a parameter."""
    return floats[at + find_piece(n, s)]


@device
def evaluate_cubic(floats, at, u):
    """Return a cubic polynomial and its first two derivatives at u."""
    a = floats[at]
    b = floats[at + 1]
    c = floats[at + 2]
    d = floats[at + 3]
    return a + u * (b + u * (c + u * d)), b + u * (2.0 * c + u * (3.0 * d)), 2.0 * c + 6.0 * d * u


@routine
def compute_squared_distance(floats, at, u, x, y, z):
    """Return the square of the distance from (x, y, z) to the point u of a piece of a curve, and
    half its first two derivatives.
    """
    cx, dx, ddx = evaluate_cubic(floats, at, u)
    cy, dy, ddy = evaluate_cubic(floats, at + 4, u)
    cz, dz, ddz = evaluate_cubic(floats, at + 8, u)
    ex = x - cx
    ey = y - cy
    ez = z - cz
    slope = -(ex * dx + ey * dy + ez * dz)
    return (
        ex * ex + ey * ey + ez * ez,
        slope,
        dx * dx + dy * dy + dz * dz - (ex * ddx + ey * ddy + ez * ddz),
    )


@routine
def refine_parameter(floats, p, low, high, x, y, z):
    """Return the parameter between `low` and `high` at which the distance from a piece of a curve
    is least.
    """
    u = 0.5 * (low + high)
    for _ in range(REFINEMENTS):  # Newton's method within a shrinking interval
        _, slope, bend = compute_squared_distance(floats, p, u, x, y, z)
        if slope < 0.0:
            low = u
        else:
            high = u
        new = u - slope / bend if bend > 0.0 else math.inf
        if not (low <= new <= high):
            new = 0.5 * (low + high)
        step = abs(new - u)
        u = new
        if step <= 1e-16:
            break
    return u


@routine
def find_nearest_parameter(floats, first, count, x, y, z):
    """Return the parameter of the point of a curve nearest to (x, y, z); the table of the curve is
    floats[first : first + count].
    """
    n = (count - 1) // PIECE
    endless = floats[first] != 0.0
    best = math.inf
    s = 0.0
    for i in range(n):
        p = first + 1 + PIECE * i
        far, before, bend = compute_squared_distance(floats, p, 0.0, x, y, z)
        if endless and (i == 0 or i == n - 1):
            u = min(-before / bend, 1.0) if i == 0 else max(-before / bend, 0.0)
            far, _, _ = compute_squared_distance(floats, p, u, x, y, z)
            if far < best:
                best = far
                s = i + u
            continue
        away = (
            math.sqrt(far) - floats[p + 12]
        )  # no point is nearer than the ball that contains the piece
        if away > 0.0 and away * away >= best:
            continue
        for k in range(SAMPLES):
            if far < best:
                best = far
                s = i + k / SAMPLES
            far, after, _ = compute_squared_distance(floats, p, (k + 1) / SAMPLES, x, y, z)
            if before < 0.0 and after > 0.0:
                u = refine_parameter(floats, p, k / SAMPLES, (k + 1) / SAMPLES, x, y, z)
                least, _, _ = compute_squared_distance(floats, p, u, x, y, z)
                if least < best:
                    best = least
                    s = i + u
            before = after
    return s


@device
def locate_node(ints, at, i):
    """Return the index in `ints` of the node at place i."""
    return at + TAPE_HEAD + ints[at + N_OUTPUTS] + NODE_INTS * (i - ints[at + N_INPUTS])


@routine
def evaluate_function(op, x):
    """Return the function `op` of one number, or NaN where its value is not finite."""
    if op == SIN:
        return math.sin(x)
    if op == COS:
        return math.cos(x)
    if op == SQRT:
        return math.sqrt(x) if x >= 0.0 else math.nan
    if op == EXP:
        return math.exp(x)
    if op == LOG:
        return math.log(x) if x > 0.0 else math.nan
    if op == TAN:
        return math.tan(x)
    if op == ASIN:
        return math.asin(x) if abs(x) <= 1.0 else math.nan
    if op == ACOS:
        return math.acos(x) if abs(x) <= 1.0 else math.nan
    if op == ATAN:
        return math.atan(x)
    if op == SINH:
        return math.sinh(x)
    if op == COSH:
        return math.cosh(x)
    if op == TANH:
        return math.tanh(x)
    if op == ASINH:
        return math.asinh(x)
    if op == ACOSH:
        return math.acosh(x) if x >= 1.0 else math.nan
    if op == ATANH:
        return math.atanh(x) if abs(x) < 1.0 else math.nan
    return math.nan


@routine
def evaluate_leaf(ints, at, floats, fat, i, width, work):
    """Return the value of a node without rates, or of the node NEAREST; operands are at `width`
    times their place.
    """
    k = locate_node(ints, at, i)
    op = ints[k + OP]
    left = ints[k + LEFT]
    right = ints[k + RIGHT]
    if op == NUMBER:
        return floats[fat + left]
    if op == LOOKUP:
        table = locate_node(ints, at, right)
        return find_table_entry(
            floats, fat + ints[table + LEFT], ints[table + RIGHT], work[width * left]
        )
    if op != NEAREST:
        return 0.0
    second = locate_node(ints, at, left)
    first = locate_node(ints, at, ints[second + LEFT])
    table = locate_node(ints, at, ints[first + LEFT])
    x = work[width * ints[first + RIGHT]]
    y = work[width * ints[second + RIGHT]]
    z = work[width * right]
    return find_nearest_parameter(floats, fat + ints[table + LEFT], ints[table + RIGHT], x, y, z)


@routine
def evaluate_nodes(ints, at, floats, fat, work):
    """Fill work[: n_nodes] with the values of all nodes; work[: n_inputs] holds the inputs."""
    n = ints[at + N_INPUTS]
    for i in range(n, ints[at + N_NODES]):
        k = locate_node(ints, at, i)
        op = ints[k + OP]
        left = ints[k + LEFT]
        right = ints[k + RIGHT]
        if op == ADD:
            work[i] = work[left] + work[right]
        elif op == SUB:
            work[i] = work[left] - work[right]
        elif op == MUL:
            work[i] = work[left] * work[right]
        elif op == DIV:
            work[i] = work[left] / work[right]
        elif op == POW:
            work[i] = work[left] ** work[right]
        elif op == NEG:
            work[i] = -work[left]
        elif op == ATAN2:
            work[i] = math.atan2(work[left], work[right])
        elif op == HYPOT:
            work[i] = math.hypot(work[left], work[right])
        elif op > NEAREST:
            work[i] = evaluate_function(op, work[left])
        else:
            work[i] = evaluate_leaf(ints, at, floats, fat, i, 1, work)


@routine
def compute_power_rates(ints, at, i, right, base, exponent, value):
    """Return the derivatives of base ** exponent by both; zero by an exponent that is a constant."""
    by_base = exponent * base ** (exponent - 1.0) if exponent != 0.0 else 0.0 * base
    if right >= ints[at + N_INPUTS] and ints[locate_node(ints, at, right)] == NUMBER:
        return by_base, 0.0
    return by_base, value * math.log(base) if base > 0.0 else math.nan


@routine
def write_gradient(ints, at, floats, fat, output, work, adjoint):
    """Write the gradient of an output by the inputs to adjoint[: n_inputs]; `work` holds the values
    of all nodes.

    `adjoint` has room for 2 n_nodes numbers; its second half says which nodes the output is
    computed from: of all others the derivatives, which may be infinite, have no part in it.
    """
    n = ints[at + N_INPUTS]
    last = ints[at + TAPE_HEAD + output]
    marks = ints[at + N_NODES]
    for i in range(max(n, last + 1)):
        adjoint[i] = 0.0
        adjoint[marks + i] = 0.0
    adjoint[last] = 1.0
    adjoint[marks + last] = 1.0
    for i in range(last, n - 1, -1):
        k = locate_node(ints, at, i)
        op = ints[k + OP]
        left = ints[k + LEFT]
        right = ints[k + RIGHT]
        a = adjoint[i]
        if adjoint[marks + i] == 0.0 or op == NUMBER or op == TABLE or op == LOOKUP:
            continue
        adjoint[marks + left] = 1.0
        if op < NEG or ATAN2 <= op <= NEAREST:
            adjoint[marks + right] = 1.0
        if op == ADD:
            adjoint[left] += a
            adjoint[right] += a
        elif op == SUB:
            adjoint[left] += a
            adjoint[right] -= a
        elif op == MUL:
            adjoint[left] += a * work[right]
            adjoint[right] += a * work[left]
        elif op == DIV:
            adjoint[left] += a / work[right]
            adjoint[right] -= a * work[i] / work[right]
        elif op == POW:
            by_base, by_exponent = compute_power_rates(
                ints, at, i, right, work[left], work[right], work[i]
            )
            adjoint[left] += a * by_base
            adjoint[right] += a * by_exponent
        elif op == NEG:
            adjoint[left] -= a
        elif op <= NEAREST:
            adjoint[left] += a * work[ints[k + NODE_INTS + LEFT]]
            adjoint[right] += a * work[ints[k + NODE_INTS + RIGHT]]
        else:
            adjoint[left] += a * (work[right] + 0.0 * work[i])  # none where there is no value


@device
def compute_product_order(k, width, series, left, right):
    """Return coefficient k of the Taylor series of a product."""
    total = 0.0
    for j in range(k + 1):
        total += series[width * left + j] * series[width * right + k - j]
    return total


@device
def compute_chain_order(k, width, series, operand, derivative):
    """Return coefficient k > 0 of the Taylor series of a function, from those of its operand and of
    its derivative.
    """
    total = 0.0
    for j in range(1, k + 1):
        total += j * series[width * operand + j] * series[width * derivative + k - j]
    return total / k


@routine
def compute_power_order(k, width, series, i, left, right):
    """Return coefficient k > 0 of the Taylor series of a power with a constant exponent;
    coefficient 0 is known.

    A base that begins at order m is t^m u(t), and its power t^(m c) u^c; c u' w = u w' holds for w
    = u^c.
    """
    c = series[width * right]
    for j in range(1, k + 1):
        if series[width * right + j] != 0.0:
            return math.nan
    if c == 0.0:
        return 0.0 * series[width * left + k]
    m = 0
    if c > 0.0 and c == math.floor(c):
        while m <= k and series[width * left + m] == 0.0:
            m += 1
        if m > k:
            return 0.0
    u = width * left + m
    w = width * i + m * int(c)
    n = k - m * int(c)  # the order of u^c that is requested
    if m > 0 and n <= 0:
        return series[u] ** c if n == 0 else 0.0
    total = 0.0
    for j in range(1, n + 1):
        total += (c * j - (n - j)) * series[u + j] * series[w + n - j]
    return total / (n * series[u])


@routine
def write_tape_order(ints, at, floats, fat, k, width, series):
    """Write coefficient k of the Taylor series of all nodes, to series[width * place + k].

    Orders 0 ... k of the inputs and orders 0 ... k - 1 of the nodes are there; width is at least k
    + 1.
    """
    n = ints[at + N_INPUTS]
    for i in range(n, ints[at + N_NODES]):
        p = locate_node(ints, at, i)
        op = ints[p + OP]
        left = ints[p + LEFT]
        right = ints[p + RIGHT]
        y = width * i + k
        a = width * left + k
        b = width * right + k
        if op == ADD:
            series[y] = series[a] + series[b]
        elif op == SUB:
            series[y] = series[a] - series[b]
        elif op == NEG:
            series[y] = -series[a]
        elif op == MUL:
            series[y] = compute_product_order(k, width, series, left, right)
        elif op == DIV:
            total = series[a]
            for j in range(1, k + 1):
                total -= series[width * right + j] * series[y - j]
            series[y] = total / series[width * right]
        elif op == POW:
            if k == 0:
                series[y] = series[a] ** series[b]
            else:
                series[y] = compute_power_order(k, width, series, i, left, right)
        elif k == 0 and (op == ATAN2 or op == HYPOT):
            series[y] = (
                math.atan2(series[a], series[b])
                if op == ATAN2
                else math.hypot(series[a], series[b])
            )
        elif op <= NEAREST:
            if k == 0:
                series[y] = evaluate_leaf(ints, at, floats, fat, i, width, series)
            elif op < ATAN2:
                series[y] = 0.0
            else:
                first = ints[p + NODE_INTS + LEFT]
                second = ints[p + NODE_INTS + RIGHT]
                series[y] = compute_chain_order(
                    k, width, series, left, first
                ) + compute_chain_order(k, width, series, right, second)
        elif k == 0:
            series[y] = evaluate_function(op, series[a])
        else:
            series[y] = compute_chain_order(k, width, series, left, right) + 0.0 * series[y - k]


@kernel(I("_"), F("_"), F("N", "n"), OUT("N", "m"), OUT("N", "m", "n"), returns=False)
def evaluate_tape_gradients(ints, floats, inputs, values, gradients):
    """Write the outputs of a tape at N points, and their gradients by the n inputs."""
    ints_ = get_pointer(ints)
    floats_ = get_pointer(floats)
    n = ints[N_INPUTS]
    scratch = np.empty(3 * ints[N_NODES] + 1)
    work = scratch[: ints[N_NODES]]
    adjoint = scratch[ints[N_NODES] :]
    work_ = get_pointer(work)
    adjoint_ = get_pointer(adjoint)
    for b in range(inputs.shape[0]):
        for i in range(n):
            work[i] = inputs[b, i]
        evaluate_nodes(ints_, 0, floats_, 0, work_)
        for o in range(ints[N_OUTPUTS]):
            values[b, o] = work[ints[TAPE_HEAD + o]]
            write_gradient(ints_, 0, floats_, 0, o, work_, adjoint_)
            for i in range(n):
                gradients[b, o, i] = adjoint[i]
    keep_alive(scratch)


@kernel(I("_"), F("_"), INT, F("N", "n", "k"), OUT("N", "m", "k"), returns=False)
def evaluate_tape_series(ints, floats, order, inputs, outputs):
    """Write orders 0 ... order, which is below k, of the outputs of a tape along N curves given by
    their series.
    """
    ints_ = get_pointer(ints)
    floats_ = get_pointer(floats)
    n = ints[N_INPUTS]
    width = inputs.shape[2]
    series = np.empty(ints[N_NODES] * width + 1)
    series_ = get_pointer(series)
    for b in range(inputs.shape[0]):
        for i in range(n):
            for k in range(width):
                series[width * i + k] = inputs[b, i, k]
        for k in range(order + 1):
            write_tape_order(ints_, 0, floats_, 0, k, width, series_)
        for o in range(ints[N_OUTPUTS]):
            for k in range(order + 1):
                outputs[b, o, k] = series[width * ints[TAPE_HEAD + o] + k]
    keep_alive(series)


@kernel(I("_"), F("_"), F("N", "n"), OUT("N", "m"), returns=False)
def evaluate_tape_outputs(ints, floats, inputs, values):
    """Write the outputs of a tape at N points."""
    ints_ = get_pointer(ints)
    floats_ = get_pointer(floats)
    n = ints[N_INPUTS]
    block = np.empty(ints[N_NODES] + 1)
    work = get_pointer(block)
    for b in range(inputs.shape[0]):
        for i in range(n):
            work[i] = inputs[b, i]
        evaluate_nodes(ints_, 0, floats_, 0, work)
        for o in range(ints[N_OUTPUTS]):
            values[b, o] = work[ints[TAPE_HEAD + o]]
    keep_alive(block)
