"""The builder: what the user says of a system, as a graph of bodies and joints. No kinematics here."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from kempe.calls import explained, explained_methods, flag
from kempe.description import checks
from kempe.description.constraint_methods import ConstraintMethods
from kempe.description.parts import Body, Coupling, Declared, Frame, Joint
from kempe.description.source import collecting_later
from kempe.errors import InputError, KempeError, UnknownNameError, Where
from kempe.joints import JointType, joint_type
from kempe.late import late
from kempe.placement import Placement, place
from kempe.values import Expression, Value, value

if TYPE_CHECKING:
    from pathlib import Path

    from kempe.model.system import System

BodyLike = Body | str


@explained_methods
class Mechanism(ConstraintMethods):
    """A system under construction: bodies, joints between any two of them, frames, couplings,
    limits, parameters.

    Every method that adds something returns its record or name; a wrong call raises at once and
    changes nothing. Lengths are metres, angles radians; both may be expressions in parameters, such
    as ``"l1/2"``.

    >>> arm = Mechanism("two-link", dim=2)
    >>> upper, lower = arm.body("upper"), arm.body("lower")
    >>> _ = arm.revolute("q1", arm.ground, upper)
    >>> _ = arm.revolute("q2", upper, lower, at=(0.5, 0))
    >>> _ = arm.frame("tip", lower, at=(0.4, 0))
    >>> float(arm.build().fk([0.0, 0.0], "tip")[0, 3])
    0.9
    """

    @explained
    def __init__(self, name: str = "mechanism", dim: int = 3, ground: str = "ground"):
        if dim not in (2, 3):
            raise InputError(f"dim is {dim!r}; a system lives in the plane (2) or in space (3)")
        self.name = name
        self.dim = int(dim)
        self.bodies: dict[str, Body] = {}
        self.joints: dict[str, Joint] = {}
        self.frames: dict[str, Frame] = {}
        self.couplings: dict[str, Coupling] = {}
        self.constraints: dict[str, Declared] = {}
        self.parameters: dict[str, float] = {}
        self.postures: dict[str, dict[str, float]] = {}
        self.locks: dict[str, float] = {}
        self.notes: list[str] = []
        self.roots: tuple[str, ...] = ()
        self.tolerance: float | str | None = None
        """What its dimensions may be off by: metres and radians, or "measured"; see
        `kempe.solvers.assembly.ideal`."""
        self._add_body(Body(checks.name(ground, "body")))
        self._ground = ground

    # ---- bodies and frames

    @property
    def ground(self) -> Body:
        """The body that does not move: body 0."""
        return self.bodies[self._ground]

    def body(
        self,
        name: str,
        mass: float | None = None,
        center: Iterable[float] | None = None,
        visuals: Iterable[str] = (),
        where: Where | None = None,
    ) -> Body:
        """A new rigid body; `mass` in kg and `center` of mass (x, y, z) in the body's frame are
        optional.
        """
        return self._add_body(checks.body(name, False, mass, center, visuals, where))

    def particle(self, name: str, mass: float | None = None, where: Where | None = None) -> Body:
        """A new particle: a point mass without orientation. Attach it by a prismatic, translation
        or free joint.
        """
        return self._add_body(checks.body(name, True, mass, None, (), where))

    def _add_body(self, body: Body) -> Body:
        self._free_name(body.name, "body", body.where)
        self.bodies[body.name] = body
        return body

    def frame(
        self,
        name: str,
        body: BodyLike,
        at: object = (0.0, 0.0, 0.0),
        where: Where | None = None,
        **turn: Any,
    ) -> Frame:
        """A new named frame on a body, placed by `at`, `rpy`, `angle`, `axis`, `quat_wxyz`,
        `matrix` as in `place`.
        """
        on = self._body(body, f"frame {name!r}", where)
        self._free_name(checks.name(name, "frame"), "frame", where)
        X_BF = self._place(at, turn, f"frame {name!r}", where, on)
        if self.dim == 2:
            checks.flat(f"frame {name!r}", X_BF, where)
        if on.particle and any(s[0] not in "xyz" for s in X_BF.steps):
            checks.refuse(
                f"frame {name!r}",
                f"a particle ({on.name!r}) has no orientation to turn from",
                where,
            )
        if on.particle and X_BF.steps:
            checks.refuse(
                f"frame {name!r}",
                f"a particle ({on.name!r}) has no extent: the frame must sit on it",
                where,
            )
        self.frames[name] = Frame(name, on.name, X_BF, where)
        return self.frames[name]

    def parameter(self, name: str, number: float) -> Expression:
        """A named parameter (a length in metres, an angle in radians) for use in placements;
        returns it as a value.
        """
        parsed = (
            value(name, "parameter name") if isinstance(name, str) and name.isidentifier() else None
        )
        if not isinstance(parsed, Expression) or parsed.names != (name,):
            raise InputError(
                f"parameter name {name!r} must be an identifier that is not a function or constant"
            )
        if name in self.parameters:
            raise InputError(f"parameter {name!r} exists already")
        self.parameters[name] = checks.number(number, f"parameter {name!r}")
        return parsed

    # ---- joints

    def joint(
        self,
        name: str,
        kind: str | JointType,
        parent: BodyLike,
        child: BodyLike,
        at: object = (0.0, 0.0, 0.0),
        child_at: object = (0.0, 0.0, 0.0),
        rpy: object = None,
        angle: object = None,
        axis: object = None,
        child_rpy: object = None,
        child_angle: object = None,
        child_axis: object = None,
        quat_wxyz: object = None,
        matrix: object = None,
        child_quat_wxyz: object = None,
        child_matrix: object = None,
        limits: object = None,
        velocity: object = None,
        effort: object = None,
        actuated: bool | None = None,
        cut: bool = False,
        where: Where | None = None,
        **options: Any,
    ) -> Joint:
        """A new joint of type `kind` between any two bodies.

        Frame F sits on the parent at `at`, turned by `rpy` (or `angle` about z, `quat_wxyz`,
        `matrix`), and then so that its z is `axis`; frame M sits on the child at `child_at`
        likewise, with `child_axis` = `axis` unless given. `at` can be the name of a frame on the
        body, a pose (4, 4) or a `Placement`; `axis` numbers or a name ("x", "-z"). `limits` is
        (lower, upper) in radians or metres, None where there is none, or a dict of such pairs by
        coordinate ('rz', 'x', ...) for joints with several. Other keywords are the type's options
        (`pitch`, `angles`). Errors: `DescriptionError` with what is wrong and what is allowed.
        """
        subject = f"joint {name!r}"
        self._free_joint_name(checks.name(name, "joint"), subject, where)
        try:
            type_ = joint_type(kind, **options)
        except UnknownNameError as error:
            checks.refuse(subject, str(error), where)
        except InputError as error:
            checks.refuse(subject, checks.slip(kind, options, Mechanism.joint) or str(error), where)
        on = self._body(parent, subject, where)
        to = self._body(child, subject, where)
        if on.name == to.name:
            checks.refuse(
                subject,
                f"it connects body {on.name!r} to itself",
                where,
                "it must connect two bodies",
            )
        checks.kind(self.dim, subject, type_, on, to, where)
        turn = {"rpy": rpy, "angle": angle, "axis": axis, "quat_wxyz": quat_wxyz, "matrix": matrix}
        X_PF = self._place(at, turn, subject, where, on)
        turn = {
            "rpy": child_rpy,
            "angle": child_angle,
            "axis": axis if child_axis is None else child_axis,
            "quat_wxyz": child_quat_wxyz,
            "matrix": child_matrix,
        }
        X_CM = self._place(child_at, turn, subject, where, to)
        checks.ends(self.dim, subject, type_, X_PF, X_CM, to, where)
        names = type_.velocities(self.dim, to.particle)
        self.joints[name] = Joint(
            name,
            type_,
            on.name,
            to.name,
            X_PF,
            X_CM,
            checks.limits(subject, limits, type_, self.dim, to.particle, where),
            checks.bounds(subject, "velocity", velocity, names, where),
            checks.bounds(subject, "effort", effort, names, where),
            actuated if actuated is None else flag(actuated, f"actuated of {subject}"),
            flag(cut, f"cut of {subject}"),
            where,
            dim=self.dim,
            of_particle=to.particle,
        )
        return self.joints[name]

    def fixed(self, name: str, parent: BodyLike, child: BodyLike, **keywords: Any) -> Joint:
        """A joint that does not move; keywords as in `joint`."""
        return self.joint(name, "fixed", parent, child, **keywords)

    def revolute(self, name: str, parent: BodyLike, child: BodyLike, **keywords: Any) -> Joint:
        """A revolute joint about z of its frame F (or `axis`); keywords as in `joint`."""
        return self.joint(name, "revolute", parent, child, **keywords)

    def prismatic(self, name: str, parent: BodyLike, child: BodyLike, **keywords: Any) -> Joint:
        """A prismatic joint along z of its frame F (or `axis`); keywords as in `joint`."""
        return self.joint(name, "prismatic", parent, child, **keywords)

    def helical(
        self, name: str, parent: BodyLike, child: BodyLike, pitch: float, **keywords: Any
    ) -> Joint:
        """A screw joint about z with `pitch` metres a radian; keywords as in `joint`."""
        return self.joint(name, "helical", parent, child, pitch=pitch, **keywords)

    def cylindrical(self, name: str, parent: BodyLike, child: BodyLike, **keywords: Any) -> Joint:
        """A cylindrical joint: rotation about z and translation along z; keywords as in `joint`."""
        return self.joint(name, "cylindrical", parent, child, **keywords)

    def universal(self, name: str, parent: BodyLike, child: BodyLike, **keywords: Any) -> Joint:
        """A universal joint: rotation about x of F, then about y of M; keywords as in `joint`."""
        return self.joint(name, "universal", parent, child, **keywords)

    def planar(self, name: str, parent: BodyLike, child: BodyLike, **keywords: Any) -> Joint:
        """A planar joint: translation along x and y, rotation about z; keywords as in `joint`."""
        return self.joint(name, "planar", parent, child, **keywords)

    def translation(self, name: str, parent: BodyLike, child: BodyLike, **keywords: Any) -> Joint:
        """A joint that only translates, along x, y and z (in the plane x and y); keywords as in
        `joint`.
        """
        return self.joint(name, "translation", parent, child, **keywords)

    def spherical(self, name: str, parent: BodyLike, child: BodyLike, **keywords: Any) -> Joint:
        """A ball joint, by a quaternion or, with `angles=True`, by three angles; keywords as in
        `joint`.
        """
        return self.joint(name, "spherical", parent, child, **keywords)

    def free(self, name: str, parent: BodyLike, child: BodyLike, **keywords: Any) -> Joint:
        """A joint that allows all motions: its coordinates are the child's pose; keywords as in
        `joint`.
        """
        return self.joint(name, "free", parent, child, **keywords)

    # ---- relations between coordinates

    def couple(
        self,
        of: str,
        sources: Mapping[str, Value | str],
        offset: Value | str = 0.0,
        where: Where | None = None,
    ) -> Coupling:
        """A linear relation: coordinate `of` = sum of multiplier * source + `offset`.

        With one source it is a mimic or a gear and `of` leaves the configuration; with several it
        is a constraint.
        """
        of = str(of)
        subject = f"coupling of {of!r}"
        if not isinstance(sources, Mapping):
            checks.refuse(
                subject,
                f"its sources are {sources!r}",
                where,
                "they must be a dict of multipliers by name",
            )
        if of in self.couplings:
            checks.refuse(subject, "the coordinate follows others already", where)
        if not sources:
            checks.refuse(subject, "it has no source coordinate", where)
        try:
            checked = {str(k): value(v, "multiplier") for k, v in sources.items()}
            self.couplings[of] = Coupling(of, checked, value(offset, "offset"), where)
        except InputError as error:
            checks.refuse(subject, str(error), where)
        return self.couplings[of]

    def gear(
        self, driven: str, driver: str, ratio: Value | str, offset: Value | str = 0.0
    ) -> Coupling:
        """A gear between two coordinates: driven = ratio * driver + offset."""
        return self.couple(driven, {driver: ratio}, offset)

    def posture(self, name: str, coordinates: Mapping[str, float]) -> None:
        """Declare a named posture: values of some coordinates by name, the others neutral."""
        if name in self.postures:
            raise InputError(f"posture {name!r} exists already")
        self.postures[name] = checks.numbers(coordinates, f"posture {name!r}")

    def lock(self, coordinates: Mapping[str, float]) -> Mechanism:
        """Hold coordinates at values: they leave the configuration. Returns the mechanism itself."""
        self.locks |= checks.numbers(coordinates, "lock")
        return self

    # ---- composition

    def attach(
        self,
        other: Mechanism | System,
        to: BodyLike | Frame | None = None,
        prefix: str = "",
        **placement: Any,
    ) -> Mechanism:
        """Mount a copy of `other` on a body or frame of this mechanism by a fixed joint; returns
        the mechanism itself.

        All names of `other` get the `prefix`; its ground becomes a body, held at `at`, `rpy`, ...
        of `to` by the joint ``<prefix><ground>_mount``. Parameters of the same name and value are
        shared.
        """
        from kempe.description.compose import attach

        attach(self, _mechanism_of(other), to, prefix, placement)
        return self

    def subchain(self, base: BodyLike, tip: BodyLike | Frame) -> Mechanism:
        """A new mechanism: the bodies and joints between `base`, its new ground, and `tip`."""
        from kempe.description.compose import subchain

        return subchain(self, str(base), str(tip))

    def copy(self) -> Mechanism:
        """An independent copy."""
        out = copy.copy(self)
        for key in (
            "bodies",
            "joints",
            "frames",
            "couplings",
            "constraints",
            "parameters",
            "locks",
            "notes",
        ):
            setattr(out, key, copy.copy(getattr(self, key)))
        out.postures = {k: dict(v) for k, v in self.postures.items()}
        return out

    def build(self) -> System:
        """The compiled `System`. Errors: `DescriptionError` that names what does not fit together."""
        with collecting_later(len(self.bodies)):
            return late("System")(self)

    def save(self, path: str | Path) -> Path:
        """Write the mechanism to a file, in the format of its ending (.toml holds everything);
        returns the path.
        """
        return late("write")(self, path)

    def __repr__(self) -> str:
        return (
            f"Mechanism({self.name!r}, dim={self.dim}, bodies={len(self.bodies) - 1}, "
            f"joints={len(self.joints)})"
        )

    def _repr_html_(self) -> str | None:
        """The system that it makes, in a notebook; None, for its text, where it makes none yet."""
        try:
            return self.build()._repr_html_()
        except KempeError:
            return None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mechanism) and self.content() == other.content()

    __hash__ = None  # type: ignore[assignment]

    def content(self) -> tuple[Any, ...]:
        """All content as nested tuples in the order of declaration, without file positions and
        notes.
        """
        return (
            self.name,
            self.dim,
            self._ground,
            tuple(self.bodies.values()),
            tuple(
                (j, tuple(j.limits.items()), tuple(j.velocity_limits.items()))
                for j in self.joints.values()
            ),
            tuple(self.frames.values()),
            tuple((c, tuple(c.sources.items())) for c in self.couplings.values()),
            tuple(self.parameters.items()),
            tuple((k, tuple(v.items())) for k, v in self.postures.items()),
            tuple(self.locks.items()),
            tuple(c.key() for c in self.constraints.values()),
            self.tolerance,
        )

    # ---- checks

    def _free_name(self, name: str, kind: str, where: Where | None) -> None:
        taken = self.bodies.get(name) or self.frames.get(name)
        if taken is not None:
            what = "body" if name in self.bodies else "frame"
            first = f" ({taken.where})" if taken.where else ""
            checks.refuse(
                f"{kind} {name!r}",
                f"there is another {what} of this name{first}",
                where,
                "names must be unique",
            )

    def _free_joint_name(self, name: str, subject: str, where: Where | None) -> None:
        taken = self.joints.get(name) or self.constraints.get(name)
        if taken is not None:
            what = "joint" if name in self.joints else "constraint"
            first = f" ({taken.where})" if taken.where else ""
            checks.refuse(
                subject,
                f"there is another {what} of this name{first}",
                where,
                "names must be unique",
            )

    def _body(self, body: BodyLike, subject: str, where: Where | None) -> Body:
        name = body.name if isinstance(body, Body) else body
        if not isinstance(name, str) or name not in self.bodies:
            checks.refuse(
                subject, str(UnknownNameError("body", name, self.bodies, self.name)), where
            )
        return self.bodies[name]

    def _place(
        self, at: object, turn: Mapping[str, Any], subject: str, where: Where | None, on: Body
    ) -> Placement:
        try:
            if isinstance(at, (Frame, str)):
                frame = self.frames.get(str(at))
                if frame is None or frame.body != on.name:
                    names = [f.name for f in self.frames.values() if f.body == on.name]
                    raise UnknownNameError("frame", str(at), names, f"body {on.name!r}")
                at = frame.X_BF
            X = place(at, **turn)
            for name in sorted(X.names):
                if name not in self.parameters:
                    raise UnknownNameError("parameter", name, self.parameters, self.name)
        except (InputError, UnknownNameError) as error:
            checks.refuse(subject, str(error), where)
        return X


def unused_name(m: Mechanism, name: str) -> str:
    """Return the name, with dashes behind it where a body, a frame, a joint or a constraint has it."""
    while any(name in parts for parts in (m.bodies, m.frames, m.joints, m.constraints)):
        name += "'"
    return name


def _mechanism_of(thing: Mechanism | System) -> Mechanism:
    mechanism = thing if isinstance(thing, Mechanism) else getattr(thing, "mechanism", None)
    if not isinstance(mechanism, Mechanism):
        raise InputError(f"{thing!r} is no Mechanism or System; read a file with kempe.read first")
    return mechanism
