"""Why a target was not reached, found out by asking again without the limits, without the orientation, by lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kempe.solvers.inverse import Task, chain_of, outside, run
from kempe.solvers.solution import BAD_INPUT, OUT_OF_REACH, OUT_OF_TIME, SOLVED, Solution
from kempe.solvers.targets import Z_AXIS, frame_of

RANK_TOLERANCE = 1e-9
"""Singular values below this fraction of the largest count as zero when the freedoms of a chain are counted."""


def sentence(solution: Solution, index: tuple[int, ...]) -> str:
    """The sentence for one target of a solution."""
    task = solution.task
    figures = (
        solution.code, solution.position_error, solution.orientation_error, solution.starts, solution.iterations
    )  # fmt: skip
    code, position, angle, starts, steps = (np.asarray(x)[index].item() for x in figures)
    if code == SOLVED:
        work = f"{_count(steps, 'step')}, {_count(starts, 'start')}" if starts else "analytically"
        return f"reached: {_errors(task, f'position error {position:.1e} m', angle)} ({work})"
    if code == BAD_INPUT:
        return "target or seed is not a finite pose"
    at = int(np.ravel_multi_index(index, np.shape(solution.code))) if index else 0
    target = task.targets[at : at + 1]
    near = f"the nearest configuration found misses it by {_errors(task, f'{position:.6g} m', angle)}"
    if code == OUT_OF_REACH:
        beyond = outside(task, target)[0]
        if task.system.dim == 2 and abs(target[0, 2, 3]) > task.tolerance[0]:
            return f"outside the plane of the system by {abs(target[0, 2, 3]):.6g} m; {near}"
        return f"outside the workspace by at least {beyond:.6g} m, by the lengths of the links; {near}"
    if code == OUT_OF_TIME:
        tried = f"{starts} of {_count(task.starts, 'start')}"
        return f"not reached within the time limit of {task.time_limit:g} s, after {tried}; {near}"
    reason = _limits(task, target) or _over_determined(task, target) or _why(task)
    return f"not reached after {_count(starts, 'start')}: {reason}; {near}"


def _errors(task: Task, position: str, angle: float) -> str:
    parts = [position] * bool(any(task.mask[:3])) + [f"{angle:.2g} rad"] * bool(any(task.mask[3:]))
    return ", ".join(parts)


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


def _solved(task: Task, target: np.ndarray, limits: np.ndarray | None = None) -> bool:
    return bool(run(task, task.chain.no_seed, 1, limits, target)[2][0, 0] == SOLVED)


def _over_determined(task: Task, target: np.ndarray) -> str:
    """Whether the task asks for more than the chain can do anywhere: rank of the Jacobian at random configurations."""
    from kempe.kinematics.forward import jacobian  # only here: a success needs no forward kernels

    rows = [i for i, used in enumerate(task.mask) if used]
    system = task.system
    J = jacobian(system, system.random(0, 16), task.frame, "body")
    J[:, 3:] = frame_of(np.array(task.axis)).T @ J[:, 3:]
    J = J[:, rows]
    if J.shape[-1] == 0:
        return f"no joint moves frame {task.frame!r}"
    values = np.linalg.svd(J, compute_uv=False)
    freedoms = int((values > RANK_TOLERANCE * values[:, :1]).sum(axis=1).max())
    wanted = 2 * bool(any(task.mask[:3])) + bool(any(task.mask[3:])) if system.dim == 2 else len(rows)
    if freedoms >= wanted:
        return ""
    text = f"the task has {wanted} equations, but the chain moves this frame in {freedoms} freedoms only"
    if task.name in ("pose", "position_axis"):
        position = replace(task, name="position", axis=Z_AXIS, chain=chain_of(system, task.frame))
        other = "can" if _solved(position, target) else "cannot"
        text += f" (its position alone {other} be reached)"
    return text


def _limits(task: Task, target: np.ndarray) -> str:
    """Which limits block the target, by solving without them."""
    chain, names = task.chain, task.system.velocity_names
    limited = np.flatnonzero(np.isfinite(chain.limits).any(axis=0))
    open_ = np.stack([np.full(len(chain.v_index), -np.inf), np.full(len(chain.v_index), np.inf)])
    if limited.size == 0 or not _solved(task, target, open_):
        return ""
    alone = []
    for i in limited:
        limits = chain.limits.copy()
        limits[:, i] = open_[:, i]
        if _solved(task, target, limits):
            alone.append(repr(names[chain.v_index[i]]))
    if alone:
        which = f"the limit of {' or of '.join(alone)}"
    else:
        which = "the limits of several joints together"
    return f"blocked by {which}; without limits it is reachable"


def _why(task: Task) -> str:
    if not any(task.mask[:3]):
        return "the orientation seems out of reach"
    lengths = "the target seems outside the workspace"
    return f"{lengths}, or not reachable with this orientation" if any(task.mask[3:]) else lengths
