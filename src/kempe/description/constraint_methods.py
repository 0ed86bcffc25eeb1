"""The methods of `Mechanism` that declare constraints: what always holds besides the joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from kempe import constraints
from kempe.constraints.base import Constraint
from kempe.description.constrain import between, declare
from kempe.description.parts import Body, Declared, Frame
from kempe.errors import Where
from kempe.values import Value

BodyLike = Body | str


class ConstraintMethods:
    """Base of `Mechanism`: constraints that are not joints, by their kinds and by name."""

    def constrain(
        self: Any, constraint: Constraint, name: str = "", where: Where | None = None
    ) -> Declared:
        """A constraint of `kempe.constraints` that always holds, between frames or bodies of the
        mechanism.

        Numbers may be expressions in parameters. It is no connection: the bodies need joints
        besides, `free` where nothing else holds them. What only `ik` reads (`weight`, `priority`,
        `tolerance`) is refused. Errors: `DescriptionError` with what is wrong and what is allowed.
        """
        return declare(self, constraint, name, where)

    def distance(
        self: Any,
        name: str,
        a: BodyLike | Frame,
        b: BodyLike | Frame,
        length: Value | str,
        at: object = (0.0, 0.0, 0.0),
        child_at: object = (0.0, 0.0, 0.0),
        where: Where | None = None,
    ) -> Declared:
        """A rod of this length, hinged in all directions, from point `at` on `a` to point
        `child_at` on `b`.

        `a` and `b` are bodies or frames; points are read in their axes, or are names of frames on
        them. The rod is no connection: both bodies need joints besides, `free` where nothing else
        holds them.
        """
        return between(self, name, "distance", (a, at, {}), (b, child_at, {}), length, where)

    def point_on_line(
        self: Any,
        name: str,
        a: BodyLike | Frame,
        b: BodyLike | Frame,
        at: object = (0.0, 0.0, 0.0),
        child_at: object = (0.0, 0.0, 0.0),
        where: Where | None = None,
        **turn: Any,
    ) -> Declared:
        """Point `child_at` of `b` stays on the line through `at` of `a` along z (or `axis`, as in
        `joint`).
        """
        return between(self, name, "point_on_line", (a, at, turn), (b, child_at, {}), None, where)

    def point_on_plane(
        self: Any,
        name: str,
        a: BodyLike | Frame,
        b: BodyLike | Frame,
        at: object = (0.0, 0.0, 0.0),
        child_at: object = (0.0, 0.0, 0.0),
        where: Where | None = None,
        **turn: Any,
    ) -> Declared:
        """Point `child_at` of `b` stays in the plane through `at` of `a` across z (or `axis`, as in
        `joint`).
        """
        return between(self, name, "point_on_plane", (a, at, turn), (b, child_at, {}), None, where)

    def no_sideslip(
        self: Any, name: str, frame: BodyLike | Frame, speed: Value | str = 0.0
    ) -> Declared:
        """The origin of a frame has no velocity along its y axis, as a wheel whose axle is y, or
        has the `speed`.
        """
        return self.constrain(constraints.NoSideslip(str(frame), speed=speed), name)

    def rolls(
        self: Any,
        name: str,
        frame: BodyLike | Frame,
        radius: Value | str,
        on: BodyLike | Frame | None = None,
        shape: str = "ball",
        spin: bool = True,
        one_sided: bool = False,
    ) -> Declared:
        """A ball or disc about a frame's origin rolls without slipping on the xy-plane of `on`
        (default: the ground).

        The axle of a disc is y of its frame. Without `spin` it does not turn about the normal
        either; `one_sided`: it may leave the plane.
        """
        other = None if on is None else str(on)
        return self.constrain(
            constraints.Rolls(str(frame), other, radius, shape, spin, one_sided), name
        )

    def contact(
        self: Any,
        name: str,
        frame: BodyLike | Frame,
        on: BodyLike | Frame | None = None,
        radius: Value | str = 0.0,
        shape: str = "ball",
    ) -> Declared:
        """A point, or a ball or disc about a frame's origin, stays above the xy-plane of `on`
        (default: the ground).
        """
        return self.constrain(
            constraints.Contact(str(frame), None if on is None else str(on), radius, shape), name
        )

    def equation(
        self: Any,
        name: str,
        expression: str | Sequence[str] | Callable[..., Any],
        of: Sequence[str] = (),
        time: bool = False,
    ) -> Declared:
        """An equation f = 0 of coordinates, or several: ``"A = 2*B"``, or a function of the
        coordinates named in `of`.

        A function is called with a mapping from these names to numbers, with `time` also with the
        time t. Text finds its coordinates itself; other names are parameters.
        """
        return self.constrain(constraints.Equation(expression, of, time, name=name), name)

    def inequality(
        self: Any,
        name: str,
        expression: str | Sequence[str] | Callable[..., Any],
        of: Sequence[str] = (),
        time: bool = False,
    ) -> Declared:
        """An inequality f >= 0 of coordinates, or several, as `equation` takes it: ``"1.2 - A"``."""
        return self.constrain(constraints.Inequality(expression, of, time, name=name), name)

    def velocity_equation(
        self: Any,
        name: str,
        matrix: Sequence[Sequence[Any]] | Callable[..., Any],
        of: Sequence[str],
        b: Any = 0,
        time: bool = False,
    ) -> Declared:
        """Rows A(q) v = b(q, t) over the velocities of the coordinates named in `of`:
        ``[["-y^2", 0, 1]]``.

        `matrix` holds numbers and texts, or is a function that returns rows; so is `b`, one number
        for each row.
        """
        return self.constrain(constraints.VelocityEquation(matrix, of, b, time, name=name), name)
