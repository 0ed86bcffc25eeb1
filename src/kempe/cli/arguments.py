"""Arguments of commands: texts and files of rows become the arguments of the library's verbs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.tables import SUFFIXES, convert_texts, read_pose_columns
from kempe.arrays import is_number
from kempe.description.source import describe_special_file, expand_path
from kempe.errors import InputError, UnknownNameError
from kempe.model import configurations
from kempe.spatial import Array
from kempe.words import DEGREE, format_count
from kempe.workspace.row_sources import open_rows

if TYPE_CHECKING:
    from kempe.assemble.answer import Assembly
    from kempe.constraints.base import Constraint
    from kempe.system import System

SPECIAL = ("neutral", "mid")
"""Names that every system has besides its postures."""


# ---- numbers, and files of rows


def is_table_file(text: str) -> bool:
    """Whether an argument names a .csv or .npy file of rows."""
    return Path(text).suffix.lower() in SUFFIXES


def parse_numbers(text: str, what: str) -> list[float]:
    """Return the numbers of 'a,b,c'.

    Errors: `InputError` that names the part that is no number.
    """
    return convert_texts(text.split(","), what)


def parse_finite_numbers(text: str, what: str) -> list[float]:
    """Return the numbers of 'a,b,c', all finite.

    Errors: `InputError`.
    """
    try:
        values = parse_numbers(text, what)
    except InputError:
        raise InputError(f"{what} is {text!r}; it must be numbers, separated by commas") from None
    if bad := [x for x in values if not math.isfinite(x)]:
        raise InputError(f"{what} is {text!r}, which holds {bad[0]}; all numbers must be finite")
    return values


def parse_single_or_several(text: str | None, what: str) -> Any:
    """Return the number in a text, or a list of its numbers; None without a text.

    Errors: `InputError`.
    """
    if text is None:
        return None
    values = parse_numbers(text, what)
    return values[0] if len(values) == 1 else values


def check_input_file(path: Path) -> None:
    """Raise `InputError` if there is no plain file to read at `path`."""
    if what := describe_special_file(path):
        raise InputError(f"{path}: this is {what}; give the path of a plain file")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")


def read_table(
    path: Path, degrees: bool = False, matrices: bool = False
) -> tuple[list[str] | None, Array]:
    """Return rows (n, k) of a .csv or .npy file, and the names in the first line of a .csv file.

    Angles of columns that state their unit, such as "q1 [deg]", are in degrees or radians as
    `degrees` says. A .npy may hold (n, 4, 4) matrices where `matrices` allows. Errors: `InputError` with the file
    and the line.
    """
    check_input_file(path)
    source = open_rows(path, degrees=degrees)
    if not source.n:
        raise InputError(f"{path}: it holds no rows of numbers")
    if len(source.tail) > 1 and not (matrices and source.tail == (4, 4)):
        shape = (source.n, *source.tail)
        wanted = "target, or (n, 4, 4) poses" if matrices else "configuration"
        raise InputError(
            f"{path}: it holds an array of shape {shape}; needed is a row for each {wanted}"
        )
    names = source.names
    return None if names is None else list(names), source.read_rows(0, source.n)


# ---- values by name


def parse_assignments(words: Iterable[str], flag: str) -> dict[str, str]:
    """Return texts by name from an option that is repeated as NAME=VALUE.

    Errors: `InputError`.
    """
    values: dict[str, str] = {}
    for text in words:
        name, sign, value = (part.strip() for part in text.partition("="))
        if not sign or not name:
            raise InputError(f"{flag} {text}: it must be NAME=VALUE")
        if name in values:
            raise InputError(f"{flag} gives {name!r} twice")
        values[name] = value
    return values


def parse_known_values(
    system: System, words: Iterable[str], degrees: bool = False, frames: bool = False
) -> dict[str, Any]:
    """Return values by name in radians and metres, from words 'name=value' or .csv files.

    A .csv file has named columns. Coordinates that follow others are turned into these. With
    `frames` a word may be 'frame=x,y,z', and the verb says what names there are.
    Errors: `InputError`, `UnknownNameError`.
    """
    units = configurations.list_units(system)
    given: dict[str, Any] = {}
    for word in words:
        for name, value in _read_values(system, word, degrees, frames).items():
            if name in given:
                raise InputError(f"{name!r} is given twice")
            given[name] = value * DEGREE if degrees and units.get(name) == "rad" else value
    return given if frames else dict(configurations.compute_source_values(system, given))


def _read_values(system: System, word: str, degrees: bool, frames: bool) -> dict[str, Any]:
    """Return the values that a word gives: of a coordinate, of a frame, or the columns of a file."""
    name, sign, text = (part.strip() for part in word.partition("="))
    if not sign and is_table_file(word):
        names, rows = read_table(path := expand_path(word), degrees)
        if names is None:
            raise InputError(f"{path}: its first line must name the known coordinates")
        if len(set(names)) < len(names):
            raise InputError(f"{path}: a column appears twice")
        return dict(zip(names, rows.T, strict=True))
    if not sign or not name:
        example = "name=value, or frame=x,y,z" if frames else "name=value"
        raise InputError(f"{word!r} is no known value: write {example}")
    values = parse_numbers(text, name)
    if frames and name in system.frame_names and name not in configurations.list_units(system):
        if len(values) not in (system.dim, 3):
            needed = "x,y" if system.dim == 2 else "x,y,z"
            has = format_count(len(values), "number")
            raise InputError(f"{name!r} is a frame and has {has}; its place is {name}={needed}")
        return {name: np.array(values)}
    if len(values) != 1:
        raise InputError(f"{name!r} has {len(values)} values; a coordinate has one")
    return {name: values[0]}


def parse_joint_names(system: System, flag: str, text: str | None) -> list[str] | None:
    """Return the names in 'A,B'; None where `text` is None.

    Errors: `InputError` where the text holds no name.
    """
    if text is None:
        return None
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise InputError(f"{flag} names no joint; there are: {', '.join(system.joint_names)}")
    return names


# ---- configurations and starts


def _parse_values(system: System, text: str, degrees: bool) -> Array | dict[str, Any]:
    """Return configurations (..., nq) of 'a,b,c' or a file; of 'name=value,...' values by name.

    A .csv file that names all coordinates may have further columns, as the tables of answers have:
    these are not read.
    """
    if is_table_file(text):
        names, rows = read_table(expand_path(text), degrees)
        if names is not None:
            given = parse_known_values(system, [text], degrees, frames=True)
            given = configurations.drop_other_columns(system, given)
            return dict(configurations.compute_source_values(system, given))
    elif "=" in text:
        return parse_known_values(system, text.split(","), degrees)
    else:
        rows = np.array(parse_numbers(text, "q"))
    return convert_to_radians(system, rows, degrees)


def convert_to_radians(system: System, rows: Any, degrees: bool) -> Array:
    """Return configurations (..., nq) in radians; with `degrees` their angles are degrees.

    Errors: `InputError`.
    """
    q = configurations.read_q(system, rows)
    if not degrees:
        configurations.warn_of_degrees_in_q(system, q, "q")
    return q / configurations.name_values(system, np.ones(system.nq)).convert_units(degrees)


def find_posture(system: System, name: str | None) -> Array | None:
    """Return the configuration (nq,) of a posture, of 'neutral' or of 'mid'; None without a name."""
    if name is None:
        return None
    if name in system.structure.posture_names:
        return configurations.make_q(system, name)
    if name not in SPECIAL:
        names = (*system.structure.posture_names, *SPECIAL)
        raise UnknownNameError("posture", name, names, system.name)
    return (system.neutral if name == "neutral" else system.mid).copy()


def read_configurations(
    system: System, text: str | None, posture: str | None = None, degrees: bool = False
) -> Array:
    """Return the configuration (nq,) that `text` gives, or configurations (n, nq) of a file.

    `text` is 'a,b,c' (all of q in order), 'name=value,...' (the rest neutral, or as in the posture;
    in a system with loops, what closes these), or a .csv or .npy file. `posture` names a posture of
    the system, or is 'neutral' or 'mid'.
    Errors: `InputError`, `UnknownNameError`.
    """
    base = find_posture(system, posture)
    if text is None:
        return system.neutral.copy() if base is None else base
    values = _parse_values(system, text, degrees)
    if isinstance(values, dict):
        return configurations.close_from_start(system, values, base)
    return values


def read_start(system: System, text: str | None, degrees: bool = False) -> Array | None:
    """Return the start (..., nq) that a posture's name or values give; None where nothing is given.

    What 'name=value' leaves open is as at home. Errors: `InputError`, `UnknownNameError`.
    """
    if text is None:
        return None
    is_name = not any(c in text for c in ",=.") and not is_number(text)
    if is_name or text in system.structure.posture_names:
        return find_posture(system, text)
    return configurations.read_start(system, _parse_values(system, text, degrees))


def find_motion_start(
    system: System, text: str | None, held: dict[str, Any], degrees: bool = False
) -> tuple[Array | None, Assembly | None]:
    """Return the configuration where a motion starts, and the assembly that closed its loops.

    Loops are closed where `text` is 'name=value,...' or where coordinates are held; else the
    assembly is None and the start is that of `read_start`.
    """
    is_named = text is not None and "=" in text and not is_table_file(text)
    named = parse_known_values(system, text.split(","), degrees) if text and is_named else {}
    for name in named:
        if name in held:
            raise InputError(f"{name!r} is held and given as a start, too: leave one out")
    near = None if is_named else read_start(system, text, degrees)
    if not named and not held:
        return near, None
    answer = system.assemble({**held, **named}, near)
    return answer.q, answer


def read_configuration(
    system: System, text: str | None, posture: str | None, degrees: bool = False
) -> tuple[Array | None, Assembly | None]:
    """Return one configuration (nq,) from the command line; None where nothing is given.

    As `read_configurations`, but where 'name=value,...' is given of a system with loops, these are
    closed, started at the posture: then the assembly is the second answer. Errors: as there, and
    `InputError` for several rows.
    """
    if text is None and posture is None:
        return None, None
    is_named = text is not None and "=" in text and not is_table_file(text)
    if text and is_named and configurations.has_loops(system):
        known = parse_known_values(system, text.split(","), degrees)
        answer = system.assemble(known, find_posture(system, posture))
        return answer.q, answer
    q = read_configurations(system, text, posture, degrees)
    if q.ndim != 1:
        raise InputError(f"{text}: it holds {format_count(len(q), 'configuration')}; one is needed")
    return q, None


# ---- targets and tasks


def read_target(system: System, text: str, degrees: bool = False) -> tuple[Array, bool]:
    """Return target poses (..., 4, 4), and whether only the positions are given.

    'x,y,z,roll,pitch,yaw' (fixed axes, as in URDF), 'x,y,z,qw,qx,qy,qz' or 'x,y,z'; of planar
    systems 'x,y,angle' and 'x,y' in place of 'x,y,z'; or a file of such rows, where a .npy may also
    hold (n, 4, 4) matrices.
    """
    if is_table_file(text):
        names, rows = read_table(expand_path(text), degrees, matrices=True)
    else:
        names = None
        rows = np.array(parse_numbers(text, "target"))
    if rows.ndim == 3:
        return rows, False
    return read_pose_columns(system.dim, rows, names, degrees)


def make_clearance(distance: float | None) -> Constraint | None:
    """Make the clearance of all bodies from the option --clearance; None where it is not given."""
    if distance is None:
        return None
    from kempe.constraints import KINDS

    clearance: Any = KINDS["clearance"]
    return clearance(at_least=distance)


def make_task_argument(task: str | None, axis: str | None) -> Any:
    """Return the argument `task` of the library: a task, perhaps with the tool's axis."""
    if axis is None:
        return task
    if task not in ("direction", "position_axis"):
        raise InputError("--axis is for the tasks direction and position_axis")
    return task, parse_numbers(axis, "axis") if "," in axis else axis.strip().lower()
