"""Singular targets of `ik_all`: self-motions, merged roots, and what is said and found where
nothing reaches.
"""

from __future__ import annotations

import math
from functools import cache

import analytic_oracle as oracle
import arms
import numpy as np
import pytest
from hunts import some
from linkages import planar_arm

import kempe
from kempe.errors import InputError
from kempe.inverse.explain_all import explain_target
from kempe.inverse.families import SolutionSet, find_families
from kempe.inverse.nearest import find_nearest_configuration

TURN = 2.0 * math.pi


@cache
def system(name: str) -> kempe.System:
    return arms.arms()[name].system


def apart(a, b) -> float:
    """The largest difference of a joint, modulo turns."""
    return float(np.abs((np.asarray(a) - b + math.pi) % TURN - math.pi).max())


def solved(name: str, q, task: str | None = None, frame: str = "tool", **options):
    """The answer for the target that q reaches, its families and the family of each row."""
    s = system(name)
    X = s.fk(np.asarray(q, dtype=float), frame)
    a = s.ik_all(X[: s.dim, 3] if task == "position" else X, frame, task=task, **options)
    families, rows = find_families(a, 0)
    return a, X, families, rows[: len(a)]


def reaches(s: kempe.System, q, X, task: str = "pose", frame: str = "tool") -> float:
    """The largest error [m, rad] of configurations by the forward model."""
    return float(np.max(oracle.error(s.fk(q, frame), X, task)))


# ---- families


def stretched(
    signs: list[float], links: list[float], turns: int = 1, rpy=(0.0, 0.0, 0.0)
) -> kempe.System:
    """An arm on its first axis, about which `turns` joints turn; the links lie along it, forwards
    or backwards.
    """
    m = kempe.Mechanism("stretched")
    body = m.body("base")
    m.fixed("mount", m.ground, body, at=(0.3, -0.2, 0.1), rpy=rpy)
    at = 0.3
    for i in range(turns + len(links)):
        new = m.body(f"b{i}")
        m.revolute(
            f"j{i}", body, new, at=(0.0, 0.0, at), axis=(0, 1, 0) if i >= turns else (0, 0, 1)
        )
        body = new
        at = signs[i - turns] * links[i - turns] if i >= turns else 0.0
    m.frame("e", body, at=(0.0, 0.0, at))
    return m.build()


def test_merged_roots_add_no_freedom():
    """Target on axis 1, arm stretched: axis 1 turns, the elbow is a double root. At first order two
    joints are free.
    """
    r = stretched([1.0, 1.0], [0.3, 0.1])
    a = r.ik_all(r.fk([0.3, 0.0, 0.0], "e")[:3, 3], "e")
    assert (
        a.status
        == "no isolated solution, and a family with one freedom: j0 is free while j1 = 0 and j2 = 0"
    )


@pytest.mark.slow
def test_freedoms_of_stretched_arms(hunt):
    """Random arms with the target on axis 1, stretched or with the elbow folded back: only turns
    about it are free.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(8)):
        turns = int(rng.integers(1, 3))
        k = int(rng.integers(1, 4))
        signs = [1.0] * k if k != 2 else [1.0, float(rng.choice([-1.0, 1.0]))]
        links = rng.uniform(0.1, 1.0, k)
        if k == 2:
            links[1] = links[0] * rng.uniform(0.2, 0.8)
        r = stretched(signs, links.tolist(), turns, tuple(rng.uniform(-3, 3, 3)))
        q = np.zeros(turns + k)
        q[:turns] = rng.uniform(-2, 2, turns)
        x = r.fk(q, "e")[:3, 3]
        families, _ = find_families(r.ik_all(x, "e"), 0)
        assert [f.freedoms for f in families] == [turns], (turns, signs, links)
        (f,) = families
        assert set(f.joints) <= {f"j{i}" for i in range(turns)}
        assert np.abs(r.fk(f.q, "e")[:, :3, 3] - x).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("length", "size"), [("d6", 1e6), ("d6", 1e8), ("d4", 1e4)])
def test_one_long_link_makes_no_family(length, size):
    """Regular configurations of a robot stay isolated with one very long link."""
    s = kempe.load("ur5").with_parameters(**{length: size})
    a = s.ik_all(s.fk(s.random(1, 20), "tool"), "tool")
    assert not [text for text in a.status if "famil" in text]
    assert not any(find_families(a, i)[0] for i in range(20))


def test_a_batch_says_that_matrices_are_no_rotations():
    """Poses rounded to two digits are finite; the single call and the batch name the same reason."""
    puma = kempe.load("puma560")
    X = puma.fk(puma.random(1, 3), "tool").round(2)
    X[2] = math.nan
    for ask in (puma.ik, puma.ik_all):
        with pytest.raises(InputError, match="must be orthonormal"):
            ask(X[0], "tool")
        answer = ask(X, "tool")
        assert (
            "must be orthonormal" in answer.status[0] and "must be orthonormal" in answer.status[1]
        )
        assert "must be finite" in answer.status[2]


def test_wrist_in_line():
    """Puma with q5 = 0: axes 4 and 6 are one line, only the sum of their angles counts (Paul,
    1981).
    """
    q = np.array([0.1, 0.2, 0.3, 0.4, 0.0, 0.6])
    a, X, families, rows = solved("puma560", q)
    (f,) = families
    assert f.freedoms == 1 and f.closed and f.joints == ("q4", "q6")
    assert reaches(a.system, f.q, X) < 1e-12 and len(f.q) > 50
    assert (
        np.ptp(f.q[:, 3]) > 6.0
        and np.abs(f.q[:, 3] + f.q[:, 5] - (f.q[0, 3] + f.q[0, 5])).max() < 1e-12
    )
    np.testing.assert_allclose(
        np.abs(f.basis[0]), [0, 0, 0, math.sqrt(0.5), 0, math.sqrt(0.5)], atol=1e-12
    )
    assert f.basis[0, 3] * f.basis[0, 5] < 0.0
    assert str(f) == "q4 + q6 = 1 while q5 = 0: one freedom"
    assert (
        f.distance(q) < 1e-12 and (rows == 0).sum() == 1 and (rows[a.multiplicity > 0] == -1).all()
    )
    assert len(a) - (rows == 0).sum() == 6  # the other shoulder and elbow, each with two wrists
    assert f.distance(q + [0, 0, 0, 0, 0, TURN]) < 1e-12
    assert f.distance(q + [0, 0, 0, 0, 1e-3, 0]) == pytest.approx(1e-3, rel=1e-6)
    assert f.distance(q + [0, 0, 0, 0.1, 0, 0]) == pytest.approx(0.05, rel=1e-6)
    assert f.distance([q, q]).shape == (2,)


def test_distances_from_a_bent_family_beside_dense_members(monkeypatch):
    """A family of the Stanford arm is bent so much that whole steps towards a point lead beyond it
    for ever.
    """
    arm = kempe.load("stanford")
    X = arm.fk(np.array([0.0, 0.0, 0.0, -0.483, -0.397, -0.822]), "tool")
    corrections = []
    minimise = SolutionSet.minimise_error

    def count(target: SolutionSet, *args):
        corrections.append(1)
        return minimise(target, *args)

    monkeypatch.setattr(SolutionSet, "minimise_error", count)
    families = arm.ik_all(X, "tool").families
    assert [f.closed for f in families] == [True, True] and len(corrections) < 4000
    turns = np.arange(6) != 2
    for f in families:
        members = f.sample(2000)
        for q in np.random.default_rng(0).uniform(-1.0, 1.0, (5, 6)) * np.where(turns, 3.0, 1.0):
            away = q - members
            away[:, turns] = np.mod(away[:, turns] + math.pi, TURN) - math.pi
            nearest = away[np.argmin((away**2).sum(axis=1))]
            assert f.distance(q) == pytest.approx(np.abs(nearest).max(), abs=3e-3)


def test_members_of_a_family():
    """Members are spaced evenly; where a joint has a value, they are the answers with it held."""
    q = np.array([0.1, 0.2, 0.3, 0.4, 0.0, 0.6])
    a, X, (f,), _ = solved("puma560", q)
    members = f.sample(7)
    assert members.shape == (7, 6) and reaches(a.system, members, X) < 1e-12
    np.testing.assert_allclose(np.abs(np.diff(members[:, 3])), TURN / 7, rtol=1e-9)
    assert f.distance(members).max() < 1e-12 and len(f.sample(1)) == 1
    held = a.system.ik_all(X, "tool", fixed={"q4": 1.1})
    one = held.q[np.argmin(f.distance(held.q))]
    assert f.distance(one) < 1e-10 and one[3] == 1.1 and abs(one[5] + 0.1) < 1e-10
    for n in (0, 1.5):
        with pytest.raises(InputError, match="n is"):
            f.sample(n)


def shoulder_singular(q5: float) -> np.ndarray:
    """A configuration of the anthropomorphic arm whose wrist centre lies on axis 1, by bisection of
    q3.
    """
    s = system("anthropomorphic6")

    def off(q3: float) -> float:
        X = s.fk(np.array([0.0, 0.9, q3, 0.0, 0.5, 0.0]), "tool")
        return float((X[:3, 3] - 0.1 * X[:3, 2])[0])

    grid = np.linspace(-3.0, 3.0, 100)
    k = next(k for k in range(99) if off(grid[k]) * off(grid[k + 1]) < 0.0)
    low = grid[k]
    high = grid[k + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if off(low) * off(middle) > 0.0 else (low, middle)
    return np.array([0.3, 0.9, low, 0.4, q5, 0.6])


@pytest.mark.slow
def test_shoulder_on_its_axis():
    """Wrist centre on axis 1: the arm turns about it, and the wrist keeps the orientation."""
    s = system("anthropomorphic6")
    q = shoulder_singular(0.5)
    a, X, families, rows = solved("anthropomorphic6", q)
    assert len(families) == 4 and set(rows.tolist()) == {0, 1, 2, 3}
    for f in families:
        assert f.freedoms == 1 and f.closed and f.joints == ("q1", "q4", "q5", "q6")
        assert reaches(s, f.q, X) < 1e-11
        np.testing.assert_allclose(f.q[:, 1:3], f.q[:1, 1:3].repeat(len(f), 0), atol=1e-10)
        assert reaches(s, f.sample(7), X) < 1e-10
        assert "q1 turns all the way round and q4, q5 and q6 follow" in str(f)
    assert min(f.distance(q) for f in families) < 1e-10


@pytest.mark.slow
def test_families_that_cross():
    """Shoulder and wrist singular at once: the arm turns about axis 1, and at one angle of it q4 is
    free too.
    """
    q = shoulder_singular(0.0)
    a, X, families, _ = solved("anthropomorphic6", q)
    assert all(reaches(a.system, f.q, X) < 1e-11 for f in families)
    joints = [f.joints for f in families]
    assert joints.count(("q1", "q4", "q5", "q6")) == 2 and joints.count(("q4", "q6")) == 2
    assert min(f.distance(q) for f in families) < 1e-10
    line = next(f for f in families if f.distance(q) < 1e-10)
    assert line.joints == ("q4", "q6")


def test_elbow_stretched_is_a_double_root():
    q = np.array([0.1, -0.7, 0.0, 0.4, 0.5, 0.6])
    a, _, families, rows = solved("ur5", q)
    assert families == [] and (rows == -1).all()
    k = int(np.argmin([apart(x, q) for x in a]))
    assert apart(a[k], q) < 1e-6 and a.multiplicity[k] == 2
    assert explain_target(a, 0).startswith("5 solutions, all of them, 1 of them a double root")


def test_puma_elbow_is_a_double_root():
    """The wrist centre as far as it goes: upper arm and forearm (a3, d4) in line."""
    q = np.array([0.1, 0.2, math.atan2(0.0203, 0.4318) - math.pi / 2, 0.4, 0.5, 0.6])
    a, _, families, _ = solved("puma560", q)
    assert families == [] and len(a) == 4 and (a.multiplicity == 2).all()
    assert min(apart(x, q) for x in a) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("q3", [0.9, 0.0])
def test_four_parallel_axes(q3):
    """UR5 with q5 = 0: axes 2, 3, 4 and 6 are parallel and move as a four-bar linkage. All its
    motions are found.
    """
    q = np.array([0.1, -0.7, q3, 0.4, 0.0, 0.6])
    a, X, families, rows = solved("ur5", q)
    s = a.system
    model = arms.arms()["ur5"].model
    assert (
        families
        and (rows[a.multiplicity == 0] >= 0).all()
        and (rows[a.multiplicity > 0] == -1).all()
    )
    for f in families:
        assert f.closed and f.joints == ("shoulder_lift", "elbow", "wrist_1", "wrist_3")
        assert reaches(s, f.q, X) < 1e-11
    assert min(f.distance(q) for f in families) < 1e-10
    # Newton from random starts ends on families, or at isolated solutions
    rng = np.random.default_rng(4)
    theta, done = oracle.newton(model, X, rng.uniform(-math.pi, math.pi, (60, 6)))
    theta = theta[done]
    single = model.condition(theta) > 1e-7
    assert 3 < (~single).sum() and 3 < single.sum()
    for x in theta[~single]:
        assert min(f.distance(x) for f in families) < 1e-5
    for x in theta[single]:
        assert min(f.distance(x) for f in families) > 1e-3


def test_two_equal_links_at_their_base():
    """A closed arm points anywhere: a circle."""
    s = planar_arm(0.5, 0.5)
    a = s.ik_all([0.0, 0.0], "tip")
    (f,), rows = find_families(a, 0)
    assert f.closed and f.joints == ("q1",) and np.ptp(f.q[:, 0]) > 6.0
    np.testing.assert_allclose(np.abs(f.q[:, 1]), math.pi, atol=1e-12)
    assert str(f) in (
        "q1 is free while q2 = 3.14159: one freedom",
        "q1 is free while q2 = -3.14159: one freedom",
    )
    assert f.distance([1.234, math.pi]) < 1e-12 and (rows[: len(a)] == 0).all()
    assert find_families(planar_arm(0.5, 0.4).ik_all([0.1, 0.0], "tip"), 0)[0] == []


def test_target_on_the_first_axis():
    """The tip of an anthropomorphic arm on axis 1: joint 1 is free, twice."""
    s = system("anthropomorphic3")
    a = s.ik_all([0.0, 0.0, 0.7], "tool")
    families, rows = find_families(a, 0)
    assert (
        len(families) == 2
        and {f.joints for f in families} == {("q1",)}
        and (rows[: len(a)] >= 0).all()
    )
    for f in families:
        assert np.abs(s.fk(f.q, "tool")[:, :3, 3] - [0.0, 0.0, 0.7]).max() < 1e-11
        assert str(f).startswith("q1 is free while q2 = ")


@pytest.mark.slow
def test_slides():
    """Two slides along one line: only their sum counts, without end."""
    m = kempe.Mechanism("slides")
    a = m.body("a")
    b = m.body("b")
    m.prismatic("x", m.ground, a, axis=(1, 0, 0))
    m.prismatic("y", a, b, axis=(-1, 0, 0))
    m.frame("tip", b)
    s = m.build()
    answer = s.ik_all([0.3, 0.0, 0.0], "tip")
    (f,), _ = find_families(answer, 0)
    assert not f.closed and f.freedoms == 1 and str(f).startswith("x - y = 0.3")
    assert np.abs(f.q[:, 0] - f.q[:, 1] - 0.3).max() < 1e-12 and f.distance([1.0, 0.7]) < 1e-12
    members = f.sample(9)
    assert np.abs(members[:, 0] - members[:, 1] - 0.3).max() < 1e-12
    assert np.ptp(np.diff(members[:, 0])) < 1e-9


def test_geared_wrist():
    """A wrist whose first joint follows a motor 2 to 1: 2 m + j3 is constant."""
    rows = [
        arms.Joint(follow=(2.0, 0.3)),
        arms.Joint(rpy=(math.pi / 2, 0, 0)),
        arms.Joint(rpy=(-math.pi / 2, 0, 0)),
    ]
    s = arms.joints("geared", rows, "", 2).system
    q = s.q({"motor1": 0.2, "j2": 0.0, "j3": 0.5})
    X = s.fk(q, "tool")
    a = s.ik_all(X, "tool", task="orientation")
    (f,), _ = find_families(a, 0)
    assert str(f) == "2 motor1 + j3 = 0.9 while j2 = 0: one freedom"
    assert f.distance(q) < 1e-12 and reaches(s, f.q, X, "orientation") < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("name", ["panda", "iiwa14"])
def test_redundant_arms(name):
    """Seven joints: each answer lies on a self-motion, the configuration that made the target too."""
    q = system(name).random(3)
    a, X, families, rows = solved(name, q)
    assert (rows >= 0).all() and all(f.freedoms == 1 and f.closed for f in families)
    for f in families:
        assert reaches(a.system, f.q, X) < 1e-11
        assert np.abs(a.system.jacobian(f.q[0], "tool") @ f.basis[0]).max() < 1e-10
    assert min(f.distance(q) for f in families) < 1e-10
    assert max(families[i].distance(x) for x, i in zip(a, rows, strict=True)) < 1e-10
    joint = a.system.coordinate_names[6]
    assert find_families(a.system.ik_all(X, "tool", fixed={joint: q[6]}), 0)[0] == []


@pytest.mark.slow
def test_more_freedoms_than_one():
    """Six joints for a position: three freedoms."""
    q = np.array([0.1, -0.7, 0.9, 0.4, 0.5, 0.6])
    a, X, families, rows = solved("ur5", q, "position")
    assert (rows >= 0).all() and {f.freedoms for f in families} == {3}
    for f in families:
        assert (
            reaches(a.system, f.q, X, "position") < 1e-11
            and f.basis.shape == (3, 6)
            and not f.closed
        )
        J = a.system.jacobian(f.q[0], "tool")[:3]
        assert np.abs(J @ f.basis.T).max() < 1e-10 and np.linalg.matrix_rank(f.basis) == 3
    assert min(f.distance(q) for f in families) < 1e-10
    members = families[0].sample(100)
    assert members.shape == (100, 6) and reaches(a.system, members, X, "position") < 1e-10
    held = a.system.ik_all(X[:3, 3], "tool", fixed={"wrist_1": 0.3, "wrist_2": 0.2, "wrist_3": 0.1})
    assert len(held) and min(f.distance(held.q).min() for f in families) < 1e-10
    assert str(families[0]).endswith("can move: three freedoms")


def test_families_for_which_an_answer_has_no_room():
    """A spherical wrist given by angles about z, y, x, singular in all four postures of shoulder
    and elbow.
    """
    q = arms.arms()["ball_wrist"].random(2, 1)[0]
    q[4] = math.pi / 2
    a, X, families, _ = solved("ball_wrist", q)
    assert len(families) == 4 and min(f.distance(q) for f in families) < 1e-10
    assert all(
        f.joints == ("j4.rz", "j4.rx") and reaches(a.system, f.q, X) < 1e-11 for f in families
    )
    assert {str(f).split(" = ")[0] for f in families} == {"j4.rz + j4.rx", "j4.rz - j4.rx"}


@pytest.mark.parametrize("name", ["puma560", "ur5", "anthropomorphic6"])
def test_regular_targets_have_no_families(name):
    a, _, families, rows = solved(name, arms.arms()[name].random(1, 1)[0])
    assert families == [] and (rows == -1).all() and len(a)


NEAR = [("puma560", [4]), ("ur5", [4]), ("ur5", [2]), ("ur5", [2, 4]), ("anthropomorphic6", [4])]


@pytest.mark.slow
@pytest.mark.parametrize("name,joints", some(NEAR, 3))
def test_near_singular_targets_are_covered(name, joints):
    """However near to singular: the configuration that made a target is an answer, or on a family
    of answers.
    """
    rng = np.random.default_rng(6)
    for exponent in np.arange(-15.0, -2.0):
        q = rng.uniform(-1.5, 1.5, 6)
        q[joints] = (
            10.0**exponent
            * rng.choice([-1.0, 1.0], len(joints))
            * rng.uniform(0.3, 1.0, len(joints))
        )
        a, X, families, rows = solved(name, q)
        alone = [apart(x, q) for x, row in zip(a, rows, strict=True) if row < 0]
        assert min([*alone, *(f.distance(q) for f in families)]) < 2e-6, exponent
        assert all(reaches(a.system, f.q, X) <= 1.5e-9 for f in families)


def test_a_family_within_the_tolerance_says_so():
    q = np.array([0.1, 0.2, 0.3, 0.4, 1e-11, 0.6])
    a, X, (f,), _ = solved("puma560", q)
    assert 1e-12 < f.residual < 1e-10 and "on target within" in str(f)
    assert reaches(a.system, f.q, X) == pytest.approx(f.residual, rel=0.5)
    assert solved("puma560", [0.1, 0.2, 0.3, 0.4, 1e-6, 0.6])[2] == []


# ---- nearest configurations


@pytest.mark.parametrize("target", [(1.2, 0.3), (0.0, 2.0), (-0.02, 0.05), (0.0, 0.0)])
def test_two_links_out_of_reach(target):
    """The closest of a two-link arm: stretched towards the target, or folded."""
    l1 = 0.5
    l2 = 0.4
    s = planar_arm(l1, l2)
    d = math.hypot(*target)
    a = s.ik_all(target, "tip")
    q, position, angle = find_nearest_configuration(a, 0)
    wanted = max(d - l1 - l2, l1 - l2 - d)
    assert len(a) == 0 and position == pytest.approx(wanted, abs=1e-9) and angle == 0.0
    assert np.linalg.norm(s.fk(q, "tip")[:2, 3] - target) == pytest.approx(wanted, abs=1e-9)
    text = explain_target(a, 0)
    assert text.startswith(
        f"no solution: outside the workspace by at least {wanted:.6g} m, by the lengths of the lin"
    )
    assert text.endswith(f"the closest configuration found misses it by {wanted:.6g} m")


def test_a_direction_beyond_a_limit():
    """One joint from -0.5 to 0.5 about x: the direction (0, 1, 0) is a right angle away from z, on
    the wrong side.
    """
    m = kempe.Mechanism("head")
    b = m.body("b")
    m.revolute("A", m.ground, b, axis=(1, 0, 0), limits=(-0.5, 0.5))
    m.frame("tip", b)
    s = m.build()
    a = s.ik_all([0.0, 1.0, 0.0], "tip", task="direction")
    q, position, angle = find_nearest_configuration(a, 0)
    assert q[0] == pytest.approx(-0.5, abs=1e-12) and position == 0.0
    assert angle == pytest.approx(math.pi / 2 - 0.5, abs=1e-10)
    assert (
        f"none inside the limits (the nearest to them has 'A' {math.pi / 2 - 0.5:.6g} rad beyond"
        in explain_target(a, 0)
    )


def test_a_tilted_direction():
    """A direction that leaves the plane in which the tool turns: the angle to the plane is missed."""
    m = kempe.Mechanism("head")
    b = m.body("b")
    m.revolute("A", m.ground, b, axis=(1, 0, 0))
    m.frame("tip", b)
    s = m.build()
    a = s.ik_all([math.sin(0.2), math.cos(0.2), 0.0], "tip", task="direction")
    q, _, angle = find_nearest_configuration(a, 0)
    assert len(a) == 0 and angle == pytest.approx(0.2, abs=1e-9)
    assert q[0] == pytest.approx(-math.pi / 2, abs=1e-6)
    assert (
        "no solution: the task has 2 equations, but the chain moves this frame in 1 freedom only"
        in explain_target(a, 0)
    )


def test_joints_that_are_held_stay():
    q = system("panda").random(5)
    X = system("panda").fk(q, "tool")
    X[:3, 3] *= 3.0
    a = system("panda").ik_all(X, "tool", start=q, fixed={"panda_joint7": q[6]})
    x, position, _ = find_nearest_configuration(a, 0)
    assert len(a) == 0 and x[6] == pytest.approx(q[6], abs=1e-12) and position > 0.5
    free, least, _ = find_nearest_configuration(system("panda").ik_all(X, "tool", start=q), 0)
    assert least <= position + 1e-9
    assert np.all(x >= a.system.lower - 1e-9) and np.all(x <= a.system.upper + 1e-9)


# ---- sentences


def test_sentences_of_what_is_reached():
    q = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    s = system("puma560")
    plain = "axes 4, 5, 6 meet in a point (closed form)"
    assert (
        explain_target(s.ik_all(s.fk(q, "tool"), "tool"), 0)
        == f"8 solutions, all of them, 4 inside the limits: {plain}"
    )
    q[4] = 0.0
    text = explain_target(s.ik_all(s.fk(q, "tool"), "tool"), 0)
    assert text == (
        "6 solutions, all of them, 3 inside the limits, and a family with one freedom: q4 + q6 = 1 "
        "while q5 = 0"
    )
    u = system("ur5")
    assert explain_target(u.ik_all(u.fk([0.1, -0.7, 0.9, 0.4, 0.3, 0.6], "tool"), "tool"), 0) == (
        "8 solutions, all of them: axes 2, 3, 4 are parallel (closed form)"
    )


def test_sentences_of_what_is_not():
    """Puma: the wrist centre is d3 = 0.15005 from axis 1 at least; a2, (a3, d4) and d3 bound its
    distance.
    """
    s = system("puma560")
    X = s.fk([0.1, 0.2, 0.3, 0.4, 0.5, 0.6], "tool")
    X[:3, 3] = 0.9, 0.0, 0.8
    over = math.hypot(0.9, 0.8) - math.hypot(0.4318 + math.hypot(0.4318, 0.0203), 0.15005)
    text = explain_target(s.ik_all(X, "tool"), 0)
    assert (
        f"no angle of 'q3' brings the point where axes 4, 5, 6 meet to its distance: {over:.6g} m "
        "too far" in text
    )
    X[:3, 3] = 0.03, 0.04, 0.5
    text = explain_target(s.ik_all(X, "tool"), 0)
    assert (
        "no angle of 'q1' brings the point where axes 4, 5, 6 meet to its height: 0.10005 m off"
        in text
    )
    assert "the closest configuration found inside the limits misses it by 0.10005 m" in text


def test_sentence_of_a_chain_with_few_joints():
    s = system("so101")
    X = s.fk([0.1, 0.2, 0.3, 0.4, 0.5], "tool")
    X[:3, 3] += 0.0, 0.02, 0.01
    assert (
        "no solution: the task has 6 equations, but the chain moves this frame in 5 freedoms only"
        in explain_target(s.ik_all(X, "tool"), 0)
    )


def test_sentence_of_a_planar_system():
    assert "outside the plane of the system by 0.1 m" in explain_target(
        planar_arm(0.5, 0.5).ik_all([0.3, 0.2, 0.1], "tip"), 0
    )


def leg(lengths, knee):
    """A leg: three axes of a hip that meet, a knee, two axes of an ankle that meet."""
    m = kempe.Mechanism("leg")
    below = m.ground
    axes = [(0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 1, 0), (0, 1, 0), (1, 0, 0)]
    heights = [0, 0, 0, *lengths, 0]
    for i, (axis, height) in enumerate(zip(axes, heights, strict=True)):
        body = m.body(f"b{i}")
        limits = knee if i == 3 else (-2.5, 2.5)
        m.revolute(f"j{i}", below, body, at=(0, 0, -height), axis=axis, limits=limits)
        below = body
    m.frame("sole", below, at=(0, 0, -0.1))
    return m.build()


def test_a_double_root_at_a_limit_is_inside_it(hunt):
    """A stretched leg whose knee ends there: rounding moves the two roots, which are one, beyond
    the limit.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        end = rng.choice([0.0, np.pi])
        system = leg(
            rng.uniform(0.2, 0.6, 2), (end, end + 2.0) if rng.random() < 0.5 else (end - 2.0, end)
        )
        q = rng.uniform(-1.0, 1.0, 6)
        q[3] = end
        answer = system.ik_all(system.fk(q, "sole"), "sole", limits=True)
        assert len(answer) >= 1, answer.status
        assert np.abs(answer.q - q).max(axis=1).min() < 1e-6
        assert np.all((answer.q >= system.lower) & (answer.q <= system.upper))
        assert np.abs(system.fk(answer.q, "sole") - system.fk(q, "sole")).max() < 1e-9


@pytest.mark.parametrize("size", [1e-3, 1.0, 1000.0])
def test_a_slide_at_its_limit_is_inside_it_whatever_the_size_of_the_arm(size, hunt):
    """Rounding grows with the lengths: a slide of an arm of 1000 m was 1.07e-10 m beyond the limit
    at which it was.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        m = kempe.Mechanism()
        body = m.ground
        for k, kind in enumerate(rng.permutation(["revolute"] * 4 + ["prismatic"] * 2).tolist()):
            at = tuple(size * rng.uniform(-1.0, 1.0, 3))
            axis = tuple(rng.normal(size=3))
            limits = (-2.0, 2.0) if kind == "revolute" else (-0.3 * size, 0.4 * size)
            child = m.body(f"b{k}")
            getattr(m, kind)(f"q{k}", body, child, at=at, axis=axis, limits=limits)
            body = child
        m.frame("tip", body, at=tuple(size * rng.uniform(-1.0, 1.0, 3)))
        system = m.build()
        q = system.random(rng)
        slides = system.upper != 2.0
        q[slides] = [rng.choice([system.lower[i], system.upper[i]]) for i in np.flatnonzero(slides)]
        answer = system.ik_all(system.fk(q, "tip"), "tip", limits=True)
        assert len(answer), answer.status
        assert np.abs((answer.q - q) / np.where(slides, size, 1.0)).max(axis=1).min() < 1e-5
