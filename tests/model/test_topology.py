"""Graph -> spanning tree: what is required of the result, on graphs that nobody chose."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest
from graphs import graphs
from hunts import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from shipped import shipped, with_loops

from kempe import Mechanism, System
from kempe.errors import DescriptionError
from kempe.joints import make_joint_type
from kempe.model.characteristic_length import choose_origin
from kempe.model.structural_order import make_sort_key
from kempe.model.topology import Topology, find_spanning_tree


def tree_by_name(system: System) -> dict:
    t = system.structure.topology
    return {
        b: (t.bodies[p], j, r)
        for b, p, j, r in zip(t.bodies[1:], t.parent, t.parent_joints, t.reversed_, strict=True)
    }


# ------------------------------------------------------------------ permutations


@pytest.mark.slow
@given(graph=graphs(), seed=st.integers(0, 10**6))
@settings(max_examples=examples(120))
def test_the_order_of_the_file_changes_no_answer_by_name(graph, seed):
    one = graph.mechanism().build()
    other = graph.shuffled(seed).mechanism().build()
    assert set(one.structure.closures) == set(other.structure.closures)
    assert tree_by_name(one) == tree_by_name(other)
    assert sorted(one.coordinate_names) == sorted(other.coordinate_names)
    by_name = lambda s, x: dict(zip(s.structure.velocity_names, x.tolist(), strict=True))  # noqa: E731
    assert by_name(one, one.lower) == by_name(other, other.lower)
    q = one.random(3)
    p = other.random(3)
    assert one.q_dict(q) == other.q_dict(p)
    poses = one.fk(q)
    others = other.fk(p)
    for name in one.body_names:
        np.testing.assert_allclose(
            poses[one.body_names.index(name)],
            others[other.body_names.index(name)],
            rtol=0,
            atol=1e-13,
        )
    for name in one.structure.closures:
        open_one = one.loops.closure_error(q)[one.structure.closures.index(name)]
        open_other = other.loops.closure_error(p)[other.structure.closures.index(name)]
        np.testing.assert_allclose(open_one, open_other, rtol=0, atol=1e-9)


# ------------------------------------------------------------------ the tree


@given(graph=graphs())
@settings(max_examples=examples(120))
def test_it_is_a_spanning_tree_that_keeps_directions(graph):
    t = find_spanning_tree(graph.mechanism())
    ends = {e.name: (e.parent, e.child) for e in graph.edges}
    assert t.bodies[0] == "ground" and sorted(t.bodies[1:]) == sorted(
        graph.bodies + graph.particles
    )
    assert sorted([*t.parent_joints, *t.closures]) == sorted(ends)
    for i, (p, joint, backwards) in enumerate(
        zip(t.parent, t.parent_joints, t.reversed_, strict=True), start=1
    ):
        assert 0 <= p < i
        there = (t.bodies[i], t.bodies[p]) if backwards else (t.bodies[p], t.bodies[i])
        assert ends[joint] == there
    assert list(t.closures) == [e.name for e in graph.edges if e.name in t.closures]


@given(graph=graphs())
@settings(max_examples=examples(120))
def test_bodies_keep_their_order_unless_a_parent_comes_later(graph):
    t = find_spanning_tree(graph.mechanism())
    parent = {b: t.bodies[p] for b, p in zip(t.bodies[1:], t.parent, strict=True)}
    expected = ["ground"]
    waiting = list(graph.bodies + graph.particles)
    while waiting:  # always the first declared body whose parent is there
        body = next(b for b in waiting if parent[b] in expected)
        waiting.remove(body)
        expected.append(body)
    assert list(t.bodies) == expected


def way_to_ground(t: Topology) -> Callable[[str], dict[str, None]]:
    """Joints of the tree between a body and the ground."""
    up = {
        b: (t.bodies[p], j) for b, p, j in zip(t.bodies[1:], t.parent, t.parent_joints, strict=True)
    }

    def way(body: str) -> dict[str, None]:
        joints: dict[str, None] = {}
        while body in up:
            body, joint = up[body]
            joints[joint] = None
        return joints

    return way


def loops_of(system: System) -> dict[str, set[str]]:
    """For each joint that is left out the joints of the tree that are on its loop."""
    way = way_to_ground(system.structure.topology)
    joints = system.structure.joints
    return {
        n: {*way(joints[n].parent)} ^ {*way(joints[n].child)} for n in system.structure.closures
    }


def shortest_basis(ends: list[tuple[int, int]]) -> int:
    """Total length of a minimum cycle basis (Horton, 1987): short loops, taken while they are
    independent modulo 2.
    """
    bodies = sorted({b for pair in ends for b in pair})
    candidates: set[tuple[int, int]] = set()  # length, and the edges as bits
    for root in bodies:
        ways = {root: 0}
        front = [root]
        while front:
            here = front.pop(0)
            for k, (a, b) in enumerate(ends):
                for x, y in ((a, b), (b, a)):
                    if x == here and y not in ways:
                        ways[y] = ways[here] | 1 << k
                        front.append(y)
        for k, (a, b) in enumerate(ends):
            loop = ways[a] ^ ways[b] ^ 1 << k
            if loop:
                candidates.add((loop.bit_count(), loop))
    total = 0
    pivots: dict[int, int] = {}
    for length, loop in sorted(candidates):
        rest = loop
        while rest and (lead := rest.bit_length()) in pivots:
            rest ^= pivots[lead]
        if rest:
            pivots[rest.bit_length()] = rest
            total += length
    assert len(pivots) == len(ends) - len(bodies) + 1
    return total


def ends_of(m: Mechanism) -> list[tuple[int, int]]:
    number = {b: k for k, b in enumerate(m.bodies)}
    return [(number[j.parent], number[j.child]) for j in m.joints.values()]


def total_length(m: Mechanism) -> int:
    return sum(1 + len(loop) for loop in loops_of(m.build()).values())


@given(graph=graphs(loops=8))
@settings(max_examples=examples(120))
def test_on_every_loop_a_joint_of_the_least_wanted_grade_is_cut(graph):
    """Joints that the user does not mark stay, fixed ones, those with motors and coupled ones."""
    system = graph.mechanism().build()
    edges = {e.name: e for e in graph.edges}
    coupled = {name for gear in graph.gears for name in gear[:2]}

    def grade(name: str) -> tuple:
        e = edges[name]
        dof = make_joint_type(e.kind, **e.options).dof(graph.dim, e.child in graph.particles)
        return e.cut, dof > 0, not (e.actuated or name in coupled)

    t = system.structure.topology
    holds = dict(zip(t.bodies[1:], t.parent_joints, strict=True))
    for name, loop in loops_of(system).items():
        # the choice is only which of its joints holds the particle
        if edges[name].child in graph.particles:
            loop = {holds[edges[name].child]}
        assert all(grade(j) <= grade(name) for j in loop), (name, loop)


@pytest.mark.parametrize("name", with_loops())
def test_loops_of_models_are_short(name):
    m = shipped()[name].mechanism
    assert total_length(m) <= 1.5 * shortest_basis(ends_of(m))


def random_pins(rng: np.random.Generator, bodies: int, loops: int, near: int) -> Mechanism:
    """Bodies on pins, each on one of the `near` bodies before it, and pins that close loops among
    `near` bodies.
    """
    m = Mechanism("pins", dim=2)
    names = [m.ground.name, *(m.body(f"b{k}").name for k in rng.permutation(bodies))]
    pairs = [(int(rng.integers(max(0, k - near), k)), k) for k in range(1, len(names))]
    for _ in range(loops):
        a = int(rng.integers(1, len(names)))
        pairs.append((a, int(rng.integers(max(0, a - near), a))))
    for k, (a, b) in zip(rng.permutation(len(pairs)), pairs, strict=True):
        m.revolute(f"j{k}", names[a], names[b])
    return m


def test_loops_of_random_graphs_are_short(hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(200)):
        bodies = int(rng.integers(3, 30))
        m = random_pins(rng, bodies, int(rng.integers(1, 12)), int(rng.choice([2, 4, bodies])))
        assert total_length(m) <= 1.5 * shortest_basis(ends_of(m))


@pytest.mark.parametrize("names", ["ABX", "LRM", "XBA"])
def test_loops_of_a_ladder_do_not_run_to_the_ground(names):
    """Rails A and B, rungs X, whatever they are called; 40 loops of four joints."""
    a, b, x = names
    m = Mechanism("ladder", dim=2)
    left = m.ground.name
    right = m.body("base").name
    m.revolute(f"{x}0", left, right)
    for k in range(1, 41):
        m.body(f"l{k}"), m.body(f"r{k}")
        m.revolute(f"{a}{k}", left, f"l{k}"), m.revolute(f"{b}{k}", right, f"r{k}")
        m.revolute(f"{x}{k}", f"l{k}", f"r{k}")
        left = f"l{k}"
        right = f"r{k}"
    assert [len(loop) for loop in loops_of(m.build()).values()] == [3] * 40


# ------------------------------------------------------------------ the lecture


def seven_bodies(loop: bool = False) -> Mechanism:
    m = Mechanism("seven bodies", ground="B0")
    for i in range(1, 8):
        m.body(f"B{i}")
    for i, parent in enumerate((0, 1, 2, 1, 4, 4, 2), start=1):
        m.revolute(f"J{i}", f"B{parent}", f"B{i}", at=(1, 0, 0))
    if loop:
        m.prismatic("J8", "B5", "B0", axis=(1, 0, 0))
    return m


def test_the_lectures_connectivity_vector():
    s = seven_bodies().build()
    assert s.parent == (0, 1, 2, 1, 4, 4, 2)
    # joint i is the parent joint of body i
    assert s.structure.parent_joints == tuple(f"J{i}" for i in range(1, 8))
    assert s.body_names == tuple(f"B{i}" for i in range(8)) and s.structure.closures == ()
    assert s.structure.topology.reversed_ == (False,) * 7


def test_a_loop_through_the_ground_does_not_change_the_rest():
    s = seven_bodies(loop=True).build()
    assert len(s.structure.closures) == 1 and s.nq == 8
    cut = s.mechanism.joints[s.structure.closures[0]]
    assert {cut.parent, cut.child} & {"B5", "B4", "B1"}


@pytest.mark.parametrize("order", [(3, 1, 2), (2, 3, 1), (3, 2, 1)])
def test_a_child_waits_for_its_parent(order):
    m = Mechanism()
    for i in order:
        m.body(f"b{i}")
    m.revolute("j3", "b2", "b3"), m.revolute("j2", "b1", "b2"), m.revolute("j1", "ground", "b1")
    s = m.build()
    assert s.body_names == ("ground", "b1", "b2", "b3") and s.parent == (0, 1, 2)
    assert s.coordinate_names == ("j3", "j2", "j1")  # q is in the order of the joints


# ------------------------------------------------------------------ what is cut


def square(**changes: dict) -> Mechanism:
    """Four-bar: A and D on the ground, B and C between."""
    m = Mechanism("square")
    for body in ("crank", "coupler", "rocker"):
        m.body(body)
    for name, parent, child in (
        ("A", "ground", "crank"),
        ("B", "crank", "coupler"),
        ("C", "coupler", "rocker"),
        ("D", "ground", "rocker"),
    ):
        m.joint(
            name, **{"kind": "revolute", "parent": parent, "child": child, **changes.get(name, {})}
        )
    return m


def cut(m: Mechanism) -> str:
    (name,) = find_spanning_tree(m).closures
    return name


def test_a_shallow_tree_is_preferred():
    assert cut(square()) in ("B", "C")


@pytest.mark.parametrize("name", "ABCD")
def test_many_freedoms_are_cut_first(name):
    assert cut(square(**{name: {"kind": "spherical"}})) == name
    assert (
        cut(square(**{name: {"kind": "universal"}, "A" if name != "A" else "B": {"kind": "fixed"}}))
        == name
    )


@pytest.mark.parametrize("name", "ABCD")
def test_the_user_names_the_cut(name):
    assert cut(square(**{name: {"cut": True}})) == name
    others = {n: {"kind": "spherical", "actuated": False} for n in "ABCD" if n != name}
    assert cut(square(**{name: {"cut": True, "kind": "fixed", "actuated": True}}, **others)) == name


@pytest.mark.parametrize("name", "ABCD")
def test_actuated_fixed_and_coupled_joints_stay(name):
    spare = next(n for n in "BCAD" if n != name)
    assert cut(square(**{name: {"actuated": True, "kind": "spherical"}})) != name
    assert cut(square(**{name: {"kind": "fixed", "actuated": False}})) != name
    m = square(**{spare: {"actuated": False}})
    assert cut(m) == spare
    m = square()
    other = next(n for n in "DABC" if n != name)
    m.gear(name, other, -1.0)
    assert cut(m) not in (name, other)


def test_coupled_joints_are_found_behind_dots():
    """A coordinate is named 'joint.rz', and joints may have dots in their own names."""
    m = Mechanism()
    m.body("a"), m.body("b")
    (
        m.cylindrical("arm.1", "ground", "a"),
        m.revolute("x", "a", "b"),
        m.cylindrical("arm.2", "ground", "b"),
    )
    m.revolute("y", "b", m.body("c"))
    m.gear("arm.2.rz", "y", 1.0)
    m.gear("arm.1.rz", "y", 2.0)
    assert cut(m) == "x"


def test_a_cut_that_would_detach_is_ignored():
    m = Mechanism()
    m.revolute("only", "ground", m.body("b"), cut=True)
    assert m.build().structure.closures == ()


def test_two_joints_between_the_same_two_bodies_are_a_loop():
    m = Mechanism()
    m.revolute("j1", "ground", m.body("b"))
    m.revolute("j2", "b", "ground", at=(1, 0, 0))
    assert m.build().structure.closures == ("j2",) and m.build().structure.topology.reversed_ == (
        False,
    )


def test_ties_are_broken_by_natural_names():
    m = Mechanism()
    m.body("b")
    for name in ("J10", "J9", "J2"):
        m.revolute(name, "ground", "b")
    assert set(m.build().structure.closures) == {
        "J9",
        "J10",
    } and m.build().structure.parent_joints == ("J2",)


def test_natural_order():
    names = ["J", "J1", "J01", "J2", "J2a", "J10", "J10b3", "J10b20", "K"]
    assert sorted(reversed(names), key=make_sort_key)[0] == "J"
    assert [n for n in sorted(names, key=make_sort_key) if n != "J01"] == [
        n for n in names if n != "J01"
    ]
    for odd in ("²", "1²2", "٣", "9" * 5000, "0", "", "a\n1"):
        assert make_sort_key(odd) < make_sort_key("zz") or make_sort_key(odd) > make_sort_key("zz")
    assert len({make_sort_key(n) for n in ("a1", "a01", "a001", "a٣", "a3")}) == 5


# ------------------------------------------------------------------ refusals, size


def test_detached_bodies_are_named():
    m = square()
    m.body("lost"), m.body("alone")
    m.revolute("E", "lost", "alone")
    with pytest.raises(
        DescriptionError,
        match="mechanism 'square': no joints lead from 'ground' to 'lost', 'alone'; a free body",
    ):
        m.build()
    for i in range(20):
        m.body(f"b{i}")
    with pytest.raises(DescriptionError, match="'b5', ...;"):
        m.build()


def test_the_ground_alone_is_a_system():
    s = Mechanism("nothing").build()
    assert (s.nq, s.nv, s.parent, s.body_names) == (0, 0, (), ("ground",))
    np.testing.assert_array_equal(s.fk([]), np.eye(4)[None])
    np.testing.assert_array_equal(s.fk(np.zeros((3, 0)), "ground"), np.tile(np.eye(4), (3, 1, 1)))
    assert s.loops.closure_error([]).shape == (0, 6) and str(s.configuration_space).startswith(
        "a point"
    )


def chain(n: int, rungs: int = 0) -> Mechanism:
    """Links in a row, with `rungs` extra joints that make loops."""
    m = Mechanism("long")
    here = m.ground.name
    for i in range(n):
        m.body(f"b{i}")
        m.revolute(f"j{i}", here, f"b{i}", at=(0.001, 0, 0))
        here = f"b{i}"
    for i in range(rungs):
        m.spherical(f"rung{i}", f"b{i}", f"b{i + n - rungs}")
    return m


@pytest.mark.slow
def test_a_chain_of_20000_bodies():
    s = chain(20_000).build()
    assert s.nq == 20_000 and s.parent == tuple(range(20_000))
    q = np.zeros(20_000)
    q[0] = np.pi / 2
    np.testing.assert_allclose(s.fk(q, "b19999")[:3, 3], [0.001, 19.999, 0], rtol=0, atol=1e-9)


def steps(function: Callable[[], object]) -> int:
    """Calls of functions that a call makes: work that does not depend on the machine."""
    count = 0

    def tick(frame, event, argument):
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(tick)
    try:
        function()
    finally:
        sys.setprofile(before)
    return count


@pytest.mark.parametrize("rungs", [0, 50])
def test_work_grows_linearly(rungs):
    small = chain(250, rungs)
    large = chain(1000, 4 * rungs)
    assert steps(large.build) < 4.8 * steps(small.build)
    assert steps(lambda: chain(1000)) < 4.8 * steps(lambda: chain(250))


def test_names_in_their_natural_order():
    names = ["J10", "J2", "J1", "Ja", "J02", "J", "K1", "1", "10", "2"]
    assert sorted(names, key=make_sort_key) == [
        "1",
        "2",
        "10",
        "J",
        "J1",
        "J02",
        "J2",
        "J10",
        "Ja",
        "K1",
    ]


@pytest.mark.parametrize("away", [0.0, 3.0, 1e6])
def test_loops_are_measured_from_where_they_are(away):
    """A mechanism far from the ground's origin loses no digits, and one near by is measured from
    there.
    """
    m = Mechanism("four-bar", dim=2)
    m.revolute("A", m.ground, m.body("a"), at=(away, 0))
    m.revolute("B", "a", m.body("b"), at=(0.1, 0))
    m.revolute("C", "b", m.body("c"), at=(0.4, 0))
    m.revolute("D", m.ground, "c", at=(away + 0.35, 0), child_at=(0.3, 0))
    system = m.build()
    origin = choose_origin(system)
    assert np.allclose(origin, [away, 0, 0] if away == 1e6 else 0.0, atol=1.0)
    assert away == 3.0 or system.mobility().dof == 1
