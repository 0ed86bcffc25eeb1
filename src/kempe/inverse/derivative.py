"""Derivatives of answers of `ik` with respect to targets, and to the goals of tasks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe import spatial
from kempe.answers.targets import Z_AXIS, make_rotations_along
from kempe.budget import check_for_stop
from kempe.equations.task_functions import REAL_STEP
from kempe.equations.tasks import Goal
from kempe.errors import InputError, UnsupportedError
from kempe.forward.fk import fk, jacobian
from kempe.inverse.answer import Reached, Solution
from kempe.kernels.base.search_layout import AHEAD, NOTHING
from kempe.numerics.rank import TINY, Level, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.inverse.chain.problem import FrameProblem
    from kempe.inverse.tasks.demands import Demands

AT_LIMIT = 1e-9
"""How near to a limit a coordinate is at it."""


PIECE = 512
"""Configurations that are differentiated together: their matrices stay in the cache."""
CLEAR = 1e-3
"""Part of its length that the last independent row of a Jacobian has at least where its rank needs no
singular values."""


def compute_derivative(solution: Solution) -> Array:
    """Compute dq (..., nv, 6) for a twist [linear; angular] of the target; NaN where not reached.

    In ground axes, at the target's origin.

    By the implicit function theorem, the pseudoinverse of the rows of the Jacobian that the task
    reads: least squares of the velocities where the chain has more freedoms than those. Coordinates
    at a limit stay, and have rows of zeros, where the others span the same motions. Errors:
    `InputError` where a single target was not reached.
    """
    problem = solution.problem
    good = np.asarray(solution.success)
    if not good.ndim and not good:
        raise InputError(f"the target was not reached, so q does not follow it: {solution.status}")
    nv = problem.system.nv
    out = np.full((good.size, nv, 6), np.nan)
    rows = np.flatnonzero(good)
    q = solution.q.reshape(good.size, -1)
    for k in range(0, len(rows), PIECE):
        check_for_stop()
        some = rows[k : k + PIECE]
        out[some] = _differentiate_configurations(problem, q[some])
    return out.reshape(*good.shape, nv, 6)


def _differentiate_configurations(problem: FrameProblem, q: Array) -> Array:
    """Compute dq (m, nv, 6) at configurations (m, nq) that reach their targets."""
    system = problem.system
    chain = problem.chain
    J = jacobian(system, q, problem.frame, threads=1)
    J = np.ascontiguousarray(J.transpose(1, 2, 0)[:, chain.v_index])
    # what has no room moves nothing
    J *= (system.upper > system.lower)[chain.v_index, None]
    mask = np.array(problem.mask, dtype=bool)
    # the rows that count are named in the axes of the tip
    split = any(part.any() and not part.all() for part in mask.reshape(2, 3))
    R = np.eye(3)[None]
    if split:
        R = fk(system, q, problem.frame, threads=1)[:, :3, :3]
        if problem.axis != Z_AXIS:
            R = R @ make_rotations_along(np.array(problem.axis))
        J = np.concatenate([np.einsum("mji,jnm->inm", R, part) for part in (J[:3], J[3:])])
    J = J[mask]
    x = np.full((len(q), system.nv), np.nan)
    v = system.structure.layout.vector_v
    x[:, v] = q[:, system.structure.layout.vector_q]
    held = ((x <= system.lower + AT_LIMIT) | (x >= system.upper - AT_LIMIT))[:, chain.v_index].T
    inverse = np.zeros((len(J), *J.shape[1:]))
    moves = J.any(axis=(1, 2))
    inverse[moves], clear = _invert_independent_rows(np.where(held, 0.0, J[moves]))
    if not clear.all():
        left = np.flatnonzero(~clear)
        inverse[:, :, left] = _invert_singular_rows(J[:, :, left], held[:, left])
    made = np.zeros((len(q), len(chain.v_index), 6))
    made[:, :, mask] = inverse.transpose(2, 1, 0)
    if split:
        made = np.concatenate(
            [part @ np.swapaxes(R, 1, 2) for part in (made[..., :3], made[..., 3:])], axis=-1
        )
    out = np.zeros((len(q), system.nv, 6))
    out[:, chain.v_index] = made
    return out


def _invert_independent_rows(A: Array) -> tuple[Array, np.ndarray]:
    """Compute transposed pseudo-inverses (k, n, m) of matrices (k, n, m), the last axis their number.

    Also return for which of them (m,) the rows are clearly independent; the others are not inverted.

    By the modified Gram-Schmidt method: A^T = Q R, and the pseudo-inverse is Q R^-T. Source: Golub,
    Van Loan, *Matrix Computations*, 4th edition, 2013, section 5.2.8.
    """
    k, n, m = A.shape
    Q = A.copy()
    R = np.zeros((k, k, m))
    least = np.full(m, np.inf)
    size = np.sqrt(np.einsum("inm,inm->im", A, A).max(axis=0, initial=0.0))
    for i in range(k):
        length = np.sqrt(np.einsum("nm,nm->m", Q[i], Q[i]))
        least = np.minimum(least, length)
        R[i, i] = np.maximum(length, TINY)
        Q[i] /= R[i, i]
        R[i, i + 1 :] = np.einsum("nm,jnm->jm", Q[i], Q[i + 1 :])
        Q[i + 1 :] -= R[i, i + 1 :, None] * Q[i]
    for i in reversed(range(k)):
        Q[i] /= R[i, i]
        Q[:i] -= R[:i, i, None] * Q[i]
    return Q, (least > CLEAR * size) & (k <= n)


def _invert_singular_rows(J: Array, held: np.ndarray) -> Array:
    """Compute transposed pseudo-inverses (k, n, m) of Jacobians (k, n, m) of any rank.

    Coordinates `held` (n, m) stay where the others span the same motions.
    """
    A = np.moveaxis(J, -1, 0)
    free = np.where(held.T[:, None], 0.0, A)
    whole = Spectrum(A)
    rank = Spectrum(free, whole.largest).compute_ranks(Level.CLOSED)
    stay = (rank == whole.compute_ranks(Level.CLOSED))[:, None, None]
    inverse = Spectrum(np.where(stay, free, A)).compute_pseudo_inverse(Level.ROUNDING)
    return inverse.transpose(2, 1, 0)


# ---- answers to several tasks, by the goals of the tasks

AT_BOUND = 2e-6
"""How near to its bound an inequality holds the answer there, in radians and characteristic
lengths."""


class _DerivativeRows(NamedTuple):
    """Equations (..., m) that hold, weighted terms with least squares, and their Jacobians."""

    held: Array
    H: Array
    soft: Array
    S: Array


def compute_task_derivatives(answer: Reached) -> dict[str, Array]:
    """Compute dq (..., nv, k) for motions of each task's goal, by label; NaN where not reached.

    The first six columns, of a task whose goal is placed, are for the twist [linear; angular] of
    the goal, at its origin, in ground axes or those of the frame that it hangs on; one column for
    each number of the goal follows (radius, distances, values of coordinates; three for a
    quaternion, about its own axes). By the implicit function theorem for the conditions of Karush,
    Kuhn and Tucker: hard tasks, loops and relations stay met, inequalities at their bound and
    coordinates at a limit stay there (these where the others can do without them); soft tasks, or
    what was preferred, stay least, and what is then free moves least, in radians and characteristic
    lengths. Derivatives by goals, and second ones, are central differences. Errors: `InputError`
    where a single problem was not solved, `UnsupportedError` for soft tasks of several priorities
    and functions that are preferred.
    """
    problem = answer.problem
    good = np.asarray(answer.success)
    if not good.ndim and not good:
        raise InputError(
            f"the tasks do not hold, so q does not follow their goals: {answer.status}"
        )
    soft = {t.priority for t in problem.tasks if t.weight is not None}
    chosen = problem.mode not in (NOTHING, AHEAD)
    if len(soft) + (problem.mode != NOTHING) > 1 or chosen:
        raise UnsupportedError(
            "derivative is for hard tasks with soft ones of one priority at most, or with prefer "
            "'nearest' or 'mid' in place of these"
        )
    if not good.ndim:
        return _differentiate_answer(problem, answer.q)
    rows = [
        _differentiate_answer(problem.select_row(i), q) if fine else None
        for i, (fine, q) in enumerate(
            zip(good.ravel(), answer.q.reshape(-1, answer.q.shape[-1]), strict=True)
        )
    ]
    none: dict[str, Array] = {}
    known = next((r for r in rows if r is not None), none)
    nothing = {label: np.full(x.shape, math.nan) for label, x in known.items()}
    each = [nothing if r is None else r for r in rows]
    return {
        k: np.stack([r[k] for r in each]).reshape(*good.shape, *x.shape) for k, x in known.items()
    }


def _differentiate_answer(problem: Demands, q: Array) -> dict[str, Array]:
    """Compute the derivatives of one answer."""
    system = problem.system
    scale = problem.packed.scale
    counts = _find_active_rows(problem, q)
    at = _compute_rows(problem, q, problem.pins, counts)
    g = at.S.T @ at.soft
    multipliers = Spectrum(at.H.T).solve_least_squares(-g, Level.CLOSED)

    def compute_gradients(rows: _DerivativeRows) -> Array:
        """Gradients (n, nv) of the Lagrangian."""
        return np.einsum("nij,ni->nj", rows.S, rows.soft) + np.einsum(
            "nij,i->nj", rows.H, multipliers
        )

    steps = REAL_STEP * np.concatenate([np.eye(system.nv), -np.eye(system.nv)]) * scale
    near = compute_gradients(
        _compute_rows(
            problem, system.structure.layout.integrate_velocity(q, steps), problem.pins, counts
        )
    )
    second = (near[: system.nv] - near[system.nv :]) / (2.0 * REAL_STEP)
    second = 0.5 * (second + second.T)
    free = _find_free_coordinates(problem, q, at.H)
    n = int(free.sum())
    m = len(at.H)
    K = np.zeros((n + m, n + m))
    K[:n, :n] = second[np.ix_(free, free)]
    K[n:, :n] = at.H[:, free]
    K[:n, n:] = at.H[:, free].T
    inverse = Spectrum(K).compute_pseudo_inverse(Level.CLOSED)[:n]
    out: dict[str, Array] = {}
    for k, task in enumerate(problem.tasks):
        moved = [
            problem.packed.pack_pins([*problem.goals[:k], goal, *problem.goals[k + 1 :]])
            for goal in _perturb_goal(problem.goals[k])
        ]
        dq = np.zeros((system.nv, len(moved) // 2))
        if moved:
            pins = np.concatenate(moved)
            rows = _compute_rows(problem, np.broadcast_to(q, (len(pins), len(q))), pins, counts)
            change = np.concatenate([compute_gradients(rows)[:, free], rows.held], axis=1)
            rate = (change[0::2] - change[1::2]) / (2.0 * REAL_STEP)
            dq[free] = scale[free, None] * -(inverse @ rate.T)
        out[task.label] = dq
    return out


def _find_active_rows(problem: Demands, q: Array) -> tuple[np.ndarray, np.ndarray, Array]:
    """Find the rows (m,) of tasks that hold, those that are minimised, and roots of weights."""
    packed = problem.packed
    error, _ = packed.evaluate_tasks(q, problem.pins)
    low, high = packed.row_bounds
    levels, strengths, *_ = problem.levels
    counts = [len(t.row_names) for t in packed.loops.ties]
    own = packed.rows >= 0
    level, hard = (np.repeat(x, counts)[own] for x in levels.reshape(2, -1))
    at_bound = (low == high) | (np.minimum(error - low, high - error) < AT_BOUND)
    return (
        (level > 0) & (hard > 0) & at_bound,
        (level > 0) & (hard == 0),
        np.repeat(np.sqrt(strengths[:, 0]), counts)[own],
    )


def _compute_rows(
    problem: Demands, q: Array, pins: Array, counts: tuple[np.ndarray, np.ndarray, Array]
) -> _DerivativeRows:
    """Compute equations and weighted terms at q (..., nq), for pins (n or 1, k)."""
    packed = problem.packed
    (held, soft, weight) = counts
    error, J = packed.evaluate_tasks(q, pins)
    closed, C = packed.evaluate_tasks(q, pins, closures=True)
    low, high = packed.row_bounds
    miss = (error - np.clip(error, low, high))[..., soft] * weight[soft]
    S = J[..., soft, :] * (weight[soft, None] * ((low == high)[soft] | (miss != 0.0))[..., None])
    if problem.mode == AHEAD and problem.aim is not None:
        miss = (
            problem.system.structure.layout.compute_difference(
                np.broadcast_to(problem.aim[0], q.shape), q
            )
            / packed.scale
        )
        S = np.broadcast_to(
            np.eye(len(packed.scale)), (*q.shape[:-1], len(packed.scale), len(packed.scale))
        )
    return _DerivativeRows(
        np.concatenate([error[..., held], closed], axis=-1),
        np.concatenate([J[..., held, :], C], axis=-2),
        miss,
        S,
    )


def _find_free_coordinates(problem: Demands, q: Array, H: Array) -> np.ndarray:
    """Find the velocity coordinates (nv,) that move.

    Those at a limit rest, unless the others cannot do without them.
    """
    system = problem.system
    v = problem.system.structure.layout.vector_v
    x = q[system.structure.layout.vector_q]
    free = np.ones(system.nv, dtype=bool)
    if problem.limits:
        free[v] = (x > system.lower[v] + AT_LIMIT) & (x < system.upper[v] - AT_LIMIT)
    if free.all() or not len(H):
        return free
    whole = Spectrum(H)
    left = Spectrum(H[:, free], whole.largest)
    enough = left.compute_rank(Level.CLOSED) == whole.compute_rank(Level.CLOSED)
    return free if enough else np.ones(system.nv, dtype=bool)


def _perturb_goal(goal: Goal) -> list[Goal]:
    """Move the goal by a small step, forth and back, along each of its freedoms."""
    out: list[Goal] = []
    pose = goal.pose
    if pose is not None:
        for twist in REAL_STEP * np.eye(6):
            out += [
                goal._replace(pose=_move_pose(pose, pose[:3, 3], sign * twist))
                for sign in (1.0, -1.0)
            ]
    for name, number in goal.numbers.items():
        for step in REAL_STEP * _list_goal_freedoms(number):
            out += [
                goal._replace(numbers=goal.numbers | {name: number + sign * step})
                for sign in (1.0, -1.0)
            ]
    return out


def _move_pose(X: Array, origin: Array, twist: Array) -> Array:
    """Move the pose X (4, 4) by a small twist about a point."""
    R = spatial.exp_so3(twist[3:])
    return spatial.pose(R @ X[:3, :3], origin + R @ (X[:3, 3] - origin) + twist[:3])


def _list_goal_freedoms(number: Array) -> Array:
    """List the ways in which the numbers (k,) of a goal can change.

    Each changes alone; a quaternion turns about its own axes.
    """
    if len(number) != 4:
        return np.eye(len(number))
    w, x, y, z = number
    return 0.5 * np.array([[-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]])
