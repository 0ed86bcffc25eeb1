"""Systems and answers as plain data (dicts, lists, numbers, text): for JSON, and for `report`."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import library, spatial
from kempe.constraints.base import with_numbers
from kempe.description.parts import Declared, Joint
from kempe.errors import DescriptionError, Fault, KempeError
from kempe.model.configurations import has_loops, units
from kempe.model.coordinates import Follower, coordinate_name, relation_text
from kempe.report import MOST_JUDGED
from kempe.words import jsonable

if TYPE_CHECKING:
    from kempe.answers.answer import Answer
    from kempe.model.model import Model
    from kempe.motion.path import Path

DEGREE = math.pi / 180.0
CLOSED = 1e-5
"""Metres and radians that a loop may be open by before it is mentioned: numbers with six decimals
count as closed."""


def in_degrees(
    values: Any, names: Iterable[str], unit: dict[str, str], degrees: bool
) -> spatial.Array:
    """Values (..., k) of the named coordinates, the angles among them in degrees if `degrees` asks
    for it.
    """
    factors = [1.0 / DEGREE if degrees and unit[n] == "rad" else 1.0 for n in names]
    return np.asarray(values, dtype=float) * factors


def system_facts(system: Model, degrees: bool = False) -> dict[str, Any]:
    """All that `kempe info` says of a system, by topic; limits of angles in radians, or in degrees."""
    # Here, as only one command needs it.
    from kempe.spaces.configuration_space import configuration_space

    space = configuration_space(system)
    closures = set(system.structure.closures)
    return {
        "name": system.name,
        "dim": system.dim,
        "kind": system.kind,
        "angle_unit": "deg" if degrees else "rad",
        "parent": list(system.parent),
        "nq": system.nq,
        "nv": system.nv,
        "dof_of_tree": _dof_of_tree(system),
        "configuration_space": {
            "shape": space.shape,
            "ambient_dimension": space.ambient_dimension,
            "limited": space.limited,
            "constraints": space.constraints,
            "text": space.within,
        },
        "bodies": _bodies(system),
        "joints": [
            _joint(system, j, j.name not in closures) for j in system.structure.joints.values()
        ],
        "coordinates": coordinates(system, degrees),
        "closures": list(system.structure.closures),
        "frames": [{"name": f.name, "body": f.body} for f in system.structure.frames.values()],
        "couplings": [_coupling(of, f) for of, f in system.structure.couplings.items()],
        "relations": [relation_text(r) for r in system.structure.relations],
        "constraints": [_constraint(system, c) for c in system.mechanism.constraints.values()],
        "postures": list(system.structure.posture_names),
        "groups": {name: list(joints) for name, joints in system.groups.items()},
        "parameters": system.structure.parameters,
        "notes": list(system.structure.notes),
    }


def _dof_of_tree(system: Model) -> int:
    """Degrees of freedom of the tree: those of all joints without those of the joints that it left
    out.
    """
    bodies = system.mechanism.bodies
    joints = system.structure.joints
    known = set(system.structure.velocity_names)
    cut = [joints[name] for name in system.structure.closures]
    names = (
        coordinate_name(j.name, v)
        for j in cut
        for v in j.type.velocities(system.dim, bodies[j.child].particle)
    )
    return system.nv - sum(name in known for name in names)


def _bodies(system: Model) -> list[dict[str, Any]]:
    names = system.body_names
    records = system.mechanism.bodies
    out: list[dict[str, Any]] = [
        {"number": 0, "name": names[0], "parent": None, "joint": None, "particle": False}
    ]
    for i, (parent, joint) in enumerate(
        zip(system.parent, system.structure.parent_joints, strict=True), start=1
    ):
        out.append(
            {
                "number": i,
                "name": names[i],
                "parent": parent,
                "joint": joint,
                "particle": records[names[i]].particle,
            }
        )
    return out


def _joint(system: Model, joint: Joint, in_tree: bool) -> dict[str, Any]:
    return {
        "name": joint.name,
        "type": joint.type.type_name,
        "options": joint.type.options,
        "parent": joint.parent,
        "child": joint.child,
        "in_tree": in_tree,
        "coordinates": system.structure.coordinates_of_joint(joint.name),
        "actuated": joint.actuated,
    }


def coordinates(system: Model, degrees: bool = False) -> list[dict[str, Any]]:
    """Each entry of q: its index, name, unit and limits (None where there is none)."""
    unit = units(system)
    limits = in_degrees(system.structure.limits.T, system.structure.velocity_names, unit, degrees)
    of = dict(zip(system.structure.velocity_names, limits.T.tolist(), strict=True))
    out: list[dict[str, int | str | float | None]] = []
    for i, name in enumerate(system.coordinate_names):
        lower, upper = of.get(name, (-math.inf, math.inf))
        shown = "deg" if degrees and unit[name] == "rad" else unit[name]
        out.append(
            {
                "index": i,
                "name": name,
                "unit": shown,
                "lower": _number(lower),
                "upper": _number(upper),
            }
        )
    return out


def _coupling(of: str, follower: Follower) -> dict[str, Any]:
    return {
        "of": of,
        "source": follower.source,
        "multiplier": follower.multiplier,
        "offset": follower.offset,
    }


def _constraint(system: Model, c: Declared) -> dict[str, Any]:
    """A declared constraint with the freedoms of position that it takes away, and its number of
    one-sided rows.
    """
    length = c.length(system.structure.parameters) if c.rod else None
    return {
        "name": c.name,
        "type": c.kind,
        "parent": c.parent,
        "child": c.child,
        "length": length,
        "equations": c.equations(system.dim),
        "one_sided": c.bounds(system.dim),
        "says": with_numbers(c.of, system.structure.parameters).sentence,
    } | ({"of": list(reads)} if (reads := c.of.reads) else {})


def largest_gap(system: Model, q: Any) -> str:
    """What is open most at q, and by how much: "'C' is open by 0.3 m"; '' where everything is
    closed.
    """
    if not has_loops(system):
        return ""
    from kempe.equations import closure_rows

    error = np.abs(closure_rows.residual(system, q)).reshape(
        -1, len(closure_rows.row_names(system))
    )
    error = np.where(np.isfinite(error), error, 0.0).max(axis=0, initial=0.0)
    worst = int(np.argmax(error))
    if error[worst] <= CLOSED:
        return ""
    name, row = closure_rows.row_names(system)[worst]
    unit = " rad" if row.startswith("r") else " m" if row in ("x", "y", "z", "distance") else ""
    return f"{name!r} is open by {error[worst]:.3g}{unit}"


def pose_rows(X: spatial.Array, degrees: bool = False) -> spatial.Array:
    """Poses (..., 4, 4) as rows (..., 6): x, y, z in metres, roll, pitch, yaw in radians or
    degrees.
    """
    out = spatial.xyz_rpy_from_pose(X)
    out[np.isnan(X).any(axis=(-2, -1))] = np.nan
    if degrees:
        out[..., 3:] /= DEGREE
    return out


def pose_facts(X: spatial.Array, frame: str, degrees: bool = False) -> dict[str, Any]:
    """A pose (4, 4) as matrix, position [m] and fixed-axis angles roll, pitch, yaw [rad, or
    degrees].
    """
    numbers = pose_rows(X, degrees)
    return {
        "frame": frame,
        "xyz": jsonable(numbers[:3]),
        "rpy": jsonable(numbers[3:]),
        "matrix": jsonable(X),
    }


def poses_facts(
    system: Model, frame: str | None, X: spatial.Array, degrees: bool = False
) -> dict[str, Any]:
    """Poses as `System.fk` gives them: of a frame, or of all bodies where `frame` is None; one or
    many q.
    """
    unit = {
        "system": system.name,
        "seen_from": system.body_names[0],
        "angle_unit": "deg" if degrees else "rad",
    }

    def one(Y: spatial.Array) -> Any:
        if frame is not None:
            return pose_facts(Y, frame, degrees)
        return [pose_facts(y, name, degrees) for name, y in zip(system.body_names, Y, strict=True)]

    if X.ndim == (2 if frame is not None else 3):
        return unit | (one(X) if frame is not None else {"bodies": one(X)})
    return unit | {"configurations": [one(Y) for Y in X]}


def answer_facts(answer: Answer, degrees: bool = False) -> dict[str, Any]:
    """The data of an answer, with the angles of its configurations in degrees if requested."""
    if not degrees:
        return answer.data()
    names = answer.system.coordinate_names
    q = answer._by_name(in_degrees(answer.q, names, units(answer.system), True))
    return answer.data() | {"angle_unit": "deg", "q": q}


def judged(answer: Answer | Path) -> dict[str, Any]:
    """What the judge says of the configurations of an answer, under "judged"; empty where there are
    too many.
    """
    return {"judged": jsonable(answer.judged.data())} if answer.q.size <= MOST_JUDGED else {}


def models() -> dict[str, str]:
    """The shipped models by name, each with a line that says what it is."""
    return {name: library.describe(name) for name in library.names()}


def model_text(name: str) -> str:
    """The TOML of a shipped model. Errors: `UnknownNameError`."""
    return library.path(name).read_text(encoding="utf-8")


def problem_facts(problem: Fault) -> dict[str, Any]:
    """A finding about a file: its place, what it is about, what is wrong, what is allowed."""
    where = problem.where
    return {
        "file": where.file if where else None,
        "line": where.line or None if where else None,
        "column": where.column or None if where else None,
        "subject": problem.subject,
        "message": problem.message,
        "allowed": problem.allowed,
        "text": str(problem),
    }


def error_facts(error: BaseException | str) -> dict[str, Any]:
    """An error as data: its sentence under 'error', and what it carries."""
    out: dict[str, Any] = {"error": str(error), "type": type(error).__name__}
    if isinstance(error, str):
        out["type"] = "UsageError"
    elif isinstance(error, DescriptionError):
        out["problems"] = [problem_facts(p) for p in error.problems]
    elif isinstance(error, KempeError) and hasattr(error, "allowed"):
        out["allowed"] = list(error.allowed)  # type: ignore[attr-defined]
    return out


def significant(x: float) -> str:
    """A number with three significant digits, without exponent."""
    return f"{x:.0f}" if abs(x) >= 100 else f"{x:.3g}"


def _number(x: Any) -> float | None:
    return jsonable(float(x))
