"""Steps of velocities, against scipy's bounded least squares, linear programs, closed forms and
finite differences.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import linprog, lsq_linear

from kempe import Mechanism, System, spatial
from kempe.errors import InputError
from kempe.inverse.ik_step import BoundStep
from kempe.kernels.servo.step_constants import SHIFT
from kempe.numerics.least_squares import minimize_bounded_residual, minimize_quadratic_in_box

HAND = "panda_link7"
DT = 0.01


def box(system: System, q: np.ndarray, speed: float) -> tuple[np.ndarray, np.ndarray]:
    low = np.maximum(-speed, (system.lower - q) / DT)
    high = np.minimum(speed, (system.upper - q) / DT)
    return low, high


def test_bounded_least_squares_is_that_of_scipy():
    rng = np.random.default_rng(0)
    for _ in range(200):
        m, n = rng.integers(1, 9, 2)
        A = np.concatenate([rng.normal(size=(m, n)), 1e-3 * np.eye(n)])
        b = rng.normal(size=m + n)
        low = rng.normal(size=n) - 0.3
        high = low + rng.uniform(0.0, 1.0, n) * (rng.random(n) < 0.9)
        x = minimize_quadratic_in_box(A.T @ A, A.T @ b, low, high)[0]
        wide = high > low
        oracle = low.copy()
        if wide.any():
            rest = b - A[:, ~wide] @ low[~wide]
            oracle[wide] = lsq_linear(
                A[:, wide], rest, (low[wide], high[wide]), tol=1e-15, method="bvls"
            ).x
        assert np.linalg.norm(A @ x - b) <= np.linalg.norm(A @ oracle - b) + 1e-9
        np.testing.assert_allclose(x, oracle, atol=1e-6)
        shift = np.clip(0.0, low, high)
        y = shift + minimize_bounded_residual(
            A, b - A @ shift, low - shift, high - shift, np.eye(n)
        )
        np.testing.assert_allclose(y, oracle, atol=1e-6)


def test_the_twist_is_had_to_first_order(panda):
    rng = np.random.default_rng(1)
    q = panda.random(rng, 45) * 0.8
    regular = q[np.linalg.svd(panda.jacobian(q, HAND), compute_uv=False)[:, -1] >= 0.06]
    assert len(regular) > 20
    for q in regular:
        q = np.clip(q, panda.lower + 0.1, panda.upper - 0.1)
        twist = rng.normal(size=6) * 0.1
        h = 1e-6
        s = panda.ik_step(q, twist, HAND, h)
        X = panda.fk(q, HAND)
        Y = panda.fk(s.q, HAND)
        moved = np.concatenate([Y[:3, 3] - X[:3, 3], spatial.log_so3(Y[:3, :3] @ X[:3, :3].T)]) / h
        np.testing.assert_allclose(moved, twist, atol=1e-5)
        np.testing.assert_allclose(
            s.velocity, np.linalg.pinv(panda.jacobian(q, HAND)) @ twist, atol=1e-9
        )
        np.testing.assert_allclose(s.q, q + h * s.velocity, atol=1e-15)
        assert s.saturated == () and abs(s.fraction - 1.0) < 1e-9


def random_chain(rng: np.random.Generator, n: int) -> System:
    """A chain of n joints in random places, some of them slides."""
    m = Mechanism("chain")
    before = m.ground
    for k in range(n):
        body = m.body(f"b{k}")
        make = m.prismatic if rng.random() < 0.2 else m.revolute
        axis = rng.normal(size=3)
        place = rng.uniform(-0.5, 0.5, 3)
        make(f"j{k}", before, body, axis=axis, at=place, limits=(-2.0, 2.0))
        before = body
    m.frame("tip", before, at=rng.uniform(-0.5, 0.5, 3))
    return m.build()


def test_limits_are_those_of_a_bounded_least_squares_problem(hunt):
    """The nearest velocities within limits, in the metric of the equations and of a little of the
    velocities: 1000 problems of 1 to 8 joints.
    """
    rng = np.random.default_rng(2)
    met = tried = 0
    dt = 1e-4
    for n in range(1, 9):
        for _ in range(5):
            s = random_chain(rng, n)
            shift = SHIFT * BoundStep(s, "tip").near
            for q in s.random(rng, hunt.cases(25)):
                ends = np.where(rng.random(n) < 0.5, s.lower, s.upper)
                q = np.where(rng.random(n) < 0.3, ends, q)
                J = s.jacobian(q, "tip")
                twist = rng.normal(size=6) * 0.5
                if np.linalg.svd(J, compute_uv=False)[-1] < shift / SHIFT + 0.01:
                    continue
                got = s.ik_step(q, twist, "tip", dt, velocity_limits=0.8)
                low = np.maximum(-0.8, (s.lower - q) / dt)
                high = np.minimum(0.8, (s.upper - q) / dt)
                A = np.concatenate([J, shift * np.eye(n)])
                b = np.append(twist, shift * np.linalg.pinv(J) @ twist)
                oracle = lsq_linear(A, b, (low, high), tol=1e-15, method="bvls")
                part = find_shortening(got.velocity, oracle.x)
                np.testing.assert_allclose(got.velocity, part * oracle.x, atol=1e-6)
                np.testing.assert_allclose(got.twist, J @ got.velocity, atol=1e-12)
                assert np.all(got.q >= s.lower) and np.all(got.q <= s.upper)
                at = (got.velocity <= low) | (got.velocity >= high)
                assert got.saturated == tuple(np.array(s.structure.velocity_names)[at])
                met += at.any()
                tried += 1
    assert met > 0.5 * tried > 0.1 * hunt.cases(1000)


def find_shortening(velocity: np.ndarray, oracle: np.ndarray) -> float:
    """The halving of a step after which no joint turns back at once, mostly none."""
    size = np.linalg.norm(oracle)
    part = np.linalg.norm(velocity) / size if size > 0.0 else 1.0
    return min(0.5 ** np.arange(6), key=lambda p: abs(p - part))


@pytest.mark.slow
def test_other_joints_take_over_where_the_arm_is_redundant(panda):
    rng = np.random.default_rng(3)
    met = 0
    for q in 0.5 * (panda.random(rng, 120) + panda.mid):
        J = panda.jacobian(q, HAND)
        twist = rng.normal(size=6) * 0.3
        values = np.linalg.svd(J, compute_uv=False)
        fast = 0.9 * np.abs(np.linalg.pinv(J) @ twist).max()
        low, high = box(panda, q, fast)
        oracle = lsq_linear(J, twist, (low, high), tol=1e-15)
        if values[-1] < 0.06:
            continue
        s = panda.ik_step(q, twist, HAND, DT, velocity_limits=fast)
        missed = np.linalg.norm(s.twist - twist)
        size = np.linalg.norm(twist)
        assert missed < np.linalg.norm(J @ oracle.x - twist) + 0.06 * size
        met += missed < 0.05 * size
    assert met > 5, met  # a shorter twist would miss a tenth


def test_the_direction_is_kept_and_the_part_of_it_the_largest(panda):
    """The largest part is that of a linear program."""
    rng = np.random.default_rng(4)
    met = 0
    for q in panda.random(rng, 40):
        J = panda.jacobian(q, HAND)
        twist = rng.normal(size=6)
        if np.linalg.svd(J, compute_uv=False)[-1] < 0.06:
            continue
        s = panda.ik_step(q, twist, HAND, DT, velocity_limits=0.7, keep_direction=True)
        low, high = box(panda, q, 0.7)
        best = linprog(
            np.append(np.zeros(7), -1.0),
            A_eq=np.column_stack([J, -twist]),
            b_eq=np.zeros(6),
            bounds=[*zip(low, high, strict=True), (0.0, 1.0)],
        )
        np.testing.assert_allclose(s.twist, s.fraction * twist, atol=1e-5)
        # self-motions cost a little
        assert 0.95 * best.x[-1] - 1e-6 <= s.fraction <= best.x[-1] + 1e-6
        met += 0.01 < s.fraction < 0.99
    assert met > 10


def arm() -> System:
    m = Mechanism("arm", dim=2)
    m.revolute("a", "ground", m.body("u"), at=(0, 0), limits=(-2.0, 2.0), velocity=3.0)
    m.revolute("b", "u", m.body("v"), at=(1, 0), limits=(-2.0, 2.0))
    m.frame("tip", "v", at=(1, 0))
    return m.build()


POSITION = [1.0, 1.0, 0.0, 0.0, 0.0, 0.0]


def test_damping_near_a_singularity():
    """The velocities are those of the damped singular values (Maciejewski and Klein, 1988)."""
    s = arm()
    for b in (1e-8, 1e-3, 0.02, 0.5):
        J = s.jacobian([0.3, b], "tip")[:2]
        U, values, Vt = np.linalg.svd(J)
        hard = np.where(
            values < 0.05, 0.05 * np.sqrt(np.maximum(1.0 - (values / 0.05) ** 2, 0.0)), 0.0
        )
        wish = np.array([0.01, -0.02])
        v = Vt.T @ (values / (values**2 + hard**2) * (U.T @ wish))
        got = s.ik_step([0.3, b], [*wish, 0, 0, 0, 0], "tip", DT, weights=POSITION)
        np.testing.assert_allclose(got.velocity, v, atol=1e-9)
    outwards = s.ik_step(
        [0.3, 0.0], [math.cos(0.3), math.sin(0.3), 0, 0, 0, 0], "tip", DT, weights=POSITION
    )
    assert np.abs(outwards.velocity).max() < 1e-9 and abs(outwards.fraction) < 1e-9
    free = s.ik_step(
        [0.3, 1e-3],
        [*wish, 0, 0, 0, 0],
        "tip",
        DT,
        weights=POSITION,
        damping=0.0,
        velocity_limits=1e9,
    )
    np.testing.assert_allclose(free.twist[:2], wish, atol=1e-9)


def test_limits_of_the_description_hold_and_what_is_outside_goes_no_further():
    s = arm()
    fast = s.ik_step([0.0, 1.0], [0.0, 9.0, 0, 0, 0, 0], "tip", DT, weights=POSITION)
    assert fast.velocity[0] == 3.0 and fast.saturated == ("a",)
    rests = s.ik_step([2.5, 1.0], np.zeros(6), "tip", DT)
    assert (
        not rests.velocity.any() and "outside its limits, moved no further out: 'a'" in rests.status
    )
    J = s.jacobian([2.5, 1.0], "tip")
    for sign in (-1.0, 1.0):
        for keep in (False, True):
            wanted = sign * 0.1 * J[:, 0]
            step = s.ik_step([2.5, 1.0], wanted, "tip", DT, keep_direction=keep, damping=0.0)
            assert 0.0 <= step.fraction <= 1.0 + 1e-12
            assert step.velocity[0] <= 0.0 and np.abs(step.velocity).max() < 0.2
            assert (step.velocity[0] < -0.09) == (sign < 0.0)
    stays = s.ik_step([2.0, 1.0], [-5.0, -5.0, 0, 0, 0, 0], "tip", DT, weights=POSITION)
    assert stays.q[0] <= 2.0 and stays.q[1] <= 2.0


def test_steps_towards_a_pose_arrive(panda):
    q = panda.mid
    target = panda.fk(q + 0.2, HAND)
    for _ in range(200):
        q = panda.ik_step(q, target, HAND, DT, velocity_limits=1.0).q
    np.testing.assert_allclose(panda.fk(q, HAND), target, atol=1e-9)


@pytest.mark.parametrize(
    ("wanted", "dt", "options"),
    [
        (np.zeros(5), DT, {}),
        (np.full(6, np.nan), DT, {}),
        (np.zeros(6), 0.0, {}),
        (np.zeros(6), DT, {"damping": -1.0}),
        (np.zeros(6), DT, {"velocity_limits": [1.0, 2.0]}),
        (np.zeros(6), DT, {"weights": -1.0}),
    ],
)
def test_bad_input_is_refused(wanted, dt, options, panda):
    q = panda.mid
    with pytest.raises(InputError):
        panda.ik_step(q, wanted, HAND, dt, **options)
