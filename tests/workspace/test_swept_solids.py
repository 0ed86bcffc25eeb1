"""Exact workspaces in space, of chains that move a frame in a plane which is moved or turned:
closed forms and `ik`.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hunts import Hunt
from reached_sets import SHELL, TORUS, scara, shell, torus

import kempe
from kempe import spatial
from kempe.workspace.planar.swept_solids import SweptSolid, find_swept_solid


def chain(*joints, tool, base=None, name="chain"):
    """A chain of (type, axis, place, limits) with a tool, held at a pose of its base."""
    m = kempe.Mechanism(name)
    base_body = m.body("base")
    at, rpy = base if base is not None else ((0, 0, 0), (0, 0, 0))
    m.fixed("hold", m.ground, base_body, at=at, rpy=rpy)
    parent = base_body
    for k, (kind, axis, at, limits) in enumerate(joints):
        child = m.body(f"b{k}")
        getattr(m, kind)(f"q{k}", parent, child, axis=axis, at=at, limits=limits)
        parent = child
    m.frame("tip", parent, tool)
    return m.build()


CLOSED = {
    "scara": (scara(0.5, 0.3, 0.2), 0.2 * math.pi * (0.8**2 - 0.2**2)),
    "shell": (shell(0.5, 0.3), SHELL),
    "torus": (torus(0.5, 0.2, True), TORUS),
    # a torus that covers its own axis: its sides lie on each other
    "spindle": (torus(0.1, 0.2, True), math.pi * (2.0 / 3.0 * (2.0 * 0.2**2 + 0.1**2) * math.sqrt(0.2**2 - 0.1**2)
                                                  + 2.0 * 0.1 * 0.2**2 * (math.pi - math.acos(0.1 / 0.2)))),
    "cylinder": (chain(("revolute", "z", (0, 0, 0), None), ("prismatic", "z", (0, 0, 0), (0.1, 0.6)),
                       ("prismatic", "x", (0, 0, 0), (0.3, 0.7)), tool=(0, 0, 0)),
                 0.5 * math.pi * (0.7**2 - 0.3**2)),
    "gantry": (chain(("prismatic", "x", (0, 0, 0), (0.0, 2.0)), ("prismatic", "y", (0, 0, 0), (-1.0, 0.5)),
                     ("prismatic", (0.0, 0.6, 0.8), (0, 0, 0), (0.0, 0.5)), tool=(0.1, 0, 0)), 2.0 * 1.5 * 0.5 * 0.8),
}  # fmt: skip


@pytest.mark.parametrize("name", CLOSED)
def test_volumes_of_closed_form(name):
    system, volume = CLOSED[name]
    solid = find_swept_solid(system, "tip")
    assert solid.measure[0] == pytest.approx(volume, rel=1e-10)
    found = system.workspace("tip", n=2000, cells=12)
    assert found.exact is not None and found.volume[0] == pytest.approx(volume, rel=1e-10)
    assert "exact but for rounding" in str(found)


@pytest.mark.parametrize("name", ["shell", "torus"])
def test_distances_of_closed_form(name):
    """Of a shell those from two spheres, of a torus those from its centre line."""
    system = CLOSED[name][0]
    p = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 3))
    r = np.linalg.norm(p, axis=1)
    expected = np.minimum(np.abs(r - 0.8), np.abs(r - 0.2))
    if name == "torus":
        expected = np.abs(np.hypot(np.hypot(p[:, 0], p[:, 1]) - 0.5, p[:, 2]) - 0.2)
    assert find_swept_solid(system, "tip").distance(p) == pytest.approx(expected, abs=1e-12)


def test_arms_of_other_kinds_are_sampled():
    assert find_swept_solid(kempe.load("ur5"), "tool") is None
    limited = chain(("revolute", "z", (0, 0, 0), (-1.0, 1.0)), ("revolute", (0.0, 0.8, 0.6), (0.3, 0, 0), None),
                    ("revolute", "y", (0.3, 0, 0), None), tool=(0.2, 0, 0))  # fmt: skip
    assert (
        find_swept_solid(limited, "tip") is None
        and limited.workspace("tip", n=2000, cells=8).exact is None
    )
    assert shell(0.5, 0.3).workspace("tip", n=500, cells=8, kind="dexterous").exact is None
    half = torus(0.5, 0.2, True).with_limits({"A": (-1.0, 1.0)})
    value, error = half.workspace("tip", n=2e5).volume
    assert find_swept_solid(half, "tip") is None
    assert value == pytest.approx(TORUS / math.pi, abs=2.0 * error)
    assert find_swept_solid(kempe.load("puma560"), "tool") is None


def random_chain(rng):
    """A chain of a kind that has an exact workspace, anyhow placed: slides and turns, some with
    limits.
    """
    limits = [
        None if rng.random() < 0.4 else tuple(np.sort(rng.uniform(-3.0, 3.0, 2)).tolist())
        for _ in range(3)
    ]
    base = rng.uniform(-1.0, 1.0, (2, 3))
    a, b, c = rng.uniform(0.2, 0.6, 3)
    if rng.random() < 0.5:
        first = [("revolute", "z", (0, 0, 0), None)]
        rest = [
            ("revolute", "y", (float(rng.choice([0.0, a])), 0.0, 0.1), limits[0]),
            ("revolute", "-y" if rng.random() < 0.3 else "y", (b, 0, 0), limits[1]),
        ]
        if rng.random() < 0.4:
            rest[1] = ("prismatic", "x", (0, 0, 0), (0.1, 0.5))
    else:
        first = [("revolute", "z", (0, 0, 0), limits[0]), ("revolute", "z", (a, 0, 0), limits[1])]
        rest = [
            ("prismatic", "z", (b, 0, 0), (-0.2, 0.3)),
            ("revolute", "z", (0.1, 0, 0), limits[2]),
        ]
    return chain(*first, *rest, tool=(c, 0, 0), base=base)


def test_hunt_for_places_in_space_that_are_decided_wrongly(hunt: Hunt):
    """Places by the solid, by the inverse model, by distance, and by forward samples; the volume by
    counting.
    """
    rng = hunt.rng()
    kinds = set()
    for _ in range(hunt.cases(40, least=8)):
        system = random_chain(rng)
        solid = find_swept_solid(system, "tip")
        assert isinstance(solid, SweptSolid)
        kinds.add(solid.turned)
        low, high = solid.extent
        reached = system.fk(system.random(int(rng.integers(2**31)), 500), "tip")[:, :3, 3]
        assert (reached >= low - 1e-9).all() and (reached <= high + 1e-9).all()
        points = rng.uniform(low - 0.1, high + 0.1, (4000, 3))
        inside = solid.contains(points)
        far = solid.distance(points)
        clear = far > 1e-4
        assert (solid.contains(reached) | (solid.distance(reached) < 1e-6)).all()
        aside = (
            points[:400]
            + 0.999 * far[:400, None] * spatial.exp_so3(rng.normal(size=(400, 3)))[:, :, 0]
        )
        assert np.array_equal(solid.contains(aside)[clear[:400]], inside[:400][clear[:400]])
        some = np.flatnonzero(clear)[:40]
        found = system.ik(points[some], "tip", task="position").success
        assert np.array_equal(inside[some], found)
        box = float(np.prod(high - low + 0.2))
        share = inside.mean()
        assert solid.measure[0] == pytest.approx(
            box * share, abs=5.0 * box * math.sqrt(share * (1.0 - share) / 4000)
        )
    assert len(kinds) == 2
