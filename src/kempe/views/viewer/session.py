"""What a page shows of a system and what its sliders, targets and buttons do: everything but the browser."""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe.budget import Budget
from kempe.errors import InputError, KempeError
from kempe.kinematics.closure_rows import evaluate
from kempe.kinematics.configuration import as_q, distance, has_loops, mid, random
from kempe.kinematics.measure import judge
from kempe.model.tree.coordinates import units
from kempe.solvers.assembly.charts import Chart, independent
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

LEAD = 0.1
"""Longest step of a slider that leads closed loops, in radians or parts of the drawing's size."""
FULL = np.pi
"""A slider of an angle without limits goes this far both ways."""
BALL = 3.0
"""Largest component of the rotation vector of a ball that a slider sets."""
GHOSTS = 16
"""Solutions that are kept, at most."""
QUICK = Budget(starts=1)
"""What a target may cost while it is dragged."""
SINGULAR = 1e-3
"""Least rate of a frame, as a part of the largest, below which it counts as singular."""
TRIES = 20
"""Random starts from which loops are closed, at most."""
SEEN = 1500
"""Points that a frame reaches, as drawn."""


class Slider(NamedTuple):
    """A coordinate that can be set: its unit "rad" or "m", its ends, and its value."""

    name: str
    unit: str
    low: float
    high: float
    value: float


class Session:
    """A configuration `q` (nq,) of a system, and what is done with it.

    `status` is the sentence about the last thing done. `frame` is the one that targets are for, `task` what of them
    counts: "pose" or "position"; `target` (4, 4) is the last one that was not reached, else None. `solutions` (k, nq)
    are configurations other than q with the frame at the same place. `path` (n, nq) is a motion to play. `revision`
    grows with each new choice of `sliders`.
    """

    def __init__(self, system: System, q: Any = None, frame: Any = None, path: Any = None):
        from kempe.views.plots import configuration_of, motion_of

        self.system = system
        self.path, _ = motion_of(system, path)
        self.q = np.array(configuration_of(system, q, self.path))
        self.status, self.target, self.revision, self.chart = "", None, 0, None
        self.solutions = np.empty((0, system.nq))
        self._bare = not (has_loops(system) or system.mechanism.constraints)
        self._modes: tuple[Array, int] = np.empty((0, system.nq)), 0
        self._units, self._rng = units(system), np.random.default_rng(0)
        if q is not None and has_loops(system) and not judge(system, self.q):
            self._take(system.assemble(start=self.q), "closed from the q given")
        self._choose()
        names = [*reversed([n for n in system.frame_names if n in system.structure.frames]), *system.body_names[:0:-1]]
        self.frames = tuple(names) or system.frame_names
        self.frame = self.frames[0] if frame is None else system.structure.frame_name(frame)
        self.task = self.usual_task()

    # ---- coordinates

    @property
    def sliders(self) -> tuple[Slider, ...]:
        """The independent coordinates, without those of idle spins, as they are now."""
        if self.chart is None:
            return ()
        values = self.chart.u(self.q)
        return tuple(self._slider(n, float(x)) for n, x in zip(self.chart.useful, values, strict=False))

    def _slider(self, name: str, value: float) -> Slider:
        names, system = self.system.structure.velocity_names, self.system
        if name not in names:
            return Slider(name, "rad", -BALL, BALL, value)
        i, unit = names.index(name), self._units.get(name, "rad")
        wide = FULL if unit == "rad" else self.size
        low, high = float(system.lower[i]), float(system.upper[i])
        about = value if abs(value) > wide else 0.0
        low = low if np.isfinite(low) else (high - 2 * wide if np.isfinite(high) else about - wide)
        high = high if np.isfinite(high) else max(low, about - wide) + 2 * wide
        return Slider(name, unit, min(low, value), max(high, value), value)

    @property
    def size(self) -> float:
        """How far [m] a slide without limits is moved: the extent of the drawing."""
        if not hasattr(self, "_size"):
            from kempe.views.drawing.scene import look

            self._size = look(self.system, self.q).size
        return self._size

    def set(self, name: str, value: float) -> None:
        """Set an independent coordinate; closed loops are led there in steps, and stay closed."""
        chart = self.chart
        if chart is None or name not in chart.useful:
            raise InputError(f"{name!r} is no independent coordinate here: {', '.join(chart.useful if chart else ())}")
        self.target = None
        k, known = chart.useful.index(name), self.system.coordinate_names
        if not chart.dependent and name in known:
            q = np.array(self.q)
            q[known.index(name)] = value
            if self._bare or judge(self.system, q):
                self._go(q, "")
                return
        u = chart.u(self.q)[: len(chart.useful)]
        wide = abs(value - u[k]) / (LEAD if self._units.get(name, "rad") == "rad" else LEAD * self.size)
        for x in np.linspace(float(u[k]), value, max(1, int(np.ceil(wide))) + 1)[1:]:
            u[k] = x
            answer = chart.q(u, self.q)
            self.status = "" if answer else answer.status
            if not answer:
                break
            self.q = answer.q
        if not chart.valid(self.q):
            self._choose()
        self._after()

    def _choose(self) -> None:
        """Find independent coordinates here, unless the loops are open."""
        with self._said():
            self.chart: Chart | None = independent(self.system, self.q)
            self.revision += 1
            if not self.chart.useful and not self.status:
                self.status = f"{self.system.name} has no freedoms: nothing moves"

    @contextlib.contextmanager
    def _said(self) -> Generator[None, None, None]:
        """What cannot be answered is said in the status."""
        try:
            yield
        except KempeError as error:
            self.status = str(error)

    def _take(self, answer: Any, said: str = "") -> bool:
        """Take the configuration of an answer if it is one that closes the loops, and its sentence."""
        self.status = said if answer else answer.status
        if answer or (np.isfinite(answer.q).all() and bool(judge(self.system, answer.q))):
            self.q = np.array(answer.q)
        return bool(answer)

    def _after(self) -> None:
        self.solutions = np.empty((0, self.system.nq))

    # ---- targets

    def usual_task(self) -> str:
        """What a frame can hold here: "pose" if it moves in every direction, else "position"."""
        if self.chart is None:
            return "position"
        with self._said():
            whole, tries = self._whole(), () if self.chart.dependent else random(self.system, 0, 4)
            rank = max(np.linalg.matrix_rank(self._rates(q), 1e-6) for q in (self.q, *tries))
            return "pose" if rank == whole else "position"
        return "position"

    def _whole(self) -> int:
        """Directions in which a frame can move that is free."""
        return 3 if self.system.dim == 2 else 6

    def _rates(self, q: Array) -> Array:
        """Rates (3 or 6, p) of the frame by the independent coordinates at q."""
        J = self.system.jacobian(q, self.frame)
        if self.chart is not None and self.chart.dependent:
            J = J @ self.chart.tangent(q)
        return J[[0, 1, 5]] if self.system.dim == 2 else J

    def aim(self, frame: Any, task: str | None = None) -> None:
        """Take another frame, and what of its targets counts (default: what it can hold here)."""
        self.frame = self.system.structure.frame_name(frame)
        self.task = self.usual_task() if task is None else task
        self._after()

    @property
    def pose(self) -> Array:
        """Pose (4, 4) of the frame."""
        return self.system.fk(self.q, self.frame)

    def reach(self, X: Array, quick: bool = True) -> bool:
        """Bring the frame to a pose (4, 4) from here, or as near as can be, and say why; whether it is reached.

        Loops stay closed and limits hold. `quick`: one search from here only, as while a target is dragged.
        """
        with self._said():
            budget = QUICK if quick else None
            answer = self.system.ik(X, self.frame, self.q, task=self.task, budget=budget)
            found = self._take(answer, "reached")
            self.target = None if found else X
            if self.chart is not None and not self.chart.valid(self.q):
                self._choose()
            self._after()
            return found
        return False

    def solve(self) -> int:
        """Find the other configurations with the frame where it is; their number, 0 where there is no plan for it."""
        self._after()
        if has_loops(self.system):
            return 0
        with contextlib.suppress(KempeError):
            found = self.system.ik_all(self.pose, self.frame, task=self.task, limits=True)
            q = np.asarray(found.q).reshape(-1, self.system.nq)
            self.solutions = q[distance(self.system, q, self.q) > 1e-4][:GHOSTS] if len(q) else q
        return len(self.solutions)

    def choose(self, k: int) -> None:
        """Go to one of the other solutions; the one that was left takes its place among them."""
        if not 0 <= k < len(self.solutions):
            raise InputError(f"there are {len(self.solutions)} other solutions; {k} is none of them")
        solutions = np.array(self.solutions)
        solutions[k], self.q = self.q, np.array(solutions[k])
        self.solutions, self.target = solutions, None
        self.status = f"another of {len(solutions) + 1} solutions with {self.frame} where it was"
        if self.chart is not None and not self.chart.valid(self.q):
            self._choose()

    def next_solution(self) -> None:
        """Go to the next configuration with the frame where it is."""
        if not len(self.solutions) and not self.solve():
            self.status = f"no other solution is known with {self.frame} here"
            return
        first, rest = self.solutions[0], self.solutions[1:]
        self.solutions = np.concatenate([rest, self.q[None]])
        self.q, self.target = np.array(first), None
        self.status = f"another of {len(rest) + 2} solutions with {self.frame} where it was"

    # ---- buttons

    def next_mode(self) -> None:
        """Go to the next way to assemble the loops with the independent coordinates as they are."""
        if not has_loops(self.system) or self.chart is None:
            self.status = f"{self.system.name} has no loops: there is one way to assemble it"
            return
        modes, k = self._modes
        if not len(modes) or not np.isclose(distance(self.system, modes[k], self.q), 0.0, atol=1e-6):
            known = {s.name: s.value for s in self.sliders if s.name in self.system.coordinate_names}
            with self._said():
                self.status = ""
                found = self.system.assembly_modes(known, self.q, budget=Budget(time_limit=3.0))
                modes = np.asarray(found.q).reshape(-1, self.system.nq)
                k = int(np.argmin(distance(self.system, modes, self.q))) if len(modes) else 0
        if len(modes) < 2:
            self.status = self.status or "one way to assemble it was found with these coordinates"
            return
        k = (k + 1) % len(modes)
        self._modes, self.q, self.target = (modes, k), np.array(modes[k]), None
        self.status = f"assembly mode {k + 1} of {len(modes)} found"
        self._choose()
        self._after()

    def random(self) -> None:
        """Go to a random configuration within the limits, with closed loops."""
        said = ""
        for _ in range(TRIES):
            start = random(self.system, self._rng)
            if judge(self.system, start):
                self._go(start, "a random configuration")
                return
            answer = self.system.assemble(start=start, budget=QUICK)
            if answer:
                self._go(answer.q, "a random configuration")
                return
            said = answer.status
        self.status = f"none of {TRIES} random starts closed the loops: {said}"

    def go(self, name: str) -> None:
        """Go to a posture of the model, or to 'neutral' or 'mid'; loops are closed from there."""
        own = {"neutral": self.system.neutral, "mid": mid(self.system)}
        q = own[name] if name in own and name not in self.system.structure.posture_names else self.system.q(name)
        if judge(self.system, q):
            self._go(q, f"posture {name}")
        elif answer := self.system.assemble(start=q):
            self._go(answer.q, f"closed from posture {name}")
        else:
            self.status = answer.status

    @property
    def postures(self) -> tuple[str, ...]:
        """Names that `go` takes."""
        return tuple(dict.fromkeys(("neutral", "mid", *self.system.structure.posture_names)))

    def put(self, q: Any) -> None:
        """Go to a configuration (nq,), as it is."""
        q = as_q(self.system, q)
        if q.shape != (self.system.nq,):
            raise InputError(f"q has shape {q.shape}; one configuration ({self.system.nq},) is shown")
        self._go(q, "")

    def _go(self, q: Array, said: str) -> None:
        self.q, self.status, self.target = np.array(q), said, None
        if self.chart is None or self.chart.dependent:
            self._choose()
        self._after()

    # ---- motions

    def at(self, part: float) -> None:
        """Go to a part (0 to 1) of the path."""
        if self.path is not None:
            k = round(float(np.clip(part, 0.0, 1.0)) * (len(self.path) - 1))
            if np.isfinite(self.path[k]).all():
                self.q, self.target = np.array(self.path[k]), None
                self._after()

    def curve(self) -> Array:
        """What the frame's origin passes: a line (n, 3) where `is_curve`, else points of what it reaches."""
        if self.path is not None:
            return self.system.fk(self.path, self.frame)[..., :3, 3]
        with self._said():
            if self.is_curve:
                motion = self.system.trace(self.sliders[0].name, self.q)
                return self.system.fk(motion.q, self.frame)[..., :3, 3]
            if not has_loops(self.system):
                return self.system.fk(random(self.system, 0, SEEN), self.frame)[..., :3, 3]
            found = self.system.assemble(start=random(self.system, 0, SEEN), budget=QUICK)
            return self.system.fk(found.q[np.asarray(found.success)], self.frame)[..., :3, 3]
        return np.empty((0, 3))

    @property
    def is_curve(self) -> bool:
        """Whether what `curve` gives is one line."""
        return self.path is not None or len(self.sliders) == 1

    def self_motion(self) -> bool:
        """Take what can be done with the frame at rest as the path; whether there is such a motion."""
        with self._said():
            motion = self.system.inverse.self_motion(self.q, self.frame, task=self.task)
            self.status = motion.status
            if len(motion.q) > 1:
                self.path = np.asarray(motion.q)
                return True
        return False

    # ---- what is said

    def residual(self) -> float:
        """The largest error of what the system holds, lengths in parts of a characteristic one, angles in radians."""
        return 0.0 if self._bare else float(np.abs(evaluate(self.system, self.q, False, True)[0]).max(initial=0.0))

    def singular(self) -> str:
        """How far the independent coordinates are from not moving the others, in a sentence."""
        if self.chart is None or not self.chart.useful:
            return ""
        if not self.chart.dependent:
            rows = self._rates(self.q)[: self.system.dim if self.task == "position" else None]
            size = np.linalg.svd(rows, compute_uv=False)
            least = size[min(len(rows), rows.shape[1]) - 1] / max(size[0], 1e-300)
            return f"{self.frame} is singular here" if least < SINGULAR else ""
        quality = self.chart.condition(self.q)
        word = "singular" if quality < 1e-6 else "near a singularity" if quality < 0.05 else "regular"
        return f"{word} (conditioning {quality:.2g})"

    def mobility(self) -> str:
        """Degrees of freedom here, and how they were counted."""
        with self._said():
            found = self.system.mobility(self.q)
            return f"{found.dof} degree{'s' * (found.dof != 1)} of freedom: {found.status}"
        return ""

    def said(self) -> str:
        """The live sentences: residual, singularity, and what the last thing done led to; Markdown."""
        lines = [f"closed to {self.residual():.1e}" if not self._bare else "", self.singular(),
                 self.status]  # fmt: skip
        return "\n\n".join(line for line in lines if line)
