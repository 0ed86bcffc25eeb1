"""The closure of a joint by the rows that its type takes away, in numpy, with exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kempe import System
from kempe.equations.judge import compute_coordinate_value
from kempe.errors import UnknownNameError
from kempe.model.configurations import read_q
from kempe.model.implicit_form import has_slide_along_z
from kempe.spatial import Array
from oracles import pairs
from oracles.carried import Carried, coordinate_row
from oracles.frames import Pair
from oracles.motion import motion_of


@dataclass(frozen=True, eq=False)
class Closure(Pair):
    """A joint that closes a loop, by the rows that its type takes away: 5 of a revolute joint, 3 of
    a ball, ...

    `tied` are coordinates of the joint that have rows of their own, which ask that the value in q
    (or what it follows) is what is read off the pose; each (names, how they are read), three angles
    or a quaternion together.
    """

    hold: pairs.Hold
    pitch: float = 0.0
    tied: tuple[tuple[tuple[str, ...], str], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each row: held directions, then tied coordinates."""
        own = [
            x
            for names, _ in self.tied
            for x in (names if len(names) == 1 else (f"own r{a}" for a in "xyz"))
        ]
        return (*self.hold.names, *own)

    def rows(self, X: Array) -> pairs.Rows:
        """The rows that the joint's type holds."""
        return self.hold.rows(X)

    def residual(self, system: System, q: Any) -> Array:
        """How far it is violated (..., size), in metres and radians."""
        return self._both(system, read_q(system, q))[0]

    def jacobian(self, system: System, q: Any) -> Array:
        """Derivatives (..., size, nv) of the residual by the velocity coordinates."""
        return self._both(system, read_q(system, q))[1]

    def _both(self, system: System, q: Array) -> tuple[Array, Array]:
        X = self.pose(system, q)
        motion = self.motion(system, q)
        value, rates = self.hold.rows(X)
        values = [value]
        jacobians = [rates @ motion]
        for names, kind in self.tied:
            if len(names) == 1:
                number, rates = pairs.read(X, kind, self.pitch)
                number = number - compute_coordinate_value(system, q, names[0])
                if kind.startswith("turn"):
                    number = (number + np.pi) % (
                        2.0 * np.pi
                    ) - np.pi  # a full turn more is the same pose
                number = number[..., None]
                J = rates[..., None, :] @ motion - coordinate_row(system, names[0])
            else:
                own = np.stack([compute_coordinate_value(system, q, n) for n in names], axis=-1)
                number, rates, by_own = (
                    pairs.angle_rows if len(names) == 3 else pairs.quaternion_rows
                )(X, own)
                J = rates @ motion + by_own @ _own_rows(system, names)
            values.append(number)
            jacobians.append(J)
        return np.concatenate(values, axis=-1), np.concatenate(jacobians, axis=-2)


def _own_rows(system: System, names: tuple[str, ...]) -> Array:
    """Matrix (3, nv) to the velocities of three angles or of a quaternion."""
    if len(names) == 3:
        return np.stack([coordinate_row(system, n) for n in names])
    out = np.zeros((3, system.nv))
    if names[0] not in system.structure.couplings:
        first = system.structure.coordinates.first[names[0]][1]
        out[:, first : first + 3] = np.eye(3)
    return out


def closure_of(system: System, joint: str, own: bool = False) -> Closure | Carried:
    """The closure of a joint, by the rows that its type takes away.

    Coordinates of the joint that follow others, are held, or are part of a relation have a row each
    besides, for they are not free; with `own=True` all of them do, so that the residual is zero
    only where q has their values, too. So they do in any case where what the type takes away has no
    fixed axes: its closure is `Carried`.
    """
    mechanism = system.mechanism
    if joint not in mechanism.joints:
        raise UnknownNameError("joint", joint, mechanism.joints, system.name)
    j = mechanism.joints[joint]
    particle = mechanism.bodies[j.child].particle
    X_PF, X_CM = (X.evaluate_pose(mechanism.parameters) for X in (j.X_PF, j.X_CM))
    X_PF, X_CM = pairs.frames_of(j.type, X_PF, X_CM, system.dim, particle)
    names = system.structure.coordinates_of_joint(joint)
    hold = pairs.hold_of(j.type, system.dim, particle)
    if hold is None:
        motion = motion_of(system, j, has_slide_along_z(j.type, system.dim, particle))
        return Carried(joint, j.parent, j.child, motion, X_A=X_PF, X_B=X_CM)
    related = {
        n for r in system.structure.relations for n in (r.of, *r.sources)
    } | system.structure.couplings.keys()
    groups = pairs.reading_groups(j.type, system.dim, particle)
    tied = [(tuple(names[i] for i in group), kind) for group, kind in groups]
    tied = [t for t in tied if own or related & {*t[0]}]
    return Closure(
        joint, j.parent, j.child, hold, hold.pitch or 0.0, tuple(tied), X_A=X_PF, X_B=X_CM
    )
