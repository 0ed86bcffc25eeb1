"""Solutions without those that violate declared one-sided constraints."""

from __future__ import annotations

import numpy as np

from kempe.kernels.closed_form import analytic_layout as A
from kempe.kinematics.configuration import winding_angles
from kempe.kinematics.one_sided import one_sided_rows
from kempe.solvers.analytic.answers.solutions import Solutions
from kempe.solvers.analytic.answers.turns import packed
from kempe.words import joined


def obeying(solutions: Solutions) -> Solutions:
    """The solutions that hold the one-sided constraints of their system; the status says how many
    do not, and which.

    Coordinates that the chain does not have are where the solutions have them: near, or neutral.
    Where a constraint tells whole turns of one without limits apart, others of its turns may hold
    it: the answer is then not complete.
    """
    bounds = one_sided_rows(solutions.system)
    if not bounds.declared:
        return solutions
    used = solutions._used
    q = np.where(used[..., None], solutions._full(), solutions.system.neutral)
    beyond = used[..., None] & (bounds.beyond(q, declared=True) > 0.0)
    bad = np.any(beyond, axis=-1)
    if not bad.any():
        return solutions
    rows = solutions._rows.copy()
    rows[bad, -A.INFO + A.CODE] = A.UNUSED
    rows = packed(rows) if solutions.single else rows
    texts = np.empty(len(beyond), dtype=object)
    texts[:] = [bounds.left_out(each) for each in beyond]
    out = solutions._with(rows, solutions, texts)
    if names := _wound(solutions):
        dropped = bad.any(axis=-1)
        counts = solutions._counts.copy()
        counts[dropped, 1] += 1
        texts[dropped] += f", at other whole turns of {joined(list(map(repr, names)))} they may not"
        out._counts = counts
    return out


def _wound(solutions: Solutions) -> list[str]:
    """The coordinates of the chain without limits whose whole turns a constraint tells apart."""
    names = solutions.system.structure.velocity_names
    endless = winding_angles(solutions.system)
    return [names[int(v)] for v in solutions.plan.lines.v_index if endless[v]]
