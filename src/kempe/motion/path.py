"""The answer of `trace`: a curve of configurations, with the special points on it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers.answer import Motion
from kempe.answers.tables import convert_columns, write_table
from kempe.answers.wording import describe_immovable_coordinates
from kempe.arguments import explain_method_errors, numbers, raise_interrupted
from kempe.arrays import is_whole
from kempe.budget import Budget, TimeUp, Usual
from kempe.equations.closure import Closure
from kempe.errors import InputError, format_value
from kempe.model.configurations import list_units, make_q_dict, make_ranges_table, shorten_turns
from kempe.motion.crossings import SingularNode
from kempe.numerics.clock import BROKEN_OFF, TIME_LIMIT, TimeLimit
from kempe.numerics.curves import BLUNT
from kempe.numerics.newton import run_many_gauss_newton
from kempe.report import Table
from kempe.spatial import Array
from kempe.words import InWords, Quantity, Unit, cut_lines, format_count

if TYPE_CHECKING:
    from kempe.model.model import FrameLike, Model


# ---- assembly modes that a path does not pass

# A mechanism that is built again may move on another branch.

MOST_SIGNS = 6
"""Dyads of mechanisms whose assembly modes are looked at: 64 modes, in some hundredths of a
second."""


def find_other_modes(path: Path) -> tuple[str, Array]:
    """Find assembly modes (k, nq) at the path's start that the path does not pass.

    Returned are the input, whose value all of them have, and the modes.

    They are looked for where they are in closed form, inside the limits. The input is the driver; a
    path that has none, or a driver that is not a coordinate, takes the first coordinate with which
    there are some. `held` coordinates stay. Of mechanisms of many dyads there are none.
    """
    from kempe.assemble.dyads import Incomplete, find_closed_form
    from kempe.assemble.modes import assembly_modes

    system = path.system
    nothing = ("", np.zeros((0, path.system.nq)))
    if not system.structure.closures or not path.success or len(path.track.s) < 2:
        return nothing
    start = make_q_dict(system, path.q[0])
    held = {name: start[name] for name in path.held}
    for name in [path.driver] if path.driver in start else start:
        plan = None if name in held else find_closed_form(system, (name, *held))
        if plan is not None and not isinstance(plan, Incomplete) and plan.signs <= MOST_SIGNS:
            modes = assembly_modes(system, {name: start[name], **held})
            others = [
                q
                for q in modes.q
                if not any(_may_pass_configuration(p, q) for p in (path, *path.others))
            ]
            if others:
                return name, np.array(others)
    return nothing


def _may_pass_configuration(path: Path, q: Array) -> bool:
    """Tell whether a path may pass q between two of its points."""
    track = path.track
    e = path.track.equations
    y = np.array([e.compute_difference(node, q) for node in track.q]) * e.unit
    turning = path.system.structure.coordinates.turning
    y = shorten_turns(y, turning) / e.unit
    return bool(np.linalg.norm(y, axis=1).min() <= np.diff(track.s).max())


# ---- the answer

MOST = 10**7
"""Points at most of a path that is resampled."""
USUAL = Usual("resample", time_limit=TIME_LIMIT, progress=None)
SLICE = 1024
"""Points that are closed at once."""
EVENTS = 24
"""Points where coordinates turn back that a text lists; the data have all."""


@dataclass(frozen=True, eq=False)
class Event(InWords):
    """Special point of a path.

    Attributes
    ----------
    q, s
        Configuration (nq,), and its arc length on the path.
    kind
        "fold of the driver" (the driver turns back: a dead point), "extreme" (another coordinate
        turns back), "bifurcation" (several branches meet), "cusp" (the motion comes to rest and
        returns beside its way) or "singular" (the rank drops, and no branch leaves).
    coordinate, value
        Coordinate that turns back, and its value in radians or metres.
    directions
        Velocities (k, nv) along the branches at a singular point; the first is along the path.
    complete
        Whether these are all branches that were looked for. Of very many only the first are found.
    nullity
        Number of independent first-order motions.
    """

    q: Array
    s: float
    kind: str
    coordinate: str = ""
    value: float = float("nan")
    nullity: int = 1
    directions: Array | None = field(default=None, repr=False)
    complete: bool = True
    node: SingularNode | None = field(default=None, repr=False)
    """The singular point as a node of the path, where branches touch or end in a cusp."""

    def __str__(self) -> str:
        return self.format_event({}, False)

    def format_event(self, unit: Mapping[str, str], degrees: bool) -> str:
        """Return a sentence on the event, with the value of its coordinate in its unit."""
        if self.coordinate:
            value = Quantity(self.value, unit.get(self.coordinate, "")).convert_units(degrees)
            shown = f"{value.value:.9g} {value.unit}".rstrip()
            return f"s = {self.s:.6g}: {self.kind}, {self.coordinate!r} = {shown}"
        lines = 0 if self.directions is None else len(self.directions)
        more = "" if self.complete else " or more"
        where = f", {lines} branches{more}" if lines > 1 else ""
        return f"s = {self.s:.6g}: {self.kind}{where}, {self.nullity} first-order motions"


@explain_method_errors
@dataclass(frozen=True, eq=False)
class Track:
    """The nodes of a computed path: configurations, arc lengths, unit tangents, and equations."""

    equations: Closure
    q: Array
    s: Array
    t: Array

    def evaluate_configurations(self, s: Array) -> Array:
        """Return configurations (k, nq) at arc lengths (k,) inside the track.

        They are cubic between nodes, and then closed exactly.
        """
        out = np.empty((len(s), self.q.shape[1]))
        for i in range(0, len(s), SLICE):
            out[i : i + SLICE] = self._close_configurations(s[i : i + SLICE])
        return out

    def _close_configurations(self, s: Array) -> Array:
        """Return closed configurations at some arc lengths."""
        if len(self.s) == 1:
            return np.repeat(self.q, len(s), axis=0)
        k = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 2)
        size = (self.s[k + 1] - self.s[k])[:, None]
        # a cusp is two nodes at one place
        u = (s - self.s[k])[:, None] / np.where(size > 0.0, size, 1.0)
        e = self.equations
        t = self.t
        y = e.compute_difference(self.q[k], self.q[k + 1])
        a = size * t[k]
        b = size * t[k + 1]
        x = e.move_point(
            self.q[k], u * (1 - u) ** 2 * a + u * u * (3 - 2 * u) * y - u * u * (1 - u) * b
        )
        across = (1 - u) * t[k] + u * t[k + 1]

        def evaluate_equations(x: Array, at: np.ndarray) -> tuple[Array, Array]:
            """Return residuals and Jacobians, with steps across the curve only."""
            F, J = e.evaluate_many_points(x)
            return np.append(F, np.zeros((len(F), 1)), axis=1), np.concatenate(
                [J, across[at, None]], axis=1
            )

        x = run_many_gauss_newton(evaluate_equations, x, 3, level=BLUNT, move=e.move_point)
        ends = np.flatnonzero((u[:, 0] <= 0.0) | (u[:, 0] >= 1.0))
        x[ends] = self.q[k[ends] + (u[ends, 0] >= 1.0)]
        return x


@explain_method_errors
@dataclass(frozen=True, eq=False, repr=False)
class Path(Motion):
    """Curve of closed configurations of a mechanism with one degree of freedom.

    Attributes
    ----------
    q
        Configurations (n, nq) in their order, in radians and metres. Angles are not wrapped.
    s
        Arc length (n,): angles in radians, slides in units of `unit_length` (metres).
    closed
        Whether the last point is the first one again, up to whole turns of angles without limits.
    ends
        Reasons why the path stops at its first and last point.
    turning_points, singular_points, extremes
        Special points, each an `Event`.
    success
        False if no configuration closes the loops, or if the work was ended early.
    late, interrupted
        Whether the time limit or Ctrl-C ended the work; `remark` says what else is missing.
    others
        Branches that ``trace(..., ways="branches")`` found at bifurcations.
    """

    _entries = (
        "s",
        "closed",
        "ends",
        "length",
        "turns",
        "driver",
        "held",
        "interrupted",
        "late",
        "hint",
    )

    q: Array
    s: Array
    closed: bool
    ends: tuple[str, str]
    turning_points: tuple[Event, ...]
    singular_points: tuple[Event, ...]
    extremes: tuple[Event, ...]
    driver: str | None
    held: tuple[str, ...]
    frames: tuple[str, ...]
    success: bool
    interrupted: bool
    track: Track
    others: tuple[Path, ...] = ()
    late: bool = False
    remark: str = ""

    @property
    def system(self) -> Model:
        """The system that moves."""
        return self.track.equations.system

    @property
    def length(self) -> float:
        """Arc length of the whole curve, in radians and slides of `unit_length`."""
        return float(self.s[-1]) if len(self.s) else 0.0

    @property
    def unit_length(self) -> float:
        """Length in metres of a slide that counts as one unit of arc length."""
        from kempe.model.characteristic_length import compute_characteristic_length

        return compute_characteristic_length(self.system)

    @property
    def turns(self) -> dict[str, int]:
        """Net number of whole turns of each turning coordinate along a closed path, by name."""
        if not self.closed:
            return {}
        e = self.track.equations
        change = self.q[-1] - self.q[0]
        names = self.system.structure.velocity_names
        return {
            name: round(change[e.place[i]] / (2.0 * np.pi))
            for i, name in enumerate(names)
            if e.place[i] >= 0 and abs(change[e.place[i]]) > 1.0
        }

    def at(self, s: ArrayLike) -> Array:
        """Return the exactly closed configurations at arc lengths.

        Parameters
        ----------
        s
            Arc lengths (...). A closed path continues around.

        Returns
        -------
        Array
            Configurations (..., nq).

        Raises
        ------
        InputError
            For arc lengths beyond the ends of a path that is not closed.
        """
        s = numbers(s, "s")
        if not np.isfinite(s).all():
            raise InputError("s holds a NaN or an infinity; arc lengths are finite numbers")
        length = self.length
        slack = 1e-9 * (1.0 + length)
        if not self.closed and (s.min(initial=0.0) < -slack or s.max(initial=0.0) > length + slack):
            raise InputError(f"s is outside the path, which runs from 0 to {length:.9g}")
        flat = s.ravel()
        around = self.closed & ((flat < 0.0) | (flat > length))
        rounds = np.where(around, np.floor(flat / max(length, 1e-300)), 0.0)
        change = self.track.q[-1] - self.track.q[0]
        change[self.system.structure.layout.quaternion_q[:, None] + np.arange(4)] = 0.0
        out = (
            self.track.evaluate_configurations(np.clip(flat - rounds * length, 0.0, length))
            + rounds[:, None] * change
        )
        return out.reshape(*s.shape, self.system.nq)

    @raise_interrupted
    def resample(self, n: int, *, budget: Budget | None = None) -> Path:
        """Return the path with `n` points at equal distances of arc length, its ends included.

        Parameters
        ----------
        n
            Number of points.
        budget
            Reads time_limit (120 s) and progress(points, length).

        Returns
        -------
        Path
            After the time limit it has the finished points; see `late` and `remark`.

        Raises
        ------
        InputError
            For a wrong number.
        Interrupted
            After Ctrl-C, with the finished points as its `answer`.
        """
        spend = USUAL.complete_budget(budget)
        if not is_whole(n) or not 2 <= n <= MOST:
            raise InputError(
                f"n is {format_value(n)}; it must be a whole number, at least 2 and at most {MOST}"
            )
        time = TimeLimit(spend.time_limit)
        broken = None
        done: list[tuple[Array, Array]] = []
        time.release_reserved_time()  # there is nothing to do afterwards
        try:
            for i in range(0, int(n), SLICE):
                time.check_time()
                s: Array = np.arange(float(i), min(i + SLICE, int(n))) * (
                    self.length / (int(n) - 1)
                )
                s[s > self.length] = self.length
                if i + SLICE >= n:
                    s[-1] = self.length
                done.append((s, self.track.evaluate_configurations(s)))
                if spend.progress is not None:
                    spend.progress(i + len(s), float(s[-1]))
        except BROKEN_OFF as error:
            broken = error
        s = np.concatenate([np.zeros(0), *(part[0] for part in done)])
        q = np.concatenate([np.empty((0, self.system.nq)), *(part[1] for part in done)])
        if broken is None:
            return replace(self, q=q, s=s)
        more = "; ".join(
            filter(
                None, [self.remark, f"{len(q)} of {format_count(n, 'point')} at equal distances"]
            )
        )
        late = isinstance(broken, TimeUp)
        interrupted = isinstance(broken, KeyboardInterrupt)
        ends = (self.ends[0], time.describe_end_reason(broken))
        return replace(
            self,
            q=q,
            s=s,
            closed=False,
            ends=ends,
            success=False,
            late=late,
            interrupted=interrupted,
            remark=more,
        )

    def table(
        self, frames: Iterable[FrameLike] | None = None, branches: bool = False
    ) -> tuple[list[str], Array]:
        """Return names and columns (n, k) for a file: s, all coordinates, x, y (and z) of frames.

        The frames are those of `self.frames` by default.

        With `branches` the rows of the `others` follow, and each begins with the number of its
        branch, 0 for this one.
        """
        frames = self.frames if frames is None else frames
        names, columns = self._make_columns("s", self.s, frames)
        if not branches:
            return names, columns
        each = [columns, *(other.table(frames)[1] for other in self.others)]
        rows = [np.insert(part, 0, k, axis=1) for k, part in enumerate(each)]
        return ["branch", *names], np.vstack(rows)

    def save(
        self,
        path: str | FilePath,
        frames: Iterable[FrameLike] | None = None,
        *,
        branches: bool = False,
        degrees: bool = False,
    ) -> FilePath:
        """Write the `table` with these frames to a .csv or .npy file; return the path.

        Errors: `InputError`.
        """
        table = self.table(frames, branches)
        return write_table(path, *convert_columns(*table, self._list_units(), degrees))

    def _compose_sentence(self, index: tuple[int, ...]) -> str:
        if len(self) == 1 and (self.ends[0] == self.ends[1] or not (self.interrupted or self.late)):
            still = describe_immovable_coordinates(self.system)
            return self.ends[1] + (f"; {still}" if still else "")
        what = "closed curve" if self.closed else "curve"
        text = f"{what} of length {self.length:.6g} through {format_count(len(self), 'point')}"
        turning = [f"{format_count(abs(k), 'turn')} of {name!r}" for name, k in self.turns.items()]
        text += f", {', '.join(turning[:4])}{', ...' * (len(turning) > 4)}" if turning else ""
        if not self.closed:
            text += f"; it ends at {self.ends[0]} and at {self.ends[1]}"
        return text + self._describe_early_end() + (f"; {self.remark}" if self.remark else "")

    def _make_tables(self) -> Sequence[Table]:
        """Make the table of the range of each coordinate, extremes between points included."""
        if len(self) < 2:
            return []
        return [make_ranges_table(self.system, np.vstack([self.q, *(e.q for e in self.extremes)]))]

    def _list_notes(self, degrees: bool = False) -> Sequence[str]:
        unit = list_units(self.system)
        lines = cut_lines([e.format_event(unit, degrees) for e in self.turning_points], EVENTS)
        lines += [str(event) for event in self.singular_points]
        lines += [f"another branch: {path.status}" for path in self.others]
        if said := self.hint:
            other = self._name_coordinates(self.elsewhere[0]).convert_units(degrees)
            values = ", ".join(f"{x:.9g}" for x in other.tolist())
            one = len(self.elsewhere) == 1
            which, rest = ("it", "") if one else ("one of them", "; all are in `elsewhere`")
            lines.append(f"{said}; trace {which} with start=({values}){rest}")
        return [*lines, *super()._list_notes()]

    def _collect_data(self) -> dict[str, Any]:
        unit = list_units(self.system)
        events = {
            name: [_list_event_data(e, unit, self._name_coordinates) for e in getattr(self, name)]
            for name in ("turning_points", "singular_points", "extremes")
        }
        curves = {frame: self.curve(frame)[:, : self.system.dim] for frame in self.frames}
        others = [{"status": path.status} | path._collect_data() for path in self.others]
        return super()._collect_data() | {"curves": curves} | events | {"others": others}

    @cached_property
    def _other_modes(self) -> tuple[str, Array]:
        """The input, and the assembly modes that the path does not pass."""

        return find_other_modes(self)

    @property
    def elsewhere(self) -> Array:
        """Other assembly modes (k, nq) at the start of the path, which the path does not pass.

        They are known where they have a closed form.

        They have the driver's value there; without a driver, that of the first coordinate with
        which there are some.
        """
        return self._other_modes[1]

    @property
    def hint(self) -> str:
        """Sentence on how many assembly modes are not on the path; "" where none are known."""
        name, q = self._other_modes
        if not len(q):
            return ""
        value = self.q[0][self.system.coordinate_names.index(name)]
        unit = list_units(self.system)[name]
        at = f"{value:.6g} {unit}".rstrip()
        many = "1 other assembly mode" if len(q) == 1 else f"{len(q)} other assembly modes"
        return f"{many} with {name!r} = {at} {'is' if len(q) == 1 else 'are'} not on this curve"


def _list_event_data(
    event: Event, unit: Mapping[str, str], by_name: Callable[[Array], Any]
) -> dict[str, Any]:
    """Return the data of an event by name, for files."""
    own = (
        {
            "coordinate": event.coordinate,
            "value": Quantity(event.value, unit[event.coordinate]),
            "unit": Unit(unit[event.coordinate]),
        }
        if event.coordinate
        else {
            "branches": 0 if event.directions is None else len(event.directions),
            "complete": event.complete,
            "nullity": event.nullity,
        }
    )
    return {"s": event.s, "kind": event.kind, **own, "q": by_name(event.q)}
