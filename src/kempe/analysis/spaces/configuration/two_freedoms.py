"""Systems with two freedoms over two of their coordinates: all configurations there, and all that reach a place.

Of an open chain there is one configuration over each pair of values; of a planar mechanism made of dyads there are its
assembly modes, in closed form.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from kempe.analysis.first_order.control import driven
from kempe.errors import InputError, UnsupportedError
from kempe.kinematics.configuration import circles, has_loops, sampling_box
from kempe.kinematics.one_sided import one_sided_rows
from kempe.solvers.dyads.dyads import Incomplete, Plan, closed_form
from kempe.spatial import Array
from kempe.words import counted

if TYPE_CHECKING:
    from kempe.model.system import System

MOST_SIGNS = 6
"""Branch signs of a closed form, at most: 64 configurations at each place."""
INSIDE = 1e-9
"""How far, in radians and metres, a configuration may be beyond a limit to be inside."""
TORN = 0.08
"""Part of the picture that an edge of a triangle may span: neighbours that are farther apart are torn apart."""
SAME = 1e-6
"""Difference of coordinates, in radians and metres, up to which configurations are the same."""
NEEDED = "both spaces are drawn of systems with two freedoms"


class TwoFreedoms:
    """An open system with two coordinates, and the frame whose place counts. Base of `LoopSheets`.

    `names` are the two coordinates, `columns` theirs in q, `low`, `high` and `turns` (2,) their ranges and which of
    them are full turns. Errors: `UnsupportedError`, `InputError`.
    """

    modes = False
    """Whether several configurations can lie over the same values."""
    counted = True
    """Whether those that reach a place are counted, in closed form or by `ik_all`."""

    def __init__(self, system: System, frame: str, names: tuple[str, ...]):
        self.system, self.frame, self.names = system, frame, names
        at = [system.structure.velocity_names.index(n) for n in names]
        self.columns = [system.coordinate_names.index(n) for n in names]
        self.turns = circles(system)[at]
        for i, name in zip(at, names, strict=True):
            if not circles(system)[i] and not np.isfinite([system.lower[i], system.upper[i]]).all():
                raise InputError(f"{name!r} has no limits on both sides, and a picture has an end: "
                                 f"with_limits({{{name!r}: (low, high)}}) gives it one")  # fmt: skip
        self.low, self.high = (x[at] for x in sampling_box(system))

    def grid(self, n: int) -> Array:
        """Values (n, n, 2) over the ranges."""
        sides = [np.linspace(float(self.low[i]), float(self.high[i]), n) for i in range(2)]
        return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)

    def over(self, values: Array) -> tuple[Array, np.ndarray]:
        """Configurations (..., k, nq) at values (..., 2) of the coordinates, and which (..., k) there are."""
        return values[..., None, :], np.ones((*values.shape[:-1], 1), dtype=bool)

    def reaching(self, p: Array) -> tuple[Array, np.ndarray]:
        """Configurations (..., k, nq) that bring the frame to places p (..., 2), and which (..., k) there are."""
        found = self.system.ik_all(p.reshape(-1, 2), self.frame, task="position", limits=True)
        mask = np.asarray(found.mask)  # type: ignore[union-attr]
        return found.q.reshape(*p.shape[:-1], mask.shape[1], -1), mask.reshape(*p.shape[:-1], -1)

    def solutions(self, p: Array) -> Array:
        """The different configurations (k, nq) that bring the frame to a place (2,)."""
        return self.system.ik_all(p, self.frame, task="position", limits=True).q

    def places(self, q: Array, mask: np.ndarray) -> Array:
        """Where the frame is (..., k, 2) at configurations, NaN where there are none."""
        p = self.system.fk(np.where(mask[..., None], q, 0.0), self.frame)[..., :2, 3]
        return np.where(mask[..., None], p, np.nan)

    def preimages(self, x: Array, y: Array, p: Array) -> np.ndarray:
        """How many configurations bring the frame to each place of a lattice x (m,), y (n,)."""
        places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        return self.reaching(places)[1].sum(axis=-1)


class LoopSheets(TwoFreedoms):
    """All closed configurations of a planar mechanism with two freedoms that is made of dyads; see `TwoFreedoms`.

    The coordinates are the actuated ones where these are two and place everything dyad after dyad, else the first pair
    that does. `placed` is the closed form with the place of the frame known, None where there is none.
    """

    modes = True

    def __init__(self, system: System, frame: str):
        self.plan = _plan(system)
        super().__init__(system, frame, self.plan.known)
        self.placed = _placed(system, frame)
        self.counted = self.placed is not None

    def over(self, values: Array) -> tuple[Array, np.ndarray]:
        """Configurations (..., k, nq) on all branches, and which (..., k) close inside the limits."""
        return self._inside(*self.plan.all(values))

    def reaching(self, p: Array) -> tuple[Array, np.ndarray]:
        """Configurations (..., k, nq) that bring the frame to places p (..., 2), and which (..., k) there are."""
        assert self.placed is not None
        q, mask = self.placed.all(p)
        at = [self.placed.system.coordinate_names.index(n) for n in self.system.coordinate_names]
        return self._inside(q[..., at], mask)

    def solutions(self, p: Array) -> Array:
        """The different configurations (k, nq) that bring the frame to a place (2,): where there is no closed form
        those that are found from many starts."""  # fmt: skip
        if self.placed is None:
            return super().solutions(p)
        q, mask = self.reaching(p)
        keep: list[Array] = []
        for x in q[mask]:
            if not any(np.abs(x - other).max() < SAME for other in keep):
                keep.append(x)
        return np.array(keep).reshape(-1, self.system.nq)

    def preimages(self, x: Array, y: Array, p: Array) -> np.ndarray:
        """How many configurations bring the frame to each place of a lattice x (m,), y (n,).

        Without a closed form they are not counted: 1 where the image p (n, n, k, 2) of a grid is, else 0.
        """
        return super().preimages(x, y, p) if self.placed is not None else covered(x, y, p).astype(np.int64)

    def _inside(self, q: Array, mask: np.ndarray) -> tuple[Array, np.ndarray]:
        beyond = one_sided_rows(self.system).beyond(q.reshape(-1, self.system.nq))
        return q, mask & np.asarray((beyond <= INSIDE).all(axis=-1)).reshape(mask.shape)


def two_freedoms(system: System, frame: str) -> TwoFreedoms:
    """The system over two of its coordinates. Errors: `UnsupportedError`, `InputError`; see `TwoFreedoms`."""
    loops = has_loops(system)
    mobility = system.mobility(local=False) if loops else None
    freedoms = system.nv if mobility is None else mobility.rank_dof
    if freedoms is None:
        raise UnsupportedError(f"{NEEDED}; of {system.name} they are not known: {mobility and mobility.sentence}")
    if freedoms != 2 or (not loops and len(system.structure.layout.vector_q) != 2):
        what = counted(freedoms, "freedom" if loops else "coordinate")
        raise UnsupportedError(f"{NEEDED}; {system.name} has {what}{' and loops' if loops else ''}")
    if not loops:
        return TwoFreedoms(system, frame, tuple(system.coordinate_names))
    return LoopSheets(system, frame)


def _plan(system: System) -> Plan:
    """The closed form from the actuated coordinates, else from the first that have one. Errors: `UnsupportedError`."""
    names = system.structure.velocity_names
    inputs = [names[i] for i in driven(system, None) or ()]
    pairs: Iterator[tuple[str, ...]] = combinations([n for n in names if n in system.coordinate_names], 2)
    why = ""
    for pair in [tuple(inputs), *pairs] if len(inputs) == 2 else pairs:
        found = closed_form(system, pair)
        if isinstance(found, Incomplete):
            why = why or found.reason
        elif found.signs <= MOST_SIGNS and _moves(found):
            return found
    raise UnsupportedError(f"{NEEDED}, with loops where dyads close them; of {system.name}: {why or 'no pair does'}")


def _moves(plan: Plan) -> bool:
    """Whether the known coordinates can be set: whether there are configurations over an area."""
    at = [plan.system.structure.velocity_names.index(n) for n in plan.known]
    low, high = (x[at] for x in sampling_box(plan.system))
    return bool(plan.all(np.random.default_rng(0).uniform(low, high, (512, 2)))[1].any())


def _placed(system: System, frame: str) -> Plan | None:
    """The closed form with the place of a frame known: that of the mechanism with slides in x and y pinned to it."""
    m, free = system.mechanism.copy(), "place"
    while any(name.startswith(free) for name in (*m.bodies, *m.joints, *m.frames, *m.couplings, *m.constraints)):
        free += "'"
    m.prismatic(f"{free} x", m.ground, m.body(f"{free} 1"), axis=(1, 0))
    m.prismatic(f"{free} y", f"{free} 1", m.body(f"{free} 2"), axis=(0, 1))
    on = m.frames.get(frame)
    m.revolute(f"{free} pin", f"{free} 2", frame if on is None else on.body, child_at=(0, 0) if on is None else frame)
    found = closed_form(m.build(), (f"{free} x", f"{free} y"))
    return None if isinstance(found, Incomplete) or found.signs > MOST_SIGNS else found


def covered(x: Array, y: Array, p: Array) -> np.ndarray:
    """Which places of a lattice x (m,), y (n,) lie in small triangles of sheets p (n, n, k, 2); NaN is no place.

    Large triangles stand where neighbours are torn apart: what is between them is not the image.
    """
    corners = [p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]]
    triangles = np.concatenate([np.stack([corners[i] for i in t], axis=-2).reshape(-1, 3, 2)
                                for t in ((0, 1, 2), (0, 2, 3))])  # fmt: skip
    edges = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=-1).max(axis=1)
    triangles = triangles[edges < TORN * max(x[-1] - x[0], y[-1] - y[0])]  # NaN is not less
    step = np.array([x[1] - x[0], y[1] - y[0]])
    first = np.ceil((triangles.min(axis=1) - [x[0], y[0]]) / step).astype(int)
    last = np.floor((triangles.max(axis=1) - [x[0], y[0]]) / step).astype(int)
    first, last = np.maximum(first, 0), np.minimum(last, [len(x) - 1, len(y) - 1])
    found, size = np.zeros((len(x), len(y)), dtype=bool), last - first
    for i in range(int(size[:, 0].max(initial=-1)) + 1):
        wide = size[:, 0] >= i
        for j in range(int(size[wide, 1].max(initial=-1)) + 1):
            some = np.flatnonzero(wide & (size[:, 1] >= j))
            at = first[some] + [i, j]
            to = triangles[some] - (np.array([x[0], y[0]]) + at * step)[:, None]
            after = np.roll(to, -1, axis=1)
            side = np.sign(to[..., 0] * after[..., 1] - to[..., 1] * after[..., 0])
            within = np.abs(side.sum(axis=1)) == 3
            found[tuple(at[within].T)] = True
    return found
