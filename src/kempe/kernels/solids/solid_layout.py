"""Where the numbers of solids lie.

    ints    a solid: output of the primitive table that carries it, form
            a pair:  first solid, second solid; a box is the second one
    floats  a solid: placement 3x4 on its output, three sizes, 0
            a pair:  what is taken off the distance of its cores, and off that of its centres

The core of a sphere is its centre, that of a capsule its segment; a ball about the core makes the
solid. A box is its own core. Off the distance of the cores go the radii and the distance that the
pair has to keep; the distance of the centres, less the second number, bounds what is left from
below.
"""

SOLID_INTS = 2
SOLID_FLOATS = 16
PAIR_INTS = 2
PAIR_FLOATS = 2

OUTPUT = 0
FORM = 1
"""Places in a solid of `ints`."""

SIZES = 12
"""Place in a solid of `floats`, after the placement."""

OFF_CORES = 0
OFF_CENTERS = 1
"""Places in a pair of `floats`."""

POINT = 0
SEGMENT = 1
BOX = 2
OTHER = 3
"""Forms of cores: no sizes; half the length, along z of the placement; three half sizes; a form of
which no pair is measured here."""
