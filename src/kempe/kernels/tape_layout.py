"""Where the numbers of a tape lie: a recorded expression as a small program. Imports nothing, like `layout`.

    ints     N_INPUTS, N_NODES, N_OUTPUTS; then the places of the outputs; then three integers for each node that is
             no input: its operation, left, right
    floats   the numbers that nodes refer to

Places count inputs first, then nodes. What left and right are is said by the operation:

    NUMBER               left: index of the number
    ADD SUB MUL DIV      left, right: places of the operands
    POW                  left: base; right: exponent, which is constant along curves
    NEG                  left: operand
    PARTIALS             left, right: places of the derivatives of the node before by its left and right operand
    EXP and beyond       functions of one operand, left; right: place of the derivative, which may come later
    ATAN2, HYPOT         functions of two operands; the node after is their PARTIALS
"""

N_INPUTS, N_NODES, N_OUTPUTS = 0, 1, 2
TAPE_HEAD, NODE_INTS = 3, 3
"""Where the places of the outputs begin, and the integers of a node."""

NUMBER, ADD, SUB, MUL, DIV, POW, NEG, PARTIALS = range(8)
ATAN2, HYPOT = 8, 9
EXP, LOG, SQRT, SIN, COS, TAN, ASIN, ACOS, ATAN, SINH, COSH, TANH, ASINH, ACOSH, ATANH = range(10, 25)
"""Operations."""
