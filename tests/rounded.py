"""Mechanisms as files from CAD hold them: frames of bodies anywhere, and every number rounded to so many decimals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

import kempe
from kempe import Mechanism, System
from kempe.placement import Placement, place, placement_of_pose
from kempe.spatial import rot_x, rot_y, rot_z, xyz_rpy_from_pose


def rounded(system: System, digits: int, rng: np.random.Generator) -> System:
    """The system with the frames of its bodies anywhere, and its numbers rounded to so many decimals."""
    m, at = system.mechanism, {}
    for body in m.bodies:
        at[body] = np.eye(4)
        if body != m.ground.name:
            turn = rot_z(rng.uniform(-3, 3))
            at[body][:3, :3] = turn if m.dim == 2 else turn @ rot_y(rng.uniform(-1, 1)) @ rot_x(rng.uniform(-3, 3))
            at[body][: m.dim, 3] = rng.uniform(-0.3, 0.3, m.dim)

    def new(X: Placement, body: str) -> Placement:
        old, inverse = X.evaluate(m.parameters), np.linalg.inv(at[body])
        x = np.round(xyz_rpy_from_pose(inverse @ old), digits).tolist()
        if m.dim == 3:
            return place(tuple(x[:3]), rpy=tuple(x[3:]))
        if old[2, 2] > 0.5:
            return place(tuple(x[:2]), angle=x[5])
        turn, rest = float(np.round(xyz_rpy_from_pose(inverse)[5], digits)), np.eye(4)
        rest[:3, :3] = old[:3, :3]  # the axis of a slide is in the plane: only what turns it there is rounded
        return place(tuple(x[:2]), angle=turn) @ placement_of_pose(rest)

    for name, j in m.joints.items():
        m.joints[name] = replace(j, X_PF=new(j.X_PF, j.parent), X_CM=new(j.X_CM, j.child))
    return m.build()


def perturbed(system: System, off: float, rng: np.random.Generator) -> System:
    """The system with all placements of joints off by up to so many metres and radians."""
    m = system.mechanism
    for name, j in m.joints.items():
        motions = ("x", "y", "rz") if m.dim == 2 else ("x", "y", "z", "rz", "ry", "rx")
        steps = tuple((k, (float(rng.uniform(-off, off)),)) for k in motions)
        m.joints[name] = replace(j, X_PF=Placement(j.X_PF.steps + steps))
    return m.build()


def cranks(count: int, dim: int = 2) -> System:
    """A coupler on parallel cranks, at most five."""
    m = Mechanism(f"{count} cranks", dim=dim)
    arms, coupler = [m.body(f"crank{i}") for i in range(count)], m.body("coupler")
    pivots = [(0.0, 0.0), (0.41 / math.sqrt(2.0), 0.1 / 3.0), (0.9 / math.sqrt(3.0), -0.07 * math.pi),
              (0.31 * math.sqrt(3.0), 0.2 / 3.0), (0.1 * math.pi, -0.1 * math.sqrt(2.0))]  # fmt: skip
    for i, (x, y) in enumerate(pivots[:count]):
        rest = (0.0,) * (dim - 2)
        m.revolute(f"A{i}", m.ground, arms[i], at=(x, y, *rest))
        m.revolute(f"B{i}", arms[i], coupler, at=(0.2 * math.sqrt(1.7), 0.0, *rest), child_at=(x, y, *rest))
    m.posture("closed", {f"{k}{i}": 0.9 if k == "A" else -0.9 for i in range(count) for k in "AB"})
    return m.build()


def spherical_triples() -> System:
    """Six hinges in a loop: the axes of three meet in one point, those of the others in another; one freedom."""
    m = Mechanism("two spherical triples")
    bodies = [m.ground, *(m.body(f"b{i}") for i in range(1, 6))]
    axes = [(1, 0.2, 0.1), (0.1, 1, -0.2), (0.3, -0.2, 1), (1, 0.5, 0.3), (-0.2, 1, 0.4), (0.2, 0.3, 1)]
    for i, axis in enumerate(axes):
        at = (0.1, 0.2, 0.3) if i < 3 else (0.9, -0.1, 0.5)
        m.revolute(f"q{i}", bodies[i], bodies[(i + 1) % 6], at=at, axis=axis, child_at=at, child_axis=axis)
    m.posture("closed", {f"q{i}": 0.0 for i in range(6)})
    return m.build()


SHIPPED = ("bennett", "goldberg_5r", "schatz", "bricard_line_symmetric", "bricard_rectangular", "bricard_trihedral",
           "sarrus", "four_bar_spatial", "double_parallelogram")  # fmt: skip
BUILT = {
    "three_cranks": lambda: cranks(3),
    "three_cranks_3d": lambda: cranks(3, 3),
    "five_cranks": lambda: cranks(5),
    "spherical_triples": spherical_triples,
}


def exact(name: str) -> System:
    """A mechanism of one freedom by name, with the numbers of its construction."""
    return BUILT[name]() if name in BUILT else kempe.load(name)


NAMES = (*SHIPPED, *BUILT)
