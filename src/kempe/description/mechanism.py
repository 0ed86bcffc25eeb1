"""Builder `Mechanism`: bodies, joints, frames and constraints as a graph, without kinematics.

Mechanisms are also joined here, and chains cut out of them.
"""

from __future__ import annotations

import copy
import math
import re
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn, Unpack

import numpy as np

from kempe import constraints
from kempe.arguments import explain_errors, explain_method_errors, read_flag
from kempe.arrays import is_array, is_sequence, warn_of_degrees
from kempe.constraints.base import (
    Constraint,
    End,
    Op,
    Row,
    evaluate_number_fields,
    find_value_field,
    list_expressions,
    list_frame_fields,
    list_number_fields,
)
from kempe.constraints.tape import POSE, TWIST
from kempe.description import checks
from kempe.description.keywords import (
    AxisLike,
    BodyLike,
    BoundsLike,
    JointKeywords,
    LimitsLike,
    MatrixLike,
    PlaceLike,
    ValueLike,
    ValuesLike,
    make_turn,
    show_joint_keywords,
)
from kempe.description.parts import Body, Coupling, Declared, Frame, Joint, Shape
from kempe.description.source import pause_garbage_collection
from kempe.errors import (
    DECLARATIONS_ELSEWHERE,
    MEMBERS_ELSEWHERE,
    DescriptionError,
    Fault,
    InputError,
    KempeError,
    UnknownNameError,
    Where,
    format_value,
    raise_missing_member,
)
from kempe.joints import Fixed, JointType, make_joint_type
from kempe.late import call_late_function, import_late_member
from kempe.poses import AXES, Placement, place
from kempe.units import METRE, check_unit
from kempe.values import Expression, Value, evaluate_value, read_value

if TYPE_CHECKING:
    from pathlib import Path

    from kempe.description.shapes import Geometry
    from kempe.late import System


# ---- constraints: ends and numbers

# The ends of a constraint are found, and its numbers are checked.

BETWEEN = {"distance": "distance", "point_on_line": "on_line", "point_on_plane": "on_plane"}
"""Kinds that are placed on bodies, by their names as methods of `Mechanism` and in files of format
1."""

Placed = tuple[Any, object, Mapping[str, object]]
"""A body or frame, a place on it, and how it is turned there."""


def declare_constraint(
    mechanism: Mechanism, given: object, name: str, where: Where | None = None
) -> Declared:
    """Add a constraint to a mechanism; see `Mechanism.constrain`."""
    if not isinstance(given, Constraint):
        raise InputError(f"{format_value(given)} is no constraint; see kempe.constraints")
    if isinstance(name, str):
        name = name or given.name or given.label
    subject = f"constraint {name!r}"
    mechanism._check_joint_name(checks.check_name(name, "constraint"), subject, where)
    names = ("weight", "priority", "tolerance")
    demands = [
        f
        for f in names
        if getattr(given, f) not in (getattr(Constraint, f), getattr(type(given), f))
    ]
    if demands:
        checks.raise_problem(
            subject,
            f"{demands[0]} is what ik reads of a wish",
            where,
            "a mechanism always holds it: leave it out",
        )
    made = _convert_fields(mechanism, given, subject, where).resolve_names(mechanism.parameters)
    made = replace(made, name="") if made.name else made
    if made.ends[1] is None:
        record = Declared(name, made, "", "", where=where)
    else:
        ends = [_resolve_end(mechanism, e, subject, where) for e in made.ends]
        record = Declared(name, made, ends[0].body, ends[1].body, ends[0].X, ends[1].X, where)
    check_constraint(mechanism, record)
    mechanism.constraints[name] = record
    return record


def declare_placed_constraint(
    mechanism: Mechanism,
    name: str,
    kind: str,
    parent: Placed,
    child: Placed,
    length: object,
    where: Where | None,
) -> Declared:
    """Add a constraint of `BETWEEN` whose ends are placed on bodies; see `Mechanism.point_on_line`."""
    subject = f"constraint {name!r}"
    mechanism._check_joint_name(checks.check_name(name, "constraint"), subject, where)
    if kind not in BETWEEN:
        checks.raise_problem(
            subject, str(UnknownNameError("kind of constraint", kind, BETWEEN)), where
        )
    A, B = (_place_end(mechanism, p, subject, where) for p in (parent, child))
    rod = BETWEEN[kind] == "distance"
    if A.body == B.body:
        checks.raise_problem(
            subject, f"it ties body {A.body!r} to itself", where, "it must tie two bodies"
        )
    if mechanism.dim == 2 and BETWEEN[kind] == "on_plane":
        checks.raise_problem(
            subject,
            f"{kind} does not exist in the plane",
            where,
            "planar systems take distance and point_on_line",
        )
    if rod and length is None:
        checks.raise_problem(
            subject, "it has no length", where, "give the length of the rod in metres"
        )
    if not rod and length is not None:
        checks.raise_problem(
            subject, f"{kind} takes no length", where, "only a distance must have one"
        )
    if rod:
        try:
            length = _check_values(
                mechanism, read_value(length, "length"), "length", subject, where
            )
        except InputError as error:
            if isinstance(error, DescriptionError):
                raise
            checks.raise_problem(subject, str(error), where)
        return declare_constraint(mechanism, constraints.Distance(B, A, length), name, where)
    direction: Any = (0.0, 0.0, 1.0)
    if mechanism.dim == 2 and kind == "point_on_line":
        checks.find_planar_axis(subject, A.X, "its line is z of the frame, out of the plane", where)
        A, direction = End(A.body, Placement(A.X.steps[:-1])), A.X.steps[-1][1]
    made: Any = constraints.KINDS[BETWEEN[kind]]
    turned = {"direction": direction} if BETWEEN[kind] == "on_line" else {}
    return declare_constraint(mechanism, made(B, other=A, **turned), name, where)


def _place_end(mechanism: Mechanism, placed: Placed, subject: str, where: Where | None) -> End:
    """Return the end of a constraint on a body, from a body or frame, a point and an orientation."""
    thing, at, turn = placed
    frame = mechanism.frames.get(str(thing)) if isinstance(thing, (Frame, str)) else None
    if frame is None:
        on = mechanism._find_body(thing, subject, where)  # type: ignore[arg-type]
        return End(on.name, mechanism._make_placement(at, turn, subject, where, on))
    if isinstance(at, (Frame, str)):
        checks.raise_problem(
            subject,
            f"its point is given twice, by frames {frame.name!r} and {str(at)!r}",
            where,
            "name the frame once",
        )
    on = mechanism.bodies[frame.body]
    return End(on.name, frame.X_BF @ mechanism._make_placement(at, turn, subject, where, on))


def _resolve_end(mechanism: Mechanism, end: object, subject: str, where: Where | None) -> End:
    """Return the end of a constraint as a placement on a body.

    None is the ground, a text is the name of a frame or a body.
    """
    if end is None:
        return End(mechanism.ground.name)
    if isinstance(end, End):
        mechanism._find_body(end.body, subject, where)
        return end
    name = end.name if isinstance(end, (Body, Frame)) else end
    frame = mechanism.frames.get(name) if isinstance(name, str) else None
    if frame is not None:
        return End(frame.body, frame.X_BF)
    if isinstance(name, str) and name in mechanism.bodies:
        return End(name)
    known = [*mechanism.frames, *mechanism.bodies]
    checks.raise_problem(
        subject, str(UnknownNameError("frame or body", name, known, mechanism.name)), where
    )


def _convert_fields(
    mechanism: Mechanism, given: Constraint, subject: str, where: Where | None
) -> Constraint:
    """Return the constraint with expressions in place of the texts in its numeric fields."""
    changed: dict[str, Any] = {}
    for key, x in list_number_fields(given).items():
        if isinstance(x, str) and x in AXES:
            continue
        read = _check_values(mechanism, x, key, subject, where)
        if read is not x:
            changed[key] = read
    return replace(given, **changed) if changed else given


def _check_values(
    mechanism: Mechanism, x: Any, what: str, subject: str, where: Where | None
) -> Any:
    """Return numbers or expressions.

    Errors: `DescriptionError` for unknown parameters and values that are not finite.
    """
    try:
        read = _parse_values(x, what)
        for e in list_expressions(read):
            for name in e.names:
                if name not in mechanism.parameters:
                    raise UnknownNameError("parameter", name, mechanism.parameters)
            number = e.evaluate(mechanism.parameters)
            if not math.isfinite(number):
                raise InputError(f"{what} is {float(number)} ({what} = {e}); it must be finite")
    except (InputError, UnknownNameError) as error:
        text = str(error) if isinstance(error, InputError) else f"{what} is {x!s}: {error}"
        checks.raise_problem(subject, text, where)
    return read


def _parse_values(x: Any, what: str) -> Any:
    """Return numbers and nested lists of numbers, with texts as expressions."""
    given: Any = x
    if isinstance(x, (np.ndarray, np.generic)):
        given = given.tolist()
    if is_sequence(given):
        items = tuple(_parse_values(item, what) for item in given)
        return given if all(a is b for a, b in zip(items, given, strict=True)) else items
    return read_value(given, what) if isinstance(given, (str, Expression)) else given


def check_constraint(mechanism: Mechanism, made: Declared) -> None:
    """Raise `DescriptionError` if the constraint cannot have its ends, frames or numbers."""
    subject = f"constraint {made.name!r}"
    where = made.where
    dim = mechanism.dim
    if made.parent and made.parent == made.child:
        checks.raise_problem(
            subject, f"it ties body {made.parent!r} to itself", where, "it must tie two bodies"
        )
    numbers = evaluate_constraint(made, mechanism.parameters, dim)
    rows = numbers.list_rows(dim)
    tool = numbers.make_tool_pose(dim)
    if not made.parent:
        if not made.of.coordinate_names:
            checks.raise_problem(
                subject,
                f"{made.of.label} is requested in one call of ik, not held always",
                where,
                "hold coordinates by lock, couple or equation, frames by kinds that name them",
            )
        return
    a, b = (mechanism.bodies[n] for n in (made.parent, made.child))
    if a.particle and any(r.op is not Op.DISTANCE for r in rows):
        checks.raise_problem(
            subject,
            f"its parent {a.name!r} is a particle, which has no axes",
            where,
            "make the particle the child",
        )
    if b.particle and (
        any(map(is_orientation_dependent, rows)) or any(tool[k] for k in (3, 7, 11))
    ):
        checks.raise_problem(
            subject, f"{b.name!r} is a particle, which has no axes and no extent", where, ""
        )
    for on, X in ((a, made.X_PF), (b, made.X_CM)):
        if on.particle and X.steps:
            checks.raise_problem(
                subject,
                f"a particle ({on.name!r}) has no extent: the point must sit on it",
                where,
                "leave out its at and its axis",
            )
        if dim == 2:
            checks.check_planar_placement(subject, X, where)


def evaluate_constraint(made: Declared, parameters: Mapping[str, float], dim: int) -> Constraint:
    """Return the constraint with its expressions evaluated at the parameters.

    Errors: `DescriptionError`.
    """
    numbers = evaluate_number_fields(made.of, parameters)
    try:
        rows = numbers.list_rows(dim)
        for key, x in list_number_fields(numbers).items():
            if x is not None and _has_nan(x):
                raise InputError(f"{key} is {format_value(x)}; it must be numbers")
        _refuse_zero_lengths(made, numbers, rows)
        numbers.check_fields(dim)
        numbers.make_goal_poses(dim)
        numbers.make_tool_pose(dim)
    except InputError as error:
        if isinstance(error, DescriptionError):
            raise
        checks.raise_problem(f"constraint {made.name!r}", str(error), made.where)
    return numbers


def _has_nan(x: Any) -> bool:
    """Whether numbers hold NaN, or an integer that is too large for a float."""
    try:
        return bool(np.isnan(np.asarray(x, dtype=float)).any())
    except OverflowError:
        return True
    except (TypeError, ValueError):
        return False


def is_orientation_dependent(row: Row) -> bool:
    """Whether a row of a constraint depends on the orientation of frame B."""
    if row.op in (Op.TAPE, Op.VELOCITY):
        tape, output = row.args
        return tape.compute_degrees((*POSE[3:], *TWIST[3:]))[output] > 0
    return row.op not in (Op.DISTANCE, Op.POINT)


def _refuse_zero_lengths(made: Declared, numbers: Constraint, rows: tuple[Row, ...]) -> None:
    """Raise `DescriptionError` if the length of a rod is not positive and finite."""
    for row in rows:
        name = find_value_field(numbers, row) if row.op is Op.DISTANCE else ""
        length = getattr(numbers, name) if name else 1.0
        if not 0.0 < float(length) < math.inf:  # not a number fails, too
            given = getattr(made.of, name)
            text = f" (length = {given})" if isinstance(given, Expression) else ""
            allowed = "it must be above zero" + (
                "; points that coincide are a joint" if float(length) == 0.0 else ""
            )
            checks.raise_problem(
                f"constraint {made.name!r}",
                f"its length is {float(length):g}{text}",
                made.where,
                allowed,
            )


def rename_constraint(
    made: Declared, bodies: Mapping[str, str], frames: Mapping[str, str], prefix: str
) -> Declared:
    """Return the constraint with new names of bodies and frames, and a prefix for its own names."""
    both = {**bodies, **frames}

    def rename_end(x: Any) -> Any:
        """Return an end of the constraint with the new name of its body or frame."""
        return replace(x, body=bodies[x.body]) if isinstance(x, End) else both.get(x, x)

    of = replace(made.of, **{k: rename_end(x) for k, x in list_frame_fields(made.of).items()})
    own = {"name": prefix + made.name, "of": of.add_prefix(prefix)}
    return replace(
        made, **own, parent=bodies.get(made.parent, ""), child=bodies.get(made.child, "")
    )


# ---- the builder


@explain_method_errors
class Mechanism:
    """System under construction: bodies, joints, frames, couplings, limits and parameters.

    Parameters
    ----------
    name
        Name of the mechanism.
    dim
        3 for a mechanism in space (default), 2 for one in the plane: its bodies stay in the
        xy-plane and turn about z.
    ground
        Name of body 0, which does not move (default: "ground").
    unit
        Unit of its lengths: "m" (default), "cm", "mm" or "in".

    Raises
    ------
    InputError
        If `dim` is neither 2 nor 3, a name is empty, or `unit` is no unit of length.

    See Also
    --------
    Mechanism.build : the `System`, with which everything is computed.
    kempe.load, kempe.read : read a mechanism from a file.

    Notes
    -----
    Lengths are metres, angles radians. With a `unit` all lengths, speeds of slides, areas, pictures
    and messages are in that unit, where these pages say metres: numbers go in and come out in it.
    Only `attach`, files in formats of others and `kempe.convert` convert. Lengths and angles may be
    expressions in parameters, such as ``"l1/2"``, where the method says so. Every method that adds
    something returns its record or name. A wrong call raises an error at once and changes nothing.

    Examples
    --------
    >>> arm = Mechanism("two-link", dim=2)
    >>> upper, lower = arm.body("upper"), arm.body("lower")
    >>> _ = arm.revolute("q1", arm.ground, upper)
    >>> _ = arm.revolute("q2", upper, lower, at=(0.5, 0))
    >>> _ = arm.frame("tip", lower, at=(0.4, 0))
    >>> float(arm.build().fk([0.0, 0.0], "tip")[0, 3])
    0.9
    """

    @explain_errors
    def __init__(
        self, name: str = "mechanism", dim: int = 3, ground: str = "ground", unit: str = METRE
    ):
        if dim not in (2, 3):
            raise InputError(f"dim is {dim!r}; a system lives in the plane (2) or in space (3)")
        self.name = name
        self.dim = int(dim)
        self.unit = check_unit(unit)
        """Unit of its lengths; see `kempe.units.METRES`."""
        self.bodies: dict[str, Body] = {}
        self.joints: dict[str, Joint] = {}
        self.frames: dict[str, Frame] = {}
        self.couplings: dict[str, Coupling] = {}
        self.constraints: dict[str, Declared] = {}
        self.parameters: dict[str, float] = {}
        self.postures: dict[str, dict[str, float]] = {}
        self.groups: dict[str, tuple[str, ...]] = {}
        """Names of joints by the name of a group; `System.group` makes a system of one."""
        self.ignored_pairs: dict[tuple[str, str], str] = {}
        """Pairs of bodies that are not checked for collisions, each with the reason, or ''."""
        self.locks: dict[str, float] = {}
        self.notes: list[str] = []
        self.roots: tuple[str, ...] = ()
        self.tolerance: float | str | None = None
        """What its dimensions may be off by: metres and radians, or "measured"; see
        `kempe.assemble.nearest_exact`."""
        self._add_body(Body(checks.check_name(ground, "body")))
        self._ground = ground

    # ---- bodies and frames

    @property
    def ground(self) -> Body:
        """Body that does not move: body 0 of the system."""
        return self.bodies[self._ground]

    def body(
        self,
        name: str,
        mass: float | None = None,
        center: Iterable[float] | None = None,
        where: Where | None = None,
    ) -> Body:
        """Add a rigid body and return it.

        Parameters
        ----------
        name
            Name, which no other body or frame has.
        mass
            Mass in kilograms, not negative (default: unknown). Only tasks on the centre of mass
            read it.
        center
            Centre of mass in the frame of the body: 2 or 3 lengths in metres (default: unknown).
        where
            Place in a file, for error messages; readers of files give it.

        Returns
        -------
        Body
            Record of the body. Other methods take the record or the name.

        Raises
        ------
        DescriptionError
            If the name is taken, the mass is negative, or the centre has not 2 or 3 numbers.

        See Also
        --------
        Mechanism.particle : a body without orientation.

        Notes
        -----
        A body needs at least one joint that connects it with the ground, directly or through other
        bodies: `build` refuses a body without a connection. A body that moves freely has a `free`
        joint.

        Examples
        --------
        >>> m = Mechanism("arm")
        >>> print(m.body("forearm", mass=2.0, center=(0.1, 0, 0)).sentence)
        forearm: a rigid body, 2 kg, centre of mass at (0.1, 0, 0) m
        """
        return self._add_body(checks.make_body(name, False, mass, center, where))

    def particle(self, name: str, mass: float | None = None, where: Where | None = None) -> Body:
        """Add a particle, a point mass without orientation, and return it.

        Parameters
        ----------
        name
            Name, which no other body or frame has.
        mass
            Mass in kilograms, not negative (default: unknown).
        where
            Place in a file, for error messages; readers of files give it.

        Returns
        -------
        Body
            Record of the particle.

        Raises
        ------
        DescriptionError
            If the name is taken or the mass is negative.

        Notes
        -----
        A particle has 3 degrees of freedom in space and 2 in the plane. It is the child of a
        prismatic, planar, translation, fixed or free joint, or of a product of slides, and has no
        extent: joints and frames sit on its origin.

        Examples
        --------
        >>> m = Mechanism("bead")
        >>> _ = m.free("x", m.ground, m.particle("bead"))
        >>> m.build().coordinate_names
        ('x.x', 'x.y', 'x.z')
        """
        return self._add_body(checks.make_body(name, True, mass, None, where))

    def _add_body(self, body: Body) -> Body:
        """Add a body whose name is not taken and return it."""
        self._check_free_name(body.name, "body", body.where)
        self.bodies[body.name] = body
        return body

    def frame(
        self,
        name: str,
        body: BodyLike,
        at: PlaceLike = (0.0, 0.0, 0.0),
        where: Where | None = None,
        *,
        rpy: ValuesLike | None = None,
        angle: ValueLike | None = None,
        axis: AxisLike | None = None,
        quat_wxyz: ValuesLike | None = None,
        matrix: MatrixLike | None = None,
    ) -> Frame:
        """Add a named frame to a body and return it; `fk` and `ik` take its name.

        Parameters
        ----------
        name
            Name, which no other body or frame has.
        body
            Body that carries the frame, as a record or a name.
        at
            Origin of the frame in the axes of the body: 2 or 3 lengths in metres, which may be
            expressions in parameters (default: the origin of the body). Also a pose (4, 4), a pose
            in words such as ``{"at": (1, 0, 0), "rpy": (0, 0, 1)}``, a `Placement`, or the name of
            another frame on the body; the orientation then turns the frame further.
        where
            Place in a file, for error messages; readers of files give it.
        rpy
            Roll, pitch and yaw: turns about the fixed axes x, y and z of the body, in this order,
            in radians. They may be expressions. Give at most one of `rpy`, `angle`, `quat_wxyz` and
            `matrix`.
        angle
            Turn about z in radians; may be an expression. The usual form in the plane.
        axis
            Direction of z of the frame, in the axes that the other keywords describe: numbers of
            any length, or a name ("x", "-z"). z turns to it by the smallest rotation. The frame of
            a mechanism in the plane has none: its z stays z.
        quat_wxyz
            Orientation as a unit quaternion, real part first; it is normalised, and may hold
            expressions.
        matrix
            Orientation as a rotation matrix (3, 3).

        Returns
        -------
        Frame
            Record of the frame.

        Raises
        ------
        DescriptionError
            If the name is taken, there is no such body, frame or parameter, the orientation is
            given twice, or the frame leaves the plane.

        Examples
        --------
        >>> m = Mechanism("arm", dim=2)
        >>> _ = m.revolute("q1", m.ground, m.body("link"))
        >>> _ = m.parameter("l", 0.4)
        >>> print(m.frame("tip", "link", at=("l", 0), angle=0.5).sentence)
        tip: a frame on link, placed by x = l, rz = 0.5
        """
        turn = make_turn(rpy, angle, axis, quat_wxyz, matrix)
        on = self._find_body(body, f"frame {name!r}", where)
        self._check_free_name(checks.check_name(name, "frame"), "frame", where)
        X_BF = self._make_placement(at, turn, f"frame {name!r}", where, on)
        if self.dim == 2:
            checks.check_planar_placement(f"frame {name!r}", X_BF, where)
        if on.particle and any(s[0] not in "xyz" for s in X_BF.steps):
            checks.raise_problem(
                f"frame {name!r}",
                f"a particle ({on.name!r}) has no orientation to turn from",
                where,
            )
        if on.particle and X_BF.steps:
            checks.raise_problem(
                f"frame {name!r}",
                f"a particle ({on.name!r}) has no extent: the frame must sit on it",
                where,
            )
        self.frames[name] = Frame(name, on.name, X_BF, where)
        return self.frames[name]

    def shape(
        self,
        body: BodyLike | Frame,
        kind: str | Geometry,
        *,
        radius: ValueLike | None = None,
        length: ValueLike | None = None,
        size: Sequence[ValueLike] | None = None,
        radii: Sequence[ValueLike] | None = None,
        path: str | None = None,
        scale: Value | Sequence[ValueLike] | None = None,
        at: PlaceLike = (0.0, 0.0, 0.0),
        roll: ValueLike = 0.0,
        pitch: ValueLike = 0.0,
        yaw: ValueLike = 0.0,
        rpy: ValuesLike | None = None,
        angle: ValueLike | None = None,
        axis: AxisLike | None = None,
        quat_wxyz: ValuesLike | None = None,
        matrix: MatrixLike | None = None,
        visual: bool = True,
        collision: bool = True,
        color: Sequence[float] | None = None,
        name: str = "",
        where: Where | None = None,
    ) -> Shape:
        """Add a shape to a body, for drawings, for collisions, or for both, and return it.

        Parameters
        ----------
        body
            Body, or a frame on it from which the place is measured, as a record or a name.
        kind
            "sphere" (`radius`), "box" (`size`), "cylinder" and "capsule" (`radius`, `length`),
            "ellipsoid" (`radii`), "mesh" (`path`, `scale`), or a `Geometry`.
        radius
            Radius of a sphere, cylinder or capsule in metres, or an expression in parameters.
        length
            Length of a cylinder or capsule along z in metres, or an expression. A capsule has a
            half ball beyond each end of its length.
        size
            Extents of a box along x, y and z in metres, or expressions.
        radii
            Semi-axes of an ellipsoid along x, y and z in metres, or expressions.
        path
            File of a mesh.
        scale
            Factor of a mesh, or three factors along x, y and z (default: 1).
        at
            Centre of the shape, or origin of the mesh, in the axes of the body or frame: as `at` of
            `frame` (default: the origin).
        roll, pitch, yaw
            Turns about the fixed axes x, y and z of the body in radians (default: 0).
        rpy, angle, axis, quat_wxyz, matrix
            Orientation in other forms, as in `frame`; `axis` is the direction of the axis of a
            cylinder or capsule.
        visual, collision
            Whether drawings show the shape, and whether it counts for collisions (default: both).
        color
            Red, green, blue, and opacity, each from 0 to 1 (default: the colour of drawings).
        name
            Name for the reader of a file; shapes may share it.
        where
            Place in a file, for error messages; readers of files give it.

        Returns
        -------
        Shape
            Record of the shape, which the record of the body in `bodies` now holds in `shapes`.

        Raises
        ------
        DescriptionError
            If a size is missing or wrong, there is no such body or parameter, the body is a
            particle, or the shape is neither visual nor for collisions.

        Examples
        --------
        >>> m = Mechanism("arm")
        >>> link = m.body("link")
        >>> print(m.shape("link", "capsule", radius=0.04, length=0.4, at=(0.2, 0, 0), axis="x"))
        capsule of radius 0.04 m and length 0.4 m
        >>> m.shape("link", "box", size=(0.1, 0.1, 0.02), collision=False).visual
        True
        """
        from kempe.description.shapes import make_geometry  # only here: many mechanisms have none

        subject = f"shape {name!r}" if name else f"a shape of {str(body)!r}"
        sizes = {"radius": radius, "length": length, "size": size, "radii": radii}
        try:
            made = make_geometry(kind, {**sizes, "path": path, "scale": scale})
            self._check_parameters(made.names)
            made.evaluate_sizes(self.parameters)
            if any(x != 0.0 for x in (roll, pitch, yaw)):
                if rpy is not None:
                    raise InputError("orientation given twice, by rpy and roll, pitch, yaw")
                rpy = (roll, pitch, yaw)
            rgba = checks.check_color(color)
        except (InputError, UnknownNameError) as error:
            checks.raise_problem(subject, str(error), where)
        turn = make_turn(rpy, angle, axis, quat_wxyz, matrix)
        end = _place_end(self, (body, at, turn), subject, where)
        on = self.bodies[end.body]
        if on.particle:
            checks.raise_problem(subject, f"{on.name!r} is a particle, which has no extent", where)
        uses = (
            read_flag(visual, f"visual of {subject}"),
            read_flag(collision, f"collision of {subject}"),
        )
        if not any(uses):
            checks.raise_problem(
                subject, "it is neither visual nor collision", where, "one of them must be True"
            )
        shape = Shape(made, end.X, *uses, rgba, str(name), where)
        self.bodies[on.name] = replace(on, shapes=(*on.shapes, shape))
        return shape

    def obstacle(
        self,
        name: str,
        kind: str | Geometry,
        *,
        radius: ValueLike | None = None,
        length: ValueLike | None = None,
        size: Sequence[ValueLike] | None = None,
        radii: Sequence[ValueLike] | None = None,
        path: str | None = None,
        scale: Value | Sequence[ValueLike] | None = None,
        at: PlaceLike = (0.0, 0.0, 0.0),
        rpy: ValuesLike | None = None,
        angle: ValueLike | None = None,
        axis: AxisLike | None = None,
        quat_wxyz: ValuesLike | None = None,
        matrix: MatrixLike | None = None,
        color: Sequence[float] | None = None,
    ) -> Body:
        """Add a thing that stands on the ground, such as a table or a wall, and return its body.

        It is a body with one shape that a fixed joint of the same name holds.

        Parameters
        ----------
        name
            Name, which no other body has.
        kind, radius, length, size, radii, path, scale, color
            Kind of the shape, its sizes in metres, and its colour, as in `shape`.
        at, rpy, angle, axis, quat_wxyz, matrix
            Place in the ground frame, in metres, and orientation, as in `frame`.

        Returns
        -------
        Body
            Record of the body.

        Raises
        ------
        DescriptionError
            If the name is taken, or a size or the place is wrong.

        See Also
        --------
        System.geometry : distances between bodies.

        Examples
        --------
        >>> m = Mechanism("cell")
        >>> m.obstacle("table", "box", size=(1, 0.6, 0.05), at=(0.5, 0, 0.4)).name
        'table'
        """
        trial = self.copy()
        trial.body(name)
        sizes: dict[str, Any] = {
            "radius": radius,
            "length": length,
            "size": size,
            "radii": radii,
            "path": path,
            "scale": scale,
        }
        trial.shape(name, kind, color=color, **sizes)
        turn = make_turn(rpy, angle, axis, quat_wxyz, matrix)
        trial.fixed(name, trial.ground, name, at=at, **turn)
        self.bodies = trial.bodies
        self.joints = trial.joints
        return self.bodies[name]

    def parameter(self, name: str, number: float) -> Expression:
        """Add a named parameter, a length or an angle, and return it as an expression.

        Parameters
        ----------
        name
            Name: an identifier that is no function or constant of expressions (`sin`, `pi`, ...).
        number
            Value in metres or radians, finite.

        Returns
        -------
        Expression
            The parameter, with which Python can calculate: ``l / 2 + 0.1`` is an expression, too.
            Placements, lengths of rods and numbers of couplings take expressions, also as text.

        Raises
        ------
        InputError
            If the name is no identifier or is taken, or the number is not finite.

        See Also
        --------
        System.with_parameters : the same system with other values.

        Examples
        --------
        >>> m = Mechanism("arm", dim=2)
        >>> length = m.parameter("l", 0.5)
        >>> _ = m.revolute("q1", m.ground, m.body("link"))
        >>> _ = m.frame("middle", "link", at=(length / 2, 0))
        >>> float(m.build().with_parameters(l=0.8).fk([0.0], "middle")[0, 3])
        0.4
        """
        parsed = (
            read_value(name, "parameter name")
            if isinstance(name, str) and name.isidentifier()
            else None
        )
        if not isinstance(parsed, Expression) or parsed.names != (name,):
            raise InputError(
                f"parameter name {name!r} must be an identifier that is not a function or constant"
            )
        if name in self.parameters:
            raise InputError(f"parameter {name!r} exists already")
        self.parameters[name] = checks.check_number(number, f"parameter {name!r}")
        return parsed

    # ---- joints

    def joint(
        self,
        name: str,
        kind: str | JointType,
        parent: BodyLike,
        child: BodyLike,
        at: PlaceLike = (0.0, 0.0, 0.0),
        child_at: PlaceLike = (0.0, 0.0, 0.0),
        rpy: ValuesLike | None = None,
        angle: ValueLike | None = None,
        axis: AxisLike | None = None,
        child_rpy: ValuesLike | None = None,
        child_angle: ValueLike | None = None,
        child_axis: AxisLike | None = None,
        quat_wxyz: ValuesLike | None = None,
        matrix: MatrixLike | None = None,
        child_quat_wxyz: ValuesLike | None = None,
        child_matrix: MatrixLike | None = None,
        limits: LimitsLike | None = None,
        velocity: BoundsLike | None = None,
        effort: BoundsLike | None = None,
        actuated: bool | None = None,
        cut: bool = False,
        where: Where | None = None,
        **options: object,
    ) -> Joint:
        """Add a joint of any type between two bodies and return it.

        A joint connects frame F on the parent with frame M on the child. At q = 0 both coincide;
        a revolute joint turns M about z of F, a prismatic joint moves M along z of F.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        kind
            Type of the joint: "fixed", "revolute", "prismatic", "helical", "cylindrical",
            "universal", "planar", "translation", "spherical", "free", a product of turns and slides
            such as "P(x) R(z) R(y)", or a `JointType`.
        parent, child
            Two different bodies, as records or names. A second joint to a body closes a loop.
        **options
            Options of the type: `pitch` in metres per radian for "helical", `angles` for
            "spherical" and "free".
        at
            Origin of frame F in the axes of the parent: 2 or 3 lengths in metres, which may be
            expressions in parameters (default: the origin of the parent). Also a pose (4, 4), a
            pose in words, a `Placement`, or the name of a frame on the parent.
        child_at
            Origin of frame M in the axes of the child, in the same forms (default: the origin of
            the child).
        rpy, child_rpy
            Orientation of F, and of M, by roll, pitch and yaw: turns about the fixed axes x, y and
            z of the body, in this order, in radians; may be expressions (default: the axes of the
            body). Give at most one of `rpy`, `angle`, `quat_wxyz` and `matrix`.
        angle, child_angle
            Orientation of F, and of M, by a turn about z in radians; may be an expression.
        axis, child_axis
            Direction of z of F, and of M, in the axes that the other keywords describe: numbers of
            any length, or a name such as "x" or "-z". `child_axis` is `axis` by default: where only
            `axis` is given, the axes of both bodies are parallel at q = 0.
        quat_wxyz, child_quat_wxyz
            Orientation of F, and of M, as a unit quaternion, real part first.
        matrix, child_matrix
            Orientation of F, and of M, as a rotation matrix (3, 3).
        limits
            Lower and upper limit in radians or metres, with None for no limit; a dict of such pairs
            by coordinate ("rz", "x", ...) for a joint with several (default: no limits). The
            coordinates of a quaternion have none.
        velocity
            Largest speed in rad/s or m/s, or a dict by velocity coordinate (default: no limit).
        effort
            Largest torque in N m or force in N, likewise. It is kept for files only.
        actuated
            True if a motor drives the joint, False if it is passive, None if unknown (default).
        cut
            Leave the joint out of the spanning tree if it lies in a loop (default: False). `fk`
            follows the tree, and solutions do not depend on the choice.
        where
            Place in a file, for error messages; readers of files give it.

        Returns
        -------
        Joint
            Record of the joint.

        Raises
        ------
        DescriptionError
            If the name is taken, there is no such type, body, frame, parameter or coordinate, a
            number is wrong, or the joint does not exist in the plane or between these bodies.

        See Also
        --------
        Mechanism.couple : relate coordinates of joints.
        Mechanism.constrain : constraints that are no joints.

        Notes
        -----
        In the plane the axis of a revolute joint is z, and a prismatic joint needs an `axis` of two
        numbers. In a system, a joint with one coordinate gives it its name; others have names such
        as "joint.rz".

        Examples
        --------
        >>> m = Mechanism("crane")
        >>> _ = m.joint("arm", "P(z) R(z)", m.ground, m.body("boom"), limits={"z": (0, 2)})
        >>> m.build().coordinate_names
        ('arm.z', 'arm.rz')
        """
        subject = f"joint {name!r}"
        self._check_joint_name(checks.check_name(name, "joint"), subject, where)
        try:
            type_ = make_joint_type(kind, **options)
        except UnknownNameError as error:
            checks.raise_problem(subject, str(error), where)
        except InputError as error:
            checks.raise_problem(
                subject,
                checks.explain_unknown_option(kind, options, Mechanism.joint) or str(error),
                where,
            )
        on = self._find_body(parent, subject, where)
        to = self._find_body(child, subject, where)
        if on.name == to.name:
            checks.raise_problem(
                subject,
                f"it connects body {on.name!r} to itself",
                where,
                "it must connect two bodies",
            )
        checks.check_joint_type(self.dim, subject, type_, on, to, where)
        turn = make_turn(rpy, angle, axis, quat_wxyz, matrix)
        X_PF = self._make_placement(at, turn, subject, where, on)
        z = axis if child_axis is None else child_axis
        turn = make_turn(child_rpy, child_angle, z, child_quat_wxyz, child_matrix)
        X_CM = self._make_placement(child_at, turn, subject, where, to)
        checks.check_joint_frames(self.dim, subject, type_, X_PF, X_CM, to, where)
        names = type_.list_velocity_names(self.dim, to.particle)
        self.joints[name] = Joint(
            name,
            type_,
            on.name,
            to.name,
            X_PF,
            X_CM,
            checks.check_limits(subject, limits, type_, self.dim, to.particle, where),
            checks.check_bounds(subject, "velocity", velocity, names, where),
            checks.check_bounds(subject, "effort", effort, names, where),
            actuated if actuated is None else read_flag(actuated, f"actuated of {subject}"),
            read_flag(cut, f"cut of {subject}"),
            where,
            dim=self.dim,
            of_particle=to.particle,
        )
        return self.joints[name]

    @show_joint_keywords(joint)
    def fixed(
        self,
        name: str,
        parent: BodyLike,
        child: BodyLike,
        **keywords: Unpack[JointKeywords],
    ) -> Joint:
        """Add a joint that holds the child on the parent and return it.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        parent, child
            Two different bodies, as records or names. Frame F of the joint sits on the parent,
            frame M on the child.

        Returns
        -------
        Joint
            Record of the joint.

        Raises
        ------
        DescriptionError
            If the name is taken, or a body, frame, parameter or number is wrong.

        See Also
        --------
        Mechanism.joint : joints of all types.
        """
        return self.joint(name, "fixed", parent, child, **keywords)

    @show_joint_keywords(joint)
    def revolute(
        self,
        name: str,
        parent: BodyLike,
        child: BodyLike,
        **keywords: Unpack[JointKeywords],
    ) -> Joint:
        """Add a revolute joint, a hinge, and return it.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        parent, child
            Two different bodies, as records or names. Frame F of the joint sits on the parent,
            frame M on the child.

        Returns
        -------
        Joint
            Record of the joint.

        Raises
        ------
        DescriptionError
            If the name is taken, or a body, frame, parameter or number is wrong.

        See Also
        --------
        Mechanism.joint : joints of all types.

        Notes
        -----
        The joint has one coordinate, the angle of M about z of F in radians. z is `axis` where it
        is given. In the plane the axis is z.

        Examples
        --------
        >>> m = Mechanism("door")
        >>> _ = m.revolute("hinge", m.ground, m.body("door"), at=(1, 0, 0), limits=(0, 1.5))
        >>> door = m.build()
        >>> door.coordinate_names, door.upper
        (('hinge',), array([1.5]))
        """
        return self.joint(name, "revolute", parent, child, **keywords)

    @show_joint_keywords(joint)
    def prismatic(
        self,
        name: str,
        parent: BodyLike,
        child: BodyLike,
        **keywords: Unpack[JointKeywords],
    ) -> Joint:
        """Add a prismatic joint, a slider, and return it.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        parent, child
            Two different bodies, as records or names. Frame F of the joint sits on the parent,
            frame M on the child.

        Returns
        -------
        Joint
            Record of the joint.

        Raises
        ------
        DescriptionError
            If the name is taken, or a body, frame, parameter or number is wrong.

        See Also
        --------
        Mechanism.joint : joints of all types.

        Notes
        -----
        The joint has one coordinate, the distance of M along z of F in metres. z is `axis` where it
        is given; a mechanism in the plane needs an `axis`.

        Examples
        --------
        >>> m = Mechanism("press", dim=2)
        >>> _ = m.prismatic("stroke", m.ground, m.body("ram"), axis=(0, 1), limits=(0, 0.3))
        >>> m.build().fk([0.2], "ram")[:3, 3]
        array([0. , 0.2, 0. ])
        """
        return self.joint(name, "prismatic", parent, child, **keywords)

    @show_joint_keywords(joint)
    def helical(
        self,
        name: str,
        parent: BodyLike,
        child: BodyLike,
        pitch: float,
        **keywords: Unpack[JointKeywords],
    ) -> Joint:
        """Add a helical joint, a screw, and return it.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        parent, child
            Two different bodies, as records or names. Frame F of the joint sits on the parent,
            frame M on the child.
        pitch
            Advance along z in metres per radian.

        Returns
        -------
        Joint
            Record of the joint.

        Raises
        ------
        DescriptionError
            If the name is taken, or a body, frame, parameter or number is wrong.

        See Also
        --------
        Mechanism.joint : joints of all types.

        Notes
        -----
        The joint has one coordinate, the angle of M about z of F in radians; M moves along z by
        `pitch` times the angle (Lynch and Park, Modern Robotics, 2017, section 2.2). It does not
        exist in the plane.

        Examples
        --------
        >>> m = Mechanism("vice")
        >>> _ = m.helical("screw", m.ground, m.body("jaw"), pitch=0.002)
        >>> float(m.build().fk([10.0], "jaw")[2, 3])
        0.02
        """
        return self.joint(name, "helical", parent, child, pitch=pitch, **keywords)

    @show_joint_keywords(joint)
    def cylindrical(
        self,
        name: str,
        parent: BodyLike,
        child: BodyLike,
        **keywords: Unpack[JointKeywords],
    ) -> Joint:
        """Add a cylindrical joint, a sleeve on a shaft, and return it.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        parent, child
            Two different bodies, as records or names. Frame F of the joint sits on the parent,
            frame M on the child.

        Returns
        -------
        Joint
            Record of the joint.

        Raises
        ------
        DescriptionError
            If the name is taken, or a body, frame, parameter or number is wrong.

        See Also
        --------
        Mechanism.joint : joints of all types.

        Notes
        -----
        The joint has two coordinates: the angle "rz" about z of F in radians, and the distance "z"
        along it in metres. It does not exist in the plane.

        Examples
        --------
        >>> m = Mechanism("sleeve")
        >>> _ = m.cylindrical("C", m.ground, m.body("sleeve"), limits={"z": (0, 0.5)})
        >>> m.build().coordinate_names
        ('C.rz', 'C.z')
        """
        return self.joint(name, "cylindrical", parent, child, **keywords)

    @show_joint_keywords(joint)
    def universal(
        self,
        name: str,
        parent: BodyLike,
        child: BodyLike,
        **keywords: Unpack[JointKeywords],
    ) -> Joint:
        """Add a universal (Cardan) joint and return it.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        parent, child
            Two different bodies, as records or names. Frame F of the joint sits on the parent,
            frame M on the child.

        Returns
        -------
        Joint
            Record of the joint.

        Raises
        ------
        DescriptionError
            If the name is taken, or a body, frame, parameter or number is wrong.

        See Also
        --------
        Mechanism.joint : joints of all types.

        Notes
        -----
        The joint has two coordinates in radians: the turn "rx" about x of F, then the turn "ry"
        about y of the cross, which is y of M. It does not exist in the plane.

        Examples
        --------
        >>> m = Mechanism("shaft")
        >>> _ = m.universal("U", m.ground, m.body("shaft"))
        >>> m.build().coordinate_names
        ('U.rx', 'U.ry')
        """
        return self.joint(name, "universal", parent, child, **keywords)

    @show_joint_keywords(joint)
    def planar(
        self,
        name: str,
        parent: BodyLike,
        child: BodyLike,
        **keywords: Unpack[JointKeywords],
    ) -> Joint:
        """Add a planar joint, a block on a table, and return it.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        parent, child
            Two different bodies, as records or names. Frame F of the joint sits on the parent,
            frame M on the child.

        Returns
        -------
        Joint
            Record of the joint.

        Raises
        ------
        DescriptionError
            If the name is taken, or a body, frame, parameter or number is wrong.

        See Also
        --------
        Mechanism.joint : joints of all types.

        Notes
        -----
        The joint has three coordinates: the distances "x" and "y" along x and y of F in metres,
        then the turn "rz" about z in radians. A particle has no "rz".

        Examples
        --------
        >>> m = Mechanism("car", dim=2)
        >>> _ = m.planar("pose", m.ground, m.body("car"))
        >>> m.build().coordinate_names
        ('pose.x', 'pose.y', 'pose.rz')
        """
        return self.joint(name, "planar", parent, child, **keywords)

    @show_joint_keywords(joint)
    def translation(
        self,
        name: str,
        parent: BodyLike,
        child: BodyLike,
        **keywords: Unpack[JointKeywords],
    ) -> Joint:
        """Add a joint that only translates and return it.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        parent, child
            Two different bodies, as records or names. Frame F of the joint sits on the parent,
            frame M on the child.

        Returns
        -------
        Joint
            Record of the joint.

        Raises
        ------
        DescriptionError
            If the name is taken, or a body, frame, parameter or number is wrong.

        See Also
        --------
        Mechanism.joint : joints of all types.

        Notes
        -----
        The joint has the coordinates "x", "y" and, in space, "z": distances along the axes of F in
        metres. The orientation of the child stays that at q = 0.

        Examples
        --------
        >>> m = Mechanism("gantry")
        >>> _ = m.translation("T", m.ground, m.body("head"))
        >>> m.build().coordinate_names
        ('T.x', 'T.y', 'T.z')
        """
        return self.joint(name, "translation", parent, child, **keywords)

    @show_joint_keywords(joint)
    def spherical(
        self,
        name: str,
        parent: BodyLike,
        child: BodyLike,
        *,
        angles: bool = False,
        **keywords: Unpack[JointKeywords],
    ) -> Joint:
        """Add a spherical joint, a ball, and return it.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        parent, child
            Two different bodies, as records or names. Frame F of the joint sits on the parent,
            frame M on the child.
        angles
            Use three angles "rz", "ry", "rx" about z, y' and x'' in radians as coordinates, in
            place of a unit quaternion "qw", "qx", "qy", "qz" (default: False). Angles can have
            limits, and are singular at ry = 90 and -90 degrees.

        Returns
        -------
        Joint
            Record of the joint.

        Raises
        ------
        DescriptionError
            If the name is taken, or a body, frame, parameter or number is wrong.

        See Also
        --------
        Mechanism.joint : joints of all types.

        Notes
        -----
        The velocity coordinates of a quaternion are the angular velocities "wx", "wy" and "wz"
        about the axes of M. The joint does not exist in the plane.

        Examples
        --------
        >>> m = Mechanism("shoulder")
        >>> _ = m.spherical("S", m.ground, m.body("arm"))
        >>> m.build().neutral
        array([1., 0., 0., 0.])
        """
        return self.joint(name, "spherical", parent, child, angles=angles, **keywords)

    @show_joint_keywords(joint)
    def free(
        self,
        name: str,
        parent: BodyLike,
        child: BodyLike,
        *,
        angles: bool = False,
        **keywords: Unpack[JointKeywords],
    ) -> Joint:
        """Add a joint that allows all motions and return it.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        parent, child
            Two different bodies, as records or names. Frame F of the joint sits on the parent,
            frame M on the child.
        angles
            Use three angles "rz", "ry", "rx" about z, y' and x'' in radians as coordinates of the
            orientation, in place of a unit quaternion (default: False).

        Returns
        -------
        Joint
            Record of the joint.

        Raises
        ------
        DescriptionError
            If the name is taken, or a body, frame, parameter or number is wrong.

        See Also
        --------
        Mechanism.joint : joints of all types.

        Notes
        -----
        The coordinates are the pose of M in F: in space "x", "y", "z" in metres and the quaternion
        "qw", "qx", "qy", "qz"; in the plane "x", "y" and the angle "rz"; for a particle its
        position.

        Examples
        --------
        >>> m = Mechanism("drone")
        >>> _ = m.free("pose", m.ground, m.body("drone"))
        >>> m.build().neutral
        array([0., 0., 0., 1., 0., 0., 0.])
        """
        return self.joint(name, "free", parent, child, angles=angles, **keywords)

    # ---- relations between coordinates

    def couple(
        self,
        of: str,
        sources: Mapping[str, ValueLike],
        offset: ValueLike = 0.0,
        where: Where | None = None,
    ) -> Coupling:
        """Add a linear relation: coordinate `of` = sum of multiplier * source + `offset`.

        Parameters
        ----------
        of
            Name of the coordinate that follows: the name of a joint with one coordinate, or such as
            "joint.rz".
        sources
            Multiplier by name of the coordinate that is followed; may be expressions in parameters.
        offset
            Value of `of` where all sources are 0, in radians or metres; may be an expression.
        where
            Place in a file, for error messages; readers of files give it.

        Returns
        -------
        Coupling
            Record of the relation.

        Raises
        ------
        DescriptionError
            If the coordinate follows others already, or `sources` is empty or no dict. Names are
            checked by `build`.

        See Also
        --------
        Mechanism.gear : the relation with one source.
        Mechanism.equation : relations that are not linear.

        Notes
        -----
        With one source (a gear or a mimic joint), `of` leaves the configuration, and its limits
        become limits of the source. With several (a differential), the relation is a constraint.

        Examples
        --------
        >>> m = Mechanism("differential")
        >>> for name in ("left", "right", "cage"):
        ...     _ = m.revolute(name, m.ground, m.body(f"{name} wheel"))
        >>> print(m.couple("cage", {"left": 0.5, "right": 0.5}).sentence)
        cage = 0.5 left + 0.5 right
        >>> m.build().mobility().dof
        2
        """
        of = str(of)
        subject = f"coupling of {of!r}"
        if not isinstance(sources, Mapping):
            checks.raise_problem(
                subject,
                f"its sources are {sources!r}",
                where,
                "they must be a dict of multipliers by name",
            )
        if of in self.couplings:
            checks.raise_problem(subject, "the coordinate follows others already", where)
        if not sources:
            checks.raise_problem(subject, "it has no source coordinate", where)
        try:
            checked = {str(k): read_value(v, "multiplier") for k, v in sources.items()}
            self.couplings[of] = Coupling(of, checked, read_value(offset, "offset"), where)
        except InputError as error:
            checks.raise_problem(subject, str(error), where)
        return self.couplings[of]

    def gear(self, driven: str, driver: str, ratio: ValueLike, offset: ValueLike = 0.0) -> Coupling:
        """Add a gear between two coordinates: driven = ratio * driver + offset.

        Parameters
        ----------
        driven
            Name of the coordinate that follows. It leaves the configuration.
        driver
            Name of the coordinate that is followed.
        ratio
            Multiplier; may be an expression in parameters. Negative for an external gear pair.
        offset
            Value of `driven` where `driver` is 0, in radians or metres; may be an expression.

        Returns
        -------
        Coupling
            Record of the relation.

        Raises
        ------
        DescriptionError
            If `driven` follows other coordinates already. Names are checked by `build`.

        See Also
        --------
        Mechanism.couple : relations with several sources.

        Examples
        --------
        >>> m = Mechanism("gears", dim=2)
        >>> _ = m.revolute("A", m.ground, m.body("small"))
        >>> _ = m.revolute("B", m.ground, m.body("large"), at=(0.3, 0), limits=(-1, 1))
        >>> _ = m.gear("B", "A", ratio=-0.5)
        >>> system = m.build()
        >>> system.coordinate_names, system.upper
        (('A',), array([2.]))
        """
        return self.couple(driven, {driver: ratio}, offset)

    def posture(self, name: str, coordinates: Mapping[str, float]) -> None:
        """Declare a named posture, which verbs take as a start.

        Parameters
        ----------
        name
            Name of the posture.
        coordinates
            Values by coordinate name in radians or metres. Other coordinates are neutral.

        Raises
        ------
        InputError
            If the name is taken, or a value is no finite number.

        Examples
        --------
        >>> m = Mechanism("arm", dim=2)
        >>> _ = m.revolute("q1", m.ground, m.body("link"))
        >>> m.posture("home", {"q1": 0.5})
        >>> m.build().q("home")
        array([0.5])
        """
        if name in self.postures:
            raise InputError(f"posture {name!r} exists already")
        self.postures[name] = checks.check_numbers(coordinates, f"posture {name!r}")

    def group(self, name: str, joints: Iterable[str]) -> None:
        """Declare a named group of joints, from which `System.group` makes a system.

        Parameters
        ----------
        name
            Name of the group.
        joints
            Names of its joints.

        Raises
        ------
        InputError
            If the name is taken.
        UnknownNameError
            If there is no such joint.

        Examples
        --------
        >>> m = Mechanism("two arms")
        >>> for side in ("left", "right"):
        ...     _ = m.revolute(side, m.ground, m.body(f"{side} arm"))
        >>> m.group("left arm", ["left"])
        >>> m.build().group("left arm").coordinate_names
        ('left',)
        """
        if checks.check_name(name, "group") in self.groups:
            raise InputError(f"group {name!r} exists already")
        names = tuple(map(str, joints))
        for joint in names:
            if joint not in self.joints:
                raise UnknownNameError("joint", joint, self.joints, self.name)
        self.groups[name] = tuple(dict.fromkeys(names))

    def ignore_pair(self, a: BodyLike, b: BodyLike, reason: str = "") -> None:
        """Exclude a pair of bodies from the checks for collisions.

        Parameters
        ----------
        a, b
            Two different bodies, as records or names.
        reason
            Reason for the reader of a file, such as "Adjacent".

        Raises
        ------
        DescriptionError
            If there is no such body, or both are one.
        """
        subject = "ignored pair"
        names = {self._find_body(body, subject, None).name for body in (a, b)}
        if len(names) == 1:
            checks.raise_problem(
                subject, f"both bodies are {str(a)!r}", None, "a pair has two bodies"
            )
        pair = tuple(name for name in self.bodies if name in names)
        self.ignored_pairs[pair] = str(reason)  # type: ignore[index]

    def lock(self, coordinates: Mapping[str, float]) -> Mechanism:
        """Fix coordinates at given values and remove them from the configuration.

        Parameters
        ----------
        coordinates
            Values by coordinate name in radians or metres. A second value replaces the first.

        Returns
        -------
        Mechanism
            The mechanism itself.

        Raises
        ------
        InputError
            If a value is no finite number. Names and limits are checked by `build`.

        Examples
        --------
        >>> m = Mechanism("arm", dim=2)
        >>> _ = m.revolute("q1", m.ground, m.body("upper"))
        >>> _ = m.revolute("q2", "upper", m.body("lower"), at=(0.5, 0))
        >>> m.lock({"q2": 0.3}).build().coordinate_names
        ('q1',)
        """
        self.locks |= checks.check_numbers(coordinates, "lock")
        return self

    # ---- constraints that are no joints

    def constrain(
        self, constraint: Constraint, name: str = "", where: Where | None = None
    ) -> Declared:
        """Add a constraint of `kempe.constraints` that the mechanism always satisfies.

        Parameters
        ----------
        constraint
            Constraint between frames or bodies of the mechanism, or on its coordinates. Its numbers
            may be expressions in parameters.
        name
            Name, which no other joint or constraint has (default: a description of the constraint).
        where
            Place in a file, for error messages; readers of files give it.

        Returns
        -------
        Declared
            Record of the constraint.

        Raises
        ------
        DescriptionError
            If there is no such frame, body or parameter, a number is wrong, or the constraint has a
            `weight`, `priority` or `tolerance`, which are for tasks of `ik`.

        Notes
        -----
        A constraint is no connection: each body needs a joint besides, a `free` joint where nothing
        else holds the body.

        Examples
        --------
        >>> from kempe.constraints import Distance
        >>> m = Mechanism("bead on a rod")
        >>> _ = m.free("x", m.ground, m.particle("bead"))
        >>> print(m.constrain(Distance("bead", "ground", 0.3), name="rod").sentence)
        rod: bead and ground are 0.3 m apart
        >>> m.build().mobility().dof
        2
        """
        return declare_constraint(self, constraint, name, where)

    def distance(
        self,
        name: str,
        a: BodyLike | Frame,
        b: BodyLike | Frame,
        length: ValueLike,
        at: PlaceLike = (0.0, 0.0, 0.0),
        child_at: PlaceLike = (0.0, 0.0, 0.0),
        where: Where | None = None,
    ) -> Declared:
        """Add a rod of constant length between a point of body `a` and a point of body `b`.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        a, b
            Two bodies or frames, as records or names.
        length
            Length of the rod in metres, above 0; may be an expression in parameters.
        at
            Point in the axes of `a`: 2 or 3 lengths in metres, which may be expressions in
            parameters, or the name of a frame on `a` (default: the origin of `a`).
        child_at
            Point in the axes of `b`, likewise (default: the origin of `b`).
        where
            Place in a file, for error messages; readers of files give it.

        Returns
        -------
        Declared
            Record of the constraint.

        Raises
        ------
        DescriptionError
            If the length is not above 0, or a body, frame, parameter or number is wrong.

        See Also
        --------
        kempe.constraints.Distance : the same constraint, also with bounds.

        Notes
        -----
        Both ends are ball hinges; the rod has no body and takes away one degree of freedom. It is
        no connection: both bodies need joints besides.

        Examples
        --------
        >>> m = Mechanism("crank, rod and slider", dim=2)
        >>> _ = m.revolute("A", m.ground, m.body("crank"))
        >>> _ = m.prismatic("S", m.ground, m.body("slider"), axis="x")
        >>> _ = m.distance("rod", "crank", "slider", 3.0, at=(1, 0))
        >>> m.build().mobility().dof
        1
        """
        return declare_placed_constraint(
            self, name, "distance", (a, at, {}), (b, child_at, {}), length, where
        )

    def point_on_line(
        self,
        name: str,
        a: BodyLike | Frame,
        b: BodyLike | Frame,
        at: PlaceLike = (0.0, 0.0, 0.0),
        child_at: PlaceLike = (0.0, 0.0, 0.0),
        where: Where | None = None,
        *,
        rpy: ValuesLike | None = None,
        angle: ValueLike | None = None,
        axis: AxisLike | None = None,
        quat_wxyz: ValuesLike | None = None,
        matrix: MatrixLike | None = None,
    ) -> Declared:
        """Keep a point of body `b` on a line of body `a`.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        a, b
            Two bodies or frames, as records or names.
        at
            Point of the line in the axes of `a`: 2 or 3 lengths in metres, which may be expressions in
            parameters, or the name of a frame on `a` (default: the origin of `a`).
        child_at
            Point in the axes of `b`, likewise (default: the origin of `b`).
        where
            Place in a file, for error messages; readers of files give it.
        rpy, angle, axis, quat_wxyz, matrix
            Orientation of the line, as in `frame`: its direction is z of the frame that they
            describe, or `axis`.

        Returns
        -------
        Declared
            Record of the constraint.

        Raises
        ------
        DescriptionError
            If the name is taken, or a body, frame, parameter or number is wrong.

        Notes
        -----
        The line takes away 2 degrees of freedom, in the plane 1; there it needs an `axis` of two
        numbers.

        Examples
        --------
        >>> m = Mechanism("slider", dim=2)
        >>> _ = m.planar("pose", m.ground, m.body("block"))
        >>> _ = m.point_on_line("slot", m.ground, "block", axis=(1, 0))
        >>> m.build().mobility().dof
        2
        """
        turn = make_turn(rpy, angle, axis, quat_wxyz, matrix)
        return declare_placed_constraint(
            self, name, "point_on_line", (a, at, turn), (b, child_at, {}), None, where
        )

    def point_on_plane(
        self,
        name: str,
        a: BodyLike | Frame,
        b: BodyLike | Frame,
        at: PlaceLike = (0.0, 0.0, 0.0),
        child_at: PlaceLike = (0.0, 0.0, 0.0),
        where: Where | None = None,
        *,
        rpy: ValuesLike | None = None,
        angle: ValueLike | None = None,
        axis: AxisLike | None = None,
        quat_wxyz: ValuesLike | None = None,
        matrix: MatrixLike | None = None,
    ) -> Declared:
        """Keep a point of body `b` in a plane of body `a`.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        a, b
            Two bodies or frames, as records or names.
        at
            Point of the plane in the axes of `a`: 2 or 3 lengths in metres, which may be expressions in
            parameters, or the name of a frame on `a` (default: the origin of `a`).
        child_at
            Point in the axes of `b`, likewise (default: the origin of `b`).
        where
            Place in a file, for error messages; readers of files give it.
        rpy, angle, axis, quat_wxyz, matrix
            Orientation of the plane, as in `frame`: its normal is z of the frame that they
            describe, or `axis`.

        Returns
        -------
        Declared
            Record of the constraint.

        Raises
        ------
        DescriptionError
            If the name is taken, or a body, frame, parameter or number is wrong.

        Notes
        -----
        The plane takes away 1 degree of freedom. The constraint does not exist in the plane.

        Examples
        --------
        >>> m = Mechanism("stool")
        >>> _ = m.free("pose", m.ground, m.body("stool"))
        >>> for k, foot in enumerate([(0, 0, 0), (1, 0, 0), (0, 1, 0)]):
        ...     _ = m.point_on_plane(f"foot {k}", m.ground, "stool", child_at=foot)
        >>> m.build().mobility().dof
        3
        """
        turn = make_turn(rpy, angle, axis, quat_wxyz, matrix)
        return declare_placed_constraint(
            self, name, "point_on_plane", (a, at, turn), (b, child_at, {}), None, where
        )

    def no_sideslip(self, name: str, frame: BodyLike | Frame, speed: ValueLike = 0.0) -> Declared:
        """Prescribe the velocity of a frame's origin along its y axis, as a wheel with axle y does.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        frame
            Body or frame, as a record or a name. Its x axis is the direction of rolling.
        speed
            Velocity along y in m/s (default: 0); may be an expression in parameters.

        Returns
        -------
        Declared
            Record of the constraint.

        Raises
        ------
        DescriptionError
            If the name is taken, or there is no such frame.

        See Also
        --------
        Mechanism.rolls : a wheel with its radius and angle.
        System.classify : which constraints are nonholonomic.

        Examples
        --------
        >>> car = Mechanism("car", dim=2)
        >>> _ = car.planar("pose", car.ground, car.body("body"))
        >>> _ = car.no_sideslip("rear axle", "body")
        >>> car.build().classify().constraints["rear axle"].kind
        'nonholonomic'
        """
        return self.constrain(constraints.NoSideslip(str(frame), speed=speed), name)

    def rolls(
        self,
        name: str,
        frame: BodyLike | Frame,
        radius: ValueLike,
        on: BodyLike | Frame | None = None,
        shape: str = "ball",
        spin: bool = True,
        one_sided: bool = False,
    ) -> Declared:
        """Let a ball or disc roll without slipping on the xy-plane of a frame.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        frame
            Body or frame whose origin is the centre of the ball or disc, as a record or a name.
        radius
            Radius in metres, above 0; may be an expression in parameters.
        on
            Body or frame whose xy-plane carries it (default: the ground).
        shape
            "ball" or "disc"; the axle of a disc is y of its frame.
        spin
            Whether it may turn about the normal of the plane (default: True).
        one_sided
            Whether it may leave the plane upwards (default: False).

        Returns
        -------
        Declared
            Record of the constraint.

        Raises
        ------
        DescriptionError
            If the name is taken, there is no such frame, or a number or word is wrong.

        See Also
        --------
        Mechanism.contact : contact without rolling.

        Examples
        --------
        >>> coin = Mechanism("coin")
        >>> _ = coin.free("pose", coin.ground, coin.body("coin"))
        >>> _ = coin.rolls("floor", "coin", radius=0.1, shape="disc")
        >>> coin.build().classify().velocity_dof
        3
        """
        other = None if on is None else str(on)
        return self.constrain(
            constraints.Rolls(str(frame), other, radius, shape, spin, one_sided), name
        )

    def contact(
        self,
        name: str,
        frame: BodyLike | Frame,
        on: BodyLike | Frame | None = None,
        radius: ValueLike = 0.0,
        shape: str = "ball",
    ) -> Declared:
        """Keep a point, ball or disc on or above the xy-plane of a frame.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        frame
            Body or frame whose origin is the point, or the centre of the ball or disc.
        on
            Body or frame whose xy-plane bounds the motion (default: the ground).
        radius
            Radius in metres (default: 0, a point); may be an expression in parameters.
        shape
            "ball" or "disc"; the axle of a disc is y of its frame.

        Returns
        -------
        Declared
            Record of the constraint.

        Raises
        ------
        DescriptionError
            If the name is taken, there is no such frame, or a number or word is wrong.

        See Also
        --------
        Mechanism.rolls : rolling without slipping.

        Examples
        --------
        >>> m = Mechanism("bead")
        >>> _ = m.free("x", m.ground, m.particle("bead"))
        >>> print(m.contact("floor", "bead").sentence)
        floor: bead stays above the plane of the ground
        """
        return self.constrain(
            constraints.Contact(str(frame), None if on is None else str(on), radius, shape), name
        )

    def equation(
        self,
        name: str,
        expression: str | Sequence[str] | Callable[..., object],
        of: Sequence[str] = (),
        time: bool = False,
    ) -> Declared:
        """Add an equation f = 0 of coordinates, or several.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        expression
            Text such as ``"A = 2*B"``, several texts, or a function. Text finds its coordinates
            itself; other names are parameters. A function is called with a mapping from the names
            in `of` to numbers, and returns one number or several.
        of
            Names of the coordinates of a function.
        time
            Call the function also with the time t in seconds (default: False).

        Returns
        -------
        Declared
            Record of the constraint.

        Raises
        ------
        DescriptionError
            If the name is taken, or the text cannot be read. Names are checked by `build`.

        See Also
        --------
        kempe.constraints.Equation : the same constraint for `ik`.
        Mechanism.couple : linear relations.

        Examples
        --------
        >>> m = Mechanism("arm", dim=2)
        >>> _ = m.revolute("A", m.ground, m.body("upper"))
        >>> _ = m.revolute("B", "upper", m.body("lower"), at=(0.5, 0))
        >>> print(m.equation("law", lambda x: x["A"] - 2 * x["B"], of=("A", "B")).sentence)
        law: A - 2*B = 0
        >>> m.build().mobility().dof
        1
        """
        return self.constrain(constraints.Equation(expression, of, time, name=name), name)

    def inequality(
        self,
        name: str,
        expression: str | Sequence[str] | Callable[..., object],
        of: Sequence[str] = (),
        time: bool = False,
    ) -> Declared:
        """Add an inequality f >= 0 of coordinates, or several.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        expression
            Text such as ``"1.2 - A"`` for A <= 1.2, several texts, or a function, as in `equation`.
        of
            Names of the coordinates of a function.
        time
            Call the function also with the time t in seconds (default: False).

        Returns
        -------
        Declared
            Record of the constraint.

        Raises
        ------
        DescriptionError
            If the name is taken, or the text cannot be read. Names are checked by `build`.

        See Also
        --------
        Mechanism.equation : equations.

        Examples
        --------
        >>> m = Mechanism("arm", dim=2)
        >>> _ = m.revolute("A", m.ground, m.body("link"))
        >>> print(m.inequality("stop", "1.2 - A").sentence)
        stop: 1.2 - A >= 0
        """
        return self.constrain(constraints.Inequality(expression, of, time, name=name), name)

    def velocity_equation(
        self,
        name: str,
        matrix: Sequence[Sequence[float | str]] | Callable[..., object],
        of: Sequence[str],
        b: float | str | Sequence[float | str] | Callable[..., object] = 0,
        time: bool = False,
    ) -> Declared:
        """Add equations A(q) v = b(q, t) of the velocities of coordinates.

        Parameters
        ----------
        name
            Name, which no other joint or constraint has.
        matrix
            Rows of A: numbers and texts, one for each coordinate of `of`, or a function that
            returns rows. A function is called as in `equation`.
        of
            Names of the coordinates whose velocities are v.
        b
            Right side: a number or text, one for each row, or a function (default: 0).
        time
            Call functions also with the time t in seconds (default: False).

        Returns
        -------
        Declared
            Record of the constraint.

        Raises
        ------
        DescriptionError
            If the name is taken, or a text cannot be read. Names are checked by `build`.

        Examples
        --------
        >>> skate = Mechanism("skate", dim=2)
        >>> _ = skate.planar("p", skate.ground, skate.body("blade"))
        >>> rows = [["sin(p.rz)", "-cos(p.rz)", 0]]
        >>> _ = skate.velocity_equation("edge", rows, of=("p.x", "p.y", "p.rz"))
        >>> skate.build().classify().velocity_dof
        2
        """
        return self.constrain(constraints.VelocityEquation(matrix, of, b, time, name=name), name)

    # ---- composition

    def attach(
        self,
        other: Mechanism | System,
        to: BodyLike | Frame | None = None,
        prefix: str = "",
        *,
        at: PlaceLike | None = None,
        rpy: ValuesLike | None = None,
        angle: ValueLike | None = None,
        axis: AxisLike | None = None,
        quat_wxyz: ValuesLike | None = None,
        matrix: MatrixLike | None = None,
    ) -> Mechanism:
        """Mount a copy of another mechanism on a body or frame by a fixed joint.

        Parameters
        ----------
        other
            Mechanism, or system of one, of the same `dim`. Its lengths are converted to the unit of
        this mechanism.
        to
            Body or frame that carries it, as a record or a name (default: the ground).
        prefix
            Text before all names of `other`, parameters excepted. Its ground becomes a body, held
            by the joint ``<prefix><ground>_mount``.
        at
            Place of the ground of `other` in the axes of the body, as in `frame` (default: its
            origin). With a frame as `to` give no `at`.
        rpy, angle, axis, quat_wxyz, matrix
            Orientation of the ground of `other`, as in `frame`.

        Returns
        -------
        Mechanism
            The mechanism itself.

        Raises
        ------
        InputError
            If the dimensions differ, or a parameter has two values.
        DescriptionError
            If both mechanisms have a name.
        UnknownNameError
            If there is no such body or frame.

        Notes
        -----
        Parameters of the same name and value are shared. They keep their numbers where lengths are
        converted: an expression in millimetres is divided by 1000 in a mechanism in metres.

        Examples
        --------
        >>> finger = Mechanism("finger", dim=2, ground="palm")
        >>> _ = finger.revolute("bend", "palm", finger.body("tip"))
        >>> hand = Mechanism("hand", dim=2)
        >>> _ = hand.attach(finger, prefix="left_", at=(-0.1, 0))
        >>> _ = hand.attach(finger, prefix="right_", at=(0.1, 0))
        >>> hand.build().coordinate_names
        ('left_bend', 'right_bend')
        """
        turn = make_turn(rpy, angle, axis, quat_wxyz, matrix)
        placement = {k: x for k, x in {"at": at, **turn}.items() if x is not None}
        attach_mechanism(self, _get_mechanism(other), to, prefix, placement)
        return self

    def subchain(self, base: BodyLike, tip: BodyLike | Frame) -> Mechanism:
        """Return the mechanism of the shortest path of joints between two bodies.

        Parameters
        ----------
        base
            Body that becomes the ground.
        tip
            Body or frame at the other end.

        Returns
        -------
        Mechanism
            Bodies and joints of the path, with the frames on them and the constraints, couplings
            and locks among them.

        Raises
        ------
        UnknownNameError
            If there is no such body or frame.
        DescriptionError
            If no joints lead from `base` to `tip`, or a coordinate of the path follows a free
            coordinate outside, without which the path would move differently.

        Examples
        --------
        >>> arm = Mechanism("arm", dim=2)
        >>> _ = arm.revolute("q1", arm.ground, arm.body("upper"))
        >>> _ = arm.revolute("q2", "upper", arm.body("lower"), at=(0.5, 0))
        >>> arm.subchain("upper", "lower").build().coordinate_names
        ('q2',)
        """
        return extract_subchain(self, str(base), str(tip))

    def copy(self) -> Mechanism:
        """Return an independent copy of the mechanism."""
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
            "groups",
            "ignored_pairs",
        ):
            setattr(out, key, copy.copy(getattr(self, key)))
        out.postures = {k: dict(v) for k, v in self.postures.items()}
        return out

    if not TYPE_CHECKING:  # else type checkers would accept any name

        def __getattr__(self, name: str) -> NoReturn:
            """Raise the error of a missing member: members of a `System` need `build` first."""
            member = MEMBERS_ELSEWHERE.get(name, name)
            said = ""
            if name in DECLARATIONS_ELSEWHERE:
                said = f"; did you mean {DECLARATIONS_ELSEWHERE[name]!r}?"
            elif member[0] != "_" and hasattr(import_late_member("System"), member):
                said = f": call build() first; {member} is a member of the System"
            raise_missing_member(self, name, said)

    def build(self) -> System:
        """Return the compiled `System`, which computes.

        Returns
        -------
        System
            The system. Later changes of the mechanism do not change it.

        Raises
        ------
        DescriptionError
            If the parts do not fit together: a body without a connection to the ground, an unknown
            coordinate in a coupling, lock, posture or equation, or couplings in a circle.

        Examples
        --------
        >>> m = Mechanism("door")
        >>> _ = m.revolute("hinge", m.ground, m.body("door"))
        >>> m.build()
        System('door', bodies=1, joints=1, nq=1)
        """
        with pause_garbage_collection(len(self.bodies)):
            return import_late_member("System")(self)

    def save(self, path: str | Path) -> Path:
        """Write the mechanism to a file and return the path.

        Parameters
        ----------
        path
            Name of the file. Its ending chooses the format: .toml (holds everything), .urdf, .sdf
            or .world (SDF).

        Returns
        -------
        Path
            The path.

        Raises
        ------
        InputError
            If the ending is another.
        DescriptionError
            If the format cannot hold a part of the mechanism; the message names each part.

        See Also
        --------
        kempe.read : read the file again.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> m = Mechanism("door")
        >>> _ = m.revolute("hinge", m.ground, m.body("door"))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     m.save(pathlib.Path(folder) / "door.toml").name
        'door.toml'
        """
        return import_late_member("write")(self, path)

    def __repr__(self) -> str:
        return (
            f"Mechanism({self.name!r}, dim={self.dim}, bodies={len(self.bodies) - 1}, "
            f"joints={len(self.joints)})"
        )

    def _repr_html_(self) -> str | None:
        """Return the mechanism's system as HTML for a notebook; None if it cannot be built yet."""
        try:
            return self.build()._repr_html_()
        except KempeError:
            return None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mechanism) and self.content() == other.content()

    __hash__ = None  # type: ignore[assignment]

    def content(self) -> tuple[object, ...]:
        """Return all content as nested tuples, in the order of declaration.

        Mechanisms with equal content are equal. Positions in files and notes are left out.
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
            tuple(self.groups.items()),
            tuple(self.ignored_pairs.items()),
            # metres are not named, so that names of stored answers stay
            *([] if self.unit == METRE else [self.unit]),
        )

    # ---- checks

    def _check_free_name(self, name: str, kind: str, where: Where | None) -> None:
        """Raise `DescriptionError` if a body or a frame has this name already."""
        taken = self.bodies.get(name) or self.frames.get(name)
        if taken is not None:
            what = "body" if name in self.bodies else "frame"
            first = f" ({taken.where})" if taken.where else ""
            checks.raise_problem(
                f"{kind} {name!r}",
                f"there is another {what} of this name{first}",
                where,
                "names must be unique",
            )

    def _check_parameters(self, names: Iterable[str]) -> None:
        """Raise `UnknownNameError` if a name is no parameter of the mechanism."""
        for name in sorted(names):
            if name not in self.parameters:
                raise UnknownNameError("parameter", name, self.parameters, self.name)

    def _check_joint_name(self, name: str, subject: str, where: Where | None) -> None:
        """Raise `DescriptionError` if a joint or a constraint has this name already."""
        taken = self.joints.get(name) or self.constraints.get(name)
        if taken is not None:
            what = "joint" if name in self.joints else "constraint"
            first = f" ({taken.where})" if taken.where else ""
            checks.raise_problem(
                subject,
                f"there is another {what} of this name{first}",
                where,
                "names must be unique",
            )

    def _find_body(self, body: BodyLike, subject: str, where: Where | None) -> Body:
        """Return the body of this name.

        Errors: `DescriptionError`.
        """
        name = body.name if isinstance(body, Body) else body
        if not isinstance(name, str) or name not in self.bodies:
            said = str(UnknownNameError("body", name, self.bodies, self.name))
            # by a program, not by a file, and not mistyped
            new = isinstance(name, str) and where is None and "did you mean" not in said
            advice = f"a new body is declared by body({name!r})" if new else ""
            checks.raise_problem(subject, said, where, advice)
        return self.bodies[name]

    def _make_placement(
        self, at: object, turn: Mapping[str, Any], subject: str, where: Where | None, on: Body
    ) -> Placement:
        """Return the placement of a point or frame with an orientation on a body.

        Errors: `DescriptionError`.
        """
        try:
            if isinstance(at, (Frame, str)):
                frame = self.frames.get(str(at))
                if frame is None or frame.body != on.name:
                    names = [f.name for f in self.frames.values() if f.body == on.name]
                    raise UnknownNameError("frame", str(at), names, f"body {on.name!r}")
                at = frame.X_BF
            X = place(at, **turn)
            self._check_parameters(X.names)
        except (InputError, UnknownNameError) as error:
            checks.raise_problem(subject, str(error), where)
        for way in ("rpy", "angle"):
            angles = turn.get(way)
            if angles is not None:
                given = angles if is_sequence(angles) or is_array(angles) else (angles,)
                named = checks.name_place(subject, way, where)
                warn_of_degrees(given, named, where is not None)
        return X


def choose_unused_name(m: Mechanism, name: str) -> str:
    """Return the name, with apostrophes appended while a part of the mechanism has it."""
    while any(name in parts for parts in (m.bodies, m.frames, m.joints, m.constraints)):
        name += "'"
    return name


def _get_mechanism(thing: Mechanism | System) -> Mechanism:
    """Return the mechanism itself, or the mechanism of a system.

    Errors: `InputError`.
    """
    mechanism = thing if isinstance(thing, Mechanism) else getattr(thing, "mechanism", None)
    if not isinstance(mechanism, Mechanism):
        raise InputError(f"{thing!r} is no Mechanism or System; read a file with kempe.read first")
    return mechanism


# ---- mounting mechanisms, and cutting out chains


def attach_mechanism(
    host: Mechanism,
    guest: Mechanism,
    to: Body | Frame | str | None,
    prefix: str,
    placement: Mapping[str, Any],
) -> None:
    """Copy `guest` into `host` and fix its ground to `to` (default: the ground)."""
    if guest.dim != host.dim:
        raise InputError(
            f"{guest.name!r} has dim {guest.dim}, {host.name!r} has dim {host.dim}; they must be "
            "equal"
        )
    if not isinstance(prefix, str):
        raise InputError(f"prefix is {format_value(prefix)}; it must be text")
    guest = call_late_function("convert_unit", guest, host.unit)
    _refuse_clashes(host, guest, prefix)
    trial = host.copy()
    name = str(to) if to is not None else host.ground.name
    if name in host.frames:
        if "at" in placement:
            raise InputError(
                "`at` cannot be given when mounting on a frame; mount on the body instead"
            )
        on = host.frames[name].body
        placement = {"at": host.frames[name].X_BF, **placement}
    elif name in host.bodies:
        on = name
    else:
        raise UnknownNameError("body or frame", name, [*host.bodies, *host.frames], host.name)
    for key, number in guest.parameters.items():
        if trial.parameters.setdefault(key, number) != number:
            raise InputError(
                f"parameter {key!r} is {trial.parameters[key]:g} here and {number:g} in "
                f"{guest.name!r}"
            )
    for body in guest.bodies.values():
        trial._add_body(replace(body, name=prefix + body.name))
    trial.joint(
        f"{prefix}{guest.ground.name}_mount", Fixed(), on, prefix + guest.ground.name, **placement
    )
    for joint in guest.joints.values():
        trial.joints[prefix + joint.name] = replace(
            joint,
            name=prefix + joint.name,
            parent=prefix + joint.parent,
            child=prefix + joint.child,
        )
    for frame in guest.frames.values():
        trial.frames[prefix + frame.name] = replace(
            frame, name=prefix + frame.name, body=prefix + frame.body
        )
    for coupling in guest.couplings.values():
        sources = {prefix + k: v for k, v in coupling.sources.items()}
        trial.couplings[prefix + coupling.of] = replace(
            coupling, of=prefix + coupling.of, sources=sources
        )
    for constraint in guest.constraints.values():
        bodies, frames = ({n: prefix + n for n in names} for names in (guest.bodies, guest.frames))
        trial.constraints[prefix + constraint.name] = rename_constraint(
            constraint, bodies, frames, prefix
        )
    for key, posture in guest.postures.items():
        trial.postures[prefix + key] = {prefix + k: v for k, v in posture.items()}
    for key, joints in guest.groups.items():
        trial.groups[prefix + key] = tuple(prefix + joint for joint in joints)
    for (a, b), reason in guest.ignored_pairs.items():
        trial.ignored_pairs[prefix + a, prefix + b] = reason
    trial.locks |= {prefix + k: v for k, v in guest.locks.items()}
    trial.notes += guest.notes
    trial.roots = tuple(dict.fromkeys(host.roots + guest.roots))
    host.__dict__.update(trial.__dict__)


def _refuse_clashes(host: Mechanism, guest: Mechanism, prefix: str) -> None:
    """Raise `DescriptionError` if the guest has names that the host has, too.

    Bodies and frames share names, and joints and constraints do.
    """
    taken: list[str] = []
    shared = [("bodies", "frames"), ("joints", "constraints")]
    for one, other in (*shared, ("postures", "postures"), ("groups", "groups")):
        here = {**getattr(host, one), **getattr(host, other)}
        mount = [f"{guest.ground.name}_mount"] if one == "joints" else []
        there = dict.fromkeys([*getattr(guest, one), *getattr(guest, other), *mount])
        names = [prefix + name for name in there if prefix + name in here]
        if names:
            what = one if one == other else f"{one} and {other}"
            more = f", ... ({len(names)} in all)" if len(names) > 4 else ""
            taken.append(f"{what} {', '.join(map(repr, names[:4]))}{more}")
    if taken:
        better = f"{prefix}2_" if prefix else re.sub(r"\W", "_", guest.name) + "_"
        allowed = f"give its names a prefix: attach(..., prefix={better!r})"
        raise DescriptionError(
            Fault(
                f"both have {'; '.join(taken)}",
                f"attach {guest.name!r} to {host.name!r}",
                None,
                allowed,
            )
        )


def extract_subchain(mechanism: Mechanism, base: str, tip: str) -> Mechanism:
    """Return the mechanism of the shortest path from body `base` to body or frame `tip`.

    Frames on these bodies, constraints between them, couplings and locks among these joints come
    along; one that follows a free coordinate outside is refused, as the chain alone would move
    differently.
    Errors: `UnknownNameError`, `DescriptionError`.
    """
    if base not in mechanism.bodies:
        raise UnknownNameError("body", base, mechanism.bodies, mechanism.name)
    if tip not in mechanism.bodies and tip not in mechanism.frames:
        raise UnknownNameError(
            "body or frame", tip, [*mechanism.bodies, *mechanism.frames], mechanism.name
        )
    end = mechanism.frames[tip].body if tip in mechanism.frames else tip
    path = find_path_joints(mechanism, base, end)
    return _extract_part(mechanism, f"{base} to {tip}", base, path)


def extract_group(mechanism: Mechanism, name: str, held: Mapping[str, float]) -> Mechanism:
    """Return the mechanism of the bodies and joints of a group.

    Its ground is the body from which all its joints branch off. Joints on the way to them that are
    not in the group are locked at the values `held`; bodies that are fixed to moving ones come
    along, and what `extract_subchain` keeps.
    Errors: `UnknownNameError`, `DescriptionError`; `InputError` for a group without joints.
    """
    if name not in mechanism.groups:
        raise UnknownNameError("group", name, mechanism.groups, mechanism.name)
    own = [mechanism.joints[joint] for joint in mechanism.groups[name]]
    if not own:
        raise InputError(f"group {name!r} has no joints")
    came = _find_shortest_paths(mechanism, mechanism.ground.name)
    ways = [_list_path_bodies(came, body) for joint in own for body in (joint.parent, joint.child)]
    shared = [bodies for bodies in zip(*ways, strict=False) if len(set(bodies)) == 1]
    base = shared[-1][0] if shared else mechanism.ground.name
    kept = {body: came[body] for way in ways for body in way[len(shared) :]}
    for body, joint in came.items():  # from the ground upwards
        if joint is not None and isinstance(joint.type, Fixed) and body not in kept:
            other = joint.parent if joint.child == body else joint.child
            if other in kept:
                kept[body] = joint
    path = list(dict.fromkeys([*(j for j in kept.values() if j is not None), *own]))
    out = _extract_part(mechanism, name, base, path)
    for joint in path:
        if joint.name not in mechanism.groups[name]:
            for coordinate in _list_coordinates(mechanism, joint):
                if coordinate in held:
                    out.locks.setdefault(coordinate, held[coordinate])
    return out


def _list_coordinates(mechanism: Mechanism, joint: Joint) -> list[str]:
    """Return the names of the coordinates of a joint."""
    of = joint.type.list_coordinate_names(mechanism.dim, mechanism.bodies[joint.child].particle)
    return [f"{joint.name}.{c}" if c else joint.name for c in of]


def _list_path_bodies(came: Mapping[str, Joint | None], body: str) -> list[str]:
    """Return the bodies from the ground to a body, in order."""
    way = [body]
    while (joint := came[way[-1]]) is not None:
        way.append(joint.parent if joint.child == way[-1] else joint.child)
    return way[::-1]


def _extract_part(mechanism: Mechanism, name: str, base: str, path: Iterable[Joint]) -> Mechanism:
    """Return the mechanism of these joints, their bodies, and all that belongs to them alone."""
    path = list(path)
    kept = {base} | {b for j in path for b in (j.parent, j.child)}
    out = Mechanism(f"{mechanism.name}: {name}", mechanism.dim, base, mechanism.unit)
    out.parameters = dict(mechanism.parameters)
    out.roots = mechanism.roots
    out.bodies = {
        n: mechanism.bodies[n]
        for n in [base, *(b for b in mechanism.bodies if b in kept and b != base)]
    }
    names = {j.name for j in path}
    out.joints = {n: j for n, j in mechanism.joints.items() if n in names}
    out.frames = {f.name: f for f in mechanism.frames.values() if f.body in kept}
    out.constraints = {
        n: c for n, c in mechanism.constraints.items() if {c.parent, c.child} <= kept
    }
    coordinates = {c for j in path for c in _list_coordinates(mechanism, j)}
    for coupling in mechanism.couplings.values():
        inside = [c in coordinates for c in (coupling.of, *coupling.sources)]
        if all(inside):
            out.couplings[coupling.of] = coupling
        elif inside[0]:
            _keep_coupling(mechanism, out, coupling, coordinates)
    out.locks |= {k: v for k, v in mechanism.locks.items() if k in coordinates}
    for name, posture in mechanism.postures.items():
        out.postures[name] = {k: v for k, v in posture.items() if k in coordinates}
    out.groups = {n: group for n, group in mechanism.groups.items() if names.issuperset(group)}
    out.ignored_pairs = {p: r for p, r in mechanism.ignored_pairs.items() if kept.issuperset(p)}
    return out


def _keep_coupling(
    mechanism: Mechanism, out: Mechanism, coupling: Coupling, coordinates: set[str]
) -> None:
    """Add a coupling to `out` if its outside sources are locked or follow coordinates inside.

    Errors: `DescriptionError` where it follows a free coordinate outside.
    """
    sources = dict(coupling.sources)
    offset = coupling.offset
    for _ in range(len(mechanism.couplings) + 1):
        outside = [c for c in sources if c not in coordinates]
        for name in outside:
            factor = sources[name]
            if name in mechanism.locks:
                offset = offset + factor * mechanism.locks[name]
            elif name in mechanism.couplings:
                via = mechanism.couplings[name]
                offset = offset + factor * via.offset
                for source, number in via.sources.items():
                    sources[source] = sources.get(source, 0.0) + factor * number
            else:
                problem = f"it follows {name}, outside the chain; lock that first"
                raise DescriptionError(
                    Fault(problem, f"coordinate {coupling.of!r}", coupling.where)
                )
            del sources[name]
    if sources:
        out.couplings[coupling.of] = replace(coupling, sources=sources, offset=offset)
    else:
        out.locks[coupling.of] = float(evaluate_value(offset, mechanism.parameters))


def _find_shortest_paths(mechanism: Mechanism, base: str, end: str = "") -> dict[str, Joint | None]:
    """Return the bodies by nearness to `base`, each with the last joint of the shortest path to it.

    The search stops at `end`.
    """
    neighbours: dict[str, list[tuple[str, Joint]]] = {b: [] for b in mechanism.bodies}
    for joint in sorted(mechanism.joints.values(), key=lambda j: (j.cut, j.name)):
        neighbours[joint.parent].append((joint.child, joint))
        neighbours[joint.child].append((joint.parent, joint))
    came: dict[str, Joint | None] = {base: None}
    queue = deque([base])
    while queue and end not in came:
        here = queue.popleft()
        if mechanism.bodies[here].particle:
            continue  # nothing can hang on a particle
        for there, joint in neighbours[here]:
            if there not in came:
                came[there] = joint
                queue.append(there)
    return came


def find_path_joints(mechanism: Mechanism, base: str, end: str) -> list[Joint]:
    """Return the joints on the shortest path from body `base` to body `end`.

    Errors: `DescriptionError`.
    """
    came = _find_shortest_paths(mechanism, base, end)
    if end not in came:
        raise DescriptionError(
            Fault(f"no joints lead from {base!r} to {end!r}", f"mechanism {mechanism.name!r}")
        )
    path: list[Joint] = []
    while (joint := came[end]) is not None:
        path.append(joint)
        end = joint.parent if joint.child == end else joint.child
    return path


def number_components(bodies: Iterable[str], ends: Iterable[tuple[str, str]]) -> dict[str, int]:
    """Return for each body the number of the connected component that holds the body."""
    neighbours: dict[str, list[str]] = {b: [] for b in bodies}
    for a, b in ends:
        neighbours[a].append(b)
        neighbours[b].append(a)
    part: dict[str, int] = {}
    for number, start in enumerate(neighbours):
        if start in part:
            continue
        part[start] = number
        queue = deque([start])
        while queue:
            for there in neighbours[queue.popleft()]:
                if there not in part:
                    part[there] = number
                    queue.append(there)
    return part
