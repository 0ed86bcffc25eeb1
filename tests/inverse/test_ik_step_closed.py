"""Steps of velocities under closed loops, relations and tasks, against linear programs, SLSQP and
the forward model.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hunts import some
from scipy.optimize import linprog, minimize

import kempe
from kempe import Mechanism, System, spatial, tasks
from kempe.equations.closure_rows import compute_residual, evaluate_constraints
from kempe.errors import InputError

DT = 0.01
PLANE = [1.0, 1.0, 0.0, 0.0, 0.0, 0.0]


def leg(speed: float | None = None) -> System:
    """A planar leg on a slider whose knee is driven through a four-bar; the ankle follows two
    coordinates.
    """
    m = Mechanism("leg", dim=2)
    for body in ("hip", "crank", "rod", "shin", "foot"):
        m.body(body)
    m.prismatic("rail", "ground", "hip", axis=(1.0, 0.0), limits=(-0.3, 0.3))
    m.revolute("motor", "hip", "crank", at=(0.0, 0.0), limits=(-1.2, 1.6), velocity=speed)
    m.revolute("knee", "hip", "shin", at=(0.4, 0.0))
    m.revolute("a", "crank", "rod", at=(0.1, 0.0))
    m.revolute("b", "rod", "shin", at=(0.4, 0.0), child_at=(0.1, 0.05), cut=True)
    m.revolute("ankle", "shin", "foot", at=(0.0, -0.5))
    m.frame("toe", "foot", at=(0.2, 0.0))
    m.couple("ankle", {"motor": -0.5, "knee": 0.3}, 0.2)
    return m.build()


def circle(X: np.ndarray, radius: float, t: float, axes: tuple[int, int] = (0, 1)) -> np.ndarray:
    """The pose X moved along a circle through it."""
    out = X.copy()
    out[axes[0], 3] += radius * (math.cos(2 * math.pi * t) - 1.0)
    out[axes[1], 3] += radius * math.sin(2 * math.pi * t)
    return out


@pytest.mark.parametrize(
    ("system", "frame", "known", "axes", "weights", "radius", "steps"),
    some(
        [
            (kempe.load("stewart"), "platform", {}, (0, 2), None, 0.0075, 250),
            (kempe.load("five_bar"), "tip", {}, (0, 1), PLANE, 0.03, 1000),
            (leg(), "toe", {"motor": 0.5, "rail": 0.0}, (0, 1), PLANE, 0.01, 1000),
            pytest.param(
                kempe.load("stewart"),
                "platform",
                {},
                (0, 2),
                None,
                0.03,
                1000,
                marks=pytest.mark.slow,
            ),
            pytest.param(
                kempe.load("delta_uu"),
                "platform",
                {},
                (0, 2),
                None,
                0.03,
                1000,
                marks=pytest.mark.slow,
            ),
        ],
        3,
    ),
    ids=["stewart", "five bar", "leg", "stewart, long", "delta"],
)
def test_loops_stay_closed_over_many_steps(system, frame, known, axes, weights, radius, steps):
    q = system.assemble(known).q
    X = system.fk(q, frame)
    for i in range(1, steps + 1):
        wanted = circle(X, radius, i / steps, axes)
        before = q
        s = system.ik_step(q, wanted, frame, DT, weights=weights)
        q = s.q
        np.testing.assert_allclose(system.fk(q, frame)[:3, 3], wanted[:3, 3], atol=5e-7)
        if i % 50 == 0:
            assert np.abs(compute_residual(system, q)).max() < 1e-11
            C = evaluate_constraints(system, before)[1]
            np.testing.assert_allclose(C @ s.velocity, 0.0, atol=1e-9)  # first order
            np.testing.assert_allclose(
                system.configuration_space.difference(before, q) / DT, s.velocity, atol=0.02
            )
            np.testing.assert_allclose(
                s.twist, system.jacobian(before, frame) @ s.velocity, atol=1e-12
            )


def test_the_part_of_a_direction_is_that_of_a_linear_program():
    s = leg()
    rng = np.random.default_rng(0)
    met = 0
    for _ in range(15):
        q = s.assemble({"motor": rng.uniform(-0.5, 1.2), "rail": rng.uniform(-0.2, 0.2)}).q
        J = s.jacobian(q, "toe")[:2]
        C = evaluate_constraints(s, q)[1]
        twist = rng.normal(size=2)
        fast = 0.5
        low = np.full(s.nv, -fast)
        high = np.full(s.nv, fast)
        low = np.maximum(low, (s.lower - q) / DT)
        high = np.minimum(high, (s.upper - q) / DT)
        best = linprog(
            np.append(np.zeros(s.nv), -1.0),
            A_eq=np.vstack([np.column_stack([J, -twist]), np.column_stack([C, np.zeros(len(C))])]),
            b_eq=np.zeros(2 + len(C)),
            bounds=[*zip(low, high, strict=True), (0.0, 1.0)],
        )
        got = s.ik_step(
            q,
            [*twist, 0, 0, 0, 0],
            "toe",
            DT,
            velocity_limits=fast,
            keep_direction=True,
            weights=PLANE,
        )
        # self-motions cost a little
        assert 0.9 * best.x[-1] - 1e-6 <= got.fraction <= best.x[-1] + 1e-6
        np.testing.assert_allclose(got.twist[:2], got.fraction * twist, atol=1e-4)
        assert np.all(np.abs(s.configuration_space.difference(q, got.q)) <= fast * DT * (1 + 1e-9))
        met += got.fraction < 0.99
    assert met > 5


def test_limits_of_speed_and_position_are_those_of_a_general_optimiser():
    s = leg(0.8)
    rng = np.random.default_rng(1)
    met = 0
    assert s.structure.velocity_limits[s.structure.velocity_names.index("motor")] == 0.8
    for _ in range(12):
        q = s.assemble({"motor": rng.uniform(-0.5, 1.2), "rail": rng.choice([-0.3, 0.0, 0.3])}).q
        wish = rng.normal(size=2)
        speed = np.minimum(s.structure.velocity_limits, 3.0)
        got = s.ik_step(
            q, [*wish, 0, 0, 0, 0], "toe", DT, velocity_limits=speed, weights=PLANE, damping=0.0
        )
        J = s.jacobian(q, "toe")[:2]
        C = evaluate_constraints(s, q)[1]
        low = np.maximum(-speed, (s.lower - q) / DT)
        high = np.minimum(speed, (s.upper - q) / DT)
        best = minimize(
            lambda v, J=J, wish=wish: np.sum((J @ v - wish) ** 2),
            np.zeros(s.nv),
            method="SLSQP",
            jac=lambda v, J=J, wish=wish: 2 * J.T @ (J @ v - wish),
            bounds=[*zip(low, high, strict=True)],
            constraints={"type": "eq", "fun": lambda v, C=C: C @ v, "jac": lambda v, C=C: C},
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert np.sum((got.twist[:2] - wish) ** 2) <= 1.03 * best.fun + 1e-7
        assert np.all(got.velocity >= low - 1e-9) and np.all(got.velocity <= high + 1e-9)
        assert np.all(got.q >= s.lower) and np.all(got.q <= s.upper)
        met += bool(got.saturated)
    assert met > 5


@pytest.mark.slow
def test_a_path_against_a_limit_stays_inside_and_closed():
    s = leg(1.0)
    q = s.assemble({"motor": 0.5, "rail": 0.0}).q
    goal = s.fk(q, "toe")
    goal[0, 3] += 2.0
    for _ in range(150):
        before = q
        q = s.ik_step(q, goal, "toe", DT, weights=PLANE, velocity_limits=2.0).q
        assert np.all(q >= s.lower) and np.all(q <= s.upper)
        assert np.abs(compute_residual(s, q)).max() < 1e-11
        assert np.abs(q - before).max() <= 2.0 * DT * (1 + 1e-9)
    assert q[s.coordinate_names.index("rail")] == pytest.approx(0.3, abs=1e-9)


def test_drift_is_taken_back_and_open_loops_are_refused():
    s = kempe.load("five_bar")
    q = s.assemble().q
    open_ = q + 1e-5 * np.random.default_rng(0).normal(size=s.nq)
    assert np.abs(compute_residual(s, open_)).max() > 1e-7
    assert np.abs(compute_residual(s, s.ik_step(open_, np.zeros(6), "tip", DT).q)).max() < 1e-11
    with pytest.raises(InputError, match="assemble"):
        s.ik_step(q + 0.1, np.zeros(6), "tip", DT)


def test_what_is_outside_its_limits_may_rest_and_goes_no_further():
    s = leg()
    free = s.assemble({"motor": 0.4, "rail": 0.35}, limits=False).q
    rail = s.coordinate_names.index("rail")
    got = s.ik_step(free, np.zeros(6), "toe", DT, velocity_limits=1.0)
    assert np.abs(got.velocity).max() < 1e-6 and got.success
    for sign in (-1.0, 1.0):
        X = s.fk(free, "toe")
        X[0, 3] += sign * 0.01
        got = s.ik_step(free, X, "toe", DT, velocity_limits=1.0)
        assert got.velocity[rail] < 1e-9 and -1e-9 <= got.fraction <= 1.0 + 1e-9
        assert np.abs(compute_residual(s, got.q)).max() < 1e-11


# ---- tasks


def test_a_pose_as_a_task_is_the_step_to_that_pose():
    s = kempe.load("stewart")
    q = s.assemble().q
    X = s.fk(q, "platform")
    X[:3, 3] += [0.001, 0.002, -0.001]
    one = s.ik_step(q, X, "platform", DT)
    two = s.ik_step(q, tasks.Pose("platform", X), dt=DT)
    np.testing.assert_allclose(one.velocity, two.velocity, atol=1e-7)
    assert two.fraction == pytest.approx(1.0) and two.twist.shape == (6,)


def test_levels_are_strict_and_those_of_pseudoinverses():
    """The velocities are those of successive null spaces (Siciliano and Slotine, 1991)."""
    panda = kempe.load("panda")
    hand = "panda_link7"
    q = panda.mid + 0.2
    p = panda.fk(q, hand)[:3, 3] + [2e-5, -1e-5, 1e-5]
    z = panda.fk(q, "panda_link4")[2, 3] + 1e-5
    first = tasks.Position(hand, p)
    second = tasks.OnPlane("panda_link4", [0, 0, z], [0, 0, 1], priority=1)
    rest = q + 3e-5 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0])
    third = tasks.Posture(rest, priority=2)
    got = panda.ik_step(q, [first, second, third], dt=DT, velocity_limits=math.inf)
    v = np.zeros(7)
    N = np.eye(7)
    for J, rate in (
        (panda.jacobian(q, hand)[:3], (p - panda.fk(q, hand)[:3, 3]) / DT),
        (panda.jacobian(q, "panda_link4")[2:3], np.array([1e-5 / DT])),
        (np.eye(7), (rest - q) / DT),
    ):
        v = v + np.linalg.pinv(J @ N, rcond=1e-9) @ (rate - J @ v)
        _, values, Vt = np.linalg.svd(J @ N)
        N = N @ Vt[int((values > 1e-9).sum()) :].T @ Vt[int((values > 1e-9).sum()) :]
    np.testing.assert_allclose(got.velocity, v, atol=1e-6)


def test_inequalities_are_kept_and_met():
    s = kempe.load("five_bar")
    q = s.assemble().q
    p = s.fk(q, "tip")[:2, 3]
    wall = tasks.HalfSpace("tip", p + [0.02, 0.0], [-1.0, 0.0])
    far = tasks.Position("tip", p + [0.1, 0.03], weight=1.0, priority=1)
    for _ in range(100):
        q = s.ik_step(q, [wall, far], dt=0.05, velocity_limits=0.3).q
        assert s.fk(q, "tip")[0, 3] <= p[0] + 0.02 + 1e-6
    np.testing.assert_allclose(s.fk(q, "tip")[:2, 3], p + [0.02, 0.03], atol=1e-6)
    out = tasks.HalfSpace("tip", p + [0.0, 0.01], [0.0, -1.0])  # beyond it now: led back
    for _ in range(100):
        q = s.ik_step(q, out, dt=0.05, velocity_limits=0.3).q
    assert s.fk(q, "tip")[1, 3] <= p[1] + 0.01 + 1e-9


def test_bad_input_is_refused():
    s = kempe.load("five_bar")
    q = s.assemble().q
    p = s.fk(q, "tip")[:2, 3]
    for wanted, options, said in (
        (tasks.Position("tip", p), {}, "positive time"),
        (tasks.Position("tip", [p, p]), {"dt": DT}, "one goal"),
        (tasks.Position("tip", [math.nan, 0.0]), {"dt": DT}, "finite"),
        (tasks.Position("tip", p), {"dt": DT, "keep_direction": True}, "weights of their own"),
        (np.zeros(6), {"dt": DT}, "without a frame"),
    ):
        with pytest.raises(InputError, match=said):
            s.ik_step(q, wanted, **options)
    for wanted, frame in ((np.zeros(6), "tip"), (tasks.Position("tip", p), None)):
        with pytest.raises(InputError, match="finite number"):
            s.ik_step(np.full(s.nq, np.nan), wanted, frame, DT)
    # across the plane
    still = s.ik_step(q, np.array([0, 0, 1.0, 0, 0, 0]), "tip", DT, weights=[0, 0, 1, 0, 0, 0])
    assert not still.velocity.any() and still.fraction == 0.0
    assert isinstance(s.ik_step(q, spatial.pose(p=[*p, 0.0]), "tip", DT).velocity, np.ndarray)
