"""A constraint as what a configuration shall do: ties for the kernels, goals, and a measure by the
forward model.

Which of the classes below a constraint needs follows from the operations of its rows (`task_of`).
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.constraints.base import HERE, Constraint, Row, held, one_sided
from kempe.constraints.reading import numbers_of
from kempe.errors import InputError
from kempe.kernels.constraints import loop_layout as L
from kempe.kinematics.forward import fk
from kempe.kinematics.measure import apart, shape_of
from kempe.model.closures.packed_loops import Centre, Tie
from kempe.model.kept import kept
from kempe.model.tree.primitive_table import Table
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.compiled_system import Compiled

GROUND = (-1, np.eye(4), False)

Goals = list[tuple[Array | None, Array | None]]
"""For each tie of a task the pose (..., 4, 4) that it is pinned at and the numbers (..., k) that it
is given."""

TILTS = (L.ALIGN, L.LOOK)
"""Ties on an axis, whose second equation holds of itself in the plane."""
ABOVE = (0.0, np.inf)
BELOW = (-np.inf, 0.0)
"""Bounds of what is measured from an end."""
FAR = 1e6
"""Where an end is put that only some targets have, in metres."""
At = Callable[[Any], Array]
"""Poses (..., 4, 4) of a frame by name; of a list of names, or of all bodies for None, (..., n, 4,
4)."""


class TaskTie(NamedTuple):
    """One tie of a task: frame `b`, with `X_B` (4, 4, as a tuple) on it, in the goal, which hangs
    on `a` or stands.
    """

    b: str
    X_B: tuple[float, ...]
    mask: int
    turns: int = L.NO_TURN
    a: str | None = None
    bounds: tuple[tuple[float, float], ...] = ()
    given: bool = False
    """Whether it has a number, such as a distance."""


class Task(ABC):
    """A constraint `of` that is requested; see `kempe.constraints`."""

    lengths: bool = True
    """Whether its error has a part in metres."""
    angles: bool = False
    """Whether its error has a part in radians."""
    lasting: bool = True
    """Whether its ties can be kept for the next task of the same structure."""

    def __init__(self, of: Constraint, dim: int, rows: tuple[Row, ...]):
        self.of: Any = of
        self.dim = dim
        self.rows = rows
        self.label = of.label
        self.weight = of.weight
        self.priority = of.priority
        self.tolerance = of.tolerance
        self.name = of.name

    def exactly(self) -> Task:
        """The same without a tolerance of its own."""
        out = copy.copy(self)
        out.tolerance = None
        return out

    @abstractmethod
    def structure(self, system: Compiled) -> Hashable:
        """All that decides its ties but the goal. Errors: `UnknownNameError` and others for what
        does not fit.
        """

    @abstractmethod
    def ties(self, system: Compiled, table: Table) -> list[Tie]:
        """Its ties for the kernels."""

    @abstractmethod
    def goals(self, system: Compiled) -> Goals:
        """The goal of each of its ties."""

    def coordinates(self, system: Compiled) -> set[str]:
        """Names of the velocity coordinates in which a whole turn is not nothing to it."""
        return set()

    @abstractmethod
    def measure(
        self, system: Compiled, q: Array, goals: Goals | None = None, at: At | None = None
    ) -> tuple[Array, Array]:
        """How far (...) it is missed at q (..., nq), in metres and in radians, by the forward
        model.

        `goals` are its own, where they are at hand; `at` gives the poses of frames in place of the
        forward model.
        """


class PlacedTask(Task):
    """A constraint on where one frame, or a centre, is in the goal."""

    _holds: list[TaskTie] | None = None
    _ends: tuple[Array, Array] | None = None

    def __init__(self, of: Constraint, dim: int, rows: tuple[Row, ...]):
        super().__init__(of, dim, rows)
        self.shape = shape = shape_of(rows, dim)
        self.lengths = shape.lengths
        self.angles = shape.angles
        self.turned = shape.turned
        self.number = held(of, rows[0])
        self.bounded = one_sided(of, rows[0])
        self.point = shape.point and not self.bounded
        """Whether it holds a point of the frame, or the whole frame."""

    # ---- what is held

    def hold(self, system: Compiled) -> TaskTie:
        """Its tie, without bounds."""
        a, b = self.of.ends
        name = None if a is None else system.structure.frame_name(a)
        return TaskTie(
            system.structure.frame_name(b),
            self.of.tool(self.dim),
            self.shape.mask,
            self.shape.turns,
            name,
            (),
            self.shape.turns == L.DISTANCE,
        )

    def goal(self, system: Compiled) -> Array:
        """The pose (..., 4, 4) of the goal in the ground, or in the frame that it hangs on."""
        return self.of.goal(self.dim)

    def ends(self) -> tuple[Array, Array] | None:
        """Low and high ends (n,), or (..., n) from target to target; None for an equality."""
        if self._ends is None and self.bounded:
            low = self._side([r.low for r in self.rows], -np.inf)
            high = self._side([r.high for r in self.rows], np.inf)
            if low.shape != high.shape:
                low, high = np.broadcast_arrays(low, high)
            self._ends = low, high
        return self._ends

    def _side(self, names: list[str], infinity: float) -> Array:
        """The ends (..., n) of one side."""
        given: dict[str, Array | None] = {}
        for n in names:
            if n not in given:
                x = getattr(self.of, n) if n else None
                given[n] = None if x is None else numbers_of(x, f"{n} of {self.label}")
        one = given[names[0]]
        parts = [r.part for r in self.rows]
        if one is not None and len(given) == 1 and None not in parts:
            return one[..., np.array(parts)]
        ends = [(given[n], k) for n, k in zip(names, parts, strict=True)]
        values = [
            np.array(infinity) if x is None else x if k is None else x[..., k] for x, k in ends
        ]
        return (
            values[0][..., None]
            if len(values) == 1
            else np.stack(np.broadcast_arrays(*values), axis=-1)
        )

    def holds(self, system: Compiled) -> list[TaskTie]:
        """One tie, or one for each end that is finite anywhere and differs from target to target."""
        if self._holds is None:
            self._holds = self._all_holds(system)
        return self._holds

    def _all_holds(self, system: Compiled) -> list[TaskTie]:
        h = self.hold(system)
        ends = self.ends()
        if ends is None:
            return [h]
        if ends[0].ndim == 1:
            if not np.all((ends[0] <= ends[1]) & (ends[0] < np.inf) & (ends[1] > -np.inf)):
                low, high = (x.tolist() for x in ends)
                raise InputError(f"{self.label} holds between {low} and {high}, which is nothing")
            return [h._replace(bounds=tuple(zip(ends[0].tolist(), ends[1].tolist(), strict=True)))]
        n = ends[0].shape[-1]
        return [h._replace(bounds=(bound,) * n) for bound, _ in _sides(*ends)]

    def structure(self, system: Compiled) -> Hashable:
        """What the ties depend on: what they hold."""
        return tuple(self.holds(system))

    def ties(self, system: Compiled, table: Table) -> list[Tie]:
        """The ties of the task, one for each hold."""
        return [self._tie(system, table, h) for h in self.holds(system)]

    def _tie(self, system: Compiled, table: Table, h: TaskTie) -> Tie:
        a = GROUND if h.a is None else table.at[h.a]
        row, X, particle = table.at[h.b]
        b = (row, X @ np.reshape(h.X_B, (4, 4)), particle)
        tie = Tie(
            self.label,
            a,
            b,
            h.mask,
            h.turns,
            pin=True,
            given=h.given,
            bounds=h.bounds,
            centre=self.centre(system, table),
        )
        turned = h.turns not in (L.NO_TURN, L.DISTANCE) or any(h.X_B[k] for k in (3, 7, 11))
        leaned = a[2] and (h.turns != L.DISTANCE or np.any(self.goal(system)[..., :3, 3]))
        if (particle and turned) or leaned:
            name = h.b if particle and turned else h.a
            raise InputError(
                f"{name!r} is a particle, which has no axes: {self.label} cannot be required of it"
            )
        return tie

    def centre(self, system: Compiled, table: Table) -> Centre | None:
        """The centre that takes the place of frame B, if any."""
        return None

    def goals(self, system: Compiled) -> Goals:
        """The goal's pose and its number; moved to each end that has a tie."""
        goal = self.goal(system)
        ends = self.ends()
        distance = self.shape.turns == L.DISTANCE
        if ends is None or ends[0].ndim == 1:
            number = None
            if distance:
                given = getattr(self.of, self.number) if self.number else 0.0
                number = numbers_of(given, f"{self.number} of {self.label}")[..., None]
            return [(goal, number)]
        out: Goals = []
        for _, end in _sides(*ends):
            if distance:
                out.append((goal, end))
            else:
                p = np.zeros((*end.shape[:-1], 3))
                p[..., self.shape.axes] = end
                out.append((goal @ spatial.pose(p=p), None))
        return out

    # ---- how far it is missed

    def place(self, system: Compiled, at: At, hold: TaskTie | None = None) -> Array:
        """Where (..., 4, 4) the frame is in the ground."""
        h = hold or self.hold(system)
        X = at(h.b)
        return X if h.X_B is HERE else X @ np.reshape(h.X_B, (4, 4))

    def measure(
        self, system: Compiled, q: Array, goals: Goals | None = None, at: At | None = None
    ) -> tuple[Array, Array]:
        """How far (...) it is missed at q (..., nq), in metres and in radians, by the forward
        model.
        """
        holds = self.holds(system)
        goals = self.goals(system) if goals is None else goals
        at = at or partial(fk, system, q)
        X = self.place(system, at, holds[0])
        with np.errstate(invalid="ignore", over="ignore"):  # of goals that are not finite
            misses = [self._apart(at, h, X, *g) for h, g in zip(holds, goals, strict=True)]
            if len(misses) == 1:
                return misses[0]
            return np.sqrt(sum(size * size for size, _ in misses)), misses[0][1]

    def _apart(
        self, at: At, h: TaskTie, X: Array, goal: Array | None, number: Array | None
    ) -> tuple[Array, Array]:
        """How far (...) the frame at X (..., 4, 4) misses a goal."""
        assert goal is not None
        if h.a is not None:
            goal = at(h.a) @ goal
        return apart(goal, X, self.shape, self.point, number, h.bounds)


def _sides(low: Array, high: Array) -> list[tuple[tuple[float, float], Array]]:
    """Bounds and ends of the sides on which there is an end anywhere."""
    sides = ((ABOVE, low), (BELOW, high))
    return [(bound, np.clip(end, -FAR, FAR)) for bound, end in sides if not np.isinf(end).all()]


class Centred(PlacedTask):
    """A constraint on a centre of masses."""

    _shares: tuple[tuple[str, tuple[float, ...], float], ...] | None = None

    def hold(self, system: Compiled) -> TaskTie:
        """The axes that count."""
        return TaskTie(system.body_names[0], HERE, self.shape.mask)

    def _points(self, system: Compiled) -> tuple[tuple[str, tuple[float, ...], float], ...]:
        """Frames, points on them and their masses, whose sum is 1."""
        if self._shares is None:
            shares = self.of.masses(system._mechanism.bodies, system.name)
            self._shares = tuple(
                (system.structure.frame_name(m.frame), m.point, m.part) for m in shares
            )
        return self._shares

    def structure(self, system: Compiled) -> Hashable:
        """Its tie and its points."""
        return super().structure(system), self._points(system)

    def centre(self, system: Compiled, table: Table) -> Centre:
        """The masses on the rows of the table."""
        rows = np.zeros((len(table.kind), 4))
        rest = np.zeros(3)
        for frame, point, mass in self._points(system):
            row, X, _ = table.at[frame]
            p = X[:3, :3] @ point + X[:3, 3]
            if row < 0:
                rest += mass * p
            else:
                rows[row] += mass, *(mass * p)
        return Centre(rows, rest)

    def place(self, system: Compiled, at: At, hold: TaskTie | None = None) -> Array:
        """The centre of mass in the ground frame."""
        points = self._points(system)
        names, moments = _moments(system, points)
        return spatial.pose(p=np.einsum("...kij,kj->...i", at(names)[..., :3, :], moments))


@kept
def _moments(
    system: Compiled, points: tuple[tuple[str, tuple[float, ...], float], ...]
) -> tuple[list[str] | None, Array]:
    """Frames, None for all bodies, and for each of them what its pose is multiplied by to give its
    part of a centre.
    """
    names = list(
        dict.fromkeys([*system.body_names, *(f for f, _, _ in points)])
    )  # all bodies are quicker than some
    moments = np.zeros((len(names), 4))
    for f, p, mass in points:
        moments[names.index(f)] += *(mass * x for x in p), mass
    return None if len(names) == len(system.body_names) else names, moments
