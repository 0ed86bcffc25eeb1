"""Records of which a `Mechanism` consists, without kinematics."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from kempe.constraints.base import (
    Constraint,
    Op,
    evaluate_number_fields,
    is_one_sided,
    list_position_rows,
    make_content_key,
)
from kempe.errors import Where
from kempe.joints import Helical, JointType, P, R, Translation
from kempe.poses import Placement
from kempe.spatial import Array
from kempe.values import Expression, Value
from kempe.words import choose_verb, format_html_paragraphs, join_first_words, join_words

if TYPE_CHECKING:
    from kempe.description.shapes import Geometry

MOVES = {R: "turns about", P: "slides along"}
"""What elementary motions do to an axis."""

Limits = tuple[float, float]
"""Lower and upper bound of one velocity coordinate; an infinity where there is none."""


class ReadOnlyDict(dict[Any, Any]):
    """Dictionary of an immutable object, which refuses every change."""

    def _refuse_change(self, *_: Any, **__: Any) -> NoReturn:
        """Raise `TypeError` for every method that would change the dictionary."""
        raise TypeError(
            "this dict is read-only: nothing would change; change a Mechanism, or make another "
            "System by with_limits, with_parameters or lock"
        )

    __setitem__ = __delitem__ = __ior__ = update = setdefault = pop = popitem = clear = (
        _refuse_change  # type: ignore[assignment]
    )

    def __reduce__(self) -> tuple[Any, ...]:
        return ReadOnlyDict, (dict(self),)


class InSentence:
    """Base of records: notebooks show the `sentence` of a record, `repr` shows its fields."""

    @property
    def sentence(self) -> str:
        """Description of the record in one sentence."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        """Return the sentence as HTML for a notebook."""
        return format_html_paragraphs([self.sentence])


SAID = 4
"""Shapes of a body that its sentence names."""

USES = {(True, True): "", (True, False): " (visual)", (False, True): " (collision)"}
"""What a shape is for, in words, by `visual` and `collision`."""


@dataclass(frozen=True)
class Shape(InSentence):
    """Shape on a body, placed by `X_BS`, for drawings, for collisions, or for both.

    `color` is red, green, blue and opacity, each from 0 to 1; None is the colour of drawings.
    """

    geometry: Geometry
    X_BS: Placement = Placement()
    visual: bool = True
    collision: bool = True
    color: tuple[float, float, float, float] | None = None
    name: str = ""
    where: Where | None = field(default=None, compare=False, repr=False)

    @property
    def kind(self) -> str:
        """Name of the kind of shape, such as "box"."""
        return self.geometry.kind

    @property
    def sentence(self) -> str:
        """Description of the shape in one sentence.

        For instance "capsule of radius 0.04 m and length 0.4 m (collision), placed by z = 0.2".
        """
        named = f"{self.name}: " if self.name else ""
        placed = f", placed by {self.X_BS}" if self.X_BS.steps else ""
        return f"{named}{self}{placed}"

    def __str__(self) -> str:
        return f"{self.geometry}{USES[self.visual, self.collision]}"


@dataclass(frozen=True)
class Body(InSentence):
    """Rigid body, or particle: a body without orientation.

    A particle has 3 degrees of freedom in space, 2 in the plane.
    """

    name: str
    particle: bool = False
    mass: float | None = None
    center: tuple[float, float, float] | None = None
    shapes: tuple[Shape, ...] = ()
    where: Where | None = field(default=None, compare=False, repr=False)

    @property
    def sentence(self) -> str:
        """Description in words: "forearm: a rigid body, 2 kg, centre of mass at (0.1, 0, 0) m"."""
        kind = "a particle, a body without orientation" if self.particle else "a rigid body"
        mass = "" if self.mass is None else f", {self.mass:.6g} kg"
        at = (
            ""
            if self.center is None
            else f", centre of mass at ({', '.join(f'{x:.6g}' for x in self.center)}) m"
        )
        shapes = (
            f"; its shapes: {join_first_words(list(map(str, self.shapes)), SAID)}"
            if self.shapes
            else ""
        )
        return f"{self.name}: {kind}{mass}{at}{shapes}"

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Joint(InSentence):
    """Joint of any type between two bodies.

    Its frame F sits at `X_PF` on the parent, its frame M at `X_CM` on the child.

    `limits`, `velocity_limits` and `effort_limits` are by the joint's velocity coordinate names (''
    where there is one). `actuated` says that a motor drives it (True), that it is passive (False),
    or nothing (None); `cut` asks that, in a loop, this joint be left out of the spanning tree, over
    which `fk` goes; no answer of solvers depends on it. `unstated` marks limits that a file does
    not give, and that are zero by the rules of its format. `dim` is that of its mechanism, and
    `of_particle` says that the child is a particle.
    """

    name: str
    type: JointType
    parent: str
    child: str
    X_PF: Placement = Placement()
    X_CM: Placement = Placement()
    limits: dict[str, Limits] = field(default_factory=dict[str, Limits])
    velocity_limits: dict[str, float] = field(default_factory=dict[str, float])
    effort_limits: dict[str, float] = field(default_factory=dict[str, float])
    actuated: bool | None = None
    cut: bool = False
    where: Where | None = field(default=None, compare=False, repr=False)
    unstated: bool = field(default=False, compare=False, repr=False)
    dim: int = field(default=3, compare=False, repr=False)
    of_particle: bool = field(default=False, compare=False, repr=False)

    @property
    def sentence(self) -> str:
        """Description of the joint in words: type, bodies, axis, limits, actuation, constraints."""
        limits = (
            "" if not self.type.dof(self.dim, self.of_particle) else f", {self._describe_limits()}"
        )
        driven = {True: ", driven by a motor", False: ", passive", None: ""}[self.actuated]
        return (
            f"{self.name}: a {self.type.type_name} joint between {self.parent} and "
            f"{self.child}{self._describe_motion()}{limits}{driven}; {self.forbids()}"
        )

    def forbids(self, dim: int | None = None, particle: bool | None = None) -> str:
        """Return the forbidden motions in words: "B5 cannot slide along y or z, ...".

        Axes are those of the parent where the joint is aligned with them, else those of the joint's
        frame F. `dim` is 2 in a planar system; `particle` says that the child is a particle;
        without them it is as in the joint's mechanism. `JointType.forbids` has the names alone.
        """
        dim = self.dim if dim is None else dim
        particle = self.of_particle if particle is None else particle
        taken = self.type.constraints(dim, particle)
        whole = dim if particle else 3 * (dim - 1)
        names = [name for name in self.type.forbids(dim) if not (particle and name[0] == "r")]
        axes, of = self._name_axes(dim)
        groups = [
            sorted(axes[n[-1]] for n in names if (n[0] == "r") == turning)
            for turning in (False, True)
        ]
        if all(len(group) in (0, 3) for group in groups):
            of = self.parent
        parts = [
            f"{verb} {' or '.join(filter(None, (', '.join(group[:-1]), group[-1])))}"
            for verb, group in zip(("slide along", "turn about"), groups, strict=True)
            if group
        ]
        said = f"cannot {', nor '.join(parts)} of {of}" if parts else "can move freely"
        total = f"{taken} of {whole} freedoms {choose_verb(taken, 'is', 'are')} taken away"
        more = taken - len(names)
        more_said = f", {more} of them by a relation or about an axis that moves" if more else ""
        return f"{self.child} {said}: {total}{more_said}"

    def _name_axes(self, dim: int) -> tuple[dict[str, str], str]:
        """Return for x, y, z of frame F the parallel axis of the parent, and the parent's name.

        Where an axis is oblique, the axes are those of F itself.

        In the plane x of a joint that slides along z of F is its slide, as in `JointType.forbids`.
        """
        turns = Placement(tuple(step for step in self.X_PF.steps if step[0] not in ("x", "y", "z")))
        R = np.eye(3) if turns.names else turns.evaluate_pose({})[:3, :3]
        if dim == 2 and any(p.kind == P and p.axis == "z" for p in self.type.layout(2)[1]):
            rail = R[:, 2]
            R = np.stack([rail, np.cross((0.0, 0.0, 1.0), rail), (0.0, 0.0, 1.0)], axis=1)
        nearest = np.abs(R)
        if turns.names or not np.allclose(nearest, np.rint(nearest), atol=1e-9):
            return {name: name for name in "xyz"}, f"the frame of {self.name}"
        return {
            name: "xyz"[k] for name, k in zip("xyz", nearest.argmax(axis=0).tolist(), strict=True)
        }, self.parent

    def _describe_motion(self) -> str:
        """Return the motion in words: ", turns about -z of ground"; of several axes each motion."""
        kinds = [p.kind for p in self.type.layout(self.dim, self.of_particle)[1]]
        axes = {p.axis for p in self.type.layout(self.dim, self.of_particle)[1]}
        if not kinds:
            return ""
        if axes != {"z"} or not set(kinds) <= set(MOVES):
            moves = self.type.summary
            if isinstance(self.type, Translation):
                moves = "slide along x and y" if self.dim == 2 else "slide along x, y and z"
            ends = (
                f" (F is its frame on {self.parent}, M on {self.child})" if "of F" in moves else ""
            )
            frame = "" if ends or "any" in moves.split() else f" of its frame on {self.parent}"
            return f", which allows: {moves}{ends}{frame}"
        if isinstance(self.type, Helical):
            return f", screws along {self._describe_axis()} by {self.type.pitch:.6g} m a rad"
        return f", {' and '.join(MOVES[kind] for kind in kinds)} {self._describe_axis()}"

    def _describe_axis(self) -> str:
        """Return axis z of frame F as the parent sees it: "-z of ground", "(0.6, 0.8, 0) of arm"."""
        turns = Placement(tuple(step for step in self.X_PF.steps if step[0] not in ("x", "y", "z")))
        if turns.names:
            return f"z of its frame on {self.parent}"
        z = turns.evaluate_pose({})[:3, 2]
        k = int(np.abs(z).argmax())
        if abs(z[k]) > 1.0 - 1e-12:
            return f"{'-' if z[k] < 0 else ''}{'xyz'[k]} of {self.parent}"
        return (
            f"({', '.join(f'{x + 0.0:.4g}' for x in z[: self.dim].round(12).tolist())}) of "
            f"{self.parent}"
        )

    def _describe_limits(self) -> str:
        """Return the limits in words: "from -1 to 1 rad", by coordinate where there are several."""
        turning = self.type.list_turning_names(self.dim, self.of_particle)
        out: list[str] = []
        for name, (low, high) in self.limits.items():
            unit = "rad" if name in turning else "m"
            ends = [
                f"{word} {x:.6g}" for word, x in (("from", low), ("to", high)) if math.isfinite(x)
            ]
            out += [f"{name} {' '.join(ends)} {unit}".lstrip()] if ends else []
        return join_words(out) if out else "without limits"

    def __str__(self) -> str:
        return self.name

    def __hash__(self) -> int:
        return hash(self.name)


@dataclass(frozen=True)
class Frame(InSentence):
    """Named frame on a body."""

    name: str
    body: str
    X_BF: Placement = Placement()
    where: Where | None = field(default=None, compare=False, repr=False)

    @property
    def sentence(self) -> str:
        """Description of the frame in words: "tip: a frame on hand, placed by x = l1, rz = 0.5"."""
        at = f"placed by {self.X_BF}" if self.X_BF.steps else "in its origin"
        return f"{self.name}: a frame on {self.body}, {at}"

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Declared(InSentence):
    """Constraint of a mechanism: its kind with numbers (`of`), and the bodies at its ends.

    Frame A sits at `X_PF` on the body `parent`, frame B at `X_CM` on the body `child`; a constraint
    on coordinates has no bodies, which are then ''.
    """

    name: str
    of: Constraint
    parent: str
    child: str
    X_PF: Placement = Placement()
    X_CM: Placement = Placement()
    where: Where | None = field(default=None, compare=False, repr=False)

    @property
    def sentence(self) -> str:
        """Description of the constraint in words."""
        return f"{self.name}: {self.of.sentence}"

    @property
    def kind(self) -> str:
        """Name of the kind of constraint."""
        return self.of.kind

    @property
    def rod(self) -> bool:
        """Whether the constraint prescribes only the distance between two points."""
        return [r.op for r in list_position_rows(self.of, 3)] == [Op.DISTANCE]

    def frames(self, parameters: Mapping[str, float], dim: int) -> tuple[Array, Array]:
        """Return the poses (4, 4) of frame A on body `parent` and of frame B on body `child`."""
        made = evaluate_number_fields(self.of, parameters)
        B = self.X_CM.evaluate_pose(parameters) @ np.reshape(made.make_tool_pose(dim), (4, 4))
        return self.X_PF.evaluate_pose(parameters) @ made.make_goal_poses(dim), B

    def length(self, parameters: Mapping[str, Any]) -> Any:
        """Return the length of a rod in metres, or those of designs (n,)."""
        made = evaluate_number_fields(self.of, parameters)
        (row,) = made.list_rows(3)
        return getattr(made, row.equal)

    def count_equations(self, dim: int) -> int:
        """Return the number of equations f(q) = 0 for dimension `dim` (2 or 3)."""
        return sum(r.count_equations(dim) for r in list_position_rows(self.of, dim))

    def count_positions(self, dim: int) -> int:
        """Return the number of rows on positions, not velocities, for dimension `dim` (2 or 3)."""
        return self.count_equations(dim) + self.count_bounds(dim)

    def count_bounds(self, dim: int) -> int:
        """Return the number of inequalities among the rows, for dimension `dim` (2 or 3)."""
        return sum(
            r.count_equations(dim)
            for r in self.of.list_rows(dim)
            if not r.velocity and is_one_sided(self.of, r)
        )

    def count_pose_equations(self, dim: int) -> int:
        """Return the number of equations on directions, rotations and distances.

        Equations by expressions do not count.
        """
        return sum(
            r.count_equations(dim)
            for r in list_position_rows(self.of, dim)
            if r.op not in (Op.TAPE, Op.CALL)
        )

    @property
    def links(self) -> bool:
        """Whether a row other than an expression restricts the relative motion of two bodies."""
        return bool(self.parent) and any(
            r.op not in (Op.TAPE, Op.CALL) for r in list_position_rows(self.of, 3)
        )

    def key(self) -> tuple[Any, ...]:
        """Return all content of the constraint as a tuple that can be compared."""
        return self.name, self.parent, self.child, self.X_PF, self.X_CM, make_content_key(self.of)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Declared) and self.key() == other.key()

    def __hash__(self) -> int:
        return hash(self.name)

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Coupling(InSentence):
    """Linear relation of coordinates: coordinate `of` = sum of multiplier * source + `offset`."""

    of: str
    sources: dict[str, Value]
    offset: Value = 0.0
    where: Where | None = field(default=None, compare=False, repr=False)

    @property
    def sentence(self) -> str:
        """Relation as an equation: "q2 = 2 q1 - 0.1"."""
        out: list[str] = []
        for name, x in [*self.sources.items(), ("", self.offset)]:
            size = (
                f"({x.text})"
                if isinstance(x, Expression)
                else ""
                if name and abs(x) == 1
                else f"{abs(x):.6g}"
            )
            if name or x != 0:
                minus = not isinstance(x, Expression) and x < 0
                out += [
                    ("- " if minus else "+ ") * bool(out)
                    + "-" * (minus and not out)
                    + f"{size} {name}".strip()
                ]
        return f"{self.of} = {' '.join(out) or '0'}"

    def __hash__(self) -> int:
        return hash(self.of)
