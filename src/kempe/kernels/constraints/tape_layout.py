"""Where the numbers of a tape lie: a recorded expression as a small program. Imports nothing, like
`table_layout`.

    ints     N_INPUTS, N_NODES, N_OUTPUTS; then the places of the outputs; then three integers for each node that is
             no input: its operation, left, right
    floats   the numbers that nodes refer to

Places count inputs first, then nodes. What left and right are is said by the operation:

    NUMBER               left: index of the number
    ADD SUB MUL DIV      left, right: places of the operands
    POW                  left: base; right: exponent, which is constant along curves
    NEG                  left: operand
    PARTIALS             left, right: places of the derivatives of the node before by its left and right operand
    TABLE                left, right: index of the first of some numbers, and how many they are
    LOOKUP               left: a parameter s; right: a table, whose entry floor(s) it is, the first or last beyond
    EXP and beyond       functions of one operand, left; right: place of the derivative, which may come later
    ATAN2, HYPOT         functions of two operands; the node after is their PARTIALS
    AT, NEAREST          the same: NEAREST(AT(AT(table, x), y), z) is the parameter of the point of a curve that is
                         nearest to (x, y, z); what lies between has no value of its own, only rates

The table of a curve is 1 where its first and last piece go on without end, else 0; then PIECE
numbers for each piece: four coefficients of its polynomial for each of x, y, z, and the radius of a
ball about its start that contains it. Piece i is for parameters from i to i + 1.
"""

N_INPUTS = 0
N_NODES = 1
N_OUTPUTS = 2
TAPE_HEAD = 3
NODE_INTS = 3
"""Where the places of the outputs begin, and the integers of a node."""

OP = 0
LEFT = 1
RIGHT = 2
"""Places in a node."""

NUMBER, ADD, SUB, MUL, DIV, POW, NEG, PARTIALS, TABLE, LOOKUP = range(10)
ATAN2, HYPOT, AT, NEAREST = range(10, 14)
EXP, LOG, SQRT, SIN, COS, TAN, ASIN, ACOS, ATAN, SINH, COSH, TANH, ASINH, ACOSH, ATANH = range(
    14, 29
)
"""Operations."""

PIECE = 13
"""Numbers of a piece of a curve."""
