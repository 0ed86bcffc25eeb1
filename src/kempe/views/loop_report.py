"""Assemblies, modes and motions for people and for programs: known values read, answers as tables and as JSON data."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from kempe import spatial
from kempe.errors import InputError
from kempe.views import facts, report, rows

if TYPE_CHECKING:
    from kempe.analysis.path import Path
    from kempe.model.system import System
    from kempe.solvers.assembly import Assembly
    from kempe.solvers.modes import Modes


# ---- what is given


def known(system: System, words: Iterable[str], degrees: bool = False) -> dict[str, Any]:
    """Known coordinates and places of frames, from 'name=value' and 'frame=x,y,z'. Errors: `InputError`."""
    unit = facts.units(system)
    out: dict[str, Any] = {}
    for word in words:
        name, sign, text = word.partition("=")
        name = name.strip()
        if not sign or not name:
            raise InputError(f"{word!r} is no known value: write name=value, or frame=x,y,z")
        if name in out:
            raise InputError(f"{name!r} is given twice")
        numbers = rows.numbers(text, name)
        if name in system.frame_names and name not in system.coordinate_names:
            if len(numbers) not in (system.dim, 3):
                raise InputError(f"the place of frame {name!r} has {len(numbers)} numbers; it needs {system.dim}")
            out[name] = np.array(numbers)
            continue
        if len(numbers) != 1:
            raise InputError(f"{name!r} has {len(numbers)} values; a coordinate has one")
        angle = unit.get(name) == "rad" or (name not in unit and name in system.couplings)
        out[name] = numbers[0] * facts.DEGREE if degrees and angle else numbers[0]
    return out


def start(system: System, text: str | None, degrees: bool = False) -> spatial.Array | None:
    """A start given as the name of a posture, or as values; None where nothing is given."""
    if text is None:
        return None
    if text in (*system.posture_names, "neutral", "mid"):
        return rows.configuration(system, None, text, degrees)
    base = "closed" if "=" in text and "closed" in system.posture_names else None
    return rows.configuration(system, text, base, degrees)


@contextlib.contextmanager
def progress(file: TextIO) -> Iterator[Callable[[int, float], None] | None]:
    """A line that counts points and arc length while a motion is traced; nothing where `file` is no terminal."""
    if not file.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(file=file), transient=True) as bar:
        task = bar.add_task("tracing ...")

        def said(points: int, length: float) -> None:
            bar.update(task, description=f"tracing: {points} points, arc length {length:.3g}")

        yield said


# ---- assemblies


def assembly(answer: Assembly, degrees: bool = False) -> RenderableType:
    """An answer of `assemble`: its sentence, and the configuration by name."""
    system = answer.system
    style = "bold green" if answer else "bold red"
    shown: list[RenderableType] = [Text(report.clean(answer.status), style=style), ""]
    lines = []
    q = facts.in_degrees(answer.q, system.coordinate_names, facts.units(system), degrees)
    given = set(answer.assembler.sources)
    for c, x in zip(facts.coordinates(system, degrees), q.tolist(), strict=True):
        cut = any(c["name"] == j or c["name"].startswith(f"{j}.") for j in system.closures)
        lines.append((c["name"], report.number(x, 9), c["unit"], "known" if c["name"] in given else "cut" * cut))
    shown.append(report.table(("coordinate" if answer else "nearest found", ">value", "=unit", ""), lines))
    return Group(*shown)


def assembly_facts(answer: Assembly, degrees: bool = False) -> dict[str, Any]:
    """An answer of `assemble` as plain data."""
    system = answer.system
    fields = ("success", "status", "residual", "iterations", "starts")
    out = {name: facts.jsonable(np.asarray(getattr(answer, name)).tolist()) for name in fields}
    return {"system": system.name, "angle_unit": _angle(degrees), **out, "q": _by_name(system, answer.q, degrees)}


def modes(answer: Modes, degrees: bool = False) -> RenderableType:
    """All assembly modes: a line for each."""
    system = answer.system
    names = [n for n in system.coordinate_names if n not in answer.known]
    unit = {c["name"]: c["unit"] for c in facts.coordinates(system, degrees)}
    q = facts.in_degrees(answer.q, system.coordinate_names, facts.units(system), degrees)
    at = [system.coordinate_names.index(n) for n in names]
    count = report.count(len(answer), "assembly mode")
    head = Text(f"{count}: {report.clean(answer.status)}", style="bold green" if answer else "bold red")
    lines = [(answer.branches[k] or str(k + 1), *(report.number(x) for x in row[at])) for k, row in enumerate(q)]
    columns = ("branch", *(f">{n} [{unit[n]}]" if unit[n] else f">{n}" for n in names))
    return Group(head, "", report.table(columns, lines)) if lines else head


def modes_facts(answer: Modes, degrees: bool = False) -> dict[str, Any]:
    """All assembly modes as plain data."""
    return {
        "system": answer.system.name, "angle_unit": _angle(degrees), "complete": answer.complete,
        "status": answer.status, "branches": list(answer.branches), "multiplicity": answer.multiplicity.tolist(),
        "coverage": answer.coverage, "expected": answer.expected,
        "q": [_by_name(answer.system, q, degrees) for q in answer.q],
    }  # fmt: skip


# ---- motions


def path(answer: Path, degrees: bool = False) -> RenderableType:
    """A traced motion: what it is, its special points, the range of each coordinate."""
    system = answer.system
    shown: list[RenderableType] = [Text(report.clean(answer.status), style="bold green" if answer else "bold red")]
    for event in (*answer.turning_points, *answer.singular_points):
        shown.append(Text(f"  {report.clean(event)}"))
    shown += [Text(f"  another branch: {report.clean(other.status)}") for other in answer.others]
    if len(answer) > 1:
        q = facts.in_degrees(answer.q, system.coordinate_names, facts.units(system), degrees)
        lines = [(c["name"], report.number(x.min()), report.number(x.max()), c["unit"])
                 for c, x in zip(facts.coordinates(system, degrees), q.T, strict=True)]  # fmt: skip
        shown += ["", report.table(("coordinate", ">least", ">largest", "=unit"), lines)]
    return Group(*shown)


def path_facts(answer: Path, degrees: bool = False) -> dict[str, Any]:
    """A traced motion as plain data: all configurations, curves of its frames, special points."""
    names, columns = path_table(answer, degrees)
    return {
        "system": answer.system.name, "angle_unit": _angle(degrees), "success": bool(answer),
        "status": answer.status, "closed": answer.closed, "ends": list(answer.ends), "length": answer.length,
        "turning_points": [str(e) for e in answer.turning_points],
        "singular_points": [str(e) for e in answer.singular_points],
        "branches": [other.status for other in answer.others], "columns": names, "rows": facts.jsonable(columns),
    }  # fmt: skip


def path_table(answer: Path, degrees: bool = False) -> tuple[list[str], spatial.Array]:
    """Names and columns of a path: arc length, all coordinates, the curves of its frames."""
    system = answer.system
    names, columns = answer.table()
    columns = columns.copy()
    q = slice(1, system.nq + 1)
    columns[:, q] = facts.in_degrees(columns[:, q], system.coordinate_names, facts.units(system), degrees)
    return names, columns


def write_path(file: FilePath, answer: Path, degrees: bool = False) -> None:
    """Write a path to a .csv (with names) or .npy file."""
    names, columns = path_table(answer, degrees)
    rows.write(file, names, columns, columns)


def _by_name(system: System, q: spatial.Array, degrees: bool) -> Any:
    values = facts.in_degrees(q, system.coordinate_names, facts.units(system), degrees)
    return dict(zip(system.coordinate_names, facts.jsonable(values), strict=True))


def _angle(degrees: bool) -> str:
    return "deg" if degrees else "rad"
