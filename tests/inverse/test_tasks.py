"""Several tasks at once, against nested optimisation, closed forms, known truths, and the forward
model.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from linkages import planar_arm
from robots import urdf_files
from scipy.optimize import minimize

import kempe
from kempe import Mechanism, System, spatial, tasks
from kempe.equations.closure_rows import compute_residual
from kempe.equations.packed_tasks import Packed
from kempe.equations.tasks import Task
from kempe.errors import InputError, NoSolutionError
from kempe.inverse.answer import Reached, Solution

HAND = "panda_link7"


def two_arms() -> System:
    """A floating body with two arms of seven joints, limited, masses everywhere."""
    m = Mechanism("two arms")
    rng = np.random.default_rng(0)
    m.joint("base", "free", m.ground, m.body("torso", 5.0, (0.0, 0.0, 0.1)))
    for side, y in (("left", 0.2), ("right", -0.2)):
        before = "torso"
        at = (0.0, y, 0.3)
        for k in range(7):
            name = f"{side}{k}"
            m.revolute(
                name,
                before,
                m.body(f"{name} link", 1.0, (0.0, 0.0, 0.1)),
                at=at,
                rpy=(math.pi / 2 * (-1) ** k, 0.0, rng.normal(0, 0.1)),
                limits=(-2.2, 2.2),
            )
            before = f"{name} link"
            at = (0.0, 0.02, 0.2)
        m.frame(side, before, at=at)
    return m.build()


def inside(s: System, q: np.ndarray) -> bool:
    x = q[..., s.structure.layout.vector_q]
    v = s.structure.layout.vector_v
    return bool(np.all(x >= s.lower[v] - 1e-12) and np.all(x <= s.upper[v] + 1e-12))


# ---- hard tasks


def test_two_hands_and_the_centre_of_mass_of_a_floating_base():
    s = two_arms()
    rng = np.random.default_rng(2)
    for q in s.random(rng, 15):
        com = tasks.error(s, tasks.CentreOfMass([0.0, 0.0, 0.0]), q)
        answer = s.ik(
            [
                tasks.Pose("left", s.fk(q, "left")),
                tasks.Pose("right", s.fk(q, "right")),
                tasks.CentreOfMass(com),
            ]
        )
        assert answer.success and isinstance(answer, Solution) and inside(s, answer.q)
        for side in ("left", "right"):
            np.testing.assert_allclose(s.fk(answer.q, side), s.fk(q, side), atol=3e-6)
        np.testing.assert_allclose(
            tasks.error(s, tasks.CentreOfMass(com), answer.q), 0.0, atol=1e-6
        )
        assert (answer.m, answer.n, answer.rank, answer.redundancy) == (15, 20, 15, 5)
        assert answer.self_motion.shape == (20, 5)


@pytest.mark.parametrize(
    "name", ["stewart", "delta_uu", "three_rrr", "five_bar", "four_bar", "bennett", "scissor"]
)
def test_closed_loops_stay_closed(name):
    s = kempe.load(name)
    frame = "platform" if "platform" in s.body_names else s.body_names[-1]
    closed = s.assemble(start=s.random(0, 8))
    assert closed.success.sum() >= 3
    for q in closed.q[closed.success]:
        answer = s.ik(tasks.Pose(frame, s.fk(q, frame)))
        assert answer.success, answer.status
        np.testing.assert_allclose(compute_residual(s, answer.q), 0.0, atol=1e-9)
        np.testing.assert_allclose(s.fk(answer.q, frame), s.fk(q, frame), atol=3e-6)


def test_a_leg_with_a_four_bar_and_a_coupling():
    """A planar leg on a slider whose knee is driven through a four-bar; a gear moves a foot with
    it.
    """
    m = Mechanism("leg", dim=2)
    for body in ("hip", "crank", "rod", "shin", "foot"):
        m.body(body)
    m.prismatic("rail", "ground", "hip", axis=(1.0, 0.0), limits=(-2.0, 2.0))
    m.revolute("motor", "hip", "crank", at=(0.0, 0.0))
    m.revolute("knee", "hip", "shin", at=(0.4, 0.0))
    m.revolute("a", "crank", "rod", at=(0.1, 0.0))
    m.revolute("b", "rod", "shin", at=(0.4, 0.0), child_at=(0.1, 0.05), cut=True)
    m.revolute("ankle", "shin", "foot", at=(0.0, -0.5))
    m.gear("ankle", "motor", -1.0, 0.2)
    s = m.build()
    goal = s.assemble({"motor": 0.7, "rail": 0.3})
    assert goal.success
    X = s.fk(goal.q, "foot")
    answer = s.ik(tasks.Position("foot", X[:2, 3]))
    assert answer.success and (answer.n, answer.rank, answer.redundancy) == (2, 2, 0)
    np.testing.assert_allclose(s.fk(answer.q, "foot")[:3, 3], X[:3, 3], atol=1e-6)
    np.testing.assert_allclose(compute_residual(s, answer.q), 0.0, atol=1e-9)


def test_a_relation_of_several_coordinates_holds():
    m = planar_arm(1.0, 1.0, 1.0).mechanism
    m.couple("q3", {"q1": 0.5, "q2": -1.0}, 0.3)
    s = m.build()
    q = s.q({"q1": 0.4, "q2": 1.0, "q3": 0.5 * 0.4 - 1.0 + 0.3})
    answer = s.ik(tasks.Position("tip", s.fk(q, "tip")[:2, 3]))
    j1, j2, j3 = answer.q
    assert answer.success and j3 == pytest.approx(0.5 * j1 - j2 + 0.3, abs=1e-9) and answer.n == 2


def test_every_kind_of_hard_task_is_met_where_it_can_be():
    """Goals are read off a random configuration, so that each can be met."""
    s = two_arms()
    rng = np.random.default_rng(3)
    for q in s.random(rng, 4):
        L = s.fk(q, "left")
        R = s.fk(q, "right")
        z = L[:3, 2]
        d = rng.normal(size=3)
        far = np.linalg.norm(R[:3, 3] - L[:3, 3])
        for task in (
            tasks.Pose("left", L),
            tasks.Position("left", (L @ [0.1, 0, 0, 1])[:3], point=[0.1, 0, 0]),
            tasks.Orientation("left", L[:3, :3]),
            tasks.Pointing("left", z),
            tasks.LookAt("left", L[:3, 3] + 0.7 * z),
            tasks.OnLine("left", L[:3, 3] + d, d),
            tasks.OnPlane("left", L[:3, 3], d),
            tasks.OnSphere("left", L[:3, 3] + d, np.linalg.norm(d)),
            tasks.InBox("left", [-1, -1, -1], [0, 0.1, 0.1], L),
            tasks.HalfSpace("left", L[:3, 3] - 0.2 * d / np.linalg.norm(d), d, margin=0.2),
            tasks.RelativePose("left", "right", spatial.inverse(R) @ L),
            tasks.RelativePosition("left", "right", (spatial.inverse(R) @ L)[:3, 3]),
            tasks.Distance("left", "right", far),
            tasks.Distance("left", "right", at_least=far, at_most=far + 0.1),
            tasks.Posture(q, weight=None),
            tasks.CentreOfPoints(["left", "right"], 0.5 * (L + R)[:3, 3]),
            tasks.Function(lambda x, q=q: (x - q)[7:] + 0.2 * (np.sin(x[7:]) - np.sin(q[7:]))),
        ):
            answer = s.ik(
                [task, tasks.HalfSpace("torso", [0, 0, -9], [0, 0, 1])], start=s.random(rng)
            )
            assert answer.success, answer.status
            assert all(np.all(e <= 1.1e-6) for e in answer.errors.values()) and inside(s, answer.q)


def test_joints_at_their_limits():
    """Targets made by configurations with half of the joints exactly at a limit."""
    s = two_arms()
    rng = np.random.default_rng(4)
    found = 0
    for q in s.random(rng, 20):
        at = rng.random(14) < 0.5
        q[7:][at] = np.where(rng.random(14) < 0.5, s.lower[6:], s.upper[6:])[at]
        answer = s.ik([tasks.Pose("left", s.fk(q, "left")), tasks.Pose("right", s.fk(q, "right"))])
        assert inside(s, answer.q)
        found += answer.success
    assert found == 20


def test_wide_limits_do_not_stand_in_the_way():
    """Joints that can turn by two turns and more: a start needs not find the right one."""
    s = kempe.load("ur5")
    frame = s.body_names[-1]
    rng = np.random.default_rng(5)
    answers = [
        s.ik(tasks.Pose(frame, s.fk(q, frame)), start=s.random(rng)) for q in s.random(rng, 40)
    ]
    assert all(a.success and inside(s, a.q) for a in answers)
    assert np.mean([a.starts == 1 for a in answers]) > 0.6


# ---- soft tasks and priorities


def cost_of(s: System, task: tasks.Task):
    """Half the square of a task's error in characteristic lengths, and its gradient by scaled
    velocities.
    """
    packed = Packed(s, [task])
    pins = packed.pack_pins([Task(s, task).goal])

    def cost(q: np.ndarray) -> tuple[float, np.ndarray]:
        e, J = packed.evaluate_tasks(q, pins)
        return 0.5 * float(e @ e), J.T @ e

    return cost


def equal_to(s: System, task: tasks.Task, value: np.ndarray | None = None) -> dict:
    """The task, at a value, as a constraint for scipy."""
    packed = Packed(s, [task])
    pins = packed.pack_pins([Task(s, task).goal])
    return {
        "type": "eq",
        "fun": lambda q: packed.evaluate_tasks(q, pins)[0] - (0.0 if value is None else value),
        "jac": lambda q: packed.evaluate_tasks(q, pins)[1],
    }


def least(function, s: System, q: np.ndarray, constraints: list[dict]) -> float:
    """The local minimum near q, by sequential quadratic programming."""
    options = {"ftol": 1e-15, "maxiter": 400}
    bounds = list(zip(s.lower, s.upper, strict=True))
    found = minimize(
        function,
        q,
        jac=True,
        bounds=bounds,
        constraints=constraints,
        method="SLSQP",
        options=options,
    )
    assert max((np.abs(c["fun"](found.x)).max() for c in constraints), default=0.0) < 1e-7
    return found.fun


@pytest.mark.parametrize("seed", range(6))
def test_levels_are_optima_of_a_nested_optimisation(seed):
    """A hard task, two weighted soft ones below it, a posture below these: each level as SLSQP
    finds it.
    """
    s = kempe.load("panda")
    rng = np.random.default_rng(seed)
    X = s.fk(s.random(rng), HAND)
    hard = tasks.Position(HAND, X[:3, 3])
    point = tasks.Pointing(HAND, rng.normal(size=3), weight=2.0)
    elbow = tasks.Position("panda_link4", X[:3, 3] + 0.4 * rng.normal(size=3), weight=0.5)
    posture = tasks.Posture(s.random(rng), priority=1)
    answer = s.ik([posture, elbow, hard, point], start=s.random(rng))
    assert answer.success and inside(s, answer.q)
    a = cost_of(s, point)
    b = cost_of(s, elbow)
    c = cost_of(s, posture)

    def middle(q):
        (x, gx) = a(q)
        (y, gy) = b(q)
        return x + 0.25 * y, gx + 0.25 * gy

    best = least(middle, s, answer.q, [equal_to(s, hard)])
    assert middle(answer.q)[0] == pytest.approx(best, abs=1e-7)
    held = [equal_to(s, hard)]
    for task in (point, elbow):
        packed = Packed(s, [task])
        held.append(
            equal_to(
                s,
                task,
                packed.evaluate_tasks(answer.q, packed.pack_pins([Task(s, task).goal]))[0],
            )
        )
    lowest = least(c, s, answer.q, held)
    assert c(answer.q)[0] == pytest.approx(lowest, abs=1e-5)


def test_a_lower_level_disturbs_no_higher_one():
    """From where the higher levels end: they are lowered on, if at all."""
    s = two_arms()
    rng = np.random.default_rng(1)
    for q in s.random(rng, 4):
        higher = [
            tasks.Pose("left", s.fk(q, "left")),
            tasks.Position("left", [5.0, 0.0, 0.0], weight=1.0),
            tasks.Position("right", [5.0, 0.0, 0.0], weight=1.0, priority=1),
        ]
        alone = s.ik(higher, start=q)
        both = s.ik([*higher, tasks.Posture(s.random(rng), priority=2)], start=alone.q)
        for task in higher:
            assert np.all(both.errors[task.label] <= alone.errors[task.label] + 1e-6)
        assert not np.allclose(both.q, alone.q, atol=1e-2)


def test_contradictory_hard_levels_keep_the_first():
    s = planar_arm(1.0, 1.0)
    near = tasks.Position("tip", [1.0, 0.5])
    far = tasks.Position("tip", [1.5, 0.5], priority=1, name="far")
    answer = s.ik([far, near])
    assert not answer.success
    assert answer.errors[near.label][0] < 1e-6 and answer.errors["far"][0] == pytest.approx(
        0.5, abs=1e-5
    )


def test_inequalities_bind_only_where_they_must():
    """The tip goes to a point as far as a wall lets it: the closest point of the wall."""
    s = planar_arm(1.0, 1.0, 1.0)
    goal = tasks.Position("tip", [2.0, 1.0], weight=1.0)
    wall = tasks.HalfSpace("tip", [1.5, 0.0], [-1.0, 0.0], name="wall")
    answer = s.ik([goal, wall], start=[0.3, 0.3, 0.3])
    assert answer.success
    np.testing.assert_allclose(s.fk(answer.q, "tip")[:2, 3], [1.5, 1.0], atol=1e-6)
    free = s.ik([goal, tasks.HalfSpace("tip", [2.5, 0.0], [-1.0, 0.0])], start=[0.3, 0.3, 0.3])
    np.testing.assert_allclose(s.fk(free.q, "tip")[:2, 3], [2.0, 1.0], atol=1e-6)
    apart = s.ik(
        [tasks.Distance("tip", "ground", at_least=2.9), tasks.InBox("tip", [2.0, 2.0], [3.0, 3.0])]
    )
    assert apart.success and np.linalg.norm(s.fk(apart.q, "tip")[:2, 3]) >= 2.9 - 1e-6


# ---- what is preferred in what is left


@pytest.mark.slow
def test_nearest_and_mid_are_the_nearest_with_the_tasks_held():
    s = kempe.load("panda")
    rng = np.random.default_rng(6)
    for q in s.random(rng, 4):
        seed = s.random(rng)
        task = tasks.Pose(HAND, s.fk(q, HAND))
        for prefer, to in (("nearest", seed), ("mid", s.mid)):
            answer = s.ik(task, start=seed, prefer=prefer)
            assert answer.success
            best = least(
                lambda x, to=to: (0.5 * float((x - to) @ (x - to)), x - to),
                s,
                answer.q,
                [equal_to(s, task)],
            )
            assert 0.5 * np.sum((answer.q - to) ** 2) == pytest.approx(best, abs=1e-6)


@pytest.mark.parametrize("name", ["five_bar", "stewart", "four_bar", "seven_bodies_loop"])
def test_the_nearest_closed_configuration_is_that_of_assembly(name):
    """A soft posture on a closed loop, against `assemble(nearest=True)`, which finds it in another
    way.
    """
    s = kempe.load(name)
    for near in s.random(1, 4):
        there = s.assemble(start=near, prefer="nearest")
        answer = s.ik(tasks.Posture(near), start=there.q)
        scale = Packed(s, [tasks.Posture(near)]).scale
        far, least = (
            float(np.sum((s.configuration_space.difference(q, near) / scale) ** 2))
            for q in (there.q, answer.q)
        )
        assert there.success and answer.success and least <= far + 1e-9
        np.testing.assert_allclose(compute_residual(s, answer.q), 0.0, atol=1e-9)


def test_preferred_functions_are_stationary_along_the_self_motion():
    s = kempe.load("panda")
    seed = s.random(8)
    task = tasks.Pose(HAND, s.fk(seed, HAND))

    def manipulability(q):
        J = s.jacobian(q, HAND)
        return 0.5 * math.log(np.linalg.det(J @ J.T))

    def mine(q):
        return (q[2] - 0.3) ** 2 + math.sin(q[0])

    for prefer, function, sign in (("manipulability", manipulability, -1.0), (mine, mine, 1.0)):
        answer = s.ik(task, start=seed, prefer=prefer)
        assert answer.success and sign * function(answer.q) < sign * function(seed)
        v = answer.self_motion[:, 0]
        slope = (function(answer.q + 1e-5 * v) - function(answer.q - 1e-5 * v)) / 2e-5
        push = -sign * slope * v
        stopped = np.any((answer.q >= s.upper - 1e-6) & (push > 0)) or np.any(
            (answer.q <= s.lower + 1e-6) & (push < 0)
        )
        assert stopped or abs(slope) < 1e-3


def test_preferences_of_a_batch_are_those_of_its_rows():
    s = kempe.load("panda")
    seeds = s.random(12, 3)
    X = s.fk(seeds, HAND)
    for prefer in ("nearest", "mid", "manipulability", lambda q: float(q @ q)):
        many = s.ik(tasks.Pose(HAND, X), start=seeds, prefer=prefer)
        assert many.success.all()
        for i in range(3):
            one = s.ik(tasks.Pose(HAND, X[i]), start=seeds[i], prefer=prefer)
            np.testing.assert_allclose(one.q, many.q[i], atol=1e-9)
    assert s.ik(tasks.Pose(HAND, X[:0]), prefer="manipulability").q.shape == (0, 7)
    assert s.ik(tasks.Pose(HAND, X[:0])).success.shape == (0,)


# ---- why not


def test_contradictory_tasks_are_named():
    s = two_arms()
    there = [tasks.Position("left", [5.0, 0.0, 0.0]), tasks.Position("right", [-5.0, 0.0, 0.0])]
    answer = s.ik([*there, tasks.Orientation("torso", np.eye(3))])
    assert not answer.success
    assert (
        f"contradictory: {there[0].label!r} and {there[1].label!r}: their places are 10 m apart"
        in answer.status
    )
    assert answer.proven
    assert "'Orientation of 'torso''" not in answer.status.split("contradictory")[1]
    with pytest.raises(NoSolutionError):
        s.ik(there).expect()


def test_blocked_by_limits_is_said_with_the_joint():
    s = planar_arm(1.0, 1.0, limits=[(-3.0, 3.0), (-0.5, 0.5)])
    answer = s.ik(tasks.Position("tip", [1.0, 0.2]))
    assert not answer.success and not answer.proven
    assert "without the limit of 'q2' it is reached, so that may be what blocks it" in answer.status


def test_too_many_equations_are_said():
    s = planar_arm(1.0, 1.0)
    answer = s.ik(tasks.Pose("tip", spatial.pose(spatial.rot_z(2.0), [1.0, 1.0, 0.0])))
    assert not answer.success and "(3 equations, but 2 freedoms)" in answer.status
    q = s.q({"q1": 0.3, "q2": 0.9})
    fits = s.ik(tasks.Pose("tip", s.fk(q, "tip")))
    assert fits.success and "no freedom is left, though 3 equations meet 2 freedoms" in fits.status


def test_out_of_reach_is_missed_by_as_much_as_must_be():
    s = planar_arm(1.0, 1.0)
    answer = s.ik(tasks.Position("tip", [3.0, 0.0]))
    assert not answer.success and answer.errors["Position of 'tip'"][0] == pytest.approx(
        1.0, abs=1e-6
    )
    assert "is missed by 1 m" in answer.status and f"{answer.starts} starts" in answer.status


def test_no_false_success():
    """What is called a success holds, whatever the tasks: checked by the forward model on
    impossible and odd ones.
    """
    s = kempe.load("panda")
    rng = np.random.default_rng(9)
    for _ in range(20):
        X = spatial.pose(spatial.exp_so3(rng.normal(size=3)), rng.uniform(-1, 1, 3))
        answer = s.ik(
            [tasks.Pose(HAND, X), tasks.HalfSpace("panda_link4", [0, 0, 0.4], [0, 0, 1])],
            budget=kempe.Budget(starts=10),
        )
        held = (
            np.abs(s.fk(answer.q, HAND) - X).max() < 3e-6
            and s.fk(answer.q, "panda_link4")[2, 3] > 0.4 - 2e-6
        )
        assert answer.success == (held and inside(s, answer.q))


# ---- batches


def test_batches_are_their_rows_and_do_not_depend_on_threads():
    s = two_arms()
    q = s.random(10, (4, 12))
    L = s.fk(q, "left")
    R = s.fk(q, "right")[..., :3, 3]
    wanted = [
        tasks.Pose("left", L),
        tasks.Position("right", R),
        tasks.Posture(s.neutral, priority=1),
    ]
    answer = s.ik(wanted, budget=kempe.Budget(threads=1))
    assert (
        answer.q.shape == (4, 12, s.nq)
        and answer.success.all()
        and answer.errors[wanted[0].label].shape == (4, 12, 2)
    )
    for threads in (2, 5):
        np.testing.assert_array_equal(
            s.ik(wanted, budget=kempe.Budget(threads=threads)).q, answer.q
        )
    first = s.ik([tasks.Pose("left", L[0, 0]), tasks.Position("right", R[0, 0]), wanted[2]])
    np.testing.assert_array_equal(first.q, answer.q[0, 0])
    assert "48 of 48 problems solved" in str(answer) and answer.status[1, 2].startswith(
        "all hard tasks hold"
    )
    with pytest.raises(InputError, match="one answer"):
        _ = answer.rank


def test_bad_rows_stay_alone():
    s = kempe.load("panda")
    X = s.fk(s.random(0, 5), HAND)
    X[2, 0, 3], X[3, :3, 0] = math.nan, X[3, :3, 1]
    answer = s.ik(tasks.Pose(HAND, X))
    assert answer.success.tolist() == [True, True, False, False, True]
    assert np.isnan(answer.q[[2, 3]]).all() and "not finite" in answer.status[2]


def test_what_is_refused():
    s = kempe.load("panda")
    X = s.fk(s.random(0), HAND)
    for bad, match in (
        ((X,), "task of kempe.tasks"),
        (([],), "task of kempe.tasks"),
        ((tasks.Pose(HAND, X, weight=-1),), "weight"),
        ((tasks.Pose(HAND, X, priority=0.5),), "priority"),
        ((tasks.Pose(HAND, 2 * X - np.diag([0, 0, 0, 1])),), "is not a pose"),
        ((tasks.Pose(HAND, np.where(np.eye(4) > 0, np.nan, X)),), "it must be finite"),
        (
            ([tasks.Pose(HAND, X[None].repeat(2, 0)), tasks.Position(HAND, np.zeros((3, 3)))],),
            "fit together",
        ),
    ):
        with pytest.raises(InputError, match=match):
            s.ik(*bad)
    nan = [math.nan] * 7
    none = kempe.Budget(starts=0)
    for more, match in (
        ({"prefer": "best"}, "prefer"),
        ({"start": nan}, "start"),
        ({"budget": none}, "starts"),
    ):
        with pytest.raises(InputError, match=match):
            s.ik(tasks.Pose(HAND, X), **more)

    def broken(q):
        raise ZeroDivisionError("mine") if abs(q[0]) < 1e-3 else ValueError("mine")

    with pytest.raises((ZeroDivisionError, ValueError), match="mine"):
        s.ik(tasks.Function(broken))
    calls = itertools.count()

    def breaks_later(q):
        if next(calls) > 40:
            raise ZeroDivisionError("later")
        return q[0] - 0.5 + 0.0 * q[1]

    with pytest.raises(ZeroDivisionError, match="later"):
        s.ik([tasks.Function(breaks_later), tasks.Position(HAND, [9.0, 0, 0])])


def test_functions_do_what_the_tasks_they_stand_for_do():
    s = kempe.load("panda")
    q = s.random(11)
    p = s.fk(q, HAND)[:3, 3]
    mine = tasks.Function(lambda x: s.fk(x, HAND)[:3, 3] - p, lambda x: s.jacobian(x, HAND)[:3])
    a = s.ik(mine, start=s.mid)
    b = s.ik(tasks.Position(HAND, p), start=s.mid)
    assert a.success and b.success
    np.testing.assert_allclose(s.fk(a.q, HAND)[:3, 3], p, atol=1e-6)
    between = s.ik(
        tasks.Function(lambda x: x[:2] * 1.0, low=[0.5, -1.0], high=[0.7, -0.9]), start=np.zeros(7)
    )
    assert (
        between.success
        and between.q[0] == pytest.approx(0.5, abs=1e-6)
        and between.q[1] == pytest.approx(-0.9, abs=1e-6)
    )


# ---- self-motions


def test_the_self_motion_of_three_links_closes():
    """The tip of a planar 3R near its base: its fibre is a closed curve, on which the tip stays."""
    s = planar_arm(1.0, 0.8, 0.6)
    q = np.array([0.4, 1.9, 1.2])
    p = s.fk(q, "tip")
    m = s.inverse.self_motion(q, tasks.Position("tip", p[:2, 3]), budget=kempe.Budget(points=400))
    assert m.closed and m.freedoms == 1 and len(m) > 50
    np.testing.assert_allclose(s.fk(m.q, "tip")[:, :3, 3] - p[:3, 3], 0.0, atol=1e-9)
    steps = np.linalg.norm(
        [s.configuration_space.difference(a, b) for a, b in itertools.pairwise(m.q)], axis=-1
    )
    assert steps.max() < 0.06
    assert s.configuration_space.distance(m.q[-1], m.q[0]) < 0.06


def test_a_self_motion_stops_at_limits_and_keeps_the_pose():
    s = kempe.load("panda")
    q = s.random(4)
    m = s.inverse.self_motion(q, HAND)
    assert not m.closed and all(end.startswith("the limit of") for end in m.ends) and inside(s, m.q)
    np.testing.assert_allclose(
        s.fk(m.q, HAND), np.broadcast_to(s.fk(q, HAND), (len(m), 4, 4)), atol=1e-9
    )
    np.testing.assert_allclose(m.q[m.start], q, atol=1e-9)
    for q_end, name in ((m.q[0], m.ends[0]), (m.q[-1], m.ends[1])):
        i = s.coordinate_names.index(name.split("'")[1])
        assert min(q_end[i] - s.lower[i], s.upper[i] - q_end[i]) < 1e-5


def test_one_direction_of_a_larger_self_motion():
    s = kempe.load("panda")
    q = s.random(4)
    task = tasks.Position(HAND, s.fk(q, HAND)[:3, 3])
    with pytest.raises(InputError, match="4 freedoms"):
        s.inverse.self_motion(q, task)
    m = s.inverse.self_motion(q, task, direction="panda_joint1", budget=kempe.Budget(points=10))
    assert m.freedoms == 4 and np.all(np.diff(m.q[:, 0]) > 0)
    np.testing.assert_allclose(s.fk(m.q, HAND)[:, :3, 3] - task.target, 0.0, atol=1e-9)
    with pytest.raises(InputError, match="do not hold"):
        s.inverse.self_motion(q, tasks.Position(HAND, [0.3, 0.3, 0.3]))
    with pytest.raises(InputError, match="no freedom"):
        s.inverse.self_motion(q, tasks.Posture(q, weight=None))


def test_the_self_motion_of_a_platform_is_the_spin_of_its_legs():
    """A Stewart platform with balls at both ends of its legs: six spins, which the basis of
    self-motions has.
    """
    s = kempe.load("stewart_sps")
    q = s.assemble().q
    answer = s.ik(tasks.Pose("platform", s.fk(q, "platform")), start=q)
    assert (answer.success, answer.n, answer.rank, answer.redundancy) == (True, 12, 6, 6)
    length = Packed(s, [tasks.Pose("platform", np.eye(4))]).scale
    v = 1e-4 * length * answer.self_motion[:, 2]
    moved = s.configuration_space.integrate(answer.q, v)
    assert np.abs(s.fk(moved, "platform") - s.fk(answer.q, "platform")).max() < 1e-7
    assert np.abs(compute_residual(s, moved)).max() < 1e-7


# ---- whole bodies


@pytest.mark.slow
@pytest.mark.skipif(not urdf_files(), reason="the package example-robot-data is not installed")
@pytest.mark.parametrize("with_mass, least_found", [(False, 0.99), (True, 0.98)])
def test_the_whole_body_of_a_humanoid(with_mass, least_found):
    """Both feet and both hands of a Unitree G1 with a floating base, 300 reachable targets."""
    path = next(p for n, p in urdf_files().items() if n.endswith("g1_29dof_rev_1_0.urdf"))
    s = kempe.load(path, base="free")
    frames = [
        "left_ankle_roll_link",
        "right_ankle_roll_link",
        "left_rubber_hand",
        "right_rubber_hand",
    ]
    q = s.random(5, 300)
    wanted: list[tasks.Task] = [tasks.Pose(f, s.fk(q, f)) for f in frames]
    if with_mass:
        wanted.append(tasks.CentreOfMass(tasks.error(s, tasks.CentreOfMass([0.0, 0.0, 0.0]), q)))
    answer = s.ik(wanted, tolerance=(1e-4, 1e-3))
    assert isinstance(answer, Reached) and np.mean(answer.success) >= least_found
    for f in frames:
        assert np.abs(s.fk(answer.q, f) - s.fk(q, f))[answer.success].max() < 2e-3
    assert inside(s, answer.q)


def mobile(planar: bool) -> System:
    """An arm of four joints on a base that drives over the ground: a planar joint, or slides and a
    turn.
    """
    m = Mechanism("mobile")
    if planar:
        m.joint("drive", "planar", m.ground, m.body("base"))
    else:
        m.prismatic("x", "ground", m.body("rail"), axis=(1, 0, 0))
        m.prismatic("y", "rail", m.body("cart"), axis=(0, 1, 0))
        m.revolute("yaw", "cart", m.body("base"))
    before = "base"
    at = (0.0, 0.0, 0.5)
    for k in range(4):
        m.revolute(
            f"j{k}",
            before,
            m.body(f"l{k}"),
            at=at,
            rpy=(math.pi / 2 * (-1) ** k, 0, 0),
            limits=(-2.5, 2.5),
        )
        before = f"l{k}"
        at = (0.02, 0.0, 0.2)
    m.frame("tool", before, at=at)
    return m.build()


@pytest.mark.parametrize("planar", [True, False])
def test_a_base_that_drives_begins_beside_its_target(planar):
    s = mobile(planar)
    rng = np.random.default_rng(0)
    q = s.random(rng, 20)
    q[:, :2] += rng.normal(size=(20, 2)) * 2000.0
    X = s.fk(q, "tool")
    answer = s.ik(tasks.Pose("tool", X), tolerance=1e-6)
    assert answer.success.all() and answer.starts.max() <= 20
    np.testing.assert_allclose(s.fk(answer.q, "tool"), X, atol=3e-6)
    one = s.ik([tasks.Posture(s.neutral), tasks.Position("tool", X[0, :3, 3])])
    assert one.success and one.starts == 1
    with pytest.raises(InputError, match="finite"):
        s.ik(tasks.Position("tool", [math.nan, 0.0, 0.0]))
    mixed = s.ik(tasks.Position("tool", [[0.2, 0.1, 0.9], [9e3, 0.0, 0.9], [math.nan, 0.0, 0.0]]))
    np.testing.assert_array_equal(mixed.success, [True, True, False])
    np.testing.assert_array_equal(mixed.q[0], s.ik(tasks.Position("tool", [0.2, 0.1, 0.9])).q)
