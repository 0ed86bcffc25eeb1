"""Idle freedoms of a system, where its loops are closed, and equations that hold them.

An idle spin moves nothing but the bodies that spin, so any rule that fixes it leaves the motion of
all others as it is. The rule here is that of a universal joint in place of a ball: a direction
fixed in the bodies stays perpendicular to a direction fixed in the ground. As long as the line
about which they spin is not parallel to the latter, the spin is a function of the line: a motion
that leads the line back leads the bodies back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from kempe.arguments import quiet
from kempe.assemble.generic_configurations import (
    close_configuration,
    find_closed_configuration,
    sample_useful_ranks,
)
from kempe.first_order.control import find_driven_velocities
from kempe.first_order.idle_freedoms import IdleFreedom, find_idle_freedoms
from kempe.first_order.rank import compute_rank
from kempe.forward.fk import jacobian, query
from kempe.kernels.constraints.loop_layout import CROSS
from kempe.model.ball_angles import make_regular_chart
from kempe.model.configurations import has_loops
from kempe.model.constraint_program import Tie
from kempe.model.model import keep_answers
from kempe.model.own_tree import remove_cut_marks
from kempe.numerics.directions import spread_directions
from kempe.spatial import Array, align_z, pose, unit

if TYPE_CHECKING:
    from kempe.equations.closure import Closure
    from kempe.model.model import Model
    from kempe.model.primitive_table import Table

STEEP = 0.2
"""Sine of the angle between line and direction in the ground below which a direction farther away
is looked for."""
BETTER = 1.5
"""How many times farther away it must be."""
DIRECTIONS = 400
"""Directions in the ground that are tried."""


# ---- what is idle


@quiet
def find_idle_freedoms_at(system: Model, q: Array) -> tuple[IdleFreedom, ...]:
    """Find the idle freedoms at the closed configuration nearest to q (nq,).

    There are none where the loops cannot be closed.

    Joints are driven that are marked so. Velocities are those of the angles in which balls are
    regular there.
    """
    at = close_configuration(system, q)
    if not at.closed:
        return ()
    system, q, _ = make_regular_chart(system, at.q)
    motors = find_driven_velocities(system, None)
    rank = compute_rank(system, q)
    return find_idle_freedoms(
        system, [rank, *sample_useful_ranks(system, rank, motors, np.random.default_rng(0))], motors
    )


def get_idle_freedoms(system: Model, q: Array | None = None) -> tuple[IdleFreedom, ...]:
    """Find the idle freedoms of a system at a closed configuration.

    The search is made once; where it finds no closed configuration, q (nq,) is taken.
    """
    tree = remove_cut_marks(system)
    found = _find_home_idle_freedoms(tree)
    if found is None:
        return () if q is None else find_idle_freedoms_at(tree, q)
    return found


@keep_answers
def _find_home_idle_freedoms(system: Model) -> tuple[IdleFreedom, ...] | None:
    """Find the idle freedoms at a closed configuration; None if there is none."""
    at = find_closed_configuration(system)
    return find_idle_freedoms_at(system, at.q) if at.closed else None


def find_idle_coordinates(system: Model, q: Array | None = None) -> np.ndarray:
    """Return a mask (nv,) of the velocity coordinates that idle freedoms change.

    Of a rotation, all three are marked.
    """
    moves = [f.moving_velocities for f in get_idle_freedoms(system, q)] if has_loops(system) else []
    out = np.any([np.zeros(system.nv, dtype=bool), *moves], axis=0)
    for iv in system.structure.layout.quaternion_v:
        out[iv : iv + 3] = out[iv : iv + 3].any()
    return np.asarray(out)


def compute_idle_rates(system: Model, q: Array) -> Array:
    """Compute the rows (k, s, nv) that map velocities at q (k, nq) to s idle spin rates [rad/s]."""
    tree = remove_cut_marks(system)
    found = get_idle_freedoms(system) if system.dim == 3 else ()
    rows = [f.in_body[1] @ jacobian(tree, q, f.bodies[0], "body")[:, 3:] for f in found]
    return np.stack(rows, axis=1) if rows else np.zeros((len(q), 0, system.nv))


# ---- equations that hold it


class SpinLock:
    """Ties that hold idle spins, one for each: ``ground . (R along) = 0``.

    `ground` (k, 3) are directions in the ground, `along` (k, 3) directions in the bodies, both
    perpendicular to the lines at the configuration where they were chosen.
    """

    def __init__(self, system: Model, spins: Sequence[IdleFreedom], q: Array):
        self._bodies = [f.bodies[0] for f in spins]
        self._queries = [query(system, body) for body in self._bodies]
        self._axes = [f.in_body[1] for f in spins]
        self._q = q
        self._seen = self.compute_lines(q[None])
        self._set_directions(_compute_perpendiculars(self._seen[0]))

    def compute_lines(self, q: Array) -> Array:
        """Compute the directions (n, k, 3) of the lines in the ground at configurations (n, nq)."""
        pairs = zip(self._queries, self._axes, strict=True)
        return np.stack([compute_pose(q)[:, :3, :3] @ axis for compute_pose, axis in pairs], axis=1)

    def _set_directions(self, ground: Array) -> None:
        """Set the directions in the ground by which spins are held at the first configuration."""
        self.ground = ground
        across = unit(np.cross(ground, self.compute_lines(self._q[None])[0]))
        pairs = zip(self._queries, across, strict=True)
        self.along = np.array([compute_pose(self._q)[:3, :3].T @ v for compute_pose, v in pairs])

    def list_ties(self, table: Table) -> list[Tie]:
        """List the ties that hold the spins: x in the ground is normal to y in the body."""
        ties: list[Tie] = []
        ground = pose(align_z(self.ground)[..., [2, 0, 1]])
        turned = pose(align_z(self.along)[..., [1, 2, 0]])
        for body, A, B in zip(self._bodies, ground, turned, strict=True):
            row, X, particle = table.at[body]
            a = (-1, A, False)
            b = (row, X @ B, particle)
            ties.append(Tie(f"spin of {body}", a, b, turns=CROSS))
        return ties

    def find_near_lines(self, q: Array) -> np.ndarray:
        """Find at which configurations (n, nq) a line comes near to its direction in the ground."""
        return np.any(_compute_sines(self.ground, self.compute_lines(q)) < 2.0 * STEEP, axis=1)

    def update_directions(self, q: Array) -> bool:
        """Choose directions in the ground that are far from the lines at a configuration (nq,).

        True is returned if others were needed: then the spins are held as they are there.
        """
        changed = bool(self.find_near_lines(q[None])[0])
        if changed:
            self._q = q
            self._set_directions(_compute_perpendiculars(self.compute_lines(q[None])[0]))
        return changed

    def replace_near_directions(self, q: Array) -> bool:
        """Replace directions in the ground that lines come near to at configurations (n, nq).

        True is returned if some changed.
        """
        self._seen = np.concatenate([self._seen, self.compute_lines(q)])
        ground = self.ground.copy()
        directions = spread_directions(DIRECTIONS)
        for i in range(len(self._axes)):
            least = _compute_sines(ground[i], self._seen[:, i]).min()
            if least < STEEP:
                away = _compute_sines(directions[:, None], self._seen[None, :, i]).min(axis=1)
                best = int(np.argmax(away))
                if away[best] > BETTER * least:
                    ground[i] = directions[best]
        changed = not np.array_equal(ground, self.ground)
        if changed:
            self._set_directions(ground)
        return changed


def find_spin_lock(equations: Closure) -> SpinLock | None:
    """Return the lock of idle spins among equations, or None where there is none."""
    return equations.lock if isinstance(equations.lock, SpinLock) else None


def lock_spins(equations: Closure, q: Array, requested: Iterable[int]) -> bool:
    """Hold the idle spins from a closed configuration on.

    Those that move held or `requested` velocities stay free. True is returned if any is held.
    """
    keep = [*equations.held, *requested]
    spins = [f for f in get_idle_freedoms(equations.tree, q) if not f.moving_velocities[keep].any()]
    if spins and find_spin_lock(equations) is None:
        equations.set_lock(SpinLock(equations.tree, spins, q))
    return bool(spins)


def _compute_perpendiculars(lines: Array) -> Array:
    """Compute unit vectors (k, 3) perpendicular to others."""
    return unit(np.cross(lines, np.eye(3)[np.argmin(np.abs(lines), axis=1)]))


def _compute_sines(a: Array, b: Array) -> Array:
    """Compute the sines (...) of the angles between unit vectors (..., 3)."""
    return np.asarray(np.linalg.norm(np.cross(a, b), axis=-1), dtype=float)
