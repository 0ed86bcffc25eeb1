"""Rows A(q) v = b(q, t) recorded as one tape: values at any number of configurations, and what
brackets need.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from kempe.constraints.tape import BINARY, UNARY, Tape
from kempe.kernels.compiled import tape_evaluation as tape
from kempe.kernels.constraints import tape_layout as L
from kempe.model.tree.coordinate_layout import Layout
from kempe.spatial import Array

CLOCK = ""
"""The name of the time among the inputs of the tape, which is no coordinate's."""


@dataclass(frozen=True)
class RowName:
    """Where a row comes from: its constraint or joint, its name there, its unit.

    `velocity`: a row A(q) v = b, not the tangent of a position; `sided`: of a position that is held
    between two ends; `written`: by the user, in units of his own.
    """

    of: str
    name: str
    unit: str = "m/s"
    velocity: bool = True
    sided: bool = False
    written: bool = False


@dataclass(frozen=True, eq=False)
class VelocityRows:
    """Rows A(q) v = b(q, t), recorded.

    `tape` has inputs that are entries of q, by `coordinates`, or the time; its outputs are the
    entries of A and b that are not zero. `entries` (k, 2) say row and column of each, the column nv
    being that of -b.
    """

    layout: Layout
    coordinates: tuple[str, ...]
    tape: Tape
    entries: np.ndarray
    names: tuple[RowName, ...]
    units: Array = field(repr=False)
    """What (nv + 1,) velocities, and the time, are measured in: 1, or a length."""

    @cached_property
    def packed(self) -> tuple[np.ndarray, Array]:
        """The arrays of the tape."""
        return self.tape.arrays()

    @cached_property
    def inputs(self) -> np.ndarray:
        """For each input of the tape its place in (q, t)."""
        place = {name: i for i, name in enumerate((*self.coordinates, CLOCK))}
        return np.array([place[name] for name in self.tape.inputs], dtype=np.int64)

    @cached_property
    def steady(self) -> bool:
        """Whether neither A nor b depends on the time, and b is zero: no column nv is needed."""
        return CLOCK not in self.tape.inputs and not bool(
            np.any(self.entries[:, 1] == self.layout.nv)
        )

    def values(self, q: Array, t: Array | float = 0.0) -> tuple[Array, Array]:
        """A (..., m, nv) and b (..., m) at configurations (..., nq) and times (...)."""
        shape = np.broadcast_shapes(q.shape[:-1], np.shape(t))
        n = int(np.prod(shape, dtype=np.int64))
        points = np.empty((n, self.layout.nq + 1))
        points[:, :-1] = np.broadcast_to(q, (*shape, self.layout.nq)).reshape(n, self.layout.nq)
        points[:, -1] = np.broadcast_to(t, shape).reshape(n)
        found = np.empty((n, len(self.entries)))
        tape.tape_outputs(*self.packed, np.ascontiguousarray(points[:, self.inputs]), found)
        whole = np.zeros((n, len(self.names), self.layout.nv + 1))
        whole[:, self.entries[:, 0], self.entries[:, 1]] = found
        whole = whole.reshape(*shape, len(self.names), self.layout.nv + 1)
        return whole[..., :-1], -whole[..., -1]

    def needed(self, outputs: Sequence[int]) -> np.ndarray:
        """Places of the nodes that some outputs are computed from, the derivatives of functions
        included, in order.
        """
        n = len(self.tape.inputs)
        nodes = self.tape.nodes
        todo = [self.tape.outputs[i] for i in outputs]
        seen = set[int]()
        while todo:
            place = todo.pop()
            if place < n or place in seen:
                continue
            seen.add(place)
            op, left, right = nodes[place - n]
            if op in UNARY:
                todo += [left] if op == L.NEG else [left, right]
            elif op in BINARY:
                todo += [left, right]
            if L.ATAN2 <= op <= L.NEAREST:
                todo += nodes[place + 1 - n][1:]
        return np.array(sorted(seen), dtype=np.int64)

    @cached_property
    def slots(self) -> np.ndarray:
        """For each entry of (q, t) its velocity, -1 in a quaternion, and its place among the
        inputs, -1 if none.
        """
        layout = self.layout
        out = np.full((layout.nq + 1, 2), -1, dtype=np.int64)
        out[layout.vector_q, 0] = layout.vector_v
        out[-1, 0] = layout.nv
        out[self.inputs, 1] = np.arange(len(self.inputs))
        return out

    @cached_property
    def balls(self) -> np.ndarray:
        """The first entry in q and the first velocity of each quaternion."""
        pairs = np.stack([self.layout.quaternion_q, self.layout.quaternion_v], axis=-1)
        return np.ascontiguousarray(pairs.reshape(-1, 2), dtype=np.int64)
