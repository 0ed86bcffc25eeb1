"""Smallest distances of pairs of solids at many configurations.

A kernel measures spheres, capsules and boxes in closed form, but for two boxes; coal measures what
is left, where it may be nearer than what the kernel found.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kempe.budget import check_for_stop
from kempe.forward.fk import fk
from kempe.geometry.solids import Placed, Solids
from kempe.kernels.compiled import solid_distances
from kempe.kernels.solids.solid_layout import BOX, OTHER, SIZES, SOLID_FLOATS
from kempe.numerics.pool import sum_over_chunks
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model

CHUNK = 1024
"""Configurations in one piece of work, whose poses are held at once."""
SERIAL_BELOW = 4096
"""Configurations below which one thread works."""


class SmallestDistance:
    """The smallest distance of pairs (k, 2) of solids, less the distance (k,) that each has to
    keep.
    """

    def __init__(
        self, system: Model, solids: Solids, couples: np.ndarray, at_least: Array | None = None
    ):
        self._system = system
        self._solids = solids
        least = np.zeros(len(couples)) if at_least is None else at_least
        form = np.array([core.form for core in solids.cores])
        sizes = np.array([core.sizes for core in solids.cores])
        radius = np.array([core.radius for core in solids.cores])
        # the smaller form first: a box is the second one
        couples = np.take_along_axis(couples, np.argsort(form[couples], axis=1), axis=1)
        first, second = form[couples].T
        closed = (first != BOX) & (second != OTHER)
        self._others = couples[~closed], least[~closed]
        pairs = couples[closed]
        off_cores = radius[pairs].sum(axis=1) + least[closed]
        off_centers = off_cores + np.linalg.norm(sizes, axis=1)[pairs].sum(axis=1)
        shapes = np.zeros((len(form), SOLID_FLOATS))
        shapes[:, :SIZES] = solids.places[:, :3].reshape(-1, SIZES)
        shapes[:, SIZES : SIZES + 3] = sizes
        self._packed = (
            np.ascontiguousarray(np.stack([solids.body_of, form], axis=1), dtype=np.int64),
            shapes,
            np.ascontiguousarray(pairs, dtype=np.int64),
            np.stack([off_cores, off_centers], axis=1),
        )
        self._table = system.structure.table.pack_arrays(solids.names)

    def compute_distances(self, q: Array, below: float = np.inf) -> Array:
        """Compute the smallest distances (n,) at q (n, nq): NaN where poses are not finite, infinite
        without pairs.

        Only those less than `below` are exact; others may be anything from there on.
        """
        out = np.empty(len(q))

        def measure_chunk(start: int, stop: int) -> int:
            solid_distances.find_smallest_distances(
                *self._table, q[start:stop], *self._packed, out[start:stop]
            )
            return 0

        sum_over_chunks(measure_chunk, len(q), CHUNK, None, SERIAL_BELOW)
        if len(self._others[0]):
            for start in range(0, len(q), CHUNK):
                self._measure_others(q[start : start + CHUNK], out[start : start + CHUNK], below)
        return out

    def _measure_others(self, q: Array, out: Array, below: float) -> None:
        """Replace distances (n,) by those of pairs without a closed form that are smaller, and less
        than `below`.
        """
        poses = fk(self._system, q, self._solids.names)
        for k, X in enumerate(poses):
            check_for_stop()
            if not np.isnan(out[k]):
                placed = Placed(self._solids, X)
                out[k] = placed.find_smallest(*self._others, min(float(out[k]), below))
