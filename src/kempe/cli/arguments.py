"""Arguments of commands: known values, starts, configurations, targets, branches, axes, tolerances."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.tables import read_pose_columns
from kempe.cli import table_files
from kempe.cli.table_files import is_table_file, parse_numbers
from kempe.description.source import expand_path
from kempe.errors import InputError, UnknownNameError
from kempe.model.configurations import (
    close_from_start,
    compute_mid_configuration,
    compute_source_values,
    has_loops,
    list_units,
    make_q,
    name_values,
    read_q,
    set_from_home,
)
from kempe.poses import AXES
from kempe.spatial import Array
from kempe.words import DEGREE, format_count

if TYPE_CHECKING:
    from kempe.assemble.answer import Assembly
    from kempe.system import System

SPECIAL = ("neutral", "mid")
"""Names that every system has besides its postures."""


# ---- values by name


def parse_known_values(
    system: System, words: Iterable[str], degrees: bool = False, frames: bool = True
) -> dict[str, Any]:
    """Return known coordinates and positions of frames by name, from 'name=value' or a .csv file.

    A word is 'name=value', 'frame=x,y,z', or the name of a .csv file with named columns.

    A word is 'name=value', 'frame=x,y,z', or the name of a .csv file with named columns.

    Coordinates that follow others are turned into these.
    Errors: `InputError`, `UnknownNameError`.
    """
    given: dict[str, Any] = {}
    for word in words:
        for name, value in _read_values(system, word, degrees, frames).items():
            if name in given:
                raise InputError(f"{name!r} is given twice")
            if not np.isfinite(value).all():
                raise InputError(
                    f"{name}: {_describe_nonfinite_number(value, '=' not in word)} is not a finite number"
                )
            given[name] = value
    places = {name: x for name, x in given.items() if _is_frame(system, name)}
    rest = {name: x for name, x in given.items() if name not in places}
    return {**compute_source_values(system, rest), **places}


def _describe_nonfinite_number(value: Any, rows: bool) -> str:
    """Return the first number that is not finite as text, with its row where `value` has rows."""
    k = int(np.flatnonzero(~np.isfinite(np.ravel(value)))[0])
    return f"{np.ravel(value)[k]}" + f" in row {k}" * rows


def _read_values(system: System, word: str, degrees: bool, frames: bool) -> dict[str, Any]:
    """Return the values that a word gives: of a coordinate, of a frame, or the columns of a file."""
    name, sign, text = (part.strip() for part in word.partition("="))
    if not sign and is_table_file(word):
        return _read_columns(system, expand_path(word), degrees)
    if not sign or not name:
        example = "name=value, or frame=x,y,z" if frames else "name=value"
        raise InputError(f"{word!r} is no known value: write {example}")
    values = parse_numbers(text, name)
    if frames and _is_frame(system, name):
        if len(values) not in (system.dim, 3):
            needed = "x,y" if system.dim == 2 else "x,y,z"
            has = format_count(len(values), "number")
            raise InputError(f"{name!r} is a frame and has {has}; its place is {name}={needed}")
        return {name: np.array(values)}
    _check_coordinate(system, name, frames)
    if len(values) != 1:
        raise InputError(f"{name!r} has {len(values)} values; a coordinate has one")
    return {name: values[0] * _choose_unit_factor(system, name, degrees)}


def _list_coordinates(system: System) -> tuple[str, ...]:
    """Return the names of all coordinates in q and of the coordinates that follow them."""
    return (*system.coordinate_names, *system.structure.couplings)


def _is_frame(system: System, name: str) -> bool:
    """Whether `name` is a frame of the system and no coordinate."""
    return name in system.frame_names and name not in _list_coordinates(system)


def _check_coordinate(system: System, name: str, frames: bool = False) -> None:
    """Raise `UnknownNameError` if no coordinate (or frame) of the system has this name."""
    names = _list_coordinates(system)
    if name not in names:
        what = "coordinate or frame" if frames else "coordinate"
        places = system.structure.frames if frames else ()
        raise UnknownNameError(what, name, (*names, *places), system.name)


def _choose_unit_factor(system: System, name: str, degrees: bool) -> float:
    """Return the factor that converts a value of a coordinate to radians or metres."""
    return DEGREE if degrees and list_units(system).get(name) == "rad" else 1.0


def _read_columns(system: System, path: Path, degrees: bool) -> dict[str, Array]:
    """Return the values (n,) of each coordinate that the first line of a .csv file names."""
    names, rows = table_files.read_table(path)
    if names is None:
        raise InputError(f"{path}: its first line must name the known coordinates")
    if len(set(names)) < len(names):
        raise InputError(f"{path}: a column appears twice")
    for name in names:
        _check_coordinate(system, name)
    factors = [_choose_unit_factor(system, name, degrees) for name in names]
    return {n: x * f for n, x, f in zip(names, rows.T, factors, strict=True)}


def parse_joint_names(system: System, flag: str, text: str | None) -> list[str] | None:
    """Return the names in 'A,B'; None where `text` is None.

    Errors: `InputError` where the text holds no name.

    Errors: `InputError` where the text holds no name.
    """
    if text is None:
        return None
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise InputError(f"{flag} names no joint; there are: {', '.join(system.joint_names)}")
    return names


# ---- configurations and starts


def read_configurations(
    system: System,
    text: str | None,
    posture: str | None = None,
    degrees: bool = False,
    start: bool = False,
) -> Array:
    """Return the configuration (nq,) that `text` gives, or configurations (n, nq) of a file.

    `text` is 'a,b,c' (all of q in order), 'name=value,...' (the rest neutral, or as in the posture;
    in a system with loops, what closes these), or a .csv or .npy file. `posture` names a posture of
    the system, or is 'neutral' or 'mid'. Of a `start` no loop is closed.
    Errors: `InputError`, `UnknownNameError`.
    """
    base = None if posture is None else _find_posture(system, posture)
    if text is None:
        return system.neutral.copy() if base is None else base
    if is_table_file(text):
        names, rows = table_files.read_table(expand_path(text))
        if names is None:
            return _convert_to_radians(system, read_q(system, rows), degrees)
        values = _read_columns(system, expand_path(text), degrees)
        return (set_from_home if start else close_from_start)(system, values)
    if "=" not in text:
        return _convert_to_radians(system, read_q(system, parse_numbers(text, "q")), degrees)
    values: dict[str, Any] = {}
    for word in text.split(","):
        for name, value in _read_values(system, word, degrees, False).items():
            if name in values:
                raise InputError(f"{name!r} is given twice")
            values[name] = value
    if not start:
        return close_from_start(system, values, base)
    return set_from_home(system, values) if base is None else make_q(system, values, base)


def _find_posture(system: System, name: str) -> Array:
    """Return the configuration (nq,) of a posture, of 'neutral' or of 'mid'."""
    if name in SPECIAL and name not in system.structure.posture_names:
        return (system.neutral if name == "neutral" else compute_mid_configuration(system)).copy()
    if name not in system.structure.posture_names:
        names = (*system.structure.posture_names, *SPECIAL)
        raise UnknownNameError("posture", name, names, system.name)
    return make_q(system, name)


def _convert_to_radians(system: System, q: Array, degrees: bool) -> Array:
    """Return configurations q with all angles in radians; with `degrees` they are given in degrees."""
    return q / name_values(system, np.ones(system.nq)).convert_units(degrees)


def read_start(system: System, text: str | None, degrees: bool = False) -> Array | None:
    """Return the start (nq,) that a posture's name or values give; None where nothing is given.

    What 'name=value' leaves open is as at home. Errors: `InputError`, `UnknownNameError`.
    """
    if text is None:
        return None
    is_name = not any(c in text for c in ",=.") and not text.strip().lstrip("+-").isdigit()
    if is_name or text in system.structure.posture_names:
        return _find_posture(system, text)
    q = read_configurations(system, text, None, degrees, start=True)
    if q.ndim != 1:
        many = format_count(len(q), "configuration")
        raise InputError(f"{text}: it holds {many}; one is needed to start from")
    if not np.isfinite(q).all():
        raise InputError(f"{text}: a number to start from is not finite")
    return q


def find_motion_start(
    system: System, text: str | None, held: Mapping[str, Any], degrees: bool = False
) -> tuple[Array | None, Assembly | None]:
    """Return the configuration where a motion starts, and the assembly that closed its loops.

    Loops are closed where `text` is 'name=value,...' or where coordinates are held; else the
    assembly is None and the start is that of `read_start`.

    Loops are closed where `text` is 'name=value,...' or where coordinates are held; else the
    assembly is None and the start is that of `read_start`.
    """
    is_named = text is not None and "=" in text and not is_table_file(text)
    named = (
        parse_known_values(system, text.split(","), degrees, frames=False)
        if text and is_named
        else {}
    )
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
    if text is not None and "=" in text and not is_table_file(text) and has_loops(system):
        near = None if posture is None else _find_posture(system, posture)
        answer = system.assemble(
            parse_known_values(system, text.split(","), degrees, frames=False), near
        )
        return answer.q, answer
    q = read_configurations(system, text, posture, degrees)
    if q.ndim != 1:
        raise InputError(f"{text}: it holds {format_count(len(q), 'configuration')}; one is needed")
    return q, None


def read_target(system: System, text: str, degrees: bool = False) -> tuple[Array, bool]:
    """Return target poses (..., 4, 4), and whether only the positions are given.

    'x,y,z,roll,pitch,yaw' (fixed axes, as in URDF), 'x,y,z,qw,qx,qy,qz' or 'x,y,z'; of planar
    systems 'x,y,angle' and 'x,y' in place of 'x,y,z'; or a file of such rows, where a .npy may also
    hold (n, 4, 4) matrices.
    """
    if is_table_file(text):
        names, rows = table_files.read_table(expand_path(text), matrices=True)
    else:
        names = None
        rows = np.array(parse_numbers(text, "target"))
    if rows.ndim == 3:
        return rows, False
    return read_pose_columns(system.dim, rows, names, degrees)


def parse_branch(system: System, given: Mapping[str, Any], text: str | None) -> str | None:
    """Return a branch: signs of dyads, or the name of a posture.

    Errors: `InputError` where the text is neither.

    Errors: `InputError` where the text is neither.
    """
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
    from kempe.assemble.dyads import Incomplete, find_closed_form

    plan = find_closed_form(system, tuple(given))
    if not isinstance(plan, Incomplete) and plan.signs != len(text):
        needs = f"{format_count(plan.signs, 'sign')} with these inputs: --modes lists its branches"
        raise InputError(
            f"branch {text!r} has {format_count(len(text), 'sign')}; {system.name} has {needs}"
        )
    return text


# ---- axis and tolerance


def parse_axis(text: str) -> Array:
    """Return the tool's axis (3,) from three numbers or a name such as '-z'.

    Errors: `InputError`.

    Errors: `InputError`.
    """
    if text.strip().lower() in AXES:
        return np.array(AXES[text.strip().lower()])
    values = parse_numbers(text, "axis")
    if len(values) != 3:
        raise InputError(
            f"the axis has {format_count(len(values), 'number')}; it must be x,y,z in the tool's "
            "frame"
        )
    return np.array(values)


def parse_tolerance(text: str) -> tuple[float, float]:
    """Return the largest errors in metres and in radians, from 'm' (for both) or 'm,rad'."""
    values = parse_numbers(text, "tolerance")
    if len(values) not in (1, 2) or not all(v > 0.0 for v in values):
        raise InputError(
            f"tolerance is {text!r}; it must be one or two positive numbers, in metres and radians"
        )
    return values[0], values[-1]


def parse_single_tolerance(text: str) -> float:
    """Return the largest error of a solution, one number for metres and radians.

    Errors: `InputError`.

    Errors: `InputError`.
    """
    values = parse_numbers(text, "tolerance")
    if len(values) != 1 or not values[0] > 0.0:
        raise InputError(
            f"tolerance is {text!r}; for --all it must be one positive number, for metres and "
            "radians"
        )
    return values[0]
