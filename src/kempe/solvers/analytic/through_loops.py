"""All configurations in which a frame that moves with loops reaches a target: assembly modes with the frame known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.errors import InputError, UnsupportedError
from kempe.solvers.modes import Modes, assembly_modes
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

TASKS = ("pose", "position")
"""What of a target can be known of a frame."""


def all_modes(
    system: System, frame: str, targets: Array, lead: tuple[int, ...], task: str, near: Any, fixed: Mapping[str, Any],
    limits: bool,
) -> Modes:  # fmt: skip
    """The configurations that are found, those inside the limits first. Errors: `UnsupportedError`, `InputError`."""
    if task not in TASKS or lead != ():
        what = f"task {task!r}" if task not in TASKS else "more than one target"
        raise UnsupportedError(
            f"frame {frame!r} moves with loops: `ik_all` takes one pose or position there, not {what}; `ik` can"
        )
    if not np.isfinite(targets).all():
        raise InputError("target has entries that are not finite")
    X = targets[0] if task == "pose" else targets[0, : system.dim, 3]
    found = assembly_modes(system, {**fixed, frame: X}, near, limits=limits)
    order = np.argsort(~found.inside, kind="stable")
    return replace(
        found, q=found.q[order], branches=tuple(found.branches[i] for i in order),
        multiplicity=found.multiplicity[order], freedoms=found.freedoms[order], inside=found.inside[order],
    )  # fmt: skip
