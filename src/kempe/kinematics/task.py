"""What a task is: frames held at, in or near places, as ties for the kernels and as a measure by the forward model."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from kempe import spatial
from kempe.calls import explained_methods, numbers
from kempe.errors import InputError
from kempe.kernels import loop_layout as L
from kempe.kinematics.configuration import as_q
from kempe.kinematics.forward import fk
from kempe.model.loops import Centre, Loops, Tie, pack
from kempe.model.own_tree import own_tree
from kempe.model.table import Table
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

_LAST = np.array([0.0, 0.0, 0.0, 1.0])
GROUND = (-1, np.eye(4), False)
RIGID, ROUNDING = 1e-6, 1e-9
"""How far a pose may be from a rigid motion, and a coordinate outside its limits."""


Goals = list[tuple[Array | None, Array | None]]
"""For each tie of a task the pose (..., 4, 4) that it is pinned at and the numbers (..., k) that it is given."""


HERE = tuple(np.eye(4).ravel().tolist())
"""The frame itself."""
LARGEST = 1e100
"""Numbers above this are too large for the kernels."""
TILTS = (L.ALIGN, L.LOOK)
"""Ties on an axis, whose second equation holds of itself in the plane."""


class Hold(NamedTuple):
    """One tie of a task: frame `b`, with `X_B` (4, 4, as a tuple) on it, in the goal, which hangs on `a` or stands."""

    b: str
    X_B: tuple[float, ...]
    mask: int
    turns: int = L.NO_TURN
    a: str | None = None
    bounds: tuple[tuple[float, float], ...] = ()
    given: bool = False
    """Whether it has a number, such as a distance."""


@explained_methods
@dataclass(frozen=True, eq=False)
class Task(ABC):
    """Something asked of a configuration; see `kempe.kinematics.tasks`.

    Without a `weight` it is hard: it must hold. With one it is soft: the sum of weight times squared error, in radians
    and characteristic lengths of the system, is made least. Tasks of a lower `priority` number come first: the others
    act only in what these leave free. `tolerance` is the largest error of a hard task, a number or (metres, radians);
    default: that of the call. `name` is how answers call it.
    """

    weight: float | None = field(default=None, kw_only=True)
    priority: int = field(default=0, kw_only=True)
    tolerance: float | tuple[float, float] | None = field(default=None, kw_only=True)
    name: str = field(default="", kw_only=True)

    lengths: ClassVar[bool] = True
    """Whether its error has a part in metres."""
    angles: ClassVar[bool] = False
    """Whether its error has a part in radians."""
    lasting: ClassVar[bool] = True
    """Whether its ties can be kept for the next task of the same structure."""

    @property
    @abstractmethod
    def about(self) -> str:
        """What it is about: the frames."""

    @cached_property
    def label(self) -> str:
        """How answers call it."""
        return self.name or f"{type(self).__name__} of {self.about}"

    @abstractmethod
    def structure(self, system: System) -> Hashable:
        """All that decides its ties but the goal. Errors: `UnknownNameError` and others for what does not fit."""

    @abstractmethod
    def ties(self, system: System, table: Table) -> list[Tie]:
        """Its ties for the kernels."""

    @abstractmethod
    def goals(self, system: System) -> Goals:
        """The goal of each of its ties."""

    def coordinates(self, system: System) -> set[str]:
        """Names of the velocity coordinates in which a whole turn is not nothing to it."""
        return set()

    @abstractmethod
    def measure(self, system: System, q: Array, goals: Goals | None = None) -> tuple[Array, Array]:
        """How far (...) it is missed at q (..., nq), in metres and in radians, by the forward model.

        `goals` are its own, where they are at hand.
        """

    def m(self, system: System) -> int:
        """Number of equations, inequalities included."""
        return Packed(system, [self]).count([0], True)

    def error(self, system: System, q: Any) -> Array:
        """Its equations (..., m) at q (..., nq), in metres and radians, before bounds; zero where an equality holds."""
        return Packed(system, [self], length=1.0).evaluate(q)[0]

    def jacobian(self, system: System, q: Any) -> Array:
        """Derivatives (..., m, nv) of `error` by the velocity coordinates, exact."""
        return Packed(system, [self], length=1.0).evaluate(q)[1]


class Placed(Task):
    """A task on where one frame, or a centre, is in the goal. Subclasses say what is held and how it is measured."""

    @abstractmethod
    def hold(self, system: System) -> Hold:
        """The tie."""

    @abstractmethod
    def goal(self, system: System) -> Array:
        """The pose (..., 4, 4) of the goal in the ground, or in the frame that it hangs on."""

    @abstractmethod
    def miss(self, X: Array) -> tuple[Array, Array]:
        """How far (...) it is missed in metres and radians, from the pose X (..., 4, 4) of the frame in the goal."""

    @property
    def number(self) -> Array | None:
        """The number (...) that the tie is given."""
        return None

    def holds(self, system: System) -> list[Hold]:
        """All its ties."""
        return [self.hold(system)]

    def structure(self, system: System) -> Hashable:
        """Its ties."""
        return tuple(self.holds(system))

    def ties(self, system: System, table: Table) -> list[Tie]:
        """Its ties."""
        return [self._tie(system, table, h) for h in self.holds(system)]

    def _tie(self, system: System, table: Table, h: Hold) -> Tie:
        a = GROUND if h.a is None else table.at[h.a]
        row, X, particle = table.at[h.b]
        b = (row, X @ np.reshape(h.X_B, (4, 4)), particle)
        tie = Tie(self.label, a, b, h.mask, h.turns, pin=True, given=h.given, bounds=h.bounds, centre=self.centre(
            system, table))  # fmt: skip
        turned = h.turns not in (L.NO_TURN, L.DISTANCE) or any(h.X_B[k] for k in (3, 7, 11))
        leaned = a[2] and (h.turns != L.DISTANCE or np.any(self.goal(system)[..., :3, 3]))
        if (particle and turned) or leaned:
            name = h.b if particle and turned else h.a
            raise InputError(f"{name!r} is a particle, which has no axes: {self.label} cannot be asked of it")
        return tie

    def centre(self, system: System, table: Table) -> Centre | None:
        """The centre that takes the place of frame B, if any."""
        return None

    def goals(self, system: System) -> Goals:
        """The goal's pose and its number."""
        number = self.number
        return [(self.goal(system), None if number is None else np.asarray(number, dtype=float)[..., None])]

    def place(self, system: System, q: Array, hold: Hold | None = None) -> Array:
        """Where (..., 4, 4) the frame is in the ground, by the forward model."""
        h = hold or self.hold(system)
        X = fk(system, q, h.b)
        return X if h.X_B is HERE else X @ np.reshape(h.X_B, (4, 4))

    def measure(self, system: System, q: Array, goals: Goals | None = None) -> tuple[Array, Array]:
        """How far (...) it is missed at q (..., nq), in metres and in radians, by the forward model."""
        hold, given = self.hold(system), None if goals is None else goals[0][0]
        goal = self.goal(system) if given is None else given
        with np.errstate(invalid="ignore", over="ignore"):  # of goals that are not finite
            if hold.a is not None:
                goal = fk(system, q, hold.a) @ goal
            return self.apart(goal, self.place(system, q, hold))

    def apart(self, goal: Array, X: Array) -> tuple[Array, Array]:
        """How far (...) the frame at X (..., 4, 4) misses the goal, both seen from the ground."""
        return self.miss(spatial.inverse(goal) @ X)


# ---- reading arguments


def poses_of(x: Any, dim: int, what: str) -> Array:
    """Poses (..., 4, 4) as given, in the plane also (..., 3, 3); kernels check rotations. Errors: `InputError`."""
    X = numbers_of(x, what)
    if dim == 2 and X.ndim >= 2 and X.shape[-2:] == (3, 3):
        flat, X = X, np.zeros((*X.shape[:-2], 4, 4))
        X[..., :2, :2], X[..., :2, 3], X[..., 2, 2], X[..., 3, 3] = flat[..., :2, :2], flat[..., :2, 2], 1.0, 1.0
    if X.ndim < 2 or X.shape[-2:] != (4, 4):
        raise InputError(f"{what} has shape {X.shape}; it must be a pose (..., 4, 4)")
    last = X[..., 3, :]
    if not (last == _LAST).all() and not np.all((last == _LAST) | np.isnan(last)):
        raise InputError(f"{what} is no pose: its last row is {X[..., 3, :].tolist()}; it must be 0 0 0 1")
    if dim == 2 and (np.any(np.abs(X[..., 2, 3]) > RIGID) or np.any(1.0 - X[..., 2, 2] > RIGID)):
        raise InputError(f"{what} leaves the plane of the system")
    return X


def refuse(goals: Goals, what: str) -> None:
    """Say what is wrong with goals that a kernel refused. Errors: `InputError`."""
    for pose, number in goals:
        if pose is not None and np.isfinite(pose).all():
            R = pose[..., :3, :3]
            if np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0.0) > RIGID or np.any(
                np.linalg.det(R) < 0.0
            ):
                raise InputError(f"the goal of {what} is no pose: its rotation must be orthonormal with determinant +1")
        if any(x is not None and not np.all(np.abs(x) < LARGEST) for x in (pose, number)):
            raise InputError(f"the goal of {what} has entries that are not finite, or too large")


def numbers_of(x: Any, what: str) -> Array:
    """Real numbers as an array. Errors: `InputError`."""
    return numbers(x, what)


def along(z: Array, dim: int) -> Array:
    """Rotations (..., 3, 3) whose z is along unit vectors (..., 3); in the plane their x is the plane's normal."""
    if dim == 3:
        return spatial.align_z(z)
    x = np.broadcast_to([0.0, 0.0, 1.0], z.shape)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def flat(X: Array) -> tuple[float, ...]:
    """A pose as something that can be a key."""
    return tuple(X.ravel().tolist())


# ---- several tasks, packed


def lead_of(goals: Sequence[Goals]) -> tuple[int, ...]:
    """The leading shape of goals. Errors: `InputError` where shapes do not fit together."""
    shapes = {x.shape[:-k] for g in goals for pair in g for x, k in zip(pair, (2, 1), strict=True) if x is not None}
    try:
        return shapes.pop() if len(shapes) == 1 else np.broadcast_shapes(*shapes)
    except ValueError:
        raise InputError(f"the goals have leading shapes that do not fit together: {sorted(shapes)}") from None


def _wide(system: System, tasks: Sequence[Task]) -> np.ndarray:
    """Angles (nv,) with limits a whole turn apart or more, which a whole turn does not change in anything else."""
    table, c = own_tree(system).table, system.coordinates
    with np.errstate(invalid="ignore"):
        wide = c.turning & np.isfinite(c.upper - c.lower) & (c.upper - c.lower >= 2.0 * np.pi)
    for v in np.flatnonzero(wide):
        rows = table.iv == v
        wide[v] = np.sum(rows) == 1 and abs(table.multiplier[rows][0]) == 1.0
    bound = {n for r in system.relations for n in (r.of, *r.sources)}
    for task in tasks:
        bound |= task.coordinates(system)
    return wide & np.array([name not in bound for name in system.velocity_names], dtype=bool)


class Packed:
    """Tasks of a system as ties, together with its loops and relations, which always hold.

    Lengths are measured in `length` (default: the characteristic length). `owner` (ties,) is the number of the task of
    each tie, -1 for a loop. With `turns`, angles with limits a whole turn apart or more count as having none (`wide`):
    `inside` brings them back. `levels` are those of the tasks: ties stand in their order, loops with the first.
    """

    def __init__(
        self, system: System, tasks: Sequence[Task], length: float | None = None, turns: bool = False,
        levels: Sequence[int] = (),
    ):  # fmt: skip
        self.system, self.tasks, self.turns = system, tuple(tasks), turns
        owner: dict[int, tuple[int, int]] = {}
        made: list[Tie] = []

        def further(table: Table) -> list[Tie]:
            for i, task in enumerate(self.tasks):
                for j, tie in enumerate(task.ties(system, table)):
                    owner[id(tie)] = i, j
                    made.append(tie)
            return made

        self.wide = _wide(system, self.tasks) if turns else np.zeros(system.nv, dtype=bool)
        tree = own_tree(system)
        carried = frozenset(tree.closures)
        level = (lambda tie: levels[owner[id(tie)][0]] if id(tie) in owner else 0) if any(levels) else None
        self.loops: Loops = pack(tree, carried, length=length, further=further, wide=self.wide, level=level)
        self.stages: dict[Hashable, Any] = {}
        """What solvers have worked out of weights and priorities."""
        self.scale: Array = self.loops.weights[L.SCALES : L.SCALES + system.nv]
        for tie in self.loops.ties:
            if tie.function is not None:
                tie.function.scale = self.scale
        self.slots = [owner.get(id(t), (-1, 0)) for t in self.loops.ties]
        self.owner = np.array([i for i, _ in self.slots], dtype=np.int64)
        self.rows = np.repeat(self.owner, [len(t.rows) for t in self.loops.ties])
        """Task of each equation; -1 for loops, -2 for what holds of itself."""
        ends = np.cumsum([len(t.rows) for t in self.loops.ties], dtype=np.int64) - 1
        self.rows[ends[[system.dim == 2 and t.turns in TILTS for t in self.loops.ties]]] = -2
        self.closed = bool(np.any(self.rows == -1))
        """Whether loops or relations hold, too."""
        at, v = system.layout.vector_q, system.layout.vector_v
        self.limits = at, system.lower[v] - ROUNDING, system.upper[v] + ROUNDING
        """Places in q of what has limits, and these."""
        wide = self.wide[v]
        self._turning = list(zip(at[wide], system.lower[v][wide], system.upper[v][wide], strict=True))

    def inside(self, q: Array) -> Array:
        """The configurations (N, nq) with wide angles brought into their limits by whole turns, in place."""
        for i, a, b in self._turning:
            x = q[:, i]
            x -= 2.0 * np.pi * np.ceil(np.maximum(x - b, 0.0) / (2.0 * np.pi))
            x += 2.0 * np.pi * np.ceil(np.maximum(a - x, 0.0) / (2.0 * np.pi))
        return q

    def count(self, tasks: Sequence[int], bounded: bool = False) -> int:
        """Number of equations of some of the tasks; in the plane, those that hold of themselves do not count."""
        trivial = TILTS if self.system.dim == 2 else ()
        ties = [t for t, i in zip(self.loops.ties, self.owner, strict=True) if i in tasks and (bounded or not t.bounds)]
        return sum(len(t.rows) - (t.turns in trivial) for t in ties)

    def pins(self, goals: Sequence[Goals], lead: tuple[int, ...] = ()) -> Array:
        """What the kernels need (N or 1, k) of the goals of tasks of this structure."""
        given = [(tie, goals[i][j]) for tie, (i, j) in zip(self.loops.ties, self.slots, strict=True) if i >= 0]
        poses = [(tie, pose) for tie, (pose, _) in given if pose is not None]
        numbers = [x for _, (_, x) in given if x is not None]
        out = np.empty((*lead, 12 * len(poses) + sum(x.shape[-1] for x in numbers)))
        at = 0
        for tie, pose in poses:
            top = out[..., at : at + 12].reshape(*lead, 3, 4)  # a view
            fixed = tie.a is not GROUND and tie.a[0] < 0  # a frame that stands; kernels put the pin in its place
            top[...] = (tie.a[1] @ pose if fixed else pose)[..., :3, :]
            if tie.a is GROUND:
                top[..., 3] -= self.loops.origin
            at += 12
        for x in numbers:
            out[..., at : at + x.shape[-1]] = x
            at += x.shape[-1]
        return out.reshape(math.prod(lead), out.shape[-1])

    def evaluate(self, q: Any, pins: Array | None = None, closures: bool = False) -> tuple[Array, Array]:
        """The tasks' equations (..., m) and Jacobian (..., m, nv) at q (..., nq); with `closures` those of loops."""
        from kempe.kernels.compiled import equations

        q = as_q(self.system, q)
        lead, loops, m = q.shape[:-1], self.loops, len(self.rows)
        flat_q = q.reshape(math.prod(lead), self.system.nq)
        if pins is None:
            goals = [t.goals(self.system) for t in self.tasks]
            pins = self.pins(goals, lead if lead_of(goals) else ())
        out, J = np.empty((len(flat_q), m)), np.empty((len(flat_q), m, self.system.nv))
        equations.equations(loops.ints, loops.floats, loops.plan, loops.weights, pins, flat_q, True, out, J)
        use = self.rows == -1 if closures else self.rows >= 0
        out, J = out[:, use], J[:, use]
        return out.reshape(*lead, out.shape[1]), J.reshape(*lead, *J.shape[1:])
