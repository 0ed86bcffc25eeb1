"""`System` as its users meet it: attributes, names, other systems from it."""

from __future__ import annotations

import ast
import inspect
import pickle
import textwrap

import numpy as np
import pytest
from graphs import Graph, graphs
from hypothesis import given

from kempe import Mechanism, System
from kempe.errors import KempeError, UnknownNameError


def scara() -> Mechanism:
    """Two hinges and a slider with a screw, a gripper whose second finger follows, a loop by a tie
    rod.
    """
    m = Mechanism("scara", ground="pedestal")
    upper, fore, quill, left, right = (
        m.body(n) for n in ("upper", "fore", "quill", "left", "right")
    )
    m.revolute("shoulder", m.ground, upper, at=(0, 0, 0.4), limits=(-2, 2), actuated=True)
    m.revolute("elbow", upper, fore, at=(0.3, 0, 0), limits=(-2.5, 2.5), actuated=True)
    m.cylindrical("quill", fore, quill, at=(0.25, 0, 0), limits={"z": (-0.2, 0)})
    m.prismatic("left", quill, left, axis=(0, 1, 0), limits=(0, 0.05))
    m.prismatic("right", quill, right, axis=(0, -1, 0))
    m.gear("right", "left", 1.0)
    m.spherical("tie", m.ground, m.body("rod"), at=(0.1, 0, 0.4))
    m.spherical("tie end", "rod", fore, at=(0.3, 0, 0), child_at=(0.1, 0, 0))
    m.frame("tcp", quill, at=(0, 0, -0.1))
    m.posture("home", {"shoulder": 0.5, "quill.z": -0.1, "right": 0.02})
    return m


def test_the_public_face():
    s = scara().build()
    assert s.name == "scara" and s.dim == 3 and (s.nq, s.nv) == (13, 11)
    assert s.body_names == ("pedestal", "upper", "fore", "quill", "left", "right", "rod")
    assert s.joint_names == ("shoulder", "elbow", "quill", "left", "right", "tie", "tie end")
    assert s.frame_names == (*s.body_names, "tcp") and s.structure.frames["tcp"].body == "quill"
    assert s.parent == (0, 1, 2, 3, 3, 0) and s.structure.closures == ("tie end",)
    assert s.structure.parent_joints == ("shoulder", "elbow", "quill", "left", "right", "tie")
    assert s.coordinate_names == (
        "shoulder",
        "elbow",
        "quill.rz",
        "quill.z",
        "left",
        "tie.qw",
        "tie.qx",
        "tie.qy",
        "tie.qz",
        "tie end.qw",
        "tie end.qx",
        "tie end.qy",
        "tie end.qz",
    )
    assert (
        s.structure.couplings["right"].source == "left"
        and s.structure.relations == ()
        and s.structure.notes == ()
        and s.structure.parameters == {}
    )
    assert s.structure.coordinates_of_joint("quill") == [
        "quill.rz",
        "quill.z",
    ] and s.structure.coordinates_of_joint("right") == ["right"]
    assert repr(s) == "System('scara', bodies=6, joints=7, nq=13, loops=1)"
    assert s.configuration_space.ambient.shape == "SO(3)^2 x T^3 x R^2"
    home = s.q("home")
    assert home[0] == 0.5 and home[3] == -0.1 and home[4] == 0.0
    with pytest.raises(UnknownNameError, match="scara has no joint 'quil'; did you mean 'quill'"):
        s.structure.coordinates_of_joint("quil")


def test_planar_systems_say_so():
    m = Mechanism("flat", dim=2)
    m.revolute("j", m.ground, m.body("b"))
    assert repr(m.build()) == "System('flat', bodies=1, joints=1, nq=1, planar)"
    assert m.build().fk([0.1], "b").shape == (4, 4) and m.build().jacobian([0.1], "b").shape == (
        6,
        1,
    )


@given(graph=graphs())
def test_systems_survive_pickling(graph: Graph):
    s = graph.mechanism().build()
    again = pickle.loads(pickle.dumps(s))
    assert (
        again == s
        and again.structure.topology == s.structure.topology
        and again.structure.content_hash == s.structure.content_hash
    )
    q = s.random(0)
    np.testing.assert_array_equal(again.fk(q), s.fk(q))
    assert graph.shuffled(1).mechanism().build().nq == s.nq


@given(graph=graphs())
def test_locking_everything_leaves_the_pose(graph: Graph):
    """Locked at q, a system stands where the free one does at q."""
    s = graph.mechanism().build()
    q = s.random(3)
    held = s.mechanism.lock(s.q_dict(q)).build()
    assert held.nq == 0 and held.structure.hash != s.structure.hash or s.nq == 0
    assert held.parent == s.parent or s.structure.closures
    for name in s.body_names:
        if held.structure.closures == s.structure.closures:
            np.testing.assert_allclose(held.fk([], name), s.fk(q, name), rtol=0, atol=1e-12)


@given(graph=graphs(loops=0))
def test_subchains_move_as_in_the_whole(graph: Graph):
    s = graph.mechanism().build()
    q = s.random(5)
    free = s.q_dict(q)
    base = s.body_names[0]
    tip = s.body_names[-1]
    for a, b in ((base, tip), (tip, base)):
        try:
            chain = s.mechanism.subchain(a, b).build()
        except KempeError as error:
            assert (
                "outside the chain" in str(error)
                or "no joints lead" in str(error)
                and a in graph.particles
            ), error
        else:
            local = chain.q({k: v for k, v in free.items() if k in chain.coordinate_names})
            X = np.linalg.inv(s.fk(q, a)) @ s.fk(q, b)
            shown = (
                slice(None) if a not in graph.particles and b not in graph.particles else np.s_[:0]
            )
            np.testing.assert_allclose(chain.fk(local, b)[shown], X[shown], rtol=0, atol=1e-11)


def test_every_method_is_documented_and_short():
    """The class is a map of the library: methods delegate."""
    own = {
        n: getattr(m, "fget", None) or getattr(m, "func", m)
        for n, m in vars(System).items()
        if n[0] != "_"
    }
    public = {name: function for name, function in own.items() if callable(function)}
    assert len(public) > 25
    for name, function in public.items():
        assert function.__doc__, name
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
        statements = [node for node in ast.walk(tree) if isinstance(node, ast.stmt)]
        assert len(statements) <= 9, f"System.{name} does work of its own"


def test_content_is_what_makes_systems_equal():
    s = scara().build()
    changes = [
        lambda m: m.frame("other", "fore"),
        lambda m: m.lock({"elbow": 0.0}),
        lambda m: m.posture("away", {}),
        lambda m: m.parameter("l", 1.0),
        lambda m: m.gear("elbow", "shoulder", 1.0),
        lambda m: m.body("more"),
    ]
    for change in changes[:-1]:
        m = scara()
        change(m)
        assert m.build() != s and m.build().structure.content_hash != s.structure.content_hash
    assert scara().build() == s


def test_structure_is_content_without_numbers():
    s = scara().build()
    m = scara()
    joint = m.joints.pop("tie end")
    m.spherical("tie end", "rod", "fore", at=(0.9, 0, 0), child_at=(0.1, 0, 0))
    assert (
        m.build() != s and m.build().structure.hash == s.structure.hash and joint.name == "tie end"
    )
    m.frame("extra", "fore")
    assert m.build().structure.hash != s.structure.hash
