"""How a program that solves dyads lies in arrays. Imports nothing: whoever writes programs needs no
compiler.

A program is a pair of flat arrays, `ints` (int64) and `floats` (float64):

    ints    n_ops, n_vectors, n_registers, nq, n_known, n_signs, first coordinate, first target, first sign, 0, ...
            the coordinate that each known value is (n_known numbers)
            the operations, OP_INTS numbers each: code, then places of vectors
    floats  the operations, OP_FLOATS numbers each

The kernel keeps a block of configurations side by side; each number of a configuration is a vector,
and a place counts vectors: GAP and FLAG, two spare ones, MARGIN, the registers (a planar pose c, s,
x, y each, the cosine and sine of the orientation and the origin), the coordinates, their targets,
the branch signs, and a spare one.
"""

HEADER = 12
OP_INTS = 12
OP_FLOATS = 20

N_OPS, N_VECTORS, N_REGISTERS, NQ, N_KNOWN, N_SIGNS, COORDINATES, TARGETS, SIGNS = range(9)
"""Places in the header of `ints`."""

GAP = 0
FLAG = 1
SPARE = 2
MARGIN = 4
REGISTERS = 5
"""Places of vectors: the sum of squared openings, the count of undetermined parts, two to work
with, how far the dyad that is nearest to a meeting of its branches is from it (0 there, at most 1),
registers."""

SET = 0
ADD = 1
EXPECT_ZERO = 2
TURN = 3
SLIDE = 4
DIVIDE = 5
CARRY = 6
REBASE = 7
CIRCLES = 8
LINE_CIRCLE = 9
LINES = 10
PIN_PIN = 11
PIN_RAIL = 12
RAIL_RAIL = 13
READ_TURN = 14
READ_SLIDE = 15
"""Codes of operations; the functions of `dyads_program` say what each does and how its numbers
lie."""
