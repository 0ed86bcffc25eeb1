"""The space of configurations: names, limits, random points, ways and distances, its shape in
words.
"""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
import pytest
from graphs import Graph, graphs
from hunts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from kempe import Mechanism, System, spatial
from kempe.errors import InputError, UnknownNameError
from kempe.model.configurations import find_free_angles


def system(**joints) -> System:
    """A chain of joints by name: kind, or (kind, keywords)."""
    m = Mechanism("chain")
    here = m.ground
    for name, what in joints.items():
        kind, keywords = (what, {}) if isinstance(what, str) else what
        body = m.body(f"{name} body")
        m.joint(name, kind, here, body, **keywords)
        here = body
    return m.build()


# ------------------------------------------------------------------ names


def test_array_and_dict():
    s = system(turn="revolute", ball="spherical", block="planar")
    names = ("turn", "ball.qw", "ball.qx", "ball.qy", "ball.qz", "block.x", "block.y", "block.rz")
    assert s.coordinate_names == names
    assert s.structure.velocity_names == (
        "turn",
        "ball.wx",
        "ball.wy",
        "ball.wz",
        "block.x",
        "block.y",
        "block.rz",
    )
    q = s.q({"block.y": 0.5, "turn": -1})
    np.testing.assert_array_equal(q, [-1, 1, 0, 0, 0, 0, 0.5, 0])
    assert s.q_dict(q) == dict(zip(names, q.tolist(), strict=True))
    np.testing.assert_array_equal(s.q(s.q_dict(q)), q)
    np.testing.assert_array_equal(s.q({}), s.neutral)
    np.testing.assert_array_equal(s.q({"turn": 2}, base=q), [2, 1, 0, 0, 0, 0, 0.5, 0])
    np.testing.assert_array_equal(s.q(MappingProxyType({"turn": np.float32(2)})), s.q({"turn": 2}))


def test_a_batch_as_base():
    s = system(a="revolute", b="revolute", c="revolute")
    base = s.random(0, (4, 2))
    q = s.q({"b": 0.5}, base=base)
    assert q.shape == (4, 2, 3) and np.all(q[..., 1] == 0.5)
    np.testing.assert_array_equal(q[..., [0, 2]], base[..., [0, 2]])


def test_one_source_of_names():
    s = system(shoulder="spherical", elbow="revolute")
    with pytest.raises(
        UnknownNameError, match="chain has no coordinate 'elbo'; did you mean 'elbow'"
    ) as error:
        s.q({"elbo": 1.0})
    assert error.value.allowed == s.coordinate_names
    with pytest.raises(
        UnknownNameError, match="chain has no coordinate 'shoulder'; did you mean 'shoulder.q"
    ):
        s.q({"shoulder": 1.0})
    for bad in ("x", None, object()):
        with pytest.raises(InputError, match="coordinate 'elbow' is .*; it must be a number"):
            s.q({"elbow": bad})  # type: ignore[dict-item]
    with pytest.raises(InputError, match="q has 3 coordinates; chain needs 5"):
        s.q_dict(np.zeros(3))
    with pytest.raises(InputError, match="q has 3 coordinates; chain needs 5: shoulder.qw"):
        s.q({}, base=np.zeros(3))


@pytest.mark.parametrize(
    ("v", "words"),
    [
        (np.zeros(5), "v has 5 coordinates; chain has 4 velocity coordinates"),
        (1.0, "v has a single number; chain has 4"),
        ("fast", "v is 'fast'; it must be an array"),
        (
            [[0] * 4, [0] * 3],
            "v is ragged: row 1 has 3 numbers, row 0 has 4 numbers; it must be an array",
        ),
    ],
)
def test_bad_tangents(v, words):
    s = system(shoulder="spherical", elbow="revolute")
    with pytest.raises(InputError, match=words):
        s.configuration_space.integrate(s.neutral, v)


def test_bad_ends():
    s = system(shoulder="spherical", elbow="revolute")
    for call in (
        s.configuration_space.difference,
        s.configuration_space.distance,
        lambda a, b: s.configuration_space.interpolate(a, b, 0.5),
    ):
        for a, b in ((s.neutral, np.zeros(4)), (np.zeros(4), s.neutral)):
            with pytest.raises(InputError, match="q has 4 coordinates; chain needs 5"):
                call(a, b)
        assert np.isfinite(call({"elbow": 1.0}, s.neutral)).all()


# ------------------------------------------------------------------ random points


@given(graph=graphs(), seed=st.integers(0, 10**6))
def test_random_is_the_same_by_name_in_every_order(graph: Graph, seed):
    one = graph.mechanism().build()
    other = graph.shuffled(seed).mechanism().build()
    for shape in ((), 4, (2, 3)):
        a = one.random(seed, shape)
        b = other.random(seed, shape)
        for name in one.coordinate_names:
            np.testing.assert_array_equal(
                a[..., one.coordinate_names.index(name)], b[..., other.coordinate_names.index(name)]
            )


def test_random_inside_limits():
    top = 1.7e308
    s = system(
        both=("revolute", {"limits": (0.5, 0.75)}),
        low=("revolute", {"limits": (1.0, np.inf)}),
        high=("prismatic", {"limits": (-np.inf, -3.0)}),
        none="revolute",
        length="prismatic",
        point=("revolute", {"limits": (0.1, 0.1)}),
        huge=("prismatic", {"limits": (-top, top)}),
    )
    q = s.random(0, 2000)
    assert np.isfinite(q).all() and np.all(q >= s.lower) and np.all(q <= s.upper)
    bounds = {
        "both": (0.5, 0.75),
        "low": (1, 1 + 2 * np.pi),
        "high": (-5, -3),
        "none": (-np.pi, np.pi),
        "length": (-1, 1),
    }
    for name, (low, high) in bounds.items():
        x = np.sort(q[:, s.coordinate_names.index(name)])
        assert low <= x[0] and x[-1] <= high
        steps = np.abs((x - low) / (high - low) - np.linspace(0, 1, 2000))
        assert steps.max() < 1.63 / np.sqrt(2000), "uniform (Kolmogorov, 1 %)"
    assert np.all(q[:, s.coordinate_names.index("point")] == 0.1)


def test_random_rotations_are_uniform():
    s = system(ball="spherical")
    q = s.random(1, 4000)
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1, atol=1e-14)
    np.testing.assert_allclose(q.T @ q / 4000, np.eye(4) / 4, atol=0.02)


def test_random_takes_every_kind_of_seed():
    s = system(a="revolute", b="spherical")
    np.testing.assert_array_equal(s.random(5), s.random(np.random.default_rng(5)))
    assert (
        s.random().shape == (5,)
        and s.random(0, np.int64(3)).shape == (3, 5)
        and s.random(0, 0).shape == (0, 5)
    )
    assert s.random(0, (2, 0)).shape == (2, 0, 5) and s.random(0, [2, 3]).shape == (2, 3, 5)
    rng = np.random.default_rng(0)
    assert not np.array_equal(s.random(rng), s.random(rng))


def test_mid_is_inside():
    top = 1.7e308
    s = system(
        both=("revolute", {"limits": (0.5, 0.75)}),
        low=("revolute", {"limits": (1.0, np.inf)}),
        high=("prismatic", {"limits": (-np.inf, -3.0)}),
        none="revolute",
        ball="spherical",
        huge=("prismatic", {"limits": (0.9 * top, top)}),
        wide=("prismatic", {"limits": (-top, top)}),
    )
    np.testing.assert_allclose(s.mid, [0.625, 1.0, -3.0, 0.0, 1, 0, 0, 0, 0.95 * top, 0.0])


# ------------------------------------------------------------------ ways and distances


def test_unlimited_turns_go_the_short_way():
    s = system(a="revolute", b=("revolute", {"limits": (-4, 4)}), c="prismatic")
    q0 = np.array([3.0, 3.0, 3.0])
    q1 = np.array([-3.0, -3.0, -3.0])
    short = 2 * np.pi - 6
    assert s.configuration_space.distance(q0, q1) == pytest.approx(np.sqrt(short**2 + 36 + 36))
    half = s.configuration_space.interpolate(q0, q1, 0.5)
    np.testing.assert_allclose(half, [3 + short / 2, 0, 0], atol=1e-14)
    np.testing.assert_allclose(
        s.configuration_space.interpolate(q0, q1, [0, 1])[1] - q1, [2 * np.pi, 0, 0], atol=1e-14
    )
    np.testing.assert_array_equal(s.configuration_space.interpolate(q0, q1, 0.0), q0)
    assert s.configuration_space.difference(q0, q1)[0] == pytest.approx(short), (
        "as the way and the distance"
    )
    far = np.array([1e6 * 2 * np.pi, 0, 0])
    assert s.configuration_space.distance(np.zeros(3), far) == pytest.approx(0.0, abs=1e-8)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=examples(25))
def test_ways_on_balls_are_great_circles(seed):
    s = system(ball="free", turn="revolute")
    rng = np.random.default_rng(seed)
    q0 = s.random(rng)
    q1 = s.random(rng)
    t = np.linspace(0, 1, 7)
    way = s.configuration_space.interpolate(q0, q1, t)
    assert way.shape == (7, s.nq)
    poses = s.fk(way, "turn body")
    ends = s.fk(np.array([q0, q1]), "turn body")
    np.testing.assert_allclose(poses[[0, -1]], ends, rtol=0, atol=1e-13)
    whole = s.configuration_space.distance(q0, q1)
    np.testing.assert_allclose(
        [s.configuration_space.distance(q0, x) for x in way], t * whole, rtol=0, atol=1e-7
    )
    np.testing.assert_allclose(
        [s.configuration_space.distance(a, b) for a, b in zip(way, way[1:], strict=False)],
        whole / 6,
        atol=1e-7,
    )
    assert s.configuration_space.distance(q0, q1) == pytest.approx(
        s.configuration_space.distance(q1, q0)
    )
    flipped = q1.copy()
    flipped[3:7] *= -1
    assert s.configuration_space.distance(q0, flipped) == pytest.approx(whole), (
        "q and -q are one rotation"
    )


def test_distance_is_a_metric():
    s = system(ball="spherical", turn="revolute", slide="prismatic")
    q = s.random(0, (200, 3))
    ab = s.configuration_space.distance(q[:, 0], q[:, 1])
    bc = s.configuration_space.distance(q[:, 1], q[:, 2])
    ac = s.configuration_space.distance(q[:, 0], q[:, 2])
    assert (
        np.all(ab >= 0)
        and np.all(ac <= ab + bc + 1e-12)
        and np.all(s.configuration_space.distance(q, q) < 1e-7)
    )


def test_ways_broadcast():
    s = system(ball="spherical", turn="revolute")
    q0 = s.random(0)
    q1 = s.random(1, (4, 1))
    assert s.configuration_space.interpolate(q0, q1, np.linspace(0, 1, 3)).shape == (4, 3, 5)
    assert s.configuration_space.distance(q0, q1).shape == (
        4,
        1,
    ) and s.configuration_space.difference(q0, q1).shape == (4, 1, 4)
    assert s.configuration_space.integrate(q0, np.zeros((2, 0, 4))).shape == (2, 0, 5)
    assert s.configuration_space.interpolate(s.random(0, 0), q0, 0.5).shape == (0, 5)


def geared(kind: str, ratio: float, cut: bool = False) -> np.ndarray:
    """Whether a revolute joint 'a', which drives another by a ratio, and a free one are circles."""
    m = Mechanism()
    m.revolute("a", m.ground, m.body("A"))
    m.joint("b", kind, "A", m.body("B"), **({"pitch": 0.5} if kind == "helical" else {}))
    m.revolute("c", m.ground, m.body("C"))
    if cut:
        m.fixed("d", "C", m.body("D"))
        m.joint("e", kind, "D", "B", cut=True, **({"pitch": 0.5} if kind == "helical" else {}))
        m.gear("e", "a", ratio)
    else:
        m.gear("b", "a", ratio)
    s = m.build()
    assert s.structure.closures == (("e",) if cut else ())
    return dict(zip(s.structure.velocity_names, find_free_angles(s).tolist(), strict=True))


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize(
    ("kind", "ratio", "whole"),
    [
        ("revolute", 2.0, True),
        ("revolute", -1.0, True),
        ("revolute", 0.5, False),
        ("prismatic", 1.0, False),
        ("prismatic", 0.3, False),
        ("helical", 2.0, False),
    ],
)
def test_a_full_turn_must_bring_back_all_that_follows(kind, ratio, whole, cut):
    found = geared(kind, ratio, cut)
    assert found["a"] == whole and found["c"]
    if cut and kind == "revolute":
        assert found["b"]


def test_relations_and_limits_end_circles():
    m = Mechanism()
    for name in "abcd":
        m.revolute(name, m.ground, m.body(name.upper()), limits=(-9, 9) if name == "d" else None)
    m.couple("c", {"a": 0.5, "b": 0.5})
    np.testing.assert_array_equal(find_free_angles(m.build()), [False, False, False, False])
    np.testing.assert_array_equal(
        find_free_angles(system(a="helical", b="universal", c="spherical")),
        [False, True, True] + [False] * 3,
    )


# ------------------------------------------------------------------ the shape in words


@pytest.mark.parametrize(
    ("joints", "shape", "dim"),
    [
        (("revolute", "revolute", "prismatic"), "T^2 x R", 3),
        (("spherical", *["revolute"] * 4), "SO(3) x T^4", 7),
        (("revolute",), "T", 1),
        (("prismatic",), "R", 1),
        ((), "a point", 0),
        (("fixed",), "a point", 0),
        (("cylindrical",), "T x R", 2),
        (("universal",), "T^2", 2),
        (("planar",), "T x R^2", 3),
        (("helical",), "R", 1),
        (("spherical",), "SO(3)", 3),
        (("spherical", "spherical"), "SO(3)^2", 6),
        (("free",), "R^3 x SO(3)", 6),
        (("translation",), "R^3", 3),
        (("free", "revolute"), "SO(3) x T x R^3", 7),
    ],
)
def test_configuration_spaces(joints, shape, dim):
    space = system(**{f"j{i}": kind for i, kind in enumerate(joints)}).configuration_space
    assert (space.shape, space.dimension, space.constraints, space.limited) == (shape, dim, 0, 0)
    assert space.ambient_dimension == dim and space.certain
    assert str(space) == f"{shape}, dimension {dim}"


def test_angles_instead_of_quaternions():
    assert system(j=("spherical", {"angles": True})).configuration_space.shape == "T^3"
    assert system(j=("free", {"angles": True})).configuration_space.shape == "T^3 x R^3"


def test_limits_and_constraints_are_counted():
    m = Mechanism("four-bar", dim=2)
    for name in ("crank", "coupler", "rocker"):
        m.body(name)
    (
        m.revolute("A", m.ground, "crank", limits=(-1, 1)),
        m.revolute("B", "crank", "coupler", at=(1, 0)),
    )
    (
        m.revolute("C", "coupler", "rocker", at=(2, 0), child_at=(1, 0)),
        m.revolute("D", m.ground, "rocker", at=(2, 0)),
    )
    space = m.build().configuration_space
    assert (space.dimension, space.certain, space.ambient_dimension) == (1, True, 4)
    assert (space.shape, space.ambient.shape, space.limited, space.constraints) == (
        "a subset of T^4",
        "T^4",
        1,
        3,
    )
    assert str(space) == (
        "dimension 1: the subset of T^4, dimension 4, 1 of them within limits, that satisfies 3 "
        "constraint equations"
    )
    m = Mechanism()
    for name in "abc":
        m.revolute(name, m.ground, m.body(name.upper()))
    m.couple("c", {"a": 1.0, "b": 1.0})
    assert m.build().configuration_space.constraints == 1


def test_planar_systems():
    m = Mechanism(dim=2)
    m.free("f", m.ground, m.body("b")), m.free("g", m.ground, m.particle("p"))
    s = m.build()
    assert (
        s.coordinate_names == ("f.x", "f.y", "f.rz", "g.x", "g.y")
        and s.configuration_space.shape == "T x R^4"
    )


@pytest.mark.parametrize(
    "call",
    [
        lambda s: s.random(0, -1),
        lambda s: s.random(0, 2.5),
        lambda s: s.random("x"),
        lambda s: s.random(-1),
        lambda s: s.random(0, (2, "a")),
        lambda s: s.q(None),
    ],
)
def test_odd_arguments_are_refused(call):
    m = Mechanism("arm")
    m.revolute("j", m.ground, m.body("b"))
    with pytest.raises(InputError, match="must be"):
        call(m.build())


@given(st.integers(0, 10**6))
@settings(max_examples=examples(60), deadline=None)
def test_the_difference_is_the_way_whose_length_is_the_distance(seed):
    """Of continuous joints by at most half a turn, of limited ones as the coordinates say, whatever
    the turns of q.
    """
    rng = np.random.default_rng(seed)
    s = system(a="revolute", b=("revolute", {"limits": (-9.0, 9.0)}), c="prismatic", d="revolute")
    space = s.configuration_space
    turns = np.array([2.0 * np.pi, 0.0, 0.0, 2.0 * np.pi])
    q0, q1 = rng.uniform(-9.0, 9.0, (2, 5, 4))
    v = space.difference(q0, q1)
    np.testing.assert_allclose(np.linalg.norm(v, axis=-1), space.distance(q0, q1), atol=1e-12)
    np.testing.assert_allclose(
        space.interpolate(q0, q1, np.ones(5)), space.integrate(q0, v), atol=1e-12
    )
    assert (np.abs(v[:, [0, 3]]) <= np.pi + 1e-12).all()
    np.testing.assert_allclose(v[:, 1:3], (q1 - q0)[:, 1:3], atol=1e-12)
    off = space.integrate(q0, v) - q1
    np.testing.assert_allclose(off, turns * np.round(off / (2.0 * np.pi)), atol=1e-12)
    wound = q1 + turns * rng.integers(-3, 4, (5, 4))
    np.testing.assert_allclose(space.difference(q0, wound), v, atol=1e-11)


@pytest.mark.parametrize("shape", [(), (7,), (0,), (3, 1)])
def test_steps_and_differences_are_those_of_quaternions(shape):
    """Steps of angles add, balls turn in their own axes: by the functions of `spatial`."""
    s = system(turn="revolute", ball="spherical", block="planar", free="free")
    layout = s.structure.layout
    rng = np.random.default_rng(2)
    q = rng.normal(size=(*shape, s.nq))
    v = 2.0 * rng.normal(size=(*shape, s.nv))
    there = layout.integrate_velocity(q, v)
    away = layout.compute_difference(q, there)
    np.testing.assert_allclose(
        there[..., layout.vector_q], q[..., layout.vector_q] + v[..., layout.vector_v]
    )
    for i, k in zip(layout.quaternion_q, layout.quaternion_v, strict=True):
        turned = spatial.quat_wxyz_multiply(
            spatial.unit(q[..., i : i + 4]), spatial.quat_wxyz_exp(v[..., k : k + 3])
        )
        np.testing.assert_allclose(there[..., i : i + 4], turned, atol=1e-15)
        back = spatial.quat_wxyz_exp(away[..., k : k + 3])
        same = spatial.quat_wxyz_multiply(spatial.unit(q[..., i : i + 4]), back)
        sign = np.sign(np.sum(same * turned, axis=-1, keepdims=True))
        np.testing.assert_allclose(sign * same, turned, atol=1e-14)
        assert (np.linalg.norm(away[..., k : k + 3], axis=-1) <= np.pi + 1e-12).all()
    one = layout.integrate_velocity(q, v[(0,) * len(shape)]) if 0 not in shape else q
    assert one.shape == q.shape
