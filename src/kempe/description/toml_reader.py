"""A mechanism from TOML text, our own format for any mechanism, loops included.

`docs/toml.md` describes the format.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any, cast

from kempe import constraints
from kempe.constraints.base import FRAMES, NUMBERS, End, list_fields, list_required_fields
from kempe.description.mechanism import BETWEEN, Mechanism, declare_placed_constraint
from kempe.description.parts import Body
from kempe.description.source import (
    Source,
    decode_text,
    list_folders,
    make_error,
    refuse_other_kinds,
    shorten_text,
)
from kempe.description.toml_document import PLACE, Document, Path, list_joint_options
from kempe.description.urdf_shapes import USES, read_materials, read_shape
from kempe.description.xml import parse_xml
from kempe.errors import DescriptionError, InputError, UnknownNameError
from kempe.joints import TYPES, make_joint_type
from kempe.poses import Placement, place, read_placement_steps
from kempe.values import Expression


def read_toml(
    text: str | bytes, source: str = "<text>", *, package_dirs: Iterable[str | FilePath] = ()
) -> Mechanism:
    """Mechanism that a TOML text describes; `source` names the text in messages.

    `package_dirs` are the folders in which meshes may lie. Errors: `DescriptionError` with all
    problems, each with its line; unknown keys are problems.
    """
    refuse_other_kinds(text, source)
    document = Document(Source(source, decode_text(text, source)))
    document.check_format()
    head: dict[str, Any] = {"name": "mechanism", "dim": 3, "ground": "ground", "notes": []}
    head |= {k: v for k, v in document.data.items() if k in head and type(v) is type(head[k])}
    try:
        mechanism = Mechanism(head["name"], head["dim"], head["ground"])
    except InputError as error:
        raise make_error(
            str(error), document.where("dim" if "dim" in str(error) else "ground")
        ) from None
    mechanism.tolerance = _read_tolerance(document)
    _TomlReader(document, mechanism).read()
    document.findings.finish()
    mechanism.notes = [*head["notes"], *mechanism.notes, *document.findings.notes]
    mechanism.roots = tuple(map(str, list_folders(package_dirs)))
    return mechanism


def _read_tolerance(document: Document) -> float | str | None:
    """What the dimensions may be off by, where the file says it."""
    said = document.data.get("tolerance")
    if said is None or said == "measured" or (type(said) in (int, float) and 0.0 < said < math.inf):
        return said
    text = (
        f"tolerance is {said!r}; it must be a positive number of metres and radians, or 'measured'"
    )
    raise make_error(text, document.where("tolerance"))


def _check_names(given: Any) -> list[str]:
    """A list of names. Errors: `InputError`."""
    names = cast("list[Any]", given)
    if isinstance(given, list) and all(isinstance(name, str) for name in names):
        return names
    raise InputError(f"it is {shorten_text(names)}; it must be a list of names")


class _TomlReader:
    """Fills a mechanism from a document, table by table."""

    def __init__(self, document: Document, mechanism: Mechanism):
        self.document = document
        self.mechanism = mechanism
        self.where = document.where
        self.findings = document.findings
        self.coordinates: dict[str, None] = {}
        self.failed: set[str] = set()

    def read(self) -> None:
        for name, number in self.document.table("parameters").items():
            with self.findings.guard("", self.where("parameters", name)):
                self.mechanism.parameter(name, number)
        for kind in ("dh", "screws"):
            table = self.document.table(kind)
            if kind in self.document.data and self.document.check(kind, table, (kind,), kind):
                self.chain(kind, table)
        steps = (
            ("body", self.body),
            ("frame", self.frame),
            ("shape", self.shape),
            ("joint", self.joint),
            ("constraint", self.constraint),
            ("coupling", self.coupling),
        )
        for kind, add in steps:
            if kind == "coupling":
                self.coordinates = _list_coordinates(self.mechanism)
            for i, table in enumerate(self.document.array(kind)):
                subject = f"{kind} {table.get('of' if kind == 'coupling' else 'name', i + 1)!r}"
                add(table, (kind, i), subject, self.document.check(kind, table, (kind, i), subject))
        self.postures_and_locks()
        self.groups_and_pairs()

    def chain(self, kind: str, table: dict[str, Any]) -> None:
        """Read the bodies and joints of [dh] or [screws]."""
        from kempe.description.dh import add_dh_chain, add_screw_chain

        rows = table["rows"]
        add = add_dh_chain if kind == "dh" else add_screw_chain
        wheres = [self.where(kind, "rows", i) for i in range(len(rows))]
        settings = {k: v for k, v in table.items() if k != "rows"}
        try:
            add(self.mechanism, rows, **settings, wheres=wheres)
        except InputError as error:
            number = re.match(r"(?:row|screw) (\d+)", str(error))
            at = wheres[int(number[1]) - 1] if number else self.where(kind)
            self.findings.add(str(error), kind, at)
        except (DescriptionError, UnknownNameError) as error:
            with self.findings.guard(kind, self.where(kind)):
                raise error

    # ---- bodies, frames, joints

    def body(self, table: dict[str, Any], path: Path, subject: str, good: bool) -> None:
        name: Any = table.get("name")
        mass = table.get("mass")
        center = table.get("center")
        visuals = table.get("visuals", ())
        where = self.where(*path)
        if good:
            with self.findings.guard(subject, where):
                if table.get("particle"):
                    if center is not None or visuals or name == self.mechanism.ground.name:
                        raise InputError(
                            "a particle has no center and no visuals, and is not the ground"
                        )
                    self.mechanism.particle(name, mass, where)
                elif name == self.mechanism.ground.name and self.mechanism.ground.where is None:
                    # the ground exists already: another mechanism checks the values
                    checked = Mechanism(ground=f"not {name}").body(name, mass, center, where)
                    self.mechanism.bodies[name] = checked
                else:
                    self.mechanism.body(name, mass, center, where)
                for text in visuals:
                    self.visual(name, text, subject)
        # so that joints to a wrong body are not called wrong, too
        if isinstance(name, str) and name.strip():
            self.mechanism.bodies.setdefault(name, Body(name))

    def visual(self, name: str, text: str, subject: str) -> None:
        """Read a <visual> element of URDF, which files of before [[shape]] hold as text."""
        element = parse_xml(text, subject)
        if element.tag not in USES:
            raise InputError(
                f"a text of visuals is {shorten_text(text)}; it must be a <visual> element"
            )
        shape = read_shape(element, subject, read_materials(element, self.findings), self.findings)
        if shape is not None:
            on = self.mechanism.bodies[name]
            self.mechanism.bodies[name] = replace(on, shapes=(*on.shapes, shape))

    def shape(self, table: dict[str, Any], path: Path, subject: str, good: bool) -> None:
        good &= self.known_body(table, "body", path, subject)
        X_BS = self.placement(table, "", path, subject, table.get("body"))
        if good and X_BS is not None:
            given = {k: x for k, x in table.items() if k not in ("body", "type", *PLACE)}
            on, kind = table["body"], table["type"]
            with self.findings.guard(subject, self.where(*path)):
                try:
                    self.mechanism.shape(on, kind, at=X_BS, where=self.where(*path), **given)
                except DescriptionError as error:
                    self.blame(error, given, path)

    def frame(self, table: dict[str, Any], path: Path, subject: str, good: bool) -> None:
        good &= self.known_body(table, "body", path, subject)
        X_BF = self.placement(table, "", path, subject, table.get("body"))
        if good and X_BF is not None:
            with self.findings.guard(subject, self.where(*path)):
                self.mechanism.frame(table["name"], table["body"], at=X_BF, where=self.where(*path))

    def joint(self, table: dict[str, Any], path: Path, subject: str, good: bool) -> None:
        for key in ("parent", "child"):
            good &= self.known_body(table, key, path, subject)
        kind = table.get("type")
        if kind is not None and (not isinstance(kind, str) or kind not in TYPES):
            try:
                make_joint_type(kind)
            except UnknownNameError as error:
                said = (
                    "unknown joint type "
                    f"{shorten_text(kind)}{self.findings.hint(str(kind), error.allowed)}"
                )
                self.findings.add(said, subject, self.where(*path, "type"))
                good = False
            except InputError as error:
                self.findings.add(str(error), subject, self.where(*path, "type"))
                good = False
        X_PF = self.placement(table, "", path, subject, table.get("parent"))
        same = X_PF is not None and "axis" in table and "child_steps" not in table
        implied = {"child_axis": table["axis"]} if same else {}
        X_CM = self.placement(implied | table, "child_", path, subject, table.get("child"))
        self.failed.add(str(table.get("name")))
        if not good or X_PF is None or X_CM is None:
            return
        options = ("limits", "velocity", "effort", "actuated", "cut", *list_joint_options())
        given = {k: table[k] for k in options if k in table}
        try:
            self.mechanism.joint(
                table["name"],
                table["type"],
                table["parent"],
                table["child"],
                at=X_PF,
                child_at=X_CM,
                where=self.where(*path),
                **given,
            )
            self.failed.discard(table["name"])
        except DescriptionError as error:
            for p in error.problems:
                about = [k for k in given if re.search(rf"\b{k.removesuffix('s')}", p.message)]
                self.findings.problems.append(replace(p, where=self.where(*path, *about[:1])))
        except (InputError, UnknownNameError) as error:
            self.findings.add(str(error), subject, self.where(*path))

    def constraint(self, table: dict[str, Any], path: Path, subject: str, good: bool) -> None:
        if "parent" in table or "child" in table or table.get("type") not in constraints.KINDS:
            self.between(table, path, subject, good)
            return
        kind = constraints.KINDS[table["type"]]
        how = list_fields(kind)
        given: dict[str, Any] = {}
        for key in list_required_fields(kind):
            if key not in table:
                self.findings.add(
                    f"the key {key!r} is missing",
                    subject,
                    self.where(*path),
                    f"it needs {', '.join(list_required_fields(kind))}",
                )
                good = False
        for key in how.keys() & table.keys():
            with self.findings.guard(subject, self.where(*path, key)):
                given[key] = self.field(table[key], how[key], key)
        if not good or len(given) < len(how.keys() & table.keys()):
            return
        try:
            self.mechanism.constrain(kind(**given), table["name"], self.where(*path))
        except DescriptionError as error:
            self.blame(error, given, path)
        except (InputError, UnknownNameError) as error:
            self.findings.add(str(error), subject, self.where(*path))

    def blame(self, error: DescriptionError, given: Iterable[str], path: Path) -> None:
        """Record problems of a table at the first of the `given` keys that they name."""
        for p in error.problems:
            about = [k for k in given if re.search(rf"\b{k}\b", p.message)]
            self.findings.problems.append(replace(p, where=self.where(*path, *about[:1])))

    def field(self, x: Any, how: str, key: str) -> Any:
        """The value of a field of a constraint. Errors: `InputError`."""
        entries: Any = x
        if how in FRAMES:
            if isinstance(x, dict):
                placed: dict[str, Any] = {k: v for k, v in entries.items() if k != "body"}
                return End(
                    str(entries.get("body", "")), self.placed(placed, "", entries.get("body"))
                )
            if not isinstance(x, str):
                raise InputError(
                    f"{key} is {shorten_text(x)}; it must be the name of a frame or body, or a table"
                )
        if how in ("bool", "str") and type(x).__name__ != how:
            raise InputError(
                f"{key} is {shorten_text(x)}; it must be {'true or false' if how == 'bool' else 'text'}"
            )
        if how == "Names" and not (
            isinstance(x, list) and all(isinstance(n, str) for n in entries)
        ):
            raise InputError(
                f"{key} is {shorten_text(entries)}; it must be a list of names of coordinates"
            )
        return tuple(entries) if isinstance(x, list) and how not in NUMBERS else entries

    def between(self, table: dict[str, Any], path: Path, subject: str, good: bool) -> None:
        """Read a constraint that is placed on bodies as joints are."""
        for key in ("parent", "child"):
            good &= self.known_body(table, key, path, subject)
            if key not in table:
                self.findings.add(
                    f"the key {key!r} is missing",
                    subject,
                    self.where(*path),
                    "it needs name, type, parent, child",
                )
        kind = table.get("type")
        if kind is not None and kind not in BETWEEN:
            said = self.findings.hint(str(kind), [*BETWEEN, *constraints.KINDS])
            message = f"unknown type of constraint {shorten_text(kind)}{said}"
            self.findings.add(message, subject, self.where(*path, "type"))
            good = False
        X_PF = self.placement(table, "", path, subject, table.get("parent"))
        X_CM = self.placement(table, "child_", path, subject, table.get("child"))
        if not good or X_PF is None or X_CM is None:
            return
        try:
            none: dict[str, Any] = {}
            ends = (table["parent"], X_PF, none), (table["child"], X_CM, none)
            declare_placed_constraint(
                self.mechanism,
                table["name"],
                table["type"],
                *ends,
                table.get("length"),
                self.where(*path),
            )
        except DescriptionError as error:
            for p in error.problems:
                about = ["length"] if "length" in table and "length" in p.message else []
                self.findings.problems.append(replace(p, where=self.where(*path, *about)))
        except InputError as error:
            self.findings.add(str(error), subject, self.where(*path))

    def known_body(self, table: dict[str, Any], key: str, path: Path, subject: str) -> bool:
        name = table.get(key)
        if isinstance(name, str) and name in self.mechanism.bodies:
            return True
        if key in table:
            said = self.findings.hint(str(name), self.mechanism.bodies)
            self.findings.add(
                f"{key} is {shorten_text(name)}, which is no body{said}",
                subject,
                self.where(*path, key),
            )
        return False

    # ---- coordinates

    def coupling(self, table: dict[str, Any], path: Path, subject: str, good: bool) -> None:
        if not good:
            return
        sources = self.document.flat(table["sources"], (*path, "sources"), "sources")
        for key, names in (("of", [table["of"]]), ("sources", sources)):
            if not self.known_coordinates(names, subject, (*path, key)):
                return
        with self.findings.guard(subject, self.where(*path)):
            made = self.mechanism.couple(
                table["of"], sources, table.get("offset", 0.0), self.where(*path)
            )
            for v in (*made.sources.values(), made.offset):
                for name in v.names if isinstance(v, Expression) else ():
                    if name not in self.mechanism.parameters:
                        raise UnknownNameError("parameter", name, self.mechanism.parameters)

    def postures_and_locks(self) -> None:
        for name, found in self.document.table("postures").items():
            path = ("postures", name)
            given = self.document.flat(found, path, f"posture {name!r}")
            if self.known_coordinates(given, f"posture {name!r}", path):
                with self.findings.guard("", self.where(*path)):
                    self.mechanism.posture(name, given)
        for name, number in self.document.flat(
            self.document.table("locks"), ("locks",), "[locks]"
        ).items():
            if self.known_coordinates([name], "[locks]", ("locks", name)):
                with self.findings.guard("", self.where("locks", name)):
                    self.mechanism.lock({name: number})

    def groups_and_pairs(self) -> None:
        for name, joints in self.document.table("groups").items():
            with self.findings.guard(f"group {name!r}", self.where("groups", name)):
                known = [joint for joint in _check_names(joints) if joint not in self.failed]
                self.mechanism.group(name, known)
        given = self.document.data.get("ignored_pairs")
        pairs = cast("list[Any]", given) if isinstance(given, list) else []
        for i, pair in enumerate(pairs):
            with self.findings.guard("ignored pair", self.where("ignored_pairs", i)):
                names = _check_names(pair)
                if len(names) not in (2, 3):
                    raise InputError(
                        f"it is {shorten_text(names)}; it must be two bodies and a reason"
                    )
                self.mechanism.ignore_pair(*names)

    def known_coordinates(self, names: Iterable[str], subject: str, path: Path) -> bool:
        """Whether all are coordinates; those of a joint that is wrong itself are not called wrong,
        too.
        """
        names = [
            n for n in names if n not in self.failed and n.rpartition(".")[0] not in self.failed
        ]
        unknown = [n for n in names if n not in self.coordinates]
        for name in unknown:
            said = self.findings.hint(name, self.coordinates)
            self.findings.add(
                f"{shorten_text(name)} is no coordinate{said}", subject, self.where(*path, name)
            )
        return not unknown

    # ---- placements

    def placement(
        self, table: Mapping[str, Any], prefix: str, path: Path, subject: str, body: object
    ) -> Placement | None:
        """Placement by the keys `PLACE` with a prefix, or None after recording what is wrong."""
        given = {k: table[prefix + k] for k in PLACE if prefix + k in table}
        try:
            return self.placed(given, prefix, body)
        except (InputError, UnknownNameError) as error:
            before = len(self.findings.problems)
            for key, item in given.items():  # which of the keys is it?
                with self.findings.guard(subject, self.where(*path, prefix + key)):
                    self.placed({key: item}, prefix, body)
            if len(self.findings.problems) == before:
                self.findings.add(str(error), subject, self.where(*path))
        return None

    def placed(self, given: dict[str, Any], prefix: str, body: object) -> Placement:
        """Placement by some of the keys `PLACE`. Errors: `InputError`, `UnknownNameError`."""
        settings = dict(given)
        for key, item in given.items():
            if key == "at" and isinstance(item, str):
                names = [f.name for f in self.mechanism.frames.values() if f.body == body]
                if item not in names:
                    raise UnknownNameError("frame", item, names, f"body {body!r}")
                settings[key] = self.mechanism.frames[item].X_BF
            elif (
                key != "angle"
                and not isinstance(item, list)
                and not (key == "axis" and isinstance(item, str))
            ):
                or_name = " or a name, such as 'z'" if key == "axis" else ""
                raise InputError(
                    f"{prefix}{key} is {shorten_text(item)}; it must be a list, such as [0, 0, "
                    f"1]{or_name}"
                )
            elif key == "matrix":
                rows: Any = given[key]
                flat: list[Any] = (
                    [x for row in rows for x in row]
                    if all(isinstance(r, list) for r in rows)
                    else rows
                )
                if len(flat) != 9 or not all(type(x) in (int, float) for x in flat):
                    raise InputError(f"{prefix}matrix must be three rows of three numbers")
                settings[key] = flat
            elif key == "steps" and len(given) > 1:
                other = next(k for k in given if k != "steps")
                raise InputError(
                    f"{prefix}steps and {prefix}{other} are both given; steps say the whole "
                    "placement"
                )
        if "steps" in given:
            return self.checked(read_placement_steps(given["steps"]))
        return self.checked(place(**settings))

    def checked(self, X: Placement) -> Placement:
        for name in sorted(X.names):
            if name not in self.mechanism.parameters:
                raise UnknownNameError("parameter", name, self.mechanism.parameters)
        return X


def _list_coordinates(mechanism: Mechanism) -> dict[str, None]:
    """Names of all joint coordinates."""
    out: dict[str, None] = {}
    for joint in mechanism.joints.values():
        for local in joint.type.list_coordinate_names(
            mechanism.dim, mechanism.bodies[joint.child].particle
        ):
            out[f"{joint.name}.{local}" if local else joint.name] = None
    return out
