"""Answers of `kempe info` and `kempe fk`: facts about a system, poses of frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.answers.tables import convert_columns, write_table
from kempe.constraints.base import evaluate_number_fields
from kempe.description.parts import Declared, Joint
from kempe.model.configurations import has_loops, list_limits
from kempe.model.coordinates import Follower, format_coordinate_name, format_relation
from kempe.report import Report, Table
from kempe.spaces.configuration_space import make_configuration_space
from kempe.spatial import Array
from kempe.views.overviews import format_connectivity
from kempe.words import Quantities, Quantity, Unit, format_count, format_fixed

if TYPE_CHECKING:
    from kempe.model.model import Model

CLOSED = 1e-5
"""Metres and radians that a loop may be open by before it is mentioned: numbers with six decimals
count as closed."""


# ---- what a system is


@dataclass(frozen=True, eq=False, repr=False)
class SystemFacts(Report):
    """Facts about a `system`: connectivity, degrees of freedom, bodies, joints, loops, limits."""

    _has_angles = True
    system: Model

    @property
    def status(self) -> str:
        """Name of the system, its numbers of bodies and joints, and its kind, in one sentence."""
        system = self.system
        place = "in the plane" if system.dim == 2 else "in space"
        bodies = format_count(len(system.body_names) - 1, "body")
        joints = format_count(len(system.structure.joints), "joint")
        return f"{system.name}: {bodies}, {joints}, {place}; {system.kind}"

    def _make_tables(self) -> Sequence[Table]:
        system = self.system
        s = system.structure
        tables = [Table((), self._make_overview(), record=True), self._make_bodies_table()]
        loops = [
            (
                j.name,
                _describe_joint_type(j),
                f"{j.parent} - {j.child}",
                *self._describe_joint_coordinates(j),
            )
            for j in (s.joints[name] for name in s.closures)
        ]
        title = "Loops, closed by the joints that the tree leaves out"
        tables.append(Table(("joint", "type", "bodies", "q", "limits"), loops, title=title))
        declared = [_describe_constraint(system, c) for c in system._mechanism.constraints.values()]
        rows = [
            (
                c["name"],
                c["type"] + ", one-sided" * bool(c["one_sided"]),
                ", ".join([f"{c['parent']} - {c['child']}"] * bool(c["parent"]) + c.get("of", [])),
                c["says"],
            )
            for c in declared
        ]
        heads = ("constraint", "type", "of", "what it asks")
        tables.append(Table(heads, rows, title="Declared constraints"))
        follow = [_format_follower(of, f) for of, f in s.couplings.items()]
        follow += [format_relation(r) for r in s.relations]
        frames = [f"{f.name} on {f.body}" for f in s.frames.values()]
        for title, lines in (
            ("Coordinates that follow others", follow),
            ("Frames", frames),
            ("Notes", s.notes),
        ):
            tables.append(Table(("",), [(f"  {line}",) for line in lines], title=title))
        return [table for table in tables if table.rows]

    def _make_overview(self) -> list[tuple[str, str]]:
        """Return the labelled lines about the whole system, without empty ones."""
        system = self.system
        parameters = [f"{k} = {v:g}" for k, v in system.structure.parameters.items()]
        rows = [
            (
                "connectivity",
                f"{format_connectivity(system)}  (parent of each body, 0 is the ground)",
            ),
            ("degrees of freedom", self._describe_freedoms()),
            ("configuration space", make_configuration_space(system).within),
            ("coordinates", f"q has {format_count(system.nq, 'number')}"),
            ("parameters", ", ".join(parameters)),
            ("postures", ", ".join(system.structure.posture_names)),
            ("groups of joints", ", ".join(system._mechanism.groups)),
        ]
        return [row for row in rows if row[1]]

    def _describe_freedoms(self) -> str:
        """Describe the degrees of freedom of the tree, and how many the equations leave at least."""
        system = self.system
        equations = make_configuration_space(system).constraints
        loops = len(system.structure.closures)
        dof = str(_count_tree_freedoms(system))
        if not equations:
            return dof if loops else f"{dof} (a tree, no loops)"
        constraints = system._mechanism.constraints.values()
        declared = sum(c.count_equations(system.dim) > 0 for c in constraints)
        what = [
            format_count(n, name) for n, name in ((loops, "loop"), (declared, "constraint")) if n
        ]
        of = " and ".join(what) or "coordinates that follow several others"
        kind = "coordinate" if system.nv == system.nq else "velocity coordinate"
        return (
            f"at least {max(system.nv - equations, 0)} ({format_count(system.nv, kind)} - "
            f"{format_count(equations, 'equation')} of {of}); kempe dof finds the true number"
        )

    def _make_bodies_table(self) -> Table:
        """Return the table of bodies, each with its parent, its joint and the limits of the joint."""
        system = self.system
        names = system.body_names
        rows: list[tuple[Any, ...]] = [(0, names[0], "", "", "ground", "", "")]
        each = zip(names[1:], system.parent, system.structure.parent_joints, strict=True)
        for i, (name, parent, joint_name) in enumerate(each, start=1):
            joint = system.structure.joints[joint_name]
            kind = _describe_joint_type(joint) + " (walked backwards)" * (joint.child != name)
            shown = name + " (particle)" * system._mechanism.bodies[name].particle
            rows.append(
                (i, shown, parent, joint.name, kind, *self._describe_joint_coordinates(joint))
            )
        return Table(("#", "body", "parent", "joint", "type", "q", "limits"), rows)

    def _describe_joint_coordinates(self, joint: Joint) -> tuple[str, Quantities]:
        """Return the indices in q of a joint's coordinates as text, and their limits."""
        system = self.system
        names = system.structure.coordinates_of_joint(joint.name)
        own = [name for name in names if name in system.coordinate_names]
        if not own:
            return "follows" * bool(names), Quantities(())
        places = [system.coordinate_names.index(name) for name in own]
        where = str(places[0]) if len(places) == 1 else f"{places[0]}..{places[-1]}"
        labels = [name[len(joint.name) + 1 :] if len(names) > 1 else "" for name in own]
        limits = [(label, self._limits[name]) for label, name in zip(labels, own, strict=True)]
        return where, Quantities([x for x in limits if np.isfinite(x[1].value).any()])

    @cached_property
    def _limits(self) -> dict[str, Quantity]:
        """Lower and upper limit of each coordinate, by its name."""
        return list_limits(self.system)

    def _collect_data(self) -> dict[str, Any]:
        system = self.system
        s = system.structure
        space = make_configuration_space(system)
        return {
            "name": system.name,
            "dim": system.dim,
            "kind": system.kind,
            "parent": list(system.parent),
            "nq": system.nq,
            "nv": system.nv,
            "dof_of_tree": _count_tree_freedoms(system),
            "configuration_space": {
                "shape": space.shape,
                "ambient_dimension": space.ambient_dimension,
                "limited": space.limited,
                "constraints": space.constraints,
                "text": space.within,
            },
            "bodies": [
                {
                    "number": i,
                    "name": name,
                    "parent": system.parent[i - 1] if i else None,
                    "joint": s.parent_joints[i - 1] if i else None,
                    "particle": bool(i) and system._mechanism.bodies[name].particle,
                }
                for i, name in enumerate(system.body_names)
            ],
            "joints": [
                {
                    "name": j.name,
                    "type": j.type.type_name,
                    "options": j.type.options,
                    "parent": j.parent,
                    "child": j.child,
                    "in_tree": j.name not in s.closures,
                    "coordinates": s.coordinates_of_joint(j.name),
                    "actuated": j.actuated,
                }
                for j in s.joints.values()
            ],
            "coordinates": [
                {
                    "index": i,
                    "name": name,
                    "unit": Unit(limit.unit),
                    "lower": Quantity(limit.value[0], limit.unit),
                    "upper": Quantity(limit.value[1], limit.unit),
                }
                for i, (name, limit) in enumerate(self._limits.items())
            ],
            "closures": list(s.closures),
            "frames": [{"name": f.name, "body": f.body} for f in s.frames.values()],
            "couplings": [
                {
                    "of": of,
                    "source": f.source,
                    "multiplier": f.multiplier,
                    "offset": f.offset,
                }
                for of, f in s.couplings.items()
            ],
            "relations": [format_relation(r) for r in s.relations],
            "constraints": [
                _describe_constraint(system, c) for c in system._mechanism.constraints.values()
            ],
            "postures": list(s.posture_names),
            "groups": {name: list(joints) for name, joints in system._mechanism.groups.items()},
            "parameters": s.parameters,
            "notes": list(s.notes),
        }


def _count_tree_freedoms(system: Model) -> int:
    """Count the degrees of freedom of the spanning tree: those of all joints but the cut joints."""
    bodies = system._mechanism.bodies
    joints = system.structure.joints
    known = set(system.structure.velocity_names)
    cut = [joints[name] for name in system.structure.closures]
    names = (
        format_coordinate_name(j.name, v)
        for j in cut
        for v in j.type.list_velocity_names(system.dim, bodies[j.child].particle)
    )
    return system.nv - sum(name in known for name in names)


def _describe_joint_type(joint: Joint) -> str:
    """Return the type of a joint with its options, such as 'helical, pitch 0.01 m/rad'."""
    unit = {"pitch": " m/rad"}
    options = [
        f"{k} {v:g}{unit.get(k, '')}" if isinstance(v, float) else k
        for k, v in joint.type.options.items()
    ]
    return ", ".join([joint.type.type_name, *options])


def _format_follower(name: str, f: Follower) -> str:
    """Return the equation of a coordinate that follows another one, such as 'B = 2 A + 0.1'."""
    if f.source is None:
        return f"{name} = {f.offset:g} (held)"
    sign = "-" if f.multiplier == -1.0 else f"{f.multiplier:g} "
    factor = "" if f.multiplier == 1.0 else sign
    offset = f" {'-' if f.offset < 0 else '+'} {abs(f.offset):g}" if f.offset else ""
    return f"{name} = {factor}{f.source}{offset}"


def _describe_constraint(system: Model, c: Declared) -> dict[str, Any]:
    """Return a declared constraint as data, with its numbers of equations and one-sided rows."""
    length = c.length(system.structure.parameters) if c.rod else None
    return {
        "name": c.name,
        "type": c.kind,
        "parent": c.parent,
        "child": c.child,
        "length": length,
        "equations": c.count_equations(system.dim),
        "one_sided": c.count_bounds(system.dim),
        "says": evaluate_number_fields(c.of, system.structure.parameters).sentence,
    } | ({"of": list(reads)} if (reads := c.of.coordinate_names) else {})


def describe_largest_gap(system: Model, q: Any) -> str:
    """Describe the largest gap of a loop at q: "'C' is open by 0.3 m"; '' without a gap."""
    if not has_loops(system):
        return ""
    from kempe.equations import closure_rows

    error = np.abs(closure_rows.compute_residual(system, q)).reshape(
        -1, len(closure_rows.list_row_names(system))
    )
    error = np.where(np.isfinite(error), error, 0.0).max(axis=0, initial=0.0)
    worst = int(np.argmax(error))
    if error[worst] <= CLOSED:
        return ""
    name, row = closure_rows.list_row_names(system)[worst]
    unit = " rad" if row.startswith("r") else " m" if row in ("x", "y", "z", "distance") else ""
    return f"{name!r} is open by {error[worst]:.3g}{unit}"


def list_outside_limits(system: Model, q: Array) -> list[str]:
    """Return the names of the coordinates of q (nq,) that are outside their limits."""
    limits = [limit.value for limit in list_limits(system).values()]
    return [
        name
        for name, x, (low, high) in zip(system.coordinate_names, q.tolist(), limits, strict=True)
        if not low <= x <= high
    ]


# ---- poses

COLUMNS: Mapping[str, str] = {name: "m" for name in "xyz"} | {
    name: "rad" for name in ("roll", "pitch", "yaw")
}
"""Numbers of a pose, with their units; angles turn about fixed axes."""


@dataclass(frozen=True, eq=False, repr=False)
class Poses(Report):
    """Poses of a `frame`, or of all bodies where `frame` is None.

    `X` are the poses as `System.fk` gives them for one configuration or several.
    """

    _has_angles = True
    system: Model
    frame: str | None
    X: Array

    @property
    def several(self) -> bool:
        """Whether the poses belong to several configurations."""
        return self.X.ndim > (2 if self.frame is not None else 3)

    @property
    def status(self) -> str:
        """Name of the frame, of its system, and of the ground in which the poses are given."""
        what = self.frame or "all bodies"
        return f"{what} of {self.system.name}, seen from {self.system.body_names[0]}"

    def _compute_pose_rows(self) -> Array:
        """Return rows (n, 6) of x, y, z [m] and roll, pitch, yaw [rad], one row for each pose."""
        X = self.X.reshape(-1, 4, 4)
        out = spatial.xyz_rpy_from_pose(X)
        out[np.isnan(X).any(axis=(-2, -1))] = np.nan
        return out

    def _make_row_labels(self) -> tuple[list[str], list[list[Any]]]:
        """Return the heads and texts of the columns that stand before the numbers of each row."""
        names = [self.frame] if self.frame is not None else list(self.system.body_names)
        count = len(self.X) if self.several else 1
        q: list[list[Any]] = [[k] * self.several for k in range(count)]
        bodies = [[i, name] * (self.frame is None) for i, name in enumerate(names)]
        heads = ["q"] * self.several + ["#", "body"] * (self.frame is None)
        return heads, [a + b for a in q for b in bodies]

    def _make_tables(self) -> Sequence[Table]:
        heads, labels = self._make_row_labels()
        rows = [
            (*label, *(Quantity(x, unit) for x, unit in zip(row, COLUMNS.values(), strict=True)))
            for label, row in zip(labels, self._compute_pose_rows().tolist(), strict=True)
        ]
        return [Table((*heads, *COLUMNS), rows, grid=True)]

    def _list_notes(self, degrees: bool = False) -> list[str]:
        if self.X.ndim > 2:
            return []
        return ["  ".join(f"{format_fixed(x):>10}" for x in row) for row in self.X.tolist()]

    def _collect_data(self) -> dict[str, Any]:
        names = [self.frame] if self.frame is not None else list(self.system.body_names)
        rows = zip(self._compute_pose_rows(), self.X.reshape(-1, 4, 4), strict=True)
        poses = [
            {
                "frame": names[i % len(names)],
                "xyz": row[:3],
                "rpy": Quantity(row[3:], "rad"),
                "matrix": X,
            }
            for i, (row, X) in enumerate(rows)
        ]
        head = {"system": self.system.name, "seen_from": self.system.body_names[0]}
        each = [poses[i : i + len(names)] for i in range(0, len(poses), len(names))]
        if self.frame is None:
            return head | ({"configurations": each} if self.several else {"bodies": each[0]})
        return head | ({"configurations": poses} if self.several else poses[0])

    def save(self, path: Path, *, degrees: bool = False) -> Path:
        """Write the poses to a file.

        A .npy file holds the array (..., 4, 4) as it is; a .csv file has x, y, z, roll, pitch, yaw
        in each line. Where the poses are those of all bodies, lines begin with the numbers of the
        configuration and of the body.
        """
        names = list(COLUMNS)
        rows = self._compute_pose_rows()
        if self.frame is None:
            index = np.indices((len(self.X) if self.several else 1, self.X.shape[-3]))
            rows = np.concatenate([index.reshape(2, -1).T.astype(float), rows], axis=1)
            names = ["configuration", "body", *names]
        return write_table(path, *convert_columns(names, rows, COLUMNS, degrees), self.X)
