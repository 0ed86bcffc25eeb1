"""Bounds by lengths and limits: no configuration lies outside of them, and where a closed form is
known they are sharp.

Places are judged by `fk`, which shares nothing with the bounds but the primitive table.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from closed_graphs import random_closed

from kempe import Mechanism, System, spatial
from kempe.numerics.length_bounds import (
    GROUND,
    compute_distance_bounds,
    compute_place_bounds,
    compute_reach_bounds,
    find_unclosable_loop,
    measure_bound_excess,
)

CONFIGURATIONS = 1000
NONE = 1e-9
"""What rounding may make of distances, in parts of 1 m and of the bound."""


def add_chain(m: Mechanism, rng: np.random.Generator, name: str, body: str, joints: int) -> str:
    """Add random joints from a body on, most of them with limits, and return the last body.

    Some follow the first joint of the chain.
    """
    simple = ("revolute", "prismatic")
    others = ("cylindrical", "universal", "spherical", "helical") if m.dim == 3 else simple
    for k in range(joints):
        joint = f"{name}{k}"
        kind = str(rng.choice(simple if rng.random() < 0.7 else others))
        low = rng.uniform(-2.0, 1.0)
        more = {} if m.dim == 2 else {"rpy": rng.uniform(-3.0, 3.0, 3)}
        follows = k > 0 and kind in simple and rng.random() < 0.15 and f"{name}0" in m.joints
        if m.dim == 2 and kind == "prismatic":
            more["axis"] = rng.normal(size=2)
        if kind == "helical":
            more |= {"pitch": 0.2}
        if kind in (*simple, "helical") and not follows and rng.random() < 0.9:
            more |= {"limits": (low, low + rng.uniform(0.0, 4.0))}
        at = rng.normal(size=m.dim) * (rng.random() < 0.8)
        m.joint(joint, kind, body, m.body(f"{name} body {k}"), at=at, **more)
        if follows and m.joints[f"{name}0"].type.type_name in simple:
            m.gear(joint, f"{name}0", float(rng.normal()), 0.3)
        body = f"{name} body {k}"
    return body


def random_tree(rng: np.random.Generator) -> System:
    """Two arms on a trunk, or on the ground, in the plane or in space, and frames at their ends."""
    m = Mechanism("tree", dim=int(rng.integers(2, 4)))
    trunk = add_chain(m, rng, "trunk", "ground", int(rng.integers(0, 4)))
    for name in ("a", "b"):
        body = add_chain(m, rng, name, trunk, int(rng.integers(1, 7)))
        turn = {} if m.dim == 2 else {"rpy": rng.uniform(-3.0, 3.0, 3)}
        m.frame(f"tip {name}", body, at=rng.normal(size=m.dim), **turn)
    return m.build()


def test_no_configuration_is_outside_the_bounds(hunt):
    """Of frames seen from the ground, and from each other with tools."""
    rng = hunt.rng()
    for _ in range(hunt.cases(60)):
        s = random_tree(rng)
        tool = spatial.pose_from_xyz_rpy(rng.normal(size=6) * (s.dim == 3))
        q = s.random(rng, CONFIGURATIONS)
        row, X, _ = s.structure.table.at["tip b"]
        tip = (row, X @ tool, False)
        X_GT = s.fk(q, "tip b") @ tool
        for base, X_GB in ((GROUND, np.eye(4)), (s.structure.table.at["tip a"], s.fk(q, "tip a"))):
            X_BT = spatial.inverse(X_GB) @ X_GT
            bounds, _ = compute_reach_bounds(s, tip, base)
            for centre, largest, smallest, point in bounds:
                far = np.linalg.norm(X_BT[:, :3, 3] + X_BT[:, :3, :3] @ point - centre, axis=-1)
                slack = NONE * (1.0 + largest)
                assert smallest - slack <= far.min() and far.max() <= largest + slack
            assert not measure_bound_excess(bounds, X_BT, (1e-9, 1e-9), dim=s.dim).any()
            smallest, largest = compute_distance_bounds(s, tip, base)
            far = np.linalg.norm(X_BT[:, :3, 3], axis=-1)
            slack = NONE * (1.0 + far.max())
            assert smallest - slack <= far.min() and far.max() <= largest + slack
            box, _, slack = compute_place_bounds(s, tip, base)
            assert (X_BT[:, :3, 3] >= box[0] - slack).all()
            assert (X_BT[:, :3, 3] <= box[1] + slack).all()


def two_links(limits: tuple[float, float] | None = None) -> System:
    m = Mechanism("two links", dim=2)
    m.revolute("A", m.ground, m.body("upper"), at=(0.1, 0.2), limits=limits)
    m.revolute("B", "upper", m.body("lower"), at=(0.5, 0.0))
    m.frame("tip", "lower", at=(0.3, 0.0))
    return m.build()


def test_two_links_reach_an_annulus_about_their_first_joint():
    s = two_links()
    (tip, elbow, *_), freedoms = compute_reach_bounds(s, s.structure.table.at["tip"])
    assert freedoms == 2
    assert tip.centre == pytest.approx([0.1, 0.2, 0.0])
    assert (tip.smallest, tip.largest) == pytest.approx((0.2, 0.8))
    assert elbow.point == pytest.approx([-0.3, 0.0, 0.0])  # the elbow lies on a circle
    assert (elbow.smallest, elbow.largest) == pytest.approx((0.5, 0.5))


def test_points_of_two_links_are_an_elbow_apart():
    """The triangle inequality, from the middle of one link to the end of the other."""
    s = two_links()
    row, X, _ = s.structure.table.at["upper"]
    middle = (row, X @ spatial.pose(p=[0.25, 0.0, 0.0]), False)
    assert compute_distance_bounds(s, s.structure.table.at["tip"], middle) == pytest.approx(
        (0.05, 0.55)
    )
    assert compute_distance_bounds(s, middle, s.structure.table.at["tip"]) == pytest.approx(
        (0.05, 0.55)
    )


def test_a_limited_turn_and_a_slide_fill_their_box():
    """A quarter turn of a telescope, whose box is that of a sector of an annulus."""
    m = Mechanism("telescope", dim=2)
    m.revolute("turn", m.ground, m.body("arm"), limits=(-0.25 * math.pi, 0.25 * math.pi))
    m.prismatic("slide", "arm", m.body("rod"), axis="x", limits=(0.5, 1.5))
    m.frame("tip", "rod", at=(0.1, 0.0))
    s = m.build()
    box, _, slack = compute_place_bounds(s, s.structure.table.at["tip"])
    half = math.sqrt(0.5)
    assert box[:, 0] == pytest.approx([0.6 * half, 1.6]) and slack < 1e-8
    assert box[:, 1] == pytest.approx([-1.6 * half, 1.6 * half])


def test_a_rail_without_end_leaves_a_strip():
    """Along the rail there is no bound, across it the length of the arm."""
    m = Mechanism("rail", dim=2)
    m.prismatic("rail", m.ground, m.body("cart"), axis="x")
    m.revolute("turn", "cart", m.body("arm"))
    m.frame("tip", "arm", at=(0.3, 0.0))
    s = m.build()
    box, shells, _ = compute_place_bounds(s, s.structure.table.at["tip"])
    assert np.isinf(box[:, 0]).all() and box[:, 1] == pytest.approx([-0.3, 0.3])
    assert shells == ()


# ---- loops that lengths leave open


def test_hunt_no_loop_is_called_open_that_closes(hunt):
    """Random loops of all joint types, which close, also with known values and limits there."""
    rng = hunt.rng()
    held = 0
    for _ in range(hunt.cases(1000)):
        s = random_closed(rng).system()
        answer = s.assemble()
        if not answer.success:
            continue
        q = dict(zip(s.coordinate_names, answer.q, strict=True))
        turned = [n for n in q if n in s.structure.velocity_names]
        known = {n: q[n] for n in turned if rng.random() < 0.5}
        held += len(known)
        assert find_unclosable_loop(s, {}) is None and find_unclosable_loop(s, known) is None
    assert held > 0


def make_polygon(sides: np.ndarray) -> System:
    """A closed chain of bars with these lengths, in the plane; joint 0 turns the first bar."""
    m = Mechanism("polygon", dim=2)
    bars = [m.ground, *(m.body(f"bar {k}") for k in range(1, len(sides)))]
    for k, side in enumerate(sides[:-1]):
        m.revolute(f"{k}", bars[k], bars[k + 1], at=(side if k else 0.0, 0.0))
    m.revolute("last", bars[-1], m.ground, at=(sides[-1], 0.0), child_at=(sides[0], 0.0))
    return m.build()


def test_hunt_polygons_close_unless_one_side_is_longer_than_the_others_together(hunt):
    """Euclid, Elements I.20 and I.22, for any number of sides; so with the first angle known, where
    ground and first bar are one side.
    """
    rng = hunt.rng()
    seen = set[tuple[bool, bool]]()
    for _ in range(hunt.cases(1000)):
        sides = rng.uniform(0.1, 1.0, int(rng.integers(4, 8))) ** 2
        s = make_polygon(sides)
        angle = float(rng.uniform(-3.0, 3.0))
        joined = float(np.hypot(sides[0] - sides[1] * np.cos(angle), sides[1] * np.sin(angle)))
        for known, those in (({}, sides), ({"0": angle}, np.array([joined, *sides[2:]]))):
            gap = find_unclosable_loop(s, known)
            longest = float(those.max())
            others = float(those.sum()) - longest
            assert (gap is not None) == (longest > others)
            seen.add((bool(known), gap is not None))
            if gap is not None:
                assert np.allclose(gap[1:], (longest, others), rtol=1e-12)
                assert gap.joint in s.structure.closures
                answer = s.assemble(known)
                assert "cannot be closed" in answer.status and not answer.success
                assert f"{longest - others:.6g} m more than" in answer.status
                modes = s.assembly_modes(known)
                assert modes.complete and not len(modes)
    assert len(seen) == 4


def test_slides_lengthen_a_loop_as_far_as_their_limits():
    """A slider crank whose rod is too short for where the rail begins."""

    def make(low: float) -> System:
        m = Mechanism("slider crank", dim=2)
        crank, rod, block = (m.body(n) for n in ("crank", "rod", "block"))
        m.revolute("A", m.ground, crank)
        m.revolute("B", crank, rod, at=(0.1, 0.0))
        m.prismatic("slide", m.ground, block, at=(low, 0.0), axis=(1.0, 0.0), limits=(0.0, 0.05))
        m.revolute("C", rod, block, at=(0.3, 0.0))
        return m.build()

    assert find_unclosable_loop(make(0.39), {}) is None and make(0.39).assemble().success
    gap = find_unclosable_loop(make(0.5), {})
    assert gap is not None and gap[1:] == pytest.approx((0.5, 0.45))
    assert find_unclosable_loop(make(0.5), {}, limits=False) is None
    assert find_unclosable_loop(make(0.5), {"slide": 0.05})[1:] == pytest.approx((0.55, 0.4))
