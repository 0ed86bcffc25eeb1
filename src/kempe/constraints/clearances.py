"""Constraint that bodies keep a distance from one another, by their collision shapes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NoReturn, TypeAlias

from kempe.arrays import is_sequence
from kempe.constraints.base import Constraint, check_constant, kind, read_nonnegative_numbers
from kempe.errors import InputError, UnsupportedError

SELF = "self"
"""All pairs of bodies that may touch."""

BodyNames: TypeAlias = str | Sequence[str] | None
"""A field of one body, or of several."""


class Apart(Constraint):
    """Base of constraints on the distances of bodies, which shapes give and no equations.

    `a` and `b` name the bodies, `at_least` their distance.
    """

    a: BodyNames
    b: BodyNames
    at_least: float

    def list_side(self, bodies: Any) -> tuple[Any, ...]:
        """List the names of one side; none where the side is open."""
        return () if bodies is None else tuple(bodies) if is_sequence(bodies) else (bodies,)

    @property
    def sides(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of the bodies on each side; () for all of them."""
        a: Any = self.a
        return () if a == SELF else self.list_side(a), self.list_side(self.b)

    def list_rows(self, dim: int) -> NoReturn:
        """Refuse: a clearance has no equations. Errors: `UnsupportedError`."""
        raise UnsupportedError(
            f"{self.label} is for ik and ik_step among their tasks, for ik_all, ik_path, drive "
            "and trace by clearance=, not here: `system.geometry.clearance` measures the distance of "
            "any configuration"
        )


@kind("clearance", says="{a} and {b} keep at least {at_least} m apart")
class Clearance(Apart):
    """Demand that bodies keep a distance, by their collision shapes.

    Parameters
    ----------
    a
        Name of a body, an obstacle included, or a list of names. With "self", all pairs of
        `system.geometry.pairs`, obstacles included (default).
    b
        The body or the bodies that `a` keeps away from (default: all that `a` may touch).
    at_least
        Least distance in metres (default: 0, where bodies may touch).

    Raises
    ------
    InputError
        If the distance is negative or not finite, or `weight`, `priority` or `tolerance` is given.

    Notes
    -----
    Between two bodies by name, this pair counts. Between several, those pairs of
    `system.geometry.pairs` count that have a body of each side: neighbours do not. It needs the
    extra [collision] (coal measures the distances).

    Examples
    --------
    >>> import kempe
    >>> from kempe.constraints import Clearance
    >>> print(Clearance("hand", "table", at_least=0.05).sentence)
    'hand' and 'table' keep at least 0.05 m apart
    """

    a: BodyNames = SELF
    b: BodyNames = None
    at_least: float = 0.0

    unbounded: ClassVar[str] = "a clearance has no upper bound; Distance has both"

    def __post_init__(self) -> None:
        for name in ("weight", "priority", "tolerance"):
            if getattr(self, name) != getattr(Constraint, name):
                raise InputError(f"{self.label} has a {name}; it always holds: leave it out")
        for side, bodies in (("a", self.a), ("b", self.b)):
            names = self.list_side(bodies)
            if not all(isinstance(n, str) for n in names) or (bodies is not None and not names):
                raise InputError(
                    f"{side} of Clearance is {bodies!r}; it must be the name of a body, or a list "
                    "of names"
                )
        if self.b is not None and SELF in (self.a, self.b):
            raise InputError("Clearance of 'self' is between all bodies: leave b out")
        what = f"at_least of {self.label}"
        given = check_constant(read_nonnegative_numbers(self.at_least, what), what)
        object.__setattr__(self, "at_least", float(given))

    @property
    def subject(self) -> str:
        """The bodies that keep apart, as text."""
        first, second = (", ".join(map(repr, side)) for side in self.sides)
        if not first:
            return "all bodies"
        return f"{first} and {second or 'all other bodies'}"

    @property
    def sentence(self) -> str:
        """The constraint as one plain sentence, with its bodies and its distance."""
        return f"{self.subject} keep at least {self.at_least:g} m apart"
