"""Singular configurations against closed forms, geometry of lines, and the literature."""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe import Budget, Status
from kempe.arguments import call_until_interrupt
from kempe.equations.closure_rows import compute_residual
from kempe.errors import InputError, TimeLimitError, UnknownNameError

PUMA = kempe.load("puma560")
A2 = 0.4318
A3 = 0.0203
D4 = 0.4318
"""Link lengths of the Puma in metres."""
FEW = Budget(starts=24)


def named(answer, name: str):
    (found,) = [s for s in answer.sets if s.name == name]
    return found


def crossing(p: np.ndarray, d: np.ndarray) -> float:
    """The smallest singular value of three lines of the plane through p (3, 2) along d (3, 2), in
    their coordinates.
    """
    lines = np.column_stack([d, p[:, 0] * d[:, 1] - p[:, 1] * d[:, 0]])
    return float(np.linalg.svd(lines / np.linalg.norm(d, axis=1)[:, None], compute_uv=False)[-1])


@pytest.fixture(scope="module")
def puma():
    return PUMA.singularities("tool")


def test_the_three_of_the_puma(puma):
    """Paul, Stevenson, "Kinematics of robot wrists", 1983; Craig, section 5.8: by the lengths of
    the links.
    """
    elbow, wrist, shoulder = (named(puma, n) for n in ("elbow", "wrist", "shoulder"))
    assert (
        elbow.coordinates == ("q3",)
        and wrist.coordinates == ("q5",)
        and shoulder.coordinates == ("q2", "q3")
    )
    assert abs(np.tan(elbow.values[0, 0])) == pytest.approx(D4 / A3, rel=1e-6)
    assert wrist.values.ravel() == pytest.approx([0.0], abs=1e-9)
    assert elbow.dimension == wrist.dimension == shoulder.dimension == 5
    # axes 4 and 6 turn against each other
    for q, still in zip(wrist.q, wrist.self_motion, strict=True):
        assert (
            np.abs(still[0, :3]).max() < 1e-6
            and abs(still[0, 4]) < 1e-6
            and still[0, 3] * still[0, 5] < 0.0
        ), q


def test_what_is_lost_is_out_of_the_jacobians_image(puma):
    for found in puma.sets:
        for q, lost, still in zip(found.q, found.lost, found.self_motion, strict=True):
            J = PUMA.jacobian(q, "tool")
            assert (
                np.linalg.matrix_rank(J, tol=1e-6) == 6 - len(lost)
                and np.abs(J @ still.T).max() < 1e-6
            )
            assert np.linalg.matrix_rank(np.column_stack([J, lost.T]), tol=1e-4) == 6


def test_the_shoulder_is_where_the_wrist_is_across_from_axis_1(puma):
    """The wrist centre then moves along axis 2 only as axis 1 turns: its distance across is zero."""
    for q in named(puma, "shoulder").q:
        p = PUMA.fk(q, "link4")[:3, 3]
        X = PUMA.fk(q, "link1")
        axis2 = PUMA.jacobian(q, "tool")[3:, 1]
        assert abs(np.cross([0.0, 0.0, 1.0], axis2) @ (p - X[:3, 3])) < 1e-7


@pytest.mark.slow
def test_distances_to_the_nearest(puma):
    """Of elbow and wrist they are differences of one joint; of the shoulder by trying 3000 pairs of
    q2 and q3.
    """
    q = PUMA.q({"q2": 0.9, "q3": -1.0, "q4": 0.3, "q5": 0.7})
    found = puma.nearest(q)
    elbow = named(puma, "elbow").values[0, 0]
    assert found.distances[str(named(puma, "elbow"))] == pytest.approx(q[2] - elbow, abs=1e-6)
    assert found.distances[str(named(puma, "wrist"))] == pytest.approx(0.7, abs=1e-6)
    q3 = np.linspace(PUMA.lower[2], PUMA.upper[2], 3001)
    trial = np.repeat(q[None], 3001, axis=0)
    trial[:, 2] = q3
    trial[:, 1] = 0.0
    p = PUMA.fk(trial, "link4")[:, :3, 3] - PUMA.fk(q, "link1")[:3, 3]
    axis2 = PUMA.jacobian(q, "tool")[3:, 1]
    ahead = np.cross([0.0, 0.0, 1.0], axis2)
    # turning by q2 about axis 2 leads the wrist centre to above it where its part ahead is zero
    part = p @ ahead
    up = p[:, 2]
    turn = np.arctan2(part, up)
    options = []
    for sign in (1.0, -1.0):
        for k in (-1, 0, 1):
            q2 = sign * turn + k * np.pi
            there = trial.copy()
            there[:, 1] = q2
            good = (
                np.abs((PUMA.fk(there, "link4")[:, :3, 3] - PUMA.fk(q, "link1")[:3, 3]) @ ahead)
                < 1e-9
            )
            good &= (q2 > PUMA.lower[1]) & (q2 < PUMA.upper[1])
            options.append(np.hypot(q2 - q[1], q3 - q[2])[good].min(initial=np.inf))
    assert found.distances[str(named(puma, "shoulder"))] == pytest.approx(min(options), abs=1e-5)
    assert found.distance == min(found.distances.values())


@pytest.mark.slow
def test_a_singular_configuration_is_its_own_nearest(puma):
    found = puma.nearest(PUMA.q({"q2": 0.3, "q3": 0.4, "q5": 0.0}))
    assert (
        found.distance < 1e-9
        and found.name == "wrist"
        and found.status.startswith("singular (wrist)")
    )


def test_an_arm_of_two_links_is_singular_stretched_or_folded():
    found = kempe.load("two_link").singularities("e")
    assert found.task == "position" and len(found.sets) == 1
    assert found.sets[0].values.ravel() == pytest.approx([0.0, np.pi], abs=1e-8)
    assert np.abs(found.sets[0].self_motion[0]).max() > 0.1


def test_what_a_one_sided_constraint_excludes_is_not_singular():
    m = kempe.load("two_link").mechanism
    m.inequality("bent", "q2^2 - 1", of=("q2",))
    found = m.build().singularities("e")
    assert found.sets[0].kinds == kempe.load("two_link").singularities("e").sets[0].kinds
    assert found.sets[0].values.ravel() == pytest.approx([np.pi], abs=1e-8)


def test_shoulder_elbow_and_wrist_without_a_spherical_wrist():
    """Of the UR5 by sin q3 = 0 and sin q5 = 0: Kufieta, "Force estimation in robotic manipulators",
    2014.
    """
    found = kempe.load("ur5").singularities("tool")
    assert {s.name for s in found.sets} == {"shoulder", "elbow", "wrist"}
    for name in ("elbow", "wrist"):
        assert np.sin(named(found, name).values) == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("name", ["panda", "iiwa14", "gen3"])
def test_of_redundant_arms_all_minors_vanish(name):
    arm = kempe.load(name)
    found = arm.singularities(arm.frame_names[-1])
    assert found.sets
    for s in found.sets:
        J = arm.jacobian(s.q, arm.frame_names[-1])
        minors = [np.linalg.det(np.delete(J, k, axis=2)) for k in range(7)]
        assert np.abs(minors).max() < 1e-8


def test_the_four_of_an_arm_with_spherical_shoulder_and_wrist():
    """Kreutz-Delgado, Long, Seraji, "Kinematic analysis of 7-DOF manipulators", Int. J. Robotics
    Research 11 (1992).
    """
    found = {
        s.coordinates: s
        for s in kempe.load("iiwa14").singularities("tool").sets
        if len(s.lost[0]) == 1
    }
    quarter = 0.5 * np.pi
    assert set(found) == {("q4",), ("q2", "q3"), ("q5", "q6"), ("q2", "q6")}
    assert (
        found["q4",].values == pytest.approx(np.zeros((1, 1)), abs=1e-7)
        and found["q4",].dimension == 6
    )
    assert found["q2", "q3"].values == pytest.approx(
        np.array([[0.0, -quarter], [0.0, quarter]]), abs=1e-7
    )
    assert found["q5", "q6"].values == pytest.approx(
        np.array([[-quarter, 0.0], [quarter, 0.0]]), abs=1e-7
    )
    assert found["q2", "q6"].values == pytest.approx(np.zeros((1, 2)), abs=1e-7)


@pytest.fixture(scope="module")
def three_rrr():
    arm = kempe.load("three_rrr")
    return arm, arm.singularities("tool")


def lines_of(arm, q):
    """Points and directions of the three links that carry the platform of the planar robot."""
    B = np.array([arm.fk(q, f"link{k}")[:2, 3] for k in (1, 2, 3)])
    C = []
    C = np.array([(arm.fk(q, f"link{k}") @ [0.3, 0.0, 0.0, 1.0])[:2] for k in (1, 2, 3)])
    return B, C - B


@pytest.mark.slow
def test_legs_of_a_planar_robot_meet_or_are_parallel_where_it_gains_a_motion(three_rrr):
    """Gosselin, Angeles 1990; Bonev, Zlatanov, Gosselin 2003: the lines of the three distal links
    are dependent.
    """
    arm, found = three_rrr
    sets = [s for s in found.sets if s.kinds == ("type 2",)]
    assert len(sets) == 1 and sets[0].dimension == 2 and len(sets[0].q) > 10
    for q, gained in zip(sets[0].q, sets[0].gained, strict=True):
        p, d = lines_of(arm, q)
        assert crossing(p, d) < 1e-7 and len(gained) == 1
        assert np.abs(compute_residual(arm, q)).max() < 1e-9
        vx, vy, _, _, _, w = gained[0]  # the platform turns about the point in which the lines meet
        at = arm.fk(q, "tool")[:2, 3] + np.array([-vy, vx]) / w
        across = np.column_stack([-d[:, 1], d[:, 0]]) / np.linalg.norm(d, axis=1)[:, None]
        assert np.abs(np.sum(across * (at - p), axis=1)).max() < 1e-5


@pytest.mark.slow
def test_a_leg_of_a_planar_robot_is_stretched_or_folded_where_it_loses_a_motion(three_rrr):
    _, found = three_rrr
    sets = [s for s in found.sets if s.kinds == ("type 1",)]
    assert sets
    for s in sets:
        bend = s.q[:, [1, 4, 7]]
        assert np.abs(np.sin(bend)).min(axis=1).max() < 1e-7


@pytest.mark.slow
def test_a_five_bar():
    """Type 1: a leg is stretched or folded; type 2: the two distal links are in line."""
    arm = kempe.load("five_bar")
    found = arm.singularities("tip", "position")
    one, two = (next(s for s in found.sets if s.kinds == (k,)) for k in ("type 1", "type 2"))
    index = {n: i for i, n in enumerate(arm.coordinate_names)}
    assert np.abs(np.sin(one.q[:, [index["B"], index["C"]]])).min(axis=1).max() < 1e-7
    assert np.abs(np.sin(two.q[:, index["P"]])).max() < 1e-7
    assert one.dimension == two.dimension == 1


@pytest.mark.slow
def test_of_a_planar_frame_with_two_freedoms_the_place_is_the_task():
    """Its pose has three equations, of which one is never met: what is lost is counted from two."""
    arm = kempe.load("five_bar")
    found = arm.singularities("tip", budget=FEW)
    assert found.task == "position"
    (one,) = (s for s in found.sets if s.kinds == ("type 1",))
    assert np.median([len(lost) for lost in one.lost]) == 1
    given = arm.singularities("tip", "position", budget=FEW)
    assert all(np.array_equal(a.q, b.q) for a, b in zip(found.sets, given.sets, strict=True))
    for name, frame in (("five_bar", "crank1"), ("three_rrr", "tool"), ("four_bar", "coupler")):
        assert kempe.load(name).singularities(
            frame, inputs=["A"] * (name == "four_bar") or None, budget=FEW
        ).task == ("pose"), f"{frame} of {name} has one freedom, or three"


@pytest.mark.slow
def test_dead_centres_of_a_four_bar():
    """Where crank and coupler are in line, the rocker is at rest: by the law of cosines."""
    bar = kempe.load("four_bar")
    found = bar.singularities("rocker", inputs=["A"])
    (dead,) = found.sets
    assert dead.kinds == ("type 1",) and dead.dimension == 0 and len(dead.q) == 4
    assert np.abs(np.sin(dead.q[:, 1])).max() < 1e-8
    driven = bar.singularities("rocker", inputs=["D"])
    assert [s.kinds for s in driven.sets] == [("type 1", "type 2")] and len(driven.sets[0].q) == 4
    assert not bar.singularities("coupler", inputs=["A"]).sets  # the crank goes round


def test_a_parallelogram_has_two_change_points():
    found = kempe.load("parallelogram").singularities(inputs=["A"])
    (flat,) = found.sets
    assert "constraint" in flat.kinds and flat.dimension == 0 and len(flat.q) == 2
    assert np.abs(np.sin(flat.q)).max() < 1e-7


def leg_lines(arm, q):
    """Plucker coordinates (6, 6) of the legs of the Stewart platform."""
    feet = np.array([arm.fk(q, f"lower{k}")[:3, 3] for k in range(1, 7)])
    heads = np.array([(arm.fk(q, f"upper{k}"))[:3, 3] for k in range(1, 7)])
    d = (heads - feet) / np.linalg.norm(heads - feet, axis=1)[:, None]
    return np.column_stack([d, np.cross(feet, d)])


@pytest.mark.slow
def test_a_hexapod_is_singular_with_its_platform_turned_by_90_degrees():
    """Fichter, "A Stewart platform-based manipulator", Int. J. Robotics Research 5 (1986): similar
    hexagons, turned.
    """
    arm = kempe.load("stewart")
    X = arm.fk(arm.q("closed"), "tool")
    q = arm.q("closed")
    for turn in np.linspace(0.0, 0.5 * np.pi, 19)[1:]:
        target = X.copy()
        target[:3, :3] = [
            [np.cos(turn), -np.sin(turn), 0.0],
            [np.sin(turn), np.cos(turn), 0.0],
            [0.0, 0.0, 1.0],
        ]
        q = arm.ik([kempe.tasks.Pose("tool", target)], start=q).expect().q
    lines = leg_lines(arm, q)
    assert np.linalg.svd(lines, compute_uv=False)[-1] < 1e-9
    found = arm.singularities("tool", budget=FEW).nearest(q)
    assert found.distance < 1e-6 and "type 2" in found.kinds and len(found.gained) == 1
    assert (
        np.abs(
            lines
            @ np.concatenate(
                [
                    found.gained[0, :3] - np.cross(found.gained[0, 3:], target[:3, 3]),
                    found.gained[0, 3:],
                ]
            )
        ).max()
        < 1e-6
    )


@pytest.mark.slow
def test_legs_of_a_hexapod_are_dependent_where_it_gains_a_motion():
    """Merlet, "Singular configurations of parallel manipulators and Grassmann geometry", 1989."""
    arm = kempe.load("stewart")
    found = arm.singularities("tool", limits=False, budget=FEW)
    two = next(s for s in found.sets if s.kinds == ("type 2",))
    assert len(two.q) > 5
    for q in two.q:
        assert np.linalg.svd(leg_lines(arm, q), compute_uv=False)[-1] < 1e-6


# ---- what is broken off, and wrong calls


def interrupted(done: int, total: int) -> None:
    """What happens where Ctrl-C comes after the first starts."""
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("last", "progress", "code", "done"),
    [
        (3, None, Status.OUT_OF_TIME, 32),
        (None, interrupted, Status.INTERRUPTED, 16),
    ],
)
def test_what_was_found_stays_where_the_search_is_broken_off(last, progress, code, done, looks):
    """Of the looks at the clock the time is up at the third from behind."""
    if last is not None:
        PUMA.singularities("tool", budget=Budget(starts=40))  # what is kept is looked up no more
        count = looks(10**9)
        PUMA.singularities("tool", budget=Budget(starts=40))
        looks(next(count) - last)
    part = call_until_interrupt(
        PUMA.singularities, "tool", budget=Budget(starts=40, progress=progress)
    )
    looks(10**9)
    whole = PUMA.singularities("tool", budget=Budget(starts=40))
    assert (
        part.code is code
        and part.starts == done
        and "this is the part that was done" in part.status
    )
    first = np.concatenate([s.q for s in whole.sets]) if done else np.zeros((0, 6))
    mine = np.concatenate([s.q for s in part.sets]) if done else first
    assert (
        all(np.abs(first - q).max(axis=1).min() < 1e-9 for q in mine)
        and whole.code is Status.SOLVED
    )
    seen = []
    PUMA.singularities("tool", budget=Budget(starts=40, progress=lambda *x: seen.append(x)))
    assert seen == [(16, 40), (32, 40), (40, 40)]


def test_memory_grows_with_the_starts_and_not_with_their_square():
    m = kempe.Mechanism("pair", dim=2)
    m.revolute("A", m.ground, m.body("a"))
    m.revolute("B", "a", m.body("b"), at=(1, 0))
    m.frame("tip", "b", at=(1, 0))
    with pytest.raises(TimeLimitError, match="over before anything was known"):
        m.build().singularities("tip", budget=Budget(starts=60_000, time_limit=1e-9))


def test_what_cannot_be_done_is_said():
    still = kempe.Mechanism("still")
    still.fixed("weld", still.ground, still.body("b"))
    with pytest.raises(InputError, match="'b' of still does not move"):
        still.build().singularities("b")
    with pytest.raises(InputError, match="is a chain: name a frame"):
        PUMA.singularities()
    with pytest.raises(UnknownNameError, match="task"):
        PUMA.singularities("tool", "twist")
    with pytest.raises(InputError, match="does not move"):
        PUMA.singularities(PUMA.body_names[0])
    with pytest.raises(InputError, match="has no actuated joint"):
        kempe.load("four_bar").singularities()
    with pytest.raises(InputError, match="budget has points"):
        PUMA.singularities("tool", budget=Budget(points=3))
    with pytest.raises(InputError, match="one configuration"):
        PUMA.singularities("tool", budget=FEW).nearest(np.zeros((2, 6)))


def test_a_gimbal_loses_a_direction_of_its_axis_where_that_is_along_the_first_turn():
    """What is lost is the turn about the axis that is across the pointing axis and the second axis
    of the gimbal.
    """
    m = kempe.Mechanism("gimbal")
    m.universal("U", m.ground, m.body("camera"))
    found = m.build().singularities("camera", "direction", budget=Budget(starts=16))
    (only,) = found.sets
    assert only.coordinates == ("U.ry",) and np.abs(np.cos(only.values)).max() < 1e-6
    for q, lost in zip(only.q, only.lost, strict=True):
        z = found.system.fk(q, "camera")[:3, 2]
        second = np.array([0.0, np.cos(q[0]), np.sin(q[0])])
        assert lost.shape == (1, 6) and np.abs(lost[0, 3:] @ np.cross(z, second)) == pytest.approx(
            1.0, abs=1e-6
        )
        assert np.abs(lost[0, :3]).max() < 1e-9
    planes = m.build().singularities("camera", "orientation", budget=Budget(starts=4))
    assert not planes.sets  # both turns stay independent as turns
    with pytest.raises(UnknownNameError, match="task 'direction'"):
        kempe.load("two_link").singularities("e", "direction")


def test_a_position_seen_along_two_axes():
    """A polar arm about a vertical axis whose height is driven: seen from the side it is singular
    where it comes by.
    """
    m = kempe.Mechanism("post")
    m.prismatic("h", m.ground, m.body("cart"), axis="z", limits=(0.0, 1.0))
    m.revolute("t", "cart", m.body("arm"), axis="z")
    m.frame("end", "arm", at=(0.5, 0, 0))
    for task, values in (("xz", [0.0, np.pi]), ("yz", [-0.5 * np.pi, 0.5 * np.pi])):
        (only,) = m.build().singularities("end", task, budget=Budget(starts=32)).sets
        assert only.coordinates == ("t",)
        off = np.abs(np.sin(0.5 * (only.values[:, :1] - np.array(values))))
        assert off.min(axis=1).max() < 1e-6 and off.min(axis=0).max() < 1e-6


@pytest.mark.slow
def test_of_a_platform_with_short_strokes_those_inside_the_limits_are_found():
    """Three legs in planes at 120 degrees: x and y of the level platform are squares of its tilts,
    so none moves it.
    """
    m = kempe.Mechanism("3-RPS")
    m.body("platform")
    for i, turn in enumerate(2.0 * np.pi / 3.0 * np.arange(3)):
        c = np.cos(turn)
        s = np.sin(turn)
        m.revolute(
            f"R{i}",
            m.ground,
            m.body(f"sleeve{i}"),
            at=(0.3 * c, 0.3 * s, 0.0),
            rpy=(0, 0, turn),
            axis="y",
        )
        m.prismatic(
            f"P{i}", f"sleeve{i}", m.body(f"rod{i}"), axis="z", actuated=True, limits=(0.25, 0.45)
        )
        m.spherical(f"S{i}", f"rod{i}", "platform", child_at=(0.2 * c, 0.2 * s, 0.0))
    system = m.build()
    found, second = system.singularities("platform", "position").sets
    assert found.kinds == ("type 1",) and found.dimension == 1
    assert second.kinds == ("type 2",) and second.dimension == 2 and len(second.q) >= 3
    # forces along the legs, and along the axes of the turns, at the balls: Pluecker lines
    for q in second.q:
        lines = []
        for i in range(3):
            sleeve = system.fk(q, f"sleeve{i}")
            ball = sleeve[:3, 3] + system.q_dict(q)[f"P{i}"] * sleeve[:3, 2]
            lines += [
                np.concatenate([v, np.cross(ball, v)]) for v in (sleeve[:3, 2], sleeve[:3, 1])
            ]
        assert abs(np.linalg.det(np.array(lines))) < 1e-9
        assert all(0.25 <= system.q_dict(q)[f"P{i}"] <= 0.45 for i in range(3))
    for q, lost in zip(found.q, found.lost, strict=True):
        X = system.fk(q, "platform")
        legs = [system.q_dict(q)[f"P{i}"] for i in range(3)]
        assert abs(abs(X[2, 2]) - 1.0) < 1e-9 and np.abs(X[:2, 3]).max() < 1e-9
        assert legs == pytest.approx([np.hypot(0.1, X[2, 3])] * 3) and 0.25 <= legs[0] <= 0.45
        assert np.linalg.matrix_rank(lost[:, :2]) == 2 and np.abs(lost[:, 2]).max() < 1e-9


@pytest.mark.slow
def test_the_nearest_singular_configuration_is_hardly_ever_farther_than_one_on_a_grid(hunt):
    """Arms of three skew hinges with limits: against changes of sign of the determinant along the
    lines of a grid.
    """
    rng = hunt.rng()
    far = 0
    count = 0
    side = np.linspace(-2.5, 2.5, 41)
    grid = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1)
    for _ in range(hunt.cases(5)):
        m = kempe.Mechanism("skew")
        last = m.ground
        for k in range(3):
            place = tuple(rng.uniform(-0.5, 0.5, 3)) if k else (0, 0, 0)
            m.revolute(
                f"j{k}",
                last,
                m.body(f"b{k}"),
                at=place,
                axis=tuple(rng.normal(size=3)),
                limits=(-2.5, 2.5),
            )
            last = f"b{k}"
        m.frame("e", last, at=tuple(rng.uniform(-0.6, 0.6, 3)))
        system = m.build()
        found = system.singularities("e", "position")
        points = [np.zeros((0, 3))]
        d = np.linalg.det(np.asarray(system.jacobian(grid, "e"))[..., :3, :])
        for axis in range(3):
            a = np.take(d, range(40), axis)
            b = np.take(d, range(1, 41), axis)
            at = np.argwhere(a * b < 0)
            p = side[at]
            p[:, axis] += (a / np.where(a == b, 1.0, a - b))[tuple(at.T)] * (side[1] - side[0])
            points.append(p)
        for q in rng.uniform(-2.4, 2.4, (3, 3)):
            best = np.linalg.norm(np.concatenate(points) - q, axis=1).min(initial=np.inf)
            far += found.nearest(q).distance > best + 0.02
            count += 1
    assert far <= max(1, 0.02 * count), f"{far} of {count}"
