"""Charts of ball joints: angles measured from a posture, so that they are not singular there.

Three angles of one ball joint are coordinates of its rotation, and fail where the second is +-90
degrees: there they have a velocity that moves nothing. That is no freedom of the mechanism. Three
hinges in a row are: there bodies turn.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kempe import spatial
from kempe.description.parts import Joint
from kempe.joints import R
from kempe.model.implicit_form import has_own_coordinates
from kempe.model.model import keep_answers
from kempe.poses import place
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model, SystemType

NEAR = 0.1
"""Cosine of the second angle below which angles are measured from here instead."""


def make_regular_chart(
    system: SystemType, q: Array, held: Collection[str] = ()
) -> tuple[SystemType, Array, dict[str, Array]]:
    """Return the system with ball angles measured from q where they are nearly singular.

    The configuration q (nq,) in these angles is returned, too.

    The frame M of such a ball is turned on its child so that the angles are 0 at q; nothing else
    changes, neither names nor numbers. Balls with an angle that is coupled, or one of `held`, stay,
    for it has a meaning of its own. The third answer are the rotations (3, 3) by which frames were
    turned, by name of the joint.
    """
    turned: dict[str, Array] = {}
    for name, at in _find_ball_angles(system).items():
        z, y, x = q[at].tolist()
        if abs(np.cos(y)) < NEAR and not any(system.coordinate_names[i] in held for i in at):
            turned[name] = (
                spatial.make_rotation(z, "z")
                @ spatial.make_rotation(y, "y")
                @ spatial.make_rotation(x, "x")
            )
    if not turned:
        return system, q, turned
    mechanism = system.mechanism
    for name, turn in turned.items():
        joint: Joint = mechanism.joints[name]
        mechanism.joints[name] = replace(joint, X_CM=joint.X_CM @ place(matrix=turn.T))
    other = type(system)(mechanism)
    values = np.array(q)
    for name in turned:
        values[_find_ball_angles(system)[name]] = 0.0
    return other, values, turned


def convert_from_chart(system: Model, q: Array, turned: dict[str, Array]) -> Array:
    """Return the system's own configuration (nq,) for `q` in the chart of `make_regular_chart`."""
    q = np.array(q)
    for name, turn in turned.items():
        at = _find_ball_angles(system)[name]
        z, y, x = q[at]
        q[at] = spatial.matrix_to_rpy(
            spatial.make_rotation(z, "z")
            @ spatial.make_rotation(y, "y")
            @ spatial.make_rotation(x, "x")
            @ turn
        )[::-1]
    return q


@keep_answers
def _find_ball_angles(system: Model) -> dict[str, list[int]]:
    """Return, by joint name, the indices in q of the three angles of each ball joint."""
    names = {n: i for i, n in enumerate(system.coordinate_names)}
    related = {f.source for f in system.structure.couplings.values()} | set(
        system.structure.couplings
    )
    related |= {n for r in system.structure.relations for n in (r.of, *r.sources)}
    found: dict[str, list[int]] = {}
    for joint in system.structure.joints.values():
        particle = system._mechanism.bodies[joint.child].particle
        own, steps = joint.type.layout(system.dim, particle)
        last = steps[-3:] if has_own_coordinates(steps) else ()
        angles = [f"{joint.name}.{own[p.coordinate]}" for p in last if p.kind == R]
        if [p.axis for p in last] == ["z", "y", "x"] and len(angles) == 3:
            if set(angles) <= set(names) and not related & set(angles):
                found[joint.name] = [names[n] for n in angles]
    return found
