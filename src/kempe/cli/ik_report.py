"""Reports of inverse models: all solutions, how they are found, and paths."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from kempe import spatial
from kempe.answers.tables import write_table
from kempe.cli import as_json, report, table_files
from kempe.model.configurations import units
from kempe.status import named
from kempe.words import jsonable

if TYPE_CHECKING:
    from kempe.inverse.all_answer import Solutions
    from kempe.inverse.describe import Recognised
    from kempe.inverse.path import IkPath
    from kempe.model.model import Model

NARROW = 7
"""Coordinates up to which solutions are lines of a table; of more of them, each solution is a
column."""

BLOCK = 8
"""Solutions beside each other, at most."""


# ---- all solutions


def solutions(answer: Solutions, degrees: bool = False) -> RenderableType:
    """All configurations that reach a target: the sentence, a table, the families; of a batch a
    line for each.
    """
    if not answer.single:
        return _batch(answer, degrees)
    system = answer.system
    shown: list[RenderableType] = [
        Text(report.clean(answer.status), style=_style(bool(answer), answer.complete))
    ]
    if len(answer):
        q = _in_units(system, answer.q, degrees)
        shown += [
            "",
            *(_lines(answer, q, degrees) if system.nq <= NARROW else _columns(answer, q, degrees)),
        ]
    if answer.families:
        shown.append("")
    shown += [
        Text(f"family: {report.clean(str(family))}", style="yellow") for family in answer.families
    ]
    if answer and answer.inside[0]:
        first = _in_units(system, answer.q[0], degrees)
        copy = (
            f"--q {','.join(report.number(x, 9).rstrip('0').rstrip('.') for x in first.tolist())}"
        )
        shown += ["", Text(copy, style="dim", no_wrap=True, overflow="ignore")]
    return Group(*shown)


def _lines(answer: Solutions, q: spatial.Array, degrees: bool) -> list[RenderableType]:
    """A line for each solution."""
    heads = [f">{c['name']} [{c['unit']}]" for c in as_json.coordinates(answer.system, degrees)]
    several = bool(np.any(answer.multiplicity != 1))
    named = any(answer.names)
    cells = [
        (
            k + 1,
            _inside(answer, k),
            *([_times(answer.multiplicity[k])] if several else []),
            f"{answer.residual[k]:.1e}",
            *(_number(x, h) for x, h in zip(row, heads, strict=True)),
            *([answer.names[k]] if named else []),
        )
        for k, row in enumerate(q.tolist())
    ]
    heads = [
        "inside",
        *(["times"] if several else []),
        ">residual",
        *heads,
        *(["branch"] if named else []),
    ]
    return [report.table((">#", *heads), cells)]


def _columns(answer: Solutions, q: spatial.Array, degrees: bool) -> list[RenderableType]:
    """A column for each solution, in blocks."""
    heads = [f"{c['name']} [{c['unit']}]" for c in as_json.coordinates(answer.system, degrees)]
    shown: list[RenderableType] = []
    blocks = math.ceil(len(q) / BLOCK)
    for k in range(blocks):
        part = range(k * len(q) // blocks, (k + 1) * len(q) // blocks)
        lines: list[tuple[object, ...]] = [("inside limits", *(_inside(answer, i) for i in part))]
        if np.any(answer.multiplicity != 1):
            lines.append(("times", *(_times(answer.multiplicity[i]) for i in part)))
        lines.append(("residual", *(f"{answer.residual[i]:.1e}" for i in part)))
        if any(answer.names):
            words = list(zip(*(answer.names[i].split(", ") for i in part), strict=True))
            heads_of = ("branch",) if len(words) == 1 else ("shoulder", "elbow", "wrist")
            lines += [
                (h, *(w.removeprefix(f"{h} ") for w in row))
                for h, row in zip(heads_of, words, strict=True)
            ]
        lines += [
            (h, *(_number(x, h) for x in q[list(part), i].tolist())) for i, h in enumerate(heads)
        ]
        shown += ["", report.table(("", *(f">{i + 1}" for i in part)), lines)]
    return shown[1:]


def _batch(answer: Solutions, degrees: bool) -> RenderableType:
    """How many targets are reached, why others are not, and every solution with the number of its
    target.
    """
    system = answer.system
    mask = answer.mask.reshape(-1, answer.mask.shape[-1])
    inside = answer.inside.reshape(mask.shape)
    reached = inside.any(axis=1)
    text = Text(
        report.clean(str(answer)),
        style=_style(bool(reached.all()), bool(np.all(answer.complete))),
    )
    missed = np.flatnonzero(~reached).tolist()
    said = np.asarray(answer.status, dtype=object).reshape(-1)
    for row in missed[: report.REASON_LIMIT]:
        text.append(f"\nrow {row}: {report.clean(said[row])}", "red")
    if len(missed) > report.REASON_LIMIT:
        text.append(f"\nand {report.rows_text(missed[report.REASON_LIMIT :])}", "red")
    heads = [f">{c['name']} [{c['unit']}]" for c in as_json.coordinates(system, degrees)]
    q = _in_units(system, answer.q.reshape(*mask.shape, system.nq), degrees)
    cells: list[tuple[Any, str, *tuple[str, ...]]] = []
    for i, k in zip(*np.nonzero(mask), strict=True):
        values = (_number(x, h) for x, h in zip(q[i, k].tolist(), heads, strict=True))
        cells.append((i, "yes" if inside[i, k] else "no", *values))
    return Group(text, "", report.table((">target", "inside", *heads), cells))


def _inside(answer: Solutions, k: int) -> str:
    return "yes" if answer.inside[k] else "no"


def _times(multiplicity: int) -> str:
    """How often a solution counts; one of a family has no number."""
    return str(multiplicity) if multiplicity > 0 else "family"


def _number(x: float, head: str) -> str:
    return report.number(x, 4 if "[deg]" in head else 6)


def _style(good: bool, complete: bool) -> str:
    return "bold red" if not good else "bold green" if complete else "bold yellow"


def _in_units(system: Model, q: spatial.Array, degrees: bool) -> spatial.Array:
    return as_json.in_degrees(q, system.coordinate_names, units(system), degrees)


def solutions_facts(answer: Solutions, degrees: bool = False) -> dict[str, Any]:
    """All solutions as plain data; of a batch a list of such data by target."""
    system = answer.system
    question = answer.question
    head = {
        "system": system.name,
        "frame": question.frame,
        "task": question.task,
        "angle_unit": "deg" if degrees else "rad",
    }
    if answer.single:
        families = [_family(system, family, degrees) for family in answer.families]
        return head | _one(answer, slice(None), degrees) | {"families": families}
    mask = answer.mask.reshape(-1, answer.mask.shape[-1])
    return head | {"targets": [_one(answer, (i, mask[i]), degrees) for i in range(len(mask))]}


def _one(answer: Solutions, which: Any, degrees: bool) -> dict[str, Any]:
    """The solutions of one target: `which` picks its rows out of a batch."""
    system = answer.system

    def picked(values: Any, core: int = 0) -> Any:
        values = np.asarray(values)
        return (
            values
            if answer.single
            else values.reshape(-1, *values.shape[values.ndim - 1 - core :])[which]
        )

    def of_target(values: Any) -> Any:
        return values if answer.single else np.asarray(values, dtype=object).reshape(-1)[which[0]]

    q = jsonable(_in_units(system, picked(answer.q, 1), degrees))
    fields = {
        name: jsonable(picked(getattr(answer, name)))
        for name in ("inside", "residual", "multiplicity", "branch", "condition")
    }
    fields["name"] = [str(name) for name in picked(answer.names)]
    found = [
        {
            "q": dict(zip(system.coordinate_names, row, strict=True)),
            **{n: v[k] for n, v in fields.items()},
        }
        for k, row in enumerate(q)
    ]
    unit = units(system)
    held = {
        n: as_json.in_degrees([of_target(v)], [n], unit, degrees).item()
        for n, v in answer.held.items()
    }
    return {
        "success": bool(picked(answer.inside).any()),
        "code": named(of_target(answer.code)),
        "status": str(of_target(answer.status)),
        "complete": bool(of_target(answer.complete)),
        "solutions": found,
        "held": jsonable(held),
        "spare": list(answer.spare),
        "tried": int(of_target(answer.tried)),
    }


def _family(system: Model, family: Any, degrees: bool) -> dict[str, Any]:
    return {
        "freedoms": family.freedoms,
        "joints": list(family.joints),
        "closed": bool(family.closed),
        "text": str(family),
        "q": jsonable(_in_units(system, family.q, degrees)),
    }


def write(path: Path, answer: Solutions, degrees: bool = False) -> None:
    """Write all solutions, a line each, as `kempe fk --q` reads them.

    Of a batch, lines of a .csv begin with the number of the target, and a .npy has the shape
    (targets, rows, nq), with NaN in rows not in use.
    """
    system = answer.system
    if answer.single:
        table_files.write_configurations(path, system, answer.q, degrees)
        return
    mask = answer.mask.reshape(-1, answer.mask.shape[-1])
    q = _in_units(system, answer.q.reshape(*mask.shape, system.nq), degrees)
    lines = np.column_stack([np.nonzero(mask)[0].astype(float), q[mask]])
    write_table(path, ("target", *system.coordinate_names), lines, q)


# ---- plans and paths


def plan(answer: Recognised) -> RenderableType:
    """What is recognised in a chain, and how its inverse model is solved."""
    head, *_ = str(answer).split("\n")
    grid = Table.grid(padding=(0, 2, 0, 0))
    grid.add_column(style="bold", no_wrap=True)
    grid.add_column(overflow="fold")
    for title, texts in answer.topics():
        for k, text in enumerate(texts):
            grid.add_row(title if k == 0 else "", Text(report.clean(text)))
    return Group(Text(report.clean(head), style="bold green"), "", grid)


def path(answer: IkPath, degrees: bool = False) -> RenderableType:
    """The sentence of a path, and the range of each coordinate on it, with the largest step between
    two targets.
    """
    system = answer.system
    style = "bold green" if answer else "bold yellow" if answer.success.all() else "bold red"
    shown: list[RenderableType] = [Text(report.clean(answer.status), style=style)]
    if answer.success.any():
        q = as_json.in_degrees(answer.q, system.coordinate_names, units(system), degrees)
        steps = np.abs(np.diff(q, axis=0))
        lines: list[tuple[Any, ...]] = []
        for i, c in enumerate(as_json.coordinates(system, degrees)):
            most = np.nanmax(steps[:, i]) if np.isfinite(steps[:, i]).any() else 0.0
            values = (np.nanmin(q[:, i]), np.nanmax(q[:, i]), most)
            lines.append(
                (
                    c["name"],
                    *(report.number(x, 4 if c["unit"] == "deg" else 6) for x in values),
                    c["unit"],
                )
            )
        shown += [
            "",
            report.table(("coordinate", ">least", ">largest", ">largest step", "=unit"), lines),
        ]
    return Group(*shown)
