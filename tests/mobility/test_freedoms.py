"""Freedoms that tasks leave, at regular and at singular configurations, and the curves that are
walked along.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hunts import some
from linkages import planar_arm
from scipy.integrate import solve_ivp

import kempe
from kempe import Mechanism, tasks
from kempe.errors import InputError
from kempe.mobility.local_dimension import find_local_dimension

RANK_LOST = "to first order only (the Jacobian loses rank here)"


def spatial_arm(rng: np.random.Generator, n: int) -> kempe.System:
    """n revolute joints at random places."""
    m = Mechanism("spatial arm")
    last = m.ground
    for i in range(n):
        body = m.body(f"b{i}")
        m.revolute(
            f"q{i + 1}", last, body, at=rng.uniform(-0.6, 0.6, 3), rpy=rng.uniform(-3.0, 3.0, 3)
        )
        last = body
    m.frame("tip", last, at=rng.uniform(-0.4, 0.4, 3))
    return m.build()


def tips(lengths, q):
    """Tip of a planar arm by its own formula."""
    angles = np.cumsum(q, axis=-1)
    return np.stack(
        [(lengths * np.cos(angles)).sum(-1), (lengths * np.sin(angles)).sum(-1)], axis=-1
    )


# ---- how many


@pytest.mark.parametrize(
    "seed", [(0.1, 0.1), (0.0, 0.0), (1.0, 1.0), (-2.0, 0.5), (0.3, -1.0), (3.0, 3.0)]
)
def test_at_the_edge_of_the_workspace_a_freedom_is_there_to_first_order_only(seed):
    """The rank does not depend on the seed, and nothing that is 3e-6 rad long is a motion."""
    s = kempe.load("two_link")
    reach = s.fk(np.zeros(2), "e")[0, 3]
    task = tasks.Position("e", reach * np.array([math.cos(0.4), math.sin(0.4)]))
    answer = s.ik(task, start=np.array(seed))
    assert (answer.success, answer.m, answer.n, answer.rank, answer.redundancy) == (
        True,
        2,
        2,
        1,
        1,
    )
    assert f"1 freedom {RANK_LOST}" in answer.status
    m = s.inverse.self_motion(answer.q, task)
    assert len(m) == 1 and m.freedoms == 0 and not m.closed and RANK_LOST in str(m)
    assert RANK_LOST in str(s.inverse.self_motion(np.array([0.4, 0.0]), "e", task="position"))


@pytest.mark.parametrize("bend", [1e-2, 1e-3, 1e-4, 1e-5])
def test_beside_the_edge_no_freedom_is_left(bend):
    s = kempe.load("two_link")
    q = np.array([0.4, bend])
    answer = s.ik(tasks.Position("e", s.fk(q, "e")[:2, 3]), start=q, tolerance=1e-12)
    assert answer.success and answer.redundancy == 0 and "no freedom is left" in answer.status


def test_a_short_link_is_no_singular_one():
    """A link a millionth as long as the others moves the tip by as little, and yet it moves it."""
    s = planar_arm(1.0, 1.0, 1e-6)
    q = np.array([0.3, 0.8, 1.1])
    answer = s.ik(tasks.Pose("tip", s.fk(q, "tip")), start=q)
    assert answer.success and answer.redundancy == 0
    plain = planar_arm(1.0, 1e-6)
    q = np.array([0.3, 0.8])
    assert (
        plain.ik(
            tasks.Position("tip", plain.fk(q, "tip")[:2, 3]), start=q, tolerance=1e-12
        ).redundancy
        == 0
    )


def collinear(lengths, signs):
    """A planar arm along x, links folded by signs, and what second order says: freedoms to first
    order, and in truth.

    The tip's way along x is -z.H.z / 2 on the null space z of its way along y; where H is definite
    there the configuration is isolated, where it is not a cone of one freedom less passes through
    it.
    """
    signs = np.concatenate([[1.0], signs])
    folds = np.diff(np.concatenate([[1.0], signs]))
    q = np.where(folds == 0.0, 0.0, math.pi)
    along = np.cumsum((signs * lengths)[::-1])[::-1]  # from each joint to the tip
    n = len(lengths)
    H = np.minimum.outer(np.arange(n), np.arange(n)) * 0.0
    for i, j in itertools.product(range(n), repeat=2):
        H[i, j] = along[max(i, j)]
    Z = np.linalg.svd(along[None])[2][1:].T
    return q, np.linalg.eigvalsh(Z.T @ H @ Z)


def lines(hunt, count: int) -> tuple[int, int]:
    """Straight and folded arms, against the definiteness of the second derivative; the tip at the
    edge or within.
    """
    rng = hunt.rng()
    isolated = 0
    crossed = 0
    for _ in range(hunt.cases(count)):
        n = int(rng.integers(2, 6))
        lengths = rng.uniform(0.2, 1.0, n)
        q, curvatures = collinear(lengths, rng.choice([1.0, -1.0], n - 1))
        if np.abs(curvatures).min() < 0.02 or abs(np.sum(lengths * np.cos(np.cumsum(q)))) < 0.05:
            continue
        definite = (curvatures > 0.0).all() or (curvatures < 0.0).all()
        q[0] = rng.uniform(-3.0, 3.0)
        s = planar_arm(*lengths)
        task = tasks.Position("tip", tips(lengths, q))
        answer = s.ik(task, start=q + rng.normal(size=n) * rng.choice([0.0, 1e-9, 1e-7]))
        assert answer.success and (answer.n, answer.rank) == (n, 1), (lengths, q)
        if definite:
            isolated += 1
            assert RANK_LOST in answer.status, (lengths, q)
            assert len(s.inverse.self_motion(q, task)) == 1
        else:
            crossed += 1
            left = n - 2
            said = (
                f"{left} freedom{'' if left == 1 else 's'} left, {n - 1} to first order (the "
                "Jacobian loses rank here)"
            )
            assert said in answer.status, (lengths, q)
            along = np.cumsum((lengths * np.cos(np.cumsum(q) - q[0]))[::-1])[::-1]
            wish = np.cross(along, rng.normal(size=3)) if n == 3 else rng.normal(size=n)
            if abs(along @ wish) > 0.95 * np.linalg.norm(along) * np.linalg.norm(wish):
                continue  # the tasks leave too little of this direction
            m = s.inverse.self_motion(q, task, direction=wish, budget=kempe.Budget(points=5))
            assert m.freedoms == left and np.abs(tips(lengths, m.q) - task.target).max() < 1e-8
            assert np.linalg.norm(m.q - q, axis=1).max() > 0.05
    return isolated, crossed


@pytest.mark.slow
def test_freedoms_of_arms_in_a_line(hunt):
    isolated, crossed = lines(hunt, 20)
    assert (isolated and crossed) or hunt.cases(20) < 20


@pytest.mark.slow
def test_freedoms_of_many_arms_in_a_line(hunt):
    assert min(lines(hunt, 600)) > hunt.cases(600) // 30


def arm(axes, lengths, pin=None) -> kempe.System:
    """Revolute joints about unit axes, each link along x; the last link is pinned to a point of the
    ground, or free.
    """
    m = Mechanism("arm")
    last = m.ground
    at = (0.0, 0.0, 0.0)
    for i, (axis, length) in enumerate(zip(axes, lengths, strict=True)):
        body = m.body(f"b{i}")
        turn = {"x": (0.0, math.pi / 2, 0.0), "y": (-math.pi / 2, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}[
            axis
        ]
        back = {"x": (0.0, -math.pi / 2, 0.0), "y": (math.pi / 2, 0.0, 0.0), "z": (0.0, 0.0, 0.0)}[
            axis
        ]
        turned = m.body(f"t{i}")
        m.revolute(f"q{i + 1}", last, turned, at=at, rpy=turn)
        m.fixed(f"w{i + 1}", turned, body, rpy=back)
        last = body
        at = (length, 0.0, 0.0)
    if pin is None:
        m.frame("tip", last, at=at)
    else:
        tip = m.body("tip")
        m.fixed("w", last, tip, at=at)
        m.spherical("pin", m.ground, tip, at=pin)
    return m.build()


@pytest.mark.parametrize(
    ("axes", "q", "finite"),
    some(
        [
            ("zy", (0.3, 0.0), 0),
            ("zyy", (0.3, 0.4, 0.0), 0),
            ("zyy", (0.3, 0.4, 1.0), 0),
            ("zyx", (0.3, 0.4, 0.5), 1),
            ("zyzy", (0.3, 0.4, 0.0, 0.0), 0),
            ("zyxy", (0.3, 0.4, 0.5, 0.0), 1),
            ("zyzyx", (0.3, 0.4, 0.5, 0.9, 0.1), 2),
            ("zyxyx", (0.3, 0.4, 0.5, 0.0, 0.2), 2),
            ("zzz", (0.3, math.pi, 0.0), 1),
            ("zyzy", (0.3, 0.0, math.pi, 0.0), 1),
        ],
        3,
    ),
)
def test_freedoms_are_those_of_the_mechanism_with_the_tip_pinned(axes, q, finite):
    """The tasks of an arm and the loop of the mechanism: rank and local dimension, found by Taylor
    series there.
    """
    lengths = (0.5, 0.4, 0.7, 0.3, 0.35)[: len(axes)]
    s = arm(axes, lengths)
    q = np.array(q)
    p = s.fk(q, "tip")[:3, 3]
    answer = s.ik(tasks.Position("tip", p), start=q)
    closed = arm(axes, lengths, p)
    there = closed.assemble({f"q{i + 1}": x for i, x in enumerate(q)}).q
    local = find_local_dimension(closed, there)
    assert (answer.redundancy, finite) == (local.rank_dim, local.dim)
    said = answer.status.partition("; ")[2]
    assert ("Jacobian loses rank" in said) == (local.dim != local.rank_dim)
    assert said.startswith(
        f"{finite} freedom" if finite else ("no freedom", f"{answer.redundancy} freedom")
    )


# ---- walked along


def loop_length(jacobian, q, longest: float) -> tuple[float, object]:
    """Length of the closed curve through q tangent to the null space of a Jacobian (n - 1, n), and
    it as a function.

    The tangent is the vector of minors, which turns round nowhere; it is integrated without any
    leading back.
    """

    def tangent(_, x):
        J = jacobian(x)
        t = np.array(
            [(-1) ** i * np.linalg.det(np.delete(J, i, axis=1)) for i in range(J.shape[1])]
        )
        return t / np.linalg.norm(t)

    t0 = tangent(0.0, q)

    def home(_, x):
        d = x - q
        return np.linalg.norm(d - 2 * np.pi * np.round(d / (2 * np.pi))) - 2e-4

    def turn(_, x):
        d = x - q
        return t0 @ (d - 2 * np.pi * np.round(d / (2 * np.pi)))

    turn.direction = 1.0
    out = solve_ivp(
        tangent,
        (0.0, longest),
        q,
        "DOP853",
        rtol=1e-9,
        atol=1e-11,
        max_step=0.05,
        events=turn,
        dense_output=True,
    )
    for s, x in zip(out.t_events[0], out.y_events[0], strict=True):
        if s > 1e-3 and home(s, x) < 0.0:
            return float(s), out.sol
    return math.inf, out.sol


def check_walk(s: kempe.System, q, task, jacobian, steps: int, hidden) -> bool | None:
    """Whether a walk is closed where the integrated curve is, has points on it, evenly, and ends in
    words otherwise.
    """
    m = s.inverse.self_motion(q, task, budget=kempe.Budget(points=steps))
    assert m.freedoms == 1 and hidden(m.q) < 1e-8
    longest = 0.05 * (2.2 * steps + 4)
    length, curve = loop_length(jacobian, np.asarray(q, dtype=float), longest)
    gaps = np.linalg.norm(np.diff(m.q, axis=0), axis=1)
    assert gaps.max() < 0.08 and gaps.min() > 1e-7
    walked = gaps.sum()
    if m.closed:
        gap = s.configuration_space.difference(m.q[-1], m.q[0])
        gap -= 2 * np.pi * np.round(gap / (2 * np.pi))
        assert np.linalg.norm(gap) < 0.06 and length < math.inf
        assert walked + np.linalg.norm(gap) == pytest.approx(length, rel=0.02, abs=0.02)
    else:
        assert length == math.inf or walked < length + 0.02, "it is closed, and was called open"
        assert all(end.startswith(("the last of", "a point where")) for end in m.ends)
    return m.closed


@pytest.mark.parametrize("steps", [110, 150, 172, 176, 200, 360])
def test_a_closed_curve_is_recognised_from_both_sides(steps):
    """349 configurations: with 174 steps each way the two ends meet, with fewer they do not."""
    lengths = np.array([1.0, 0.8, 0.6])
    q = np.array([0.4, 1.9, 1.2])
    s = planar_arm(*lengths)
    m = s.inverse.self_motion(q, "tip", task="position", budget=kempe.Budget(points=steps))
    assert m.closed == (steps > 174)
    assert len(m) <= 349 and (not m.closed or len(m) >= 348)
    assert np.abs(tips(lengths, m.q) - tips(lengths, q)).max() < 1e-9


def minors(s: kempe.System, rows: int):
    return lambda x: s.jacobian(x, "tip")[:rows]


def walks(hunt, count: int) -> tuple[int, int]:
    rng = hunt.rng()
    closed = 0
    run = 0
    for _ in range(hunt.cases(count)):
        if rng.random() < 0.6:
            lengths = rng.uniform(0.3, 1.0, 3)
            s = planar_arm(*lengths)
            rows = 2
        else:
            s = spatial_arm(rng, 4)
            rows = 3
        q = rng.uniform(-3.0, 3.0, s.nq)
        p = s.fk(q, "tip")[:3, 3]
        if np.linalg.svd(s.jacobian(q, "tip")[:rows], compute_uv=False)[-1] < 0.05:
            continue
        steps = int(rng.choice([60, 100, 200]))
        found = check_walk(
            s,
            q,
            tasks.Position("tip", p[: 2 if rows == 2 else 3]),
            minors(s, rows),
            steps,
            lambda x, s=s, p=p: np.abs(s.fk(x, "tip")[:, :3, 3] - p).max(),
        )
        closed = closed + bool(found)
        run = run + 1
    return closed, run


def test_walks_of_redundant_arms(hunt):
    """Planar arms of three links, spatial ones of four joints, the point held: against the
    integrated null space.
    """
    closed, run = walks(hunt, 8)
    assert closed or run < 8


@pytest.mark.slow
def test_many_walks_of_redundant_arms(hunt):
    closed, run = walks(hunt, 90)
    assert closed > 0.2 * run


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_direction_says_which_way_is_forth(sense):
    s = kempe.load("panda")
    m = s.inverse.self_motion(
        s.mid, "tool", direction=sense * np.eye(7)[0], budget=kempe.Budget(points=3)
    )
    assert sense * (m.q[m.start + 1, 0] - m.q[m.start, 0]) > 0.0


def test_where_self_motions_branch_the_direction_chooses():
    """Three equal links, folded: the tip stays with the elbow folded, or as the links open to a
    parallelogram.
    """
    s = planar_arm(1.0, 1.0, 1.0)
    q = np.array([0.0, math.pi, 0.0])
    with pytest.raises(InputError, match="branch here: `direction` chooses one"):
        s.inverse.self_motion(q, "tip", task="position")
    for direction, way in (("q1", (1.0, 0.0, -1.0)), ("q2", (-1.0, 1.0, -1.0))):
        m = s.inverse.self_motion(
            q, "tip", task="position", direction=direction, budget=kempe.Budget(points=5)
        )
        np.testing.assert_allclose(
            (m.q[-1] - q) / np.linalg.norm(m.q[-1] - q), way / np.linalg.norm(way), atol=1e-6
        )


@pytest.mark.parametrize("task", ["position", "orientation", "direction", "position_axis"])
def test_a_frame_is_held_at_what_the_task_names(task):
    s = kempe.load("panda")
    q = s.mid
    X = s.fk(q, "tool")
    m = s.inverse.self_motion(
        q, "tool", task=task, direction=np.ones(7), budget=kempe.Budget(points=10)
    )
    Y = s.fk(m.q, "tool")
    place = np.abs(Y[:, :3, 3] - X[:3, 3]).max()
    turned = np.abs(Y[:, :3, :3] - X[:3, :3]).max()
    pointed = np.abs(Y[:, :3, 2] - X[:3, 2]).max()
    assert (place < 1e-8) == ("position" in task) and (turned < 1e-8) == (task == "orientation")
    assert (pointed < 1e-8) == (task != "position")
    with pytest.raises(InputError, match="task"):
        s.inverse.self_motion(q, tasks.Pose("tool", X), task=task)


# ---- joints that do not move the frame


def with_others(n: int, joints: int, loop: bool) -> kempe.System:
    """A planar arm of n turns with fingers at its end and an arm beside it, or a four-bar whose
    coupler carries it.
    """
    m = kempe.Mechanism("arm and others", dim=2)
    body = m.ground
    if loop:
        crank = m.body("crank")
        coupler = m.body("coupler")
        rocker = m.body("rocker")
        m.revolute("A", m.ground, crank)
        m.revolute("B", crank, coupler, at=(0.5, 0))
        m.revolute("C", coupler, rocker, at=(0.9, 0), child_at=(0.7, 0))
        m.revolute("D", m.ground, rocker, at=(1, 0))
        body = coupler
    for k in range(n):
        child = m.body(f"link{k}")
        m.revolute(f"q{k}", body, child, at=(0.4 if k else 0.2, 0))
        body = child
    m.frame("tip", body, at=(0.3, 0))
    other = m.ground
    for k in range(joints):
        child = m.body(f"other{k}")
        m.revolute(f"o{k}", (body, other)[k % 2], child, at=(0.1, 0.1 * k))
        other = child
    return m.build()


@pytest.mark.parametrize("others", [1, 4])
@pytest.mark.parametrize("loop", [False, True])
def test_freedoms_of_joints_that_do_not_move_the_frame_are_no_redundancy(loop, others):
    """An arm counts as it does without fingers and without the arm beside it: m, n, rank, and its
    curve.
    """
    alone = with_others(3, 0, loop)
    system = with_others(3, others, loop)
    q0 = alone.assemble({"A": 0.9}).q if loop else np.zeros(3)
    q0[alone.structure.velocity_names.index("q0") :] = 0.3, 0.5, -0.4
    q = system.q(alone.q_dict(q0))
    for task in ("position", "pose"):
        target = alone.fk(q0, "tip")
        target = target[:2, 3] if task == "position" else target
        answers = [s.ik(target, "tip", start=x, task=task) for s, x in ((alone, q0), (system, q))]
        assert all(answers)
        assert [(a.m, a.n, a.rank, a.redundancy) for a in answers][1:] == [
            (answers[0].m, 3 + loop, answers[0].m, 3 + loop - answers[0].m)
        ]
        basis = answers[1].self_motion
        names = system.structure.velocity_names
        assert basis.shape == (system.nv, 3 + loop - answers[1].m)
        assert not basis[[names.index(f"o{k}") for k in range(others)]].any()
        by_tasks = system.ik([tasks.Pose("tip", alone.fk(q0, "tip"))], start=q)
        assert (by_tasks.n, by_tasks.redundancy) == (3 + loop, loop)
    if not loop:
        budget = kempe.Budget(points=30)
        one, same = (
            s.inverse.self_motion(x, "tip", task="position", budget=budget)
            for s, x in ((alone, q0), (system, q))
        )
        assert one.freedoms == same.freedoms == 1
        own = [system.coordinate_names.index(name) for name in alone.coordinate_names]
        np.testing.assert_allclose(same.q[:, own], one.q, atol=1e-9)
        assert np.ptp(np.delete(same.q, own, axis=1), axis=0).max() == 0.0
        with pytest.raises(InputError, match="'o0', which does not move"):
            system.inverse.self_motion(q, "tip", task="position", direction="o0")


def test_a_self_motion_of_the_whole_velocity_moves_what_moves_the_frame():
    """A direction is a velocity of all coordinates: fingers stay."""
    system = with_others(4, 2, False)
    q = system.q({"q0": 0.3, "q1": 0.5, "q2": -0.4, "q3": 0.2})
    with pytest.raises(InputError, match="2 freedoms"):
        system.inverse.self_motion(q, "tip", task="position")
    motion = system.inverse.self_motion(
        q, "tip", task="position", direction=np.ones(6), budget=kempe.Budget(points=9)
    )
    names = system.coordinate_names
    assert motion.freedoms == 2 and len(motion.q) > 9
    assert np.ptp(motion.q[:, [names.index("o0"), names.index("o1")]], axis=0).max() == 0.0
    np.testing.assert_allclose(
        system.fk(motion.q, "tip")[:, :2, 3] - system.fk(q, "tip")[:2, 3], 0.0, atol=1e-9
    )


def test_a_configuration_outside_the_limits_has_no_self_motion():
    system = with_others(3, 0, False).with_limits({"q1": (-0.2, 0.2)})
    with pytest.raises(InputError, match="outside the limits of 'q1'"):
        system.inverse.self_motion(system.q({"q1": 0.5}), "tip", task="position")
