"""The best of several paths, and paths that return: turns, costs and ends are computed here."""

from __future__ import annotations

import math

import numpy as np
import pytest
from linkages import planar_arm

import kempe
from kempe import spatial, tasks
from kempe.errors import InputError

HAND = "panda_hand_tcp"


def nearness(s: kempe.System, q: np.ndarray) -> float:
    """How near q comes to a limit: 1 at a limit, 0 in the middle."""
    half = 0.5 * (s.upper - s.lower)
    return float(np.abs((q - 0.5 * (s.upper + s.lower)) / half).max())


def worst_ratio(s: kempe.System, q: np.ndarray, frame: str) -> float:
    values = np.linalg.svd(s.jacobian(q, frame), compute_uv=False)
    return float((values[:, 0] / values[:, -1]).max())


def length(q: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())


def wind(seed: int, turns: float, n: int = 120) -> tuple[kempe.System, np.ndarray, np.ndarray]:
    """A UR5, a start, and poses of its tool on an arc about the axis of the first joint."""
    s = kempe.load("ur5")
    q = np.random.default_rng(seed).uniform(-2.5, 2.5, 6)
    Q = np.tile(q, (n, 1))
    Q[:, 0] += np.linspace(0.0, 2.0 * math.pi * turns, n)
    return s, q, s.fk(Q, "tool")


@pytest.mark.parametrize("turns", [-1.7, 1.5, 1.9])
def test_whole_turns_lead_past_limits(turns):
    """From 0.3 rad on an arc of 1.5 turns ends at a limit of two turns; from a turn less it does
    not.
    """
    s, q, X = wind(3, turns)
    q[0] = 0.3 * math.copysign(1.0, turns)
    X = s.fk(
        np.stack([q] * len(X))
        + np.outer(np.linspace(0, 2 * math.pi * turns, len(X)), [1, 0, 0, 0, 0, 0]),
        "tool",
    )
    alone = s.ik_path(X, "tool", q)
    assert not alone and "limit of 'shoulder_pan'" in alone.status
    p = s.ik_path(X, "tool", q, branches="best")
    assert p and not p.jumps
    np.testing.assert_allclose(s.fk(p.q, "tool"), X, atol=1e-9)
    assert (p.q >= s.lower).all() and (p.q <= s.upper).all()
    assert np.abs(np.diff(p.q, axis=0)).max() < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_best_path_by_a_cost_is_no_worse_than_those_by_others(seed):
    s, q, X = wind(seed, 0.4, 40)
    measures = {
        "motion": length,
        "limits": lambda q: nearness(s, q),
        "singularities": lambda q: worst_ratio(s, q, "tool"),
    }
    paths = {c: s.ik_path(X, "tool", q, branches="best", cost=c) for c in measures}
    own = s.ik_path(X, "tool", q, branches="best", cost=lambda q: np.abs(q).max())
    assert all(paths.values()) and own
    for name, measure in list(measures.items())[:2]:
        least = min(measure(p.q) for p in [*paths.values(), own])
        assert measure(paths[name].q) <= least + 1e-9, name
    # of the Jacobian in metres here, in characteristic lengths there
    assert measures["singularities"](paths["singularities"].q) <= 2.0 * min(
        measures["singularities"](p.q) for p in paths.values()
    )
    assert np.abs(own.q).max() <= min(np.abs(p.q).max() for p in paths.values()) + 1e-9


def test_every_solution_of_the_first_target_is_a_start():
    """Of the eight solutions of a UR5 the one with the smallest largest angle of the wrist is named
    by a cost.
    """
    s, q, X = wind(5, 0.1, 10)
    every = s.ik_all(X[0], "tool").q
    p = s.ik_path(X, "tool", q, branches="best", cost=lambda q: -math.cos(q[0, 4] - 1.0))
    turned = np.cos(every[:, 4] - 1.0)
    assert math.isclose(math.cos(p.q[0, 4] - 1.0), turned.max(), abs_tol=1e-9)


# ---- paths that return


def loop_of_poses(
    s: kempe.System, q: np.ndarray, frame: str, rng: np.random.Generator, n: int = 80
):
    """A smooth closed loop of poses that begins and ends with that of q."""
    a = np.linspace(0.0, 2.0 * math.pi, n)
    wave = np.stack([np.cos(a) - 1.0, np.sin(a), np.sin(2.0 * a)], axis=-1)
    X = np.tile(s.fk(q, frame), (n, 1, 1))
    X[:, :3, 3] += 0.12 * wave @ rng.uniform(-0.5, 0.5, (3, 3))
    X[:, :3, :3] = X[:, :3, :3] @ spatial.exp_so3(0.3 * wave @ rng.uniform(-0.5, 0.5, (3, 3)))
    X[-1] = X[0]
    return X


def check_closed(s, p, X, frame):
    assert p, p.status
    np.testing.assert_allclose(s.fk(p.q, frame), X, atol=1e-9)
    np.testing.assert_allclose(p.q[-1], p.q[0], atol=1e-6)
    assert (p.q >= s.lower - 1e-12).all() and (p.q <= s.upper + 1e-12).all()


@pytest.mark.slow
def test_a_redundant_arm_returns(hunt):
    """The shortest steps alone do not; going round once more repeats the first round."""
    s = kempe.load("panda")
    rng = hunt.rng()
    drifted = 0
    for _ in range(hunt.cases(40)):
        q = s.q("ready") + rng.uniform(-0.2, 0.2, 7)
        X = loop_of_poses(s, q, HAND, rng)
        plain = s.ik_path(X, HAND, q)
        if not plain:
            continue
        drifted += np.abs(plain.q[-1] - plain.q[0]).max() > 1e-4
        p = s.ik_path(X, HAND, q, closed=True)
        check_closed(s, p, X, HAND)
        # it moves about as evenly as the one that does not return
        assert (
            np.abs(np.diff(p.q, axis=0)).max() < 3.0 * np.abs(np.diff(plain.q, axis=0)).max() + 0.05
        )
    assert drifted


def test_an_arm_without_limits_returns_after_whole_turns():
    s = planar_arm(1.0, 0.8, 0.6)
    a = np.linspace(0.0, 2.0 * math.pi, 90)
    X = 1.5 * np.stack([np.cos(a), np.sin(a)], axis=-1)
    p = s.ik_path(X, "tip", [0.3, 0.4, 0.5], closed=True)
    assert p
    turned = (p.q[-1] - p.q[0]) / (2.0 * math.pi)
    np.testing.assert_allclose(turned, np.round(turned), atol=1e-9)
    assert np.round(turned)[0] == 1.0
    np.testing.assert_allclose(s.fk(p.q, "tip")[:, :2, 3], X, atol=1e-9)


def test_tasks_return_too():
    s = planar_arm(1.0, 0.8, 0.6, limits=[(-3.0, 3.0)] * 3)
    a = np.linspace(0.0, 2.0 * math.pi, 60)
    X = np.stack([1.2 + 0.3 * np.cos(a), 0.5 * np.sin(a)], axis=-1)
    open_path = s.ik_path([tasks.Position("tip", X)], start=[0.3, 0.8, 0.5])
    assert open_path and np.abs(open_path.q[-1] - open_path.q[0]).max() > 1e-3
    p = s.ik_path([tasks.Position("tip", X)], start=[0.3, 0.8, 0.5], closed=True)
    assert p, p.status
    np.testing.assert_allclose(p.q[-1], p.q[0], atol=1e-9)
    np.testing.assert_allclose(s.fk(p.q, "tip")[:, :2, 3], X, atol=1e-9)


def test_a_path_that_does_not_return_says_so():
    """Once around the base is a turn of the first joint, which its limits tell from none."""
    s = planar_arm(1.0, 1.0, limits=[(-8.0, 8.0), (-3.0, 3.0)])
    a = np.linspace(0.0, 2.0 * math.pi, 80)
    X = 1.2 * np.stack([np.cos(a), np.sin(a)], axis=-1)
    X[-1] = X[0]
    p = s.ik_path(X, "tip", [-0.9, 1.8], closed=True)
    assert not p and not p.success[-1] and p.success[:-1].all()
    assert "'q1' differs by 6.28" in p.status


def test_what_cannot_be_is_refused():
    s = planar_arm(1.0, 1.0)
    X = np.array([[1.0, 0.0], [1.0, 0.2]])
    with pytest.raises(InputError, match="the first one again"):
        s.ik_path(X, "tip", closed=True)
    with pytest.raises(InputError, match="'motion', 'limits', 'singularities'"):
        s.ik_path(X, "tip", branches="best", cost="speed")
    with pytest.raises(InputError, match="best"):
        s.ik_path(X, "tip", branches="all")
