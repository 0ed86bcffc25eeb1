"""Known values, starts, configurations and branches of systems with loops, as the command line is
given them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.description.source import expanded
from kempe.errors import InputError, UnknownNameError
from kempe.kinematics.configuration import has_loops
from kempe.model.tree.coordinates import units
from kempe.views import facts, report, rows
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.model.system import System
    from kempe.solvers.assembly.assembled import Assembly

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
        if not sign and rows.is_file(word):
            found = _columns(system, expanded(word), degrees)
        elif not sign or not name:
            raise InputError(
                f"{word!r} is no known value: write name=value"
                + (", or frame=x,y,z" if frames else "")
            )
        else:
            found = {name: _value(system, name, rows.numbers(text, name), degrees, frames)}
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
            has = report.count(len(numbers), "number")
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
    return facts.DEGREE if degrees and units(system).get(name) == "rad" else 1.0


def _columns(system: System, path: Path, degrees: bool) -> dict[str, Any]:
    """Values (n,) of the coordinates that the first line of a .csv names."""
    names, table = rows.read(path)
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
        return rows.configuration(system, None, text, degrees)
    if not any(c in text for c in ",=.") and not text.strip().lstrip("+-").isdigit():
        raise UnknownNameError(
            "posture", text, (*system.structure.posture_names, *SPECIAL), system.name
        )
    return rows.configuration(system, text, None, degrees, start=True)


def first(
    system: System, text: str | None, held: Mapping[str, Any], degrees: bool = False
) -> tuple[spatial.Array | None, Assembly | None]:
    """Where a motion starts, as `start`; with 'name=value,...' or held coordinates closed, then
    with the assembly.
    """
    words = text.split(",") if text is not None and "=" in text and not rows.is_file(text) else []
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

    As `rows.configuration`, but where 'name=value,...' is given of a system with loops, these are
    closed, started at the posture: then the assembly is the second answer. Errors: as there, and
    `InputError` for several rows.
    """
    if text is None and posture is None:
        return None, None
    if text is not None and "=" in text and not rows.is_file(text) and has_loops(system):
        near = None if posture is None else rows.configuration(system, None, posture, degrees)
        answer = system.assemble(known(system, text.split(","), degrees, frames=False), near)
        return answer.q, answer
    q = rows.configuration(system, text, posture, degrees)
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
    from kempe.solvers.dyads.dyads import Incomplete, closed_form

    plan = closed_form(system, tuple(given))
    if not isinstance(plan, Incomplete) and plan.signs != len(text):
        needs = f"{report.count(plan.signs, 'sign')} with these inputs: --modes lists its branches"
        raise InputError(
            f"branch {text!r} has {report.count(len(text), 'sign')}; {system.name} has {needs}"
        )
    return text
