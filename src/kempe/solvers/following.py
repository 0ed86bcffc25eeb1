"""Paths of configurations that follow a sequence of targets without a jump, and where and why that cannot be."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.calls import brief, explained, explained_methods
from kempe.errors import InputError, UnsupportedError
from kempe.kernels.search_layout import BAD_INPUT
from kempe.kinematics.tabular import Tabular
from kempe.kinematics.task import refuse
from kempe.kinematics.tasks import Pose, Position
from kempe.reals import reals
from kempe.solvers.chain import inside
from kempe.solvers.clock import BROKEN_OFF, LONG, Budget, partial
from kempe.solvers.solution import SOLVED
from kempe.solvers.targets import parse_targets
from kempe.solvers.tasks import STARTS, Problem, judge, pose_problem
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

TOLERANCE = 1e-10
"""Largest error of the targets along a path, in metres and radians."""
DEPTH = 12
"""How often the way between two targets is halved before it counts as a jump."""
SMALL = 0.02
"""Steps so small, in radians and characteristic lengths, need no explanation: with square roots, 1 / 2^(DEPTH/2)."""
STRETCH = 2.0
"""How many times longer than its first order a step may be."""
ALIKE = 0.5
"""How much a step may differ from the one before, as a part of it, to count as going on."""
DAMPING = 1e-3
"""Singular values below it do not make the first order longer (Wampler, 1986)."""
SINGULAR = 0.05
"""Ratio of singular values at the end of a path below which it ends at a singularity; it falls with a square root."""
ROUNDING = 1e-12
"""How far outside its limits a coordinate may seem to be."""
TRIED = 16
"""Seeds that are tried where another start or a way on is looked for."""


@explained_methods
@dataclass(frozen=True, eq=False)
class IkPath(Tabular):
    """Configurations `q` (n, nq) that follow n targets, NaN where not `success` (n,).

    `jumps` are the targets that are reached, but not continuously from the one before; `status` says where and why the
    path jumps or stops. It is true where all targets are reached without a jump. Ctrl-C or the time limit
    leaves what was done (`interrupted`, `late`).
    """

    __repr__ = brief

    system: System
    q: Array
    success: np.ndarray
    jumps: tuple[int, ...]
    status: str
    interrupted: bool = False
    late: bool = False

    def __len__(self) -> int:
        return len(self.q)

    def table(self) -> tuple[list[str], Array]:
        """Names and columns (n, nq) for a file: the coordinates at each target, NaN where it is not reached."""
        return list(self.system.coordinate_names), self.q

    def __bool__(self) -> bool:
        return bool(np.all(self.success)) and not self.jumps

    def __str__(self) -> str:
        return self.status


@explained
def ik_path(
    system: System, targets: Any, frame: FrameLike | None = None, seed: Any = None, *, max_step: float = 0.5,
    restart: bool = False, branches: bool = False, tolerance: float | tuple[float, float] = TOLERANCE,
    starts: int = STARTS, rng: int | np.random.Generator = 0, time_limit: float | None = LONG,
    progress: Callable[[int], None] | None = None,
) -> IkPath:  # fmt: skip
    """Configurations in which a frame follows targets, each reached continuously from the one before.

    `targets` are poses (n, 4, 4) or positions (n, 3), in the plane also (n, 3, 3) or (n, 2); without a frame they are
    tasks of `kempe.tasks` whose goals have a leading axis (n). Limits, couplings and loops hold, too. The first target
    is reached from `seed` as `ik` does; from there on each step starts at its first order, the damped pseudoinverse
    times what is missing (Whitney, 1969). A step is taken where it is not much longer than that, nor than `max_step`
    in radians and characteristic lengths, or much like the one before; else the targets' way (linear, rotations by the
    exponential map) is halved.
    Where the smallest part of it cannot be gone, the path must jump: it stops, or, with `restart`, goes on from the
    nearest configuration found at the next target that can be reached. With `branches`, paths from several start
    configurations are tried, those of `ik_all` among them where it applies: the answer is the one that gets farthest,
    then the one with fewest jumps, then the shortest. `progress` is told how many targets are done.
    The `time_limit` [s] (600; None: none) is for the whole call; what was done by then is the answer.
    Errors: `InputError`, `UnknownNameError`.
    """
    if not 0.0 < max_step < math.inf:
        raise InputError(f"max_step is {max_step!r}; it must be a positive number")
    wanted = targets if frame is None else _held(system, targets, frame)
    problem, first = pose_problem(system, wanted, seed, tolerance, starts, rng)
    if not np.isfinite(first).all():
        raise InputError("seed has entries that are not finite")
    if len(problem.lead) != 1 or not problem.lead[0] or len(first) > 1:
        raise InputError(f"targets have the leading shape {problem.lead}, the seed {first.shape}; needed are (n,) "
                         f"targets and one seed ({system.nq},)")  # fmt: skip
    for task, goals in zip(problem.tasks, problem.goals, strict=True):
        refuse(goals, task.label)
    budget = Budget(time_limit)
    budget.put_in_order()  # there is nothing to do afterwards
    way = _Way(problem, max_step, budget, progress)
    q0, info = way.rows[0].run(first)
    begin, n = 0, problem.lead[0]
    while restart and info[0, 0] != SOLVED and begin + 1 < n:
        begin += 1
        q0, info = way.rows[begin].run(first)
    if info[0, 0] != SOLVED:
        status = f"the path does not begin: target {begin} is {judge(way.rows[begin], q0, info).status}"
        return IkPath(system, np.full((n, system.nq), np.nan), np.zeros(n, dtype=bool), (), status)
    if not branches:
        return way.path(q0[0], restart, begin)
    begins = _distinct([q0[0], *way.elsewhere(begin, q0[0]), *_all(system, targets, frame, way.rows[begin], begin)])
    paths = []
    for q in begins:
        paths.append(way.path(q, restart, begin))
        if paths[-1].interrupted or paths[-1].late:
            break
    return min(paths, key=lambda p: (-_farthest(p), -np.sum(p.success), len(p.jumps), _length(p)))


def _held(system: System, targets: Any, frame: FrameLike) -> Pose | Position:
    poses, lead, is_position = parse_targets(system, targets)
    for i in np.flatnonzero(~np.isfinite(poses).all(axis=(1, 2)))[:1]:
        raise InputError(f"target {i} is not finite, or no pose, whose last row must be 0 0 0 1")
    poses = poses.reshape(*lead, 4, 4)
    name = system.frame_name(frame)
    is_position = is_position or bool(system.table.at[name][2])
    return Position(name, poses[..., :3, 3]) if is_position else Pose(name, poses)


class _Way:
    """The targets of a path, all that lies between them, and steps along it."""

    def __init__(self, problem: Problem, max_step: float, budget: Budget, progress: Callable[[int], None] | None):
        tasks = tuple(replace(t, tolerance=None) for t in problem.tasks)
        self.problem, self.max_step, self.budget = replace(problem, tasks=tasks), max_step, budget
        self.system, self.scale, self.progress = problem.system, problem.packed.scale, progress
        self.rows = [self.problem.of(i) for i in range(problem.lead[0])]
        packed = problem.packed
        equal = np.repeat([not t.bounds for t in packed.loops.ties], [len(t.rows) for t in packed.loops.ties])
        hard = [i for i, t in enumerate(tasks) if t.weight is None]
        own = packed.rows >= 0
        self.counts = np.isin(packed.rows[own], hard) & equal[own]

    def at(self, i: int, part: float) -> Problem:
        """The problem at a part of the way from target i - 1 to target i."""
        if part >= 1.0:
            return self.rows[i]
        a, b = self.rows[i - 1].goals, self.rows[i].goals
        goals: Any = tuple(
            [(_between(x, y, part), None if m is None or n is None else m + part * (n - m))
             for (x, m), (y, n) in zip(g, h, strict=True)] for g, h in zip(a, b, strict=True))  # fmt: skip
        return replace(self.rows[i], goals=goals, pins=self.problem.packed.pins(goals))

    def first_order(self, problem: Problem, q: Array) -> tuple[Array, float, Array]:
        """Scaled step (nv,) from q to what a problem asks, to first order and damped; also the ratio of the smallest
        singular value to the largest, and the velocity (nv,) that belongs to it."""
        packed = problem.packed
        own, closed = packed.evaluate(q, problem.pins), packed.evaluate(q, problem.pins, closures=True)
        e, J = (np.concatenate([x[self.counts], y]) for x, y in zip(own, closed, strict=True))
        if not J.size:
            return np.zeros(self.system.nv), 1.0, np.zeros(self.system.nv)
        U, s, Vt = np.linalg.svd(J, full_matrices=False)
        return -Vt.T @ (s / (s * s + DAMPING**2) * (U.T @ e)), float(s[-1] / max(s[0], 1e-300)), Vt[-1]

    def step(self, problem: Problem, q: Array) -> Array | None:
        """The configuration (nq,) that holds a problem and that one gets to from q; None where one does not.

        Singular configurations are left by a small step to either side: there, what is missing gives no direction.
        """
        ahead, ratio, weak = self.first_order(problem, q)
        if np.abs(ahead).max(initial=0.0) > self.max_step:
            return None
        for aside in (0.0, 0.5, -0.5) if ratio < SINGULAR else (0.0,):
            found, moved = self.land(problem, q, ahead + aside * SMALL * weak)
            most = np.abs(moved).max(initial=0.0)
            explained = most <= self.max_step and np.linalg.norm(moved) <= STRETCH * np.linalg.norm(ahead) + SMALL
            if found is not None and (explained or most <= SMALL):
                return found
        return None

    def coast(self, problem: Problem, q: Array, before: Array) -> Array | None:
        """The same by going on as before, by the scaled step (nv,): so targets that jump over a singularity are met."""
        found, moved = self.land(problem, q, before)
        smooth = np.linalg.norm(moved - before) <= ALIKE * np.linalg.norm(before)
        return found if smooth and np.abs(moved).max(initial=0.0) <= self.max_step else None

    def land(self, problem: Problem, q: Array, ahead: Array) -> tuple[Array | None, Array]:
        """Where (nq,) the solver gets to from a scaled step (nv,) away from q, None without success, and the step."""
        self.budget.check()
        start = self.system.integrate(q, ahead * self.scale)[None]
        found, info = replace(problem, starts=1).run(inside(self.system, start) if problem.limits else start)
        moved = self.system.difference(q, found[0]) / self.scale
        return found[0] if info[0, 0] == SOLVED else None, moved

    def follow(self, i: int, q: Array, before: Array) -> tuple[Array, float]:
        """Where one gets from q at target i - 1 towards target i, and which part of the way that is.

        `before` (nv,) is the scaled step that led to q.
        """
        part, size = 0.0, 1.0
        while part < 1.0:
            found = self.step(self.at(i, part + size), q)
            if found is None and size == 1.0:
                found = self.coast(self.rows[i], q, before)
            if found is None:
                size *= 0.5
                if size < 0.5**DEPTH:
                    break
            else:
                q, part = found, part + size
                size = min(2.0 * size, 1.0 - part)
        return q, part

    def reason(self, i: int, q: Array, part: float) -> str:
        """What ends the way at q: the limits that it would leave, or a singularity."""
        ahead = self.at(i, min(part + 4.0 * 0.5**DEPTH, 1.0))
        free = self.step(replace(ahead, limits=False), q)
        if free is not None and (names := _outside(self.system, free)):
            return f"the limit of {' and of '.join(map(repr, names))}"
        ratio = self.first_order(ahead, q)[1]
        if ratio < SINGULAR:
            return f"a singularity (ratio of singular values {ratio:.1g})"
        return "a point from which it cannot be followed"

    def elsewhere(self, i: int, q: Array) -> list[Array]:
        """Configurations found that hold target i, from many starts, the nearest to q first."""
        row = self.rows[i]
        seeds = np.concatenate([q[None], self.system.random(row.rng, TRIED - 1)])
        found, info = replace(row, lead=(TRIED,), starts=max(1, row.starts // TRIED)).run(seeds)
        good = found[info[:, 0] == SOLVED]
        return sorted(good, key=lambda x: float(np.linalg.norm(self.system.difference(q, x) / self.scale)))

    def path(self, q: Array, restart: bool, begin: int = 0) -> IkPath:
        """The path from q, which holds target `begin`; those before cannot be reached."""
        n = len(self.rows)
        out, jumps, said = np.full((n, self.system.nq), np.nan), [], []
        out[begin], interrupted, late = q, False, False
        if begin:
            said.append(f"no answer was found for {'targets 0 to ' if begin > 1 else 'target '}{begin - 1}")
        try:
            self._go(out, jumps, said, restart, begin)
        except BROKEN_OFF as error:
            interrupted, late = (isinstance(error, kind) for kind in BROKEN_OFF)
            said.append(partial(interrupted, late).strip(" ()"))
        success = self._checked(out)
        status = f"{success.sum()} of {n} targets followed"
        jumped = f" with {len(jumps)} jump{'s' if len(jumps) > 1 else ''}" if jumps and restart else ""
        return IkPath(self.system, out, success, tuple(jumps), "; ".join([status + jumped, *said]), interrupted, late)

    def _go(self, out: Array, jumps: list[int], said: list[str], restart: bool, begin: int) -> None:
        """Write the path from its configuration at target `begin` on, and what there is to say."""
        q, broken, before = out[begin], False, np.zeros(self.system.nv)
        for i in range(begin + 1, len(out)):
            found, part = (q, 0.0) if broken else self.follow(i, q, before)
            if part < 1.0:
                why = ""
                if not broken:
                    why = f"{part:.1%} of the way from target {i - 1} to {i}, at {self.reason(i, found, part)}"
                others = self.elsewhere(i, found)
                broken = not others
                said += [_sentence(self.system, i, why, found, others, restart)] if why or others else []
                jumps += [i] if others else []
                if not restart:
                    break
                if broken:
                    continue
                found, q = others[0], others[0]
            before, q = self.system.difference(q, found) / self.scale, found
            out[i] = q
            if self.progress is not None:
                self.progress(i + 1)

    def _checked(self, q: Array) -> np.ndarray:
        """Which configurations (n,) hold, by the forward model; the others become NaN, in place."""
        info = np.zeros((len(q), 3), dtype=np.int64)
        info[np.isnan(q).any(axis=1), 0] = BAD_INPUT
        good = np.asarray(judge(self.problem, q, info).success)
        q[~good] = np.nan
        return good


def _between(a: Array | None, b: Array | None, part: float) -> Array | None:
    """The pose at a part of the way between two: positions linear, rotations by the exponential map."""
    if a is None or b is None:
        return None
    R, S = a[:3, :3], b[:3, :3]
    turned = R @ spatial.exp_so3(part * spatial.log_so3(R.T @ S))
    return spatial.pose(turned, a[:3, 3] + part * (b[:3, 3] - a[:3, 3]))


def _outside(system: System, q: Array) -> list[str]:
    """Coordinates outside their limits at q (nq,); a turn less would be a jump."""
    v, x = system.layout.vector_v, q[system.layout.vector_q]
    return [system.velocity_names[i] for i in v[(x < system.lower[v] - ROUNDING) | (x > system.upper[v] + ROUNDING)]]


def _sentence(system: System, i: int, why: str, q: Array, others: list[Array], restart: bool) -> str:
    where = f"{'jumps' if restart and others else 'stops'} {why}" if why else f"goes on at target {i}"
    if not others:
        return f"{where}; target {i} was not reached from {TRIED} other starts either"
    change = np.abs(system.difference(q, others[0]))
    far = int(np.argmax(change))
    return f"{where}; target {i} is reached by a jump of {change[far]:.3g} in {system.velocity_names[far]!r}"


def _all(system: System, targets: Any, frame: FrameLike | None, row: Problem, begin: int) -> list[Array]:
    """What `ik_all` finds for target `begin`, inside the limits."""
    if frame is None:
        return []
    try:
        found = system.ik_all(reals(targets, "targets")[begin], frame)
    except UnsupportedError:
        return []
    answers = [row.run(q[None]) for q in found.q[found.inside]]
    return [q[0] for q, info in answers if info[0, 0] == SOLVED]


def _distinct(configurations: list[Array]) -> list[Array]:
    out: list[Array] = []
    for q in configurations:
        if all(np.abs(q - other).max(initial=0.0) > 1e-6 for other in out):
            out.append(q)
    return out


def _farthest(path: IkPath) -> int:
    """Number of targets before the first that is not reached continuously."""
    bad = [*np.flatnonzero(~path.success), *path.jumps, len(path)]
    return int(min(bad))


def _length(path: IkPath) -> float:
    q = path.q[path.success]
    return float(np.linalg.norm(path.system.difference(q[:-1], q[1:]), axis=-1).sum())
