"""Prescribed inputs: no branch is ever left, change points are passed straight on, toggles hold."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hunts import some
from motion_linkages import (
    TURN,
    bennett,
    circles,
    four_bar,
    ladder,
    linkage,
    same_angle,
    slider_crank,
)

import kempe
from kempe.arguments import call_until_interrupt
from kempe.equations.closure_rows import compute_residual
from kempe.errors import InputError, UnsupportedError
from kempe.motion import drive as drives
from kempe.motion.drive import RegularSteps, drive

STEPS = [5, 7, 36, 50, 101, 360, 997, 1000]


def crossed(a: float, d: float, A: float) -> np.ndarray:
    """The antiparallelogram with cranks a and links d at crank angle A: B, D, C by the mirror image
    of C.
    """
    B = a * np.array([math.cos(A), math.sin(A)])
    C = circles(B, d, [d, 0.0], a, -1.0 if math.sin(A) > 0 else 1.0)
    b = math.atan2(*(C - B)[::-1])
    D = math.atan2(*(C - [d, 0.0])[::-1])
    return np.array([A, b - A, D, D - b])


def parallel_error(q):
    return same_angle(q[:, 0], q[:, 2])


def crossed_error(q):
    """tan(D/2) = (d + a)/(d - a) * -tan(A/2) for links 1 and 2, without poles."""
    A = q[:, 0] / 2
    D = q[:, 2] / 2
    return float(np.abs(np.sin(D) * np.cos(A) * 1.0 + 3.0 * np.sin(A) * np.cos(D)).max())


def kite_error(q):
    """The pin C is the mirror image of the pivot A about the line from D to B (links 1, 1, 2, 2)."""
    A = q[:, 0]
    D = q[:, 2]
    return same_angle(D, 2 * np.arctan2(np.sin(A), np.cos(A) - 2.0) - math.pi)


def slider_error(q):
    return float(np.abs(q[:, 3] - 2 * np.cos(q[:, 0])).max())


def ladder_error(q):
    return max(same_angle(q[:, 0], q[:, 2 * k]) for k in (1, 2))


AT_CHANGE_POINTS = [(x, n) for x in (0.0, -math.pi / 2) for n in (5, 36, 360)]


@pytest.mark.slow
@pytest.mark.parametrize(("first", "n"), some([*((0.8, n) for n in STEPS), *AT_CHANGE_POINTS], 8))
def test_no_flip_through_change_points_at_any_number_of_steps(first, n):
    inputs = np.linspace(first, first + TURN, n + 1)
    cases = [
        (four_bar(1, 2, 1, 2), "A", [first, -first, first, -first], parallel_error),
        (ladder(3), "A1", [first, -first, first, -first, first, -first], ladder_error),
        (slider_crank(1, 1), "A", [first, -2 * first, first, 2 * math.cos(first)], slider_error),
    ]
    if first == 0.8:
        cases.append((four_bar(1, 2, 1, 2), "A", crossed(1, 2, first), crossed_error))
        D = 2 * math.atan2(math.sin(first), math.cos(first) - 2.0) - math.pi
        cases.append((four_bar(1, 1, 2, 2), "A", [first, -1.0, D, 0.0], kite_error))
    for system, name, start, error in cases:
        # else the branch at rest, if it starts there
        toward = {"S": 1.0} if "S" in system.coordinate_names else {}
        motion = drive(system, {name: inputs}, start=start, toward=toward)
        assert motion.success and not motion.held.any() and len(motion) == n + 1, (
            system.name,
            str(motion),
        )
        assert error(motion.q) < 1e-9, system.name
        assert np.abs(motion.values(name) - inputs).max() < 1e-12
        assert np.abs(compute_residual(system, motion.q)).max() < 1e-11
        assert len(motion.singular_points) >= 2


def test_a_full_turn_back_and_forth_retraces():
    inputs = np.concatenate(
        [np.linspace(0.8, 7.0, 41), np.linspace(7.0, -3.0, 67)[1:], np.linspace(-3.0, 0.8, 11)[1:]]
    )
    motion = drive(four_bar(1, 2, 1, 2), {"A": inputs}, start=crossed(1, 2, 0.8))
    assert motion.success and crossed_error(motion.q) < 1e-9
    np.testing.assert_allclose(motion.q[-1], motion.q[0], atol=1e-10)


def test_at_a_toggle_the_last_pose_is_held_and_it_goes_on_when_the_input_comes_back():
    a = 2.0
    b = 1.5
    c = 2.2
    d = 3.0
    limit = math.acos((a * a + d * d - (b + c) ** 2) / (2 * a * d))
    inputs = np.concatenate([np.linspace(0.5, 2.5, 40), np.linspace(2.5, 0.5, 40)])
    motion = drive(four_bar(a, b, c, d), {"A": inputs}, start={"A": 0.5})
    assert not motion.success and not motion.jumps and "held" in motion.status
    np.testing.assert_array_equal(motion.held, inputs > limit)
    (toggle,) = motion.toggles
    assert inputs[toggle.first - 1] < limit < inputs[toggle.first]
    assert inputs[toggle.last + 1] < limit < inputs[toggle.last]
    assert toggle.inputs["A"] == pytest.approx(limit, abs=1e-12)
    np.testing.assert_array_equal(motion.q[motion.held], np.tile(toggle.q, (motion.held.sum(), 1)))
    # the same way back
    np.testing.assert_allclose(motion.q[::-1][~motion.held], motion.q[~motion.held], atol=1e-9)
    # coupler and rocker in line
    assert abs(math.remainder(motion.system.q_dict(toggle.q)["C"], math.pi)) < 1e-6


def test_the_toggle_itself_is_reached():
    a = 2.0
    b = 1.5
    c = 2.2
    d = 3.0
    limit = math.acos((a * a + d * d - (b + c) ** 2) / (2 * a * d))
    inputs = [0.5, limit - 1e-6, limit, limit - 1e-6, 0.5]
    motion = drive(four_bar(a, b, c, d), {"A": inputs}, start={"A": 0.5})
    assert motion.success
    np.testing.assert_allclose(motion.values("A"), inputs, atol=1e-11)
    np.testing.assert_allclose(motion.q[4], motion.q[0], atol=1e-10)
    np.testing.assert_allclose(motion.q[3], motion.q[1], atol=1e-8)


def test_a_limit_holds_like_a_toggle():
    system = slider_crank(1, 2, 0.0, limits=(1.5, 3.0))
    motion = drive(system, {"A": np.linspace(0.5, TURN + 0.5, 60)}, start={"A": 0.5})
    assert motion.held.any() and "beyond the lower limit 1.5 of 'S'" in str(motion)
    S = 1 * np.cos(motion.inputs["A"]) + np.sqrt(4 - np.sin(motion.inputs["A"]) ** 2)
    free = ~motion.held
    np.testing.assert_allclose(motion.values("S")[free], S[free], atol=1e-12)
    np.testing.assert_allclose(motion.values("S")[motion.held], 1.5, atol=1e-12)


def five_bar():
    points = {"A": (0.0, 0.0), "B": (-0.5, 1.0), "C": (0.9, 1.8), "D": (2.2, 1.1), "E": (2.0, 0.0)}
    system = linkage(
        "five-bar",
        points,
        {
            "ground": ("A", "E"),
            "a": ("A", "B"),
            "b": ("B", "C"),
            "c": ("C", "D"),
            "d": ("D", "E"),
        },
    )
    return system, {k: np.array(v) for k, v in points.items()}


def turned(p, about, by):
    c = np.cos(by)
    s = np.sin(by)
    v = p - about
    return about + np.stack([c * v[0] - s * v[1], s * v[0] + c * v[1]], axis=-1)


def test_two_inputs_as_functions_of_time():
    system, p = five_bar()
    times = np.linspace(0.0, 3.0, 50)
    courses = {"A": lambda t: 0.15 * math.sin(2 * t), "E": lambda t: 0.12 * math.sin(3 * t)}
    motion = drive(system, courses, times, start=np.zeros(5))
    assert motion.success
    A, E = (np.array([courses[n](t) for t in times]) for n in "AE")
    B = turned(p["B"], p["A"], A)
    D = turned(p["D"], p["E"], E)
    rods = [np.linalg.norm(p["C"] - p[k]) for k in "BD"]
    C = circles(B, rods[0], D, rods[1], 1.0)
    np.testing.assert_allclose(motion.curve("C*")[:, :2], C, atol=1e-12)
    names, table = motion.table(["C*"])
    assert names[0] == "time" and names[-1] == "held" and table.shape == (50, 1 + 5 + 2 + 1)


def test_going_on_from_elsewhere_than_held_is_reported_as_a_jump():
    """Two inputs leave the possible region at one place and come back at another."""
    system, p = five_bar()
    # the pins B and D are pulled too far apart, then both are brought to another place, within
    # reach
    inputs = {"A": [0.0, 2.0, 2.0, -0.8], "E": [0.0, -1.5, 0.4, 0.4]}
    motion = drive(system, {k: np.array(v) for k, v in inputs.items()}, start=np.zeros(5))
    ends = zip(*inputs.values(), strict=True)
    far = [np.linalg.norm(turned(p["B"], p["A"], a) - turned(p["D"], p["E"], e)) for a, e in ends]
    reach = sum(np.linalg.norm(p["C"] - p[k]) for k in "BD")
    np.testing.assert_array_equal(motion.held, np.array(far) > reach)
    assert motion.held[1] and not motion.held[-1]
    assert (
        motion.jumps
        and motion.jumps[0][0] == int(np.flatnonzero(motion.held)[-1]) + 1
        and "jumps" in motion.status
    )
    assert np.abs(compute_residual(system, motion.q)).max() < 1e-12


def test_inputs_must_fit_the_freedoms():
    system, _ = five_bar()
    with pytest.raises(UnsupportedError, match="'A' held still"):
        drive(system, {"A": [0.0, 0.1]}, start=np.zeros(5))
    with pytest.raises(UnsupportedError, match="fewer freedoms than inputs"):
        drive(four_bar(1, 2.5, 2, 3), {"A": [0.5, 0.6], "D": [1.7, 1.9]}, start={"A": 0.5})
    with pytest.raises(InputError, match="times"):
        drive(system, {"A": math.sin, "E": 0.0})
    with pytest.raises(InputError, match="differ"):
        drive(system, {"A": [0.0, 1.0], "E": [0.0, 1.0, 2.0]})
    with pytest.raises(InputError, match=r"input 'A'\[1\] is nan; it must be finite"):
        drive(system, {"A": [0.0, float("nan")], "E": 0.0})


def test_whole_turns_of_the_start_follow_the_inputs():
    motion = drive(four_bar(1, 2.5, 2, 3), {"A": [20.0, 20.1]}, start={"A": 0.5})
    assert motion.success
    np.testing.assert_allclose(motion.values("A"), [20.0, 20.1], atol=1e-12)


def test_an_interrupt_returns_what_was_done():
    def stop(k, n):
        if k > 20:
            raise KeyboardInterrupt

    motion = call_until_interrupt(
        drive,
        four_bar(1, 2.5, 2, 3),
        {"A": np.linspace(0.5, 3, 60)},
        start={"A": 0.5},
        budget=kempe.Budget(progress=stop),
    )
    assert (
        motion.interrupted
        and not motion
        and 20 < len(motion) < 60
        and len(motion.inputs["A"]) == len(motion)
    )


@pytest.mark.parametrize(
    "inputs",
    [
        {"A": "x"},
        {"A": lambda t: [1, 2]},
        {"A": lambda t: "x"},
        ["A"],
        {"A": []},
        {"A": lambda t: 1.5 if t < 1 else np.nan},
    ],
)
def test_bad_inputs_of_a_drive_are_refused(inputs):
    times = [0, 1, 2] if isinstance(inputs, dict) and callable(inputs["A"]) else None
    with pytest.raises(InputError, match=r"must be|no samples"):
        kempe.load("four_bar").drive(inputs, times)


def rod_with_balls(*lengths: float) -> kempe.System:
    """A four-bar in space whose rod has a ball at each end, and so spins."""
    crank, rod, rocker, ground = lengths
    m = kempe.Mechanism("rod with balls")
    bodies = [m.body(name) for name in ("crank", "rod", "rocker")]
    m.revolute("A", m.ground, bodies[0])
    m.revolute("D", m.ground, bodies[2], at=(ground, 0, 0))
    m.spherical("B", bodies[0], bodies[1], at=(crank, 0, 0))
    m.spherical("C", bodies[1], bodies[2], at=(rod, 0, 0), child_at=(rocker, 0, 0), cut=True)
    return m.build()


def list_drives():
    """Systems, inputs and starts: regular, through toggles, limits and change points, back and
    forth, with rests, two inputs, redundant equations, idle spins.
    """
    turn = np.linspace(0.8, 0.8 + TURN, 200)
    swing = 0.8 + 1.5 * np.sin(np.linspace(0.0, 9.0, 300))
    fine = np.linspace(0.1, 0.9, 150)
    return {
        "turn": (four_bar(1, 2.5, 2, 3), {"A": turn}, {"A": 0.8}),
        "rests": (four_bar(1, 2.5, 2, 3), {"A": np.repeat(turn, 2)}, {"A": 0.8}),
        "toggles": (four_bar(2, 2.5, 1, 3), {"A": swing}, {"A": 0.8}),
        "limits": (four_bar(1, 2.5, 2, 3, D=(1.2, 2.2)), {"A": turn}, {"A": 0.8}),
        "change points": (four_bar(1, 2, 1, 2), {"A": turn}, {"A": 0.8, "D": 0.8}),
        "slides": (slider_crank(1, 3), {"A": swing}, {"A": 0.8}),
        "redundant": (bennett(1.0, 1.3, 0.7, math.asin(1.3 * math.sin(0.7))), {"T1": fine}, None),
        "spins": (rod_with_balls(1, 2.5, 2, 3), {"A": turn}, {"A": 0.8}),
        "spins, toggles": (rod_with_balls(2, 2.5, 1, 3), {"A": swing}, {"A": 0.8}),
        "two inputs": (five_bar()[0], {"A": 0.2 * fine, "E": -0.1 * fine}, np.zeros(5)),
    }


@pytest.mark.parametrize("name", list_drives())
def test_many_samples_at_once_are_what_single_steps_give(name, monkeypatch):
    system, inputs, start = list_drives()[name]
    motion = drive(system, inputs, start=start)
    monkeypatch.setattr(RegularSteps, "choose_sample_count", lambda self: 0)
    single = drive(system, inputs, start=start)
    np.testing.assert_allclose(motion.q, single.q, atol=1e-9)
    np.testing.assert_array_equal(motion.held, single.held)
    assert motion.status == single.status
    assert len(motion.singular_points) == len(single.singular_points)


@pytest.mark.parametrize("make, most", [(four_bar, 2), (rod_with_balls, 3)])
def test_a_regular_motion_takes_its_single_steps_at_the_first_sample_only(make, most, monkeypatch):
    """Counted are the nodes of single steps, and the calls that take many samples."""
    counts = {"nodes": 0, "calls": 0}

    def count(key, function):
        def call(*args):
            counts[key] += 1
            return function(*args)

        return call

    monkeypatch.setattr(drives, "make_node", count("nodes", drives.make_node))
    follow = count("calls", RegularSteps.follow_samples)
    monkeypatch.setattr(RegularSteps, "follow_samples", follow)
    motion = drive(make(1, 2.5, 2, 3), {"A": np.linspace(0.8, 0.8 + TURN, 1000)}, start={"A": 0.8})
    assert motion.success and counts["nodes"] <= most and counts["calls"] <= 12, counts
