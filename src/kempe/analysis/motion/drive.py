"""Inputs that follow given time courses: the mechanism moves along, never jumping to another
branch.

Between two samples the inputs move on a straight line, and the configuration is continued along it
as a curve in configurations and length of that line. So a change point is passed straight on at any
number of samples, and where the inputs ask for more than the mechanism can do the curve turns back:
a toggle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.analysis.continuation.beginning import (
    angle_or_slide,
    begin,
    longest_step,
    periods,
    start_of,
    why_open,
    wish_of,
)
from kempe.analysis.continuation.continuation import Closure
from kempe.analysis.continuation.one_sided_ends import OneSidedEnds
from kempe.analysis.continuation.path import Event, Motion
from kempe.analysis.motion.input_segments import SegmentContext, State, Stuck
from kempe.analysis.motion.motion import Progress
from kempe.analysis.motion.rolling_drive import RollingSamples, driven
from kempe.budget import Budget, Usual
from kempe.calls import explained, explained_methods, flag, interruptible, until_interrupt
from kempe.constraints.tape import TIME
from kempe.errors import InputError
from kempe.kinematics.common.tabular import write_table
from kempe.kinematics.configuration import as_q, home_of, refuse_wound_angle
from kempe.model.clocked import clocked, timed
from kempe.reals import is_mapping, reals, within_range
from kempe.solvers.assembly.ideal import tolerant
from kempe.solvers.common.clock import BROKEN_OFF, LONG, TimeLimit, TimeUp, time_limited, time_of
from kempe.solvers.common.slip import rolls
from kempe.solvers.dyads.held import held_at
from kempe.spatial import Array
from kempe.status import Status
from kempe.words import InWords, counted

if TYPE_CHECKING:
    from kempe.model.system import FrameLike, System

USUAL = Usual("drive", step=None, time_limit=LONG, progress=None)
CONTINUOUS = 1e-5
"""Distance between the pose that was held and the one from which it goes on, above which that is a
jump."""
BETWEEN = 0.2
"""Change of an input between two samples above which a function is evaluated in between, too."""
MOST_PARTS = 200
"""Values in between two samples for which a function is evaluated at most."""


def _samples_text(first: int, last: int) -> str:
    """'sample 3', 'samples 3 to 5'."""
    return f"sample {first}" if first == last else f"samples {first} to {last}"


@dataclass(frozen=True, eq=False)
class Toggle(InWords):
    """Samples `first` to `last`, whose inputs cannot be reached: `q` (nq,) is held there, for this
    `reason`.
    """

    first: int
    last: int
    q: Array
    inputs: dict[str, float]
    reason: str

    def __str__(self) -> str:
        at = ", ".join(f"{k!r} = {v:.9g}" for k, v in self.inputs.items())
        return f"{_samples_text(self.first, self.last)}: held at {at}: {self.reason}"


@explained_methods
@dataclass(frozen=True, eq=False)
class Drive(Motion):
    """The motion of a mechanism whose inputs were prescribed.

    `q` (n, nq) are closed configurations, one for each sample of `times` (n,); `inputs` the values
    requested. Where `held` (n,) the inputs cannot be reached and the last pose stays: see
    `toggles`. `jumps` are (index, distance) of samples at which the motion is not continuous: it
    went on from elsewhere than it was held. `singular_points` are the change points passed,
    straight on. Where the work was `interrupted`, or the time limit came (`late`), these are the
    samples that were done.
    """

    also = ("times", "inputs", "held", "jumps", "interrupted", "late")

    system: System
    q: Array
    times: Array
    inputs: dict[str, Array]
    held: Array
    toggles: tuple[Toggle, ...]
    jumps: tuple[tuple[int, float], ...]
    singular_points: tuple[Event, ...]
    success: bool
    interrupted: bool
    reason: str = field(default="", repr=False)
    late: bool = False
    _clock: Array | None = field(default=None, repr=False)
    """Time (n,) at which each configuration holds, where equations depend on time: of those `held`
    an earlier one."""

    def __repr__(self) -> str:
        return (
            f"Drive({self.system.name!r}, {counted(len(self.q), 'sample')}, "
            f"held={int(self.held.sum())})"
        )

    def table(self, frames: Iterable[FrameLike] = ()) -> tuple[list[str], Array]:
        """Names and columns (n, k) for a file: time, all coordinates, whether held, x, y (and z) of
        frames.
        """
        names, columns = self._columns("time", self.times, frames)
        return [*names, "held"], np.column_stack([columns, self.held])

    def save(self, path: str | FilePath, frames: Iterable[FrameLike] = ()) -> FilePath:
        """Write the `table` with these frames to a .csv or .npy file; returns the path. Errors:
        `InputError`.
        """
        return write_table(path, *self.table(frames))

    @property
    def code(self) -> Status:
        """The outcome: `PARTLY` where inputs cannot be reached, or it jumps."""
        return (
            Status.SOLVED
            if self.success
            else self._broken_off()
            or (Status.NOT_FOUND if self.reason and len(self) < 2 else Status.PARTLY)
        )

    def _when(self) -> Any:
        return 0.0 if self._clock is None else self._clock

    def _goals(self) -> Sequence[tuple[Any, Any, Any]]:
        """The inputs, of samples that are not held, where they belong to coordinates."""
        own = [] if self.reason else [n for n in self.inputs if n in self.system.coordinate_names]
        return held_at(
            self.system, {n: np.where(self.held, self.values(n), self.inputs[n]) for n in own}
        )

    def _sentence(self, index: tuple[int, ...]) -> str:
        if self.reason:
            return self.reason
        text = (
            f"{counted(len(self), 'sample')}, {counted(len(self.singular_points), 'change point')} "
            "passed"
        )
        if self.toggles:
            count = int(self.held.sum())
            text += (
                f"; at {counted(count, 'sample')} the inputs cannot be reached and the last pose "
                "is held"
            )
        if self.jumps:
            text += f"; it jumps at samples {', '.join(str(k) for k, _ in self.jumps)}"
        return text + self._partial()

    def _notes(self) -> Sequence[str]:
        lines = [str(toggle) for toggle in self.toggles]
        lines += [
            f"sample {k}: it goes on {size:.6g} away from where it was held"
            for k, size in self.jumps
        ]
        return [*lines, *super()._notes()]


def _not_begun(
    time: TimeLimit,
    system: System,
    inputs: Mapping[str, Any],
    times: Any = None,
    start: Any = None,
    **_: Any,
) -> Drive:
    """The motion where the time was up before a closed configuration was known: it stays where
    `start` is, or home.
    """
    near = (
        home_of(system)
        if start is None or isinstance(start, str) or is_mapping(start)
        else as_q(system, start)
    )
    clock, samples = _samples(inputs, times)
    requested = {n: np.array([v]) for n, v in zip(inputs, samples(0, 1)[-1].tolist(), strict=True)}
    said = (
        f"nothing was driven: {time.reason(TimeUp())} came before a closed configuration was known"
    )
    return Drive(
        system,
        near[None],
        clock[:1],
        requested,
        np.ones(1, dtype=bool),
        (),
        (),
        (),
        False,
        False,
        said,
        True,
    )


@explained
@interruptible
@time_limited(USUAL, _not_begun)
@tolerant()
def drive(
    system: System,
    inputs: Mapping[str, ArrayLike | Callable[[float], float]],
    times: ArrayLike | None = None,
    start: ArrayLike | Mapping[str, float] | str | None = None,
    *,
    hold: Mapping[str, float] | None = None,
    toward: Mapping[str, float] | None = None,
    limits: bool = True,
    tolerance: float | str | None = None,
    budget: Budget | None = None,
) -> Drive:
    """The motion that follows prescribed inputs, as a `Drive`: continuous, on the branch of
    `start`.

    `inputs` gives for each driven coordinate its values (n,) in radians or metres, one number, or a
    function of time, which needs `times` (n,), growing. Samples may be coarse: in between the
    motion is continued in steps of arc length. `start` is as in `trace` (default: the posture
    "closed", or what the first inputs give). It goes straight on through change points. `toward`
    gives rates by coordinate name that choose the branch if the start
    is a change point; otherwise the branch that moves least. Where the inputs ask for what the
    mechanism cannot do, or for what is beyond a limit, the last pose is held until they come back.
    Of the `budget` are read: step (0.1 at most), time_limit (600 s for the whole call),
    progress(sample, total), called now and then; the time limit leaves the samples that were done,
    Ctrl-C as the `answer` of an `Interrupted`.

    With velocity constraints, what is not driven rolls along (from the first values of the inputs
    on), and the motion ends before it slips: `status` says where; `toward` and the step do not
    count. Equations in time follow `times`.

    Errors: `UnsupportedError` where the inputs leave freedoms or fight each other;
    `UnknownNameError`; `InputError`.

    >>> from kempe import Mechanism
    >>> m = Mechanism("parallelogram", dim=2)
    >>> left, bar, right = m.body("left"), m.body("bar"), m.body("right")
    >>> _ = m.revolute("A", m.ground, left)
    >>> _ = m.revolute("B", left, bar, at=(1, 0))
    >>> _ = m.revolute("C", bar, right, at=(3, 0), child_at=(1, 0))
    >>> _ = m.revolute("D", m.ground, right, at=(3, 0))
    >>> motion = drive(m.build(), {"A": [0.0, 2.0, 4.0, 6.0]})
    >>> motion.values("D").round(9).tolist(), len(motion.singular_points)
    ([0.0, 2.0, 4.0, 6.0], 1)
    """
    if not isinstance(inputs, Mapping):
        raise InputError(
            f"inputs is {type(inputs).__name__}; it must be a dict of values by coordinate name"
        )
    flag(limits, "limits")
    spend = USUAL.of(budget)
    if timed(system):
        return _in_time(system, inputs, times, start, hold, toward, limits, budget)
    names = list(inputs)
    index = [angle_or_slide(system, n) for n in names]
    if hold and set(hold) & set(names):
        raise InputError(
            f"{sorted(set(hold) & set(names))} are both driven and held; a coordinate is one of "
            "them"
        )
    turning = system.structure.coordinates.turning
    angles = {n for n, i in zip(names, index, strict=True) if turning[i]}
    clock, samples = _samples(inputs, times, angles)
    longest = longest_step(spend.step)
    time = time_of(USUAL, budget)
    time.put_in_order()  # there is nothing to do afterwards
    if rolls(system):
        rolled = driven(system, names, dict(hold or {}), start, clock, samples, limits, time)
        return _rolled(rolled, system, names, clock, samples)
    first = dict(zip(names, samples(0, 1)[-1].tolist(), strict=True))
    closure, q = _begin(system, start, dict(hold or {}), first, index)
    if q is None:
        near = start_of(system, start, dict(hold or {}))
        requested = {n: np.array([v]) for n, v in first.items()}
        said = why_open(system, start, {**(hold or {}), **first})
        return Drive(
            system,
            near[None],
            clock[:1],
            requested,
            np.ones(1, dtype=bool),
            (),
            (),
            (),
            False,
            False,
            said,
        )
    closure.budget = time
    wish = wish_of(system, toward)
    context = SegmentContext(
        closure, index, longest, OneSidedEnds(closure, limits), wish / closure.unit
    )
    return _run(context, q, names, clock, samples, spend.progress)


def _in_time(
    system: System,
    inputs: Mapping[str, Any],
    times: Any,
    start: Any,
    hold: Any,
    toward: Any,
    limits: bool,
    budget: Budget | None,
) -> Drive:
    """The motion where equations depend on time, which is driven as a coordinate of its own."""
    if TIME in inputs and TIME not in system.coordinate_names:
        raise InputError(f"{TIME!r} is the time and no input; give it by `times`")
    clock, _ = _samples({**inputs, TIME: 0.0}, times)
    found = until_interrupt(
        drive,
        clocked(system),
        {**inputs, TIME: clock},
        clock,
        _with_time(system, start, clock),
        hold=hold,
        toward=toward,
        limits=limits,
        budget=budget,
    )
    return _without_time(found, system)


def _with_time(system: System, start: Any, clock: Array) -> Any:
    """The start with the first time, where it is a configuration."""
    if start is None or isinstance(start, str) or not clock.size:
        return start
    return (
        {**start, TIME: clock[0]}
        if is_mapping(start)
        else np.append(np.asarray(start, float), clock[0])
    )


def _without_time(found: Drive, system: System) -> Drive:
    """The motion in the coordinates of the system itself."""
    inputs = {n: x for n, x in found.inputs.items() if n != TIME}
    toggles = tuple(replace(toggle, q=toggle.q[:-1]) for toggle in found.toggles)
    events = tuple(replace(event, q=event.q[:-1]) for event in found.singular_points)
    return replace(
        found,
        system=system,
        q=found.q[:, :-1],
        inputs=inputs,
        toggles=toggles,
        singular_points=events,
        _clock=found.q[:, -1],
    )


def _rolled(
    found: RollingSamples | None,
    system: System,
    names: list[str],
    clock: Array,
    samples: Callable[[int, int], list[Array]],
) -> Drive:
    """The motion of what rolls, as an answer."""
    if found is None:
        found = RollingSamples(
            start_of(system, None, {})[None], "the loops do not close near the start", None
        )
    n = len(found.q)
    requested = np.array([samples(k, 1)[-1] for k in range(n)]).reshape(n, len(names))
    return Drive(
        system,
        found.q,
        clock[:n],
        {name: requested[:, j] for j, name in enumerate(names)},
        np.zeros(n, dtype=bool),
        (),
        (),
        (),
        not found.reason and found.broken is None,
        isinstance(found.broken, KeyboardInterrupt),
        found.reason,
        isinstance(found.broken, TimeUp),
    )


def _samples(
    inputs: Mapping[str, Any], times: ArrayLike | None, angles: Set[str] = frozenset()
) -> tuple[Array, Callable[[int, int], list[Array]]]:
    """The times (n,), and a function (k, parts) that gives the inputs on the way from sample k - 1
    to sample k.
    """
    if not inputs:
        raise InputError("there are no inputs; give values by coordinate name")
    functions = [n for n, f in inputs.items() if callable(f)]
    arrays = {n: _numbers(v, f"input {n!r}") for n, v in inputs.items() if not callable(v)}
    sizes = {a.shape[0] for a in arrays.values() if a.ndim == 1}
    if times is not None:
        clock = _numbers(times, "times")
    elif functions and not sizes:
        raise InputError(
            f"inputs {', '.join(map(repr, functions))} are functions of time; give the times"
        )
    else:
        clock = np.arange(float(max(sizes, default=1)))
    bad = [n for n, a in arrays.items() if a.ndim > 1 or (a.ndim == 1 and a.shape != clock.shape)]
    if not clock.size:
        raise InputError("there are no samples: times or inputs are empty")
    if clock.ndim != 1 or bad:
        raise InputError(
            f"times and inputs must be one number or {clock.shape} numbers; {', '.join(bad)} differ"
        )
    back = np.flatnonzero(~(np.diff(clock) > 0.0))
    if np.isfinite(clock).all() and len(back):
        k = int(back[0])
        raise InputError(
            f"times must grow from sample to sample: {clock[k + 1]:g} at sample {k + 1} comes "
            f"after {clock[k]:g}"
        )
    full = {n: np.broadcast_to(a, clock.shape) for n, a in arrays.items()}
    for name, a in {"times": clock, **{f"input {n!r}": a for n, a in full.items()}}.items():
        within_range(a, name)
    for n in angles & full.keys():
        refuse_wound_angle(float(np.abs(full[n]).max()), f"input {n!r}")

    def value(name: str, before: int, k: int, f: float) -> float:
        if name in functions:
            t = (1.0 - f) * clock[before] + f * clock[k]
            found = _numbers(inputs[name](t), f"input {name!r} at time {t:g}")
            if found.size != 1:
                raise InputError(
                    f"input {name!r} at time {t:g} has shape {found.shape}; it must be one number"
                )
            number = float(within_range(found, f"input {name!r} at time {t:g}").item())
            if name in angles:
                refuse_wound_angle(number, f"input {name!r} at time {t:g}")
            return number
        return float((1.0 - f) * full[name][before] + f * full[name][k])

    def at(k: int, parts: int) -> list[Array]:
        before = max(k - 1, 0)
        return [
            np.array([value(n, before, k, float(f)) for n in inputs])
            for f in np.linspace(0.0, 1.0, parts + 1)[1:]
        ]

    return clock, at


def _numbers(values: Any, subject: str) -> Array:
    return reals(values, subject, "numbers")


def _begin(
    system: System,
    start: Any,
    hold: dict[str, float],
    first: dict[str, float],
    index: Sequence[int],
) -> tuple[Closure, Array | None]:
    """The equations, and a closed configuration to begin with."""
    if start is None and "closed" not in system.structure.posture_names:
        start = first
    closure, q = begin(system, start, hold)
    if q is None:
        return closure, None
    u = q[closure.place[list(index)]]
    period = periods(system)[list(index)]
    gap = np.array(list(first.values())) - u
    turns = np.divide(gap, period, out=np.zeros_like(gap), where=period > 0.0)
    q[closure.place[list(index)]] += np.round(turns) * period
    return closure, q


def _run(
    context: SegmentContext,
    q: Array,
    names: list[str],
    clock: Array,
    samples: Callable[[int, int], list[Array]],
    progress: Progress | None,
) -> Drive:
    """The motion through all samples."""
    state = State(q, q[context.closure.place[context.index]])
    requested: list[Array] = []
    poses: list[Array] = []
    held: list[bool] = []
    toggles: list[Toggle] = []
    jumps: list[tuple[int, float]] = []
    stuck: Stuck | None = None
    last = state.u
    broken = None
    try:
        with context.closure.budget:
            for k in range(len(clock)):
                end = samples(k, 1)[-1]
                parts = (
                    int(np.ceil(np.abs((end - last) / context.unit).max() / BETWEEN)) if k else 1
                )
                single = (
                    len(names) == 1 or stuck is None
                )  # a way back in several inputs is looked for once a sample
                for u in samples(k, min(max(parts, 1), MOST_PARTS) if single else 1):
                    state, stuck, gap = context.follow(state, stuck, last, u, k)
                    last = u
                    if gap > CONTINUOUS:
                        jumps.append((k, gap))
                requested.append(end)
                poses.append(state.q if stuck is None else stuck.q)
                held.append(stuck is not None and not stuck.reached)
                if stuck is not None and not stuck.reached:
                    if toggles and toggles[-1].last == k - 1 and toggles[-1].q is stuck.q:
                        toggles[-1] = replace(toggles[-1], last=k)
                    else:
                        at = dict(zip(names, stuck.u.tolist(), strict=True))
                        toggles.append(Toggle(k, k, stuck.q, at, stuck.reason))
                if progress is not None and k % 16 == 0:
                    progress(k + 1, len(clock))
    except BROKEN_OFF as error:
        broken = error
    n = len(held)
    values = np.array(requested[:n]).reshape(n, len(names))
    return Drive(
        context.closure.system,
        np.array(poses[:n]).reshape(n, context.closure.system.nq),
        clock[:n],
        {name: values[:, j] for j, name in enumerate(names)},
        np.array(held[:n], dtype=bool),
        tuple(toggles),
        tuple(j for j in jumps if j[0] < n),
        tuple(context.singular),
        not (broken or any(held) or jumps),
        isinstance(broken, KeyboardInterrupt),
        late=isinstance(broken, TimeUp),
    )
