"""The inverse geometric model, numerically: a configuration in which a frame of a tree reaches a target."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.errors import InputError, NoSolutionError, UnsupportedError
from kempe.kernels import solve
from kempe.kernels.layout import HEADER, KIND, MULTIPLIER, ROW_FLOATS, ROW_INTS, SLIDE, TURN, V_INDEX
from kempe.kinematics.configuration import as_q
from kempe.kinematics.parallel import over_chunks
from kempe.model.gauge import regauge
from kempe.model.table import local_chain
from kempe.solvers.arguments import seed_number, start_count, tolerances
from kempe.solvers.solution import BAD_INPUT, NOT_FOUND, OUT_OF_REACH, SOLVED, Solution
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

STARTS = 250
"""Starts before a target is given up. Most succeed with the first; one in a hundred thousand needs more than 100."""
ITERATIONS = 20
"""Steps of one start; those that converge need 5 to 9."""
TOLERANCE = (1e-6, 1e-6)
"""Largest position error [m] and rotation angle [rad] of a success."""
CHUNK, SERIAL_BELOW = 64, 256
POSE, POSITION = (1, 1, 1, 1, 1, 1), (1, 1, 1, 0, 0, 0)


@dataclass(frozen=True, eq=False)
class Chain:
    """The chain that moves one frame, packed for the kernel with coordinates of its own.

    `q_index` and `v_index` say which entries of the system's `q` and velocities they are.
    """

    ints: np.ndarray
    floats: np.ndarray
    q_index: np.ndarray
    v_index: np.ndarray
    limits: np.ndarray
    circular: np.ndarray
    base: Array
    """Where (1, nq) coordinates rest that no seed names: neutral, inside the limits."""
    no_seed: Array
    bounds: tuple[tuple[Array, float, float], ...]
    """Reach bounds: the frame is never farther than the second number, nor nearer than the third, from the point."""


@dataclass(frozen=True, eq=False)
class Task:
    """What was asked of the solver: kept with the answer, so that it can say why it failed."""

    system: System
    frame: str
    targets: Array = field(repr=False)
    mask: tuple[int, ...]
    tolerance: tuple[float, float]
    starts: int
    rng: int
    chain: Chain = field(repr=False)

    @property
    def position_only(self) -> bool:
        """Whether only the position matters."""
        return self.mask == POSITION


def ik(
    system: System, target: ArrayLike, frame: FrameLike, seed: Any = None, *, position_only: bool = False,
    tolerance: tuple[float, float] = TOLERANCE, starts: int = STARTS, rng: int | np.random.Generator = 0,
    threads: int | None = None, throw: bool = False, method: str = "numeric",
) -> Solution:  # fmt: skip
    """A configuration in which `frame` reaches `target` (the inverse geometric model), always inside the limits.

    `target` is a pose (..., 4, 4) in the ground frame (in planar systems also (..., 3, 3)), or a position (..., 3)
    (in planar systems also (..., 2)); with `position_only` the orientation of a pose is ignored. `seed` (nq,) or
    (..., nq), or a dict by name, is the first start; what the chain does not move keeps its value there, else the
    neutral one, inside the limits. `tolerance` is the largest position error [m] and rotation angle [rad]. Up to
    `starts` starts are tried, drawn from `rng`: the same arguments give the same answer, whatever the `threads`.

    The answer says by `success` and `status` whether it was reached and if not, why; `throw=True` raises
    `NoSolutionError` instead. A NaN in a single target is an `InputError`, in a batch it gives a NaN row. Systems whose
    loops or relations involve the frame's joints are refused (`UnsupportedError`).

    `method`: "numeric", damped least squares with an active set of limits and restarts (Sugihara, 2011; Chan and
    Lawrence, 1988); "analytic", of all solutions that `ik_all` finds the one nearest to `seed`; "auto", that where the
    chain allows it, else numeric. Targets that have no analytic solution inside the limits get the numeric answer.
    """
    name = system.frame_name(frame)
    chain = chain_of(system, name)
    targets, lead, is_position = parse_targets(system, target)
    mask = POSITION if position_only or is_position else POSE
    if mask is POSE and system.table.at[name][2]:
        mask = _of_particle(targets, name)
    base, seeds = _seeds(system, chain, seed, lead)
    task = Task(system, name, targets, mask, tolerances(tolerance), start_count(starts), seed_number(rng), chain)
    plan = None
    if method != "numeric":
        from kempe.solvers.analytic import hand_over

        plan = hand_over.plan_of(task, method)
    if plan is None:
        q, residual, info = run(task, seeds, threads)
    else:
        q, residual, info = hand_over.answer(task, plan, base, seeds, threads)
    full = np.empty((len(targets), system.nq))
    full[:] = base
    full[:, chain.q_index] = q
    code = info[:, 0]
    if code.any():
        _look_closer(task, code)
        full[code == BAD_INPUT] = math.nan
    if not lead and code[0] == BAD_INPUT:
        _refuse_target(targets[0], base[0])
    solution = _answer(task, full, code, residual, info, lead)
    if throw and not solution:
        raise NoSolutionError(solution)
    return solution


def run(
    task: Task, seeds: Array, threads: int | None = 1, limits: Array | None = None, targets: Array | None = None
) -> tuple[Array, Array, np.ndarray]:
    """Chain configurations, residuals (N, 2) and (status, steps, starts) of all targets, in fixed chunks."""
    chain = task.chain
    goals = task.targets if targets is None else targets
    n = len(goals)
    q, residual, info = np.empty((n, len(chain.q_index))), np.empty((n, 2)), np.empty((n, 3), dtype=np.int64)
    bounds = chain.limits if limits is None else limits
    mask = np.array(task.mask, dtype=np.int64)

    def work(i: int, j: int) -> int:
        first = seeds[i:j] if len(seeds) > 1 else seeds
        return solve.ik(
            chain.ints, chain.floats, bounds, chain.circular, mask, goals[i:j], first, task.rng, i,
            task.starts, ITERATIONS, task.tolerance[0], task.tolerance[1], 0.0, q[i:j], residual[i:j], info[i:j],
        )  # fmt: skip

    over_chunks(work, n, CHUNK, threads, SERIAL_BELOW)
    return q, residual, info


def chain_of(system: System, name: str) -> Chain:
    """The packed chain of a frame, made once. Errors: `UnsupportedError` where loops or relations move it."""
    chain = system._queries.get(("ik", name))
    if chain is None:
        table, q_index, v_index = local_chain(system.table, name)
        used = {system.velocity_names[i] for i in v_index}
        _refuse_closed(system, name, used)
        packed = table.pack([name], table.path(name))
        limits = np.ascontiguousarray(system.limits[v_index].T)
        ints, floats = regauge(*packed)
        circular = np.zeros(len(v_index), dtype=np.int64)
        wide = np.subtract(limits[1], limits[0]) >= 2.0 * math.pi
        for iv in range(len(v_index)):
            rows = table.multiplier[table.iv == iv]
            circular[iv] = wide[iv] and len(rows) == 1 and abs(rows[0]) == 1.0 and table.kind[table.iv == iv][0] == TURN
        bounds = tuple(_reach(*arrays, limits) for arrays in (packed, (ints, floats)))
        base, no_seed = _inside(system, system.neutral[None]), np.empty((1, 0, len(q_index)))
        chain = Chain(ints, floats, q_index, v_index, limits, circular, base, no_seed, bounds)
        system._queries[("ik", name)] = chain
    return chain


def _refuse_closed(system: System, name: str, used: set[str]) -> None:
    for closure in system.closures:
        if used & loop_coordinates(system, closure):
            raise UnsupportedError(
                f"frame {name!r} moves with the loop that joint {closure!r} closes: `ik` is for open chains; "
                f"assemble({{{name!r}: target}}) closes the loops with the frame in place"
            )
    for relation in system.relations:
        if used & {relation.of, *relation.sources}:
            raise UnsupportedError(
                f"frame {name!r} moves with coordinate {relation.of!r}, which follows several others: `ik` is for "
                f"open chains; assemble({{{name!r}: target}}) keeps such relations"
            )


def loop_coordinates(system: System, closure: str) -> set[str]:
    """Velocity coordinates of the joints of the loop that a left-out joint closes, its own included."""
    number = {b: i for i, b in enumerate(system.body_names)}
    joint = system.joints[closure]
    ways: list[set[int]] = []
    for body in (joint.parent, joint.child):
        i, way = number[body], set()
        while i:
            way.add(i)
            i = system.parent[i - 1]
        ways.append(way)
    joints = {closure} | {system.parent_joints[i - 1] for i in ways[0] ^ ways[1]}
    names: set[str] = set()
    for j in joints:
        for c in system.coordinates_of_joint(j):
            follower = system.couplings.get(c)
            names.add(c if follower is None else follower.source or c)
        names |= {v for v in system.velocity_names if v.startswith(f"{j}.")}
    return names


def _reach(ints: np.ndarray, floats: np.ndarray, limits: Array) -> tuple[Array, float, float]:
    """A point and the largest and smallest distance that the tip can have from it, by lengths alone."""
    n = int(ints[0])
    lengths = []
    for k in range(1, n + 1):  # the last one is the output's placement
        at = ROW_FLOATS * k
        lengths.append(float(np.linalg.norm(floats[[at + 3, at + 7, at + 11]])))
    for row in range(n):
        at = HEADER + ROW_INTS * row
        kind, iv, m = ints[at + KIND], ints[at + V_INDEX], floats[ROW_FLOATS * row + MULTIPLIER]
        if kind == SLIDE:
            far = float(np.max(np.abs(m * limits[:, iv])))
            lengths.append(far)
            if not math.isfinite(far):
                return np.zeros(3), math.inf, 0.0
    start = floats[[3, 7, 11]]
    slides = np.any(ints[HEADER + KIND : HEADER + ROW_INTS * n : ROW_INTS] == SLIDE)
    total = sum(lengths)
    longest = 0.0 if slides or not lengths else max(lengths)
    return start, total, max(0.0, 2.0 * longest - total)


def _look_closer(task: Task, code: np.ndarray) -> None:
    """Tell, in place, targets that lengths alone put out of reach from those that were not found."""
    failed = np.flatnonzero(code == NOT_FOUND)
    code[failed[outside(task, task.targets[failed]) > task.tolerance[0]]] = OUT_OF_REACH


def outside(task: Task, targets: Array) -> Array:
    """How far (N,) targets are outside the reach bounds, in metres: a proven lower bound of the position error."""
    out = np.abs(targets[:, 2, 3]) if task.system.dim == 2 else np.zeros(len(targets))
    for point, largest, smallest in task.chain.bounds:
        distance = np.linalg.norm(targets[:, :3, 3] - point, axis=-1)
        out = np.maximum(out, np.maximum(distance - largest, smallest - distance))
    return out


def parse_targets(system: System, target: Any) -> tuple[Array, tuple[int, ...], bool]:
    """Targets (N, 4, 4), their leading shape, and whether they are positions."""
    if target.__class__ is np.ndarray and target.dtype == np.float64:
        array = target
    else:
        try:
            given = np.asarray(target)
            if given.dtype.kind == "c":
                raise TypeError
            array = np.asarray(given, dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"target is {type(target).__name__}; it must be an array of real numbers") from None
    planar = system.dim == 2
    is_pose = array.ndim >= 2 and array.shape[-2:] == (4, 4)
    if planar and array.ndim >= 2 and array.shape[-2:] == (3, 3) and np.all(array[..., 2, :] == [0.0, 0.0, 1.0]):
        flat = array
        array = np.zeros((*flat.shape[:-2], 4, 4))
        array[..., :2, :2], array[..., :2, 3], array[..., 2, 2], array[..., 3, 3] = (
            flat[..., :2, :2], flat[..., :2, 2], 1.0, 1.0)  # fmt: skip
        is_pose = True
    if is_pose:
        lead = array.shape[:-2]
        out = array.reshape(math.prod(lead), 4, 4)
        bad = np.any(out[:, 3] != [0.0, 0.0, 0.0, 1.0], axis=-1)  # a transposed pose would pass for another one
        if bad.any():
            out = np.where(bad[:, None, None], math.nan, out)
            if not lead and np.isfinite(array).all():
                raise InputError(f"target is not a pose: its last row is {array[3].tolist()}; it must be 0 0 0 1")
        return np.ascontiguousarray(out), lead, False
    if array.ndim and (array.shape[-1] == 3 or (planar and array.shape[-1] == 2)):
        lead = array.shape[:-1]
        out = np.zeros((math.prod(lead), 4, 4))
        out[:] = np.eye(4)
        out[:, : array.shape[-1], 3] = array.reshape(len(out), array.shape[-1])
        return out, lead, True
    in_plane = ", or (..., 3, 3) or (..., 2) in the plane" if planar else ""
    allowed = f"a pose (..., 4, 4) or a position (..., 3){in_plane}"
    raise InputError(f"target has shape {array.shape}; it must be {allowed}")


def _of_particle(targets: Array, name: str) -> tuple[int, ...]:
    """What of a pose counts for a particle: its position. Errors: `InputError` for a target that turns it."""
    turned = np.abs(targets[:, :3, :3] - np.eye(3)).max(axis=(1, 2), initial=0.0) > TOLERANCE[1]  # a NaN stays one
    if turned.any():
        raise InputError(f"{name!r} is a particle, which has no orientation; give a position (..., 3) as target")
    return POSITION


def _seeds(system: System, chain: Chain, seed: Any, lead: tuple[int, ...]) -> tuple[Array, Array]:
    """Configurations (1 or N, nq) to start from, and the chain's part of them as (1 or N, K, nq) for the kernel."""
    if seed is None:
        return chain.base, chain.no_seed
    base = as_q(system, seed)
    if base.ndim > 1 and base.shape[:-1] != lead:
        each = f" or {(*lead, system.nq)}" if lead else ""
        raise InputError(f"seed has shape {base.shape}; it must be ({system.nq},){each}")
    base = np.array(base.reshape(math.prod(base.shape[:-1]), system.nq))
    if not lead and not np.isfinite(base).all():
        raise InputError("seed has entries that are not finite")
    base = _inside(system, base)
    return base, np.ascontiguousarray(base[:, None, chain.q_index])


def _inside(system: System, q: Array) -> Array:
    """The configurations (N, nq) with every limited coordinate brought inside its limits, in place."""
    at_q, at_v = system.layout.vector_q, system.layout.vector_v
    q[:, at_q] = np.clip(q[:, at_q], system.lower[at_v], system.upper[at_v])
    return q


def _refuse_target(target: Array, seed: Array) -> None:
    if not np.isfinite(target).all():
        raise InputError("target has entries that are not finite")
    if not np.isfinite(seed).all():
        raise InputError("seed has entries that are not finite")
    raise InputError("target is not a pose: its rotation part must be orthonormal with determinant +1")


def _answer(
    task: Task, q: Array, code: np.ndarray, residual: Array, info: np.ndarray, lead: tuple[int, ...]
) -> Solution:  # fmt: skip
    columns = (code == SOLVED, code, residual[:, 0], residual[:, 1], info[:, 1], info[:, 2])
    fields = [x.reshape(lead) if lead else x[0].item() for x in columns]
    success, code_, position, angle, steps, starts = fields
    return Solution(q.reshape(*lead, task.system.nq), success, code_, position, angle, steps, starts, task)
