"""Reader of TOML text, Kempe's own format for any mechanism with or without loops.

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
from kempe.units import METRE
from kempe.values import Expression


def read_toml(
    text: str | bytes, source: str = "<text>", *, package_dirs: Iterable[str | FilePath] = ()
) -> Mechanism:
    """Return the mechanism of a TOML text; `source` names the text in messages.

    `package_dirs` are the folders in which meshes may lie. Errors: `DescriptionError` with all
    problems, each with its line; unknown keys are problems.
    """
    refuse_other_kinds(text, source)
    document = Document(Source(source, decode_text(text, source)))
    document.check_format()
    head: dict[str, Any] = {"name": "mechanism", "dim": 3, "ground": "ground", "notes": []}
    head["unit"] = document.data.get("unit", METRE)
    head |= {k: v for k, v in document.data.items() if k in head and type(v) is type(head[k])}
    try:
        mechanism = Mechanism(head["name"], head["dim"], head["ground"], head["unit"])
    except InputError as error:
        key = next((k for k in ("dim", "unit") if str(error).startswith(k)), "ground")
        raise make_error(str(error), document.locate_value(key)) from None
    mechanism.tolerance = _read_tolerance(document)
    _TomlReader(document, mechanism).read_document()
    document.findings.raise_problems()
    mechanism.notes = [*head["notes"], *mechanism.notes, *document.findings.notes]
    mechanism.roots = tuple(map(str, list_folders(package_dirs)))
    return mechanism


def _read_tolerance(document: Document) -> float | str | None:
    """Return the tolerance of the dimensions; None where the file gives none."""
    said = document.data.get("tolerance")
    if said is None or said == "measured" or (type(said) in (int, float) and 0.0 < said < math.inf):
        return said
    text = (
        f"tolerance is {said!r}; it must be a positive number of metres and radians, or 'measured'"
    )
    raise make_error(text, document.locate_value("tolerance"))


def _check_names(given: Any) -> list[str]:
    """Return a list of names.

    Errors: `InputError`.
    """
    names = cast("list[Any]", given)
    if isinstance(given, list) and all(isinstance(name, str) for name in names):
        return names
    raise InputError(f"it is {shorten_text(names)}; it must be a list of names")


class _TomlReader:
    """Reader that fills a mechanism from a document, table by table."""

    def __init__(self, document: Document, mechanism: Mechanism):
        self.document = document
        self.mechanism = mechanism
        self.locate_value = document.locate_value
        self.findings = document.findings
        self.coordinates: dict[str, None] = {}
        self.failed: set[str] = set()

    def read_document(self) -> None:
        """Add everything in the document to the mechanism."""
        for name, number in self.document.get_table("parameters").items():
            with self.findings.record_errors("", self.locate_value("parameters", name)):
                self.mechanism.parameter(name, number)
        for kind in ("dh", "screws"):
            table = self.document.get_table(kind)
            if kind in self.document.data and self.document.check_table(kind, table, (kind,), kind):
                self.read_chain(kind, table)
        steps = (
            ("body", self.read_body),
            ("frame", self.read_frame),
            ("shape", self.read_shape),
            ("joint", self.read_joint),
            ("constraint", self.read_constraint),
            ("coupling", self.read_coupling),
        )
        for kind, add in steps:
            if kind == "coupling":
                self.coordinates = _list_coordinates(self.mechanism)
            for i, table in enumerate(self.document.get_tables(kind)):
                subject = f"{kind} {table.get('of' if kind == 'coupling' else 'name', i + 1)!r}"
                add(
                    table,
                    (kind, i),
                    subject,
                    self.document.check_table(kind, table, (kind, i), subject),
                )
        self.read_postures_and_locks()
        self.read_groups_and_pairs()

    def read_chain(self, kind: str, table: dict[str, Any]) -> None:
        """Add the bodies and joints of [dh] or [screws]."""
        from kempe.description.dh import add_dh_chain, add_screw_chain

        rows = table["rows"]
        add = add_dh_chain if kind == "dh" else add_screw_chain
        wheres = [self.locate_value(kind, "rows", i) for i in range(len(rows))]
        settings = {k: v for k, v in table.items() if k != "rows"}
        try:
            add(self.mechanism, rows, **settings, wheres=wheres)
        except InputError as error:
            number = re.match(r"(?:row|screw) (\d+)", str(error))
            at = wheres[int(number[1]) - 1] if number else self.locate_value(kind)
            self.findings.add_problem(str(error), kind, at)
        except (DescriptionError, UnknownNameError) as error:
            with self.findings.record_errors(kind, self.locate_value(kind)):
                raise error

    # ---- bodies, frames, joints

    def read_body(self, table: dict[str, Any], path: Path, subject: str, good: bool) -> None:
        """Add the body of a table [[body]]."""
        name: Any = table.get("name")
        mass = table.get("mass")
        center = table.get("center")
        visuals = table.get("visuals", ())
        where = self.locate_value(*path)
        if good:
            with self.findings.record_errors(subject, where):
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
                    self.read_visual(name, text, subject)
        # so that joints to a wrong body are not called wrong, too
        if isinstance(name, str) and name.strip():
            self.mechanism.bodies.setdefault(name, Body(name))

    def read_visual(self, name: str, text: str, subject: str) -> None:
        """Add a <visual> element of URDF, which files older than [[shape]] hold as text."""
        element = parse_xml(text, subject)
        if element.tag not in USES:
            raise InputError(
                f"a text of visuals is {shorten_text(text)}; it must be a <visual> element"
            )
        shape = read_shape(element, subject, read_materials(element, self.findings), self.findings)
        if shape is not None:
            on = self.mechanism.bodies[name]
            self.mechanism.bodies[name] = replace(on, shapes=(*on.shapes, shape))

    def read_shape(self, table: dict[str, Any], path: Path, subject: str, good: bool) -> None:
        """Add the shape of a table [[shape]]."""
        good &= self.check_body_name(table, "body", path, subject)
        X_BS = self.read_placement(table, "", path, subject, table.get("body"))
        if good and X_BS is not None:
            given = {k: x for k, x in table.items() if k not in ("body", "type", *PLACE)}
            on, kind = table["body"], table["type"]
            with self.findings.record_errors(subject, self.locate_value(*path)):
                try:
                    self.mechanism.shape(on, kind, at=X_BS, where=self.locate_value(*path), **given)
                except DescriptionError as error:
                    self.record_key_problems(error, given, path)

    def read_frame(self, table: dict[str, Any], path: Path, subject: str, good: bool) -> None:
        """Add the frame of a table [[frame]]."""
        good &= self.check_body_name(table, "body", path, subject)
        X_BF = self.read_placement(table, "", path, subject, table.get("body"))
        if good and X_BF is not None:
            with self.findings.record_errors(subject, self.locate_value(*path)):
                self.mechanism.frame(
                    table["name"], table["body"], at=X_BF, where=self.locate_value(*path)
                )

    def read_joint(self, table: dict[str, Any], path: Path, subject: str, good: bool) -> None:
        """Add the joint of a table [[joint]]."""
        for key in ("parent", "child"):
            good &= self.check_body_name(table, key, path, subject)
        kind = table.get("type")
        if kind is not None and (not isinstance(kind, str) or kind not in TYPES):
            try:
                make_joint_type(kind)
            except UnknownNameError as error:
                said = (
                    "unknown joint type "
                    f"{shorten_text(kind)}{self.findings.suggest_name(str(kind), error.allowed)}"
                )
                self.findings.add_problem(said, subject, self.locate_value(*path, "type"))
                good = False
            except InputError as error:
                self.findings.add_problem(str(error), subject, self.locate_value(*path, "type"))
                good = False
        X_PF = self.read_placement(table, "", path, subject, table.get("parent"))
        same = X_PF is not None and "axis" in table and "child_steps" not in table
        implied = {"child_axis": table["axis"]} if same else {}
        X_CM = self.read_placement(implied | table, "child_", path, subject, table.get("child"))
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
                where=self.locate_value(*path),
                **given,
            )
            self.failed.discard(table["name"])
        except DescriptionError as error:
            for p in error.problems:
                about = [k for k in given if re.search(rf"\b{k.removesuffix('s')}", p.message)]
                self.findings.problems.append(
                    replace(p, where=self.locate_value(*path, *about[:1]))
                )
        except (InputError, UnknownNameError) as error:
            self.findings.add_problem(str(error), subject, self.locate_value(*path))

    def read_constraint(self, table: dict[str, Any], path: Path, subject: str, good: bool) -> None:
        """Add the constraint of a table [[constraint]]."""
        if "parent" in table or "child" in table or table.get("type") not in constraints.KINDS:
            self.read_placed_constraint(table, path, subject, good)
            return
        kind = constraints.KINDS[table["type"]]
        how = list_fields(kind)
        given: dict[str, Any] = {}
        good &= self.document.require_keys(list_required_fields(kind), table, path, subject)
        for key in how.keys() & table.keys():
            with self.findings.record_errors(subject, self.locate_value(*path, key)):
                given[key] = self.read_field(table[key], how[key], key)
        if not good or len(given) < len(how.keys() & table.keys()):
            return
        try:
            self.mechanism.constrain(kind(**given), table["name"], self.locate_value(*path))
        except DescriptionError as error:
            self.record_key_problems(error, given, path)
        except (InputError, UnknownNameError) as error:
            self.findings.add_problem(str(error), subject, self.locate_value(*path))

    def record_key_problems(
        self, error: DescriptionError, given: Iterable[str], path: Path
    ) -> None:
        """Record problems of a table at the first of the `given` keys that they name."""
        for p in error.problems:
            about = [k for k in given if re.search(rf"\b{k}\b", p.message)]
            self.findings.problems.append(replace(p, where=self.locate_value(*path, *about[:1])))

    def read_field(self, x: Any, how: str, key: str) -> Any:
        """Return the value of a field of a constraint.

        Errors: `InputError`.
        """
        entries: Any = x
        if how in FRAMES:
            if isinstance(x, dict):
                placed: dict[str, Any] = {k: v for k, v in entries.items() if k != "body"}
                return End(
                    str(entries.get("body", "")),
                    self.make_placement(placed, "", entries.get("body")),
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

    def read_placed_constraint(
        self, table: dict[str, Any], path: Path, subject: str, good: bool
    ) -> None:
        """Add a constraint whose ends are placed on bodies as those of joints are."""
        for key in ("parent", "child"):
            good &= self.check_body_name(table, key, path, subject)
            if key not in table:
                self.findings.add_problem(
                    f"the key {key!r} is missing",
                    subject,
                    self.locate_value(*path),
                    "it needs name, type, parent, child",
                )
        kind = table.get("type")
        if kind is not None and kind not in BETWEEN:
            said = self.findings.suggest_name(str(kind), [*BETWEEN, *constraints.KINDS])
            message = f"unknown type of constraint {shorten_text(kind)}{said}"
            self.findings.add_problem(message, subject, self.locate_value(*path, "type"))
            good = False
        X_PF = self.read_placement(table, "", path, subject, table.get("parent"))
        X_CM = self.read_placement(table, "child_", path, subject, table.get("child"))
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
                self.locate_value(*path),
            )
        except DescriptionError as error:
            for p in error.problems:
                about = ["length"] if "length" in table and "length" in p.message else []
                self.findings.problems.append(replace(p, where=self.locate_value(*path, *about)))
        except InputError as error:
            self.findings.add_problem(str(error), subject, self.locate_value(*path))

    def check_body_name(self, table: dict[str, Any], key: str, path: Path, subject: str) -> bool:
        """Return whether a key names a body; record a problem where it does not."""
        name = table.get(key)
        if isinstance(name, str) and name in self.mechanism.bodies:
            return True
        if key in table:
            said = self.findings.suggest_name(str(name), self.mechanism.bodies)
            self.findings.add_problem(
                f"{key} is {shorten_text(name)}, which is no body{said}",
                subject,
                self.locate_value(*path, key),
            )
        return False

    # ---- coordinates

    def read_coupling(self, table: dict[str, Any], path: Path, subject: str, good: bool) -> None:
        """Add the coupling of a table [[coupling]]."""
        if not good:
            return
        sources = self.document.flatten_table(table["sources"], (*path, "sources"), "sources")
        for key, names in (("of", [table["of"]]), ("sources", sources)):
            if not self.check_coordinate_names(names, subject, (*path, key)):
                return
        with self.findings.record_errors(subject, self.locate_value(*path)):
            made = self.mechanism.couple(
                table["of"], sources, table.get("offset", 0.0), self.locate_value(*path)
            )
            for v in (*made.sources.values(), made.offset):
                for name in v.names if isinstance(v, Expression) else ():
                    if name not in self.mechanism.parameters:
                        raise UnknownNameError("parameter", name, self.mechanism.parameters)

    def read_postures_and_locks(self) -> None:
        """Add the postures and locks of the document."""
        for name, found in self.document.get_table("postures").items():
            path = ("postures", name)
            given = self.document.flatten_table(found, path, f"posture {name!r}")
            if self.check_coordinate_names(given, f"posture {name!r}", path):
                with self.findings.record_errors("", self.locate_value(*path)):
                    self.mechanism.posture(name, given)
        for name, number in self.document.flatten_table(
            self.document.get_table("locks"), ("locks",), "[locks]"
        ).items():
            if self.check_coordinate_names([name], "[locks]", ("locks", name)):
                with self.findings.record_errors("", self.locate_value("locks", name)):
                    self.mechanism.lock({name: number})

    def read_groups_and_pairs(self) -> None:
        """Add the groups of joints and the ignored pairs of bodies."""
        for name, joints in self.document.get_table("groups").items():
            with self.findings.record_errors(f"group {name!r}", self.locate_value("groups", name)):
                known = [joint for joint in _check_names(joints) if joint not in self.failed]
                self.mechanism.group(name, known)
        given = self.document.data.get("ignored_pairs")
        pairs = cast("list[Any]", given) if isinstance(given, list) else []
        for i, pair in enumerate(pairs):
            with self.findings.record_errors("ignored pair", self.locate_value("ignored_pairs", i)):
                names = _check_names(pair)
                if len(names) not in (2, 3):
                    raise InputError(
                        f"it is {shorten_text(names)}; it must be two bodies and a reason"
                    )
                self.mechanism.ignore_pair(*names)

    def check_coordinate_names(self, names: Iterable[str], subject: str, path: Path) -> bool:
        """Return whether all names are coordinates; record a problem where they are not.

        Coordinates of a joint that is wrong itself are not recorded.
        """
        names = [
            n for n in names if n not in self.failed and n.rpartition(".")[0] not in self.failed
        ]
        unknown = [n for n in names if n not in self.coordinates]
        for name in unknown:
            said = self.findings.suggest_name(name, self.coordinates)
            self.findings.add_problem(
                f"{shorten_text(name)} is no coordinate{said}",
                subject,
                self.locate_value(*path, name),
            )
        return not unknown

    # ---- placements

    def read_placement(
        self, table: Mapping[str, Any], prefix: str, path: Path, subject: str, body: object
    ) -> Placement | None:
        """Return the placement in the keys `PLACE` with a prefix; None after recording a problem."""
        given = {k: table[prefix + k] for k in PLACE if prefix + k in table}
        try:
            return self.make_placement(given, prefix, body)
        except (InputError, UnknownNameError) as error:
            before = len(self.findings.problems)
            for key, item in given.items():  # which of the keys is it?
                with self.findings.record_errors(subject, self.locate_value(*path, prefix + key)):
                    self.make_placement({key: item}, prefix, body)
            if len(self.findings.problems) == before:
                self.findings.add_problem(str(error), subject, self.locate_value(*path))
        return None

    def make_placement(self, given: dict[str, Any], prefix: str, body: object) -> Placement:
        """Return the placement of some of the keys `PLACE`.

        Errors: `InputError`, `UnknownNameError`.
        """
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
            return self.check_placement(read_placement_steps(given["steps"]))
        return self.check_placement(place(**settings))

    def check_placement(self, X: Placement) -> Placement:
        """Return a placement whose parameters are known.

        Errors: `UnknownNameError`.
        """
        for name in sorted(X.names):
            if name not in self.mechanism.parameters:
                raise UnknownNameError("parameter", name, self.mechanism.parameters)
        return X


def _list_coordinates(mechanism: Mechanism) -> dict[str, None]:
    """Return the names of all joint coordinates, in order."""
    out: dict[str, None] = {}
    for joint in mechanism.joints.values():
        for local in joint.type.list_coordinate_names(
            mechanism.dim, mechanism.bodies[joint.child].particle
        ):
            out[f"{joint.name}.{local}" if local else joint.name] = None
    return out
