"""A kind of constraint that Kempe does not ship: one class and one row, in a module of its own."""

from __future__ import annotations

from kempe.constraints import Constraint, Op, Row, kind
from kempe.constraints.base import Frame, Number
from kempe.constraints.text import parse_tape

CURVE = parse_tape(["(x/a)^2 + (y/b)^2 - 1"], ("x", "y", "a", "b"))


@kind("on_ellipse", "line", "{frame} is on an ellipse of {other}")
class OnEllipse(Constraint):
    """The origin of a frame on an ellipse of half axes `a` and `b` along x and y."""

    frame: Frame
    a: Number
    b: Number
    other: Frame | None = None

    def list_rows(self, dim: int) -> tuple[Row, ...]:
        """The curve."""
        return (Row(Op.TAPE, (CURVE, 0), "ellipse", "1"),)
