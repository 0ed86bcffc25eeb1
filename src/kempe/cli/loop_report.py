"""Reports of systems with loops: freedoms, assemblies, modes and motions, as tables and data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from kempe import spatial
from kempe.answers.tables import write_table
from kempe.cli import as_json, report
from kempe.forward.fk import fk
from kempe.model.configurations import units
from kempe.status import named
from kempe.words import counted, jsonable

if TYPE_CHECKING:
    from kempe.assemble.answer import Assembly
    from kempe.assemble.modes import Modes
    from kempe.mobility.answer import Mobility
    from kempe.mobility.classify import Classification
    from kempe.model.model import Model
    from kempe.motion.path import Event, Path

EVENT_LIMIT = 24
"""Points where coordinates turn back that are listed; the data have all."""
NARROW = 7
"""Coordinates up to which assembly modes are lines of a table; of more of them, each mode is a
column."""


# ---- degrees of freedom


def mobility(answer: Mobility) -> RenderableType:
    """Degrees of freedom: the sentence, and the reasoning by topic."""
    style = (
        "bold green"
        if answer.closed and answer.certain
        else "bold red"
        if not answer.closed
        else "bold yellow"
    )
    return _by_topic(str(answer._headline()), answer.topics(), style)


def classify(answer: Classification) -> RenderableType:
    """What constraints are: the sentence, and the reasoning by topic."""
    style = "bold green" if not answer.why and not answer.doubtful else "bold yellow"
    return _by_topic(str(answer._headline()), answer.topics(), style)


def _by_topic(headline: str, topics: list[tuple[str, list[str]]], style: str) -> RenderableType:
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column(style="bold", no_wrap=True)
    grid.add_column(overflow="fold")
    for title, own in topics:
        for k, line in enumerate(x for x in own if x):
            grid.add_row(title if k == 0 else "", Text(report.clean(line)))
    return Group(Text(report.clean(headline), style=style), "", grid)


def report_facts(
    system: Model, answer: Mobility | Classification, degrees: bool = False
) -> dict[str, Any]:
    """Degrees of freedom, or what constraints are, as plain data."""
    data = answer.data()
    sides: list[dict[str, Any]] = (
        data["one_sided"]["sides"] if data["one_sided"] and degrees else []
    )
    for side in sides:
        if side["unit"] == "rad":
            side |= {
                "unit": "deg",
                **{k: side[k] / as_json.DEGREE for k in ("value", "bound", "slack")},
            }
    return {
        "system": data.pop("name"),
        "angle_unit": _angle(degrees),
        **data,
        "q": by_name(system, answer.q, degrees),
    }


# ---- assemblies


def assembly(
    answer: Assembly, degrees: bool = False, given: Mapping[str, Any] | None = None
) -> RenderableType:
    """An answer of `assemble`: its sentence, and the configuration by name; a line for each row of
    a batch.

    `given` are the known values: of frames among them it is said where they are, and by how much
    they miss.
    """
    system = answer.system
    if np.ndim(answer.success):
        return _assemblies(answer, degrees)
    shown: list[RenderableType] = [Text(report.clean(answer.status), style=_style(answer)), ""]
    lines: list[tuple[Any, str, Any, str]] = []
    q = _shown(system, answer.q, degrees)
    sources = set(answer.assembler.sources)
    for c, x in zip(as_json.coordinates(system, degrees), q.tolist(), strict=True):
        cut = any(
            c["name"] == j or c["name"].startswith(f"{j}.") for j in system.structure.closures
        )
        lines.append(
            (
                c["name"],
                report.number(x, 9),
                c["unit"],
                "known" if c["name"] in sources else "cut" * cut,
            )
        )
    shown.append(
        report.table(("coordinate" if answer else "nearest found", ">value", "=unit", ""), lines)
    )
    for name in answer.assembler.frames:
        at = fk(system, answer.q, name)[: system.dim, 3]
        text = f"{name} is at {', '.join(report.number(x) for x in at.tolist())}"
        missed = float(np.linalg.norm(at - _place((given or {}).get(name, at), system.dim)))
        if missed > as_json.CLOSED:
            text += f", {missed:.6g} m from where it should be"
        shown.append(Text(report.clean(text)))
    shown += report.verdict(answer)
    if answer and lines:
        copy = f"--q {','.join(report.number(x, 9).rstrip('0').rstrip('.') for x in q.tolist())}"
        shown += ["", Text(copy, style="dim", no_wrap=True, overflow="ignore")]
    return Group(*shown)


def _place(value: Any, dim: int) -> spatial.Array:
    value = np.asarray(value, dtype=float)
    return value[:dim, 3] if value.ndim == 2 else value[:dim]


def _assemblies(answer: Assembly, degrees: bool) -> RenderableType:
    missed = np.flatnonzero(~np.asarray(answer.success)).tolist()
    head = Text(str(answer), style=_style(answer))
    for row in missed[: report.REASON_LIMIT]:
        head.append(f"\nrow {row}: {report.clean(answer.status[row])}", "red")
    if len(missed) > report.REASON_LIMIT:
        head.append(f"\nand {report.rows_text(missed[report.REASON_LIMIT :])}", "red")
    q = _shown(answer.system, answer.q, degrees)
    cells = [
        (i, "yes" if good else "no", *map(report.number, row))
        for i, (good, row) in enumerate(zip(answer.success, q.tolist(), strict=True))
    ]
    heads = (">row", "closed", *_heads(answer.system, degrees))
    return Group(head, *report.verdict(answer), "", report.table(heads, cells))


def closed_only(answer: Assembly) -> spatial.Array:
    """Configurations (nq,) or (n, nq) of an assembly, those that are not closed as NaN: fit for a
    file.
    """
    return np.where(np.asarray(answer.success)[..., None], answer.q, np.nan)


def modes(answer: Modes, degrees: bool = False) -> RenderableType:
    """All assembly modes: a line for each, or a column where there are many coordinates; and what
    signs mean.
    """
    system = answer.system
    count = report.count(
        len(answer), "configuration" if np.any(answer.freedoms) else "assembly mode"
    )
    head = Text(f"{count}: {report.clean(answer.status)}", style=_style(answer))
    at = [i for i, n in enumerate(system.coordinate_names) if n not in answer.known]
    q = _shown(system, answer.q, degrees)[:, at]
    heads = [_heads(system, degrees)[i] for i in at]
    names = [_mode(answer, k) for k in range(len(q))]
    shown: list[RenderableType] = [head]
    if len(q) and len(at) <= NARROW:
        lines = [
            (name, *map(report.number, row)) for name, row in zip(names, q.tolist(), strict=True)
        ]
        shown += ["", report.table(("branch", *heads), lines)]
    blocks = math.ceil(len(q) / NARROW) if len(at) > NARROW else 0
    for k in range(blocks):
        part = slice(k * len(q) // blocks, (k + 1) * len(q) // blocks)
        lines = [
            (h.lstrip(">"), *map(report.number, row))
            for h, row in zip(heads, q[part].T.tolist(), strict=True)
        ]
        shown += ["", report.table(("branch", *(f">{n}" for n in names[part])), lines)]
    if any(answer.branches):
        from kempe.assemble.dyads import closed_form

        meaning = str(closed_form(system, tuple(answer.known)).describe()).split("\n")[1:]  # type: ignore[union-attr]
        shown += ["", *(Text(report.clean(line.strip()), style="dim") for line in meaning)]
    return Group(*shown)


def _mode(answer: Modes, k: int) -> str:
    return (answer.branches[k] or str(k + 1)) + ("" if answer.inside[k] else " (outside limits)")


# ---- motions


def path(answer: Path, degrees: bool = False) -> RenderableType:
    """A traced motion: what it is, its special points, the range of each coordinate."""
    system = answer.system
    shown: list[RenderableType] = [Text(report.clean(answer.status), style=_style(answer))]
    shown += [Text(f"  another branch: {report.clean(other.status)}") for other in answer.others]
    if answer.hint:
        start = ",".join(f"{x:.9g}" for x in _shown(system, answer.elsewhere[0], degrees).tolist())
        shown.append(Text(report.clean(f"  {answer.hint}: --start {start}")))
    unit = units(system)
    events = [*answer.turning_points[:EVENT_LIMIT], *answer.singular_points]
    if events:
        lines = [_event(e, unit, degrees) for e in sorted(events, key=lambda e: e.s)]
        shown += ["", report.table((">at s", "what", "=coordinate", ">value", "=unit"), lines)]
        more = len(answer.turning_points) - EVENT_LIMIT
        if more > 0:
            shown.append(Text(f"... and {counted(more, 'more point')} where coordinates turn back"))
    if len(answer) > 1:
        all_q = np.vstack([answer.q, *(e.q for e in answer.extremes)])
        q = _shown(system, all_q, degrees)
        lines = [
            (c["name"], report.number(x.min()), report.number(x.max()), c["unit"])
            for c, x in zip(as_json.coordinates(system, degrees), q.T, strict=True)
        ]
        shown += ["", report.table(("coordinate", ">least", ">largest", "=unit"), lines)]
    return Group(*shown, *report.verdict(answer))


def _event(event: Event, unit: dict[str, str], degrees: bool) -> tuple[str, ...]:
    if event.coordinate:
        value, shown = _in_unit(event, unit, degrees)
        return report.number(event.s), event.kind, event.coordinate, report.number(value, 9), shown
    lines = 0 if event.directions is None else len(event.directions)
    branches = f" of {report.count(lines, 'branch', 'branches')}" if lines > 1 else ""
    return report.number(event.s), event.kind + branches, "", "", ""


def _in_unit(event: Event, unit: dict[str, str], degrees: bool) -> tuple[float, str]:
    angle = degrees and unit[event.coordinate] == "rad"
    return (event.value / as_json.DEGREE, "deg") if angle else (event.value, unit[event.coordinate])


def path_facts(answer: Path, degrees: bool = False) -> dict[str, Any]:
    """A traced motion as plain data: all configurations, curves of its frames, special points,
    other branches.
    """
    names, columns = path_table(answer, degrees)
    return {
        "system": answer.system.name,
        "angle_unit": _angle(degrees),
        "driver": answer.driver,
        "held": list(answer.held),
        **_motion(answer, degrees),
        **as_json.judged(answer),
        "columns": names,
        "rows": jsonable(columns),
        "others": [
            {**_motion(o, degrees), "rows": jsonable(path_table(o, degrees)[1])}
            for o in answer.others
        ],
    }


def _motion(answer: Path, degrees: bool) -> dict[str, Any]:
    return {
        "success": bool(answer),
        "code": named(answer.code),
        "status": answer.status,
        "interrupted": answer.interrupted,
        "late": answer.late,
        "closed": answer.closed,
        "ends": list(answer.ends),
        "length": answer.length,
        "turns": answer.turns,
        "turning_points": [_event_facts(answer.system, e, degrees) for e in answer.turning_points],
        "singular_points": [
            _event_facts(answer.system, e, degrees) for e in answer.singular_points
        ],
    }


def _event_facts(system: Model, event: Event, degrees: bool) -> dict[str, Any]:
    out: dict[str, Any] = {"s": event.s, "kind": event.kind}
    if event.coordinate:
        value, unit = _in_unit(event, units(system), degrees)
        out |= {"coordinate": event.coordinate, "value": value, "unit": unit}
    else:
        out |= {
            "branches": 0 if event.directions is None else len(event.directions),
            "nullity": event.nullity,
        }
    return out | {"q": by_name(system, event.q, degrees)}


def path_table(answer: Path, degrees: bool = False) -> tuple[list[str], spatial.Array]:
    """Names and columns of a path: arc length, all coordinates, the curves of its frames."""
    system = answer.system
    names, columns = answer.table()
    columns = columns.copy()
    q = slice(1, system.nq + 1)
    columns[:, q] = _shown(system, columns[:, q], degrees)
    return names, columns


def write_path(file: FilePath, answer: Path, degrees: bool = False, branches: bool = False) -> None:
    """Write a path to a .csv (with names) or .npy file; with `branches` the others too, numbered in
    column 0.
    """
    names, columns = path_table(answer, degrees)
    if branches:
        tables = [columns, *(path_table(other, degrees)[1] for other in answer.others)]
        columns = np.vstack([np.insert(table, 0, k, axis=1) for k, table in enumerate(tables)])
        names = ["branch", *names]
    write_table(file, names, columns)


# ---- coordinates and their units


def by_name(system: Model, q: spatial.Array, degrees: bool) -> Any:
    """Values by coordinate name of a configuration (nq,); a list of these of many (n, nq)."""
    values = jsonable(_shown(system, q, degrees))
    several = values if np.ndim(q) > 1 else [values]
    named = [dict(zip(system.coordinate_names, row, strict=True)) for row in several]
    return named if np.ndim(q) > 1 else named[0]


def _shown(system: Model, q: spatial.Array, degrees: bool) -> spatial.Array:
    return as_json.in_degrees(q, system.coordinate_names, units(system), degrees)


def _heads(system: Model, degrees: bool) -> list[str]:
    """Heads of columns of numbers: each coordinate with its unit."""
    return [
        f">{c['name']} [{c['unit']}]" if c["unit"] else f">{c['name']}"
        for c in as_json.coordinates(system, degrees)
    ]


def _style(answer: Any) -> str:
    return "bold green" if answer else "bold red"


def _angle(degrees: bool) -> str:
    return "deg" if degrees else "rad"
