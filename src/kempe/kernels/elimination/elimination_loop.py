"""The loop equations of a chain of six joints with one joint removed, and the six equations without
the pair.

A solution closes the loop E_1 ... E_6 G^-1 = 1. Without joint r it says that the product of the
other five carries r's line, seen from one side, onto the same line, seen from the other. Of the
five, three ("the triple") act on one line, two ("the pair") on the other:

    X_1 X_2 X_3 source = Y_2^-1 Y_1^-1 target

Of a line through p along l both sides compare fourteen numbers: l, p, p x l, p.p, p.l, (p.p) l - 2
(p.l) p (Raghavan and Roth 1990, "Kinematic analysis of the 6R manipulator of general geometry";
1993, "Inverse kinematics of the general 6R manipulator and related linkages"). With 1 they span a
representation of the rigid motions. So each is linear in (1, cos, sin) of every turn, and of degree
two in every slide: three samples a joint determine it, and nothing needs to be derived. A slide
cannot be the removed joint: it leaves no line in place.

Formulations: 18 direction + 6 hidden + removed, where `removed` counts joints from 0, `hidden` says
which joint of the triple stays in the eigenproblem, and `direction` whether the pair comes right
after the removed joint (0) or before it.
"""

from __future__ import annotations

import math

from kempe.kernels.base._jit import device, routine
from kempe.kernels.base.scratch import advance_pointer
from kempe.kernels.base.vectors import LANES, load_lanes, spread_lanes, store_value
from kempe.kernels.forward.table_layout import SLIDE

LINE_STRIDE = 8
"""Numbers of a joint's line: direction (3), 0, point (3), 0."""

NUMBER = 3
IS_SLIDE = 7
"""Places in a line of the loop, where the zeros were: number of the joint, and whether it
slides."""

PAIR = 0
TRIPLE = 16
SOURCE = 40
TARGET = 48
"""Places in the loop: lines Y_1, Y_2, lines X_1, X_2, X_3, and the removed joint's line seen from
both sides."""

LOOP_SIZE = 56

EQUATIONS = 14
SAMPLES = 0
DIFFERENCES = 32
SAMPLE_STRIDE = 40
"""The table of samples: a row an equation; its 27 samples of the triple, then eight differences of
the pair's."""

FANS = 6 * (3 + 9 + 27)
FANS_SIZE = 6 * (3 + 9 + 27) + 16
"""Numbers of the sampled lines, and with what the pair's first sample needs."""


@device
def find_removed_joint(formulation):
    """Return the number of the joint that the formulation removes."""
    return formulation % 6


@device
def find_hidden_joint(formulation):
    """Return which joint of the triple stays in the eigenproblem: 0, 1 or 2."""
    return formulation // 6 % 3


@device
def _copy_line(lines, i, sign, loop, k):
    """Write line i with its direction times `sign` to loop[k:]."""
    for j in range(3):
        loop[k + j] = sign * lines[LINE_STRIDE * i + j]
        loop[k + 4 + j] = lines[LINE_STRIDE * i + 4 + j]


@device
def _move_line_back(goal, loop, k):
    """Move the line loop[k:] by the inverse of the goal."""
    hx = loop[k]
    hy = loop[k + 1]
    hz = loop[k + 2]
    ox = loop[k + 4] - goal[3]
    oy = loop[k + 5] - goal[7]
    oz = loop[k + 6] - goal[11]
    for j in range(3):
        loop[k + j] = goal[j] * hx + goal[4 + j] * hy + goal[8 + j] * hz
        loop[k + 4 + j] = goal[j] * ox + goal[4 + j] * oy + goal[8 + j] * oz


@routine
def arrange_loop(kinds, lines, goal, formulation, loop):
    """Write the loop of this formulation (LOOP_SIZE numbers).

    Joints before the removed one come after the goal's inverse, which is moved to the right through
    them. The loop walked backwards is a loop again: of inverse motions, hence of flipped lines.
    """
    removed = find_removed_joint(formulation)
    backwards = formulation // 18 == 1
    sign = -1.0 if backwards else 1.0
    for place in range(5):
        i = (removed + 1 + place) % 6
        k = LINE_STRIDE * (4 - place if backwards else place)
        _copy_line(lines, i, sign, loop, k)
        if i < removed:
            _move_line_back(goal, loop, k)
        loop[k + NUMBER] = float(i)
        loop[k + IS_SLIDE] = 1.0 if kinds[i] == SLIDE else 0.0
    near, far = (SOURCE, TARGET) if backwards else (TARGET, SOURCE)
    _copy_line(lines, removed, 1.0, loop, near)
    _copy_line(lines, removed, 1.0, loop, far)
    _move_line_back(goal, loop, far)


@routine
def write_fan(line, sign, here, there):
    """Write three positions of the line here (l, p: 6 numbers), moved by a joint, to `there`: at 0,
    pi/2 and pi, or at 0, 1 and -1.
    """
    hx = sign * line[0]
    hy = sign * line[1]
    hz = sign * line[2]
    lx = here[0]
    ly = here[1]
    lz = here[2]
    px = here[3]
    py = here[4]
    pz = here[5]
    there[0] = lx
    there[1] = ly
    there[2] = lz
    there[3] = px
    there[4] = py
    there[5] = pz
    if line[IS_SLIDE] != 0.0:
        there[6] = lx
        there[7] = ly
        there[8] = lz
        there[9] = px + hx
        there[10] = py + hy
        there[11] = pz + hz
        there[12] = lx
        there[13] = ly
        there[14] = lz
        there[15] = px - hx
        there[16] = py - hy
        there[17] = pz - hz
        return
    ox = line[4]
    oy = line[5]
    oz = line[6]
    along = hx * lx + hy * ly + hz * lz
    there[6] = along * hx + (hy * lz - hz * ly)
    there[7] = along * hy + (hz * lx - hx * lz)
    there[8] = along * hz + (hx * ly - hy * lx)
    there[12] = 2.0 * along * hx - lx
    there[13] = 2.0 * along * hy - ly
    there[14] = 2.0 * along * hz - lz
    px = px - ox
    py = py - oy
    pz = pz - oz
    along = hx * px + hy * py + hz * pz
    there[9] = ox + along * hx + (hy * pz - hz * py)
    there[10] = oy + along * hy + (hz * px - hx * pz)
    there[11] = oz + along * hz + (hx * py - hy * px)
    along *= 2.0
    there[15] = ox + along * hx - px
    there[16] = oy + along * hy - py
    there[17] = oz + along * hz - pz


@routine
def write_line_numbers(line, out, stride):
    """Write the fourteen numbers of a line (l, p: 6 numbers) in the loop equations to `out`,
    `stride` apart.
    """
    lx = line[0]
    ly = line[1]
    lz = line[2]
    px = line[3]
    py = line[4]
    pz = line[5]
    pp = px * px + py * py + pz * pz
    pl = px * lx + py * ly + pz * lz
    out[0] = lx
    out[stride] = ly
    out[2 * stride] = lz
    out[3 * stride] = px
    out[4 * stride] = py
    out[5 * stride] = pz
    out[6 * stride] = py * lz - pz * ly
    out[7 * stride] = pz * lx - px * lz
    out[8 * stride] = px * ly - py * lx
    out[9 * stride] = pp
    out[10 * stride] = pl
    out[11 * stride] = pp * lx - 2.0 * pl * px
    out[12 * stride] = pp * ly - 2.0 * pl * py
    out[13 * stride] = pp * lz - 2.0 * pl * pz


@routine
def write_line(loop, k, out):
    """Write direction and point of the line loop[k:] side by side."""
    for j in range(3):
        out[j] = loop[k + j]
        out[3 + j] = loop[k + 4 + j]


@routine
def sample_loop(loop, fans, table):
    """Fill the table: samples 9 i3 + 3 i2 + i1 of the triple, and eight of the pair, all less the
    pair's first.
    """
    write_line(loop, TARGET, fans)
    write_fan(advance_pointer(loop, PAIR), -1.0, fans, advance_pointer(fans, 6))
    for i in range(3):
        write_fan(
            advance_pointer(loop, PAIR + LINE_STRIDE),
            -1.0,
            advance_pointer(fans, 6 + 6 * i),
            advance_pointer(fans, 24 + 18 * i),
        )
    constant = advance_pointer(fans, FANS)
    write_line_numbers(advance_pointer(fans, 24), constant, 1)
    for i in range(1, 9):
        write_line_numbers(
            advance_pointer(fans, 24 + 6 * i),
            advance_pointer(table, DIFFERENCES + i - 1),
            SAMPLE_STRIDE,
        )
    write_line(loop, SOURCE, fans)
    write_fan(
        advance_pointer(loop, TRIPLE + 2 * LINE_STRIDE), 1.0, fans, advance_pointer(fans, 27 * 6)
    )
    for i in range(3):
        write_fan(
            advance_pointer(loop, TRIPLE + LINE_STRIDE),
            1.0,
            advance_pointer(fans, (27 + i) * 6),
            advance_pointer(fans, (30 + 3 * i) * 6),
        )
    for i in range(9):
        write_fan(
            advance_pointer(loop, TRIPLE),
            1.0,
            advance_pointer(fans, (30 + i) * 6),
            advance_pointer(fans, 18 * i),
        )
    for i in range(27):
        write_line_numbers(advance_pointer(fans, 6 * i), advance_pointer(table, i), SAMPLE_STRIDE)
    for e in range(EQUATIONS):
        for c in range(0, SAMPLE_STRIDE, LANES):
            k = e * SAMPLE_STRIDE + c
            store_value(table, k, load_lanes(table, k) - constant[e])


@routine
def remove_pair(table, v):
    """Turn the last six rows of the table into equations of the triple alone. v: scratch, 14
    numbers.

    Reflections (Householder 1958) make the eight differences upper triangular: below, the pair has
    vanished.
    """
    for k in range(8):
        rest = 0.0
        first = table[k * SAMPLE_STRIDE + DIFFERENCES + k]
        for e in range(k + 1, EQUATIONS):
            v[e] = table[e * SAMPLE_STRIDE + DIFFERENCES + k]
            rest += v[e] * v[e]
        size = math.sqrt(first * first + rest)
        if not size > 0.0:
            continue
        v[k] = first + (size if first > 0.0 else -size)
        scale = 1.0 / (size * abs(v[k]))
        for c in range(0, SAMPLE_STRIDE, LANES):
            sum_ = spread_lanes(0.0)
            for e in range(k, EQUATIONS):
                sum_ = sum_ + v[e] * load_lanes(table, e * SAMPLE_STRIDE + c)
            sum_ = sum_ * scale
            for e in range(k, EQUATIONS):
                i = e * SAMPLE_STRIDE + c
                store_value(table, i, load_lanes(table, i) - v[e] * sum_)
