"""One tolerance: rounded overconstrained mechanisms move like the exact ones, by all verbs; locked
ones do not.

The judge is the mechanism with the exact numbers of its construction: its closed configurations,
and its velocities by differences of them.
"""

from __future__ import annotations

import itertools
import math
import pickle
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hunts import some
from rounded import FAMILIES, NAMES, exact, in_place, perturbed, rounded, spherical_triples

import kempe
from kempe import Mechanism, System
from kempe.assemble import nearest_exact
from kempe.budget import check_for_stop
from kempe.errors import InputError, TimeLimitError
from kempe.model.characteristic_length import compute_characteristic_length
from kempe.numerics import clock
from kempe.poses import Placement
from kempe.spatial import rot_x, rot_y, rot_z

ENOUGH = 20
"""Points of a path that is one."""
CASES = pytest.mark.parametrize("name", some(NAMES, 3))


def of(name: str, digits: int, hunt) -> tuple[System, System, np.ndarray]:
    system = exact(name)
    return (
        system,
        rounded(system, digits, hunt.rng()),
        system.q("closed") if system.structure.posture_names else system.mid,
    )


def moves_like(system: System, given: System, digits: int, tolerance: float | str | None) -> None:
    """One freedom, closed, traced round, velocities right: by all verbs."""
    more: dict[str, Any] = {} if tolerance is None else {"tolerance": tolerance}
    off = 10.0**-digits
    driver = system.coordinate_names[0]
    other = system.coordinate_names[1]
    m: Any = given.mobility(**more)
    assert (
        m.dof == 1
        and m.closed
        and not m.certain
        and "within" in m.sentence
        and m.within.tolerance < 3.0 * off
    )
    start = (
        system.q("closed")[0]
        if "closed" in system.structure.posture_names
        else system.assemble().q[0]
    )
    answer: Any = given.assemble({driver: start + 0.1}, **more)
    assert answer and answer.residual < 1e-12 and "within" in answer.status
    ideal = answer.within.system
    path = given.trace(driver, **more)
    assert path.success and path.closed and "within" in path.status
    assert np.abs(ideal.loops.closure_error(path.q)).max() < 1e-11
    assert np.abs(given.loops.closure_error(path.q)).max() < 30.0 * off
    truth = system.assemble(start=path.q, limits=False, prefer="nearest")
    assert (
        np.all(truth.success)
        and np.abs(truth.q - path.q).max() < 100.0 * math.sqrt(off)
        and np.median(np.abs(truth.q - path.q).max(axis=1)) < 100.0 * off
    )
    assert given.drive({driver: start + np.linspace(0.0, 0.2, 5)}, **more).success
    assert (
        given.independent(answer.q, **more).dim == 1
        and given.classify(answer.q, **more).position_dof == 1
    )
    found = given.loops.jacobian(answer.q, [driver], [other], **more)
    near = system.assemble({driver: start + 0.1}, start=answer.q).q
    h = 1e-5
    a, b = (system.assemble({driver: near[0] + s * h}, start=near).q[1] for s in (-1.0, 1.0))
    assert found and abs(found.matrix[0, 0] - (b - a) / (2.0 * h)) < 1e3 * off + 1e-8
    gain = given.loops.mechanical_advantage(answer.q, driver, other, **more)
    assert gain == pytest.approx(1.0 / found.matrix[0, 0], rel=1e-9)
    assert (
        len(given.assembly_modes({driver: start + 0.1}, **more, budget=kempe.Budget(starts=64)))
        >= 1
    )


@pytest.mark.slow
@CASES
def test_rounded_to_six_digits_moves_as_if_exact(name, hunt):
    system, given, _ = of(name, 6, hunt)
    moves_like(system, given, 6, None)


@pytest.mark.slow
@pytest.mark.parametrize("digits", [3, 4, 6, 8, 10, 12])
@CASES
def test_rounded_mechanisms_move_within_what_is_measured(name, digits, hunt):
    system, given, _ = of(name, digits, hunt)
    moves_like(system, given, digits, "measured")


@pytest.mark.parametrize("name", NAMES)
def test_exact_mechanisms_are_left_alone(name):
    system = exact(name)
    assert system.idealise(None) is None and system.idealise() is None
    assert system.assemble().within is None and system.mobility().within is None


@pytest.mark.parametrize(
    "name", some(["bennett", "schatz", "bricard_trihedral", "sarrus", "four_bar_spatial"], 3)
)
def test_mechanisms_that_are_off_by_more_than_rounding_are_locked(name, hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(4)):
        system = exact(name)
        given = perturbed(system, 10.0 ** rng.uniform(-3, -2) * 0.3, rng)
        m = given.mobility()
        assert given.idealise(None) is None and m.dof in (0, None) and m.within is None


def random_loop(rng: np.random.Generator) -> System:
    """Hinges anywhere in a loop that is closed at zero angles."""
    m = Mechanism("loop")
    n = int(rng.integers(3, 7))
    bodies = [m.ground, *(m.body(f"b{i}") for i in range(n - 1))]
    for i in range(n):
        place = {"at": rng.uniform(-0.5, 0.5, 3), "axis": rng.normal(size=3)}
        more = {f"child_{k}": v for k, v in place.items()}
        m.revolute(f"q{i}", bodies[i], bodies[(i + 1) % n], **place, **more)
    return m.build()


@pytest.mark.parametrize("tolerance", [None, pytest.param("measured", marks=pytest.mark.slow)])
def test_random_loops_are_no_mechanisms_within_any_tolerance(tolerance, hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(20)):
        system = random_loop(rng)
        assert system.idealise(tolerance) is None and system.mobility().dof == 0


def spatial_four_bar(angle: float) -> System:
    """A four-bar of a plane in space, one pin of which is turned by an angle that should be a right
    one.
    """
    m = Mechanism("four-bar")
    a, b, c = (m.body(x) for x in "abc")
    m.revolute("A", m.ground, a, rpy=(math.pi / 2, 0, 0))
    m.revolute("B", a, b, at=(0.1, 0, 0))
    m.revolute("C", b, c, at=(0.5, 0, 0), child_at=(0.4, 0, 0))
    m.revolute("D", m.ground, c, at=(0.4, 0, 0), rpy=(angle, 0, 0))
    return m.build()


def test_an_angle_near_a_right_one_is_made_one():
    given = spatial_four_bar(1.5708)
    right = spatial_four_bar(math.pi / 2)
    found: Any = given.idealise()
    assert (
        "1.5708" in found.changes[0].old
        and found.changes[0].new == "roll pi/2"
        and len(found.changes) == 1
    )
    assert found.tolerance == pytest.approx(1.5708 - math.pi / 2) and found.freedoms == 1
    assert set(found.absorbed) <= set(given.structure.closures)
    np.testing.assert_allclose(given.trace("A").length, right.trace("A").length, rtol=1e-9)
    report = given.mobility()
    assert "'D' on its parent" in str(report) and "would lock it" in report.sentence
    assert report.data()["within"]["freedoms"] == 1


def test_answers_say_the_same_after_pickling():
    s = spatial_four_bar(1.5708)
    q = s.assemble({"A": 0.4}).q
    for answer in (
        s.assemble({"A": 0.4}),
        s.trace("A", q),
        s.mobility(q),
        s.independent(q),
        s.idealise(),
    ):
        again = pickle.loads(pickle.dumps(answer))
        assert str(again) == str(answer) and "within" in str(again)
        assert (
            getattr(again, "within", again).tolerance == getattr(answer, "within", answer).tolerance
        )
    assert pickle.loads(pickle.dumps(s))._ideal is None


@pytest.mark.slow
@pytest.mark.parametrize("off", some([1e-13, 1e-12, 1e-11, 1e-9], 2))
def test_all_verbs_agree_where_lengths_are_off_by_rounding(off):
    m = kempe.load("bennett").mechanism
    m.parameters["a"] *= 1.0 + off
    joint = m.joints["q4"]
    m.joints["q4"] = type(joint)(
        **{**vars(joint), "X_CM": exact("bennett").mechanism.joints["q4"].X_CM}
    )
    m = perturbed(m.build(), off, np.random.default_rng(0))
    assert m.mobility().dof == 1 and m.assemble() and m.trace("q1").closed
    assert m.drive({"q1": [1.0, 1.2]}).success and m.independent(m.assemble().q).dim == 1


def all_agree(given: System, dof: int = 1) -> None:
    """Every verb says that it closes with so many freedoms, and `ik` reaches what `fk` gives."""
    home = given.assemble()
    q = home.q
    driver = given.coordinate_names[0]
    frame = given.body_names[-1]
    at = q[0]
    report = given.mobility(q)
    path = given.trace(driver, start=q)
    assert home and report.closed and report.dof == dof and given.classify(q).position_dof == dof
    assert path.success and path.closed and len(path) > ENOUGH, path.status
    assert given.drive({driver: at + np.linspace(0.0, 0.1, 4)}, start=q).success
    assert given.assemble({driver: at + 0.05}, start=q) and given.independent(q).dim == dof
    assert (
        len(given.assembly_modes({driver: at + 0.05}, start=q, budget=kempe.Budget(starts=16))) >= 1
    )
    poses = given.fk(np.array([q, given.assemble({driver: at + 0.02}, start=q).q]), frame)
    answer = given.ik(poses[0], frame, start=q)
    assert answer and answer.judged and np.abs(answer.q - q).max() < 1e-9, answer.status
    assert given.ik_path(poses, frame, start=q), given.ik_path(poses, frame, start=q).status
    assert (answer.within is None) == (home.within is None)


def tolerates(system: System, tolerance: float | str) -> System:
    """The system with a tolerance of its dimensions."""
    m = system.mechanism
    m.tolerance = tolerance
    return m.build()


@pytest.mark.parametrize(
    "name", some(["spherical_triples", "bennett", "three_cranks", "sarrus"], 3)
)
def test_all_verbs_agree_about_rounded_mechanisms(name, hunt):
    rng = hunt.rng()
    digits = int(rng.integers(3, 15))
    given = rounded(exact(name), digits, rng)
    all_agree(tolerates(given, "measured") if digits < 7 else given)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_hunt_all_verbs_agree_about_mechanisms_rounded_or_perturbed(name, hunt):
    """At 3 to 14 decimals with the frames of bodies anywhere, and off by 1e-16 to 1e-3."""
    rng = hunt.rng()
    system = exact(name)
    for k in range(hunt.cases(76)):
        if k % 2:
            off = 10.0 ** rng.uniform(-16.0, -3.0)
            given = perturbed(system, 0.3 * off, rng)
        else:
            digits = int(rng.integers(3, 15))
            given = rounded(system, digits, rng)
            off = 10.0**-digits
        all_agree(tolerates(given, "measured") if off > 1e-7 else given)


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_hunt_families_of_the_literature_move_when_rounded(family, hunt):
    """With random dimensions, at 3 to 6 decimals, and the frames of bodies anywhere."""
    rng = hunt.rng()
    count = 0
    for _ in range(hunt.cases(50)):
        system, freedoms = FAMILIES[family](rng)
        if system is None:
            continue
        count += 1
        digits = int(rng.integers(3, 7))
        given = rounded(system, digits, rng)
        if 10.0**-digits > 0.4 * nearest_exact.WIDEST * compute_characteristic_length(system):
            continue  # the largest tolerance may be smaller than what rounding has changed
        found: Any = given.idealise()
        assert (
            found is not None
            and found.freedoms == freedoms
            and found.tolerance < 10.0 * 10.0**-digits
        )
    assert count > 0.3 * hunt.cases(50)


@pytest.mark.slow
def test_a_platform_whose_rounded_legs_nearly_close_at_single_places_moves():
    """Changes of 1e-7 make a structure of it there; those of 4e-4, as large as rounding, the
    mechanism that was meant.

    The conditions on its dimensions have a nearly double root.
    """
    rng = np.random.default_rng([0, 3])
    T = np.eye(4)
    T[:3, :3] = rot_z(rng.uniform(-3, 3)) @ rot_y(rng.uniform(-1, 1)) @ rot_x(rng.uniform(-3, 3))
    T[:3, 3] = rng.uniform(-0.5, 0.5, 3)
    given = rounded(kempe.load("delta_uu"), 3, rng, ground=T)
    found: Any = given.idealise()
    assert found.freedoms == 3 and 1e-4 < found.tolerance < 1e-3
    assert given.idealise(None) is None


@pytest.mark.parametrize(("seed", "digits"), [(5, 3), (6, 4)])
def test_a_mechanism_that_closes_exactly_only_where_it_is_flat_moves(seed, digits):
    """Far from home the given numbers close, and nothing moves there: the rank is read at home."""
    given = rounded(exact("double_parallelogram"), digits, np.random.default_rng(seed))
    found: Any = given.idealise()
    assert found is not None and found.freedoms == 1 and found.tolerance < 3.0 * 10.0**-digits
    assert given.mobility(tolerance="measured").dof == 1


@pytest.mark.parametrize(("seed", "digits"), [(1, 5), (5, 5), (15, 3)])
def test_a_mechanism_drawn_flat_moves_when_rounded(seed, digits):
    """Motions cross at home, where the given numbers close, or nearly, so that it seems to be
    rigid.
    """
    m = exact("double_parallelogram").mechanism
    rng = np.random.default_rng([1, seed, 7])
    m.postures = {}
    assert int(rng.integers(3, 7)) == digits
    given = rounded(m.build(), digits, rng)
    found: Any = given.idealise()
    assert found is not None and found.freedoms == 1 and found.tolerance < 3.0 * 10.0**-digits


@pytest.mark.slow
def test_hunt_mechanisms_drawn_flat_move_when_rounded(hunt):
    rng = hunt.rng()
    m = exact("double_parallelogram").mechanism
    m.postures = {}
    for _ in range(hunt.cases(20)):
        digits = int(rng.integers(3, 7))
        found: Any = rounded(m.build(), digits, rng).idealise()
        assert found is not None and found.freedoms == 1 and found.tolerance < 3.0 * 10.0**-digits


@pytest.mark.parametrize("off", [1e-13, 1e-12])
def test_what_assemble_calls_closed_is_traced_and_driven_where_no_ideal_is_searched(off, hunt):
    """Of more coordinates than the search takes, off by more than rounding and less than `assemble`
    tolerates.
    """
    rng = hunt.rng()
    joints = []
    for i, p in enumerate(rng.uniform(-1.0, 1.0, (31, 2))):
        joints += [("", f"crank{i}", p, None), (f"crank{i}", "coupler", p + [0.25, 0.31], None)]
    given = perturbed(in_place("cranks", joints, 2), off, rng)
    answer = given.assemble()
    assert (
        given.nv > nearest_exact.MOST
        and answer
        and answer.within is None
        and answer.residual > 1e-13
    )
    assert given.mobility(answer.q, local=False).closed
    path = given.trace("q0", start=answer.q, budget=kempe.Budget(points=5))
    assert len(path) > 3 and "do not close" not in path.status
    assert np.abs(given.loops.closure_error(path.q)).max() < 1e-9
    assert given.drive({"q0": answer.q[0] + np.linspace(0.0, 0.1, 3)}, start=answer.q).success


@pytest.mark.parametrize("off", [1e-13, 1e-12, 1e-11])
def test_cranks_whose_home_is_flat_are_traced_whatever_their_lengths_are_off_by(off):
    """Home is singular, so that it says nothing of the rank along the motion."""
    m = Mechanism("three cranks", dim=2)
    m.body("coupler")
    for i in range(3):
        m.revolute(f"A{i}", m.ground, m.body(f"crank{i}"), at=(i, 0))
        m.revolute(f"B{i}", f"crank{i}", "coupler", at=(1.0 + off * (i == 1), 0), child_at=(i, 0))
    given = m.build()
    q = given.assemble({"A0": 1.0}).q
    assert given.mobility(q).dof == 1 and given.trace("A0", start=q).closed


@pytest.mark.parametrize("off", [2e-14, 5e-14, 1e-13, 2e-13])
def test_a_length_off_by_little_more_than_rounding_is_traced_all_round(off):
    given = kempe.load("bennett")
    m = given.mechanism
    joint = m.joints["q2"]
    m.joints["q2"] = replace(joint, X_PF=Placement((*joint.X_PF.steps, ("x", (off,)))))
    given = m.build()
    q = given.assemble({"q1": 0.4}).q
    assert given.mobility(q).dof == 1 and given.trace("q1", start=q).closed


def test_tasks_of_a_rounded_mechanism_hold_where_they_were_read(hunt):
    given = tolerates(rounded(exact("bennett"), 4, hunt.rng()), "measured")
    q = given.assemble({given.coordinate_names[0]: 0.7}).q
    frames = given.body_names[1:]
    wanted = [kempe.tasks.Position(f, given.fk(q, f)[:3, 3]) for f in frames]
    answer = given.ik(wanted, start=q)
    assert (
        answer and answer.judged and "within" in answer.status and np.abs(answer.q - q).max() < 1e-6
    )
    step = given.ik_step(q, given.fk(q, frames[-1]), frames[-1], 0.01)
    assert step.success and np.abs(step.q - q).max() < 1e-6


def hanging(count: int, digits: int, rng: np.random.Generator) -> System:
    """A free body with four-bars in space that hang on it one by one, their placements rounded."""
    m = Mechanism("legs")
    base = m.body("base")
    m.free("base joint", m.ground, base)
    for k in range(count):
        turn = {"rpy": (0.4 * k, 0.3, 0.2)}
        a, b, c = (m.body(f"{x}{k}") for x in "abc")
        m.revolute(f"A{k}", base, a, at=(0.1 * k, 0, 0), **turn)
        m.revolute(f"B{k}", a, b, at=(0.1, 0, 0))
        m.revolute(f"C{k}", b, c, at=(0.5, 0, 0), child_at=(0.4, 0, 0))
        far = kempe.poses.place((0.1 * k, 0, 0), **turn) @ kempe.poses.place((0.4, 0, 0))
        m.joints[f"D{k}"] = replace(m.revolute(f"D{k}", base, c), X_PF=far)
    return rounded(m.build(), digits, rng)


@pytest.fixture
def sizes(monkeypatch) -> list[int]:
    """Numbers of velocities of the systems whose dimensions are changed."""
    out: list[int] = []
    before = nearest_exact.Dimensions.__init__

    def init(self, system):
        out.append(system.nv)
        before(self, system)

    monkeypatch.setattr(nearest_exact.Dimensions, "__init__", init)
    return out


def test_parts_that_share_no_joint_are_compared_one_by_one(hunt, monkeypatch, sizes):
    """So a robot of many loops costs as much as its loops, and may have any number of coordinates."""
    monkeypatch.setattr(nearest_exact, "MOST", 20)
    given = hanging(5, 6, hunt.rng())
    assert given.nv == 26 > nearest_exact.MOST
    answer = given.assemble()
    assert (
        answer
        and answer.within is not None
        and answer.within.freedoms == 6 + 5
        and answer.residual < 1e-12
    )
    assert set(sizes) == {4} and set(answer.within.absorbed) == set(given.structure.closures)


def test_loops_whose_joints_follow_motors_outside_are_compared_one_by_one(hunt, sizes):
    """A motor that no loop passes drives a crank by a gear: the loop's freedom is the motor's."""
    m = hanging(3, 6, hunt.rng()).mechanism
    for k in range(3):
        m.revolute(f"M{k}", "b1", m.body(f"rotor{k}"), at=(0.1, 0.2, 0.3))
        m.gear(f"A{k}", f"M{k}", 0.1)
    answer = m.build().assemble({"M0": 2.0})
    assert answer and answer.within.freedoms == 6 + 3 and answer.residual < 1e-12
    assert set(sizes) == {4}


def test_equations_of_coordinates_count_where_a_loop_is_compared(hunt):
    m = hanging(2, 6, hunt.rng()).mechanism
    m.equation("law", "A0 - 0.3 * C0**2 - 0.1")
    answer = m.build().assemble()
    assert answer and answer.within.freedoms == 6 + 1 and answer.residual < 1e-12


@pytest.mark.parametrize("name", ["held", "change 0", "clock", "M"])
def test_names_that_searches_give_to_parts_of_their_own_may_be_taken(name):
    """A four-bar on a body that turns; D and its last body have the name."""
    answers: list[tuple[Any, ...]] = []
    for called in ("D", name):
        m = Mechanism("on a turning base", dim=2)
        m.revolute("F", m.ground, m.body("base"))
        for body in ("crank", "rod", called):
            m.body(body)
        joints = [
            ("A", "base", "crank", 0.0, 0.0),
            ("B", "crank", "rod", 0.0, 1.0),
            ("C", "rod", called, 1.0, 1.0),
        ]
        for joint, parent, child, x, y in (*joints, (called, "base", called, 1.00001, 0.0)):
            m.revolute(joint, parent, child, at=(x, y), child_at=(x, y))
        system = m.build()
        answer = system.assemble({"A": 0.1}, tolerance=1e-4)
        answers.append((system.mobility(answer.q, tolerance=1e-4).dof, answer.q.round(12).tolist()))
        assert answer
    assert answers[0] == answers[1]


def test_a_time_limit_ends_the_search_and_the_answer_says_so(hunt, monkeypatch):
    """What is closed is not known then, and nothing is a success; the next call without a limit
    searches again.
    """
    given = rounded(exact("bennett"), 6, hunt.rng())
    with monkeypatch.context() as m:
        m.setattr(clock, "time", SimpleNamespace(monotonic=itertools.count(1e9).__next__))
        answer = given.assemble(budget=kempe.Budget(time_limit=1.0))
        many = given.assemble(
            {given.coordinate_names[0]: [0.1, 0.2]}, budget=kempe.Budget(time_limit=1.0)
        )
    assert (
        answer.late
        and answer.within is None
        and "time limit of 1 s ended the search" in answer.status
    )
    assert (
        not answer.success
        and answer.code is kempe.Status.OUT_OF_TIME
        and np.isfinite(answer.q).all()
    )
    assert many.late and not many.success.any() and (many.code == kempe.Status.OUT_OF_TIME).all()
    again = given.assemble(budget=kempe.Budget(time_limit=100.0))
    assert (
        again
        and not again.late
        and again.within is not None
        and again.status == given.assemble().status
    )


UNDECIDED = {
    "assemble": lambda s, name, b: s.assemble(budget=b),
    "mobility": lambda s, name, b: s.mobility(budget=b),
    "classify": lambda s, name, b: s.classify(budget=b),
    "assembly_modes": lambda s, name, b: s.assembly_modes({name: 0.3}, budget=b),
    "trace": lambda s, name, b: s.trace(name, budget=b),
    "drive": lambda s, name, b: s.drive({name: [0.3, 0.4]}, budget=b),
    "ik": lambda s, name, b: s.ik(s.fk(s.mid, s.body_names[-1]), s.body_names[-1], budget=b),
    "ik_path": lambda s, name, b: s.ik_path(
        s.fk(s.mid, s.body_names[-1])[None], s.body_names[-1], budget=b
    ),
    "components": lambda s, name, b: s.configuration_space.components(budget=b),
}


@pytest.mark.parametrize("verb", UNDECIDED)
def test_no_verb_answers_before_it_is_decided_which_mechanism_is_closed(verb, hunt, monkeypatch):
    """One search for each system decides for all verbs: none of them answers for the given numbers
    in its place.
    """
    given = rounded(exact("bennett"), 6, hunt.rng())
    searched = []

    def search(system: kempe.System, *_: Any, **__: Any) -> None:
        searched.append(system)
        check_for_stop()
        raise AssertionError("the time was up")

    monkeypatch.setattr(nearest_exact, "_search_nearest", search)
    monkeypatch.setattr(
        clock, "time", SimpleNamespace(monotonic=lambda: math.inf if searched else -math.inf)
    )
    try:
        answer = UNDECIDED[verb](given, given.coordinate_names[0], kempe.Budget(time_limit=100.0))
    except TimeLimitError as error:
        assert "over before anything was known" in str(error)
    else:
        assert answer.late and answer.code is kempe.Status.OUT_OF_TIME and not answer
    assert searched


def test_loops_that_close_with_any_dimensions_are_not_searched(monkeypatch):
    def search(*_: Any) -> None:
        raise AssertionError("it is searched")

    monkeypatch.setattr(nearest_exact, "_find_starts", search)
    m = Mechanism("four-bar", dim=2)
    a, b, c = (m.body(x) for x in "abc")
    m.revolute("A", m.ground, a)
    m.revolute("B", a, b, at=(1, 0))
    m.revolute("C", b, c, at=(2.5, 0), child_at=(2, 0))
    m.revolute("D", m.ground, c, at=(3, 0))
    assert m.build().assemble({"A": 0.4})


def test_offsets_of_axes_that_should_meet_do_not_decide_the_size():
    """Of two spherical triples, whose links are points, rounding makes no mechanism of micrometres."""
    size = compute_characteristic_length(spherical_triples())
    for digits in (3, 4, 6, 9):
        system = rounded(spherical_triples(), digits, np.random.default_rng(0))
        assert compute_characteristic_length(system) == pytest.approx(size, rel=1e-2)


# ---- what is refused


@pytest.mark.parametrize("tolerance", [1e-16, 0.1, -1.0, float("nan"), "small", True, [1e-5]])
@pytest.mark.parametrize(
    "verb", ["mobility", "assemble", "trace", "independent", "assembly_modes", "classify"]
)
def test_a_tolerance_out_of_its_bounds_is_refused_with_both(verb, tolerance):
    with pytest.raises(InputError, match=r"from 3\.9e-14 \(rounding\) to 0\.0039 \(a hundredth"):
        getattr(kempe.load("bennett"), verb)(tolerance=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize(
    "verb",
    some(
        ["assemble", "mobility", "trace", "drive", "assembly_modes", "classify", "independent"], 3
    ),
)
def test_what_is_open_by_more_says_where_and_at_which_tolerance_it_closes(verb, hunt):
    """By each verb: the joint whose loop is open, by how much, and a tolerance within which it then
    does close.
    """
    _, given, _ = of("bennett", 3, hunt)
    driver = given.coordinate_names[0]
    options: dict[str, Any] = {
        "drive": {"inputs": {driver: np.linspace(0.3, 0.4, 3)}},
        "assembly_modes": {"known": {driver: 0.3}},
    }
    try:
        said = str(getattr(given, verb)(**options.get(verb, {})).status)
    except InputError as error:  # of those that have nothing else to say
        said = str(error)
    (least,) = re.findall(r"it closes within (\S+) m and rad: give a larger tolerance", said)
    assert re.search(r"the loop of joint '\w+' stays open by [\d.e-]+ m", said)
    assert given.mobility(tolerance=1.5 * float(least)).dof == 1


@pytest.mark.slow
def test_what_is_open_by_more_has_no_freedoms(hunt):
    _, given, _ = of("bennett", 3, hunt)
    assert given.mobility().dof is None and given.mobility(tolerance=2e-3).dof == 1
    assert given.mobility(tolerance=1e-5).dof is None


@pytest.mark.slow
def test_a_tolerance_of_the_mechanism_holds_for_all_verbs_and_in_files(hunt, tmp_path):
    _, given, _ = of("bennett", 3, hunt)
    m = given.mechanism
    m.tolerance = 2e-3
    system = kempe.load(m.save(tmp_path / "rounded.toml"))
    assert (
        system.structure.tolerance == 2e-3
        and system.mobility().dof == 1
        and system.trace("q1").closed
    )
    assert system == m.build() and system != given
    path = tmp_path / "wrong.toml"
    path.write_text('format = 1\ntolerance = "no"\n')
    with pytest.raises(kempe.errors.DescriptionError, match="tolerance is 'no'"):
        kempe.load(path)


def make_locomotive(error: float) -> kempe.System:
    """Make three parallel cranks on one rod; the pin of the one between is off along the rod."""
    m = kempe.Mechanism("locomotive", dim=2)
    m.revolute("A", m.ground, m.body("first"))
    m.revolute("B", "first", m.body("rod"), at=(0.05, 0))
    m.revolute("C", "rod", m.body("last"), at=(0.2, 0), child_at=(0.05, 0))
    m.revolute("D", m.ground, "last", at=(0.2, 0))
    m.revolute("E", "rod", m.body("between"), at=(0.1 + error, 0), child_at=(0.05, 0))
    m.revolute("F", m.ground, "between", at=(0.1, 0))
    return m.build()


@pytest.mark.parametrize("error", [1e-7, 1e-6, 1e-5])
def test_a_tolerance_is_enough_from_the_change_that_is_needed_on(error):
    """Of two tolerances the larger closes what the smaller one does, from the measured one on."""
    system = make_locomotive(error)
    needed = system.mobility(tolerance="measured").within.tolerance
    parts = np.array([0.1, 0.4, 0.6, 0.7, 1.0, 3.0, 30.0, 1.001 * needed / error])
    closed = [bool(system.assemble({"A": 0.8}, tolerance=x * error)) for x in np.sort(parts)]
    assert closed == sorted(closed) and not closed[0]
    assert all(np.array(closed)[np.sort(parts) > needed / error])


def test_mobility_says_what_moves_near_a_rigid_mechanism():
    """Also where it stands folded: `test_mobility_says_where_it_is_folded`."""
    found = make_locomotive(1e-5).mobility()
    assert (
        found.dof == 0
        and "it would have 1 freedom: the argument tolerance= allows this" in found.sentence
    )
    assert "tolerance" not in kempe.load("shaky_3r").mobility().sentence
