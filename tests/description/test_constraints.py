"""Rods, points on lines and in planes: what the builder accepts, refuses, copies and writes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kempe import Mechanism, System, constraints
from kempe.description.mechanism import declare_placed_constraint
from kempe.description.toml_reader import read_toml
from kempe.description.toml_writer import write_toml
from kempe.description.urdf_writer import write_urdf
from kempe.errors import DescriptionError, InputError
from kempe.values import Expression

ENDS = ("a", (0, 0, 0), {}), ("b", (0, 0, 0), {})


def two_bodies(dim: int = 3) -> Mechanism:
    m = Mechanism("two", dim)
    m.parameter("l", 2.0)
    for name in "ab":
        m.free(f"J{name}", m.ground, m.body(name))
    m.frame("tip", "a", at=(1, 2))
    return m


def test_ends_are_bodies_or_frames():
    m = two_bodies()
    by_keyword = m.distance("r1", "a", m.bodies["b"], 2.0, at="tip", child_at=(0, 0, 1))
    by_frame = m.distance("r2", "tip", "b", 2.0, child_at=(0, 0, 1))
    assert by_keyword.X_PF == by_frame.X_PF == m.frames["tip"].X_BF
    assert (by_frame.parent, by_frame.child, by_frame.kind) == ("a", "b", "distance")
    shifted = m.point_on_line("r3", m.frames["tip"], "b", at=(0, 0, 3), axis=(1, 0, 0))
    X = shifted.X_PF.evaluate_pose({})
    np.testing.assert_allclose(X[:3, 3], [1, 2, 3], atol=1e-15)
    np.testing.assert_allclose(X[:3, 2], [1, 0, 0], atol=1e-15)
    with pytest.raises(DescriptionError, match="given twice, by frames 'tip' and 'tip'"):
        m.distance("r4", "tip", "b", 1.0, at="tip")


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda m: m.distance("r", "a", "a", 1.0), "ties body 'a' to itself"),
        (lambda m: m.distance("r", "tip", "a", 1.0), "ties body 'a' to itself"),
        (lambda m: m.distance("r", "a", "c", 1.0), "no body 'c'"),
        (
            lambda m: m.distance("r", "a", "b", 0.0),
            "length is 0; it must be above zero; points that coincide",
        ),
        (lambda m: m.distance("r", "a", "b", -0.5), "length is -0.5; it must be above zero"),
        (lambda m: m.distance("r", "a", "b", math.nan), "length is nan; it must be finite"),
        (lambda m: m.distance("r", "a", "b", math.inf), "length is inf; it must be finite"),
        (lambda m: m.distance("r", "a", "b", True), "length is True; it must be a number"),
        (lambda m: m.distance("r", "a", "b", "l - 2"), r"length is 0 \(length = l - 2\)"),
        (lambda m: m.distance("r", "a", "b", "sqrt(-l)"), "length is nan"),
        (lambda m: m.distance("r", "a", "b", "l/0"), "length is nan"),
        (
            lambda m: m.distance("r", "a", "b", "k"),
            "length is k: no parameter 'k'; did you mean|there are: 'l'",
        ),
        (lambda m: m.distance("r", "a", "b", None), "no length"),
        (lambda m: m.distance("Ja", "a", "b", 1.0), "another joint of this name"),
        (lambda m: m.distance("r", "a", "b", 1.0, at=(math.nan, 0)), "at is nan"),
        (lambda m: m.distance("r", "a", "b", 1.0, at="nowhere"), "no frame 'nowhere'"),
        (
            lambda m: declare_placed_constraint(m, "r", "distanc", *ENDS, None, None),
            "no kind of constraint .distanc.; did you mean",
        ),
        (
            lambda m: declare_placed_constraint(m, "r", "point_on_line", *ENDS, 1.0, None),
            "point_on_line takes no length",
        ),
        (lambda m: m.point_on_line("r", "a", "b", axis=(0, 0, 0)), "axis is 0.0 0.0 0.0"),
        (
            lambda m: m.point_on_line("r", m.particle("p"), "b"),
            "'p' is a particle, which has no axes",
        ),
        (
            lambda m: m.point_on_plane("r", m.particle("p"), "b"),
            "'p' is a particle, which has no axes",
        ),
        (
            lambda m: m.point_on_line("r", "a", m.particle("p"), child_at=(1, 0)),
            "particle .* has no extent",
        ),
    ],
)
def test_what_is_refused(call, said):
    m = two_bodies()
    before = m.copy()
    with pytest.raises((DescriptionError, InputError), match=said):
        call(m)
    assert m.constraints == {} and m.joints == before.joints


def test_a_name_is_taken_by_a_constraint():
    m = two_bodies()
    m.distance("r", "a", "b", 1.0)
    with pytest.raises(DescriptionError, match="another constraint of this name"):
        m.revolute("r", "a", "b")
    with pytest.raises(DescriptionError, match="another constraint of this name"):
        m.point_on_plane("r", "a", "b")
    with pytest.raises(InputError, match="constraint name is ''"):
        m.distance("", "a", "b", 1.0)


def test_in_the_plane():
    m = two_bodies(2)
    m.distance("rod", "a", "b", "l", at=(1, 0))
    m.point_on_line("guide", "tip", "b", axis=(0, 1))
    with pytest.raises(
        DescriptionError, match="does not exist in the plane; planar systems take distance"
    ):
        m.point_on_plane("p", "a", "b")
    with pytest.raises(DescriptionError, match=r"out of the plane; give its axis=\(x, y\)"):
        m.point_on_line("p", "a", "b")
    with pytest.raises(DescriptionError, match="its axis has z = "):
        m.point_on_line("p", "a", "b", axis=(1, 0, 1))
    with pytest.raises(DescriptionError, match="z leaves the plane"):
        m.distance("p", "a", "b", 1.0, at=(0, 0, 1))
    with pytest.raises(DescriptionError, match="z leaves the plane"):
        m.point_on_line("p", "a", "b", axis=(1, 0), child_at=(0, 0, 1))
    assert read_toml(write_toml(m)) == m


def test_particles():
    m = two_bodies()
    p = m.particle("p")
    r = m.particle("r")
    for particle in (p, r):
        m.translation(f"J{particle}", m.ground, particle)
    m.distance("rod", p, r, 1.0)
    m.point_on_line("line", "a", p)
    m.point_on_plane("plane", "tip", p, rpy=(0, 0.5, 0))
    assert read_toml(write_toml(m)) == m and len(m.build().mechanism.constraints) == 3


def test_they_belong_to_what_the_mechanism_is():
    m = two_bodies()
    plain = m.build()
    same = m.copy()
    m.distance("rod", "tip", "b", "l")
    assert m != same and same.constraints == {}
    assert m.build() != plain and m.copy() == m
    assert m.build().mechanism.lock({"Ja.x": 0.5}).build().mechanism.constraints == m.constraints
    assert System(m).mechanism.constraints == m.constraints
    assert "constraints" in vars(m) and hash(m.constraints["rod"]) == hash(
        m.copy().constraints["rod"]
    )


def test_they_are_no_connection():
    m = Mechanism()
    m.body("b")
    m.distance("rod", m.ground, "b", 1.0)
    with pytest.raises(DescriptionError, match="no joints lead from 'ground' to 'b'"):
        m.build()
    m.free("J", m.ground, "b")
    assert m.build().structure.closures == () and m.build().nv == 6


def test_mounting_and_cutting_out():
    m = two_bodies()
    m.distance("rod", "tip", "b", "l", child_at=(0, 1))
    host = Mechanism("host")
    host.attach(m, prefix="x_").attach(m, prefix="y_")
    assert list(host.constraints) == ["x_rod", "y_rod"]
    moved = host.constraints["y_rod"]
    assert (moved.parent, moved.child, moved.of.value) == ("y_a", "y_b", Expression("l"))
    assert moved.X_PF == m.frames["tip"].X_BF
    other = Mechanism("other")
    other.revolute("x_rod", other.ground, other.body("z"))
    with pytest.raises(
        DescriptionError, match="both have joints and constraints 'x_rod'.*prefix='x_2_'"
    ):
        other.attach(m, prefix="x_")
    assert m.subchain("a", "b").constraints.keys() == {"rod"}
    assert m.subchain("ground", "tip").constraints == {}


def test_urdf_cannot_say_it():
    m = two_bodies()
    m.distance("rod", "a", "b", 1.0)
    m.point_on_plane("plane", "a", "b")
    with pytest.raises(
        DescriptionError, match="constraint 'rod': a distance does not exist in URDF"
    ) as caught:
        write_urdf(m)
    assert len(caught.value.problems) == 2


def test_length_follows_parameters():
    m = two_bodies()
    rod = m.distance("rod", "a", "b", "l - 1")
    assert rod.length(m.parameters) == 1.0
    with pytest.raises(
        DescriptionError, match=r"constraint 'rod': its length is -0.5 \(length = l - 1\)"
    ):
        m.build().with_parameters(l=0.5).assemble()


def test_a_posture_is_refused_for_what_it_is_and_not_for_a_weight_that_nobody_gave():
    m = Mechanism("arm", dim=2)
    m.revolute("j", m.ground, m.body("link"))
    for posture in (constraints.Posture({"j": 0.3}), constraints.Posture({"j": 0.3}, weight=None)):
        with pytest.raises(DescriptionError, match="requested in one call of ik.*lock, couple"):
            m.constrain(posture)
    with pytest.raises(DescriptionError, match="weight is what ik reads"):
        m.constrain(constraints.Posture({"j": 0.3}, weight=2.0))
