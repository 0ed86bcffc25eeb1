"""Smallest distances in closed form, beside coal called by hand and beside what is known of special
places.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import kempe

coal = pytest.importorskip("coal")

PAIRS = [
    ("sphere", "sphere"),
    ("sphere", "capsule"),
    ("capsule", "capsule"),
    ("sphere", "box"),
    ("capsule", "box"),
]
MADE = {
    "sphere": lambda s: coal.Sphere(s["radius"]),
    "capsule": lambda s: coal.Capsule(s["radius"], s["length"]),
    "box": lambda s: coal.Box(*s["size"]),
    "cylinder": lambda s: coal.Cylinder(s["radius"], s["length"]),
}


def sizes(kind: str, rng: np.random.Generator) -> dict[str, Any]:
    """Random sizes of a shape; some capsules have hardly a length."""
    short = 1e-12 if rng.random() < 0.1 else 1.0
    given = {
        "sphere": {"radius": rng.uniform(0.02, 0.4)},
        "capsule": {
            "radius": rng.uniform(0.02, 0.4),
            "length": short * rng.uniform(0.05, 1.0),
        },
        "box": {"size": tuple(rng.uniform(0.05, 1.0, 3))},
        "cylinder": {"radius": rng.uniform(0.1, 0.3), "length": rng.uniform(0.1, 0.5)},
    }
    return {"kind": kind, **given[kind]}


def two(first: dict[str, Any], second: dict[str, Any]) -> kempe.System:
    """A free body with one shape, and an obstacle at the origin with the other one."""
    m = kempe.Mechanism("two")
    m.free("A", m.ground, m.body("a"))
    m.shape("a", **first)
    m.obstacle("b", **second)
    return m.build()


def by_hand(first: dict[str, Any], second: dict[str, Any], X: np.ndarray) -> float:
    """The distance of the first shape at X from the second one at the origin, by coal."""
    return coal.distance(
        MADE[first["kind"]](first),
        coal.Transform3s(X[:3, :3], X[:3, 3]),
        MADE[second["kind"]](second),
        coal.Transform3s.Identity(),
        coal.DistanceRequest(),
        coal.DistanceResult(),
    )


def places(rng: np.random.Generator, n: int) -> np.ndarray:
    """Configurations of a free body: far, near, at special places, and hardly turned."""
    q = np.zeros((n, 7))
    q[:, :3] = rng.normal(size=(n, 3)) * rng.choice([0.0, 1e-9, 0.05, 0.4, 1.0], (n, 1))
    q[:, :3] *= rng.random((n, 3)) < 0.8
    turns = rng.normal(size=(n, 4))
    turns[rng.random(n) < 0.2] = (1, 0, 0, 0)
    q[:, 3:] = np.where(rng.random((n, 1)) < 0.2, np.round(turns) + [[1e-9, 0, 0, 0]], turns)
    q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1)[:, None]
    return q


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_hunt_distances_and_depths_are_those_of_coal(pair, hunt):
    """Coal's own error is up to 4e-7 where capsules are nearly parallel."""
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        first, second = (sizes(kind, rng) for kind in pair)
        s = two(first, second)
        q = places(rng, 50)
        for d, X in zip(s.geometry.clearance(q), s.fk(q, "a"), strict=True):
            assert math.isclose(d, by_hand(first, second, X), abs_tol=1e-6), (first, second, X)


def measure_exactly(q: list[float], u: float, v: float) -> float:
    """The distance of a segment of half length u, at q of a free body, from one of half length v
    along z at the origin, with 40 digits: at one of the ends, or where the lines are nearest.
    """
    mp = pytest.importorskip("mpmath")
    with mp.workdps(40):
        w, x, y, z = (mp.mpf(c) for c in q[3:])
        scale = mp.mpf(u) / (w * w + x * x + y * y + z * z)
        a = [2 * (x * z + w * y) * scale, 2 * (y * z - w * x) * scale]
        a.append((w * w - x * x - y * y + z * z) * scale)
        b = [mp.mpf(0), mp.mpf(0), mp.mpf(v)]
        c = [-mp.mpf(t) for t in q[:3]]
        aa, ab, bb, ac, bc = (mp.fdot(*p) for p in ((a, a), (a, b), (b, b), (a, c), (b, c)))
        det = aa * bb - ab * ab
        found = [(e, (e * ab - bc) / bb) for e in (-1, 1)]
        found += [((e * ab + ac) / aa, e) for e in (-1, 1)]
        if det > 1e-30:
            found.append(((ac * bb - bc * ab) / det, (ac * ab - bc * aa) / det))
        clamped = [[max(-1, min(1, t)) for t in pair] for pair in found]
        return float(
            min(
                mp.sqrt(sum((z + t * y - s * x) ** 2 for x, y, z in zip(a, b, c, strict=True)))
                for s, t in clamped
            )
        )


def test_hunt_capsules_that_are_nearly_parallel(hunt):
    """Angles of 1e-12 to 0.1, with axes that nearly cross: all digits are right."""
    rng = hunt.rng()
    for _ in range(hunt.cases(20)):
        u, v = rng.uniform(0.1, 1.0, 2)
        s = two(
            {"kind": "capsule", "radius": 0.1, "length": 2 * u},
            {"kind": "capsule", "radius": 0.1, "length": 2 * v},
        )
        angle = 10.0 ** rng.uniform(-12, -1, 50)
        axis = rng.normal(size=(50, 3))
        q = np.zeros((50, 7))
        q[:, :3] = rng.normal(size=(50, 3))
        q[::2, :2] *= angle[::2, None]
        q[:, 3] = np.cos(angle)
        q[:, 4:] = np.sin(angle)[:, None] * axis / np.linalg.norm(axis, axis=1)[:, None]
        for d, x in zip(s.geometry.clearance(q), q.tolist(), strict=True):
            assert math.isclose(d, measure_exactly(x, u, v) - 0.2, abs_tol=1e-14)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_hunt_overlaps_end_by_a_shift_of_the_depth_and_by_no_shorter_one(pair, hunt):
    rng = hunt.rng()
    shifts = rng.normal(size=(400, 3))
    shifts /= np.linalg.norm(shifts, axis=1)[:, None]
    count, apart = hunt.cases(40), 0
    for _ in range(count):
        s = two(*(sizes(kind, rng) for kind in pair))
        q = places(rng, 1)
        q[0, :3] *= 0.1
        d = s.geometry.clearance(q[0])
        if d >= 0.0:
            apart += 1
            continue
        shifted = np.repeat(q, 400, axis=0)
        shifted[:, :3] += 0.999 * abs(d) * shifts
        assert (s.geometry.clearance(shifted) < 0.0).all(), "a shorter shift separates them"
        shifted[:, :3] = q[:, :3] + 1.3 * abs(d) * shifts
        assert s.geometry.clearance(shifted).max() > -0.1 * abs(d), "no shift of that length does"
    assert apart < count


def test_special_places_are_exact():
    ball, rod, slab = (
        {"kind": "sphere", "radius": 0.25},
        {"kind": "capsule", "radius": 0.125, "length": 1.0},
        {"kind": "box", "size": (2.0, 4.0, 1.0)},
    )
    at = np.array([1.0, 0.0, 0.0, 0.0])
    quarter = np.array([math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0])  # z becomes -y
    for first, second, place, turn, distance in (
        (ball, ball, (0.5, 0.0, 0.0), at, 0.0),
        (ball, ball, (0.0, 0.0, 0.0), at, -0.5),
        (ball, rod, (0.375, 0.0, 0.5), at, 0.0),
        (ball, rod, (0.0, 0.0, 0.875), at, 0.0),
        (ball, rod, (0.0, 0.0, 0.25), at, -0.375),
        (rod, rod, (0.0, 0.0, 0.0), at, -0.25),
        (rod, rod, (0.0, 0.0, 1.25), at, 0.0),
        (rod, rod, (0.5, 0.0, 0.0), quarter, 0.25),
        (rod, rod, (0.0, 0.0, 0.0), quarter, -0.25),
        (ball, slab, (0.0, 0.0, 0.0), at, -0.75),
        (ball, slab, (1.25, 0.0, 0.0), at, 0.0),
        (ball, slab, (1.3, 2.4, 0.0), at, 0.25),
        (ball, slab, (0.9, 0.0, 0.0), at, -0.35),
        (rod, slab, (0.0, 0.0, 0.0), at, -1.125),
        (rod, slab, (0.0, 0.0, 0.0), quarter, -0.625),
        (rod, slab, (0.0, 0.0, 1.25), at, 0.125),
        (rod, slab, (1.3, 2.9, 0.0), quarter, 0.375),
    ):
        q = np.concatenate([place, turn])
        assert math.isclose(two(first, second).geometry.clearance(q), distance, abs_tol=1e-15)


def make_workshop(rng: np.random.Generator) -> kempe.System:
    """Balls, rods, plates and cylinders on a tree of joints, and obstacles of all kinds."""
    m = kempe.Mechanism("workshop")
    names = [m.ground]
    for k in range(5):
        body = m.body(f"b{k}")
        add = (m.revolute, m.prismatic, m.spherical)[rng.integers(3)]
        axis = {} if add == m.spherical else {"axis": tuple(rng.normal(size=3))}
        at = tuple(rng.normal(size=3))
        add(f"j{k}", names[rng.integers(len(names))], body, at=at, **axis)
        names.append(body)
        for _ in range(2):
            shape = sizes(str(rng.choice(list(MADE))), rng)
            m.shape(
                body, **shape, at=tuple(0.3 * rng.normal(size=3)), rpy=tuple(rng.normal(size=3))
            )
    for kind in MADE:
        rpy = tuple(rng.normal(size=3))
        m.obstacle(kind, **sizes(kind, rng), at=tuple(rng.normal(size=3)), rpy=rpy)
    return m.build()


def test_hunt_the_smallest_is_that_of_all_pairs_measured_by_coal(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        s = make_workshop(rng)
        q = s.random(rng, 20)
        d = s.geometry.clearance(q)
        for x, found in zip(q, d, strict=True):
            nearest = s.geometry.nearest(x)
            assert math.isclose(found, nearest.distance[0], abs_tol=1e-5), nearest.pairs[0]
        a, b = s.geometry.pairs[0]
        alone = s.geometry.clearance(q, [(b, a)])
        assert (alone >= d - 1e-5).all()


@pytest.mark.parametrize("n", [1, 7, 8, 9, 6001])
def test_no_answer_depends_on_the_rows_beside_it(n):
    rng = np.random.default_rng(n)
    m = kempe.Mechanism("arm")
    last = m.ground
    for k in range(4):
        m.spherical(f"j{k}", last, m.body(f"b{k}"), at=(0, 0, 0.4))
        m.shape(f"b{k}", **sizes(("sphere", "capsule")[k % 2], rng), at=(0, 0.1, 0.2))
        last = f"b{k}"
    m.obstacle("table", "box", size=(1, 1, 0.1))
    s = m.build()
    q = s.random(rng, n)
    d = s.geometry.clearance(q)
    assert d.shape == (n,)
    some = rng.permutation(n)[:20]
    assert [s.geometry.clearance(x) for x in q[some]] == d[some].tolist()
    q[n // 2, -1] = np.nan
    spoiled = s.geometry.clearance(q)
    assert math.isnan(spoiled[n // 2])
    np.testing.assert_array_equal(np.delete(spoiled, n // 2), np.delete(d, n // 2))
    assert s.geometry.clearance(np.zeros((0, s.nq))).shape == (0,)
