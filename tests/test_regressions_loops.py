"""Defects of closed loops that were found by playing with mechanisms of one's own, each pinned."""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe import Mechanism
from kempe.errors import InputError
from kempe.kinematics.closure_rows import characteristic_length


def four_bar(cut: str | None = None, at: tuple[float, float] = (0.0, 0.0), **lengths: float) -> kempe.System:
    """A four-bar with crank a, coupler b, rocker c and ground d, standing at `at`."""
    n = {"a": 0.1, "b": 0.5, "c": 0.4, "d": 0.4, **lengths}
    m = Mechanism("four-bar", dim=2)
    crank, coupler, rocker = m.body("crank"), m.body("coupler"), m.body("rocker")
    m.revolute("A", m.ground, crank, at=at, cut=cut == "A")
    m.revolute("B", crank, coupler, at=(n["a"], 0), cut=cut == "B")
    m.revolute("C", coupler, rocker, at=(n["b"], 0), child_at=(n["c"], 0), cut=cut == "C")
    m.revolute("D", m.ground, rocker, at=(at[0] + n["d"], at[1]), cut=cut == "D")
    return m.build()


# ---- what is nearest, and where the loops are cut


def test_the_nearest_does_not_depend_on_the_cut():
    """The distance counts all coordinates, so that the answer by name is the same wherever the loop is cut."""
    near = {"A": 1.4, "B": -0.7, "C": 1.0, "D": 1.3}
    answers = []
    for cut in "ABCD":
        s = four_bar(cut)
        answer = s.assemble(start=near, prefer="nearest")
        assert answer
        answers.append([s.q_dict(answer.q)[n] for n in "ABCD"])
    np.testing.assert_allclose(answers, np.broadcast_to(answers[0], (4, 4)), atol=1e-7)


def test_the_nearest_is_nearest():
    """No closed configuration of a fine sweep of the crank is nearer, measured in all joints."""
    s = kempe.load("four_bar")
    near = s.q({"A": 1.4, "B": -0.7, "C": 1.0, "D": 1.3})
    answer = s.assemble(start=near, prefer="nearest")
    crank = answer.q[0] + np.linspace(-0.2, 0.2, 2001)
    around = s.assemble({"A": crank}, start=answer.q)
    assert around
    assert s.configuration_space.distance(near, answer.q) <= s.configuration_space.distance(near, around.q).min() + 1e-9


@pytest.mark.parametrize("cut", "ABCD")
@pytest.mark.parametrize("at", [(0.0, 0.0), (1000.0, -2000.0)])
def test_the_characteristic_length_is_of_the_links(cut, at):
    """Neither the cut nor where the ground has its origin matters."""
    assert characteristic_length(four_bar(cut, at)) == pytest.approx(0.4, rel=1e-9)


def test_a_mechanism_far_from_the_origin():
    """1000 m away loops close, and are traced, as at the origin: no digits and no tolerance are lost."""
    m = Mechanism("far", ground="world")
    m.attach(kempe.load("sarrus"), m.ground, at=(1000.0, 2000.0, 0.0), rpy=(0.3, 0.2, 1.0))
    far, home = m.build(), kempe.load("sarrus")
    driver = home.structure.velocity_names[0]
    start = far.q({k: v for k, v in home.q_dict(home.q("closed")).items()})
    assert far.trace(driver, start).length == pytest.approx(home.trace(driver, "closed").length, rel=1e-6)
    s = four_bar(at=(1e6, 0.0))
    answer = s.assemble({"A": 1.0})
    assert answer and np.abs(s.loops.closure_error(answer.q)).max() < 1e-9
    tip = s.fk(answer.q, "rocker")[:3, 3] + s.fk(answer.q, "rocker")[:3, :3] @ [0.4, 0, 0]
    assert np.linalg.norm(tip[:2] - [1e6 + 0.1 * np.cos(1.0), 0.1 * np.sin(1.0)]) == pytest.approx(0.5, abs=1e-9)


def test_a_known_place_far_from_the_origin():
    """Places of frames are in the ground, however the loops are measured."""
    m = Mechanism("four-bar", dim=2)
    crank, coupler, rocker = m.body("crank"), m.body("coupler"), m.body("rocker")
    m.revolute("A", m.ground, crank, at=(500, 0))
    m.revolute("B", crank, coupler, at=(0.1, 0))
    m.revolute("C", coupler, rocker, at=(0.5, 0), child_at=(0.4, 0))
    m.revolute("D", m.ground, rocker, at=(500.4, 0))
    m.frame("pin", "crank", at=(0.1, 0))
    s = m.build()
    place = [500 + 0.1 * np.cos(0.7), 0.1 * np.sin(0.7)]
    answer = s.assemble({"pin": place})
    assert answer and s.q_dict(answer.q)["A"] == pytest.approx(0.7, abs=1e-8)


# ---- what is said


@pytest.mark.parametrize("beyond", [1e-9, 1e-7, 1e-3])
def test_the_open_loop_is_named_however_little_it_is_open(beyond):
    s = four_bar(a=0.4, b=0.2, c=0.3, d=0.8)
    toggle = np.arccos((0.16 + 0.64 - 0.25) / (2 * 0.4 * 0.8))
    answer = s.assemble({"A": toggle + beyond})
    assert not answer and "the loop of joint" in answer.status


def test_a_violated_rod_and_a_violated_relation_are_named():
    m = Mechanism("rod", dim=2)
    crank, block = m.body("crank"), m.body("block")
    m.revolute("A", m.ground, crank)
    m.prismatic("S", m.ground, block, axis=(1, 0), limits=(5, 6))
    m.distance("rod", crank, block, length=2.0, at=(1, 0))
    answer = m.build().assemble()
    assert not answer and "constraint 'rod' stays open by 2 m" in answer.status
    m = Mechanism("differential")
    for name in ("L", "R", "C"):
        m.revolute(name, m.ground, m.body(f"body {name}"), limits=(0, 1))
    m.couple("C", {"L": 1.0, "R": 1.0}, offset=5.0)
    answer = m.build().assemble()
    assert not answer and "the relation of 'C' is off by 4" in answer.status


# ---- bad input


@pytest.mark.parametrize("tolerance", [-1.0, 0.0, 1.0, float("nan"), float("inf"), "x"])
def test_a_tolerance_that_would_call_open_loops_closed_is_refused(tolerance):
    with pytest.raises(InputError, match="tolerance"):
        kempe.load("four_bar").assemble({"A": 1.0}, tolerance=tolerance)


@pytest.mark.parametrize("values", [{}, {"B": 1.0}, {"A": 1.0, "B": 1.0}])
def test_a_bound_assembler_says_which_values_it_needs(values):
    with pytest.raises(InputError, match=r"needed are \('A',\)"):
        kempe.load("four_bar").loops.assembler(["A"])(values)


def test_a_bad_row_leaves_the_others_alone_where_rows_follow_each_other():
    s = kempe.load("four_bar")
    angles = np.linspace(1.5, 2.5, 11)
    bad = np.where(np.arange(11) == 4, np.nan, angles)
    answer = s.assemble({"A": bad}, prefer="continuous")
    np.testing.assert_array_equal(answer.success, np.arange(11) != 4)
    assert np.isnan(answer.q[4]).all()
    whole = s.assemble({"A": angles}, prefer="continuous")
    good = np.arange(11) != 4
    np.testing.assert_allclose(answer.q[good], whole.q[good], atol=1e-9)


def test_a_bad_place_of_a_frame_leaves_the_other_rows_alone():
    s = kempe.load("four_bar")
    places = s.fk(s.assemble({"A": np.array([1.0, 1.1, 1.2])}).q, "coupler")[:, :2, 3]
    places[1] = np.nan
    answer = s.assemble({"coupler": places})
    assert answer.success.tolist() == [True, False, True] and np.isnan(answer.q[1]).all()


def test_too_many_known_values_are_said_to_be_too_many():
    s = four_bar()
    assert "2 coordinates are given, but it has 1 freedom" in s.assemble({"A": 1.0, "D": 1.0}).status


# ---- couplings in loops


@pytest.mark.parametrize("cut", "ABCD")
@pytest.mark.parametrize(("driven", "driver"), [("D", "A"), ("A", "D"), ("C", "A"), ("B", "C")])
def test_gears_close_wherever_the_loop_is_cut(cut, driven, driver):
    """A cut joint that others follow is no less bound than one that follows."""
    m = four_bar(cut).mechanism
    m.gear(driven, driver, -0.5, 0.4)
    s = m.build()
    answer = s.assemble()
    assert np.abs(s.loops.closure_error(answer.q)).max() < 1e-9 or not answer
    assert answer


@pytest.mark.parametrize("cut", [None, "B", "D"])
@pytest.mark.parametrize(("driven", "driver", "ratio", "count"), [("D", "A", -0.3, 6), ("B", "C", -0.5, 4)])
def test_all_modes_of_a_gear_that_comes_back_after_several_turns(cut, driven, driver, ratio, count):
    """Counts by sign changes over all turns of the driver, from the closed form of the four-bar."""
    m = four_bar(cut).mechanism
    m.gear(driven, driver, ratio, 0.4)
    s = m.build()
    modes = s.assembly_modes({})
    assert len(modes) == count and not modes.complete
    assert max(np.abs(s.loops.closure_error(q)).max() for q in modes) < 1e-8


# ---- motion


def test_a_branch_closes_where_limits_are_not_looked_at():
    m = four_bar().mechanism
    m.joints.pop("A")
    m.revolute("A", m.ground, "crank", limits=(-1, 1))
    path = m.build().trace("A", {"A": 0.0}, limits=False)
    assert path.closed and path.turns["A"] == 1 and len(path) < 200


def test_points_allowed_are_all_points():
    path = kempe.load("four_bar").trace("A", budget=kempe.Budget(points=7))
    assert len(path) == 7 and path.ends == ("the start", "the 7 points allowed")


@pytest.mark.parametrize("wrong", [{"step": "x"}, {"points": "x"}, {"points": 2.5}])
def test_bad_budgets_of_a_trace_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        kempe.load("four_bar").trace("A", budget=kempe.Budget(**wrong))


@pytest.mark.parametrize("rate", [np.nan, "x"])
def test_bad_rates_of_a_trace_are_refused(rate):
    with pytest.raises(InputError, match="toward"):
        kempe.load("four_bar").trace("A", toward={"A": rate})


@pytest.mark.parametrize("inputs", [{"A": "x"}, {"A": lambda t: [1, 2]}, {"A": lambda t: "x"}, ["A"], {"A": []},
                                    {"A": lambda t: 1.5 if t < 1 else np.nan}])  # fmt: skip
def test_bad_inputs_of_a_drive_are_refused(inputs):
    times = [0, 1, 2] if isinstance(inputs, dict) and callable(inputs["A"]) else None
    with pytest.raises(InputError, match=r"must be|no samples"):
        kempe.load("four_bar").drive(inputs, times)


# ---- places of frames, and systems with next to nothing in them


def test_places_that_no_frame_can_have_are_refused():
    s = kempe.load("three_rrr")
    body = s.body_names[-1]
    tilted = np.eye(4)
    tilted[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    for place in ([0.0, 0.0, 1.0], tilted):
        with pytest.raises(InputError, match="leaves the plane"):
            s.assemble({body: place})
    for place in (np.full((4, 4), 2.0), np.diag([1.0, 1.0, -1.0, 1.0])):
        with pytest.raises(InputError, match="is no pose"):
            s.assemble({body: place})


def test_by_how_much_a_place_is_missed():
    m = Mechanism("arm", dim=2)
    m.revolute("A", m.ground, m.body("a"))
    m.revolute("B", "a", m.body("b"), at=(1, 0))
    s = m.build()
    assert "the place of 'b' is missed by 0.118034 m" in s.assemble({"b": [1.0, 0.5]}).status
    assert "the place of 'ground' is missed by 1 m" in kempe.load("four_bar").assemble({"ground": [1, 0]}).status


def test_what_has_no_coordinates_does_not_move():
    m = Mechanism("nothing", dim=2)
    assert len(m.build().trace()) == 1
    m.fixed("F", m.ground, m.body("block"))
    assert "cannot move" in m.build().trace().status


def test_a_search_among_thousands_of_modes_ends():
    m = Mechanism("row", dim=2)
    before = m.body("r0")
    m.revolute("A0", m.ground, before)
    for k in range(1, 21):
        coupler, rocker = m.body(f"c{k}"), m.body(f"r{k}")
        m.revolute(f"B{k}", before, coupler, at=(0, 0.5))
        m.revolute(f"C{k}", coupler, rocker, at=(1, 0), child_at=(0, 0.5))
        m.revolute(f"A{k}", m.ground, rocker, at=(k, 0))
        before = rocker
    modes = m.build().assembly_modes({"A0": 0.4})
    assert len(modes) > 500 and not modes.complete and modes.coverage < 0.9


# ---- further constraints, transmission angles


def test_bad_further_constraints_are_refused_and_violated_ones_named():
    from kempe import constraints

    s = kempe.load("five_bar")
    for bad in (3, ["x"]):
        with pytest.raises(InputError, match="also holds"):
            s.assemble(also=bad)
    for wrong in (lambda q: "x", lambda q: np.nan):
        with pytest.raises(InputError, match="must give a number"):
            s.assemble(also=wrong)
    with pytest.raises(InputError, match=r"its Jacobian has shape \(1, 3\)"):
        s.assemble(also=constraints.Function(lambda q: q[0], lambda q: np.zeros(3)))
    a, b = s.body_names[1], s.body_names[-1]
    answer = s.assemble(also=constraints.Distance(a, b, 99.0, name="far rod"))
    assert not answer and "'far rod'" in answer.status


def test_a_joint_on_the_ground_has_no_transmission_angle():
    from kempe.analysis.motion.transmission import transmission_angle

    s = kempe.load("four_bar")
    with pytest.raises(InputError, match="on the ground"):
        transmission_angle(s, s.q("closed"), "A")
