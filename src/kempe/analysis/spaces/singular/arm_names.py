"""Names of the singular configurations of six-joint arms: those on the border of which branches."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.model.kept import kept
from kempe.solvers.analytic.ik_analytic import plan_of
from kempe.solvers.analytic.plans.branch_names import Kind, branch_names, kind_of
from kempe.solvers.analytic.plans.chain_lines import Lines
from kempe.solvers.common.targets import Z_AXIS
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

BORDER = " singular"


def names_of(system: System, frame: str | None, q: Array) -> list[str]:
    """For each configuration (k, nq) "shoulder", "elbow", "wrist", or several of them, or "" where
    there is no name.
    """
    named = None if frame is None else _named(system, frame)
    if named is None or not len(q):
        return [""] * len(q)
    kind, lines = named
    theta = lines.theta(q[:, lines.q_index])
    found = branch_names(kind, lines, theta, np.ones(len(q), dtype=bool))
    return [
        " and ".join(w.removesuffix(BORDER) for w in name.split(", ") if w.endswith(BORDER))
        for name in found
    ]


@kept
def _named(system: System, frame: str) -> tuple[Kind, Lines] | None:
    """The kind of arm and its lines, None where its branches have no names."""
    plan = plan_of(system, frame, "pose", Z_AXIS)
    if isinstance(plan, str):
        return None
    kind = kind_of(plan, system.dim == 2)
    return None if kind is None else (kind, plan.lines)
