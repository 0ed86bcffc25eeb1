"""Mechanisms as files from CAD hold them: frames of bodies anywhere, and every number rounded to so
many decimals.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

import kempe
from kempe import Mechanism, System
from kempe.poses import Placement, make_placement_from_pose, place
from kempe.spatial import rot_x, rot_y, rot_z, xyz_rpy_from_pose


def rounded(
    system: System, digits: int, rng: np.random.Generator, ground: np.ndarray | None = None
) -> System:
    """The system with the frames of its bodies anywhere, and its numbers rounded to so many
    decimals.

    With a pose (4, 4) of the `ground` the frames of bodies stay, and the mechanism as a whole is
    there.
    """
    m = system.mechanism
    at: dict[str, np.ndarray] = {}
    for body in m.bodies:
        at[body] = np.eye(4)
        if ground is not None:
            at[body] = np.linalg.inv(ground) if body == m.ground.name else at[body]
        elif body != m.ground.name:
            turn = rot_z(rng.uniform(-3, 3))
            at[body][:3, :3] = (
                turn if m.dim == 2 else turn @ rot_y(rng.uniform(-1, 1)) @ rot_x(rng.uniform(-3, 3))
            )
            at[body][: m.dim, 3] = rng.uniform(-0.3, 0.3, m.dim)

    def new(X: Placement, body: str) -> Placement:
        old = X.evaluate_pose(m.parameters)
        inverse = np.linalg.inv(at[body])
        x = np.round(xyz_rpy_from_pose(inverse @ old), digits).tolist()
        if m.dim == 3:
            return place(tuple(x[:3]), rpy=tuple(x[3:]))
        if old[2, 2] > 0.5:
            return place(tuple(x[:2]), angle=x[5])
        turn = float(np.round(xyz_rpy_from_pose(inverse)[5], digits))
        rest = np.eye(4)
        # the axis of a slide is in the plane: only what turns it there is rounded
        rest[:3, :3] = old[:3, :3]
        return place(tuple(x[:2]), angle=turn) @ make_placement_from_pose(rest)

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
    arms = [m.body(f"crank{i}") for i in range(count)]
    coupler = m.body("coupler")
    pivots = [(0.0, 0.0), (0.41 / math.sqrt(2.0), 0.1 / 3.0), (0.9 / math.sqrt(3.0), -0.07 * math.pi),
              (0.31 * math.sqrt(3.0), 0.2 / 3.0), (0.1 * math.pi, -0.1 * math.sqrt(2.0))]  # fmt: skip
    for i, (x, y) in enumerate(pivots[:count]):
        rest = (0.0,) * (dim - 2)
        m.revolute(f"A{i}", m.ground, arms[i], at=(x, y, *rest))
        m.revolute(
            f"B{i}", arms[i], coupler, at=(0.2 * math.sqrt(1.7), 0.0, *rest), child_at=(x, y, *rest)
        )
    m.posture("closed", {f"{k}{i}": 0.9 if k == "A" else -0.9 for i in range(count) for k in "AB"})
    return m.build()


def spherical_triples() -> System:
    """Six hinges in a loop: the axes of three meet in one point, those of the others in another;
    one freedom.
    """
    m = Mechanism("two spherical triples")
    bodies = [m.ground, *(m.body(f"b{i}") for i in range(1, 6))]
    axes = [
        (1, 0.2, 0.1),
        (0.1, 1, -0.2),
        (0.3, -0.2, 1),
        (1, 0.5, 0.3),
        (-0.2, 1, 0.4),
        (0.2, 0.3, 1),
    ]
    for i, axis in enumerate(axes):
        at = (0.1, 0.2, 0.3) if i < 3 else (0.9, -0.1, 0.5)
        m.revolute(
            f"q{i}", bodies[i], bodies[(i + 1) % 6], at=at, axis=axis, child_at=at, child_axis=axis
        )
    m.posture("closed", {f"q{i}": 0.0 for i in range(6)})
    return m.build()


SHIPPED = (
    "bennett",
    "goldberg_5r",
    "schatz",
    "bricard_line_symmetric",
    "bricard_rectangular",
    "bricard_trihedral",
    "sarrus",
    "four_bar_spatial",
    "double_parallelogram",
)
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


# ---- families of the literature with random dimensions


def in_place(name: str, joints: Iterable[tuple[str, str, Any, Any]], dim: int = 3) -> System:
    """Hinges (a, b, point, axis) in the axes of the ground, closed at zero angles; `None` for a
    body is the ground.
    """
    m = Mechanism(name, dim=dim)
    joints = list(joints)
    for body in dict.fromkeys(b for j in joints for b in j[:2] if b):
        m.body(body)
    for i, (a, b, p, z) in enumerate(joints):
        p = tuple(map(float, p))[:dim]
        more = {"axis": z, "child_axis": z} if dim == 3 else {}
        m.revolute(f"q{i}", a or m.ground, b or m.ground, at=p, child_at=p, **more)
    m.posture("closed", {f"q{i}": 0.0 for i in range(len(joints))})
    return m.build()


def ring(name: str, points: np.ndarray, axes: np.ndarray) -> System:
    """One loop of hinges."""
    bodies = ["", *(f"b{i}" for i in range(1, len(points))), ""]
    return in_place(
        name,
        [
            (bodies[i], bodies[i + 1], p, z)
            for i, (p, z) in enumerate(zip(points, axes, strict=True))
        ],
    )


def shipped(
    name: str, ranges: dict[str, tuple[float, float]], rng: np.random.Generator
) -> System | None:
    """A mechanism of the library with other dimensions, closed where it moves; None where none was
    found.
    """
    m = kempe.load(name).mechanism
    m.parameters |= {k: float(rng.uniform(*ends)) for k, ends in ranges.items()}
    system = m.build()
    for _ in range(10):
        answer = system.assemble(start=rng.uniform(-2.5, 2.5, system.nq))
        report = system.mobility(answer.q) if answer else None
        if report is not None and report.dof == 1 and not report.singular:
            m.postures["closed"] = dict(
                zip(system.coordinate_names, answer.q.tolist(), strict=True)
            )
            return m.build()
    return None


def random_bennett(rng: np.random.Generator) -> tuple[System | None, int]:
    return shipped("bennett", {"a": (0.1, 0.5), "alpha": (0.4, 1.4), "beta": (0.4, 1.4)}, rng), 1


def random_goldberg(rng: np.random.Generator) -> tuple[System | None, int]:
    angles = {k: (0.4, 1.2) for k in ("alpha", "beta", "gamma")}
    return shipped("goldberg_5r", {"a": (0.15, 0.4), **angles}, rng), 1


def random_line_symmetric(rng: np.random.Generator) -> tuple[System | None, int]:
    turns = {k: (0.5, 1.4) for k in ("alpha", "beta", "gamma")}
    return shipped(
        "bricard_line_symmetric", {**{k: (0.2, 0.5) for k in "abc"}, **turns, "r": (-0.2, 0.2)}, rng
    ), 1


def random_trihedral(rng: np.random.Generator) -> tuple[System | None, int]:
    return shipped(
        "bricard_trihedral",
        {f"a{i}": (0.3, 0.4) if i % 2 else (0.2, 0.3) for i in range(1, 6)},
        rng,
    ), 1


def random_spherical(rng: np.random.Generator) -> tuple[System | None, int]:
    n = int(rng.integers(4, 7))
    axes = rng.normal(size=(6, 3))
    axes = (axes / np.linalg.norm(axes, axis=1, keepdims=True))[:n]
    return ring(
        "spherical", rng.uniform(-0.5, 0.5, 3) + rng.uniform(0.2, 0.5, (n, 1)) * axes, axes
    ), n - 3


def random_planar(rng: np.random.Generator) -> tuple[System | None, int]:
    n = int(rng.integers(4, 7))
    return ring(
        "parallel", rng.uniform(-0.5, 0.5, (n, 3)), np.tile(rng.normal(size=3), (n, 1))
    ), n - 3


def random_sarrus(rng: np.random.Generator) -> tuple[System | None, int]:
    axes = np.repeat(rng.normal(size=(2, 3)), 3, axis=0)
    return ring("sarrus", rng.uniform(-0.5, 0.5, (6, 3)), axes), 1


def random_triples(rng: np.random.Generator) -> tuple[System | None, int]:
    return ring(
        "triples", np.repeat(rng.uniform(-0.6, 0.6, (2, 3)), 3, axis=0), rng.normal(size=(6, 3))
    ), 1


def random_cranks(rng: np.random.Generator) -> tuple[System | None, int]:
    n = int(rng.integers(3, 7))
    dim = int(rng.integers(2, 4))
    t = rng.uniform(0.0, 2.0 * math.pi)
    arm = rng.uniform(0.2, 0.5) * np.array([math.cos(t), math.sin(t), 0.0])
    joints: list[Any] = []
    for i, p in enumerate(rng.uniform(-0.5, 0.5, (n, 3))):
        joints += [("", f"crank{i}", p, (0, 0, 1)), (f"crank{i}", "coupler", p + arm, (0, 0, 1))]
    return in_place("cranks", joints, dim), 1


def random_ring_of_scissors(rng: np.random.Generator) -> tuple[System | None, int]:
    """Hoberman's ring: pairs of equal angulated bars whose ends run on lines through the center."""
    n = int(rng.integers(4, 7))
    inner = rng.uniform(0.2, 0.3)
    outer = rng.uniform(0.5, 0.6)
    half = math.pi / n
    bars = [["" if not i else f"a{i}" for i in range(n)], [f"b{i}" for i in range(n)]]

    def at(radius: float, turn: float) -> tuple[float, float, float]:
        return radius * math.cos(turn), radius * math.sin(turn), 0.0

    joints: list[Any] = []
    for i in range(n):
        a = bars[0][i]
        b = bars[1][i]
        turn = 2.0 * half * i
        following = (i + 1) % n
        joints.append((a, b, at((inner + outer) / 2.0 / math.cos(half), turn), (0, 0, 1)))
        joints.append((a, bars[1][following], at(outer, turn + half), (0, 0, 1)))
        joints.append((b, bars[0][following], at(inner, turn + half), (0, 0, 1)))
    return in_place("ring", joints, 2), 1


FAMILIES = {
    "bennett": random_bennett,
    "goldberg": random_goldberg,
    "line_symmetric": random_line_symmetric,
    "trihedral": random_trihedral,
    "spherical": random_spherical,
    "planar": random_planar,
    "sarrus": random_sarrus,
    "triples": random_triples,
    "cranks": random_cranks,
    "ring_of_scissors": random_ring_of_scissors,
}
"""Overconstrained mechanisms with random dimensions, and their freedoms."""
