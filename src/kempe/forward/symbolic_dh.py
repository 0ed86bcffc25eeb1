"""Denavit-Hartenberg tables of chains, with lengths in named parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.arguments import check_name, explain_errors
from kempe.description.dh import CONVENTIONS, DHRow, from_dh
from kempe.errors import UnsupportedError
from kempe.forward.joint_lines import JointLine
from kempe.forward.symbolic import (
    SymbolicStep,
    SymbolLeaves,
    list_oriented_steps,
    multiply_steps,
    sympy,
    unwrap_alignments,
)
from kempe.poses import make_placement_from_pose
from kempe.report import Report, Table
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.description.mechanism import Mechanism
    from kempe.model.model import FrameLike, Model

SMALL = 1e-12
"""Numbers below this are rounding."""
PARALLEL = 1e-8
NEARLY = 1e-3
"""Directions nearer than the first [rad] are parallel: the feet of their common normal would be so
far away that their digits say less. Of those nearer than the second the normal is small."""


@dataclass(frozen=True, eq=False, repr=False)
class DHTable(Report):
    """The Denavit-Hartenberg table of a chain: one `DHRow` for each joint.

    `base` is the pose of frame 0 in the ground, `tool` that of the frame in the last frame.

    Lengths are numbers or text in parameters, angles radians; `base` and `tool` are numbers (4, 4).
    """

    _entries = ("frame", "convention", "base", "tool")

    system: Model
    frame: str
    convention: str
    rows: tuple[DHRow, ...]
    base: Array
    tool: Array

    def mechanism(self) -> Mechanism:
        """Return the mechanism that `kempe.from_dh` makes of the table.

        Its frame 'tool' is where the frame of the table was.
        """
        parameters = self.system.structure.parameters
        ends = (make_placement_from_pose(X) for X in (self.base, self.tool))
        return from_dh(self.rows, self.convention, self.system.name, *ends, parameters=parameters)

    @property
    def status(self) -> str:
        """Title of the report: frame, system and convention."""
        return f"{self.frame} of {self.system.name}, {self.convention} Denavit-Hartenberg"

    def _make_tables(self) -> Sequence[Table]:
        rows: list[list[str]] = []
        for row in self.rows:
            turns = row.type == "revolute"
            theta, d = (
                f"{_format_entry(x)} + {row.name}"
                if moves and _format_entry(x) != "0"
                else row.name
                if moves
                else _format_entry(x)
                for x, moves in ((row.theta, turns), (row.d, not turns))
            )
            rows.append(
                [str(row.name), _format_entry(row.a), _format_entry(row.alpha), str(d), str(theta)]
            )
        return [Table(("joint", "a", "alpha", "d", "theta"), rows)]

    def _list_notes(self, degrees: bool = False) -> list[str]:
        said = (
            ("frame 0 in the ground", self.base),
            (f"{self.frame} in the last frame", self.tool),
        )
        return [
            f"{what}: {_format_placement(X)}"
            for what, X in said
            if np.abs(X - np.eye(4)).max() > SMALL
        ]

    def _collect_data(self) -> dict[str, Any]:
        numbers = [
            {k: getattr(row, k) for k in ("name", "type", "a", "alpha", "d", "theta")}
            for row in self.rows
        ]
        return super()._collect_data() | {"rows": numbers}


@explain_errors
def to_dh(
    system: Model,
    frame: FrameLike,
    convention: str = "standard",
    *,
    symbols: Mapping[str, Any] | None = None,
    snap: float = 0.0,
) -> DHTable:
    """Derive the Denavit-Hartenberg table of the chain that moves a frame.

    Frames stand on the common normals of neighbouring axes (Denavit and Hartenberg, 1955); where
    axes are parallel, d is zero; of axes that are nearly so the common normal is far away, unless
    `snap` makes them parallel. `convention` is "standard" or "modified", as `kempe.from_dh`
    explains it. Parameters on which directions depend are replaced by their numbers. `symbols` and
    `snap` are those of `derive_fk`, for files whose angles are rounded. Errors: those of
    `derive_steps`; `UnsupportedError` for quaternions, screws and gears, and where nothing moves
    the frame.

    >>> import kempe
    >>> print(to_dh(kempe.load("two_link"), "e"))
    e of two_link, standard Denavit-Hartenberg
      joint = q1, a = l1, alpha = 0, d = 0, theta = q1
      joint = q2, a = l2, alpha = 0, d = 0, theta = q2
    """
    convention = check_name("convention", convention, CONVENTIONS)
    name = system.structure.frame_name(frame)
    given = dict(symbols or {})
    values = system.structure.parameters
    while True:
        found = _derive_table(system, name, convention, SymbolLeaves(system, given, snap))
        if isinstance(found, DHTable):
            return found
        given |= {str(s): values[str(s)] for s in found}  # directions depend on these lengths


def _derive_table(
    system: Model, frame: str, convention: str, leaves: SymbolLeaves
) -> DHTable | set[Any]:
    """Derive the table, or return the parameters on which directions of normals depend."""
    axes, tip = derive_joint_lines(system, frame, leaves)
    unknown = set[Any]().union(
        tip.free_symbols, *(a.point.free_symbols | a.direction.free_symbols for a in axes)
    )
    if unknown := sorted(set(map(str, unknown)) - set(system.structure.parameters)):
        raise UnsupportedError(
            f"no numbers are known for {', '.join(unknown)}: a table needs the sense of each length"
        )
    tip_R = np.array(tip[:3, :3], dtype=float)
    lines = [*axes, JointLine(tip[:3, 3], tip[:3, 2])]
    start, x = _find_first_frame(lines[0])
    # feet of the normal on the axis and on the next one
    ends = [(start, start)]
    x_axes = [x]
    for i, (one, two) in enumerate(zip(lines[:-1], lines[1:], strict=True)):
        foot, other, x = _find_common_normal(
            one, two, ends[-1][1], x_axes[-1], system, last=i == len(axes) - 1
        )
        if x.free_symbols:
            return x.free_symbols
        ends.append((foot, other))
        x_axes.append(x)
    rows = list[DHRow]()
    before = (0.0, 0.0)
    for i, axis in enumerate(axes):
        (_, at) = ends[i]
        (foot, other) = ends[i + 1]
        h = axis.direction
        x = x_axes[i + 1]
        a = _to_table_entry(_drop_rounding((other - foot).dot(x)))
        d = _to_table_entry(_drop_rounding((foot - at).dot(h)))
        alpha = _to_table_entry(derive_angle(h, lines[i + 1].direction, x))
        theta = _to_table_entry(derive_angle(x_axes[i], x, h))
        held = (a, alpha) if convention == "standard" else before
        before = (a, alpha)
        rows.append(
            DHRow(
                *held,
                d,
                theta,
                "revolute" if axis.turns else "prismatic",
                axis.name,
                limits=axis.limits if np.isfinite(axis.limits).any() else None,
            )
        )
    base = _compute_pose(x_axes[0], lines[0].direction, start, system)
    last = ends[-1][1 if convention == "standard" else 0]
    X_n = _compute_pose(
        x_axes[-1], lines[-1 if convention == "standard" else -2].direction, last, system
    )
    X_tip = spatial.pose(tip_R, _evaluate_vector(tip[:3, 3], system))
    return DHTable(system, frame, convention, tuple(rows), base, spatial.inverse(X_n) @ X_tip)


def derive_joint_lines(
    system: Model, frame: str, leaves: SymbolLeaves, none: str = "there is no table"
) -> tuple[list[JointLine], Any]:
    """Derive the lines of the joints at q = 0, and the pose of the frame there, in symbols.

    Directions are numbers.

    Errors: `UnsupportedError` for joints that are no turn or slide of their own, and, with the
    words `none`, where nothing moves the frame.
    """
    steps = unwrap_alignments(
        step for _, motions in list_oriented_steps(system, frame, leaves) for step in motions
    )
    names = {
        leaves.express_coordinate(n): n
        for n in system.coordinate_names
        if leaves.express_coordinate(n).is_Symbol
    }
    still: list[SymbolicStep] = []
    at: list[tuple[SymbolicStep, int, int, str]] = []
    for step in steps:
        amount: Any = step.amount
        moving = [name for s, name in names.items() if amount is not None and amount.has(s)]
        if amount is not None and moving:
            rate: Any = (
                sympy.diff(amount, leaves.express_coordinate(moving[0]))
                if step.kind != "rotation"
                else None
            )
            if len(moving) > 1 or rate not in (1, -1) or any(moving[0] == name for *_, name in at):
                raise UnsupportedError(
                    f"{step.subject} has no row in a table: each has a turn or a slide of its own"
                )
            at.append((step, len(still), int(rate), moving[0]))
            step = replace(step, amount=amount.xreplace(dict.fromkeys(names, 0)))
        still.append(step)
    if not at:
        raise UnsupportedError(f"no joint moves {frame!r}: {none}")
    values = {sympy.Symbol(n): x for n, x in system.structure.parameters.items()}
    poses = [multiply_steps(still[:k], leaves) for _, k, _, _ in at] + [
        multiply_steps(still, leaves)
    ]
    poses = [X.applyfunc(_evaluate_sines) for X in poses]
    directions = [
        X[:3, :3] * step.axis * rate for X, (step, _, rate, _) in zip(poses[:-1], at, strict=True)
    ]
    bent = set[Any]().union(*(v.free_symbols for v in [*directions, poses[-1][:3, :3]]))
    fixed = {s: values[s] for s in bent if s in values}
    bounds: dict[str, Any] = dict(
        zip(system.structure.velocity_names, system.structure.limits.tolist(), strict=True)
    )
    out: list[JointLine] = []
    for X, h, (step, _, _, name) in zip(poses[:-1], directions, at, strict=True):
        direction = tidy_matrix(h.subs(fixed))
        limits = tuple(bounds[name])
        out.append(
            JointLine(X[:3, 3].subs(fixed), direction, step.kind == "turn", name, limits=limits)
        )
    tip = poses[-1].subs(fixed)
    tip[:3, :3] = tidy_matrix(tip[:3, :3])
    return out, tip


def _find_first_frame(axis: JointLine) -> tuple[Any, Any]:
    """Find origin and x axis of frame 0, near the ground and along its x axis where possible."""
    h = axis.direction
    foot = axis.point - axis.direction * axis.direction.dot(axis.point)
    ground = sympy.Matrix([1, 0, 0] if abs(float(h[0])) < 0.9 else [0, 1, 0])
    x = ground - h * h.dot(ground)
    return foot, tidy_matrix(x / sympy.sqrt(x.dot(x)))


def _find_common_normal(
    one: JointLine, two: JointLine, at: Any, x: Any, system: Model, last: bool
) -> tuple[Any, Any, Any]:
    """Find the common normal of two axes: its two feet, and its direction from first to second.

    `at` is a point of the first axis, through which the normal of parallel axes goes, and `x` the
    direction that it has where the axes are one; the last normal of parallel axes goes through the
    tip. Where the direction depends on lengths these are its symbols.
    """
    h = one.direction
    k = two.direction
    gap = two.point - at
    n = h.cross(k)
    sine = math.sqrt(float(n.dot(n)))
    if sine < PARALLEL:
        foot = at + h * h.dot(gap) if last else at
        other = two.point if last else two.point - k * k.dot(gap)
        way = tidy_matrix(other - foot)
        if way.is_zero_matrix:
            return foot, foot, x
        sizes = np.abs(_evaluate_vector(way, system))
        pivot = way[int(sizes.argmax())] if sizes.max() > 0.0 else next(w for w in way if w != 0)
        ratio = sympy.simplify(way / pivot)
        sense = -1 if float(_evaluate_vector(sympy.Matrix([pivot]), system)[0]) < 0.0 else 1
        return foot, other, tidy_matrix(sense * ratio / sympy.sqrt(ratio.dot(ratio)))
    n = tidy_matrix(n) if sine > NEARLY else n  # else what is tidied away may count
    size = n.dot(n)
    foot = at + h * (gap.cross(k).dot(n) / size)
    other = two.point + k * (gap.cross(h).dot(n) / size)
    unit = n / sympy.sqrt(size)
    if float(unit.dot(x)) < -SMALL:  # the sense that turns the frame least
        unit = -unit
    return foot, other, tidy_matrix(unit)


def derive_angle(a: Any, b: Any, about: Any) -> Any:
    """Derive the angle from a to b about an axis perpendicular to both.

    Multiples of 15 degrees are exact.
    """
    angle = sympy.atan2(about.dot(a.cross(b)), a.dot(b))
    exact = sympy.pi * sympy.Rational(round(float(angle) / math.pi * 12), 12)
    return exact if abs(float(angle - exact)) < SMALL else angle


def tidy_matrix(matrix: Any) -> Any:
    """Expand the entries of a matrix and drop terms that are rounding errors."""
    return matrix.applyfunc(_drop_rounding)


def _drop_rounding(x: Any) -> Any:
    """Expand an expression and drop terms that are rounding errors."""
    x = sympy.expand(x)
    return x.xreplace({f: sympy.Integer(0) for f in x.atoms(sympy.Float) if abs(f) < SMALL})


def _evaluate_sines(x: Any) -> Any:
    """Replace sines and cosines of numbers by decimals."""
    return x.xreplace({f: f.evalf() for f in x.atoms(sympy.sin, sympy.cos) if f.is_number})


def _to_table_entry(x: Any) -> Any:
    """Return an expression as a number, or as text where it has symbols or pi."""
    return str(x) if x.free_symbols or x.has(sympy.pi) else float(x)


def _evaluate_vector(v: Any, system: Model) -> Array:
    """Evaluate a vector (n,) at the values of the parameters."""
    values = {sympy.Symbol(n): x for n, x in system.structure.parameters.items()}
    return np.array(v.subs(values), dtype=float).reshape(v.shape)[:, 0]


def _compute_pose(x: Any, z: Any, origin: Any, system: Model) -> Array:
    """Compute the pose (4, 4) of a frame from its x axis, z axis and origin."""
    across = _evaluate_vector(x, system)
    along = _evaluate_vector(z, system)
    # of axes that are nearly parallel x is a rounded normal
    across = across - along * (along @ across)
    across = across / np.linalg.norm(across)
    axes = [across, np.cross(along, across), along]
    return spatial.pose(np.stack(axes, axis=1), _evaluate_vector(origin, system))


def _format_placement(X: Array) -> str:
    """Format a pose as the keywords that place a frame."""
    p, rpy = (
        ", ".join(_format_entry(float(x)) for x in np.where(np.abs(v) < SMALL, 0.0, v))
        for v in (X[:3, 3], spatial.matrix_to_rpy(X[:3, :3]))
    )
    return f"at ({p}), rpy ({rpy})"


def _format_entry(x: Any) -> str:
    """Format an entry of the table."""
    return str(x) if isinstance(x, str) else f"{x + 0.0:.6g}"
