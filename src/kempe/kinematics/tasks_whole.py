"""Tasks on the whole configuration: coordinates, centres of mass and of points, functions of the user."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kempe import spatial
from kempe.errors import InputError
from kempe.kernels import loop_layout as L
from kempe.kinematics.configuration import as_q, circles
from kempe.kinematics.forward import fk
from kempe.kinematics.task import GROUND, HERE, Goals, Hold, Task, numbers_of
from kempe.kinematics.task_between import Between
from kempe.kinematics.task_input import ends_of, fixed, points_of
from kempe.kinematics.zoo import UserConstraint, user_constraint
from kempe.model.loops import Centre, Tie
from kempe.model.table import Table
from kempe.reals import named, reals
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.system import System

AXES = {"xyz": 7, "xy": 3, "xz": 5, "yz": 6, "x": 1, "y": 2, "z": 4}


@dataclass(frozen=True, eq=False)
class Posture(Task):
    """Coordinates near values: a configuration `q` (..., nq), or a dict by coordinate name of those that count.

    It is soft unless `weight` is None. A quaternion counts as a whole, by the angle between the two orientations.
    """

    q: Any
    weight: float | None = field(default=1.0, kw_only=True)
    angles = True

    @property
    def about(self) -> str:
        """What coordinates."""
        given = named(self.q)
        if given is not None:
            return ", ".join(map(repr, given))
        return "all coordinates"

    def _values(self, system: System) -> tuple[Array, list[tuple[str, int, int, bool]]]:
        """The values as (..., nq), and for each tie its name, place in q, velocity coordinate, whether it is a ball."""
        layout = system.layout
        items = [(system.coordinate_names[i], int(i), int(v), False)
                 for i, v in zip(layout.vector_q, layout.vector_v, strict=True)]  # fmt: skip
        items += [(system.coordinate_names[i], int(i), int(v), True)
                  for i, v in zip(layout.quaternion_q, layout.quaternion_v, strict=True)]  # fmt: skip
        items.sort(key=lambda item: item[1])
        given = named(self.q)
        if given is None:
            return as_q(system, self.q), items
        system.q(dict.fromkeys(given, 0.0))  # refuses names that are none, or follow others
        index = {n: i for i, n in enumerate(system.coordinate_names)}
        values = [numbers_of(x, f"{k!r} of {self.label}") for k, x in given.items()]
        out = np.empty((*np.broadcast_shapes(*(x.shape for x in values)), system.nq))
        out[:] = system.neutral
        for name, x in zip(given, values, strict=True):
            out[..., index[name]] = x
        balls = [item for item in items if item[3]]
        whole = [item for item in balls if {*system.coordinate_names[item[1] : item[1] + 4]} & given.keys()]
        for _, i, _, _ in whole:
            missing = [n for n in system.coordinate_names[i : i + 4] if n not in given]
            if missing:
                raise InputError(f"a quaternion is given as a whole; missing are {', '.join(missing)}")
        return out, [item for item in items if (item in whole if item[3] else item[0] in given)]

    def structure(self, system: System) -> Hashable:
        """The coordinates."""
        return tuple(name for name, *_ in self._values(system)[1])

    def ties(self, system: System, table: Table) -> list[Tie]:
        """One for each coordinate or quaternion."""
        return [Tie(self.label, GROUND, GROUND, turns=L.OWN, given=True, own=v, ball=ball)
                for _, _, v, ball in self._values(system)[1]]  # fmt: skip

    def coordinates(self, system: System) -> set[str]:
        """Its own."""
        return {system.velocity_names[v] for _, _, v, _ in self._values(system)[1]}

    def goals(self, system: System) -> Goals:
        """The values."""
        values, items = self._values(system)
        out: Goals = []
        for name, i, _, ball in items:
            x = values[..., i : i + (4 if ball else 1)]
            if ball and np.any(np.linalg.norm(x, axis=-1) == 0.0):
                raise InputError(f"the quaternion at {name!r} of {self.label} is zero")
            out.append((None, x / np.linalg.norm(x, axis=-1, keepdims=True) if ball else x))
        return out

    def measure(self, system: System, q: Array, goals: Goals | None = None) -> tuple[Array, Array]:
        """The largest difference of a slide and of a turn."""
        values, items = self._values(system)
        if goals is not None:  # of one row of a batch, it may be
            values = np.broadcast_to(system.neutral, q.shape).copy()
            for (_, i, _, ball), (_, x) in zip(items, goals, strict=True):
                assert x is not None
                values[..., i : i + (4 if ball else 1)] = x
        d = np.abs(system.difference(np.broadcast_to(values, q.shape), q))
        round_ = circles(system)
        d[..., round_] = np.abs(d[..., round_] - 2.0 * np.pi * np.round(d[..., round_] / (2.0 * np.pi)))
        turning = system.coordinates.turning
        slides = [v for _, _, v, ball in items if not ball and not turning[v]]
        turns = [v for _, _, v, ball in items if not ball and turning[v]]
        balls = [np.linalg.norm(d[..., v : v + 3], axis=-1) for _, _, v, ball in items if ball]
        angle = np.max(np.stack([d[..., turns].max(axis=-1, initial=0.0), *balls]), axis=0)
        return d[..., slides].max(axis=-1, initial=0.0), angle


class _Centred(Between):
    """A centre at a position."""

    target: Any
    axes: str
    within: Any

    def _points(self, system: System) -> list[tuple[str, tuple[float, ...], float]]:
        """Frames, points on them and their masses, whose sum is 1."""
        raise NotImplementedError

    def hold(self, system: System) -> Hold:
        """The axes that count, within bounds where given."""
        return Hold(system.body_names[0], HERE, sum(1 << i for i in self._axes(system.dim)))

    def values(self, X: Array) -> Array:
        """Where the centre is along the axes that count."""
        return X[..., self._axes(3), 3]

    def _axes(self, dim: int) -> list[int]:
        mask = AXES.get(self.axes, 0) if isinstance(self.axes, str) else 0
        axes = [i for i in range(dim) if mask >> i & 1]
        if not axes:
            allowed = ", ".join(a for a in AXES if dim == 3 or a != "z")
            raise InputError(f"axes of {self.label} are {self.axes!r}; allowed are {allowed}")
        return axes

    def ends(self, system: System) -> tuple[Array, Array] | None:
        """As far as it may be to either side, if it may."""
        n = len(self._axes(system.dim))
        w = numbers_of(self.within, f"within of {self.label}")
        if w.shape[-1:] not in ((), (1,), (n,)) or not np.all(w >= 0.0):
            raise InputError(f"within of {self.label} is {self.within!r}; it must be a distance, or (..., {n})")
        if not np.any(w):
            return None
        w = np.broadcast_to(w, (*w.shape[:-1], n))
        return -w, w

    def from_end(self, system: System, goal: Array, end: Array) -> tuple[Array, Array | None]:
        """The target at an end."""
        p = np.zeros((*end.shape[:-1], 3))
        p[..., self._axes(system.dim)] = end
        return goal @ spatial.pose(p=p), None

    def structure(self, system: System) -> Hashable:
        """Its tie and its points."""
        return super().structure(system), self._own()

    def _own(self) -> Hashable:
        """What its points depend on, of one system."""
        raise NotImplementedError

    def goal(self, system: System) -> Array:
        """The target: three numbers, or one for each axis that counts."""
        what, axes = f"target of {self.label}", self._axes(system.dim)
        p = numbers_of(self.target, what)
        if p.shape[-1:] == (len(axes),):
            p, given = np.zeros((*p.shape[:-1], 3)), p
            p[..., axes] = given
        elif p.shape[-1:] not in ((3,), (system.dim,)):
            short = f", or (..., {len(axes)}) for axes={self.axes!r}" if len(axes) < system.dim else ""
            raise InputError(f"{what} has shape {p.shape}; it must be (..., {system.dim}){short}")
        return spatial.pose(p=points_of(p, system.dim, what))

    def centre(self, system: System, table: Table) -> Centre:
        """The masses on the rows of the table."""
        rows, rest = np.zeros((len(table.kind), 4)), np.zeros(3)
        for frame, point, mass in self._points(system):
            row, X, _ = table.at[frame]
            p = X[:3, :3] @ point + X[:3, 3]
            if row < 0:
                rest += mass * p
            else:
                rows[row] += mass, *(mass * p)
        return Centre(rows, rest)

    def place(self, system: System, q: Array, hold: Hold | None = None) -> Array:
        """The centre, by the forward model."""
        key = ("centre", type(self), self._own())
        found = system._queries.get(key)
        if found is None:
            points = self._points(system)
            frames = [f for f, _, _ in points]
            names = list(dict.fromkeys([*system.body_names, *frames]))  # all bodies at once are quicker than some
            moments = np.zeros((len(names), 4))
            for f, p, mass in points:
                moments[names.index(f)] += *(mass * x for x in p), mass
            found = system._queries[key] = None if len(names) == len(system.body_names) else names, moments
        X = fk(system, q, found[0])
        return spatial.pose(p=np.einsum("...kij,kj->...i", X[..., :3, :], found[1]))


@dataclass(frozen=True, eq=False)
class CentreOfMass(_Centred):
    """The centre of mass at a position `target` (..., 3), along `axes` ("xyz", or "xy", ...), or `within` (m) of it.

    Where fewer axes count, `target` may have a number for each of these only.
    `within` is one number, or (..., n) for the n axes, from target to target where it has leading axes.
    Masses and centres are those of the bodies, as files give them.
    """

    target: Any
    axes: str = "xyz"
    within: Any = 0.0

    @property
    def about(self) -> str:
        """The system."""
        return "the system"

    def _own(self) -> Hashable:
        return None

    def _points(self, system: System) -> list[tuple[str, tuple[float, ...], float]]:
        bodies = system.mechanism.bodies
        heavy = [(n, tuple(bodies[n].center or (0.0, 0.0, 0.0)), float(bodies[n].mass or 0.0)) for n in bodies]
        total = sum(mass for _, _, mass in heavy)
        if not total > 0.0:
            raise InputError(f"{system.name} has no masses: it has no centre of mass")
        return [(n, p, mass / total) for n, p, mass in heavy if mass > 0.0]


@dataclass(frozen=True, eq=False)
class CentreOfPoints(_Centred):
    """The mean of the origins of frames at a position `target` (..., 3); `frames` is a list, or a dict of weights."""

    frames: Sequence[str] | Mapping[str, float]
    target: Any
    axes: str = "xyz"
    within: Any = 0.0

    @property
    def about(self) -> str:
        """The frames."""
        return ", ".join(repr(str(f)) for f in self.frames)

    def _own(self) -> Hashable:
        weights = self.frames if isinstance(self.frames, Mapping) else dict.fromkeys(self.frames, 1.0)
        return tuple(weights.items())

    def _points(self, system: System) -> list[tuple[str, tuple[float, ...], float]]:
        given = self.frames if isinstance(self.frames, Mapping) else dict.fromkeys(self.frames, 1.0)
        weights = {f: float(fixed(numbers_of(w, what := f"a weight of {self.label}"), what)) for f, w in given.items()}
        total = sum(weights.values())
        if not weights or any(not w > 0.0 for w in weights.values()):
            raise InputError(f"frames of {self.label} are {self.frames!r}; needed are some, with weights above 0")
        return [(system.frame_name(f), (0.0, 0.0, 0.0), w / total) for f, w in weights.items()]


class Callback:
    """A function of q (nq,) that gives values (rows,) and derivatives (rows, nv), as kernels call it.

    See `kempe.model.loops.Function`. What it raises is kept in `error`, for no exception passes through a kernel.
    `scale` (nv,) are the units of the velocities.
    """

    def __init__(self, system: System, rows: int, function: Callable[[Array], tuple[Any, Array]]):
        number = ctypes.POINTER(ctypes.c_double)
        kind = ctypes.CFUNCTYPE(None, number, number, number, ctypes.c_int64)
        self.rows, self.error, self.scale = rows, None, np.ones(system.nv)
        nq, shape = system.nq, (system.nv, rows)

        def work(q: Any, value: Any, columns: Any, _: int) -> None:
            out = np.ctypeslib.as_array(value, (rows,))
            out[:] = np.nan  # what stays where it raises
            with self:
                found, J = function(np.ctypeslib.as_array(q, (nq,)).copy())
                np.ctypeslib.as_array(columns, shape)[:] = (J * self.scale).T
                out[:] = found

        self._kept = kind(work)
        self.address = int(ctypes.cast(self._kept, ctypes.c_void_p).value or 0)

    def __enter__(self) -> None: ...

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> bool:
        self.error = self.error or error
        return True


@dataclass(frozen=True, eq=False)
class Function(Task):
    """A function of q (nq,), a number or (m,), at zero, or between `low` and `high` (m,).

    `derivative` gives its derivatives (m, nv) by the velocity coordinates, and is checked; else they are by complex
    steps or central differences. Its error is compared with the tolerance of angles.
    """

    function: Callable[[Array], Any]
    derivative: Callable[[Array], Any] | None = None
    low: Any = 0.0
    high: Any = 0.0
    lengths, angles, lasting = False, True, False

    @property
    def about(self) -> str:
        """The function's name."""
        return getattr(self.function, "__name__", repr(self.function))

    def structure(self, system: System) -> Hashable:
        """The function itself."""
        return self.function

    def ties(self, system: System, table: Table) -> list[Tie]:
        """The function, as kernels call it."""
        if not callable(self.function):
            raise InputError(f"{self.label} is given {self.function!r}; it must be a function of q ({system.nq},)")
        rows: UserConstraint = user_constraint(system, self.label, self.function, self.derivative)
        if not rows.count:
            raise InputError(f"{self.label} gives no numbers at all; it must give one or more")

        def steady(q: Array) -> Any:
            found = self.function(q)
            if np.size(found) != rows.count:
                raise InputError(f"{self.label} gives {np.size(found)} numbers, but gave {rows.count} before")
            return found

        rows = replace(rows, function=steady)
        call = Callback(system, rows.count, lambda q: (rows.residual(system, q.copy()), rows.jacobian(system, q)))
        low, high = ends_of(self.low, self.high, f"bounds of {self.label}", rows.count)
        bounds = tuple(zip(low.tolist(), high.tolist(), strict=True)) if np.any(low) or np.any(high) else ()
        return [Tie(self.label, GROUND, GROUND, turns=L.FUNCTION, function=call, bounds=bounds)]

    def coordinates(self, system: System) -> set[str]:
        """All."""
        return set(system.velocity_names)

    def goals(self, system: System) -> Goals:
        """None."""
        return [(None, None)]

    def measure(self, system: System, q: Array, goals: Goals | None = None) -> tuple[Array, Array]:
        """How far its values are from where they must be."""
        lead = q.shape[:-1]
        out = np.zeros(lead)
        for index in np.ndindex(lead):
            value = np.atleast_1d(reals(self.function(q[index].copy()), f"the value of {self.label}"))
            out[index] = np.linalg.norm(value - np.clip(value, self.low, self.high))
        return np.zeros(lead), out
