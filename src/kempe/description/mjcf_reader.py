"""Reader of MJCF text, through the model that MuJoCo's compiler makes of it.

The compiler resolves includes, defaults, angles, frames, replicas and references; what is left is a
table of bodies and joints. `q` has the order and the values of MuJoCo's qpos, except for
coordinates that follow others.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kempe.constraints import KINDS
from kempe.description.mechanism import Mechanism
from kempe.description.mjcf_product import make_product
from kempe.description.mjcf_text import Merged, compile_mjcf
from kempe.description.source import Findings, list_folders
from kempe.errors import Where
from kempe.poses import place
from kempe.spatial import pose, quat_wxyz_to_matrix
from kempe.words import format_count

Row = dict[str, Any]
_KINDS: Mapping[str, Any] = KINDS

HIDDEN_GROUP = 3
"""Geoms of this group and above are not seen in MuJoCo's viewer unless they are asked for."""

SIZES: dict[str, Callable[[list[float]], dict[str, Any]]] = {
    "sphere": lambda s: {"radius": s[0]},
    "capsule": lambda s: {"radius": s[0], "length": 2 * s[1]},
    "cylinder": lambda s: {"radius": s[0], "length": 2 * s[1]},
    "box": lambda s: {"size": [2 * x for x in s]},
    "ellipsoid": lambda s: {"radii": s},
    "mesh": lambda s: {},
}
"""Kinds of geoms, and the sizes of their shapes: MuJoCo writes halves."""


def read_mjcf(
    text: str | bytes, source: str = "<text>", *, package_dirs: Iterable[str | Path] = ()
) -> Mechanism:
    """Mechanism that an MJCF text describes; MuJoCo's world is the ground.

    `source` names the text in messages. Files that it includes may lie in its folder and in
    `package_dirs`. Several joints of one body are one joint, a product of theirs, called like the
    body. Sites are frames, keyframes are postures, equalities are constraints and couplings. What
    does not map is in `notes` of the mechanism. Errors: `MissingExtraError` without the extra
    [mjcf], `DescriptionError` with what MuJoCo's compiler refuses.
    """
    merged = Merged(text, source, package_dirs)
    reader = _Reader(compile_mjcf(merged), merged)
    mechanism = reader.read_mechanism()
    mechanism.roots = tuple(map(str, list_folders(package_dirs)))
    return mechanism


class _Reader:
    """Reader that turns the tables of a compiled model into a mechanism."""

    def __init__(self, tables: Row, merged: Merged):
        self.t = tables
        self.merged = merged
        self.findings = Findings()
        self.bodies = _choose_names(tables["bodies"], "body", set())
        self.sites = _choose_names(tables["sites"], "site", set(self.bodies))
        self.m = Mechanism(tables["name"] or "mjcf", ground=self.bodies[0])
        self.joints_of: dict[int, list[tuple[int, Row]]] = {}
        for j, row in enumerate(tables["joints"]):
            self.joints_of.setdefault(row["body"], []).append((j, row))
        self.coordinates: dict[int, str] = {}
        """Of each hinge and slide the name of its coordinate."""
        self.addresses: list[tuple[int, str]] = []
        """Places in qpos, and the coordinates there."""
        self.taken: set[str] = set()
        """Names of joints and constraints."""

    def read_mechanism(self) -> Mechanism:
        """Return the mechanism.

        Errors: `DescriptionError` with all problems of the file.
        """
        self._check_numbers()
        self.findings.raise_problems()
        for b, row in enumerate(self.t["bodies"][1:], 1):
            with self.findings.record_errors(f"body {self.bodies[b]!r}", self._locate_row(row)):
                self._read_body(b, row)
        for name, row in zip(self.sites, self.t["sites"], strict=True):
            self.m.frame(
                name,
                self.bodies[int(row["body"])],
                at=tuple(row["pos"]),
                where=self._locate_row(row),
                **_make_turn(row),
            )
        self.findings.raise_problems()
        for row in self.t["geoms"]:
            self._read_shape(row)
        self._read_equalities()
        self._read_tendon_ranges()
        self._read_postures()
        self._note_unread_elements()
        self.findings.raise_problems()
        self.m.notes = self.findings.notes
        return self.m

    def _locate_row(self, row: Row) -> Where:
        """Return the place in the file of the element that a row describes."""
        return self.merged.locate_line(row["line"])

    def _choose_name(self, *wishes: str) -> str:
        """Return the first free name among the wishes for a joint or constraint, and reserve it."""
        name = next((w for w in wishes if w and w not in self.taken), wishes[-1])
        while name in self.taken:
            name += "'"
        self.taken.add(name)
        return name

    def _check_numbers(self) -> None:
        """Record a problem for each number that is not finite; MuJoCo accepts them."""
        for word, key in (("body", "bodies"), ("joint", "joints"), ("site", "sites")):
            for row in self.t[key]:
                for what in ("pos", "quat", "axis", "range"):
                    if not np.isfinite(row.get(what) or ()).all():
                        self.findings.add_problem(
                            f"{what} has a number that is not finite",
                            f"{word} {row['name']!r}",
                            self._locate_row(row),
                            "it must be finite numbers",
                        )
        if not np.isfinite(self.t["qpos0"]).all():
            self.findings.add_problem(
                "ref of a joint is not finite",
                "",
                self.merged.locate_line(0),
                "it must be a number",
            )

    # ---- bodies and joints

    def _read_body(self, b: int, row: Row) -> None:
        """Add a body and its joints to the mechanism."""
        m = self.m
        name = self.bodies[b]
        where = self._locate_row(row)
        parent = self.bodies[int(row["parent"])]
        center = row["center"] if row["mass"] is not None else None
        m.body(name, mass=row["mass"], center=center, where=where)
        joints = self.joints_of.get(b, [])
        if not joints:
            m.fixed(
                self._choose_name(f"{name}_fixed"),
                parent,
                name,
                at=tuple(row["pos"]),
                **_make_turn(row),
            )
            if row["mocap"]:
                said = "it is a mocap body, whose pose a program sets; it is fixed at its pose in the file"
                self.findings.add_note(said, f"body {name!r}", where)
        elif len(joints) == 1:
            self._read_joint(parent, name, row, *joints[0])
        else:
            self._read_joint_product(parent, name, row, joints)

    def _read_joint(self, parent: str, child: str, body: Row, j: int, joint: Row) -> None:
        """Add the only joint of a body to the mechanism."""
        m = self.m
        kind = joint["kind"]
        name = self._choose_name(joint["name"], child)
        where = self._locate_row(joint)
        if kind == "free":
            m.free(name, m.ground, child, where=where)
            self._add_addresses(
                joint, [f"{name}.{c}" for c in m.joints[name].type.list_coordinate_names()]
            )
            return
        on_body = place(tuple(body["pos"]), **_make_turn(body)) @ place(tuple(joint["pos"]))
        if kind == "ball":
            m.spherical(name, parent, child, at=on_body, child_at=joint["pos"], where=where)
            self._add_addresses(
                joint, [f"{name}.{c}" for c in m.joints[name].type.list_coordinate_names()]
            )
            self._note_ball_range(name, joint)
            return
        ref = self.t["qpos0"][joint["address"]]
        along = place(axis=tuple(joint["axis"]))
        back = place((0.0, 0.0, ref)) if kind == "slide" else place(angle=ref)
        m.joint(
            name,
            "prismatic" if kind == "slide" else "revolute",
            parent,
            child,
            at=on_body @ along,
            child_at=place(tuple(joint["pos"])) @ along @ back,
            limits=joint["range"],
            where=where,
        )
        self.coordinates[j] = name
        self._add_addresses(joint, [name])

    def _read_joint_product(
        self, parent: str, child: str, body: Row, joints: list[tuple[int, Row]]
    ) -> None:
        """Add the joints of a body as one joint that has all their coordinates in order."""
        where = self._locate_row(joints[0][1])
        name = self._choose_name(child)
        product = make_product([row for _, row in joints], self.t["qpos0"])
        on_body = place(tuple(body["pos"]), **_make_turn(body))
        own = [product.names[i] for i in product.of_joint]
        m = self.m
        limits: dict[str, Any] = {}
        for (_, row), part in zip(joints, own, strict=True):
            if row["range"] is not None and row["kind"] != "ball":
                limits[part] = row["range"]
        m.joint(
            name,
            product.words,
            parent,
            child,
            at=on_body @ product.first,
            child_at=product.last,
            limits=limits or None,
            where=where,
        )
        m.lock({f"{name}.{product.names[i]}": x for i, x in product.held.items()})
        said: list[str] = []
        for (j, row), part, i in zip(joints, own, product.of_joint, strict=True):
            if row["kind"] == "ball":
                self._add_addresses(row, [f"{name}.{c}" for c in product.names[i : i + 4]])
                self._note_ball_range(name, row)
                said.append(f"{row['name'] or 'the ball'} is {name}.qw, qx, qy, qz")
            else:
                self.coordinates[j] = f"{name}.{part}"
                self._add_addresses(row, [f"{name}.{part}"])
                said.append(f"{row['name'] or 'a ' + row['kind']} is {name}.{part}")
        self.findings.add_note(
            f"its {len(joints)} joints are one: {', '.join(said)}", f"body {child!r}", where
        )

    def _add_addresses(self, joint: Row, names: Sequence[str]) -> None:
        """Record the places in qpos of the coordinates of a joint."""
        self.addresses += [(joint["address"] + k, name) for k, name in enumerate(names)]

    def _note_ball_range(self, name: str, joint: Row) -> None:
        """Note that the range of a ball joint is left out."""
        if joint["range"] is not None:
            said = f"its range of {joint['range'][1]:.6g} rad about any axis is left out"
            self.findings.add_note(
                said, f"joint {joint['name'] or name!r}", self._locate_row(joint)
            )

    # ---- shapes

    def _read_shape(self, row: Row) -> None:
        """Add a geom to its body as a shape.

        A geom without contacts is only drawn; geoms in groups from 3 on are not drawn.
        """
        on = self.bodies[int(row["body"])]
        where = self._locate_row(row)
        subject = f"geom {row['name']!r}" if row["name"] else f"a geom of body {on!r}"
        color = row["color"]
        visual = row["group"] < HIDDEN_GROUP and (color is None or color[3] > 0)
        sizes = SIZES.get(row["kind"])
        mesh = self.t["meshes"].get(row["mesh"])
        said = ""
        if sizes is None:
            said = f"a {row['kind']} is no shape of Kempe, and is left out"
        elif row["mesh"] and row["kind"] != "mesh":
            said = f"it is a {row['kind']} around the mesh {row['mesh']!r}, and is left out"
        elif row["mesh"] and (mesh is None or not mesh["file"]):
            said = f"its mesh {row['mesh']!r} is no file, and is left out"
        elif mesh and mesh["moved"]:
            said = f"its mesh {row['mesh']!r} has a refpos or refquat, and is left out"
        elif not visual and not row["touches"]:
            said = "it is neither seen nor touched, and is left out"
        if said or sizes is None:
            self.findings.add_note(said, subject, where)
            return
        given = (
            {"path": self._make_mesh_path(mesh), "scale": mesh["scale"]}
            if mesh
            else sizes(row["size"])
        )
        with self.findings.record_errors(subject, where):
            self.m.shape(
                on,
                row["kind"],
                **given,
                at=tuple(row["pos"]),
                **_make_turn(row),
                visual=visual,
                collision=row["touches"],
                color=None if color is None else np.clip(color, 0.0, 1.0).tolist(),
                name=row["name"],
                where=where,
            )

    def _make_mesh_path(self, mesh: Row) -> str:
        """Return the path of a mesh, relative to the folder of the model."""
        file = os.path.basename(mesh["file"]) if mesh["strip"] else mesh["file"]
        return os.path.normpath(
            os.path.join(self.merged.find_folder(mesh["line"]), mesh["folder"], file)
        )

    # ---- equalities and tendons

    def _read_equalities(self) -> None:
        """Add the active equalities to the mechanism as constraints and couplings."""
        for e, row in enumerate(self.t["equalities"]):
            name = self._choose_name(row["name"], f"equality{e}")
            subject = f"equality {name!r}"
            where = self._locate_row(row)
            make = {
                "connect": self._read_connect,
                "weld": self._read_weld,
                "joint": self._read_joint_equality,
                "tendon": self._read_tendon_equality,
            }.get(row["kind"])
            if not row["active"]:
                self.findings.add_note("it is not active, and is left out", subject, where)
            elif make is None:
                self.findings.add_note(f"{row['kind']} is left out", subject, where)
            else:
                with self.findings.record_errors(subject, where):
                    make(name, row, where)

    def _list_ends(self, row: Row) -> tuple[str, str]:
        """Return the names of the two bodies or sites that an equality ties."""
        names = self.sites if row["sites"] else self.bodies
        return names[int(row["a"])], names[int(row["b"])]

    def _read_connect(self, name: str, row: Row, where: Where) -> None:
        """Add an equality that holds two points together."""
        a, b = self._list_ends(row)
        d = row["data"]
        at_a, at_b = ((0.0, 0.0, 0.0),) * 2 if row["sites"] else (tuple(d[0:3]), tuple(d[3:6]))
        self.m.constrain(_KINDS["position"](a, at_b, at_a, other=b), name, where)

    def _read_weld(self, name: str, row: Row, where: Where) -> None:
        """Add an equality that holds the pose of body b in body a.

        Point d[3:6] of body a is d[0:3] of body b, which is turned by the quaternion d[6:10]; with
        a torque scale of 0 the rotation stays free.
        """
        a, b = self._list_ends(row)
        d = row["data"]
        R = np.eye(3) if row["sites"] else quat_wxyz_to_matrix(d[6:10])
        anchor = np.zeros(3) if row["sites"] else np.array(d[0:3])
        there = np.zeros(3) if row["sites"] else np.array(d[3:6])
        if d[10] == 0.0:
            point = _KINDS["position"](b, tuple(there.tolist()), tuple(anchor.tolist()), other=a)
            self.m.constrain(point, name, where)
        else:
            X = pose(R, there - R @ anchor)
            self.m.constrain(_KINDS["pose"](b, X, other=a), name, where)

    def _read_joint_equality(self, name: str, row: Row, where: Where) -> None:
        """Add the relation: coordinate a = polynomial of b, both relative to references."""
        a = self.coordinates[row["a"]]
        b = self.coordinates.get(row["b"])
        c = row["data"][0:5]
        ref_a = self._get_reference(row["a"])
        ref_b = self._get_reference(row["b"]) if b else 0.0
        single = a not in self.m.couplings and a not in self.m.locks
        if single and (b is None or not any(c[1:])):
            self.m.lock({a: ref_a + c[0]})
        elif single and b is not None and not any(c[2:]) and not self._is_follower(b, a):
            self.m.couple(a, {b: c[1]}, ref_a + c[0] - c[1] * ref_b, where)
        else:
            of_b = [] if b is None else [(b, 1.0)]
            self._add_relation(name, [(a, 1.0)], ref_a, of_b, ref_b, c, where)

    def _get_reference(self, j: int) -> float:
        """Return the reference value of a joint in qpos0."""
        return float(self.t["qpos0"][self.t["joints"][j]["address"]])

    def _is_follower(self, name: str, other: str) -> bool:
        """Whether the coordinate `name` is `other`, or follows it through couplings."""
        while name != other:
            if name not in self.m.couplings:
                return False
            name = next(iter(self.m.couplings[name].sources))
        return True

    def _read_tendon_equality(self, name: str, row: Row, where: Where) -> None:
        """Add the relation between the lengths of two fixed tendons."""
        first = self.t["tendons"][row["a"]]
        second = self.t["tendons"][row["b"]] if row["b"] >= 0 else None
        if first["joints"] is None or (second and second["joints"] is None):
            self.findings.add_note(
                "it ties a tendon that runs in space, and is left out",
                f"equality {name!r}",
                where,
            )
            return
        self._add_relation(
            name,
            self._list_terms(first),
            first["length"],
            self._list_terms(second) if second else [],
            second["length"] if second else 0.0,
            row["data"][0:5],
            where,
        )

    def _list_terms(self, tendon: Row) -> list[tuple[str, float]]:
        """Return the coordinates of a fixed tendon with their coefficients."""
        return [(self.coordinates[j], float(w)) for j, w in tendon["joints"]]

    def _add_relation(
        self,
        name: str,
        left: list[tuple[str, float]],
        left_rest: float,
        right: list[tuple[str, float]],
        right_rest: float,
        c: list[float],
        where: Where,
    ) -> None:
        """Add the equation left - rest = c0 + c1 (right - rest) + c2 (right - rest)^2 + ..."""
        text = f"{_format_sum(left)}{-left_rest - c[0]:+.17g}"
        other = f"({_format_sum(right)}{-right_rest:+.17g})" if right else ""
        for power, factor in enumerate(c[1:], 1):
            if other and factor:
                text += f"{-factor:+.17g}*{other}" + (f"^{power}" if power > 1 else "")
        self.m.constrain(_KINDS["equation"](text), name, where)

    def _read_tendon_ranges(self) -> None:
        """Add the ranges of fixed tendons as inequalities."""
        for k, row in enumerate(self.t["tendons"]):
            name = row["name"] or f"tendon{k}"
            where = self._locate_row(row)
            if row["joints"] is None:
                what = "" if row["range"] is None else ", and so is its range"
                said = f"it runs in space: it moves no body, and is left out{what}"
                self.findings.add_note(said, f"tendon {name!r}", where)
            elif row["range"] is not None and row["joints"]:
                low, high = row["range"]
                length = _format_sum(self._list_terms(row))
                texts = (f"{length}{-low:+.17g}", f"{high:.17g}-({length})")
                with self.findings.record_errors(f"tendon {name!r}", where):
                    self.m.constrain(
                        _KINDS["inequality"](texts), self._choose_name(name, f"{name}_range"), where
                    )

    # ---- postures and notes

    def _read_postures(self) -> None:
        """Add the key frames, and qpos0 where it is not zero, as postures."""
        neutral = [1.0 if name.endswith(".qw") else 0.0 for _, name in self.addresses]
        at_rest = [self.t["qpos0"][a] for a, _ in self.addresses]
        keys = [(row["name"] or f"key{k}", row["qpos"]) for k, row in enumerate(self.t["keys"])]
        if at_rest != neutral:
            keys.insert(0, ("qpos0", self.t["qpos0"]))
        for name, qpos in keys:
            while name in self.m.postures:
                name += "'"
            if np.isfinite(qpos).all():
                self.m.posture(
                    name,
                    {
                        c: qpos[a]
                        for a, c in self.addresses
                        if c not in self.m.couplings and c not in self.m.locks
                    },
                )

    def _note_unread_elements(self) -> None:
        """Note the elements of the model that are left out, such as actuators and sensors."""
        t = self.t
        here = self.merged.locate_line(0)
        for word in ("actuators", "sensors"):
            if t[word]:
                said = f"{format_count(t[word], word[:-1])} of the simulator left out"
                self.findings.add_note(said, where=here)
        for word in ("flexes", "plugins"):
            for name in t[word]:
                self.findings.add_note(
                    "it is left out", f"{word[:-1].removesuffix('e')} {name!r}", here
                )
        unknown = {int(g["body"]) for g in t["geoms"] if g["weighs"] and g["body"]}
        without = [self.bodies[b] for b in sorted(unknown) if t["bodies"][b]["mass"] is None]
        if without:
            said = "their masses follow from meshes, which are not read"
            self.findings.add_note(said, f"bodies {', '.join(map(repr, without))}", here)


def _choose_names(rows: Iterable[Row], word: str, taken: set[str]) -> list[str]:
    """Return different names for the rows; a row without a name gets `word` and a number."""
    out: list[str] = []
    for i, row in enumerate(rows):
        name = row["name"] if row["name"].strip() else f"{word}{i}"
        if name in taken:
            name = f"{name}_{word}"
        while name in taken:
            name += "'"
        taken.add(name)
        out.append(name)
    return out


def _make_turn(row: Row) -> Row:
    """Return the orientation of a row as a keyword of `place`; {} where the row is not rotated."""
    quat = tuple(row["quat"])
    return {} if quat == (1.0, 0.0, 0.0, 0.0) else {"quat_wxyz": quat}


def _format_sum(terms: Iterable[tuple[str, float]]) -> str:
    """Return a sum of coordinates as the text of an equation."""
    return "".join(f"{w:+.17g}*`{name}`" for name, w in terms).removeprefix("+") or "0"
