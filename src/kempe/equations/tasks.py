"""Constraints as tasks: ties for the kernels, goals, and a measure by the forward model.

The operations of a constraint's rows decide which class it needs (`task_of`).
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kempe import spatial
from kempe.arrays import named
from kempe.constraints.base import (
    HERE,
    Constraint,
    Op,
    Row,
    held,
    numbers_of,
    one_sided,
    with_numbers,
)
from kempe.description.mechanism import reads_axes
from kempe.equations.judge import apart, missed, shape_of
from kempe.equations.task_functions import bound
from kempe.errors import InputError
from kempe.forward.fk import fk
from kempe.kernels.constraints import loop_layout as L
from kempe.model.configurations import as_q, check_read, circles, q_from_dict
from kempe.model.constraint_program import Centre, Tie, every_tie, input_of, plain_rows
from kempe.model.model import kept
from kempe.model.primitive_table import Table
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

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
    def structure(self, system: Model) -> Hashable:
        """All that decides its ties but the goal. Errors: `UnknownNameError` and others for what
        does not fit.
        """

    @abstractmethod
    def ties(self, system: Model, table: Table) -> list[Tie]:
        """Its ties for the kernels."""

    @abstractmethod
    def goals(self, system: Model) -> Goals:
        """The goal of each of its ties."""

    def coordinates(self, system: Model) -> set[str]:
        """Names of the velocity coordinates in which a whole turn is not nothing to it."""
        return set()

    @abstractmethod
    def measure(
        self, system: Model, q: Array, goals: Goals | None = None, at: At | None = None
    ) -> tuple[Array, Array]:
        """How far (...) it is missed at q (..., nq), in metres and in radians, by the forward
        model.

        `goals` are its own, where they are at hand; `at` gives the poses of frames in place of the
        forward model.
        """


# ---- constraints on frames and on centres of masses


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

    def hold(self, system: Model) -> TaskTie:
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

    def goal(self, system: Model) -> Array:
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

    def holds(self, system: Model) -> list[TaskTie]:
        """One tie, or one for each end that is finite anywhere and differs from target to target."""
        if self._holds is None:
            self._holds = self._all_holds(system)
        return self._holds

    def _all_holds(self, system: Model) -> list[TaskTie]:
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

    def structure(self, system: Model) -> Hashable:
        """What the ties depend on: what they hold."""
        return tuple(self.holds(system))

    def ties(self, system: Model, table: Table) -> list[Tie]:
        """The ties of the task, one for each hold."""
        return [self._tie(system, table, h) for h in self.holds(system)]

    def _tie(self, system: Model, table: Table, h: TaskTie) -> Tie:
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

    def centre(self, system: Model, table: Table) -> Centre | None:
        """The centre that takes the place of frame B, if any."""
        return None

    def goals(self, system: Model) -> Goals:
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

    def place(self, system: Model, at: At, hold: TaskTie | None = None) -> Array:
        """Where (..., 4, 4) the frame is in the ground."""
        h = hold or self.hold(system)
        X = at(h.b)
        return X if h.X_B is HERE else X @ np.reshape(h.X_B, (4, 4))

    def measure(
        self, system: Model, q: Array, goals: Goals | None = None, at: At | None = None
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

    def hold(self, system: Model) -> TaskTie:
        """The axes that count."""
        return TaskTie(system.body_names[0], HERE, self.shape.mask)

    def _points(self, system: Model) -> tuple[tuple[str, tuple[float, ...], float], ...]:
        """Frames, points on them and their masses, whose sum is 1."""
        if self._shares is None:
            shares = self.of.masses(system._mechanism.bodies, system.name)
            self._shares = tuple(
                (system.structure.frame_name(m.frame), m.point, m.part) for m in shares
            )
        return self._shares

    def structure(self, system: Model) -> Hashable:
        """Its tie and its points."""
        return super().structure(system), self._points(system)

    def centre(self, system: Model, table: Table) -> Centre:
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

    def place(self, system: Model, at: At, hold: TaskTie | None = None) -> Array:
        """The centre of mass in the ground frame."""
        points = self._points(system)
        names, moments = _moments(system, points)
        return spatial.pose(p=np.einsum("...kij,kj->...i", at(names)[..., :3, :], moments))


@kept
def _moments(
    system: Model, points: tuple[tuple[str, tuple[float, ...], float], ...]
) -> tuple[list[str] | None, Array]:
    """Frames, None for all bodies, and for each of them what its pose is multiplied by to give its
    part of a centre.
    """
    # all bodies are quicker than some
    names = list(dict.fromkeys([*system.body_names, *(f for f, _, _ in points)]))
    moments = np.zeros((len(names), 4))
    for f, p, mass in points:
        moments[names.index(f)] += *(mass * x for x in p), mass
    return None if len(names) == len(system.body_names) else names, moments


# ---- constraints on coordinates


class CoordinateTask(Task):
    """A constraint on coordinates, at values of the field `q`."""

    angles = True

    def _values(self, system: Model) -> tuple[Array, list[tuple[str, int, int, bool]]]:
        """The values as (..., nq), and for each tie its name, place in q, velocity coordinate,
        whether it is a ball.
        """
        layout = system.structure.layout
        items: list[tuple[str, int, int, bool]]
        items = [
            (system.coordinate_names[int(i)], int(i), int(v), False)
            for i, v in zip(layout.vector_q, layout.vector_v, strict=True)
        ]
        items += [
            (system.coordinate_names[int(i)], int(i), int(v), True)
            for i, v in zip(layout.quaternion_q, layout.quaternion_v, strict=True)
        ]
        items.sort(key=lambda item: item[1])
        given = named(self.of.q)
        if given is None:
            return as_q(system, self.of.q), items
        # refuses names that are none, or follow others
        q_from_dict(system, dict.fromkeys(given, 0.0))
        index = {n: i for i, n in enumerate(system.coordinate_names)}
        values = [numbers_of(x, f"{k!r} of {self.label}") for k, x in given.items()]
        out = np.empty((*np.broadcast_shapes(*(x.shape for x in values)), system.nq))
        out[:] = system.neutral
        for name, x in zip(given, values, strict=True):
            out[..., index[name]] = x
        balls = [item for item in items if item[3]]
        whole = [
            item
            for item in balls
            if {*system.coordinate_names[item[1] : item[1] + 4]} & given.keys()
        ]
        for _, i, _, _ in whole:
            missing = [n for n in system.coordinate_names[i : i + 4] if n not in given]
            if missing:
                raise InputError(
                    f"a quaternion is given as a whole; missing are {', '.join(missing)}"
                )
        return out, [item for item in items if (item in whole if item[3] else item[0] in given)]

    def structure(self, system: Model) -> Hashable:
        """The names of the coordinates that are held."""
        return tuple(name for name, *_ in self._values(system)[1])

    def ties(self, system: Model, table: Table) -> list[Tie]:
        """One for each coordinate or quaternion."""
        return [
            Tie(self.label, GROUND, GROUND, turns=L.OWN, given=True, own=v, ball=ball)
            for _, _, v, ball in self._values(system)[1]
        ]

    def coordinates(self, system: Model) -> set[str]:
        """The coordinates that it reads: those that it holds."""
        return {system.structure.velocity_names[v] for _, _, v, _ in self._values(system)[1]}

    def goals(self, system: Model) -> Goals:
        """The values at which coordinates are held."""
        values, items = self._values(system)
        out: Goals = []
        for name, i, _, ball in items:
            x = values[..., i : i + (4 if ball else 1)]
            if ball and np.any(np.linalg.norm(x, axis=-1) == 0.0):
                raise InputError(f"the quaternion at {name!r} of {self.label} is zero")
            out.append((None, x / np.linalg.norm(x, axis=-1, keepdims=True) if ball else x))
        return out

    def measure(
        self, system: Model, q: Array, goals: Goals | None = None, at: At | None = None
    ) -> tuple[Array, Array]:
        """The largest difference of a slide and of a turn."""
        values, items = self._values(system)
        if goals is not None:  # of one row of a batch, it may be
            values = np.broadcast_to(system.neutral, q.shape).copy()
            for (_, i, _, ball), (_, x) in zip(items, goals, strict=True):
                assert x is not None
                values[..., i : i + (4 if ball else 1)] = x
        d = np.abs(system.structure.layout.difference(np.broadcast_to(values, q.shape), q))
        round_ = circles(system)
        d[..., round_] = np.abs(
            d[..., round_] - 2.0 * np.pi * np.round(d[..., round_] / (2.0 * np.pi))
        )
        turning = system.structure.coordinates.turning
        slides = [v for _, _, v, ball in items if not ball and not turning[v]]
        turns = [v for _, _, v, ball in items if not ball and turning[v]]
        balls = [np.linalg.norm(d[..., v : v + 3], axis=-1) for _, _, v, ball in items if ball]
        angle = np.max(np.stack([d[..., turns].max(axis=-1, initial=0.0), *balls]), axis=0)
        return d[..., slides].max(axis=-1, initial=0.0), angle


# ---- constraints by expressions or functions, or with rows of several kinds


class Made(NamedTuple):
    """A constraint in a system: with its parameters and functions; its rows of position, and its
    ties on no frames.
    """

    system: Model
    of: Constraint
    rows: list[Row]
    ties: list[Tie]


class Written(Task):
    """A constraint on values of expressions and functions: of poses, coordinates, parameters, and
    its own numbers.

    The goal and the numbers come with each call; parameters, and what functions are, do not.
    """

    _made: Made | None = None

    def __init__(self, of: Constraint, dim: int, rows: tuple[Row, ...]):
        super().__init__(of, dim, rows)
        units = {r.unit for r in self.rows}
        self.lengths = "m" in units
        self.angles = units != {"m"}
        self.lasting = all(r.op is not Op.CALL for r in self.rows)
        self.tool = np.reshape(of.tool(dim), (4, 4))
        self.posed = of.ends[1] is not None

    def made(self, system: Model) -> Made:
        """It in a system. Errors: `UnknownNameError` for coordinates that do not exist."""
        if self._made is None or self._made.system is not system:
            of = bound(
                system,
                with_numbers(
                    self.of.knowing(system.structure.parameters), system.structure.parameters
                ),
            )
            check_read(system, of.reads, self.label)
            ties = every_tie(system, self.label, of, GROUND, GROUND, True)
            check_read(system, [n for t in ties if t.tape for n in t.tape.coordinates], self.label)
            self._made = Made(system, of, plain_rows(of, self.dim, True), ties)
        return self._made

    def names(self, system: Model) -> tuple[str | None, str | None]:
        """The frames A and B. Errors: `UnknownNameError`."""
        a, b = (None if e is None else system.structure.frame_name(e) for e in self.of.ends)
        return a, b

    def structure(self, system: Model) -> Hashable:
        """Its frames, and its expressions without the numbers of the call."""
        each = (
            (t.mask, t.turns, t.bounds, t.tape and (t.tape.tape, t.tape.unit, t.tape.given))
            for t in self.made(system).ties
        )
        return self.names(system), self.tool.tobytes(), *each

    def ties(self, system: Model, table: Table) -> list[Tie]:
        """The packed constraints of the expressions: one for all equations and one for each group
        of inequalities.

        `table` holds the frames in which the poses are. Constraints that read poses have a goal,
        which comes with each call. Errors: `InputError` where axes of a particle are read.
        """
        if not self.posed:
            return every_tie(system, self.label, self.made(system).of, GROUND, GROUND, True)
        a, b = self.names(system)
        A = GROUND if a is None else table.at[a]
        (row, X, particle) = table.at[b]
        rows = self.made(system).rows
        turned = particle and (any(map(reads_axes, rows)) or np.any(self.tool[:3, 3]))
        if turned or (A[2] and any(r.op is not Op.DISTANCE for r in rows)):
            name = b if turned else a
            raise InputError(
                f"{name!r} is a particle, which has no axes: {self.label} cannot be required of it"
            )
        found = every_tie(
            system, self.label, self.made(system).of, A, (row, X @ self.tool, particle), True
        )
        return [t if t.function else replace(t, pin=True) for t in found]

    def coordinates(self, system: Model) -> set[str]:
        """Those that it reads, or those that they follow."""
        first = system.structure.coordinates.first
        found: set[int] = set()
        for t in self.made(system).ties:
            found |= {first[n][1] for n in t.tape.coordinates} if t.tape else found
            found |= set(t.function.support) if t.function else found
        return {system.structure.velocity_names[v] for v in found}

    def goals(self, system: Model) -> Goals:
        """For each tie the goal, and its numbers; ends that only some targets have are far away."""
        _, of, _, ties = self.made(system)
        goal = of.goal(self.dim) if self.posed else None
        out: list[tuple[Array | None, Array | None]] = []
        for tie in ties:
            given = [
                numbers_of(input_of(of, n), f"{n} of {self.label}")
                for n in (tie.tape.given if tie.tape else ())
            ]
            numbers = np.stack(np.broadcast_arrays(*given), axis=-1) if given else None
            if numbers is not None and tie.bounds:
                numbers = np.where(np.isinf(numbers), np.clip(numbers, -FAR, FAR), numbers)
            out.append((None if tie.function else goal, numbers))
        return out

    def measure(
        self, system: Model, q: Array, goals: Goals | None = None, at: At | None = None
    ) -> tuple[Array, Array]:
        """How far its values are from where they must be, by the forward model and plain numpy."""
        _, of, rows, ties = self.made(system)
        goals = self.goals(system) if goals is None else goals
        at = at or partial(fk, system, q)
        given: dict[str, Array] = {}
        A = None
        B = None
        for tie, (goal, numbers) in zip(ties, goals, strict=True):
            if numbers is not None and tie.tape:
                given |= {n: numbers[..., k] for k, n in enumerate(tie.tape.given)}
            A = goal if A is None else A
        if A is not None:
            a, b = self.names(system)
            A = A if a is None else at(a) @ A
            B = at(b) @ self.tool
        return missed(system, of, rows, q, A, B, given)


# ---- the class for a constraint

FAMILIES: dict[Op, type[Task]] = {Op.COORDINATE: CoordinateTask, Op.TAPE: Written, Op.CALL: Written}
"""Which class asks for rows of an operation; `PlacedTask` for all others."""


def task_of(constraint: Constraint, dim: int) -> Task:
    """The constraint as a task. Errors: `InputError` where it cannot be required of a
    configuration.
    """
    rows = constraint.rows(dim)
    constraint.check(dim)
    family = family_of(rows)
    if family is None:
        raise InputError(
            f"{constraint.label} is about velocities, which no configuration has: declare it by "
            "Mechanism.constrain"
        )
    if family is PlacedTask and constraint.ends[1] is None:  # a centre is no frame
        family = Centred
    return family(constraint, dim, rows)


@lru_cache(maxsize=512)
def family_of(rows: tuple[Row, ...]) -> type[Task] | None:
    """The class that asks for these rows; None where some are about velocities."""
    ops = [r.op for r in rows]
    if Op.VELOCITY in ops:
        return None
    families = {FAMILIES.get(op, PlacedTask) for op in ops}
    if families != {PlacedTask}:
        return families.pop() if len(families) == 1 else Written
    further = [r for r in rows if r.op is not Op.POINT]
    sided = {bool(r.low or r.high) for r in rows}
    valued = any(r.equal for r in rows if r.op is not Op.DISTANCE)
    alone = len(further) <= 1 and (len(rows) == 1 or Op.DISTANCE not in ops)
    return (
        PlacedTask
        if alone
        and len(sided) == 1
        and not valued
        and not (sided == {True} and further and further[0].op is not Op.DISTANCE)
        else Written
    )
