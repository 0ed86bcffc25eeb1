"""Arguments of commands: known values, starts, configurations, branches, axes, tolerances, and files
of tasks.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.cli import table_files
from kempe.constraints import KINDS, Constraint
from kempe.description.source import Source, decode, expanded, no_file, shorten
from kempe.description.toml_document import Document
from kempe.equations.tasks import Task
from kempe.errors import InputError, UnknownNameError, hint
from kempe.model.configurations import has_loops, units
from kempe.poses import AXES
from kempe.words import DEGREE, counted

if TYPE_CHECKING:
    from kempe.assemble.answer import Assembly
    from kempe.system import System


# ---- values, starts and branches

# As systems with loops need them.

SPECIAL = ("neutral", "mid")
"""Names that every system has besides its postures."""


def known(
    system: System, words: Iterable[str], degrees: bool = False, frames: bool = True
) -> dict[str, Any]:
    """Known coordinates and places of frames, from 'name=value' and 'frame=x,y,z', or a .csv with
    names.

    Coordinates that follow others are turned into these.
    Errors: `InputError`, `UnknownNameError`.
    """
    out: dict[str, Any] = {}
    for word in words:
        name, sign, text = (part.strip() for part in word.partition("="))
        if not sign and table_files.is_file(word):
            found = _columns(system, expanded(word), degrees)
        elif not sign or not name:
            raise InputError(
                f"{word!r} is no known value: write name=value"
                + (", or frame=x,y,z" if frames else "")
            )
        else:
            found = {name: _value(system, name, table_files.numbers(text, name), degrees, frames)}
        for given, value in found.items():
            source, x = _by_source(system, given, value)
            if source in out:
                said = (
                    "is given twice"
                    if given == source
                    else f"follows {source!r}, which is given, too"
                )
                raise InputError(f"{given!r} {said}")
            out[source] = x
    return out


def _value(system: System, name: str, numbers: list[float], degrees: bool, frames: bool) -> Any:
    is_frame = frames and name in system.frame_names and name not in system.coordinate_names
    if not is_frame:
        _check_coordinate(system, name, frames)
    if not np.isfinite(numbers).all():
        raise InputError(
            f"{name}: {next(x for x in numbers if not np.isfinite(x))} is not a finite number"
        )
    if is_frame:
        if len(numbers) not in (system.dim, 3):
            needed = "x,y" if system.dim == 2 else "x,y,z"
            has = counted(len(numbers), "number")
            raise InputError(f"{name!r} is a frame and has {has}; its place is {name}={needed}")
        return np.array(numbers)
    if len(numbers) != 1:
        raise InputError(f"{name!r} has {len(numbers)} values; a coordinate has one")
    return numbers[0] * _factor(system, name, degrees)


def _by_source(system: System, name: str, value: Any) -> tuple[str, Any]:
    """A coordinate that follows another, as the one that it follows, which is part of q."""
    follower = system.structure.couplings.get(name)
    if follower is None or follower.source is None:
        return name, value
    return follower.source, (value - follower.offset) / follower.multiplier


def _check_coordinate(system: System, name: str, frames: bool) -> None:
    coordinates = (*system.coordinate_names, *system.structure.couplings)
    if name not in coordinates:
        places = system.structure.frames if frames else ()
        what = "coordinate or frame" if frames else "coordinate"
        raise UnknownNameError(what, name, (*coordinates, *places), system.name)


def _factor(system: System, name: str, degrees: bool) -> float:
    return DEGREE if degrees and units(system).get(name) == "rad" else 1.0


def _columns(system: System, path: Path, degrees: bool) -> dict[str, Any]:
    """Values (n,) of the coordinates that the first line of a .csv names."""
    names, table = table_files.read(path)
    if names is None:
        raise InputError(f"{path}: its first line must name the known coordinates")
    if len(set(names)) < len(names):
        raise InputError(f"{path}: a column appears twice")
    for name in names:
        _check_coordinate(system, name, False)
    if not np.isfinite(table).all():
        row = int(np.flatnonzero(~np.isfinite(table).all(axis=1))[0])
        raise InputError(f"{path}: row {row} holds a number that is not finite")
    return {
        name: column * _factor(system, name, degrees)
        for name, column in zip(names, table.T, strict=True)
    }


def start(system: System, text: str | None, degrees: bool = False) -> spatial.Array | None:
    """A start (nq,) given as the name of a posture, or as values; None where nothing is given.

    What 'name=value' leaves open is as at home. Errors: `InputError`, `UnknownNameError`.
    """
    if text is None:
        return None
    q = _start(system, text, degrees)
    if q.ndim != 1:
        raise InputError(
            f"{text}: it holds {counted(len(q), 'configuration')}; one is needed to start from"
        )
    if not np.isfinite(q).all():
        raise InputError(f"{text}: a number to start from is not finite")
    return q


def _start(system: System, text: str, degrees: bool) -> spatial.Array:
    if text in (*system.structure.posture_names, *SPECIAL):
        return table_files.configuration(system, None, text, degrees)
    if not any(c in text for c in ",=.") and not text.strip().lstrip("+-").isdigit():
        raise UnknownNameError(
            "posture", text, (*system.structure.posture_names, *SPECIAL), system.name
        )
    return table_files.configuration(system, text, None, degrees, start=True)


def first(
    system: System, text: str | None, held: Mapping[str, Any], degrees: bool = False
) -> tuple[spatial.Array | None, Assembly | None]:
    """Where a motion starts, as `start`; with 'name=value,...' or held coordinates closed, then
    with the assembly.
    """
    words = (
        text.split(",")
        if text is not None and "=" in text and not table_files.is_file(text)
        else []
    )
    named = known(system, words, degrees, frames=False)
    for name in named:
        if name in held:
            raise InputError(f"{name!r} is held and given as a start, too: leave one out")
    near = start(system, text, degrees) if text is not None and not words else None
    if not named and not held:
        return near, None
    answer = system.assemble({**held, **named}, near)
    return answer.q, answer


def configuration(
    system: System, text: str | None, posture: str | None, degrees: bool = False
) -> tuple[spatial.Array | None, Assembly | None]:
    """A configuration (nq,) from the command line; None where nothing is given.

    As `table_files.configuration`, but where 'name=value,...' is given of a system with loops,
    these are closed, started at the posture: then the assembly is the second answer. Errors: as
    there, and `InputError` for several rows.
    """
    if text is None and posture is None:
        return None, None
    if text is not None and "=" in text and not table_files.is_file(text) and has_loops(system):
        near = (
            None if posture is None else table_files.configuration(system, None, posture, degrees)
        )
        answer = system.assemble(known(system, text.split(","), degrees, frames=False), near)
        return answer.q, answer
    q = table_files.configuration(system, text, posture, degrees)
    if q.ndim != 1:
        raise InputError(f"{text}: it holds {counted(len(q), 'configuration')}; one is needed")
    return q, None


def branch(system: System, given: Mapping[str, Any], text: str | None) -> str | None:
    """A branch: signs of dyads, or the name of a posture. Errors: `InputError` where it is neither."""
    if text is None or text in system.structure.posture_names:
        return text
    if not text or set(text) - set("+-"):
        postures = ", ".join(map(repr, system.structure.posture_names)) or "none"
        raise InputError(
            f"branch {text!r} is neither signs such as '+-' nor a posture; postures are: {postures}"
        )
    places = [name for name in given if name not in system.coordinate_names]
    if places:
        raise InputError(
            f"signs name a branch where coordinates are known; {places[0]!r} is a frame: use "
            "--start"
        )
    from kempe.assemble.dyads import Incomplete, closed_form

    plan = closed_form(system, tuple(given))
    if not isinstance(plan, Incomplete) and plan.signs != len(text):
        needs = f"{counted(plan.signs, 'sign')} with these inputs: --modes lists its branches"
        raise InputError(
            f"branch {text!r} has {counted(len(text), 'sign')}; {system.name} has {needs}"
        )
    return text


# ---- axis and tolerance


def axis(text: str) -> spatial.Array:
    """The tool's axis (3,) from three numbers or a name such as '-z'. Errors: `InputError`."""
    if text.strip().lower() in AXES:
        return np.array(AXES[text.strip().lower()])
    values = table_files.numbers(text, "axis")
    if len(values) != 3:
        raise InputError(
            f"the axis has {counted(len(values), 'number')}; it must be x,y,z in the tool's frame"
        )
    return np.array(values)


def one_tolerance(text: str) -> float:
    """The largest error of a solution, in metres and radians. Errors: `InputError`."""
    values = table_files.numbers(text, "tolerance")
    if len(values) != 1 or not values[0] > 0.0:
        raise InputError(
            f"tolerance is {text!r}; for --all it must be one positive number, for metres and "
            "radians"
        )
    return values[0]


# ---- tasks from a TOML file

# A table [[task]] for each, by type with the parameters of its class in `kempe.tasks`.


def types() -> dict[str, type[Constraint]]:
    """The kinds that can be requested, by name: 'pose', 'look_at', ... Functions of the user are
    for Python.
    """
    return {
        name: k
        for name, k in KINDS.items()
        if not any("Callable" in str(f.type) for f in fields(k))
    }


TEXT = ("frame", "other", "name", "axes", "shape", "surface")
NUMBERS = ("weight", "margin")


@dataclass(frozen=True)
class _TaskRow:
    """A task with its parameters; those in `many` have an entry for each row of a file."""

    kind: type[Constraint]
    given: dict[str, Any]
    many: frozenset[str]


@dataclass(frozen=True)
class FileTasks:
    """The tasks of a file, for `count` problems, None where it asks one."""

    rows: tuple[_TaskRow, ...]
    count: int | None

    def tasks(self, start: int = 0, stop: int | None = None) -> list[Constraint]:
        """The tasks, of a file of rows those from `start` to `stop`."""
        return [
            r.kind(**{k: v[start:stop] if k in r.many else v for k, v in r.given.items()})
            for r in self.rows
        ]


def read(system: System, path: Path, degrees: bool = False) -> FileTasks:
    """The tasks of a TOML file, each checked with the system.

    A value that names a .csv or .npy file, seen from the folder of this one, has an entry in each
    of its rows: these make a batch. Errors: `DescriptionError` with all problems, each with its
    line.
    """
    path = expanded(path)
    if what := no_file(path):
        raise InputError(f"{path}: this is {what}; give the path of a plain file")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    document = Document(Source(str(path), decode(path.read_bytes(), str(path))))
    reader = _TaskReader(system, document, path.parent, degrees)
    found = reader.all()
    document.findings.finish()
    return found


class _TaskReader:
    """Makes tasks of the tables of a document."""

    def __init__(self, system: System, document: Document, folder: Path, degrees: bool):
        self.system = system
        self.document = document
        self.folder = folder
        self.degrees = degrees
        self.angle = DEGREE if degrees else 1.0

    def all(self) -> FileTasks:
        """All tasks of the file."""
        findings = self.document.findings
        where = self.document.where
        for key in self.document.data:
            if key != "task":
                findings.add(
                    f"unknown key {shorten(key)}", "", where(key), "write [[task]] above each task"
                )
        found = [self.task(table, i) for i, table in enumerate(self.document.array("task"))]
        if not found and not findings.problems:
            findings.add("there are no tasks", "", where(), "write [[task]] above each task")
        made = tuple(r for r in found if r is not None)
        counts = {len(r.given[k]) for r in made for k in r.many}
        if len(counts) > 1:
            said = ", ".join(map(str, sorted(counts)))
            findings.add(
                f"the files that values name have {said} rows",
                "",
                where("task"),
                "they need as many each",
            )
        return FileTasks(made, counts.pop() if len(counts) == 1 else None)

    def task(self, table: dict[str, Any], index: int) -> _TaskRow | None:
        """A task, or None after recording what is wrong."""
        findings = self.document.findings
        at = ("task", index)
        kind = table.get("type")
        subject = f"task {shorten(table.get('name') or kind or index + 1)}"
        if not isinstance(kind, str) or kind not in types():
            message = (
                "the key 'type' is missing"
                if kind is None
                else f"unknown type of task {shorten(kind)}"
            )
            said = (
                "it must be one of " + ", ".join(types())
                if kind is None
                else hint(str(kind), types()).lstrip("; ")
            )
            findings.add(
                message,
                subject,
                self.document.where(*at, *(["type"] if kind is not None else [])),
                said,
            )
            return None
        names, needed = _parameters(types()[kind])
        before = len(findings.problems)
        given: dict[str, Any] = {}
        many: set[str] = set()
        for key, value in table.items():
            if key == "type":
                continue
            if key not in names:
                findings.add(
                    f"unknown key {shorten(key)}{hint(key, names)}",
                    subject,
                    self.document.where(*at, key),
                )
                continue
            with findings.guard(subject, self.document.where(*at, key)):
                given[key] = self.value(types()[kind], key, value)
                if _names_file(key, value):
                    many.add(key)
        for key in needed:
            if key not in table:
                allowed = f"it needs {', '.join(needed)}"
                findings.add(
                    f"the key {key!r} is missing", subject, self.document.where(*at), allowed
                )
        if len(findings.problems) > before:
            return None
        row = _TaskRow(types()[kind], given, frozenset(many))
        self.check(row, subject, at)
        return row if len(findings.problems) == before else None

    def check(self, row: _TaskRow, subject: str, at: tuple[str, int]) -> None:
        """Record what does not fit the system, at the key that it is about."""
        try:
            task = Task(self.system, row.kind(**row.given))
            task.structure()
            task.goal()
        except (InputError, UnknownNameError) as error:
            text = str(error)
            about = [k for k in row.given if re.search(rf"\b{k}\b", text)]
            if isinstance(error, UnknownNameError):
                about = [
                    k for k, v in row.given.items() if v == error.name or _holds(v, error.name)
                ]
            self.document.findings.add(text, subject, self.document.where(*at, *about[:1]))

    def value(self, kind: type[Constraint], key: str, value: Any) -> Any:
        """A parameter as the class takes it. Errors: `InputError`."""
        if key in TEXT:
            if not isinstance(value, str):
                raise InputError(f"{key} is {shorten(value)}; it must be text in quotes")
            return value
        if _names_file(key, value):
            return self.from_file(kind, key, self.folder / value)
        if key in NUMBERS and not _is_number(value):
            raise InputError(f"{key} is {shorten(value)}; it must be a number")
        if key == "priority" and type(value) is not int:
            raise InputError(f"priority is {shorten(value)}; it must be a whole number")
        if key == "tolerance" and not (_is_number(value) or _are_numbers(value, 2)):
            raise InputError(
                f"tolerance is {shorten(value)}; it must be one or two numbers, in metres and "
                "radians"
            )
        if key == "frames":
            given: Any = value
            good = isinstance(value, list) and all(isinstance(x, str) for x in given)
            if not good and not (isinstance(value, dict) and all(map(_is_number, given.values()))):
                raise InputError(
                    f"frames is {shorten(given)}; it must be a list of names, or a table of weights"
                )
            return given
        if key == "q":
            return self.posture(value)
        if (turned := self.turned(kind, key)) is not None:
            return turned(np.asarray(_numbers(key, value), dtype=float))
        return _numbers(key, value)

    def turned(
        self, kind: type[Constraint], key: str
    ) -> Callable[[spatial.Array], spatial.Array] | None:
        """How numbers become a pose or a rotation, where the parameter is one."""
        sort = next(str(f.type) for f in fields(kind) if f.name == key)
        return {"Matrix": self.poses, "Rotation": self.rotations}.get(sort)

    def poses(self, x: spatial.Array) -> spatial.Array:
        """Poses (..., 4, 4) from x, y, z, roll, pitch, yaw, of planar systems x, y, angle; or as
        they are.
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

    def rotations(self, x: spatial.Array) -> spatial.Array:
        """Rotations (..., 3, 3) from roll, pitch, yaw, of planar systems an angle; or as they are."""
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

    def posture(self, value: Any) -> Any:
        """Values by name, or a configuration, or the name of a posture, with angles in radians."""
        if isinstance(value, str):
            return table_files.configuration(self.system, None, value)
        if isinstance(value, Mapping):
            flat = self.document.flat(value, (), "q")
            if not all(map(_is_number, flat.values())):
                raise InputError(
                    "q must be a table of numbers by coordinate name, such as {A = 0.3}"
                )
            unit = units(self.system)
            return {k: x * (self.angle if unit.get(k) == "rad" else 1.0) for k, x in flat.items()}
        return table_files.configuration(
            self.system, ",".join(map(str, _numbers("q", value))), None, self.degrees
        )

    def from_file(self, kind: type[Constraint], key: str, path: Path) -> spatial.Array:
        """Values (n, ...) of the rows of a file."""
        if key == "q":
            return table_files.configuration(self.system, str(path), None, self.degrees)
        turned = self.turned(kind, key)
        _, table = table_files.read(path, matrices=turned is not None)
        if turned is not None:
            return turned(table)
        single = table.shape[1] == 1 and key in ("radius", "value", "margin", "at_least", "at_most")
        return table[:, 0] if single else table


def _parameters(kind: type[Constraint]) -> tuple[list[str], list[str]]:
    """Names of the parameters of a class, and those that it needs."""
    own = sorted((f for f in fields(kind) if f.init), key=lambda f: f.kw_only is True)
    needed = [f.name for f in own if f.default is MISSING and f.default_factory is MISSING]
    return [f.name for f in own], needed


def _names_file(key: str, value: Any) -> bool:
    return key not in TEXT and isinstance(value, str) and table_files.is_file(value)


def _is_number(x: Any) -> bool:
    return isinstance(x, (int, float)) and not isinstance(x, bool) and not math.isnan(x)


def _are_numbers(x: Any, n: int) -> bool:
    entries: Any = x
    return isinstance(x, list) and len(entries) == n and all(map(_is_number, entries))


def _numbers(key: str, value: Any) -> Any:
    """A number, or numbers in lists. Errors: `InputError`."""
    try:
        good = np.asarray(value).dtype.kind in "fiu"
    except ValueError:
        good = False
    if not good or isinstance(value, bool):
        raise InputError(
            f"{key} is {shorten(value)}; it must be a number, a list of numbers, or a .csv or .npy "
            "file"
        )
    return value


def _holds(value: Any, name: object) -> bool:
    return isinstance(value, (list, dict)) and name in value
