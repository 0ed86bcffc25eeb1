"""What `assemble` takes besides values: a branch by the signs of its dyads, a tolerance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.budget import Budget
from kempe.reals import plain
from kempe.solvers.assembly.assembled import Assembly
from kempe.solvers.assembly.assembly import LOOSEST, TOLERANCE, Assembler
from kempe.solvers.assembly.ideal import one_number, within
from kempe.solvers.common.problem import Choice, Solver, choose, chosen_by, takes_all
from kempe.solvers.dyads.dyads import closed_form, on_branch
from kempe.status import Status, member

if TYPE_CHECKING:
    from kempe.model.system import System

ONCE = Budget(starts=1)


def _no_signs(one_sided: bool, signs: bool) -> str | None:
    return None if signs else "no branch is named by signs"


def _no_bounds(one_sided: bool, signs: bool) -> str | None:
    return None if one_sided else "the system has no one-sided constraints"


def allowing(system: System, tolerance: float | str) -> tuple[System, float]:
    """The system to close within a tolerance, and the largest residual of a success.

    Where another mechanism is nearest, it closes exactly; the given one has what is open for its residual.
    """
    found = within(system, tolerance)
    if found is not None:
        return found.system, TOLERANCE
    return system, TOLERANCE if isinstance(tolerance, str) else min(float(one_number(tolerance)), LOOSEST)


def on_named_branch(bound: Assembler, given: Mapping[str, Any], near: Any, branch: str, limits: bool) -> Assembly:
    """The answer on a branch named by the signs of its dyads: closed form, polished and checked."""
    system = bound.system
    start = on_branch(system, given, branch, near)
    answer = bound._ask(given, start, limits=limits, budget=ONCE)
    plan: Any = closed_form(system, tuple(bound.sources))
    requested, found = plan.branch_of(start), plan.branch_of(answer.q)
    strayed = np.any((found != requested) & (requested != 0) & (found != 0), axis=-1) & (answer.code == Status.SOLVED)
    if np.any(strayed):
        code = np.where(strayed, Status.OTHER_BRANCH, answer.code)
        answer = replace(answer, success=plain(code == Status.SOLVED), code=member(code))
    return chosen_by(answer, chosen(bound.one_sided is not None, True))


SOLVERS = (
    Solver("dyads", "closed form on the branch with these signs, then least squares", _no_signs, on_named_branch),
    Solver("active set", "damped least squares in which bounds are taken up and released", _no_bounds, Assembler._ask),
    Solver("least squares", "damped least squares of the closure equations, with steps of minimum norm",
           takes_all, Assembler._ask),
)  # fmt: skip
"""Who answers for one closed configuration."""


def chosen(one_sided: bool, signs: bool = False) -> Choice:
    """Who answers for a system with or without one-sided constraints, a branch named by signs or not."""
    return choose(SOLVERS, one_sided, signs)[1]
