"""The session behind a page: what is shown, and what sliders, targets and buttons do.

It has all but the browser.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.assemble.assemble import assemble
from kempe.budget import Budget
from kempe.designs import with_parameters
from kempe.equations.closure_rows import evaluate_constraints
from kempe.equations.judge import judge_configurations
from kempe.errors import InputError, KempeError
from kempe.forward.fk import fk, jacobian
from kempe.mobility.independent import Chart, independent
from kempe.model.configurations import (
    compute_distance,
    compute_mid_configuration,
    has_loops,
    list_parameter_units,
    list_units,
    make_q,
    read_q,
    sample_configurations,
)
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array, log_so3
from kempe.views.drawing.plot_request import read_configuration, read_motion
from kempe.views.drawing.scene import build_scene
from kempe.views.sketch.sketch import History
from kempe.views.viewer.dimensions import describe_four_bar, make_dimension_slider
from kempe.views.viewer.first_sight import choose_first_posture, sort_frames_by_use
from kempe.views.viewer.sliders import Slider
from kempe.words import format_count

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- motions

# One that is given, and those that can be found from where the system is.

SLOW = 4.0
"""Seconds in which a motion is played that has no times of its own."""
FALL = 3.0
"""Seconds of a fall, and part of its speed that a bounce leaves."""
LEFT = 0.8
MOTION_PATIENCE = 5.0
"""Seconds that a search for a motion may take."""


class Played(NamedTuple):
    """Configurations `q` (n, nq), all of them finite, at times `t` (n,) [s] from 0 on; `timed`: its
    own times.
    """

    q: Array
    t: Array
    timed: bool

    @property
    def duration(self) -> float:
        """Duration from the first to the last configuration [s]."""
        return float(self.t[-1]) or SLOW

    def find_configuration(self, time: float) -> Array:
        """Find the configuration (nq,) whose time is nearest to a time [s]."""
        k = int(np.searchsorted(self.t, time))
        before = k > 0 and (k == len(self.t) or time - self.t[k - 1] < self.t[k] - time)
        return np.array(self.q[k - 1 if before else k])


def make_motion(system: Model, path: Any) -> Played | None:
    """Make a motion to be played from an answer or configurations (n, nq); None from None.

    Errors: `InputError` for other shapes.
    """
    q, _ = read_motion(system, path)
    if q is None:
        return None
    own: Any = getattr(path, "t", None)
    timed = np.shape(own) == q.shape[:1]
    t = np.asarray(own, dtype=float) if timed else np.linspace(0.0, SLOW, len(q))
    finite = np.isfinite(q).all(axis=1) & np.isfinite(t)
    return Played(q[finite], t[finite] - t[finite][0], timed)


def _trace_whole_motion(session: Session) -> Any:
    """Trace the whole motion of a system with one freedom."""
    from kempe.motion.trace import trace

    driver = session.sliders[0].name
    return trace(session.system, driver, session.q, budget=session.make_budget(MOTION_PATIENCE))


def _find_self_motion(session: Session) -> Any:
    """Find a self-motion in a random direction, with the frame at rest."""
    from kempe.inverse.self_motion import self_motion

    system = session.system
    way = session.rng.normal(size=system.nv)  # of several freedoms: each search takes another one
    budget = session.make_budget(MOTION_PATIENCE)
    task = session.task
    return self_motion(system, session.q, session.frame, task=task, direction=way, budget=budget)


def _find_manoeuvre(session: Session) -> Any:
    """Find a manoeuvre from the first configuration to the present one."""
    from kempe.motion.manoeuvre import manoeuvre

    return manoeuvre(session.system, session.home, session.q)


def _simulate_fall(session: Session) -> Any:
    """Simulate a fall from the present configuration."""
    from kempe.motion.simulate import simulate

    return simulate(session.system, FALL, session.q, restitution=LEFT)


MOTIONS: dict[str, Callable[[Session], Any]] = {
    "whole motion": _trace_whole_motion,
    "frame at rest": _find_self_motion,
    "manoeuvre": _find_manoeuvre,
    "fall": _simulate_fall,
}
"""Motions that are found on request: with one freedom, with the frame where it is, of what rolls,
of what falls."""


def list_possible_motions(session: Session) -> tuple[str, ...]:
    """List the names of `MOTIONS` that a system can have."""
    system = session.system
    freedoms = len(session.sliders)
    rows = [r for c in system.mechanism.constraints.values() for r in c.of.list_rows(system.dim)]
    rolls = any(r.velocity for r in rows)
    falls = len(system.parent) == 1 and any(
        c.count_bounds(system.dim) for c in system.mechanism.constraints.values()
    )
    have = {
        "whole motion": freedoms == 1 and not rolls,
        "frame at rest": session.is_redundant() and not rolls,
        "manoeuvre": rolls and not has_loops(system),
        "fall": falls and not rolls,
    }
    return tuple(name for name, has in have.items() if has)


def find_named_motion(session: Session, name: str) -> tuple[Played | None, str]:
    """Find the motion with this name from the present configuration, and the sentence about it.

    The motion is None if there is none.

    Errors: those of the verb that looks for it.
    """
    answer = MOTIONS[name](session)
    return (make_motion(session.system, answer) if len(answer.q) > 1 else None), answer.status


# ---- the session

LEAD = 0.1
"""Longest step of a slider that leads closed loops, in radians or parts of the drawing's size."""
STUCK = 0.05
"""Part of such a step within which the last dimensions that close the loops are found."""
FULL = np.pi
"""A slider of an angle without limits goes this far both ways."""
BALL = 3.0
"""Largest component of the rotation vector of a ball that a slider sets."""
GHOSTS = 16
"""Solutions that are kept, at most."""
QUICK = Budget(starts=1)
"""What a target may cost while it is dragged."""
KINDS = {"solution": "solution", "mode": "assembly mode"}
"""What other configurations are called."""
APART = 1e-4
"""How far coordinates, or joints in parts of the drawing's size, are apart in different
configurations."""
SINGULAR = 1e-3
"""Least rate of a frame, as a part of the largest, below which it counts as singular."""
NEAR_SINGULAR = 0.05
"""Conditioning of the sliders below which a page says so."""
CLOSED = 1e-8
"""Residual up to which loops are closed."""
TRIES = 20
"""Random starts from which loops are closed, at most."""
PATIENCE = 3.0
"""Seconds that the search for other solutions and modes of loops may take."""


@dataclass(frozen=True)
class Dimensioned:
    """A system whose parameters have these values, and a configuration (nq,) that closes its loops."""

    values: dict[str, float]
    system: Model = field(compare=False)
    q: Array = field(compare=False)


class Session:
    """State of a page: the configuration `q` (nq,) of a system, and the actions on it.

    `status` is the sentence about the last thing done. `frame` is the one that targets are for,
    `task` what of them counts: "pose" or "position"; `target` (4, 4) is the last one that was not
    reached, else None. `solutions` (k, nq) are other configurations, of the `kind` "solution" (the
    frame at the same place) or "mode" (the independent coordinates as they are), the search for
    which `took` so many seconds. `motion` is what is played, `home` the configuration at first, `first` the system
    with its first dimensions, `dimension_steps` the history of these.
    `revision` grows with each new choice of `sliders`. `progress` is called in long searches.
    """

    def __init__(self, system: Model, q: Any = None, frame: Any = None, path: Any = None):
        self.system = system
        self.lock = threading.RLock()
        self.motion = make_motion(system, path)
        self.frames = sort_frames_by_use(system)
        self.frame = self.frames[0] if frame is None else system.structure.frame_name(frame)
        self.q = np.array(
            choose_first_posture(system, self.frame)
            if q is None and self.motion is None
            else read_configuration(system, q, None if self.motion is None else self.motion.q)
        )
        self.status = ""
        self.target = None
        self.revision = 0
        self.chart = None
        self.solutions = np.empty((0, system.nq))
        self.kind = "solution"
        self.took = 0.0
        self.progress: Callable[..., None] | None = None
        self._bare = not (has_loops(system) or system.mechanism.constraints)
        self._closes = not self._bare and bool(
            evaluate_constraints(system, system.neutral, False, True)[0].size
        )
        self._units = list_units(system)
        joints = system.mechanism.joints
        self._driven = tuple(
            name
            for joint in system.joint_names
            if joints[joint].actuated and not self._bare
            for name in system.structure.coordinates_of_joint(joint)
            if name in system.structure.velocity_names
        )
        self.rng = np.random.default_rng(0)
        if q is not None and has_loops(system) and not judge_configurations(system, self.q):
            self._take_answer(assemble(system, start=self.q), "closed from the q given")
        self._choose_chart()
        self.task = self.choose_task()
        self.home = self.q
        self.first = system
        self._parameter_units = list_parameter_units(system)
        self.forget_steps()

    # ---- coordinates

    @property
    def sliders(self) -> tuple[Slider, ...]:
        """Independent coordinates with their present values, without idle rotations."""
        if self.chart is None:
            return ()
        values = self.chart.u(self.q)
        return tuple(
            self._make_slider(n, float(x)) for n, x in zip(self.chart.useful, values, strict=False)
        )

    def _make_slider(self, name: str, value: float) -> Slider:
        """Make the slider of an independent coordinate, with ends from its limits."""
        names = self.system.structure.velocity_names
        system = self.system
        if name not in names:
            return Slider(name, "rad", -BALL, BALL, value)
        i = names.index(name)
        unit = self._units.get(name, "rad")
        wide = FULL if unit == "rad" else self.size
        low = float(system.lower[i])
        high = float(system.upper[i])
        about = value if abs(value) > wide else 0.0
        low = low if np.isfinite(low) else (high - 2 * wide if np.isfinite(high) else about - wide)
        high = high if np.isfinite(high) else max(low, about - wide) + 2 * wide
        return Slider(name, unit, min(low, value), max(high, value), value)

    @property
    def size(self) -> float:
        """Range [m] of a slide without limits: the extent of the drawing."""
        if not hasattr(self, "_size"):
            scene = build_scene(self.system, self.q)
            self._size = max(scene.size, *(10.0 * m.radius for m in scene.marks), 0.0)
        return self._size

    def set_coordinate(self, name: str, value: float) -> None:
        """Set an independent coordinate; loops are moved there in steps, and stay closed."""
        chart = self.chart
        if chart is None or name not in chart.useful:
            raise InputError(
                f"{name!r} is no independent coordinate here: "
                f"{', '.join(chart.useful if chart else ())}"
            )
        self.target = None
        k = chart.useful.index(name)
        known = self.system.coordinate_names
        if not chart.dependent and name in known:
            q = np.array(self.q)
            q[known.index(name)] = value
            if self._bare or judge_configurations(self.system, q):
                self._set_configuration(q, "")
                return
        u = chart.u(self.q)[: len(chart.useful)]
        wide = abs(value - u[k]) / (
            LEAD if self._units.get(name, "rad") == "rad" else LEAD * self.size
        )
        for x in np.linspace(float(u[k]), value, max(1, int(np.ceil(wide))) + 1)[1:]:
            u[k] = x
            answer = chart.q(u, self.q)
            self.status = "" if answer else answer.status
            if not answer:
                break
            self.q = answer.q
        if not chart.valid(self.q):
            self._choose_chart()
        self._forget_solutions()

    def _choose_chart(self, prefer: Sequence[str] = ()) -> None:
        """Choose independent coordinates at this configuration, unless its loops are open.

        `prefer` are coordinates that are chosen where they are independent and enough; else, where
        they are, the motors.
        """
        with self._catch_refusals():
            try:
                self.chart: Chart | None = independent(self.system, self.q, prefer or self._driven)
            except InputError:
                self.chart = independent(self.system, self.q)
            self.revision += 1
            if not self.chart.useful and not self.status:
                self.status = f"{self.system.name} has no freedoms: nothing moves"

    @contextlib.contextmanager
    def _catch_refusals(self) -> Generator[None, None, None]:
        """Report errors of the block in the status instead of raising them."""
        try:
            yield
        except KempeError as error:
            self.status = str(error)

    def _take_answer(self, answer: Any, said: str = "") -> bool:
        """Take over the configuration of an answer if its loops are closed, and its sentence."""
        self.status = said if answer else answer.status
        if answer or (
            np.isfinite(answer.q).all() and bool(judge_configurations(self.system, answer.q))
        ):
            self.q = np.array(answer.q)
        return bool(answer)

    def _forget_solutions(self) -> None:
        """Forget the other solutions, which a move makes obsolete."""
        self.solutions = np.empty((0, self.system.nq))

    def make_budget(self, seconds: float, **more: Any) -> Budget:
        """Make the budget of a long search."""
        return Budget(time_limit=seconds, progress=self.progress, **more)

    # ---- dimensions

    @property
    def dimensions(self) -> tuple[Slider, ...]:
        """Parameters of the mechanism with their present values."""
        first = self.first.structure.parameters
        return tuple(
            make_dimension_slider(name, self._parameter_units[name], first[name], value, self.size)
            for name, value in self.system.structure.parameters.items()
        )

    def set_dimension(self, name: str, value: float) -> None:
        """Set a parameter of the mechanism, and close the loops again from this configuration.

        The independent coordinates stay where they can. Where the loops do not close, the mechanism
        stays the last one that does.
        """
        self._change_dimensions({name: float(value)})
        self.dimension_steps.add_step(self._get_dimensions(self.system, self.q), name)

    def forget_steps(self) -> None:
        """Begin the history of dimensions anew."""
        self.dimension_steps = History(self._get_dimensions(self.system, self.q))

    def undo_dimensions(self) -> None:
        """Take the last change of dimensions back. Errors: `InputError` at the first one."""
        self.dimension_steps.undo_step()
        self._restore_dimensions(self.dimension_steps.state, "one step back")

    def redo_dimensions(self) -> None:
        """Take the last undo back. Errors: `InputError` without one."""
        self.dimension_steps.redo_step()
        self._restore_dimensions(self.dimension_steps.state, "one step forward")

    def reset_dimensions(self) -> None:
        """Set all parameters to their first values, which is one step, too."""
        first = self._get_dimensions(self.first, self.home)
        self.dimension_steps.add_step(first)
        self._restore_dimensions(first, "dimensions reset")

    @staticmethod
    def _get_dimensions(system: Model, q: Array) -> Dimensioned:
        """Get the values of a system's parameters, with a configuration (nq,)."""
        return Dimensioned(dict(system.structure.parameters), system, np.array(q))

    def _restore_dimensions(self, state: Dimensioned, said: str) -> None:
        """Go to a state of the history from this configuration; where that leads nowhere, to its
        own.
        """
        self._change_dimensions(state.values)
        closed = not self.status
        self._take_system(state.system, self.q if closed else state.q)
        self.status = said + ", and the configuration of then" * (not closed)

    def _change_dimensions(self, wanted: dict[str, float]) -> None:
        """Lead parameters to these values in steps, as far as the loops close."""
        now = {name: self.system.structure.parameters[name] for name in wanted}
        longest = max(
            abs(value - now[name])
            / (LEAD if self._parameter_units[name] == "rad" else LEAD * self.size)
            for name, value in wanted.items()
        )
        count = max(1, int(np.ceil(longest)))
        self.status = ""
        good, bad = 0.0, np.inf
        step = 1.0 / count
        system, q = self.system, self.q
        while good < 1.0:
            part = min(good + step, 1.0)
            trial = {name: x + part * (wanted[name] - x) for name, x in now.items()}
            if part == 1.0:
                trial = wanted
            found = self._close_dimensions(trial, system, q)
            if found is not None:
                system, q = found
                good = part
            else:
                bad = part
            if bad < np.inf:
                step = 0.5 * (bad - good)
                if step * longest < STUCK:
                    break
        if system is not self.system:
            self._take_system(system, q)
        if good < 1.0 and not self.status:
            values = ", ".join(
                f"{name} = {value:.4g}" for name, value in wanted.items() if value != now[name]
            )
            self.status = f"the loops do not close with {values}: shown is the last that closes"

    def _close_dimensions(
        self, wanted: dict[str, float], system: Model, q: Array
    ) -> tuple[Model, Array] | None:
        """Close the loops of a system with other parameters, from q (nq,).

        None if they do not close.
        """
        with self._catch_refusals():
            changed: Any = with_parameters(system, wanted)
            if self._bare or judge_configurations(changed, q):
                return changed, q
            known = (
                {}
                if self.chart is None
                else dict(zip(self.chart.useful, self.chart.u(self.q).tolist(), strict=False))
            )
            known = {name: x for name, x in known.items() if name in system.coordinate_names}
            for some in (known, {}) if known else ({},):
                answer = assemble(changed, some, q, budget=QUICK)
                if answer:
                    return changed, np.array(answer.q)
        return None

    def _take_system(self, system: Model, q: Array) -> None:
        """Go on with the system with other dimensions, at a configuration (nq,) that closes."""
        self.system = system
        self.q = q
        self.target = None
        self.motion = None
        self._choose_chart(() if self.chart is None else self.chart.useful)
        self._forget_solutions()

    def describe_dimensions(self) -> str:
        """Describe what the dimensions of a four-bar mean for its motion; else the text is empty."""
        driver = self.chart.useful[0] if self.chart is not None and self.chart.useful else ""
        with self._catch_refusals():
            return describe_four_bar(self.system, self.q, driver)
        return ""

    # ---- targets

    def choose_task(self) -> str:
        """Choose the task of targets: "pose" if the frame moves in every direction, else
        "position".
        """
        if self.chart is None:
            return "position"
        with self._catch_refusals():
            return (
                "pose"
                if self.count_directions("pose") == (3 if self.system.dim == 2 else 6)
                else "position"
            )
        return "position"

    def count_directions(self, task: str) -> int:
        """Count the directions of a task in which the frame can move.

        It is the largest number at several configurations.
        """
        if self.chart is None:
            return 0
        tries = () if self.chart.dependent else sample_configurations(self.system, 0, 4)
        rows = self.system.dim if task == "position" else None
        return max(
            Spectrum(self._compute_rates(q)[:rows], 1.0).compute_rank(Level.GENERIC)
            for q in (self.q, *tries)
        )

    def is_redundant(self) -> bool:
        """Whether the system can move with the frame at rest, at most configurations."""
        return self.chart is not None and len(self.chart.useful) > max(
            1, self.count_directions(self.task)
        )

    def _compute_rates(self, q: Array) -> Array:
        """Compute the rates (3 or 6, p) of the frame with respect to the independent coordinates."""
        J = jacobian(self.system, q, self.frame)
        if self.chart is not None and self.chart.dependent:
            J = J @ self.chart.tangent(q)
        return J[[0, 1, 5]] if self.system.dim == 2 else J

    def aim_frame(self, frame: Any, task: str | None = None) -> None:
        """Choose the frame and the task of targets, by default the usual task."""
        self.frame = self.system.structure.frame_name(frame)
        self.task = self.choose_task() if task is None else task
        self._forget_solutions()

    @property
    def pose(self) -> Array:
        """Pose (4, 4) of the frame."""
        return fk(self.system, self.q, self.frame)

    def reach_pose(self, X: Array, quick: bool = True) -> bool:
        """Bring the frame to a pose (4, 4), or as near as possible; whether it is reached.

        Loops stay closed and limits hold. `quick`: one search from here only, as while a target is
        dragged.
        """
        from kempe.inverse.ik import ik

        with self._catch_refusals():
            budget = QUICK if quick else None
            answer = ik(self.system, X, self.frame, self.q, task=self.task, budget=budget)
            found = self._take_answer(answer, "reached")
            self.target = None if found else X
            if not found:
                self.status = self._describe_miss(X)
            if self.chart is not None and not self.chart.valid(self.q):
                self._choose_chart()
            self._forget_solutions()
            return found
        return False

    def _describe_miss(self, X: Array) -> str:
        """Describe how far the nearest configuration stays from a target (4, 4)."""
        from kempe.views.drawing.page import format_length

        off = float(np.linalg.norm(X[:3, 3] - self.pose[:3, 3]))
        parts = [f"{format_length(float(f'{off:.2g}'), self.system.unit)} away"] * (
            off > APART * self.size
        )
        if self.task == "pose":
            angle = float(np.linalg.norm(log_so3(self.pose[:3, :3].T @ X[:3, :3])))
            parts += [f"turned by {np.rad2deg(angle):.2g}°"] * (angle > APART)
        one = self.chart is not None and len(self.chart.useful) == 1
        follows = f"{self.frame} follows its curve (1 freedom)" if one else "out of reach"
        return f"{follows}: nearest is {' and '.join(parts) or 'shown'}"

    def find_other_configurations(self, kind: str = "solution") -> int:
        """Find the other configurations of a kind; return their number."""
        self._forget_solutions()
        self.kind = kind
        begun = time.perf_counter()
        with self._catch_refusals():
            q = self._find_modes() if kind == "mode" else self._find_inverse_solutions()
            self.solutions = self._select_distinct(
                q.reshape(int(np.prod(q.shape[:-1])), self.system.nq)
            )[:GHOSTS]
            n = len(self.solutions)
            where = "" if kind == "mode" else f" with {self.frame} here"
            if n:
                self.status = f"{n} other {KINDS[kind]}{'s' * (n > 1)}{where}: click on one"
            else:
                moves = ", but it moves on with it at rest" * self.is_redundant()
                self.status = f"no other {KINDS[kind]} was found{where}{moves}"
        self.took = time.perf_counter() - begun
        return len(self.solutions)

    def _find_inverse_solutions(self) -> Array:
        """Find configurations (k, nq) with the frame at the same pose."""
        X = self.pose
        system = self.system
        if has_loops(system):
            known = {self.frame: X if self.task == "pose" else X[: system.dim, 3]}
            return self._close_known_coordinates(known)
        from kempe.inverse.ik_all import ik_all

        return np.asarray(ik_all(system, X, self.frame, task=self.task, limits=True).q)

    def _find_modes(self) -> Array:
        """Find configurations (k, nq) with the same independent coordinates."""
        if not has_loops(self.system):
            return np.empty((0, self.system.nq))
        known = {s.name: s.value for s in self.sliders if s.name in self.system.coordinate_names}
        return self._close_known_coordinates(known)

    def _close_known_coordinates(self, known: dict[str, Any]) -> Array:
        """Find configurations (k, nq) that close the loops with known coordinates or frames."""
        from kempe.assemble.modes import assembly_modes

        budget = self.make_budget(PATIENCE)
        return np.asarray(assembly_modes(self.system, known, self.q, budget=budget).q)

    def _select_distinct(self, q: Array) -> Array:
        """Select the configurations (k, nq) that differ from q; with loops those that look
        different.
        """
        system = self.system
        q = q[np.isfinite(q).all(axis=1)]
        if not has_loops(system):
            return q[compute_distance(system, q, self.q) > APART] if len(q) else q
        links = build_scene(system, self.q)
        heads = [system.body_names.index(link.name) for link in links.links]
        own = [links.list_points(link) for link in links.links]
        X = np.linalg.inv(fk(system, self.q)[heads])
        Y = fk(system, np.concatenate([self.q[None], q]))[:, heads]
        at = np.concatenate(
            [
                (p @ A[:3, :3].T + A[:3, 3]) @ B[..., :3, :3].swapaxes(-1, -2) + B[:, None, :3, 3]
                for p, A, B in zip(own, X, Y.swapaxes(0, 1), strict=True)
            ],
            axis=1,
        )
        seen = [0]
        for k in range(1, len(at)):
            if np.abs(at[seen] - at[k]).max(axis=(1, 2)).min() > APART * self.size:
                seen.append(k)
        return q[np.array(seen[1:], dtype=int) - 1]

    def choose_solution(self, k: int) -> None:
        """Go to one of the other configurations, and keep the present one in its place."""
        if not 0 <= k < len(self.solutions):
            raise InputError(
                f"{k} is none of {format_count(len(self.solutions), f'other {KINDS[self.kind]}')}"
            )
        solutions = np.array(self.solutions)
        solutions[k], self.q = self.q, np.array(solutions[k])
        self.target = None
        if self.kind == "mode" or (self.chart is not None and not self.chart.valid(self.q)):
            self._choose_chart()
        self.solutions = solutions
        same = (
            "the independent coordinates as they were"
            if self.kind == "mode"
            else f"{self.frame} where it was"
        )
        self.status = f"another of the {len(solutions) + 1} {KINDS[self.kind]}s found with {same}"

    def choose_next_configuration(self, kind: str = "solution") -> None:
        """Go to the next configuration of a kind."""
        if (self.kind == kind and len(self.solutions)) or self.find_other_configurations(kind):
            self.choose_solution(0)
            self.solutions = np.roll(self.solutions, -1, axis=0)

    # ---- buttons

    def go_to_random(self) -> None:
        """Go to a random configuration within the limits, with closed loops."""
        said = ""
        for _ in range(TRIES):
            start = sample_configurations(self.system, self.rng)
            if judge_configurations(self.system, start):
                self._set_configuration(start, "a random configuration")
                return
            answer = assemble(self.system, start=start, budget=QUICK)
            if answer:
                self._set_configuration(answer.q, "a random configuration")
                return
            said = answer.status
        self.status = f"none of {TRIES} random starts closed the loops: {said}"

    def reset(self) -> None:
        """Go to the first configuration; with other dimensions to the nearest one that closes."""
        if self._bare or judge_configurations(self.system, self.home):
            self._set_configuration(self.home, "as at first")
        elif answer := assemble(self.system, start=self.home):
            self._set_configuration(answer.q, "as at first, with the loops closed")
        else:
            self.status = answer.status

    def go_to_posture(self, name: str) -> None:
        """Go to a posture of the model, or to 'neutral' or 'mid', and close the loops."""
        own = {"neutral": self.system.neutral, "mid": compute_mid_configuration(self.system)}
        named = name in self.system.structure.posture_names
        q = own[name] if name in own and not named else make_q(self.system, name)
        if judge_configurations(self.system, q):
            self._set_configuration(q, f"posture {name}")
        elif answer := assemble(self.system, start=q):
            self._set_configuration(answer.q, f"closed from posture {name}")
        else:
            self.status = answer.status

    @property
    def postures(self) -> tuple[str, ...]:
        """Names of the postures that `go` takes."""
        return tuple(dict.fromkeys(("neutral", "mid", *self.system.structure.posture_names)))

    def go_to_configuration(self, q: Any) -> None:
        """Go to a configuration (nq,) without changing it."""
        if (q := read_q(self.system, q)).shape != (self.system.nq,):
            raise InputError(
                f"q has shape {q.shape}; one configuration ({self.system.nq},) is shown"
            )
        self._set_configuration(q, "")

    def _set_configuration(self, q: Array, said: str) -> None:
        """Go to a configuration (nq,), and set the status."""
        self.q = np.array(q)
        self.status = said
        self.target = None
        if self.chart is None or self.chart.dependent:
            self._choose_chart()
        self._forget_solutions()

    # ---- motions

    def go_to_time(self, time: float) -> None:
        """Go to the configuration of the motion at a time [s]."""
        if self.motion is not None:
            self.q = self.motion.find_configuration(time)
            self.target = None
            self._forget_solutions()

    def find_motion(self, name: str) -> bool:
        """Find a motion of `MOTIONS` from this configuration; whether there is one."""
        with self._catch_refusals():
            motion, self.status = find_named_motion(self, name)
            self.motion = self.motion if motion is None else motion
            return motion is not None
        return False

    # ---- what is said

    def compute_residual(self) -> float:
        """Compute the largest error of the constraints; lengths relative to the characteristic
        length.
        """
        return (
            0.0
            if self._bare
            else float(
                np.abs(evaluate_constraints(self.system, self.q, False, True)[0]).max(initial=0.0)
            )
        )

    def describe_singularity(self) -> str:
        """Describe how near the independent coordinates are to a singularity."""
        if self.chart is None or not self.chart.useful:
            return ""
        if not self.chart.dependent:
            rows = self._compute_rates(self.q)[
                : self.system.dim if self.task == "position" else None
            ]
            singular = Spectrum(rows).compute_rank(SINGULAR) < min(rows.shape)
            return f"{self.frame} is singular here" if singular else ""
        # where loops are open, which `compose_text` tells by the residual
        with contextlib.suppress(InputError):
            quality = self.chart.condition(self.q)
            if quality < NEAR_SINGULAR:
                word = "singular" if quality < 1e-6 else "near a singular configuration"
                return f"{word} (conditioning {quality:.2g}): {', '.join(self.chart.useful)}"
        return ""

    def describe_mobility(self) -> str:
        """Describe the degrees of freedom at this configuration, and how they were counted."""
        from kempe.mobility.mobility import mobility

        with self._catch_refusals():
            found = mobility(self.system, self.q)
            return found.status
        return ""

    def compose_text(self) -> str:
        """Compose the sentences of the page, as paragraphs: loops that are open, singularity, status."""
        error = self.compute_residual() if self._closes else 0.0
        closed = f"the loops are open (residual {error:.2g})" if error > CLOSED else ""
        return "\n\n".join(
            line for line in (closed, self.describe_singularity(), self.status) if line
        )
