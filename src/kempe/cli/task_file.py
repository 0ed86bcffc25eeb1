"""Tasks from a TOML file: each table [[task]] gives the type and the parameters of its class."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.answers.tables import read_pose_columns
from kempe.cli import arguments
from kempe.constraints import KINDS, Constraint
from kempe.constraints.base import list_required_fields
from kempe.constraints.clearances import Apart
from kempe.description.source import Source, decode_text, expand_path, shorten_text
from kempe.description.toml_document import Document
from kempe.equations.tasks import Task
from kempe.errors import InputError, UnknownNameError, hint
from kempe.geometry.clearance import watch_clearances
from kempe.model.configurations import list_units
from kempe.words import DEGREE

if TYPE_CHECKING:
    from kempe.system import System


def list_constraint_types() -> dict[str, type[Constraint]]:
    """Return the constraint classes that a file can name, by name: 'pose', 'look_at', ...

    Functions of the user are for Python.
    """
    return {
        name: k
        for name, k in KINDS.items()
        if not any("Callable" in str(f.type) for f in fields(k))
    }


ABOVE = "write [[task]] above each task"


class FileTasks(NamedTuple):
    """Tasks of a file, and the number of problems in its tables of values (None for one problem)."""

    tasks: list[Constraint]
    rows: int | None


def read_tasks(system: System, path: Path, degrees: bool = False) -> FileTasks:
    """Return the tasks of a TOML file, each checked with the system.

    A value that names a .csv or .npy file, seen from the folder of this one, has an entry in each
    of its rows: these make a batch. Errors: `DescriptionError` with all problems, each with its
    line.
    """
    path = expand_path(path)
    arguments.check_input_file(path)
    document = Document(Source(str(path), decode_text(path.read_bytes(), str(path))))
    tasks = _TaskReader(system, document, path.parent, degrees).read_all_tasks()
    document.findings.raise_problems()
    return tasks


class _TaskReader:
    """Converts the tables of a document to tasks."""

    def __init__(self, system: System, document: Document, folder: Path, degrees: bool):
        self.system = system
        self.document = document
        self.folder = folder
        self.degrees = degrees
        self.angle = DEGREE if degrees else 1.0
        self.counts: list[int] = []
        """Numbers of rows of the files that values name."""

    def read_all_tasks(self) -> FileTasks:
        """Return all tasks of the file."""
        add = self.document.findings.add_problem
        where = self.document.locate_value
        for key in self.document.data:
            if key != "task":
                add(f"unknown key {shorten_text(key)}", "", where(key), ABOVE)
        tables = self.document.get_tables("task")
        if not tables and not self.document.findings.problems:
            add("there are no tasks", "", where(), ABOVE)
        tasks = [self.read_task(table, i) for i, table in enumerate(tables)]
        counts = sorted(set(self.counts))
        if len(counts) > 1:
            rows = ", ".join(map(str, counts))
            message = f"the files that values name have {rows} rows"
            add(message, "", where("task"), "they need as many each")
        made = [task for task in tasks if task is not None]
        return FileTasks(made, counts[0] if counts else None)

    def read_task(self, table: dict[str, Any], index: int) -> Constraint | None:
        """Return the task of a table; None after recording a problem."""
        findings = self.document.findings
        before = len(findings.problems)
        place = ("task", index)
        name = table.get("type")
        subject = f"task {shorten_text(table.get('name') or name or index + 1)}"

        def add_problem(message: str, allowed: str, *key: str) -> None:
            """Record a problem of the task."""
            findings.add_problem(
                message, subject, self.document.locate_value(*place, *key), allowed
            )

        types = list_constraint_types()
        if name is None:
            add_problem("the key 'type' is missing", f"it must be one of {', '.join(types)}")
            return None
        if not isinstance(name, str) or name not in types:
            close = hint(str(name), types).lstrip("; ")
            add_problem(f"unknown type of task {shorten_text(name)}", close, "type")
            return None
        kind = types[name]
        names = [f.name for f in fields(kind) if f.init]
        given: dict[str, Any] = {}
        for key, value in table.items():
            if key == "type":
                continue
            if key not in names:
                add_problem(f"unknown key {shorten_text(key)}{hint(key, names)}", "", key)
                continue
            with findings.record_errors(subject, self.document.locate_value(*place, key)):
                given[key] = self.read_value(kind, key, value)
                if _is_file_name(key, value):
                    self.counts.append(len(given[key]))
        self.document.require_keys(list_required_fields(kind), table, place, subject)
        if len(findings.problems) > before:
            return None
        try:
            made = kind(**given)
            if isinstance(made, Apart):
                watch_clearances(self.system, [made])
            else:
                task = Task(self.system, made)
                _ = task.structure_key, task.goal
        except (InputError, UnknownNameError) as error:
            about = [k for k in given if re.search(rf"\b{k}\b", str(error))]
            if isinstance(error, UnknownNameError):
                about = [k for k, v in given.items() if v == error.name or _has_name(v, error.name)]
            add_problem(str(error), "", *about[:1])
            return None
        return made

    def read_value(self, kind: type[Constraint], key: str, value: Any) -> Any:
        """Return the value of a parameter in the form that the class of the task accepts.

        Errors: `InputError`.
        """
        if _is_file_name(key, value):
            return self.read_file_values(kind, key, self.folder / value)
        if key == "q":
            return self.read_posture(value)
        is_good, wanted = FORMS.get(
            key, (_are_numbers, "a number, numbers, or a .csv or .npy file")
        )
        if not is_good(value):
            raise InputError(f"{key} is {shorten_text(value)}; it must be {wanted}")
        convert = self.choose_conversion(kind, key)
        return value if convert is None else convert(np.asarray(value, dtype=float))

    def choose_conversion(
        self, kind: type[Constraint], key: str
    ) -> Callable[[spatial.Array], spatial.Array] | None:
        """Return the function that converts numbers to poses or rotations, if the parameter is one."""
        sort = next(str(f.type) for f in fields(kind) if f.name == key)
        return {"Matrix": self.make_poses, "Rotation": self.make_rotations}.get(sort)

    def make_poses(self, x: spatial.Array) -> spatial.Array:
        """Return poses (..., 4, 4) from x, y, z, roll, pitch, yaw; in the plane from x, y, angle.

        Matrices stay as they are.
        """
        if x.shape[-2:] == (4, 4):
            return x
        X, is_position = read_pose_columns(self.system.dim, np.atleast_1d(x), None, self.degrees)
        if is_position:
            raise InputError(
                f"a pose has the shape {x.shape}: that is a position; an orientation is missing"
            )
        return X

    def make_rotations(self, x: spatial.Array) -> spatial.Array:
        """Return rotations (..., 3, 3) from roll, pitch, yaw; in the plane from an angle.

        Matrices stay as they are.
        """
        if x.shape[-2:] in ((3, 3), (4, 4)):
            return x
        x = np.atleast_1d(x)
        turns = slice(5, 6) if self.system.dim == 2 and x.shape[-1] == 1 else slice(3, 6)
        if turns.start == 3 and x.shape[-1] != 3:
            raise InputError(
                f"an orientation has the shape {x.shape}; it must be roll, pitch, yaw, or a matrix"
            )
        full = np.zeros((*x.shape[:-1], 6))
        full[..., turns] = x * self.angle
        return spatial.pose_from_xyz_rpy(full)[..., :3, :3]

    def read_posture(self, value: Any) -> Any:
        """Return a posture with angles in radians: values by name, a configuration, or a name."""
        if isinstance(value, str):
            return arguments.find_posture(self.system, value)
        if not isinstance(value, Mapping):
            return arguments.convert_to_radians(self.system, value, self.degrees)
        flat = self.document.flatten_table(value, (), "q")
        if not all(map(_is_number, flat.values())):
            raise InputError("q must be a table of numbers by coordinate name, such as {A = 0.3}")
        unit = list_units(self.system)
        return {k: x * (self.angle if unit.get(k) == "rad" else 1.0) for k, x in flat.items()}

    def read_file_values(self, kind: type[Constraint], key: str, path: Path) -> spatial.Array:
        """Return the values (n, ...) of the rows of a file."""
        if key == "q":
            return arguments.read_configurations(self.system, str(path), None, self.degrees)
        turned = self.choose_conversion(kind, key)
        _, table = arguments.read_table(path, self.degrees, turned is not None)
        if turned is not None:
            return turned(table)
        single = table.shape[1] == 1 and key in ("radius", "value", "margin", "at_least", "at_most")
        return table[:, 0] if single else table


# ---- forms of values


def _is_file_name(key: str, value: Any) -> bool:
    """Whether the value of a parameter is the name of a file of rows."""
    return key not in TEXT and isinstance(value, str) and arguments.is_table_file(value)


def _is_text(x: Any) -> bool:
    """Whether an entry is text."""
    return isinstance(x, str)


def _is_whole(x: Any) -> bool:
    """Whether an entry is a whole number."""
    return type(x) is int


def _is_number(x: Any) -> bool:
    """Whether an entry is a number and not NaN."""
    return isinstance(x, (int, float)) and not isinstance(x, bool) and not math.isnan(x)


def _is_tolerance(x: Any) -> bool:
    """Whether a value is one number, or a list of two."""
    entries: Any = x
    return _is_number(x) or (
        isinstance(x, list) and len(entries) == 2 and all(map(_is_number, entries))
    )


def _are_frames(x: Any) -> bool:
    """Whether a value is a list of names, or a table of numbers by name."""
    entries: Any = x
    if isinstance(x, dict):
        return all(map(_is_number, entries.values()))
    return isinstance(x, list) and all(map(_is_text, entries))


def _are_bodies(x: Any) -> bool:
    """Whether a value is a name, or a list of names."""
    return _is_text(x) or (isinstance(x, list) and _are_frames(x))


def _are_numbers(x: Any) -> bool:
    """Whether a value is a number, or numbers in nested lists."""
    try:
        return not isinstance(x, bool) and np.asarray(x).dtype.kind in "fiu"
    except ValueError:
        return False


def _has_name(value: Any, name: object) -> bool:
    """Whether a list or dict holds the name."""
    return isinstance(value, (list, dict)) and name in value


TEXT = ("frame", "other", "name", "axes", "shape", "surface")
BODIES = ("a", "b")
FORMS: dict[str, tuple[Callable[[Any], bool], str]] = {
    **{key: (_is_text, "text in quotes") for key in TEXT},
    "weight": (_is_number, "a number"),
    "margin": (_is_number, "a number"),
    "priority": (_is_whole, "a whole number"),
    "tolerance": (_is_tolerance, "one or two numbers, a length and an angle in radians"),
    **{key: (_are_bodies, "the name of a body, or a list of names") for key in BODIES},
    "frames": (_are_frames, "a list of names, or a table of weights"),
}
"""Tests of values by the names of parameters, and what the values must be; the others are numbers."""
