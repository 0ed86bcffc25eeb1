"""Which coordinates make up q, their order and limits, and the rows of the table that they drive."""

from __future__ import annotations

import numpy as np
import pytest
import reference
from graphs import Graph, graphs
from hunts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from kempe import Mechanism
from kempe.equations.judge import compute_coordinate_value
from kempe.errors import DescriptionError, KempeError
from kempe.joints import P, Q, R, make_joint_type
from kempe.kernels.compiled import table_sweep
from kempe.model.coordinates import Follower, format_relation


@given(graph=graphs(loops=4))
@settings(max_examples=examples(80))
def test_q_holds_all_coordinates_in_the_order_of_the_joints(graph: Graph):
    """Those of cut joints too; not those that follow or are locked."""
    s = graph.mechanism().build()
    gone = {of for of, *_ in graph.gears} | {name for name, _ in graph.locks}
    names = []
    velocities = []
    for e in graph.edges:
        kind = make_joint_type(e.kind, **e.options)
        particle = e.child in graph.particles
        for c in kind.list_coordinate_names(graph.dim, particle):
            names += [n for n in [f"{e.name}.{c}" if c else e.name] if n not in gone]
        for c in kind.list_velocity_names(graph.dim, particle):
            velocities += [n for n in [f"{e.name}.{c}" if c else e.name] if n not in gone]
    assert s.coordinate_names == tuple(names) and s.structure.velocity_names == tuple(velocities)
    assert (s.nq, s.nv) == (len(names), len(velocities)) == (len(s.neutral), len(s.lower))


@given(graph=graphs())
@settings(max_examples=examples(80))
def test_the_layout_uses_every_entry_once(graph: Graph):
    s = graph.mechanism().build()
    lay = s.structure.layout
    in_q = [*lay.vector_q, *(lay.quaternion_q[:, None] + np.arange(4)).ravel()]
    in_v = [*lay.vector_v, *(lay.quaternion_v[:, None] + np.arange(3)).ravel()]
    assert sorted(in_q) == list(range(s.nq)) and sorted(in_v) == list(range(s.nv))
    for iq, iv in zip(lay.vector_q, lay.vector_v, strict=True):
        assert s.coordinate_names[iq] == s.structure.velocity_names[iv]
    for iq, iv in zip(lay.quaternion_q, lay.quaternion_v, strict=True):
        assert s.coordinate_names[iq].removesuffix("qw") == s.structure.velocity_names[
            iv
        ].removesuffix("wx")
        np.testing.assert_array_equal(s.neutral[iq : iq + 4], [1, 0, 0, 0])


@given(graph=graphs(), seed=st.integers(0, 10**6))
def test_any_coordinate_has_a_value(graph: Graph, seed):
    s = graph.mechanism().build()
    q = s.random(seed, (2, 3))
    for i in np.ndindex(2, 3):
        for name, x in graph.values(s, q[i]).items():
            assert compute_coordinate_value(s, q, name)[i] == pytest.approx(x, abs=1e-12)


# ------------------------------------------------------------------ the table


@given(graph=graphs())
@settings(max_examples=examples(80))
def test_the_table_has_a_row_for_each_moving_primitive_of_the_tree(graph: Graph):
    s = graph.mechanism().build()
    table = s.structure.table
    held = {name for name, f in s.structure.couplings.items() if f.source is None}
    expected = 0
    for e in graph.edges:
        if e.name in s.structure.closures or e.name in held:
            continue
        expected += len(
            make_joint_type(e.kind, **e.options).layout(graph.dim, e.child in graph.particles)[1]
        )
    assert len(table.kind) == expected and set(table.kind) <= {R, P, Q}
    assert np.all(table.parent < np.arange(expected)) and np.all(table.parent >= -1)
    for row in range(expected):
        iq = int(table.iq[row])
        iv = int(table.iv[row])
        if table.kind[row] == Q:
            assert (
                iq in s.structure.layout.quaternion_q
                and iv in s.structure.layout.quaternion_v
                and abs(table.multiplier[row]) == 1.0
            )
        else:
            assert s.coordinate_names[iq] == s.structure.velocity_names[iv]
    assert np.all(table.offset[table.kind != R] == 0.0)


@given(graph=graphs(), seed=st.integers(0, 10**6))
def test_packs_hold_what_moves_their_outputs(graph: Graph, seed):
    s = graph.mechanism().build()
    rng = np.random.default_rng(seed)
    names = [s.body_names[i] for i in rng.integers(0, len(s.body_names), 3)]
    ints, floats = s.structure.table.pack_arrays(names)
    rows = sorted({r for n in names for r in s.structure.table.find_path(n)})
    assert (ints[0], ints[1], ints[2], ints[3]) == (len(rows), 3, s.nq, s.nv)
    assert len(ints) == 8 + 6 * len(rows) + 2 * 3 and len(floats) == 16 * len(rows) + 12 * 3
    q = s.random(rng)
    out = np.empty((3, 4, 4))
    assert table_sweep.compute_single_poses(ints, floats, q, out) == 0
    np.testing.assert_allclose(out, s.fk(q, names), rtol=0, atol=1e-14)
    ints, floats = s.structure.table.pack_arrays(names[:1], s.structure.table.find_path(names[0]))
    assert ints[4] == 1, "the way to one body is a chain"


def test_constants_are_folded():
    """Fixed joints, offsets and locked coordinates cost nothing."""
    m = Mechanism()
    a, b, c, d = (m.body(x) for x in "abcd")
    (
        m.fixed("f", m.ground, a, at=(1, 0, 0)),
        m.revolute("r", a, b),
        m.prismatic("p", b, c),
        m.cylindrical("c", c, d),
    )
    m.gear("p", "r", 0.5, offset=0.25)
    m.lock({"c.z": 0.1})
    table = m.build().structure.table
    np.testing.assert_array_equal(table.kind, [R, P, R])
    np.testing.assert_array_equal(table.iq, [0, 0, 1])
    np.testing.assert_array_equal(table.multiplier, [1.0, 0.5, 1.0])
    np.testing.assert_allclose(table.placement[1][:3, 3], [0, 0, 0.25])
    np.testing.assert_allclose(table.at["d"][1][:3, 3], [0, 0, 0.1])


def test_large_offsets_do_not_cost_accuracy():
    """The offset of a turn is kept apart from the coordinate: nothing is lost at large q."""
    m = Mechanism()
    m.revolute("a", m.ground, m.body("A")), m.revolute("b", m.ground, m.body("B"))
    m.gear("b", "a", 3.0, offset=0.1)
    X = m.build().fk([1e8 / 3], "B")
    expected = reference.turn("z", 3.0 * (1e8 / 3)) @ reference.turn("z", 0.1)
    np.testing.assert_allclose(X, expected.astype(float), rtol=0, atol=1e-15)


# ------------------------------------------------------------------ limits, words


def test_limits_by_coordinate():
    m = Mechanism()
    m.planar(
        "j", m.ground, m.body("b"), limits={"rz": (-1, 1), "x": (0, np.inf)}, velocity={"y": 2.0}
    )
    m.free("f", "b", m.body("c"), limits={"z": (0, 1)}, velocity={"wx": 3.0})
    s = m.build()
    inf = np.inf
    assert s.structure.velocity_names == (
        "j.x",
        "j.y",
        "j.rz",
        "f.x",
        "f.y",
        "f.z",
        "f.wx",
        "f.wy",
        "f.wz",
    )
    np.testing.assert_array_equal(s.lower, [0, -inf, -1, -inf, -inf, 0, -inf, -inf, -inf])
    np.testing.assert_array_equal(s.upper, [inf, inf, 1, inf, inf, 1, inf, inf, inf])
    np.testing.assert_array_equal(
        s.structure.velocity_limits, [inf, 2, inf, inf, inf, inf, 3, inf, inf]
    )
    np.testing.assert_array_equal(s.structure.limits, np.stack([s.lower, s.upper], axis=-1))


def test_limits_of_cut_joints_count():
    m = Mechanism()
    m.revolute("a", m.ground, m.body("b"), limits=(-1, 1))
    m.revolute("c", m.ground, "b", limits=(-0.5, 0.5), cut=True)
    s = m.build()
    assert s.structure.closures == ("c",)
    np.testing.assert_array_equal(s.structure.limits, [[-1, 1], [-0.5, 0.5]])
    with pytest.raises(DescriptionError, match="lock of 'c'"):
        s.mechanism.lock({"c": 0.7}).build()


def test_relations_in_words():
    m = Mechanism()
    for name in "abc":
        m.revolute(name, m.ground, m.body(name.upper()))
    m.couple("c", {"a": 0.5, "b": -2}, offset=0.1)
    (relation,) = m.build().structure.relations
    assert format_relation(relation) == "c = 0.5 a + -2 b + 0.1"


def test_followers_say_what_they_follow():
    m = Mechanism()
    for name in "abc":
        m.revolute(name, m.ground, m.body(name.upper()))
    m.gear("b", "a", 2.0, offset=1.0)
    m.lock({"c": 0.5})
    assert m.build().structure.couplings == {
        "c": Follower(None, 0.0, 0.5),
        "b": Follower("a", 2.0, 1.0),
    }


def geared(
    driver: tuple[float, float], driven: tuple[float, float], ratio: float, driven_first: bool
):
    system = Mechanism("gear")
    joints = {"x": driver, "y": driven}
    for name in sorted(joints, reverse=driven_first):
        system.revolute(name, system.ground, system.body(f"body_{name}"), limits=joints[name])
    system.gear("y", "x", ratio)
    return system.build()


@pytest.mark.parametrize("driven_first", [False, True])
def test_limits_that_do_not_overlap_name_both_joints_whatever_their_order(driven_first):
    with pytest.raises(
        DescriptionError, match=r"joint 'y': .*'x' in \[5, 6\], those of joint 'x' for \[-1, 1\]"
    ):
        geared((-1.0, 1.0), (5.0, 6.0), 1.0, driven_first)


@pytest.mark.parametrize("driven_first", [False, True])
@pytest.mark.parametrize(
    ("driver", "driven"),
    [((0.3, 0.3), (0.1, 0.1)), ((-1.0, 0.3), (0.1, 2.0)), ((0.3, 1.0), (0.0, 0.1))],
)
@pytest.mark.parametrize(
    "ratio", [1.0 / 3.0, np.nextafter(1.0 / 3.0, 0.0), np.nextafter(1.0 / 3.0, 1.0)]
)
def test_limits_that_touch_through_a_gear_are_accepted(ratio, driver, driven, driven_first):
    limits = geared(driver, driven, ratio, driven_first).structure.limits
    np.testing.assert_allclose(limits, [[0.3, 0.3]], rtol=1e-15)
    assert limits[0, 0] <= limits[0, 1]


@pytest.mark.parametrize(("apart", "good"), [(5e-4, True), (2e-3, False)])
def test_limits_touch_up_to_rounding_of_their_size(apart, good):
    given = (0.0, 1e6), (1e6 + apart, 2e6), 1.0, False
    if good:
        np.testing.assert_allclose(geared(*given).structure.limits, [[1e6, 1e6]], rtol=1e-9)
    else:
        with pytest.raises(DescriptionError, match="leave nothing to 'x'"):
            geared(*given)


@pytest.mark.parametrize(
    ("value", "good"), [(0.5, True), (1.0, True), (0.7, True), (0.49, False), (1.01, False)]
)
def test_a_joint_is_locked_inside_its_limits_and_at_them(value, good):
    m = Mechanism("arm", dim=2)
    m.revolute("J", m.ground, m.body("B"), limits=(0.5, 1.0))
    m.lock({"J": value})
    if good:
        assert m.build().nq == 0
    else:
        with pytest.raises(KempeError, match="outside"):
            m.build()
