"""Constraints on coordinates as tasks."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING

import numpy as np

from kempe.constraints.reading import numbers_of
from kempe.errors import InputError
from kempe.kernels.constraints import loop_layout as L
from kempe.kinematics.configuration import as_q, circles, q_from_dict
from kempe.kinematics.tasks.task import GROUND, At, Goals, Task
from kempe.model.closures.packed_loops import Tie
from kempe.model.tree.primitive_table import Table
from kempe.reals import named
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.compiled_system import Compiled


class CoordinateTask(Task):
    """A constraint on coordinates, at values of the field `q`."""

    angles = True

    def _values(self, system: Compiled) -> tuple[Array, list[tuple[str, int, int, bool]]]:
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
        q_from_dict(
            system, dict.fromkeys(given, 0.0)
        )  # refuses names that are none, or follow others
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

    def structure(self, system: Compiled) -> Hashable:
        """The names of the coordinates that are held."""
        return tuple(name for name, *_ in self._values(system)[1])

    def ties(self, system: Compiled, table: Table) -> list[Tie]:
        """One for each coordinate or quaternion."""
        return [
            Tie(self.label, GROUND, GROUND, turns=L.OWN, given=True, own=v, ball=ball)
            for _, _, v, ball in self._values(system)[1]
        ]

    def coordinates(self, system: Compiled) -> set[str]:
        """The coordinates that it reads: those that it holds."""
        return {system.structure.velocity_names[v] for _, _, v, _ in self._values(system)[1]}

    def goals(self, system: Compiled) -> Goals:
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
        self, system: Compiled, q: Array, goals: Goals | None = None, at: At | None = None
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
