"""All configurations in which a frame reaches a target that moves with loops, or with joints that
follow others.

They are the assembly modes with the frame known.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from kempe.budget import Budget, Usual
from kempe.errors import UnsupportedError
from kempe.solvers.common.problem import Problem
from kempe.solvers.modes.modes import Modes, assembly_modes

LOOPS = Usual("ik_all", threads=None, time_limit=30.0)
"""What is spent on one target."""

TASKS = ("pose", "position")
"""What of a target can be known of a frame."""


def all_modes(problem: Problem, moving: str = "loops") -> Modes:
    """The configurations that are found, those inside the limits first; the frame moves with what
    `moving` says.

    Errors: `UnsupportedError`.
    """
    system = problem.system
    frame = problem.frame
    (task, _) = problem.task
    targets = problem.targets
    if task not in TASKS or problem.lead != ():
        what = f"task {task!r}" if task not in TASKS else "more than one target"
        raise UnsupportedError(
            f"frame {frame!r} moves with {moving}: `ik_all` takes one pose or position there, not "
            f"{what}; `ik` can"
        )
    X = targets[0] if task == "pose" else targets[0, : system.dim, 3]
    limit = LOOPS.of(problem.budget).time_limit
    spend = Budget(time_limit=math.inf if limit is None else limit)
    known = {**problem.known, str(frame): X}
    found = assembly_modes(system, known, problem.start, limits=bool(problem.limits), budget=spend)
    order = np.argsort(~found.inside, kind="stable")
    return replace(
        found,
        q=found.q[order],
        branches=tuple(found.branches[int(i)] for i in order),
        multiplicity=found.multiplicity[order],
        freedoms=found.freedoms[order],
        inside=found.inside[order],
    )
