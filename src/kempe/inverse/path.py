"""`ik_path`: configurations that follow targets without a jump, or the reason of a failure."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.answers import wording
from kempe.answers.answer import Configurations
from kempe.answers.evidence import list_limit_violations
from kempe.answers.problem import NOTHING, Problem, Solver, accept_all_problems, solve_problem
from kempe.answers.targets import Z_AXIS, make_target_constraints, parse_targets
from kempe.arguments import explain_errors, explain_method_errors, raise_interrupted
from kempe.assemble.assemble import assemble
from kempe.assemble.bound import remove_limits
from kempe.assemble.nearest_exact import find_nearest_exact_in_time
from kempe.budget import Budget, Usual
from kempe.constraints.base import Constraint
from kempe.equations.packed_tasks import refuse_goal
from kempe.equations.slip import Slip, compute_unit_rows, find_first_slip, has_velocity_constraints
from kempe.equations.tasks import Goal
from kempe.errors import InputError
from kempe.forward.fk import fk
from kempe.geometry.clearance import compute_gap_gradients, watch_clearances
from kempe.geometry.path_clearance import Encounter, PathGuard, read_clearances
from kempe.inverse.answer import Reached
from kempe.inverse.best_path import (
    Home,
    close_path,
    count_followed_targets,
    find_best_branch,
    list_starts,
    read_cost,
)
from kempe.inverse.chain.serial_chain import move_inside_limits
from kempe.inverse.tasks.demands import STARTS, Demands, find_untouched_places
from kempe.inverse.tasks.keep_clear import ClearSearch
from kempe.inverse.tasks.search import make_checked_answer, make_demands
from kempe.kernels.base.search_layout import SOLVED
from kempe.kernels.compiled import path_steps
from kempe.model.configurations import (
    make_ranges_table,
    refuse_large_numbers,
    sample_configurations,
)
from kempe.numerics.clock import BROKEN_OFF, LONG, TimeLimit, describe_early_end
from kempe.numerics.newton import run_gauss_newton, solve_least_squares
from kempe.numerics.rank import Level, Spectrum
from kempe.poses import check_poses, correct_rotations, read_pose_array
from kempe.report import Table
from kempe.spatial import Array
from kempe.status import Status
from kempe.units import make_tolerance
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model


# ---- steps from target to target

# Where nothing is singular a step is explained by its first order. Near a singularity that says
# little: there a path goes on as before where it can, and a turn of joints that leaves the targets'
# way alone is no jump.

TOLERANCE = 1e-10
"""Largest error of the targets along a path, in metres and radians; see `make_tolerance`."""
DEPTH = 12
"""How often the way between two targets is halved before it counts as a jump."""
SMALL = 0.02
"""Steps so small, in radians and characteristic lengths, need no explanation: with square roots, 1
/ 2^(DEPTH/2)."""
STRETCH = 2.0
"""How many times longer than its first order a step may be."""
ALIKE = 0.5
"""How much a step may differ from the one before, as a part of it, to count as going on."""
DAMPING = 1e-3
"""Singular values below it do not make the first order longer (Wampler, 1986)."""
SINGULAR = 0.05
"""Ratio of singular values at the end of a path below which it ends at a singularity; it falls with
a square root."""
WEAK = 0.1
"""Ratio of singular values below which a path goes on as before where it can."""
BESIDE = 0.1
"""How far from their way, as a part of it, straight lines of the joints may lead that are no
jump."""
ASIDE = (0.0, 1.0, -1.0, 2.0, -2.0)
"""Steps aside, as parts of the first order, from which the other side of a singularity is looked
for."""
CALM = 0.7
"""Part of the steps before the last one in what goes on, where tolerances let targets be
rounded."""
UNEVEN = 0.5
"""Part by which the ways to two targets may differ that count as equal steps of one motion."""
STAYS = 1e-9
"""Length of a way below which a target stays where it was."""
HOMEWARDS = 20
"""Self-motions at most at one target that lead towards a configuration."""
AVOID = 0.1
"""Self-motion at most at one target, in radians and characteristic lengths, that leads away from
limits."""
TRUNCATED = 6
"""Steps that leave out what is singular."""
ROWS = 12
"""Equations of a target up to which kernels make the steps that nothing speaks against."""
PIECE = 64
"""Targets that are followed by one call of a kernel."""


class Order(NamedTuple):
    """First-order step towards a problem's solution, and how singular its Jacobian is."""

    ahead: Array
    """The scaled step (nv,) to it, damped."""
    ratio: float
    """The smallest singular value, as a part of the largest."""
    weak: Array
    """The velocity (nv,) that belongs to it."""
    way: float
    """The length of what is missing."""


class _Targets:
    """The problems of the single targets of a path, which are made where they are needed: there may
    be a million.
    """

    def __init__(self, problem: Demands):
        self.count = problem.lead[0]
        self._of = functools.lru_cache(8)(problem.select_row)

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, i: int) -> Demands:
        return self._of(i)


class PathSteps:
    """Targets of a path, problems between them, and steps from one to the next."""

    def __init__(
        self,
        problem: Demands,
        max_step: float,
        budget: TimeLimit,
        progress: Callable[..., object] | None = None,
    ):
        tasks = tuple(t.copy_without_tolerance() for t in problem.tasks)
        self.problem = replace(problem, tasks=tasks)
        self.max_step = max_step
        self.budget = budget
        usual = make_tolerance(TOLERANCE, problem.system.unit)
        self.loose = all(x > y for x, y in zip(problem.tolerance, usual, strict=True))
        """Whether both tolerances are wider than the usual ones."""
        self.calm = CALM if self.loose else 0.0
        self.system = problem.system
        self.scale = problem.packed.scale
        self.progress = progress
        self.rows = _Targets(self.problem)
        packed = problem.packed
        equal = np.repeat(
            [not t.bounds for t in packed.loops.ties], [len(t.row_names) for t in packed.loops.ties]
        )
        hard = [i for i, t in enumerate(tasks) if t.weight is None]
        own = packed.rows >= 0
        self.counts = np.isin(packed.rows[own], hard) & equal[own]

    @cached_property
    def _kernel_arguments(self) -> tuple[Any, ...] | None:
        """Arguments of `path_steps.follow_targets`; None where steps are more than that."""
        problem = self.problem
        packed = problem.packed
        loops = packed.loops
        layout = self.system.structure.layout
        counted = (packed.rows >= 0).astype(np.int64)
        plain = (
            not self.loose
            and not packed.closed
            and self.counts.all()
            and not packed.one_sided.declared
            and all(tie.function is None for tie in loops.ties)
            and layout.nq == layout.nv == len(layout.vector_v)
            and 0 < counted.sum() <= min(ROWS, layout.nv)
        )
        if not plain:
            return None
        stages, strengths, *_ = problem.levels
        rules = (self.max_step, STRETCH, SMALL, WEAK, DAMPING, UNEVEN, STAYS, ALIKE)
        limits = np.stack([self.system.lower, self.system.upper])
        weights = loops.weights
        if not problem.limits:
            limits = np.stack([np.full(layout.nv, -np.inf), np.full(layout.nv, np.inf)])
            weights = remove_limits(self.system, loops)
        return (
            (loops.ints, loops.floats, loops.plan, weights, stages, strengths),
            (counted, np.array(rules), limits, problem.iterations, problem.loose, problem.rng),
        )

    def follow_plain_targets(self, out: Array, i: int, before: Array) -> int:
        """Write configurations of targets i on to `out` as long as no step is in doubt.

        Returns the first target that is left. `before` (nv + 1) is the scaled step to target i - 1
        and the length of its way, and is updated.
        """
        if self._kernel_arguments is None:
            return i
        system, judged = self._kernel_arguments
        pins = self.problem.pins
        while i < len(out):
            self.budget.check_time()
            j = min(i + PIECE, len(out))
            some = pins[i - 1 : j] if len(pins) > 1 else pins
            rows = out[i - 1 : j]
            done = path_steps.follow_targets(*system, some, *judged, before, rows)
            if self.progress is not None:
                for k in range(i, i + done - 1):
                    self.progress(k + 1)
            i += done - 1
            if i < j:
                break
        return i

    def interpolate_problem(self, i: int, part: float) -> Demands:
        """Interpolate the problem at the fraction `part` from target i - 1 to target i."""
        if part >= 1.0:
            return self.rows[i]
        a = self.rows[i - 1].goals
        b = self.rows[i].goals
        goals = tuple(
            Goal(
                None
                if x.pose is None or y.pose is None
                else _interpolate_pose(x.pose, y.pose, part),
                {n: m + part * (y.numbers[n] - m) for n, m in x.numbers.items()},
            )
            for x, y in zip(a, b, strict=True)
        )
        return replace(self.rows[i], goals=goals, pins=self.problem.packed.pack_pins(goals))

    def compute_first_order_step(self, problem: Demands, q: Array, weak: float = 0.0) -> Order:
        """Compute the damped first-order step from q that solves a problem.

        Singular values below `weak` times the largest are left out.
        """
        e, J = self.evaluate_residuals(problem, q)
        if not J.size:
            return Order(np.zeros(self.system.nv), 1.0, np.zeros(self.system.nv), 0.0)
        U, s, Vt = Spectrum(J).thin_decomposition
        part = s / (s * s + DAMPING**2)
        if weak:
            part[s < weak * s[0]] = 0.0
        return Order(
            -Vt.T @ (part * (U.T @ e)),
            float(s[-1] / max(s[0], 1e-300)),
            Vt[-1],
            float(np.linalg.norm(e)),
        )

    def evaluate_residuals(self, problem: Demands, q: Array) -> tuple[Array, Array]:
        """Compute residuals (m,) and Jacobian (m, nv) of hard tasks and loops at q (nq,)."""
        packed = problem.packed
        e, J = packed.evaluate_tasks(q, problem.pins)
        if not self.counts.all():
            e = e[self.counts]
            J = J[self.counts]
        if packed.closed:
            more, rows = packed.evaluate_tasks(q, problem.pins, closures=True)
            e = np.concatenate([e, more])
            J = np.concatenate([J, rows])
        return e, J

    def find_configuration(
        self, problem: Demands, q: Array, order: Order | None = None
    ) -> Array | None:
        """Find the configuration (nq,) near q that solves a problem, by first-order steps, or None.

        Singular configurations are left by a small step to either side: there, the residual gives
        no direction.
        """
        ahead, ratio, weak, _ = (
            self.compute_first_order_step(problem, q) if order is None else order
        )
        if np.abs(ahead).max(initial=0.0) > self.max_step:
            return None
        for aside in (0.0, 0.5, -0.5) if ratio < SINGULAR else (0.0,):
            found, moved = self.find_landing(problem, q, ahead + aside * SMALL * weak)
            most = np.abs(moved).max(initial=0.0)
            explained = (
                most <= self.max_step
                and np.linalg.norm(moved) <= STRETCH * np.linalg.norm(ahead) + SMALL
            )
            if found is not None and (explained or most <= SMALL):
                return found
        return None

    def repeat_step(self, problem: Demands, q: Array, before: Array) -> Array | None:
        """Find a solution (nq,) near q by repeating the last scaled step (nv,), or None.

        So targets beyond a singularity are met.
        """
        if not before.any():
            return None
        found = self.repeat_step_within_tolerance(problem, q, before)
        if found is not None:
            return found
        found, moved = self.find_landing(problem, q, before)
        return found if found is not None and self.is_smooth_step(moved, before) else None

    def repeat_step_within_tolerance(
        self, problem: Demands, q: Array, before: Array
    ) -> Array | None:
        """Repeat the last step, with residuals in singular directions up to the tolerance.

        Returns None where this fails.
        """
        x = self.repeat_truncated_step(problem, q, before) if self.loose else None
        good = (
            x is not None and make_checked_answer(problem, x[None], np.full((1, 3), SOLVED)).success
        )
        return x if good else None

    def repeat_truncated_step(self, problem: Demands, q: Array, before: Array) -> Array | None:
        """Repeat the last step and correct it in regular directions only.

        Returns None where the configuration is off the target.
        """
        x = self.system.structure.layout.integrate_velocity(q, before * self.scale)
        for _ in range(TRUNCATED):
            x = self.system.structure.layout.integrate_velocity(
                x, self.compute_first_order_step(problem, x, SINGULAR).ahead * self.scale
            )
            x = move_inside_limits(self.system, x[None])[0] if problem.limits else x
        return (
            x
            if self.is_smooth_step(
                self.system.structure.layout.compute_difference(q, x) / self.scale, before
            )
            else None
        )

    def is_smooth_step(self, moved: Array, before: Array) -> bool:
        """Whether a scaled step (nv,) continues the last one without a jump or a sharp turn."""
        close = np.linalg.norm(moved - before) <= ALIKE * np.linalg.norm(before)
        return bool(close) and np.abs(moved).max(initial=0.0) <= self.max_step

    def find_smooth_opening(self, i: int, q: Array, order: Order) -> Array | None:
        """Find the solution (nq,) at target i whose next step is most like the last one.

        Near a singularity a candidate is tried on either side. `order` is the first-order step at
        q. None where no candidate leads smoothly to the next target.
        """
        size = max(float(np.linalg.norm(order.ahead)), SMALL)
        tried: list[tuple[float, Array]] = []
        for aside in ASIDE if i + 1 < len(self.rows) and order.way > STAYS else ():
            start = order.ahead + aside * size * order.weak
            found, moved = self.find_landing(self.rows[i], q, start)
            if (
                found is not None
                and np.linalg.norm(moved) <= (1.0 + STRETCH) * size
                and self.is_smooth_step(moved, moved)
            ):
                there, further = self.find_landing(self.rows[i + 1], found, moved)
                if there is not None and self.is_smooth_step(further, moved):
                    tried.append((float(np.linalg.norm(further - moved)), found))
        return min(tried, key=lambda x: x[0])[1] if tried else None

    def find_bridge(self, i: int, q: Array, before: Array, order: Order) -> Array | None:
        """Find the nearest solution (nq,) at target i from which straight lines lead on.

        At a singularity joints may turn by much while the targets move by little: that is no jump,
        as long as the way between is held as well as short steps hold it elsewhere.
        """
        starts = (np.zeros(self.system.nv), order.ahead, before)
        tried = [
            self.find_landing(self.rows[i], q, x)
            for x in starts
            if np.abs(x).max(initial=0.0) <= self.max_step
        ]
        found = [(np.abs(moved).max(initial=0.0), x, moved) for x, moved in tried if x is not None]
        integrate = self.system.structure.layout.integrate_velocity
        for most, x, moved in sorted(found, key=lambda f: float(f[0])):
            if most <= self.max_step and all(
                np.linalg.norm(
                    self.evaluate_residuals(
                        self.interpolate_problem(i, part), integrate(q, part * moved * self.scale)
                    )[0]
                )
                <= BESIDE * order.way
                for part in (0.25, 0.5, 0.75)
            ):
                return x
        return None

    def move_from_limits(self, i: int, q: Array, strength: float) -> Array:
        """Move away from limits by a small self-motion at target i; returns q (nq,).

        It is the motion that lowers the sum of 1 / distance over all limits the fastest, distances
        as parts of ranges; its size is the rate of that times `strength`, and `AVOID` at most.
        """
        system = self.system
        limits = self.system.lower
        at = system.structure.layout.vector_q
        v = system.structure.layout.vector_v
        wide = system.upper[v] - limits[v]
        bounded = np.isfinite(wide) & (wide > 0.0)
        at = at[bounded]
        v = v[bounded]
        wide = wide[bounded]
        low, high = (
            (np.maximum(x, 1e-3 * wide)) / wide
            for x in (q[at] - limits[v], system.upper[v] - q[at])
        )
        pull = np.zeros(system.nv)
        pull[v] = (1.0 / low**2 - 1.0 / high**2) / wide * self.scale[v]
        pull[
            v[
                np.isin(
                    at,
                    np.flatnonzero(find_untouched_places(self.problem.packed, self.problem.pins)),
                )
            ]
        ] = 0.0
        return self.move_by_self_motion(i, q, pull, strength)

    def move_by_self_motion(self, i: int, q: Array, pull: Array, strength: float) -> Array:
        """Move by a small self-motion at target i along a scaled velocity (nv,); returns q (nq,)."""
        way = self.project_on_self_motions(i, q, pull)
        size = float(np.linalg.norm(way))
        if size < 1e-9:
            return q
        for step in (AVOID, 0.25 * AVOID):
            moved = way * (min(step, strength * size) / size)
            found, whole = self.find_landing(self.rows[i], q, moved)
            if found is not None and np.linalg.norm(whole - moved) <= 0.5 * np.linalg.norm(moved):
                return found
        return q

    def project_on_self_motions(self, i: int, q: Array, v: Array) -> Array:
        """Project a scaled velocity (nv,) on the self-motions of target i at q."""
        J = self.evaluate_residuals(self.rows[i], q)[1]
        N = Spectrum(J).compute_null_space(Level.GENERIC).T
        return N.T @ (N @ v)

    def move_home(self, i: int, q: Array, home: Home) -> Array:
        """Move by self-motion at target i to the configuration that is nearest to `home`.

        So the path is a function of the targets, and returns where they do (Baillieul, 1985).
        """
        layout = self.system.structure.layout
        for _ in range(HOMEWARDS):
            pull = home.weights * layout.compute_difference(q, home.q) / self.scale
            way = self.project_on_self_motions(i, q, pull)
            size = float(np.linalg.norm(way))
            if size < 1e-9:
                break
            found, _ = self.find_landing(self.rows[i], q, way * min(1.0, AVOID / size))
            if found is None:
                break
            q = found
        return q

    def find_landing(self, problem: Demands, q: Array, ahead: Array) -> tuple[Array | None, Array]:
        """Find a solution (nq,) from q plus the scaled step `ahead` (nv,), and the step there."""
        self.budget.check_time()
        start = self.system.structure.layout.integrate_velocity(q, ahead * self.scale)[None]
        found, info = replace(problem, starts=1).run_search(
            move_inside_limits(self.system, start) if problem.limits else start
        )
        moved = self.system.structure.layout.compute_difference(q, found[0]) / self.scale
        return found[0] if info[0, 0] == SOLVED else None, moved

    def follow_segment(
        self, i: int, q: Array, before: Array, last: float
    ) -> tuple[Array, float, float]:
        """Follow the path from q at target i - 1 towards target i.

        Returns where it ends, the fraction of the way, and its length.

        `before` (nv,) is the scaled step that led to q, and `last` the length of its way.
        """
        begin = q
        order = self.compute_first_order_step(self.rows[i], q)
        part = 0.0
        size = 1.0
        if abs(order.way - last) > UNEVEN * last:
            before = before * (order.way / last if last else 0.0)
        near = order.ratio < WEAK
        found = None
        if near:
            found = (
                self.repeat_step(self.rows[i], q, before)
                if before.any()
                else self.find_smooth_opening(i, q, order)
            )
        if found is None:
            found = self.find_configuration(self.rows[i], q, order)
        if found is None and not near:
            found = self.repeat_step(self.rows[i], q, before)
        if found is not None:
            return found, 1.0, order.way
        while part < 1.0:
            found = (
                self.find_configuration(self.interpolate_problem(i, part + size), q)
                if size < 1.0
                else None
            )
            if found is None:
                size *= 0.5
                if size < 0.5**DEPTH:
                    break
            else:
                q = found
                part = part + size
                size = min(2.0 * size, 1.0 - part)
        if part < 1.0 and (found := self.find_bridge(i, begin, before, order)) is not None:
            return found, 1.0, order.way
        return q, part, order.way


def _interpolate_pose(a: Array, b: Array, part: float) -> Array:
    """Interpolate between two poses: positions linearly, rotations by the exponential map."""
    R = a[:3, :3]
    S = b[:3, :3]
    turned = R @ spatial.exp_so3(part * spatial.log_so3(R.T @ S))
    return spatial.pose(turned, a[:3, 3] + part * (b[:3, 3] - a[:3, 3]))


# ---- paths of systems that roll

# They are checked for slip, and where the targets leave freedoms, led without slip from the start
# on.

LONGEST = 0.02
"""Longest step that is led without slip at once, in radians and characteristic lengths."""
ITERATIONS = 12
HELD = 1e-12
"""By how much targets may be missed, and rows violated, after a step."""
MOST = 4096
"""Steps at most between two targets."""


def remove_slip(way: PathSteps, path: IkPath, begin: int) -> IkPath:
    """Return the path if it does not slip, else a path that rolls to the targets.

    Where there is none, return the part before the first slip, with its place.
    """
    good = np.flatnonzero(path.success)
    whole = len(good) and good[-1] - good[0] + 1 == len(good)
    slip = find_first_slip(way.system, path.q[good]) if whole else None
    if slip is None:
        return path
    q = path.q.copy()
    reached = _roll_along_targets(way, q, begin)
    if reached == len(q) - 1:
        status = f"{len(q) - begin} of {format_count(len(q), 'target')} followed, without slip"
        return replace(path, q=q, success=np.arange(len(q)) >= begin, jumps=(), reason=status)
    return _cut_slipping_path(path, slip, int(good[0]))


def _cut_slipping_path(path: IkPath, slip: Slip, first: int) -> IkPath:
    """Cut the path before it slips."""
    k = first + slip.index
    why = f"before target {k}: on the way there it {slip.text}; getting there is a manoeuvre"
    return _cut_path(path, k, why)


def _cut_path(path: IkPath, k: int, why: str) -> IkPath:
    """Cut the path before target k."""
    q = path.q.copy()
    success = path.success.copy()
    q[k:] = np.nan
    success[k:] = False
    many = int(success.sum())
    status = f"{many} of {format_count(len(q), 'target')} followed; stops {why}"
    return replace(path, q=q, success=success, jumps=(), reason=status)


def _roll_along_targets(way: PathSteps, out: Array, begin: int) -> int:
    """Write configurations (n, nq) that roll from target to target; return the last reached."""
    q = out[begin]
    for i in range(begin + 1, len(out)):
        way.budget.check_time()
        ahead = way.compute_first_order_step(way.rows[i], q).way
        parts = min(max(2, math.ceil(ahead / LONGEST)), MOST)
        for part in range(1, parts + 1):
            found = _make_rolling_step(way, i, part / parts, q)
            if found is None:
                return i - 1
            q = found
        out[i] = q
    return len(out) - 1


def _make_rolling_step(way: PathSteps, i: int, part: float, q: Array) -> Array | None:
    """Find the configuration (nq,) at the target that is reached without slip, or None.

    The smallest such step, by Newton's method.
    """
    system = way.system
    problem = way.interpolate_problem(i, part)

    def evaluate_equations(d: Array) -> tuple[Array, Array]:
        e, J = way.evaluate_residuals(
            problem, system.structure.layout.integrate_velocity(q, d * way.scale)
        )
        A, b = compute_unit_rows(
            system, system.structure.layout.integrate_velocity(q, 0.5 * d * way.scale), way.scale
        )
        return np.concatenate([e, np.full(len(A), np.inf) if b.any() else A @ d]), np.concatenate(
            [J, A]
        )

    def compute_newton_step(d: Array, r: Array, M: Array) -> Array:
        new = solve_least_squares(M, M @ d - r, Level.CLOSED)
        return (
            new - d
            if np.linalg.norm(new) < 10.0 * LONGEST + 2.0 * np.linalg.norm(d)
            else np.full(len(d), np.inf)
        )

    found = run_gauss_newton(
        evaluate_equations,
        np.zeros(system.nv),
        ITERATIONS - 1,
        step=compute_newton_step,
        met=HELD,
        last=0.0,
    )
    layout = system.structure.layout
    x = layout.integrate_velocity(q, found.x * way.scale)
    v = layout.vector_v
    at = layout.vector_q
    inside = (x[at] >= system.lower[v] - HELD) & (x[at] <= system.upper[v] + HELD)
    return x if found.size <= HELD and inside.all() else None


# ---- the path

USUAL = Usual("ik_path", starts=STARTS, rng=0, time_limit=LONG, progress=None)
ROUNDING = 1e-12
"""How far outside its limits a coordinate may seem to be."""
ROUNDED = 1e-3
"""Largest tolerance that is named where targets seem to be rounded."""
REPELLING = (0.02, 0.2)
"""Strengths with which paths keep near bodies apart that are tried where these come too near."""
NEAR = 0.25
"""How much further than asked bodies are apart that are near, in characteristic lengths."""
AVOIDING = (0.02, 0.2)
"""Strengths with which paths keep away from limits that are tried where the shortest steps end."""
TRIED = 16
"""Seeds that are tried where another start or a way on is looked for."""


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class IkPath(Configurations):
    """Answer of `ik_path`: configurations that follow a sequence of n targets.

    The answer is true if all targets are reached without a jump.

    Attributes
    ----------
    q
        Configurations (n, nq); NaN in rows without `success` (n,).
    jumps
        Targets that are reached, but not continuously from the target before.
    status
        Where and why the path jumps or stops.
    encounters
        Where two bodies would come too near for a `clearance`, on the way that the path did not
        take: `piece` is the target before, as in `BodyGeometry.check_path`.
    late, interrupted
        Whether the time limit or Ctrl-C ended the work; `q` has the finished part.
    """

    is_motion = True
    _entries = ("jumps", "interrupted", "late")

    system: Model
    q: Array
    success: np.ndarray
    jumps: tuple[int, ...]
    reason: str
    problem: Demands
    """The tasks, with a goal for each of the targets."""
    interrupted: bool = False
    late: bool = False
    encounters: tuple[Encounter, ...] = ()

    @property
    def code(self) -> Status:
        """Outcome: `PARTLY` if a target is not reached, or is reached only by a jump."""
        if self:
            return Status.SOLVED
        return self._find_early_end() or (Status.PARTLY if self.success.any() else Status.NOT_FOUND)

    def __bool__(self) -> bool:
        return bool(np.all(self.success)) and not self.jumps

    @property
    def _closed_system(self) -> Any:
        return self.problem.packed.closing

    def _list_goals(self) -> Sequence[tuple[Any, Any, Any]]:
        return self.problem.hard_tasks

    def _list_outcomes(self) -> dict[str, np.ndarray]:
        jump = np.isin(np.arange(len(self.q)), self.jumps)
        return {"success": self.success, "jump": jump, "residual": self.residual}

    def _collect_data(self) -> dict[str, Any]:
        return {"success": bool(self), "followed": self.success} | super()._collect_data()

    def _select_claimed_rows(self) -> np.ndarray:
        return self.success

    def _make_headline(self) -> str:
        return self.status

    def _make_tables(self) -> Sequence[Table]:
        """Make the table of the range and the largest step of each coordinate."""
        if not np.isfinite(self.q).any():
            return []
        return [make_ranges_table(self.system, self.q, steps=True)]

    def _list_reasons(self) -> list[str]:
        """Nothing: the headline says where the path ends, and why."""
        return []


@explain_errors
@raise_interrupted
def ik_path(
    system: Model,
    targets: Any,
    frame: FrameLike | None = None,
    start: Any = None,
    *,
    max_step: float = 0.5,
    restart: bool = False,
    branches: bool | str = False,
    cost: Any = "motion",
    closed: bool = False,
    clearance: Any = None,
    tolerance: float | tuple[float, float] | None = None,
    budget: Budget | None = None,
) -> IkPath:
    """Find configurations in which a frame follows targets without a jump; see `System.ik_path`."""
    if not 0.0 < max_step < math.inf:
        raise InputError(f"max_step is {max_step!r}; it must be a positive number")
    if branches not in (False, True, "best"):
        raise InputError(f'branches is {branches!r}; it must be False, or True or "best"')
    options = {
        "max_step": max_step,
        "restart": restart,
        "branches": branches,
        "cost": read_cost(cost),
        "closed": closed,
        "clearances": () if clearance is None else tuple(read_clearances(clearance)),
    }
    wanted = targets if frame is None else _make_pose_task(system, targets, frame)
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
    return solve_problem(SOLVERS, problem)


def solve_path(problem: Problem) -> IkPath:
    """Follow the path step by step."""
    system = problem.system
    start = problem.start
    options = problem.options
    spend = USUAL.complete_budget(problem.budget)
    tolerance = problem.tolerance
    if tolerance is None:
        tolerance = make_tolerance(TOLERANCE, system.unit)
    restart = options["restart"]
    time = TimeLimit(spend.time_limit)
    time.release_reserved_time()  # there is nothing to do afterwards
    find_nearest_exact_in_time(USUAL, time, system)
    demands, first = make_demands(system, problem.wanted, start, tolerance, spend.starts, spend.rng)
    refuse_large_numbers(system, first, "start")
    if len(demands.lead) != 1 or not demands.lead[0] or len(first) > 1:
        raise InputError(
            f"targets have the leading shape {demands.lead}, the start {first.shape}; needed are "
            f"(n,) targets and one start ({system.nq},)"
        )
    for task, goals in zip(demands.tasks, demands.goals, strict=True):
        refuse_goal(goals, task.label)
    way = FollowedPath(demands, options["max_step"], time, spend.progress)
    if options["clearances"]:
        way.guard = PathGuard(system, watch_clearances(system, options["clearances"]))
    n = demands.lead[0]
    none = IkPath(system, np.full((n, system.nq), np.nan), np.zeros(n, dtype=bool), (), "", demands)
    begin = 0
    starts = list[Array]()
    try:
        with time:
            answer, begin = way.find_first_configuration(first, restart)
            if not answer:
                said = f"the path does not begin: target {begin} is {answer.status}"
                return replace(none, reason=said)
            starts = [answer.q]
            if options["branches"]:
                starts = list_starts(problem, way, begin, answer.q)
                starts = [x for x in starts if way.is_clear(x)]
    except BROKEN_OFF as error:
        interrupted, late = (isinstance(error, kind) for kind in BROKEN_OFF)
        if not starts or interrupted:
            said = f"the path does not begin{describe_early_end(interrupted, late)}"
            return replace(none, reason=said, interrupted=interrupted, late=late)
    if options["branches"]:
        path = find_best_branch(way, starts, begin, restart, options["cost"])
    else:
        path = way.keep_rolling_part(way.find_best_path(starts[0], restart, begin), begin)
    return close_path(way, path) if options["closed"] else path


def _make_pose_task(system: Model, targets: Any, frame: FrameLike) -> Constraint:
    poses, lead, is_position = parse_targets(system, read_pose_array(targets, "targets"))
    poses = correct_rotations(poses, "targets")
    check_poses(poses, "targets")
    poses = poses.reshape(*lead, 4, 4)
    name = system.structure.frame_name(frame)
    is_position = is_position or bool(system.structure.table.at[name][2])
    (held,) = make_target_constraints(name, "position" if is_position else "pose", Z_AXIS, poses)
    return held


class FollowedPath(PathSteps):
    """The way of targets, and the path along it.

    It has self-motions away from limits where `avoids` is not 0, and away from other bodies where
    `repels` is not 0. A `guard` keeps bodies apart.
    """

    avoids = 0.0
    repels = 0.0
    home: Home | None = None
    guard: PathGuard | None = None

    def copy_without_limits(self) -> FollowedPath:
        """Return the same way, with joints that have no limits."""
        free = replace(self.problem, limits=False)
        way = FollowedPath(free, self.max_step, self.budget, self.progress)
        way.guard = self.guard
        return way

    def find_first_configuration(self, first: Array, restart: bool) -> tuple[Reached, int]:
        """Find the answer for the first target, or with `restart` for the first reached."""
        begin = 0
        answer = self.reach_target(begin, first)
        while restart and not answer and begin + 1 < len(self.rows):
            begin += 1
            answer = self.reach_target(begin, first)
        return answer, begin

    def reach_target(self, i: int, first: Array) -> Reached:
        """Find a configuration at target i, from a start (1, nq), that keeps clearances."""
        row = self.rows[i]
        answer = make_checked_answer(row, *row.run_search(first))
        if self.guard is None or not answer or self.is_clear(answer.q):
            return answer
        return ClearSearch(row, self.guard.watch, None).finish(answer, [])

    def is_clear(self, q: Array) -> bool:
        """Whether bodies keep their distances at q (nq,)."""
        return self.guard is None or self.guard.find_near_configuration(q[None]) is None

    def find_encounter(self, i: int, q: Array) -> Encounter | None:
        """Find where bodies come too near on the path q (n, nq) that begins at target i."""
        found = None if self.guard is None else self.guard.find_encounter(q)
        return None if found is None else found._replace(piece=i + found.piece)

    def move_from_bodies(self, i: int, q: Array, strength: float) -> Array:
        """Move near bodies apart by a small self-motion at target i; returns q (nq,).

        It is the motion that lowers the sum of 1 / distance over near pairs the fastest, distances
        less what is asked, as parts of what counts as near.
        """
        assert self.guard is not None
        watch = self.guard.watch
        near = NEAR * self.problem.packed.loops.length
        gaps = watch.list_gaps(fk(self.system, q, watch.solids.names), near)
        if not gaps:
            return q
        over = np.array([g.distance - watch.at_least[g.couple] for g in gaps]) / near
        push = (1.0 / np.maximum(over, 1e-3) ** 2 - 1.0) / near
        pull = push @ compute_gap_gradients(self.system, watch, q, gaps) * self.scale
        return self.move_by_self_motion(i, q, pull, strength)

    def describe_end(self, i: int, q: Array, part: float) -> str:
        """Describe what ends the path at q: limits, a singularity, or neither."""
        ahead = self.interpolate_problem(i, min(part + 4.0 * 0.5**DEPTH, 1.0))
        free = self.find_configuration(replace(ahead, limits=False), q)
        if free is not None and (
            names := list_limit_violations(self.system, free, ROUNDING, False)
        ):
            return wording.format_limits(names, " and of ")
        ratio = self.compute_first_order_step(ahead, q).ratio
        if ratio < SINGULAR and (name := self.find_forbidding_constraint(ahead, q)):
            return f"a point from which {name!r} does not let it follow"
        if ratio < SINGULAR:
            return f"a singularity (ratio of singular values {ratio:.1g})"
        return "a point from which no further step was found"

    def find_forbidding_constraint(self, problem: Demands, q: Array) -> str:
        """Find the constraint that repeats a row of the targets at q and elsewhere; '' if none."""
        packed = problem.packed
        name = ""
        if not packed.closed:
            return ""
        ties = [t.name for t in packed.loops.ties for _ in t.row_names]
        names = [t for t, row in zip(ties, packed.rows, strict=True) if row == -1]
        aside = 0.2 * np.random.default_rng(0).normal(size=self.system.nv)
        near = self.system.structure.layout.integrate_velocity(q, aside * self.scale)
        other = assemble(self.system, start=near)
        for x in (q, other.q) if other.success else ():
            J = self.evaluate_residuals(problem, x)[1]
            tasks = len(J) - len(names)
            spectrum = Spectrum(J)
            left = spectrum.left
            independent = spectrum.compute_rank(Level.CLOSED) == len(J)
            alone = Spectrum(J[:tasks]).compute_rank(SINGULAR) == tasks
            if independent or len(J) > J.shape[1] or not alone:
                return ""
            name = names[int(np.argmax(np.abs(left[tasks:, -1])))]
        return name

    def suggest_tolerance(self, i: int, q: Array, before: Array) -> str:
        """Suggest a small tolerance with which the path passes a singularity, if there is one."""
        if not before.any() or self.compute_first_order_step(self.rows[i], q).ratio > WEAK:
            return ""
        x = self.repeat_truncated_step(self.rows[i], q, before)
        if x is None:
            return ""
        missed = make_checked_answer(self.rows[i], x[None], np.full((1, 3), SOLVED))
        most = float(max(np.max(missed.position_error), np.max(missed.orientation_error)))
        return f", where tolerance={1.5 * most:.1g} lets it go on" if most <= ROUNDED else ""

    def find_other_configurations(self, i: int, q: Array) -> list[Array]:
        """Find other configurations at target i from many starts, the nearest to q first."""
        row = self.rows[i]
        seeds = np.concatenate([q[None], sample_configurations(self.system, row.rng, TRIED - 1)])
        untouched = find_untouched_places(row.packed, row.pins)
        seeds[:, untouched] = q[untouched]
        found, info = replace(row, lead=(TRIED,), starts=max(1, row.starts // TRIED)).run_search(
            seeds
        )
        good = found[info[:, 0] == SOLVED]
        return sorted(
            good,
            key=lambda x: float(
                np.linalg.norm(self.system.structure.layout.compute_difference(q, x) / self.scale)
            ),
        )

    def find_best_path(self, q: Array, restart: bool, begin: int = 0) -> IkPath:
        """Find the path from q by the shortest steps, else one that keeps away from limits."""
        path = self.follow_path(q, restart, begin)
        if (
            path
            or path.interrupted
            or path.late
            or has_velocity_constraints(self.system)
            or not self.has_free_joints(begin, q)
        ):
            return path
        for strengths in self._list_strengths(begin):
            self.avoids, self.repels = strengths
            other = self.follow_path(q, restart, begin)
            if count_followed_targets(other) > count_followed_targets(path):
                path = other
            elif other.interrupted or other.late:
                broken = describe_early_end(other.interrupted, other.late).strip(" ()")
                said = f"{path.reason}; another way was looked for, {broken}"
                path = replace(path, interrupted=other.interrupted, late=other.late, reason=said)
            if path or path.interrupted or path.late:
                break
        self.avoids = self.repels = 0.0
        return path

    def _list_strengths(self, begin: int) -> list[tuple[float, float]]:
        """List strengths of self-motions away from limits and from bodies that are tried."""
        limited = self.rows[begin].limits
        out = [(0.0, x) for x in REPELLING] if self.guard is not None else []
        return out + [(x, 0.0) for x in AVOIDING if limited]

    def has_free_joints(self, i: int, q: Array) -> bool:
        """Whether target i leaves freedoms of its joints, for what may be kept away from."""
        J = self.evaluate_residuals(self.rows[i], q)[1]
        if not J.size:
            return False
        used = int((np.abs(J) > 0.0).any(axis=0).sum())
        kept = self.rows[i].limits or self.guard is not None
        return kept and used > Spectrum(J).compute_rank(Level.ROUNDING)

    def follow_path(self, q: Array, restart: bool, begin: int = 0) -> IkPath:
        """Follow the path from q, which holds target `begin`."""
        n = len(self.rows)
        out = np.full((n, self.system.nq), np.nan)
        jumps: list[int] = []
        said: list[str] = []
        met: list[Encounter] = []
        out[begin] = q
        interrupted = False
        late = False
        if begin:
            said.append(
                f"no answer was found for {'targets 0 to ' if begin > 1 else 'target '}{begin - 1}"
            )
        try:
            with self.budget:
                self._follow_targets(out, jumps, said, met, restart, begin)
        except BROKEN_OFF as error:
            interrupted, late = (isinstance(error, kind) for kind in BROKEN_OFF)
            said.append(describe_early_end(interrupted, late).strip(" ()"))
        untouched = find_untouched_places(self.problem.packed, self.problem.pins)
        out[:, untouched] = q[untouched]  # to the last bit
        success = self.check_configurations(out)
        status = f"{success.sum()} of {format_count(n, 'target')} followed"
        jumped = (
            f" with {len(jumps)} jump{'s' if len(jumps) > 1 else ''}" if jumps and restart else ""
        )
        status = "; ".join([status + jumped, *said])
        return IkPath(
            self.system,
            out,
            success,
            tuple(jumps),
            status,
            self.problem,
            interrupted,
            late,
            tuple(met),
        )

    def keep_rolling_part(self, path: IkPath, begin: int) -> IkPath:
        """Keep the part of the path that does not slip, or a rolling path in its place."""
        if not has_velocity_constraints(self.system) or path.interrupted or path.late:
            return path

        try:
            with self.budget:
                rolling = remove_slip(self, path, begin)
                met = self.find_encounter(0, rolling.q)
        except BROKEN_OFF as error:
            interrupted, late = (isinstance(error, kind) for kind in BROKEN_OFF)
            said = f"{path.reason}; it slips, {describe_early_end(interrupted, late).strip(' ()')}"
            return replace(
                path,
                success=np.zeros(len(path.q), dtype=bool),
                reason=said,
                interrupted=interrupted,
                late=late,
            )
        if met is None:
            return rolling
        cut = _cut_path(rolling, met.piece + 1, _describe_encounter(met))
        return replace(cut, encounters=(met,))

    def _follow_targets(
        self,
        out: Array,
        jumps: list[int],
        said: list[str],
        encounters: list[Encounter],
        restart: bool,
        begin: int,
    ) -> None:
        """Write the path from its configuration at target `begin` on, and its messages."""
        q = out[begin]
        broken = False
        nv = self.system.nv
        before = np.zeros(nv + 1)  # the scaled step to target i - 1, and the length of its way
        i = begin
        while (i := i + 1) < len(out):
            met = None
            if not (broken or self.avoids or self.repels or self.home is not None):
                first = i - 1
                i = self.follow_plain_targets(out, i, before)
                met = self.find_encounter(first, out[first:i])
                if met is not None:
                    i = met.piece + 1
                    out[i:] = np.nan
                    before[:] = 0.0
                q = out[i - 1]
                if i == len(out):
                    break
            step = before[:nv]
            found, part, way = q, 0.0, 0.0
            if not broken and met is None:
                found, part, way = self.follow_segment(i, q, step, float(before[nv]))
            after = self._move_freely(i, found) if part == 1.0 else found
            if self.guard is not None and part == 1.0:
                met = self.find_encounter(i - 1, np.stack([q, after]))
            if part < 1.0 or met is not None:
                why = ""
                if met is not None:
                    found = q
                    encounters += [met]
                    why = _describe_encounter(met)
                elif not broken:
                    why = (
                        f"{part:.1%} of the way from target {i - 1} to {i}, at "
                        f"{self.describe_end(i, found, part)}"
                    )
                    why += self.suggest_tolerance(i, q, step)
                others = [x for x in self.find_other_configurations(i, found) if self.is_clear(x)]
                broken = not others
                kept = "" if self.guard is None else ", at the distances asked,"
                said += (
                    [_describe_stop(self.system, i, why, found, others, restart, kept)]
                    if why or others
                    else []
                )
                jumps += [i] if others else []
                if not restart:
                    break
                if broken:
                    continue
                found = q = others[0]
                after = found if self.guard is not None else self._move_freely(i, found)
            if way > STAYS:  # else the target stays, and one goes on as before it
                moved = self.system.structure.layout.compute_difference(q, found) / self.scale
                before[:nv] = moved if not step.any() else moved + self.calm * (step - moved)
                before[nv] = way
            q = after
            out[i] = q
            if self.progress is not None:
                self.progress(i + 1)

    def _move_freely(self, i: int, q: Array) -> Array:
        """Move by the self-motions at target i that are asked for; returns q (nq,)."""
        if self.avoids:
            q = self.move_from_limits(i, q, self.avoids)
        if self.repels:
            q = self.move_from_bodies(i, q, self.repels)
        if self.home is not None:
            q = self.move_home(i, q, self.home)
        return q

    def check_configurations(self, q: Array) -> np.ndarray:
        """Check configurations (n, nq) by the forward model; those that fail become NaN."""
        info = np.zeros((len(q), 3), dtype=np.int64)
        info[np.isnan(q).any(axis=1), 0] = Status.BAD_INPUT
        good = np.asarray(make_checked_answer(self.problem, q, info).success)
        q[~good] = np.nan
        return good


def _describe_encounter(met: Encounter) -> str:
    """Describe where on the way between two targets bodies come too near."""
    way = f"{met.part:.1%} of the way from target {met.piece} to {met.piece + 1}"
    return f"{way}, where {met.describe_bodies()}"


def _describe_stop(
    system: Model, i: int, why: str, q: Array, others: list[Array], restart: bool, kept: str
) -> str:
    where = (
        f"{'jumps' if restart and others else 'stops'} {why}" if why else f"goes on at target {i}"
    )
    if not others:
        return f"{where}; target {i} was not reached{kept} from {TRIED} other starts either"
    change = np.abs(system.structure.layout.compute_difference(q, others[0]))
    far = int(np.argmax(change))
    name = system.structure.velocity_names[far]
    known = "" if restart else "; whether a way without a jump exists is not known"
    return f"{where}; target {i} is reached by a jump of {change[far]:.3g} in {name!r}{known}"


SOLVERS = (
    Solver(
        "steps",
        "steps along the path, each predicted to first order, corrected, and halved where it is too long",
        accept_all_problems,
        solve_path,
    ),
)
"""Who answers for a path."""
