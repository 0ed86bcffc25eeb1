"""The inverse model of a chain with one freedom to spare: its solutions as functions of a
parameter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe import spatial
from kempe.budget import Budget, TimeUp, Usual
from kempe.calls import explained
from kempe.errors import InputError, UnknownNameError, UnsupportedError, shown
from kempe.reals import FARTHEST, is_whole, reals
from kempe.rigid import arrays, refuse_no_poses
from kempe.solvers.analytic.ik_all import chain_lines, ik_all, plan_for
from kempe.solvers.analytic.plans.chain_lines import Lines
from kempe.solvers.analytic.plans.choice import domains
from kempe.solvers.analytic.plans.question import held, near_of
from kempe.solvers.analytic.redundant.arm_angle import (
    BRANCHES,
    ELBOW,
    Arm,
    Posed,
    find_arm,
    no_arm,
    required_arm,
)
from kempe.solvers.analytic.redundant.sweep import Sweep
from kempe.solvers.analytic.redundant.sweep_curves import ChainMotion, CurvePiece
from kempe.solvers.analytic.redundant.sweep_net import arcs_through
from kempe.solvers.common.clock import SHARE, SHORT, TimeLimit, time_limited, time_of
from kempe.solvers.common.problem import Problem, Solver, choose, chosen_by
from kempe.solvers.common.serial_chain import inside
from kempe.solvers.common.targets import (
    Z_AXIS,
    axis_for,
    not_a_pose,
    refuse_position,
    targets_of,
    task_and_axis,
    task_of,
)
from kempe.spatial import Array
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

ARM_ANGLE = "arm_angle"

SAMPLES = 256
MOST_SAMPLES = 10_000_000
"""Values of a joint at which all solutions are requested, as starts of the curves between: usually,
and at most."""
USUAL = Usual("ik_sweep", points=SAMPLES, time_limit=SHORT)


@explained
@time_limited(USUAL)
def ik_sweep(
    system: System,
    target: ArrayLike,
    frame: FrameLike,
    parameter: str | tuple[str, ArrayLike] | None = None,
    *,
    n: int | None = None,
    task: str | tuple[str, ArrayLike] | None = None,
    start: Any = None,
    fixed: Mapping[str, Any] | None = None,
    budget: Budget | None = None,
) -> Sweep:
    """The solutions of a redundant chain for one target, over a parameter, and where they are
    inside the limits.

    `parameter` is a joint of the chain, or "arm_angle" for seven turning joints of which the first
    three axes meet, and the last three (`kempe.solvers.analytic.redundant.arm_angle` says what it
    is; a pair ("arm_angle", reference) names its reference); by default that, and else the joint
    that `ik_all` holds. `target` and `task` are as in `ik_all`. Where there is more than one
    freedom to spare, joints are held: those `fixed`, by name, and others at `start` (nq,), which
    also chooses among turns of angles; without `start` where `ik_all` finds a solution inside the
    limits. `n` asks for samples at so many values. Of the `budget` are read: points (256), the
    values of a joint at which curves are looked for, and time_limit (30 s): where it ends the work,
    `late` is true, and the branches are those found.

    Errors: `UnsupportedError` for chains without a freedom to spare, or without an arm angle where
    that is requested, `InputError`, `UnknownNameError`, `TimeLimitError` where no branch could be
    looked for by then.

    >>> import kempe
    >>> robot = kempe.load("iiwa14")
    >>> target = robot.fk([0.3, 0.9, 0.2, 1.3, -0.4, 0.8, 0.1], "tool")
    >>> sweep = ik_sweep(robot, target, "tool")
    >>> [(round(low, 3), round(high, 3)) for low, high in sweep.intervals[0]]
    [(0.156, 6.204)]
    >>> sweep.at(0.2).q[0].round(3).tolist()
    [0.252, -0.341, -0.177, -1.3, 0.474, -0.535, -0.241]
    """
    name = system.structure.frame_name(frame)
    said, axis = task_and_axis(task)
    with_reference = isinstance(parameter, (tuple, list))
    if with_reference and len(parameter) != 2:
        raise InputError(
            f"the parameter is {shown(parameter)}; it must be a name, or a name and a direction"
        )
    parameter, reference = parameter if with_reference else (parameter, None)
    _count(USUAL.of(budget).points)
    direction = axis_for(axis, said)
    targets, lead, is_position = targets_of(system, arrays(target, "target"), said, direction)
    if lead != ():
        raise InputError(f"target has the leading shape {lead}; a sweep has one target")
    if not np.all(np.abs(targets) < FARTHEST):
        raise InputError(not_a_pose(targets[0]))
    task = task_of(said, is_position, bool(system.structure.table.at[name][2]))
    refuse_position(task, is_position, system.dim)
    given_near = near_of(system, start, None)
    near = system.neutral[None] if given_near is None else given_near
    lines = chain_lines(system, name, Z_AXIS)
    base = inside(system, near.copy())[0]
    base[lines.q_index] = near[
        0, lines.q_index
    ]  # which chooses among turns, also from outside the limits
    if task != "position" and system.dim == 3:
        _refuse_no_rotation(targets[0, :3, :3])
    given = held(name, lines.names, fixed)
    if any(v.ndim for v in given.values()):
        raise InputError("a sweep holds joints at single numbers")
    options = {
        "parameter": parameter,
        "reference": reference,
        "base": base,
        "n": None if n is None else _count(n),
        "given": reals(target, "target"),
    }
    problem = Problem(
        system,
        "set",
        given,
        start,
        budget=budget,
        options=options,
        frame=name,
        task=(task, direction),
        targets=targets,
    )
    solver, choice = choose(SOLVERS, system, name, task, tuple(given), parameter, reference)
    return chosen_by(solver.run(problem), choice)


# ---- the solvers


def _no_arm(
    system: System, frame: str, task: str, fixed: tuple[str, ...], parameter: Any, reference: Any
) -> str | None:
    joints = ", ".join(chain_lines(system, frame, Z_AXIS).names)
    if parameter not in (None, ARM_ANGLE):
        return f"joint {parameter!r} is named as the parameter"
    if task != "pose" or fixed:
        return f"the arm angle is for poses, with no joint held; name a joint: {joints}"
    arm = find_arm(system, frame, reference)
    return no_arm(system, frame, arm) if isinstance(arm, str) else None


def _no_joint(
    system: System, frame: str, task: str, fixed: tuple[str, ...], parameter: Any, reference: Any
) -> str | None:
    return "the arm angle is requested" if parameter == ARM_ANGLE else None


def by_arm_angle(problem: Problem) -> Sweep:
    """The branches of an arm over its arm angle, in closed form."""
    over = _sweep_problem(problem)
    arm = required_arm(problem.system, over.frame, problem.options["reference"])
    return _sweep(over, ArmCurves(over, arm), problem.options["n"])


def by_joint(problem: Problem) -> Sweep:
    """The branches over a joint, from solutions at many of its values."""
    over = _sweep_problem(problem)
    points = _count(USUAL.of(problem.budget).points)
    return _sweep(
        over, _joint_curves(over, problem.options["parameter"], points), problem.options["n"]
    )


SOLVERS = (
    Solver(
        "arm angle",
        "both sides of shoulder, elbow and wrist over the angle of the arm's plane",
        _no_arm,
        by_arm_angle,
    ),
    Solver(
        "joint",
        "all solutions at many values of a joint, and the curves through them",
        _no_joint,
        by_joint,
    ),
)
"""Who answers for the solutions over a parameter."""


def _sweep_problem(problem: Problem) -> SweepProblem:
    (task, axis) = problem.task
    given = problem.options["given"]
    lines = chain_lines(problem.system, str(problem.frame), Z_AXIS)
    return SweepProblem(
        problem.system,
        str(problem.frame),
        lines,
        task,
        axis,
        problem.targets[0],
        given,
        problem.options["base"],
        dict(problem.known),
        problem.start is None,
        time_of(USUAL),
    )


def _refuse_no_rotation(R: Array) -> None:
    refuse_no_poses(spatial.pose(R), "target")


def _count(n: object) -> int:
    if not is_whole(n) or not 2 <= n <= MOST_SAMPLES:
        raise InputError(
            f"the number of samples is {n!r}; it must be a whole number from 2 to {MOST_SAMPLES}"
        )
    return int(n)


@dataclass(frozen=True, eq=False)
class SweepProblem:
    """System, frame, target and parameter of a sweep over the solutions of a redundant chain."""

    system: System
    frame: str
    lines: Lines
    task: str
    axis: tuple[float, float, float]
    target: Array
    given: Array
    near: Array
    fixed: dict[str, Array]
    anywhere: bool
    time: TimeLimit = field(compare=False)

    def locked(self, fixed: Mapping[str, Any]) -> tuple[int, ...]:
        """Joints that `ik_all` holds, with these `fixed`."""
        lines = chain_lines(self.system, self.frame, self.axis)
        return plan_for(self.system, self.frame, lines, self.task, self.axis, tuple(fixed)).locked

    def place(self) -> Array:
        """Configuration (nq,) where joints are held that nobody named: near, inside the limits, or
        on target.
        """
        if self.anywhere:
            found = ik_all(
                self.system, self.given, self.frame, task=(self.task, self.axis), fixed=self.fixed
            )
            if found:
                return found.q[0]
        q = self.near.copy()
        at = self.lines.q_index
        q[at] = np.clip(q[at], *self.lines.limits)
        return q

    def all_at(
        self, name: str, values: Array, fixed: Mapping[str, Any], time: TimeLimit | None = None
    ) -> Any:
        """`ik_all` with a joint held at values () or (m,), in the `time` that is left."""
        budget = None if time is None or time.left is None else Budget(time_limit=SHARE * time.left)
        m = (len(values),) if values.ndim else ()
        target = np.broadcast_to(self.given, (*m, *self.given.shape))
        near = np.array(np.broadcast_to(self.near, (*m, self.system.nq)), order="C")
        return ik_all(
            self.system,
            target,
            self.frame,
            near,
            task=(self.task, self.axis),
            fixed={**fixed, name: values},
            budget=budget,
        )


def _sweep(over: SweepProblem, curves: ArmCurves | JointCurves, n: int | None) -> Sweep:
    """The answer, with samples."""
    rows, spans = (tuple(tuple(r) for r in curves.intervals(limited)) for limited in (True, False))
    none = np.zeros((0, len(curves.labels)), dtype=bool)
    sweep = Sweep(
        over.system,
        over.frame,
        curves.parameter,
        over.task,
        over.target,
        curves.held,
        curves.domain,
        curves.labels,
        rows,
        spans,
        curves.exact,
        np.zeros(0),
        np.zeros((*none.shape, over.system.nq)),
        none,
        none,
        curves,
        curves.base,
        None if curves.exact else partial(over.all_at, curves.parameter, fixed=curves.held),
    )
    if n is None:
        return sweep
    values = np.linspace(*curves.domain, n)
    try:
        q, mask, fits = sweep._sampled(values, True)
    except TimeUp:
        if not over.time.spent:
            raise
        curves.late = True
        return sweep
    for name, x in (("values", values), ("q", q), ("mask", mask), ("inside", fits)):
        object.__setattr__(sweep, name, x)
    return sweep


class ArmCurves:
    """The eight branches of an arm over its arm angle."""

    parameter = ARM_ANGLE
    exact = True
    circular = True
    late = False
    domain = (-math.pi, math.pi)

    def __init__(self, over: SweepProblem, arm: Arm):
        self.posed = Posed(arm, over.target)
        self.lines = arm.lines
        self.base = over.near
        self.held: dict[str, float] = {}
        names = (arm.lines.names[1], arm.lines.names[ELBOW], arm.lines.names[5])
        self.labels = tuple(
            " ".join(n + ("+", "-")[side] for n, side in zip(names, (s, e, w), strict=True))
            for e, s, w in BRANCHES
        )
        self.reason = (
            f"the wrist would have to be {self.posed.distance * arm.lines.length:.6g} m from the "
            "shoulder"
        )

    def intervals(self, limited: bool) -> list[list[tuple[float, float]]]:
        """For each branch, where it exists, inside the limits where `limited`."""
        return self.posed.intervals(limited)

    def rows(self, values: Array, branch: int | None = None) -> tuple[Array, np.ndarray]:
        """Coordinates (m, 8, 7), and which branches are there (m, 8); (m, 1, 7) and (m, 1) of one
        branch.
        """
        theta, found = self.posed.theta(values)
        if branch is not None:
            theta = theta[:, [branch]]
            found = found[:, [branch]]
        return (theta - self.lines.offset) / self.lines.multiplier, found


class JointCurves:
    """Branches over a joint: arcs of the curves of self-motion."""

    exact = False
    circular = False

    def __init__(
        self,
        motion: ChainMotion,
        arcs: list[CurvePiece],
        name: str,
        domain: tuple[float, float],
        fixed: dict[str, float],
        samples: int,
        late: bool,
    ):
        self.late = late
        self.motion = motion
        self.arcs = arcs
        self.lines = motion.lines
        self.parameter = name
        self.domain = domain
        self.held = fixed
        self.base = motion.base
        self.unit = float(motion.unit[motion.p])
        self.labels = tuple(f"branch {k + 1}" for k in range(len(arcs)))
        self.reason = (
            f"none of {counted(samples, 'value')} has one; it may be that the target alone decides "
            "it"
        )

    def intervals(self, limited: bool) -> list[list[tuple[float, float]]]:
        """For each branch, where it exists, inside the limits where `limited`."""
        return [
            [(a * self.unit, b * self.unit) for a, b in arc.intervals(limited)] for arc in self.arcs
        ]

    def rows(self, values: Array, branch: int | None = None) -> tuple[Array, np.ndarray]:
        """Coordinates (m, K, n), and which branches are there (m, K); of one branch K = 1."""
        arcs = self.arcs if branch is None else [self.arcs[branch]]
        q = np.full((len(values), len(arcs), len(self.lines)), np.nan)
        mask = np.zeros(q.shape[:2], dtype=bool)
        for k, arc in enumerate(arcs):
            x, mask[:, k] = arc.at(values / self.unit)
            q[:, k] = self.motion.q(x)[:, self.lines.q_index]
            q[:, k, self.motion.free[self.motion.p]] = values
        q[~mask] = np.nan
        return q, mask


def _joint_curves(over: SweepProblem, parameter: str | None, samples: int) -> JointCurves:
    """The branches over a joint. Errors: `UnsupportedError` where the chain has no freedom to
    spare.
    """
    lines = over.lines
    if parameter is not None and parameter not in lines.names:
        raise UnknownNameError(
            "joint", str(parameter), (*lines.names, ARM_ANGLE), f"the chain of {over.frame!r}"
        )
    if parameter in over.fixed:
        raise InputError(f"{parameter} is fixed; the parameter must be free")
    locked = _locked(over, parameter)
    if not locked:
        raise UnsupportedError(
            f"the chain of {over.frame!r} has no freedom to spare for {_article(over.task)}: ask "
            "`ik_all`"
        )
    name = locked[0] if parameter is None else parameter
    others = {n: float(over.fixed[n]) for n in locked if n in over.fixed}
    if left := [n for n in locked if n not in (name, *others)]:
        q = over.place()
        others |= {n: float(q[lines.q_index[lines.names.index(n)]]) for n in left}
    i = lines.names.index(name)
    first, last = domains(lines)[:, i].tolist()
    domain: tuple[float, float] = first, last
    shift = (domain[1] - domain[0]) * 0.381966 / samples  # arms tend to be singular at round values
    inner = np.linspace(domain[0], domain[1], samples)[:-1] + shift
    values = np.concatenate([[domain[0]], inner, [domain[1]]])
    over.time.put_in_order()  # `ik_all` has its share, and ends by itself
    found = over.all_at(name, values, others, over.time)
    missed = int(np.sum(found.late))
    free = tuple(j for j, n in enumerate(lines.names) if n not in others)
    base = over.near.copy()
    for other, value in others.items():
        base[lines.q_index[lines.names.index(other)]] = value
    motion = ChainMotion(
        over.system, over.frame, lines, over.task, over.axis, over.target, base, free, free.index(i)
    )
    level, row = np.nonzero(found.mask & (found.multiplicity > 0))
    arcs = arcs_through(
        motion, values / motion.unit[motion.p], motion.x(found.q[level, row]), level, over.time
    )
    late = missed > 0 or over.time.spent
    return JointCurves(motion, arcs, name, domain, others, len(values) - missed, late)


def _article(task: str) -> str:
    return f"a{'n' if task[0] in 'aeiou' else ''} {task.replace('_axis', ' with an axis')}"


def _locked(over: SweepProblem, parameter: str | None) -> list[str]:
    """Joints that `ik_all` holds for this task, the parameter first; none where the chain has no
    freedom to spare.
    """
    fixed = dict(over.fixed)
    if parameter is not None:
        fixed[parameter] = np.zeros(())
    names = over.lines.names
    chosen = [names[i] for i in over.locked(fixed) if names[i] not in fixed]
    if parameter is None:
        return [*chosen, *fixed] if chosen else []
    spare = [i for i in over.locked(over.fixed) if names[i] not in over.fixed]
    return [parameter, *chosen, *over.fixed] if spare else []
