"""URDF written and read again: the same robot, or the list of what URDF cannot say."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hunts import examples, some
from hypothesis import given, reject, settings
from random_mechanisms import mechanisms
from robots import good_urdf_files

from kempe.constraints import Position
from kempe.description.dh import from_dh
from kempe.description.mechanism import Mechanism
from kempe.description.urdf_reader import read_urdf
from kempe.description.urdf_writer import write_urdf
from kempe.errors import DescriptionError
from kempe.poses import place


@pytest.mark.parametrize("path", some(good_urdf_files().values(), 4), ids=list(good_urdf_files()))
def test_real_robots_come_back_as_they_were(path: Path):
    m = read_urdf(path.read_bytes())
    assert read_urdf(write_urdf(m)) == m


def same_poses(m: Mechanism, seed: int = 0) -> None:
    """All bodies and frames of the mechanism must be where those of its URDF are."""
    before = m.build()
    after = read_urdf(write_urdf(m)).build()
    assert set(before.coordinate_names) == set(after.coordinate_names)
    q = before.structure.layout.neutral + np.random.default_rng(seed).normal(size=before.nq)
    by_name = before.q_dict(q)
    for name in before.frame_names:
        X = before.fk(q, name)
        Y = after.fk(by_name, name)
        np.testing.assert_allclose(Y, X, rtol=0, atol=1e-12 * max(1.0, np.abs(X).max()))


@pytest.mark.slow
@settings(max_examples=examples(150))
@given(mechanisms())
def test_any_mechanism_comes_back_or_is_refused(m: Mechanism):
    try:
        m.build()
    except DescriptionError:
        reject()
    try:
        write_urdf(m)
    except DescriptionError as error:
        assert all(p.allowed for p in error.problems)
    else:
        same_poses(m)


@pytest.mark.parametrize("seed", range(20))
def test_trees_of_what_urdf_has(seed: int):
    rng = np.random.default_rng(seed)
    m = Mechanism("tree")
    bodies = [m.ground]
    for i, kind in enumerate(
        rng.choice(["revolute", "prismatic", "fixed", "planar", "free", "spherical"], 8)
    ):
        bodies.append(m.body(f"b{i}"))
        X_PF = place(rng.normal(size=3), rpy=rng.normal(size=3))
        X_CM = place(
            rng.normal(size=3) * (rng.random() < 0.5), rpy=rng.normal(size=3) * (rng.random() < 0.5)
        )
        m.joint(
            f"j{i}", kind, bodies[rng.integers(len(bodies) - 1)], bodies[-1], at=X_PF, child_at=X_CM
        )
    m.frame("tip", bodies[-1], at=(0.1, 0.2, 0.3), quat_wxyz=(1, 2, 3, 4))
    same_poses(m, seed)


def test_spherical_joints_are_written_with_a_remark():
    m = Mechanism("m")
    m.spherical("s", m.ground, m.body("a"), at=(1, 2, 3), child_at=(0, 0, 1))
    assert "<!-- spherical: a type of MuJoCo and Bullet, which ROS refuses -->" in write_urdf(m)
    same_poses(m)


def test_dh_chains_get_links_for_their_axes():
    m = from_dh(
        [{"a": 0.5, "alpha": "pi/2", "d": 0.1}, {"a": "l", "alpha": 0.3}, {"d": 0.2}],
        parameters={"l": 0.4},
    )
    text = write_urdf(m)
    assert text.count("<link") == 4 + 2 + 1  # two axes off their body's origin, and the tool
    same_poses(m)


def test_limits_of_all_kinds():
    m = Mechanism("m")
    bodies = [m.body(n) for n in "abcd"]
    m.revolute("a", m.ground, bodies[0], limits=(-1, math.inf), velocity=2.0)
    m.prismatic("b", m.ground, bodies[1])
    m.revolute("c", m.ground, bodies[2], effort=3.0)
    m.revolute("d", m.ground, bodies[3], limits=(-math.inf, math.inf))
    again = read_urdf(write_urdf(m))
    assert again.notes == []
    assert [j.limits for j in again.joints.values()] == [{"": (-1.0, math.inf)}, {}, {}, {}]
    assert again.joints["a"].velocity_limits == {"": 2.0} and again.joints["c"].effort_limits == {
        "": 3.0
    }
    assert 'type="prismatic"' in write_urdf(m) and 'lower="-1e+308"' in write_urdf(m)


def test_locks_become_fixed_joints():
    m = Mechanism("m")
    a, b, c, d = (m.body(n) for n in "abcd")
    m.revolute("a", m.ground, a, axis=(0, 1, 0), at=(1, 2, 3))
    m.helical("b", a, b, pitch=0.3, child_at=(0.1, 0, 0))
    m.revolute("c", b, c, at=(0.1, 0, 0))
    m.revolute("d", c, d, at=(0.1, 0, 0))
    m.couple("c", {"b": 2.0, "d": 0.5}, 0.1)
    m.lock({"b": 0.4})
    text = write_urdf(m)
    assert (
        text.count('type="fixed"') == 1
        and '<mimic joint="d" multiplier="0.5" offset="0.9"/>' in text
    )
    same_poses(m)
    m.lock({"d": 0.2})
    assert write_urdf(m).count('type="fixed"') == 3
    same_poses(m)


def test_planar_systems_turn_about_z():
    m = Mechanism("m", dim=2)
    a = m.body("a")
    b = m.body("b")
    m.revolute("q", m.ground, a, at=(1, 0), angle=0.3)
    m.planar("p", a, b, at=(0.5, 0), child_at=(0, 0.2), child_angle=0.1)
    same_poses(m)


def test_names_masses_and_visuals():
    m = Mechanism('<&">')
    m.body("a\tb'", mass=1.5, center=(1, 2, 3))
    m.shape("a\tb'", "mesh", path="a&b.stl", collision=False, name="<v>")
    m.revolute('"j"', m.ground, "a\tb'")
    m.frame("a frame", "a\tb'")
    again = read_urdf(write_urdf(m))
    assert (
        again.name == m.name
        and again.bodies["a\tb'"] == m.bodies["a\tb'"]
        and '"j"' in again.joints
    )
    assert again.joints["a frame_fixed"].child == "a frame"


def test_all_that_urdf_cannot_say_is_listed():
    m = Mechanism("m")
    a, b, c, d, e, f, g = (m.body(n) for n in "abcdefg")
    p = m.particle("p")
    m.revolute("ra", m.ground, a)
    m.helical("hb", a, b, pitch=0.1)
    m.universal("uc", b, c)
    m.spherical("sd", c, d, angles=True)
    m.revolute("re", d, e)
    m.revolute("loop", e, c)
    m.revolute("back", f, m.ground)
    m.helical("hl", d, b, pitch=0.1)
    m.free("pf", d, p)
    m.planar("pg", d, g, limits={"x": (0, 1)})
    m.couple("re", {"ra": 1.0, "back": 2.0})
    m.couple("pg.x", {"ra": 1.0})
    m.lock({"pg.y": 0.1})
    with pytest.raises(DescriptionError) as caught:
        write_urdf(m)
    said = str(caught.value)
    for piece in (
        "joint 'hl': it closes a loop, and cannot be said as a <loop_joint>",
        "body 'f': no joints lead to it from the ground in their own direction",
        "joint 'hb': a helical joint does not exist in URDF",
        "joint 'uc': a universal joint",
        "joint 'sd': a spherical joint by angles",
        "body 'p': it is a particle",
        "joint 'pg': limits of a planar joint",
        "joint 'pg': only pg.y of its coordinates are locked",
        "coordinate 're': it follows several coordinates (ra, back)",
        "coordinate 'pg.x': it is one of several coordinates",
    ):
        assert piece in said


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m.body("lost"), "body 'lost': no joints lead to it from the ground"),
        (lambda m: m.fixed("f", m.body("b"), "a"), "body 'b': no joints lead to it"),
        (lambda m: m.shape("a", "ellipsoid", radii=(1, 1, 2)), "ellipsoid does not exist in URDF"),
        (
            lambda m: m.shape("a", "sphere", radius=1, at=("1/(l - 1)", 0, 0)),
            "not a number with these parameters",
        ),
        (
            lambda m: m.constrain(Position("a", (1, 2, 3), at_most=0.1)),
            "a position does not exist in URDF",
        ),
        (
            lambda m: m.frame("t", "a", at=("1/(l - 1)", 0, 0)),
            "frame 't': its placement is not a number with these parameters",
        ),
        (
            lambda m: m.fixed("f", m.ground, "a", at=("1/(l - 1)", 0, 0)),
            "not a number with these parameters",
        ),
        (lambda m: m.frame("\x01", "a"), "a character that XML forbids"),
        (lambda m: m.free("z", "a", m.body("b"), angles=True), "a free joint by angles"),
        (
            lambda m: m.fixed("z", "a", m.body("b"), at=("1/(l - 1)", 0, 0)),
            "not a number with these parameters",
        ),
    ],
)
def test_one_reason_at_a_time(change, words: str):
    m = Mechanism("m")
    m.parameter("l", 1.0)
    m.revolute("j", m.ground, m.body("a"))
    change(m)
    with pytest.raises(DescriptionError, match=words):
        write_urdf(m)


def test_loops_are_between_the_same_frames():
    m = Mechanism("m")
    m.parameter("l", 0.4)
    a = m.body("a")
    b = m.body("b")
    m.revolute("y", m.ground, a, limits=(-1, 1))
    m.revolute("z", a, b, at=(1, 0, 0), limits=(-1, 1))
    m.revolute("r", b, m.ground, at=(1, 2, 3), axis=(1, 2, 2), child_at=(0.1, 0.2, 0.3))
    m.prismatic("p", a, b, rpy=(0.1, 0.2, 0.3), child_rpy=(0.3, 0.2, 0.1))
    m.fixed("f", b, a, at=(0, 0, 1), rpy=(0.1, 0.2, 0.3))
    m.spherical("s", m.ground, a, child_at=(0, "l", 0), child_rpy=(1, 0, 0))
    m.helical("h", m.ground, b, pitch=0.1, child_at=(0.3, 0, 0))
    m.lock({"h": 0.7})
    m.frame("tip", b, at=(0.1, 0.2, 0.3), rpy=(1, 2, 3))
    m.constrain(Position("tip", (1, "l", 3), (0.1, 0, 0)), name="<p>")
    m.constrain(Position("b", (1, 2, 3), other="a"), name="q")
    again = read_urdf(write_urdf(m))
    assert [j.name for j in again.joints.values() if j.cut] == ["r", "p", "f", "s", "h"]
    for name in "rpfsh":
        one, other = m.joints[name], again.joints[name]
        assert (one.parent, one.child) == (other.parent, other.child)
        assert other.type.type_name == ("fixed" if name == "h" else one.type.type_name)
        held = place((0, 0, 0.07), angle=0.7) if name == "h" else place()
        F = (one.X_PF @ held).evaluate_pose(m.parameters)
        np.testing.assert_allclose(other.X_PF.evaluate_pose({}), F, rtol=0, atol=1e-15)
        M = one.X_CM.evaluate_pose(m.parameters)
        np.testing.assert_allclose(other.X_CM.evaluate_pose({}), M, rtol=0, atol=1e-15)
    for name, points in {"<p>": ((1, 0.4, 3), (0.1, 0, 0)), "q": ((1, 2, 3), (0, 0, 0))}.items():
        one, other = m.constraints[name], again.constraints[name]
        assert (one.parent, one.child) == (other.parent, other.child)
        A, B = other.frames({}, 3)
        np.testing.assert_allclose(A[:3, 3], points[0], rtol=0, atol=1e-15)
        point = (one.X_CM @ place(points[1])).evaluate_pose({})
        np.testing.assert_allclose(B[:3, 3], point[:3, 3], rtol=0, atol=1e-15)


def test_marked_joints_close_the_loop_and_limits_stay_in_the_tree():
    m = Mechanism("m", dim=2)
    a, b = m.body("a"), m.body("b")
    m.revolute("p", m.ground, a)
    m.revolute("q", a, b, at=(1, 0))
    m.revolute("r", m.ground, b, at=(3, 0), child_at=(1, 0))

    def list_closing_joints() -> list[str]:
        return [j.name for j in read_urdf(write_urdf(m)).joints.values() if j.cut]

    assert list_closing_joints() == ["r"]
    m.joints["q"] = replace(m.joints["q"], cut=True)
    assert list_closing_joints() == ["q"]
    m.joints["q"] = replace(m.joints["q"], limits={"": (-1.0, 1.0)})
    assert list_closing_joints() == ["r"]
    m.couple("r", {"p": 1.0})
    with pytest.raises(DescriptionError, match="joint 'q': it closes a loop, and cannot be said"):
        write_urdf(m)


def test_what_is_left_out_is_said():
    m = Mechanism("m")
    m.revolute("j", m.ground, m.body("a"))
    m.posture("home--sweet", {"j": 1.0})
    assert "left out" in write_urdf(m) and "home- -sweet" in write_urdf(m)
    read_urdf(write_urdf(m))
