"""Tasks from a TOML file: each table [[task]] gives the type and the parameters of its class."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.cli import arguments, table_files
from kempe.constraints import KINDS, Constraint
from kempe.description.source import Source, decode_text, expand_path, shorten_text
from kempe.description.toml_document import Document
from kempe.equations.tasks import Task
from kempe.errors import InputError, UnknownNameError, hint
from kempe.model.configurations import list_units
from kempe.words import DEGREE

if TYPE_CHECKING:
    from kempe.system import System


def list_constraint_types() -> dict[str, type[Constraint]]:
    """Return the constraint classes that a file can name, by name: 'pose', 'look_at', ...

    Functions of the user are for Python.

    Functions of the user are for Python.
    """
    return {
        name: k
        for name, k in KINDS.items()
        if not any("Callable" in str(f.type) for f in fields(k))
    }


TEXT = ("frame", "other", "name", "axes", "shape", "surface")
NUMBERS = ("weight", "margin")
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
    table_files.check_input_file(path)
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

        if name is None:
            add_problem(
                "the key 'type' is missing",
                f"it must be one of {', '.join(list_constraint_types())}",
            )
            return None
        if not isinstance(name, str) or name not in list_constraint_types():
            close = hint(str(name), list_constraint_types()).lstrip("; ")
            add_problem(f"unknown type of task {shorten_text(name)}", close, "type")
            return None
        kind = list_constraint_types()[name]
        names = [f.name for f in sorted(fields(kind), key=lambda f: f.kw_only is True) if f.init]
        needed = [
            f.name
            for f in fields(kind)
            if f.init and f.default is MISSING and f.default_factory is MISSING
        ]
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
        for key in needed:
            if key not in table:
                add_problem(f"the key {key!r} is missing", f"it needs {', '.join(needed)}")
        if len(findings.problems) > before:
            return None
        try:
            made = kind(**given)
            task = Task(self.system, made)
            task.make_structure_key()
            task.make_goal()
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

        Errors: `InputError`.
        """
        if key in TEXT:
            if not isinstance(value, str):
                raise InputError(f"{key} is {shorten_text(value)}; it must be text in quotes")
            return value
        if _is_file_name(key, value):
            return self.read_file_values(kind, key, self.folder / value)
        if key in NUMBERS and not _is_number(value):
            raise InputError(f"{key} is {shorten_text(value)}; it must be a number")
        if key == "priority" and type(value) is not int:
            raise InputError(f"priority is {shorten_text(value)}; it must be a whole number")
        if key == "tolerance" and not (_is_number(value) or _are_numbers(value, 2)):
            raise InputError(
                f"tolerance is {shorten_text(value)}; it must be one or two numbers, in metres and "
                "radians"
            )
        if key == "frames":
            given: Any = value
            good = isinstance(value, list) and all(isinstance(x, str) for x in given)
            if not good and not (isinstance(value, dict) and all(map(_is_number, given.values()))):
                raise InputError(
                    f"frames is {shorten_text(given)}; it must be a list of names, or a table of weights"
                )
            return given
        if key == "q":
            return self.read_posture(value)
        if (turned := self.choose_conversion(kind, key)) is not None:
            return turned(np.asarray(_check_numbers(key, value), dtype=float))
        return _check_numbers(key, value)

    def choose_conversion(
        self, kind: type[Constraint], key: str
    ) -> Callable[[spatial.Array], spatial.Array] | None:
        """Return the function that converts numbers to poses or rotations, if the parameter is one."""
        sort = next(str(f.type) for f in fields(kind) if f.name == key)
        return {"Matrix": self.make_poses, "Rotation": self.make_rotations}.get(sort)

    def make_poses(self, x: spatial.Array) -> spatial.Array:
        """Return poses (..., 4, 4) from x, y, z, roll, pitch, yaw; in the plane from x, y, angle.

        Matrices stay as they are.

        Matrices stay as they are.
        """
        if x.shape[-2:] == (4, 4):
            return x
        planar = self.system.dim == 2
        if x.shape[-1:] not in ((6,), (3,) if planar else (6,)):
            allowed = (
                "x, y, angle" if planar else "x, y, z, roll, pitch, yaw, or a matrix of four rows"
            )
            raise InputError(f"a pose has the shape {x.shape}; it must be {allowed}")
        full = np.zeros((*x.shape[:-1], 6))
        full[..., [0, 1, 5] if x.shape[-1] == 3 else slice(None)] = x
        full[..., 3:] *= self.angle
        return spatial.pose_from_xyz_rpy(full)

    def make_rotations(self, x: spatial.Array) -> spatial.Array:
        """Return rotations (..., 3, 3) from roll, pitch, yaw; in the plane from an angle.

        Matrices stay as they are.

        Matrices stay as they are.
        """
        if x.shape[-2:] in ((3, 3), (4, 4)):
            return x
        if self.system.dim == 2 and (x.ndim == 0 or x.shape[-1] == 1):
            angle = np.zeros((*x.shape[:-1], 3))
            angle[..., 2] = x.reshape(x.shape[:-1])
            x = angle
        if x.shape[-1:] != (3,):
            raise InputError(
                f"an orientation has the shape {x.shape}; it must be roll, pitch, yaw, or a matrix"
            )
        return spatial.pose_from_xyz_rpy(
            np.concatenate([np.zeros(x.shape), x * self.angle], axis=-1)
        )[..., :3, :3]

    def read_posture(self, value: Any) -> Any:
        """Return a posture with angles in radians: values by name, a configuration, or a name."""
        if isinstance(value, str):
            return arguments.read_configurations(self.system, None, value)
        if isinstance(value, Mapping):
            flat = self.document.flatten_table(value, (), "q")
            if not all(map(_is_number, flat.values())):
                raise InputError(
                    "q must be a table of numbers by coordinate name, such as {A = 0.3}"
                )
            unit = list_units(self.system)
            return {k: x * (self.angle if unit.get(k) == "rad" else 1.0) for k, x in flat.items()}
        return arguments.read_configurations(
            self.system, ",".join(map(str, _check_numbers("q", value))), None, self.degrees
        )

    def read_file_values(self, kind: type[Constraint], key: str, path: Path) -> spatial.Array:
        """Return the values (n, ...) of the rows of a file."""
        if key == "q":
            return arguments.read_configurations(self.system, str(path), None, self.degrees)
        turned = self.choose_conversion(kind, key)
        _, table = table_files.read_table(path, matrices=turned is not None)
        if turned is not None:
            return turned(table)
        single = table.shape[1] == 1 and key in ("radius", "value", "margin", "at_least", "at_most")
        return table[:, 0] if single else table


def _is_file_name(key: str, value: Any) -> bool:
    """Whether the value of a parameter is the name of a file of rows."""
    return key not in TEXT and isinstance(value, str) and table_files.is_table_file(value)


def _is_number(x: Any) -> bool:
    """Whether an entry is a number and not NaN."""
    return isinstance(x, (int, float)) and not isinstance(x, bool) and not math.isnan(x)


def _are_numbers(x: Any, n: int) -> bool:
    """Whether a value is a list of `n` numbers."""
    entries: Any = x
    return isinstance(x, list) and len(entries) == n and all(map(_is_number, entries))


def _check_numbers(key: str, value: Any) -> Any:
    """Return a number, or numbers in nested lists, unchanged.

    Errors: `InputError` for any other entry.

    Errors: `InputError` for any other entry.
    """
    try:
        good = np.asarray(value).dtype.kind in "fiu"
    except ValueError:
        good = False
    if not good or isinstance(value, bool):
        raise InputError(
            f"{key} is {shorten_text(value)}; it must be a number, a list of numbers, or a .csv or .npy "
            "file"
        )
    return value


def _has_name(value: Any, name: object) -> bool:
    """Whether a list or dict holds the name."""
    return isinstance(value, (list, dict)) and name in value
