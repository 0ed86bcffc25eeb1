"""`ik_step`: velocities that give a frame a twist or move the frame to a pose, within limits."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe.answers.answer import Answer
from kempe.arguments import FOREIGN, explain_errors, explain_method_errors
from kempe.arrays import is_sequence, read_reals
from kempe.constraints.clearances import Apart
from kempe.equations.one_sided import pack_one_sided_rows
from kempe.equations.packed_tasks import Packed, find_leading_shape, refuse_goal
from kempe.equations.slip import has_velocity_constraints
from kempe.errors import InputError
from kempe.forward.fk import find_query, refuse_bad_configuration
from kempe.inverse.chain.serial_chain import find_chain, find_obstacle
from kempe.inverse.constrained_step import (
    ConstrainedSteps,
    NearRows,
    Stage,
    StageMaker,
    find_steady_fraction,
    make_constrained_steps,
)
from kempe.kernels.compiled import make_allocator, servo_step, task_step
from kempe.kernels.forward.table_layout import (
    BALL,
    KIND,
    Q_INDEX,
    TURN,
    V_INDEX,
    get_row_integers,
)
from kempe.kernels.servo.servo_layout import ANSWER, FRACTION
from kempe.kernels.servo.step_constants import BESIDE, NEAR, REACHED, SLOW
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.model.configurations import read_q
from kempe.model.in_metres import convert_system_to_metres
from kempe.model.model import bind_call, keep_answers, store_answer
from kempe.model.own_tree import remove_cut_marks
from kempe.poses import correct_rotations, read_pose_array
from kempe.report import by_code
from kempe.spatial import Array, log_so3
from kempe.status import Status
from kempe.units import METRE, METRES, from_metres, scale_lengths

if TYPE_CHECKING:
    from kempe.equations.tasks import Task
    from kempe.inverse.tasks.demands import Demands
    from kempe.model.model import FrameLike, Model


WHOLE = 1.0 - 1e-3
"""Fraction of what is wanted that counts as all of it: damping takes less than the rest far from
singularities."""
NONE = np.zeros(0)
PLAIN = (type(None), float, int)
"""Kinds of limits of speed that a plain call has."""
EYE = np.eye(3)
TURNING = math.pi
SLIDING = 1.0
"""Largest speeds of joints that the description gives none, in rad/s and m/s."""
KEPT = 64
"""Sets of tasks whose packed goals a system keeps, and sets of weights and priorities whose packed
numbers are kept with each structure of tasks."""
SKEW = 1e-5
"""Sum of what a rotation's product with its transpose may miss."""


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class IkStep(Answer):
    """Answer of `ik_step`: velocities, and the configuration after the step.

    Attributes
    ----------
    q
        Configuration (nq,) after the step.
    velocity
        Velocities (nv,).
    twist
        Twist (6,) of the frame; for tasks the rates (m,) of the hard tasks, in radians and
        characteristic lengths.
    fraction
        Achieved part of the wanted twist, from 0 to 1.
    saturated
        Names of the coordinates at a limit of position or velocity.
    default_speed
        Those of them whose speed limit is the default, since neither the system nor the call has
        one.
    blocked_by
        Names of the velocity constraints that prevent the rest of the motion.
    held_apart
        Pairs of bodies that are as near as clearances allow, by name.
    """

    _entries = ("velocity", "twist", "fraction", "saturated", "blocked_by", "held_apart")

    q: Array
    velocity: Array
    twist: Array
    fraction: float
    saturated: tuple[str, ...]
    system: Model
    default_speed: tuple[str, ...] = ()
    blocked_by: tuple[str, ...] = ()
    held_apart: tuple[tuple[str, str], ...] = ()

    success = by_code

    @property
    def code(self) -> Status:
        """Outcome: `PARTLY` where limits or a singularity leave only a fraction of the motion."""
        return Status.SOLVED if self.fraction >= WHOLE else Status.PARTLY

    def _compose_sentence(self, index: tuple[int, ...]) -> str:
        default: tuple[str, ...] = ()
        if not self.twist.size:
            moves = self.velocity.any()
            text = "A step of the soft tasks" if moves else "No motion: a step of soft tasks alone"
        elif self.success:
            text = "The wanted motion in full"
        else:
            none = "Nothing of the wanted motion" if self.velocity.any() else "No motion"
            text = f"{self.fraction:.3g} of the wanted motion" if self.fraction > 0.0 else none
            default = self.default_speed
        declared = self.system._mechanism.constraints
        why = [declared[name].of.prevents.format(name=name) for name in self.blocked_by]
        limited = [name for name in self.saturated if name not in self.default_speed]
        beyond = pack_one_sided_rows(self.system).list_violated_names(self.q) if limited else []
        outside = [name for name in limited if name in beyond]
        if inside := [name for name in limited if name not in outside]:
            why.append(f"at a limit: {', '.join(map(repr, inside))}")
        if outside:
            why.append(f"outside its limits, moved no further out: {', '.join(map(repr, outside))}")
        if self.held_apart and not (self.success and self.twist.size):
            said = ", ".join(f"{a!r} and {b!r}" for a, b in self.held_apart)
            why.append(f"kept apart: {said}")
        if default:
            sliding = from_metres(SLIDING, self.system.unit)
            why.append(
                f"at the default speed (pi rad/s, {sliding:.3g} {self.system.unit}/s): "
                f"{', '.join(map(repr, default))}"
            )
        if not (why or self.success) and self.twist.size:
            why.append("slowed: a singular configuration or a limit is near, or dt is long")
        return f"{text}: {'; '.join(why)}" if why else text

    def _select_claimed_rows(self) -> np.ndarray:
        return np.array(False)  # a step is of first order: how far it leads away is its residual


@explain_errors
def ik_step(
    system: Model,
    q: Any,
    wanted: Any,
    frame: FrameLike | None = None,
    dt: float = 0.0,
    *,
    velocity_limits: Any = None,
    damping: float = 0.05,
    keep_direction: bool = False,
    weights: Any = None,
) -> IkStep:
    """Compute velocities for a twist, a pose or tasks, within all limits; see `System.ik_step`."""
    q = read_q(system, q)
    if q.ndim != 1:
        raise InputError(f"q has shape {q.shape}; it must be one configuration ({system.nq},)")
    if not 0.0 < dt < math.inf:
        raise InputError(f"dt is {dt!r}; it must be a positive time in seconds, such as dt=0.01")
    if not 0.0 <= damping < math.inf:
        raise InputError(f"damping is {damping!r}; it must be a number, at least 0")
    speed = (
        list_speed_limits(system)
        if velocity_limits is None
        else _parse_numbers(velocity_limits, system.nv, "velocity_limits")
    )
    default = velocity_limits is None
    w = _parse_numbers(weights, 6, "weights", True) if weights is not None else None
    if frame is None:
        if keep_direction or w is not None:
            raise InputError(
                "keep_direction and weights are for the twist of a frame; tasks have weights of "
                "their own"
            )
        steps = bind_call(system, "ik_step", None, lambda: TaskSteps(system))
        return steps.take_step(q, wanted, dt, speed, default, damping)
    name = system.structure.frame_name(frame)
    constrained = (
        has_velocity_constraints(system)
        or find_obstacle(system, name)
        or pack_one_sided_rows(system).declared
    )
    if system.unit != METRE and (constrained or _has_slides(system, name)):
        motion = _parse_motion(wanted)
        options = {"damping": damping, "keep_direction": keep_direction, "weights": w}
        step = _take_step_in_metres(
            system, q, motion, name, dt, None if default else speed, options
        )
        if step is not None:
            return step
    if constrained:
        return _make_constrained_step(
            system, q, wanted, name, dt, speed, default, damping, keep_direction, w
        )
    bound = bind_call(system, "ik_step", name, lambda: BoundStep(system, name))
    return bound.take_step(
        q,
        _parse_motion(wanted),
        dt,
        np.ascontiguousarray(speed),
        damping,
        keep_direction,
        w,
        default,
    )


class BoundStep:
    """`ik_step` of one frame that its own chain moves, with all look-ups done once."""

    def __init__(self, system: Model, frame: str):
        self.system = system
        self.frame = frame
        chain = find_chain(system, frame)
        n = len(chain.v_index)
        rows = get_row_integers(chain.ints)
        place = {int(r[V_INDEX]): int(r[Q_INDEX]) for r in rows if r[KIND] != BALL}
        balls = sorted({(int(r[Q_INDEX]), int(r[V_INDEX])) for r in rows if r[KIND] == BALL})
        plain = len(rows) == n and not balls and (rows[:, V_INDEX] == np.arange(n)).all()
        head = (len(chain.q_index), n, len(balls), system.nq, system.nv, int(plain))
        self.ints = np.concatenate(
            [
                head,
                chain.q_index,
                chain.v_index,
                [place.get(k, -1) for k in range(n)],
                [i for i, _ in balls],
                [k for _, k in balls],
                chain.ints,
            ]
        ).astype(np.int64)
        turns = system.structure.coordinates.angular[chain.v_index]
        slides = [k in place and not turns[k] for k in range(n)]
        # a system with slides is converted to metres, unless it cannot be: see `_take_step_in_metres`
        metre = 1.0 if any(slides) else from_metres(1.0, system.unit)
        self.units = np.append(np.full(3, 1.0 / metre), np.ones(3))
        """Weights (6,) of a twist that count 1 m as 1 rad."""
        self.usual = NONE if metre == 1.0 else self.units
        reach = min((b.largest for b in chain.bounds), default=math.inf) / metre
        self.near = NEAR * min(1.0, reach) if reach > 0.0 else NEAR
        """Singular values to be damped: metres, so less where the whole chain is shorter than
        one."""
        length = compute_characteristic_length(system)
        self.floats = np.concatenate(
            [
                [self.near],
                [metre / length] * 3,
                [1.0] * 3,
                np.where(slides, length, 1.0),
                system.lower[chain.v_index],
                system.upper[chain.v_index],
                chain.floats,
            ]
        )
        names = system.structure.velocity_names
        self.names = [names[int(i)] for i in chain.v_index]
        self.speed = list_speed_limits(system)
        self.new = make_allocator(system.nq + system.nv + ANSWER + n)
        self.compute = servo_step.compute_frame_step

    def __reduce__(self) -> tuple[Any, ...]:
        return BoundStep, (self.system, self.frame)

    def __call__(
        self,
        q: Any,
        wanted: Any,
        dt: Any,
        velocity_limits: Any,
        damping: Any,
        keep_direction: bool,
    ) -> IkStep | None:
        """Return the step of a plain call; None where arguments have to be looked at."""
        if q.__class__ is not np.ndarray or velocity_limits.__class__ not in PLAIN:
            return None
        if wanted.__class__ is not np.ndarray:
            if wanted.__class__ is not list or len(wanted) != 6:
                return None
            wanted = np.array(wanted)
            if wanted.dtype != np.float64 or wanted.shape != (6,):  # text, truth values, masks
                return None
        elif wanted.shape == (4, 4):
            wanted = wanted.reshape(16)
        elif wanted.shape != (6,):
            return None
        if velocity_limits is None:
            speed = self.speed
        elif velocity_limits >= 0.0:
            speed = np.array([velocity_limits], dtype=np.float64)
        else:
            return None
        if not (0.0 < dt < math.inf and 0.0 <= damping < math.inf):
            return None
        out = self.new()
        try:
            count = self.compute(
                self.ints,
                self.floats,
                q,
                wanted,
                speed,
                self.usual,
                dt,
                damping,
                keep_direction,
                out,
            )
        except (TypeError, ValueError):
            return None
        return None if count < 0 else self.make_answer(out, count, velocity_limits is None)

    def take_step(
        self,
        q: Array,
        wanted: Array,
        dt: float,
        speed: Array,
        damping: float,
        keep_direction: bool,
        weights: Array | None,
        default: bool,
    ) -> IkStep:
        """Take a step with arguments that were looked at."""
        out = self.new()
        w = self.usual if weights is None else np.ascontiguousarray(weights * self.units)
        x = np.ascontiguousarray(wanted).reshape(-1)
        q = np.ascontiguousarray(q)
        count = self.compute(
            self.ints,
            self.floats,
            q,
            x,
            speed,
            w,
            float(dt),
            float(damping),
            bool(keep_direction),
            out,
        )
        if count < 0:
            refuse_bad_configuration(self.system, q)
        return self.make_answer(out, count, default)

    def make_answer(self, out: Array, count: int, default: bool) -> IkStep:
        """Make the answer of what the kernel wrote, with `count` velocities at a limit."""
        end = self.system.nq + self.system.nv
        return _make_answer(
            self.system,
            out,
            out[end : end + 6],
            out.item(end + FRACTION),
            _select_limited(self.names, out[end + ANSWER :]) if count else (),
            default,
        )


class BoundTaskStep:
    """`ik_step` of tasks of one structure, with their weights and priorities."""

    def __init__(self, problem: Demands):
        packed = problem.packed
        system = problem.system
        self.system = system
        self.loops = packed.loops
        levels, strengths, *_ = problem.levels
        counts = [len(t.row_names) for t in packed.loops.ties]
        level, hard = np.repeat(levels.reshape(2, -1), counts, axis=1)
        level = np.where(packed.rows >= 0, level, 0)
        low, high = packed.loops.bounds
        equal = low == high
        last = int(level.max(initial=0))
        is_hard = [bool(hard[level == k].all()) for k in range(last + 1)]
        rates = int((equal & (level > 0) & (hard == 1)).sum())
        layout = system.structure.layout
        q_of = np.full(system.nv, -1)
        q_of[layout.vector_v] = layout.vector_q
        self.rates = rates
        self._levels = level, equal, is_hard
        self._places = np.concatenate([q_of, layout.quaternion_q, layout.quaternion_v])
        self._balls = len(layout.quaternion_q)
        self._orders: dict[int, np.ndarray] = {}
        self.scale = packed.scale
        self.numbers = np.concatenate(
            [
                packed.scale,
                system.lower,
                system.upper,
                np.repeat(np.sqrt(strengths[:, 0]), counts),
                low,
                high,
            ]
        )
        self.new = make_allocator(system.nq + 2 * system.nv + 1 + rates)

    def _find_order(self, near: int) -> np.ndarray:
        """Return the order of the levels, of which `near` rows of near bodies are the first."""
        found = self._orders.get(near)
        if found is not None:
            return found
        level, equal, is_hard = self._levels
        first = int(near > 0)
        made = np.concatenate(
            [
                [len(is_hard) - 1 + first, self._balls, self.rates],
                np.where(level > 0, level + first, 0),
                np.full(near, 1),
                equal,
                np.full(near, 0),
                is_hard[:1],
                np.full(first, 1),
                is_hard[1:],
                self._places,
            ]
        ).astype(np.int64)
        return store_answer(self._orders, near, made, KEPT)

    def take_step(
        self,
        pins: Array,
        q: Array,
        dt: float,
        speed: Array,
        damping: float,
        default: bool,
        near: NearRows | None,
    ) -> IkStep | None:
        """Take a step towards the goals in `pins` (k,); None where these or q are none."""
        system = self.system
        loops = self.loops
        out = self.new()
        count = task_step.compute_task_step(
            loops.ints,
            loops.floats,
            loops.plan,
            loops.weights,
            pins,
            self._find_order(0 if near is None else len(near.least)),
            self.numbers,
            NONE if near is None else near.pack(self.scale, dt),
            q,
            speed,
            dt,
            damping,
            out,
        )
        if count < 0:
            return None
        end = system.nq + system.nv
        rates = end + 1 + system.nv
        names = system.structure.velocity_names
        return _make_answer(
            system,
            out,
            out[rates:],
            out.item(end),
            _select_limited(names, out[end + 1 : rates]) if count else (),
            default,
        )


class BoundTasks:
    """Tasks of a step with what is prepared for them: the step of their structure, and their goals.

    There are no `pins` where the kernel takes no step.
    """

    def __init__(self, system: Model, wanted: Any, q: Array, tasks: tuple[Task, ...]):
        from kempe.inverse.tasks.search import pack_tasks

        self.packed = pack_tasks(system, tasks, False)
        key = BoundTaskStep, *((t.priority, t.weight) for t in tasks)
        self.step: BoundTaskStep | None = self.packed.stages.get(key)
        if self.step is None and _is_open(self.packed):
            if not find_leading_shape([t.goal for t in tasks]):
                made = BoundTaskStep(make_step_problem(system, wanted, q))
                self.step = store_answer(self.packed.stages, key, made, KEPT)
        self.set_goals(tasks)

    def set_goals(self, tasks: tuple[Task, ...]) -> BoundTasks:
        """Pack the goals of tasks of the same structure."""
        self.tasks = tasks
        goals = [t.goal for t in tasks]
        single = self.step is not None and not find_leading_shape(goals)
        self.pins = self.packed.pack_pins(goals)[0] if single else None
        return self

    def find_tasks(self, tasks: tuple[Task, ...]) -> BoundTasks | None:
        """Return what is prepared for tasks; None where their structure is another."""
        if self.tasks == tasks:
            return self
        if [t.structure for t in self.tasks] != [t.structure for t in tasks]:
            return None
        return copy.copy(self).set_goals(tasks)  # another thread may still read this one


class TaskSteps:
    """`ik_step` of tasks, with what is prepared for the last of each label."""

    def __init__(self, system: Model):
        from kempe.inverse.tasks.search import make_distinct_tasks

        self.system = system
        self.speed = list_speed_limits(system)
        self._make_tasks = make_distinct_tasks
        self._bound: dict[tuple[str, ...], BoundTasks] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return TaskSteps, (self.system,)

    def __call__(
        self,
        q: Any,
        wanted: Any,
        dt: Any,
        velocity_limits: Any,
        damping: Any,
        keep_direction: bool,
    ) -> IkStep | None:
        """Return the step of a plain call; None where arguments have to be looked at."""
        if (
            q.__class__ is not np.ndarray
            or q.shape != (self.system.nq,)
            or q.dtype != np.float64
            or velocity_limits.__class__ not in PLAIN
            or keep_direction
            or not (0.0 < dt < math.inf and 0.0 <= damping < math.inf)
        ):
            return None
        default = velocity_limits is None
        if default:
            speed = self.speed
        elif velocity_limits >= 0.0:
            speed = np.full(self.system.nv, velocity_limits, dtype=np.float64)
        else:
            return None
        given = wanted if wanted.__class__ is list else [wanted]
        if any([isinstance(t, Apart) for t in given]):
            return None
        try:
            with np.errstate(all="ignore"):
                return self.take_kernel_step(
                    np.ascontiguousarray(q), given, dt, speed, default, damping
                )
        except FOREIGN:
            return None

    def take_step(
        self,
        q: Array,
        wanted: Any,
        dt: float,
        speed: Array,
        default: bool,
        damping: float,
        near: NearRows | None = None,
    ) -> IkStep:
        """Take a step with arguments that were looked at.

        Bodies at `near` keep apart, before all tasks.
        """
        given = list(wanted) if is_sequence(wanted) else [wanted]
        if any(isinstance(t, Apart) for t in given):
            from kempe.inverse.clear_step import make_clear_step

            return make_clear_step(
                self.system,
                q,
                given,
                dt,
                (dt, speed.tobytes(), default, damping),
                speed,
                lambda x, tasks, near: self.take_step(x, tasks, dt, speed, default, damping, near),
            )
        answer = self.take_kernel_step(
            np.ascontiguousarray(q), wanted, dt, np.ascontiguousarray(speed), default, damping, near
        )
        if answer is not None:
            return answer
        return _make_constrained_step(
            self.system, q, wanted, None, dt, speed, default, damping, False, None, near
        )

    def take_kernel_step(
        self,
        q: Array,
        wanted: Any,
        dt: float,
        speed: Array,
        default: bool,
        damping: float,
        near: NearRows | None = None,
    ) -> IkStep | None:
        """Take a step in one kernel call; None where loops or declared constraints hold, and for
        goals that are none: the general way says why.
        """
        tasks = self._make_tasks(wanted, self.system)
        labels = tuple([t.label for t in tasks])
        kept = self._bound.get(labels)
        bound = None if kept is None else kept.find_tasks(tasks)
        if bound is None or bound is not kept:
            bound = bound or BoundTasks(self.system, wanted, q, tasks)
            store_answer(self._bound, labels, bound, KEPT)
        if bound.pins is None or bound.step is None:
            return None
        return bound.step.take_step(bound.pins, q, float(dt), speed, float(damping), default, near)


def _has_slides(system: Model, frame: str) -> bool:
    """Return whether a joint of the chain that moves the frame slides."""
    return not system.structure.coordinates.angular[find_chain(system, frame).v_index].all()


def _take_step_in_metres(
    system: Model,
    q: Array,
    wanted: Array,
    frame: str,
    dt: float,
    speed: Array | None,
    options: dict[str, Any],
) -> IkStep | None:
    """Take the step of the same system in metres; None if the system cannot be converted.

    Velocities of slides and angles are weighed against each other there, 1 m against 1 rad, so that
    the step does not depend on the unit.
    """
    try:
        metres = convert_system_to_metres(system)
    except InputError:  # a Python function has its own unit
        return None
    unit = METRES[system.unit]
    motion = wanted.copy()
    linear = (slice(3),) if motion.ndim == 1 else (slice(3), 3)
    motion[linear] = scale_lengths(motion[linear], unit)
    fastest = None if speed is None else metres.convert_v(speed)
    own = metres.read_q(q)
    found = ik_step(metres.system, own, motion, frame, dt, velocity_limits=fastest, **options)
    twist = found.twist.copy()
    twist[:3] = scale_lengths(twist[:3], 1 / unit)
    after = metres.write_q(found.q)
    # rounding of the conversion must not lead out of the limits
    at, v = system.structure.layout.vector_q, system.structure.layout.vector_v
    low, high = np.minimum(system.lower[v], q[at]), np.maximum(system.upper[v], q[at])
    after[at] = np.clip(after[at], low, high)
    return replace(
        found,
        q=after,
        velocity=metres.write_v(found.velocity),
        twist=twist,
        system=system,
    )


def _is_open(packed: Packed) -> bool:
    """Whether the kernel takes steps of tasks: no loops, declared constraints, Python functions."""
    return not (
        packed.closed
        or packed.one_sided.declared
        or has_velocity_constraints(packed.system)
        or any(t.function is not None for t in packed.loops.ties)
    )


def _make_answer(
    system: Model,
    out: Array,
    twist: Array,
    fraction: float,
    saturated: tuple[str, ...],
    default: bool,
) -> IkStep:
    """Make the answer of a kernel that wrote q and velocities to `out`; `default` says whether the
    call gives no speed limits.
    """
    velocity = out[system.nq : system.nq + system.nv]
    answer = object.__new__(IkStep)
    fields = answer.__dict__  # one by one: a frozen class takes longer
    fields["q"] = out[: system.nq]
    fields["velocity"] = velocity
    fields["twist"] = twist
    fields["fraction"] = fraction
    fields["saturated"] = saturated
    fields["system"] = system
    if saturated and default:
        fields["default_speed"] = _select_default_speeds(system, saturated, velocity)
    return answer


def _select_limited(names: Sequence[str], limited: Array) -> tuple[str, ...]:
    """Select the names of velocities that a kernel marks as limited (n,)."""
    return tuple([name for name, at in zip(names, limited.tolist(), strict=True) if at])


def _select_default_speeds(
    system: Model, saturated: tuple[str, ...], velocity: Array
) -> tuple[str, ...]:
    """Select the saturated coordinates that move at a default speed."""
    defaults = _list_default_speeds(system)
    return tuple(
        [
            name
            for name in saturated
            if name in defaults and abs(velocity[defaults[name][0]]) >= defaults[name][1]
        ]
    )


@keep_answers
def _list_default_speeds(system: Model) -> dict[str, tuple[int, float]]:
    """List velocity and least saturated speed of each coordinate that has a default speed limit."""
    speeds = list_speed_limits(system).tolist()
    given = system.structure.velocity_limits.tolist()
    return {
        name: (i, speeds[i] * (1.0 - BESIDE))
        for i, name in enumerate(system.structure.velocity_names)
        if not math.isfinite(given[i])
    }


def _make_constrained_step(
    system: Model,
    q: Array,
    wanted: Any,
    frame: str | None,
    dt: float,
    speed: Array,
    default: bool,
    damping: float,
    direction: bool,
    weights: Array | None,
    near: NearRows | None = None,
) -> IkStep:
    """Make a step for a frame, or for tasks, while loops and relations stay closed."""
    if not np.isfinite(q).all():
        refuse_bad_configuration(system, q)
    closed = make_constrained_steps(system)
    at, J, asked = _read_wanted_motion(
        system, closed, q, wanted, frame, dt, np.ones(6) if weights is None else weights, near
    )
    low, high = closed.compute_velocity_bounds(q, dt, speed)
    slow = SLOW * float((speed / closed.scale).min(initial=math.inf))
    law = (
        closed.make_twist_step
        if frame is not None and np.ndim(wanted) == 1
        else closed.make_goal_step
    )

    case = (
        asked,
        dt,
        speed.tobytes(),
        damping,
        direction,
        None if weights is None else weights.tobytes(),
    )

    def compute_step(x: Array) -> tuple[Array, Array, bool]:
        if closed.upcoming[0] == (case, x.tobytes()):
            return closed.upcoming[1]
        return law(
            x,
            at(x),
            *closed.compute_velocity_bounds(x, dt, speed),
            damping,
            direction,
            dt,
            at,
            slow,
        )

    def compute_velocity_after(part: float) -> Array:
        there = after if part == 1.0 else closed.take_step(q, part * u, dt, low, high)[0]
        found = compute_step(there)
        closed.upcoming = (case, there.tobytes()), found
        return found[1]

    stages = at(q)
    (after, u, calm) = compute_step(q)
    if (
        not calm
        and (part := find_steady_fraction(compute_velocity_after, u, speed / closed.scale)) < 1.0
    ):
        after, u = closed.take_step(q, part * u, dt, low, high)
    velocity = u * closed.scale
    beside = BESIDE * np.maximum(1.0, np.abs(u))
    limited = ((u <= low + beside) | (u >= high - beside)).nonzero()[0]
    requested = np.concatenate([NONE, *(s.b for s in stages if s.hard)])
    had = np.concatenate([NONE, *(s.A @ u for s in stages if s.hard)])
    twist = had if frame is None else J @ velocity
    names = tuple(system.structure.velocity_names[int(i)] for i in limited)
    part = _compute_fraction(had, requested, dt)
    blocked = (
        closed.find_blocking_constraints(q, stages, u, low, high)
        if part < WHOLE and closed.rolls
        else ()
    )
    return IkStep(
        after,
        velocity,
        twist,
        part,
        names,
        system,
        _select_default_speeds(system, names, velocity) if default else (),
        blocked,
    )


def _read_wanted_motion(
    system: Model,
    closed: ConstrainedSteps,
    q: Array,
    wanted: Any,
    frame: str | None,
    dt: float,
    weights: Array,
    near: NearRows | None,
) -> tuple[Callable[[Array], list[Stage]], Array, tuple[Any, ...]]:
    """What is required at configurations (..., nq), as a function of them; the Jacobian (6, nv) of
    the frame, if any; and all that the function depends on, for comparisons.
    """

    if frame is None:
        problem = make_step_problem(system, wanted, q)
        levels, strengths, *_ = problem.levels
        asked = (
            problem.packed,
            problem.pins.tobytes(),
            np.asarray(levels).tobytes(),
            np.asarray(strengths).tobytes(),
            None if near is None else near.pack(closed.scale, dt).tobytes(),
        )
        return StageMaker(problem, dt, near), NONE, asked
    goal = _parse_motion(wanted)
    pose_of = find_query(system, frame)

    def make_stages(x: Array) -> list[Stage]:
        pose, J = pose_of.pose_and_jacobian(x)
        if goal.ndim == 1:
            return [closed.make_twist_stage(J, np.broadcast_to(goal, (*x.shape[:-1], 6)), weights)]
        place = goal[:3, 3] - pose[..., :3, 3]
        turn = log_so3(goal[:3, :3] @ np.swapaxes(pose[..., :3, :3], -1, -2))
        missing = np.concatenate([place, turn], axis=-1)
        return [closed.make_twist_stage(J, missing / dt, weights)]

    return make_stages, pose_of.jacobian(q), (frame, goal.tobytes())


def make_step_problem(system: Model, wanted: Any, q: Array) -> Demands:
    """Check and pack the tasks of one step.

    Errors: `InputError` for a batch, and for goals that are none.
    """
    from kempe.inverse.tasks.search import make_demands

    problem, _ = make_demands(system, wanted, q)
    if problem.lead:
        raise InputError(
            f"the goals have the leading shape {problem.lead}; one step has one goal for each task"
        )
    for task, goals in zip(problem.tasks, problem.goals, strict=True):
        refuse_goal(goals, task.label)
    return problem


def _compute_fraction(had: Array, requested: Array, dt: float) -> float:
    """Compute which fraction of the requested motion is achieved."""
    square = float(requested @ requested)
    return float(requested @ had) / square if square * dt * dt > REACHED * REACHED else 1.0


def _parse_motion(wanted: Any) -> Array:
    """Parse the requested twist (6,) or pose (4, 4)."""
    x = read_reals(
        read_pose_array(wanted, "the wanted motion"),
        "the wanted motion",
        "a twist (6,) or a pose (4, 4)",
    )
    good = x.shape == (6,) and math.isfinite(x.dot(x))
    if x.shape == (4, 4) and not (good := _is_pose(x)):
        x = correct_rotations(x, "the wanted motion")
        good = _is_pose(x)
    if not good:
        raise InputError(
            f"the wanted motion has shape {x.shape}; it must be a twist (6,), the linear velocity "
            "first, or a pose (4, 4), finite, the rotation of a pose orthonormal with determinant +1"
        )
    return x


def _is_pose(x: Array) -> bool:
    R = x[:3, :3]
    off = math.fsum(np.abs((R @ R.T - EYE).ravel())) + abs(float(x[3, 3]) - 1.0)
    return off < SKEW and math.isfinite(x[:3, 3].sum()) and float(R[2] @ np.cross(R[0], R[1])) > 0.0


@keep_answers
def list_speed_limits(system: Model) -> Array:
    """List the largest speeds (nv,) of steps, in rad/s and units of length per second.

    They are the system's velocity limits, else `TURNING` and `SLIDING`.

    The defaults hold for coupled joints too: a coordinate is so slow that none of its followers
    exceeds them.
    """
    table = remove_cut_marks(system).structure.table
    given = system.structure.velocity_limits
    sliding = from_metres(SLIDING, system.unit)
    usual = np.where(system.structure.coordinates.angular, TURNING, sliding)
    for kind, v, m in zip(
        table.kind.tolist(), table.iv.tolist(), table.multiplier.tolist(), strict=True
    ):
        if kind != BALL:
            usual[v] = min(usual[v], (TURNING if kind == TURN else sliding) / abs(m))
    return np.where(np.isfinite(given), given, usual)


def _parse_numbers(x: Any, n: int, what: str, finite: bool = False) -> Array:
    try:
        out = np.broadcast_to(read_reals(x, what, f"a number or ({n},) numbers"), (n,))
    except InputError:
        raise
    except ValueError:
        out = np.full(1, np.nan)
    if not (out >= 0.0).all() or (finite and not np.isfinite(out).all()):
        raise InputError(
            f"{what} is {x!r}; it must be a number or ({n},) numbers, none "
            f"negative{' or infinite' if finite else ''}"
        )
    return out
