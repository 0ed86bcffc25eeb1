"""Paths of configurations that follow a sequence of targets without a jump, and where and why that
cannot be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.budget import Budget, Usual
from kempe.calls import brief, explained, explained_methods, interruptible
from kempe.constraints.base import Constraint
from kempe.constraints.frame_targets import of_target
from kempe.errors import InputError, UnsupportedError
from kempe.kernels.base.search_layout import SOLVED
from kempe.kinematics.configuration import random, refuse_far
from kempe.kinematics.tasks.packed import refuse
from kempe.reals import reals
from kempe.rigid import arrays, refuse_no_poses, sound
from kempe.singular_values import svd
from kempe.solvers.assembly.assembly import assemble
from kempe.solvers.assembly.ideal import decided_within
from kempe.solvers.common import wording
from kempe.solvers.common.answer import Configurations
from kempe.solvers.common.clock import BROKEN_OFF, LONG, TimeLimit, partial
from kempe.solvers.common.problem import NOTHING, Problem, Solver, choose, chosen_by, takes_all
from kempe.solvers.common.proofs import outside_limits
from kempe.solvers.common.serial_chain import of_loops, shared_by
from kempe.solvers.common.slip import rolls
from kempe.solvers.common.targets import Z_AXIS, parse_targets
from kempe.solvers.paths.path_steps import DEPTH, SINGULAR, STAYS, TOLERANCE, WEAK, PathSteps
from kempe.solvers.tasks.demands import STARTS, Demands
from kempe.solvers.tasks.ik_tasks import judge, pose_problem
from kempe.solvers.tasks.uninvolved import apart
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

USUAL = Usual("ik_path", starts=STARTS, rng=0, time_limit=LONG, progress=None)
ROUNDING = 1e-12
"""How far outside its limits a coordinate may seem to be."""
ROUNDED = 1e-3
"""Largest tolerance that is named where targets seem to be rounded."""
SAME = 1e-9
"""Smallest singular value, as a part of the largest, at which rows are dependent."""
AVOIDING = (0.02, 0.2)
"""Strengths with which paths keep away from limits that are tried where the shortest steps end."""
TRIED = 16
"""Seeds that are tried where another start or a way on is looked for."""


@explained_methods
@dataclass(frozen=True, eq=False)
class IkPath(Configurations):
    """Configurations `q` (n, nq) that follow n targets, NaN where not `success` (n,).

    `jumps` are the targets that are reached, but not continuously from the one before; `status`
    says where and why the path jumps or stops. It is true where all targets are reached without a
    jump. Ctrl-C or the time limit leaves what was done (`interrupted`, `late`).
    """

    is_motion = True
    __repr__ = brief

    also = ("jumps", "interrupted", "late")

    system: System
    q: Array
    success: np.ndarray
    jumps: tuple[int, ...]
    reason: str
    problem: Demands = field(repr=False)
    """The tasks, with a goal for each of the targets."""
    interrupted: bool = False
    late: bool = False

    @property
    def code(self) -> Status:
        """The outcome: `PARTLY` where a target is not reached, or by a jump only."""
        if self:
            return Status.SOLVED
        return self._broken_off() or (Status.PARTLY if self.success.any() else Status.NOT_FOUND)

    def __bool__(self) -> bool:
        return bool(np.all(self.success)) and not self.jumps

    @property
    def _closing(self) -> Any:
        return self.problem.packed.closing

    def _goals(self) -> Sequence[tuple[Any, Any, Any]]:
        return self.problem.hard_tasks

    def _data(self) -> dict[str, Any]:
        return {"success": bool(self), "followed": self.success} | super()._data()

    def _claimed(self) -> np.ndarray:
        return self.success

    def _headline(self) -> str:
        return self.status


@explained
@interruptible
def ik_path(
    system: System,
    targets: Any,
    frame: FrameLike | None = None,
    start: Any = None,
    *,
    max_step: float = 0.5,
    restart: bool = False,
    branches: bool = False,
    tolerance: float | tuple[float, float] | None = None,
    budget: Budget | None = None,
) -> IkPath:
    """Configurations in which a frame follows targets, each reached continuously from the one
    before.

    `targets` are poses (n, 4, 4) or positions (n, 3), in the plane also (n, 3, 3) or (n, 2);
    without a frame they are tasks of `kempe.tasks` whose goals have a leading axis (n). Limits,
    couplings and loops hold, too. The first target is reached from `start` as `ik` does; from there
    on each step starts at its first order, the damped pseudoinverse times what is missing (Whitney,
    1969). A step is taken where it is not much longer than that, nor than `max_step` in radians and
    characteristic lengths, or much like the one before; else the targets' way (linear, rotations by
    the exponential map) is halved. Near a singularity it goes on as before where it can, and a turn
    of the joints that leaves the targets' way alone is no jump. A `tolerance` above the usual 1e-10
    m and rad is for rounded targets: what a singularity cannot give is then left out within it.
    Where the smallest part of it cannot be gone, the path from the start is tried once more, if the
    targets leave freedoms, with small self-motions away from limits. Where that ends, too, it
    stops, or, with `restart`, goes on from the nearest configuration found at the next target that
    can be reached; joints that the targets do not ask for stay. That it stops is no proof that no
    continuous path exists.
    Where there are velocity constraints, a path that slips (by more than the bend between targets
    explains) is refused with the place; where targets leave freedoms, one that rolls is led from
    the first target on instead. With `branches`, paths from several start configurations are tried,
    those of `ik_all` among them where it applies: the answer is the one that gets farthest, then
    the one with fewest jumps, then the shortest.
    Of the `budget` are read: starts (60) and rng (0) of what is looked for, time_limit (600 s) of
    the whole call, after which what was done by then is the answer, and progress, which receives
    how many targets are done. Errors: `InputError`, `UnknownNameError`.
    """
    if not 0.0 < max_step < math.inf:
        raise InputError(f"max_step is {max_step!r}; it must be a positive number")
    options = {"max_step": max_step, "restart": restart, "branches": branches}
    wanted = targets if frame is None else _held(system, targets, frame)
    name = None if frame is None else system.structure.frame_name(frame)
    problem = Problem(
        system,
        "path",
        NOTHING,
        start,
        None,
        True,
        tolerance,
        budget,
        options,
        name,
        targets=targets,
        wanted=wanted,
    )
    solver, choice = choose(SOLVERS, system)
    return chosen_by(solver.run(problem), choice)


def by_steps(problem: Problem) -> IkPath:
    """The path, gone step by step."""
    system = problem.system
    start = problem.start
    options = problem.options
    spend = USUAL.of(problem.budget)
    tolerance = TOLERANCE if problem.tolerance is None else problem.tolerance
    restart = options["restart"]
    time = TimeLimit(spend.time_limit)
    time.put_in_order()  # there is nothing to do afterwards
    decided_within(USUAL, time, system)
    demands, first = pose_problem(system, problem.wanted, start, tolerance, spend.starts, spend.rng)
    refuse_far(system, first, "start")
    if len(demands.lead) != 1 or not demands.lead[0] or len(first) > 1:
        raise InputError(
            f"targets have the leading shape {demands.lead}, the start {first.shape}; needed are "
            f"(n,) targets and one start ({system.nq},)"
        )
    for task, goals in zip(demands.tasks, demands.goals, strict=True):
        refuse(goals, task.label)
    way = _FollowedPath(demands, options["max_step"], time, spend.progress)
    n = demands.lead[0]
    none = IkPath(system, np.full((n, system.nq), np.nan), np.zeros(n, dtype=bool), (), "", demands)
    begin = 0
    begins = list[Array]()
    try:
        with time:
            q0, info, begin = way.begun(first, restart)
            if info[0, 0] != SOLVED:
                why = judge(way.rows[begin], q0, info).status
                return replace(none, reason=f"the path does not begin: target {begin} is {why}")
            begins.append(q0[0])
            if options["branches"]:
                begins += [
                    *way.elsewhere(begin, q0[0]),
                    *_all(problem, way.rows[begin], begin, q0[0]),
                ]
    except BROKEN_OFF as error:
        interrupted, late = (isinstance(error, kind) for kind in BROKEN_OFF)
        if not begins or interrupted:
            said = f"the path does not begin{partial(interrupted, late)}"
            return replace(none, reason=said, interrupted=interrupted, late=late)
    if not options["branches"]:
        return way.rolled(way.best(begins[0], restart, begin), begin)
    begins = _distinct(begins)
    paths: list[IkPath] = []
    for q in begins:
        paths.append(way.best(q, restart, begin))
        if paths[-1].interrupted or paths[-1].late:
            break
    paths = [way.rolled(p, begin) for p in paths]
    return min(paths, key=lambda p: (-_farthest(p), -np.sum(p.success), len(p.jumps), _length(p)))


def _held(system: System, targets: Any, frame: FrameLike) -> Constraint:
    poses, lead, is_position = parse_targets(system, arrays(targets, "targets"))
    poses = sound(poses, "targets")
    refuse_no_poses(poses, "targets")
    poses = poses.reshape(*lead, 4, 4)
    name = system.structure.frame_name(frame)
    is_position = is_position or bool(system.structure.table.at[name][2])
    (held,) = of_target(name, "position" if is_position else "pose", Z_AXIS, poses)
    return held


class _FollowedPath(PathSteps):
    """The way of targets, and the path along it, with self-motions away from limits where `avoids`
    is not 0.
    """

    avoids = 0.0

    def begun(self, first: Array, restart: bool) -> tuple[Array, np.ndarray, int]:
        """What is found for the first target, or with `restart` for the first that is reached, and
        its number.
        """
        begin = 0
        q, info = self.rows[begin].run(first)
        while restart and info[0, 0] != SOLVED and begin + 1 < len(self.rows):
            begin += 1
            q, info = self.rows[begin].run(first)
        return q, info, begin

    def reason(self, i: int, q: Array, part: float) -> str:
        """What ends the path at q, a fraction `part` of the way to target i: limits, a singularity,
        or neither.
        """
        ahead = self.at(i, min(part + 4.0 * 0.5**DEPTH, 1.0))
        free = self.step(replace(ahead, limits=False), q)
        if free is not None and (names := outside_limits(self.system, free, ROUNDING, False)):
            return wording.limits_of(names, " and of ")
        ratio = self.first_order(ahead, q).ratio
        if ratio < SINGULAR and (name := self.forbidding(ahead, q)):
            return f"a point from which {name!r} does not let it follow"
        if ratio < SINGULAR:
            return f"a singularity (ratio of singular values {ratio:.1g})"
        return "a point from which it cannot be followed"

    def forbidding(self, problem: Demands, q: Array) -> str:
        """The name of what holds always and repeats a row of the targets, at q and elsewhere; ''
        where nothing does.
        """
        packed = problem.packed
        name = ""
        if not packed.closed:
            return ""
        ties = [t.name for t in packed.loops.ties for _ in t.rows]
        names = [t for t, row in zip(ties, packed.rows, strict=True) if row == -1]
        aside = 0.2 * np.random.default_rng(0).normal(size=self.system.nv)
        near = self.system.structure.layout.integrate(q, aside * self.scale)
        other = assemble(self.system, start=near)
        for x in (q, other.q) if other.success else ():
            J = self.missing(problem, x)[1]
            U, s, _ = svd(J)
            tasks = len(J) - len(names)
            alone = svd(J[:tasks], compute_uv=False)
            if s[-1] > SAME * s[0] or len(J) > J.shape[1] or alone[-1] < SINGULAR * alone[0]:
                return ""
            name = names[int(np.argmax(np.abs(U[tasks:, -1])))]
        return name

    def hint(self, i: int, q: Array, before: Array) -> str:
        """The tolerance with which a path would go on through a singularity as before, where there
        is a small one.
        """
        if not before.any() or self.first_order(self.rows[i], q).ratio > WEAK:
            return ""
        x = self.truncated(self.rows[i], q, before)
        if x is None:
            return ""
        missed = judge(self.rows[i], x[None], np.full((1, 3), SOLVED))
        most = float(max(np.max(missed.position_error), np.max(missed.orientation_error)))
        return f", where tolerance={1.5 * most:.1g} lets it go on" if most <= ROUNDED else ""

    def elsewhere(self, i: int, q: Array) -> list[Array]:
        """Configurations found that hold target i, from many starts, the nearest to q first."""
        row = self.rows[i]
        seeds = np.concatenate([q[None], random(self.system, row.rng, TRIED - 1)])
        untouched = apart(row.packed, row.pins)
        seeds[:, untouched] = q[untouched]
        found, info = replace(row, lead=(TRIED,), starts=max(1, row.starts // TRIED)).run(seeds)
        good = found[info[:, 0] == SOLVED]
        return sorted(
            good,
            key=lambda x: float(
                np.linalg.norm(self.system.structure.layout.difference(q, x) / self.scale)
            ),
        )

    def best(self, q: Array, restart: bool, begin: int = 0) -> IkPath:
        """The path from q by the shortest steps; where that ends, and freedoms are left, one that
        keeps from limits.
        """
        path = self.path(q, restart, begin)
        if path or path.interrupted or path.late or rolls(self.system) or not self.free(begin, q):
            return path
        for self.avoids in AVOIDING:
            other = self.path(q, restart, begin)
            if _farthest(other) > _farthest(path):
                path = other
            elif other.interrupted or other.late:
                broken = partial(other.interrupted, other.late).strip(" ()")
                said = f"{path.reason}; another way was looked for, {broken}"
                path = replace(path, interrupted=other.interrupted, late=other.late, reason=said)
            if path or path.interrupted or path.late:
                break
        self.avoids = 0.0
        return path

    def free(self, i: int, q: Array) -> bool:
        """Whether target i leaves freedoms of joints that it asks for, and there are limits."""
        J = self.missing(self.rows[i], q)[1]
        used = int((np.abs(J) > 0.0).any(axis=0).sum()) if J.size else 0
        return self.rows[i].limits and used > int(np.linalg.matrix_rank(J)) if J.size else False

    def path(self, q: Array, restart: bool, begin: int = 0) -> IkPath:
        """The path from q, which holds target `begin`; those before cannot be reached."""
        n = len(self.rows)
        out = np.full((n, self.system.nq), np.nan)
        jumps: list[int] = []
        said: list[str] = []
        out[begin] = q
        interrupted = False
        late = False
        if begin:
            said.append(
                f"no answer was found for {'targets 0 to ' if begin > 1 else 'target '}{begin - 1}"
            )
        try:
            with self.budget:
                self._go(out, jumps, said, restart, begin)
        except BROKEN_OFF as error:
            interrupted, late = (isinstance(error, kind) for kind in BROKEN_OFF)
            said.append(partial(interrupted, late).strip(" ()"))
        untouched = apart(self.problem.packed, self.problem.pins)
        out[:, untouched] = q[untouched]  # to the last bit
        success = self._checked(out)
        status = f"{success.sum()} of {counted(n, 'target')} followed"
        jumped = (
            f" with {len(jumps)} jump{'s' if len(jumps) > 1 else ''}" if jumps and restart else ""
        )
        status = "; ".join([status + jumped, *said])
        return IkPath(
            self.system, out, success, tuple(jumps), status, self.problem, interrupted, late
        )

    def rolled(self, path: IkPath, begin: int) -> IkPath:
        """The path, or where there are velocity constraints what of it, or in its place, does not
        slip.
        """
        if not rolls(self.system) or path.interrupted or path.late:
            return path
        from kempe.solvers.paths.rolling_path import without_slip

        try:
            with self.budget:
                return without_slip(self, path, begin)
        except BROKEN_OFF as error:
            interrupted, late = (isinstance(error, kind) for kind in BROKEN_OFF)
            said = f"{path.reason}; it slips, {partial(interrupted, late).strip(' ()')}"
            return replace(
                path,
                success=np.zeros(len(path.q), dtype=bool),
                reason=said,
                interrupted=interrupted,
                late=late,
            )

    def _go(self, out: Array, jumps: list[int], said: list[str], restart: bool, begin: int) -> None:
        """Write the path from its configuration at target `begin` on, and what there is to say."""
        q = out[begin]
        broken = False
        before = np.zeros(self.system.nv)
        last = 0.0
        for i in range(begin + 1, len(out)):
            found, part, way = (q, 0.0, 0.0) if broken else self.follow(i, q, before, last)
            if part < 1.0:
                why = ""
                if not broken:
                    why = (
                        f"{part:.1%} of the way from target {i - 1} to {i}, at "
                        f"{self.reason(i, found, part)}"
                    )
                    why += self.hint(i, q, before)
                others = self.elsewhere(i, found)
                broken = not others
                said += (
                    [_sentence(self.system, i, why, found, others, restart)]
                    if why or others
                    else []
                )
                jumps += [i] if others else []
                if not restart:
                    break
                if broken:
                    continue
                found = others[0]
                q = others[0]
            if way > STAYS:  # else the target stays, and one goes on as before it
                moved = self.system.structure.layout.difference(q, found) / self.scale
                before = moved if not before.any() else moved + self.calm * (before - moved)
                last = way
            q = self.away(i, found, self.avoids) if self.avoids else found
            out[i] = q
            if self.progress is not None:
                self.progress(i + 1)

    def _checked(self, q: Array) -> np.ndarray:
        """Which configurations (n,) hold, by the forward model; the others become NaN, in place."""
        info = np.zeros((len(q), 3), dtype=np.int64)
        info[np.isnan(q).any(axis=1), 0] = Status.BAD_INPUT
        good = np.asarray(judge(self.problem, q, info).success)
        q[~good] = np.nan
        return good


def _sentence(
    system: System, i: int, why: str, q: Array, others: list[Array], restart: bool
) -> str:
    where = (
        f"{'jumps' if restart and others else 'stops'} {why}" if why else f"goes on at target {i}"
    )
    if not others:
        return f"{where}; target {i} was not reached from {TRIED} other starts either"
    change = np.abs(system.structure.layout.difference(q, others[0]))
    far = int(np.argmax(change))
    name = system.structure.velocity_names[far]
    known = "" if restart else "; whether a way without a jump exists is not known"
    return f"{where}; target {i} is reached by a jump of {change[far]:.3g} in {name!r}{known}"


def _all(problem: Problem, row: Demands, begin: int, q: Array) -> list[Array]:
    """What `ik_all` finds for target `begin`, inside the limits; what the target does not ask for
    is as in q (nq,).
    """
    if (
        problem.frame is None
        or of_loops(problem.system, problem.frame)
        or shared_by(problem.system, problem.frame)
    ):
        return []
    from kempe.solvers.analytic.ik_all import ik_all

    try:
        found = ik_all(problem.system, reals(problem.targets, "targets")[begin], problem.frame)
    except UnsupportedError:
        return []
    starts = found.q[found.inside]
    untouched = apart(row.packed, row.pins)
    starts[:, untouched] = q[untouched]
    answers = [row.run(x[None]) for x in starts]
    return [x[0] for x, info in answers if info[0, 0] == SOLVED]


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
    return float(
        np.linalg.norm(path.system.structure.layout.difference(q[:-1], q[1:]), axis=-1).sum()
    )


SOLVERS = (
    Solver(
        "steps",
        "each step from its first order on, halved where it is not much longer than that",
        takes_all,
        by_steps,
    ),
)
"""Who answers for a path."""
