"""Paths of configurations that follow targets, for people and for programs: as tables and data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from kempe.model.tree.coordinates import units
from kempe.views import facts, report

if TYPE_CHECKING:
    from kempe.solvers.paths.following import IkPath


def path(answer: IkPath, degrees: bool = False) -> RenderableType:
    """The sentence of a path, and the range of each coordinate on it, with the largest step between two targets."""
    system = answer.system
    style = "bold green" if answer else "bold yellow" if answer.success.all() else "bold red"
    shown: list[RenderableType] = [Text(report.clean(answer.status), style=style)]
    if answer.success.any():
        q = facts.in_degrees(answer.q, system.coordinate_names, units(system), degrees)
        steps = np.abs(np.diff(q, axis=0))
        lines: list[tuple[Any, ...]] = []
        for i, c in enumerate(facts.coordinates(system, degrees)):
            most = np.nanmax(steps[:, i]) if np.isfinite(steps[:, i]).any() else 0.0
            values = (np.nanmin(q[:, i]), np.nanmax(q[:, i]), most)
            lines.append((c["name"], *(report.number(x, 4 if c["unit"] == "deg" else 6) for x in values), c["unit"]))
        shown += ["", report.table(("coordinate", ">least", ">largest", ">largest step", "=unit"), lines)]
    return Group(*shown)
