"""Paths through singularities and at limits, against the joint motions that the targets were made
of.
"""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe import Mechanism, System, tasks
from kempe.inverse.chain.serial_chain import find_chain

ARMS = ("puma560", "ur5", "stanford", "irb6640", "crx10ia", "xarm6", "hc10", "jaco2", "ur10e")


@pytest.fixture(scope="module")
def robots() -> dict[str, System]:
    return {name: kempe.load(name) for name in ARMS}


def tip(system: System) -> str:
    names = system.frame_names
    return max(names, key=lambda f: (len(find_chain(system, f).v_index), names.index(f)))


def line(system: System, rng: np.random.Generator, count: int, middle: float = 0.0) -> np.ndarray:
    """A straight line (count, 6) of joints inside the limits, the fifth through the middle of a
    wrist.
    """
    a = system.random(rng)
    b = system.random(rng)
    a[4] = middle - 0.8
    b[4] = middle + 0.8
    part = min(1.0, 0.4 * (count - 1) / float(np.abs(b - a).max()))  # steps that are no jumps
    middle_q = 0.5 * (a + b)
    return middle_q + part * (np.linspace(a, b, count) - middle_q)


@pytest.mark.slow
def test_a_puma_is_followed_through_its_wrist_singularity():
    s = kempe.load("puma560")
    followed = 0
    for k in range(40):
        rng = np.random.default_rng(k)
        a = s.random(rng)
        b = s.random(rng)
        a[4] = -0.8
        b[4] = 0.8
        Q = np.linspace(a, b, 81)
        p = s.ik_path(s.fk(Q, "tool"), "tool", a)
        followed += bool(p) and bool(np.abs(p.q - Q).max() < 1e-3)
    assert followed == 40


@pytest.mark.parametrize("count", [11, 41, pytest.param(321, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["ur5", "stanford", "irb6640", "crx10ia"])
def test_wrists_go_through_at_any_sampling(robots, name, count):
    s = robots[name]
    rng = np.random.default_rng(7)
    for _ in range(10):
        Q = line(s, rng, count)
        p = s.ik_path(s.fk(Q, tip(s)), tip(s), Q[0])
        assert p, p.status


def test_uneven_samples_and_targets_that_stay_are_followed():
    s = kempe.load("puma560")
    rng = np.random.default_rng(3)
    for _ in range(5):
        Q = line(s, rng, 61)
        keep = np.sort(rng.choice(61, 45, replace=False))
        Q = np.repeat(Q[keep], rng.integers(1, 3, 45), axis=0)
        p = s.ik_path(s.fk(Q, "tool"), "tool", Q[0])
        assert p, p.status


@pytest.mark.parametrize("name", ["puma560", "ur5", "irb6640"])
def test_rounded_targets_are_followed_within_a_tolerance(robots, name):
    """Rounded by 0.05 mm, a target at a singularity asks for a turn of the wrist that the next one
    takes back.
    """
    s = robots[name]
    rng = np.random.default_rng(5)
    for _ in range(8):
        Q = line(s, rng, 41)
        X = s.fk(Q, tip(s))
        X[:, :3, 3] = X[:, :3, 3].round(4)
        p = s.ik_path(X, tip(s), Q[0], tolerance=3e-4)
        assert p, p.status
        assert np.abs(s.fk(p.q, tip(s))[:, :3, 3] - X[:, :3, 3]).max() < 3.1e-4
        assert np.abs(np.diff(p.q, axis=0)).max() < 3.0 * np.abs(np.diff(Q, axis=0)).max() + 0.1


def followed_or_ended(robots, hunt, cases: int) -> None:
    """Half the motions stay inside the limits and are followed; half leave one, and the path ends
    where they do.
    """
    rng = hunt.rng()
    ends = 0
    for _ in range(cases):
        s = robots[str(rng.choice(ARMS))]
        frame = tip(s)
        count = int(rng.choice([15, 30, 60, 120]))
        a = s.random(rng)
        b = s.random(rng)
        Q = np.linspace(a, a + (b - a) * min(1.0, 0.2 * count / np.abs(b - a).max()), count)
        leaves = rng.random() < 0.5
        k = count
        j = int(rng.integers(6))
        if leaves:
            at = rng.uniform(0.2, 0.8)
            speed = 0.15 * count * rng.uniform(0.2, 1.0)
            if not speed * at <= s.upper[j] - s.lower[j] < np.inf:
                continue
            Q[:, j] = s.upper[j] + speed * (np.linspace(0.0, 1.0, count) - at)
            k = int(np.flatnonzero(Q[:, j] > s.upper[j] + 1e-9)[0])
        p = s.ik_path(s.fk(Q, frame), frame, Q[0])
        if not leaves:
            assert p, (s.name, p.status)
            continue
        values = np.linalg.svd(s.jacobian(Q[: k + 1], frame), compute_uv=False)
        if (values[:, -1] > 0.06 * values[:, 0]).all():  # else another motion may part from it
            assert p.success.sum() == k and p.jumps in ((), (k,)), (s.name, k, p.status)
            ends += 1
    assert ends or cases < 20


def test_motions_are_followed_and_end_at_limits(robots, hunt):
    followed_or_ended(robots, hunt, hunt.cases(40))


@pytest.mark.slow
def test_motions_are_followed_and_end_at_limits_often(robots, hunt):
    """A motion of joints inside the limits is followed, and none is followed beyond them."""
    followed_or_ended(robots, hunt, hunt.cases(1000))


# ---- joints that have nothing to do with it


def two_arms() -> System:
    """A torso that turns, and on it two arms of six joints each with limits."""
    m = Mechanism("torso")
    m.revolute("torso", "ground", m.body("chest"), axis=(0, 0, 1), limits=(-0.5, 0.5))
    for side, y in (("l", 0.2), ("r", -0.2)):
        before = "chest"
        for k, (axis, at) in enumerate(
            (
                ((0, 0, 1), (0, y, 0.5)),
                ((0, 1, 0), (0.1, 0, 0)),
                ((0, 1, 0), (0.4, 0, 0)),
                ((1, 0, 0), (0.3, 0, 0)),
                ((0, 1, 0), (0.1, 0, 0)),
                ((1, 0, 0), (0.1, 0, 0)),
            )
        ):
            body = m.body(f"{side}{k}")
            m.revolute(f"{side}_{k}", before, body, axis=axis, at=at, limits=(-2.0, 2.0))
            before = body
        m.frame(f"{side}_hand", before, at=(0.1, 0, 0))
    return m.build()


@pytest.mark.slow
@pytest.mark.parametrize("branches", [False, True])
def test_a_new_start_leaves_the_other_arm_alone(branches):
    s = two_arms()
    jumps = 0
    other = [i for i, n in enumerate(s.coordinate_names) if n.startswith("l_")]
    for seed in range(3 if branches else 10):
        rng = np.random.default_rng(seed)
        q = s.random(rng)
        goal = s.fk(s.random(rng), "r_hand")
        targets = np.tile(s.fk(q, "r_hand"), (12, 1, 1))
        targets[:, :3, 3] += np.linspace(0.0, 1.0, 12)[:, None] * (goal[:3, 3] - targets[0, :3, 3])
        p = s.ik_path(targets, "r_hand", q, restart=True, branches=branches)
        jumps += len(p.jumps)
        np.testing.assert_array_equal(
            p.q[p.success][:, other], np.tile(q[other], (p.success.sum(), 1))
        )
    assert jumps > (0 if branches else 3)


def test_new_starts_for_tasks_leave_the_other_arm_alone():
    s = two_arms()
    more = 0
    other = [i for i, n in enumerate(s.coordinate_names) if n.startswith("l_")]
    for seed in range(60):
        rng = np.random.default_rng(seed)
        q = s.random(rng)
        X = s.fk(s.random(rng), "r_hand")
        answer = s.ik([tasks.Pose("r_hand", X)], start=q)
        more += answer.starts > 1
        np.testing.assert_array_equal(answer.q[other], q[other])
    assert more > 5


def test_loops_beside_the_task_stay_as_they_are():
    """Two four-bars side by side: a task for one of them leaves the other where it is closed."""
    m = Mechanism("pair", dim=2)
    for side, x in (("p", 0.0), ("n", 5.0)):
        for b in "abc":
            m.body(side + b)
        m.revolute(f"{side}A", m.ground, f"{side}a", at=(x, 0), limits=(-3.0, 3.0))
        m.revolute(f"{side}B", f"{side}a", f"{side}b", at=(0.4, 0), limits=(-3.0, 3.0))
        m.revolute(
            f"{side}C", f"{side}b", f"{side}c", at=(1.0, 0), child_at=(0.8, 0), limits=(-3.0, 3.0)
        )
        m.revolute(f"{side}D", m.ground, f"{side}c", at=(x + 0.9, 0), limits=(-3.0, 3.0))
        m.frame(f"{side}tip", f"{side}b", at=(0.5, 0.4))
    s = m.build()
    other = [i for i, n in enumerate(s.coordinate_names) if n.startswith("n")]
    more = 0
    for k in range(30):
        start = s.assemble({"pA": -2.0 + 0.1 * k, "nA": 0.7})
        there = s.assemble({"pA": 1.5 - 0.13 * k, "nA": -0.4})
        if not (start and there):
            continue
        answer = s.ik([tasks.Position("ptip", s.fk(there.q, "ptip")[:2, 3])], start=start.q)
        more += answer.starts > 1
        assert answer, answer.status
        np.testing.assert_allclose(answer.q[other], start.q[other], atol=1e-9)
    assert more
