"""What `ik` of tasks can make least in the freedoms that all tasks leave: functions of q, with
their gradient.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.errors import InputError
from kempe.kinematics.configuration import random
from kempe.kinematics.tasks.derivatives import REAL_STEP, checked_value, jacobian_of, way_of
from kempe.model.closures.callback import Callback
from kempe.singular_values import svd
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.solvers.tasks.demands import Demands

SMALL = 1e-24
"""Added to squared singular values, so that the logarithm of none is infinite."""


def least(problem: Demands, prefer: Any) -> Callback:
    """The function that is to be made least, as kernels call it: "manipulability", or of q. Errors:
    `InputError`.
    """
    if prefer == "manipulability":
        callback = Callback(
            problem.system, 1, _with_differences(problem, lambda q: -log_manipulability(problem, q))
        )
    else:
        callback = Callback(problem.system, 1, _of_user(problem, prefer))
    callback.scale = problem.packed.scale
    return callback.made_by(least, problem, prefer)


def log_manipulability(problem: Demands, q: Array) -> Array:
    """Logarithm (...) of the hard tasks' manipulability at q (..., nq): of sqrt(det(J J^T))
    (Yoshikawa, 1985).

    J is taken in the velocities that the loops leave. For tasks that are singular everywhere, of
    the part that is not.
    """
    packed = problem.packed
    hard = [i for i, t in enumerate(problem.tasks) if t.weight is None]
    J = packed.evaluate(q, problem.pins)[1][..., np.isin(packed.rows[packed.rows >= 0], hard), :]
    C = packed.evaluate(q, problem.pins, closures=True)[1]
    if C.shape[-2]:
        J = J - J @ np.linalg.pinv(C, rcond=1e-9) @ C
    s = svd(J, compute_uv=False)
    return 0.5 * np.sum(np.log(s * s + SMALL), axis=-1)


def _with_differences(
    problem: Demands, function: Callable[[Array], Array]
) -> Callable[[Array], tuple[Any, Array]]:
    """The function with its gradient by central differences, all of them in one batch."""
    system = problem.system
    steps = REAL_STEP * np.concatenate(
        [np.eye(system.nv), -np.eye(system.nv), np.zeros((1, system.nv))]
    )

    def work(q: Array) -> tuple[Any, Array]:
        f = function(system.structure.layout.integrate(q, steps))
        return f[-1:], ((f[: system.nv] - f[system.nv : -1]) / (2.0 * REAL_STEP))[None]

    return work


def _of_user(
    problem: Demands, function: Callable[[Array], Any]
) -> Callable[[Array], tuple[Any, Array]]:
    layout = problem.system.structure.layout
    q0 = random(problem.system, 0)
    if checked_value("prefer", function, q0).size != 1:
        raise InputError(
            "what is preferred must be one number: a function of q (nq,) to be made least"
        )
    how = way_of(function, layout, q0)
    return lambda q: (
        np.ravel(function(q)),
        jacobian_of(function, None, how, layout, q).reshape(1, -1),
    )
