"""Declared one-sided constraints in the solvers: contacts, ropes, boxes and half-spaces, judged by
poses in numpy.
"""

from __future__ import annotations

import numpy as np
import pytest

import kempe
from kempe import Mechanism
from kempe.constraints import Contact, Distance, HalfSpace, InBox

EYE = np.eye(4)


def arm():
    """Two links in the plane whose tip is above the ground, on a rope of 1.5 from (0, 1.5), and
    left of x = 1.9.
    """
    m = Mechanism("arm", dim=2)
    upper = m.body("upper")
    lower = m.body("lower")
    m.revolute("A", m.ground, upper, limits=(-2.0, 2.0))
    m.revolute("B", upper, lower, at=(1, 0))
    m.frame("tip", lower, at=(1, 0))
    m.frame("hook", m.ground, at=(0, 1.5))
    m.contact("floor", "tip")
    m.constrain(Distance("tip", "hook", at_most=1.5), name="rope")
    m.constrain(HalfSpace("tip", origin=(1.9, 0), normal=(-1, 0)), name="wall")
    return m.build()


def arm_beyond(q):
    """How far the arm at q (..., 2) violates what its mechanism holds, worked out by hand."""
    a = q[..., 0]
    b = q[..., 0] + q[..., 1]
    x = np.cos(a) + np.cos(b)
    y = np.sin(a) + np.sin(b)
    return np.maximum.reduce([-y, np.hypot(x, y - 1.5) - 1.5, x - 1.9, np.abs(a) - 2.0, 0.0 * x])


def ball(radius=0.1):
    m = Mechanism("ball")
    m.free("F", m.ground, m.body("ball"))
    m.contact("floor", "ball", radius=radius)
    return m.build()


# ---- assemble


def test_a_ball_below_the_ground_is_put_on_it(hunt):
    system = ball()
    rng = hunt.rng()
    start = np.array([system.random(rng) for _ in range(hunt.cases(200))])
    start[:, :3] = rng.uniform(-1.0, 1.0, (len(start), 3))
    answer = system.assemble(start=start)
    assert answer.success.all()
    expected = start.copy()
    expected[:, 2] = np.maximum(start[:, 2], 0.1)
    assert np.abs(answer.q[:, :3] - expected[:, :3]).max() < 1e-9
    same = np.abs(np.sum(answer.q[:, 3:] * start[:, 3:], axis=1))
    assert np.abs(same - 1.0).max() < 1e-12


def test_what_is_assembled_is_inside_and_nearest(hunt):
    """Oracle: all configurations of a fine grid."""
    system = arm()
    rng = hunt.rng()
    grid = np.stack(
        np.meshgrid(np.linspace(-2, 2, 401), np.linspace(-np.pi, np.pi, 629), indexing="ij"), -1
    )
    grid = grid.reshape(-1, 2)[arm_beyond(grid.reshape(-1, 2)) <= 0.0]
    far = 0
    for start in rng.uniform([-2.0, -3.0], [2.0, 3.0], (hunt.cases(60), 2)):
        answer = system.assemble(start=start)
        assert answer.success
        assert arm_beyond(answer.q) < 1e-9
        best = np.linalg.norm(grid - start, axis=1).min()
        far += (
            np.linalg.norm(answer.q - start) > best + 1e-9
            and np.linalg.norm(answer.q - start) > 1.05 * best + 0.02
        )
        if arm_beyond(start) == 0.0:
            assert np.abs(answer.q - start).max() < 1e-12
    assert far <= 0.1 * hunt.cases(60)  # a nearer one may be behind a farther one


def test_known_values_that_contradict_are_named():
    answer = arm().assemble({"A": -1.9, "B": 0.2})
    assert not answer.success
    tip = np.sin(-1.9) + np.sin(-1.7)
    assert f"what is known contradicts 'floor' by {-tip:.6g} m" in answer.status
    assert "'rope'" in answer.status
    assert "'wall'" not in answer.status
    assert np.array_equal(answer.q, [-1.9, 0.2])


def test_known_values_are_kept(hunt):
    system = arm()
    rng = hunt.rng()
    known = rng.uniform(-2.0, 2.0, hunt.cases(200))
    answer = system.assemble({"A": known})
    assert np.array_equal(answer.q[:, 0], known)
    assert (arm_beyond(answer.q[answer.success]) < 1e-9).all()
    b = np.linspace(-np.pi, np.pi, 2001)
    for a, success in zip(known, answer.success, strict=True):
        possible = (arm_beyond(np.stack([np.full_like(b, a), b], -1)) <= 0.0).any()
        assert success == possible


def test_a_batch_that_follows_itself():
    system = arm()
    answer = system.assemble(
        {"A": np.linspace(0.2, 1.8, 30)}, start=[0.2, 1.0], prefer="continuous"
    )
    assert answer.success.all()
    assert np.abs(np.diff(answer.q[:, 1])).max() < 0.2
    assert (arm_beyond(answer.q) < 1e-9).all()


def above_line(height=0.25):
    """The four-bar of the library, a point of whose coupler stays above y = `height`."""
    m = kempe.load("four_bar").mechanism
    m.constrain(HalfSpace("coupler_point", origin=(0, height), normal=(0, 1)), name="line")
    return m.build()


def test_a_loop_closes_where_the_bound_lets_it(hunt):
    """Oracle: all modes of the same four-bar without the bound."""
    free = kempe.load("four_bar")
    bound = above_line()
    place = free.frame_names.index("coupler_point")
    assert place >= 0
    for a in hunt.rng().uniform(-np.pi, np.pi, hunt.cases(30)):
        modes = free.assembly_modes({"A": a})
        heights = free.fk(modes.q, "coupler_point")[:, 1, 3]
        answer = bound.assemble({"A": a})
        assert bool(answer.success) == bool((heights >= 0.25).any())
        some = bound.assembly_modes({"A": a})
        assert some.left_out == int((heights < 0.25).sum())
        assert len(some) == int((heights >= 0.25).sum())
        assert ("'line'" in some.status) == (some.left_out > 0)


# ---- ik


def test_ik_holds_them(hunt):
    """Targets that some configuration of a grid reaches and holds; answers are judged by hand."""
    system = arm()
    rng = hunt.rng()
    for p in rng.uniform([-2.0, -0.5], [2.0, 2.0], (hunt.cases(300), 2)):
        answer = system.ik(p, "tip")
        r = np.hypot(*p)
        good = p[1] >= 0.0 and np.hypot(p[0], p[1] - 1.5) <= 1.5 and p[0] <= 1.9 and r <= 2.0
        if good:  # the angle of the first link, elbow up or down
            a = np.arctan2(p[1], p[0]) + np.array([1.0, -1.0]) * np.arccos(r / 2.0)
            good = bool((np.abs((a + np.pi) % (2 * np.pi) - np.pi) <= 2.0).any())
        assert bool(answer.success) == good
        if answer.success:
            assert arm_beyond(answer.q) < 2e-9
            assert np.hypot(*(system.fk(answer.q, "tip")[:2, 3] - p)) < 1e-6


def puma(height):
    """The Puma 560 of the library, whose tool and elbow stay above z = `height`."""
    m = kempe.load("puma560").mechanism
    m.frame("table", m.ground, at=(0, 0, height))
    m.contact("tool above", "tool", on="table")
    m.contact("elbow above", kempe.load("puma560").body_names[3], on="table", radius=0.05)
    return m.build()


def test_ik_all_leaves_out_what_violates(hunt):
    free = kempe.load("puma560")
    rng = hunt.rng()
    bound = puma(0.2)
    left_out = 0
    for _ in range(hunt.cases(200)):
        X = free.fk(free.random(rng), "tool")
        every = free.ik_all(X, "tool")
        poses = free.fk(every.q)
        holds = (poses[:, 3, 2, 3] >= 0.25) & (X[2, 3] >= 0.2)
        some = bound.ik_all(X, "tool")
        left_out += int(np.sum(~holds))
        assert len(some) == holds.sum()
        if holds.any():
            assert np.abs(some.q[:, None] - every.q[holds]).max(axis=-1).min(axis=1).max() < 1e-9
        assert ("left out" in some.status) == (not holds.all())
    assert left_out > hunt.cases(200)


def test_ik_all_of_a_batch_leaves_out_what_violates():
    free = kempe.load("puma560")
    bound = puma(0.2)
    X = free.fk(free.random(3, 20), "tool")
    some = bound.ik_all(X, "tool")
    every = free.ik_all(X, "tool")
    poses = free.fk(np.where(every.mask[..., None], every.q, 0.0))
    holds = every.mask & (poses[:, :, 3, 2, 3] >= 0.25) & (X[:, None, 2, 3] >= 0.2)
    assert np.array_equal(some.mask, holds)


def test_ik_of_a_robot_above_a_table(hunt):
    free = kempe.load("puma560")
    bound = puma(0.2)
    rng = hunt.rng()
    for _ in range(hunt.cases(40)):
        X = free.fk(free.random(rng), "tool")
        every = free.ik_all(X, "tool")
        holds = every.inside & (free.fk(every.q)[:, 3, 2, 3] >= 0.25) & (X[2, 3] >= 0.2)
        answer = bound.ik(X, "tool")
        assert bool(answer.success) == bool(holds.any())
        if answer.success:
            assert free.fk(answer.q)[3, 2, 3] >= 0.25 - 1e-8


def test_a_blocked_target_says_by_what():
    bound = puma(0.2)
    free = kempe.load("puma560")
    X = free.fk([0.3, -0.2, 0.1, 0.4, 0.5, 0.6], "tool")
    q = free.ik(X, "tool").q
    below = 0.2 - X[2, 3]
    answer = bound.ik(X, "tool")
    if below > 0.0:
        assert not answer.success
        assert f"'tool above' by {below:.6g} m" in answer.status
    else:
        assert answer.success == (free.fk(q)[3, 2, 3] >= 0.25)


def test_the_analytic_method_is_refused_by_name():
    with pytest.raises(kempe.KempeError, match="'floor'"):
        arm().ik([0.5, 0.5], "tip", method="analytic")


def test_rank_and_freedoms_do_not_see_them():
    m = ball().mobility([0, 0, 0.1, 1, 0, 0, 0])
    assert (m.dof, m.rank_dof, m.gruebler, m.certain) == (6, 6, 6, True)
    assert m.one_sided is not None
    assert (m.one_sided.active, m.one_sided.dimension, m.one_sided.lineality) == (("floor",), 6, 5)
    assert "floor: closed; its value can only grow" in str(m)
    m = ball().mobility([0, 0, 0.5, 1, 0, 0, 0])
    assert m.one_sided is not None
    assert (m.one_sided.active, m.one_sided.lineality) == ((), 6)
    assert "floor: open by 0.4 m" in str(m)


# ---- steps and paths


@pytest.mark.parametrize("keep_direction", [False, True])
def test_steps_stay_inside(keep_direction, hunt):
    system = arm()
    rng = hunt.rng()
    q = system.assemble(start=rng.uniform([-2.0, -3.0], [2.0, 3.0], (hunt.cases(150), 2))).q
    for x in q[arm_beyond(q) < 1e-12]:
        step = system.ik_step(
            x,
            np.append(rng.normal(size=2), np.zeros(4)),
            "tip",
            0.05,
            keep_direction=keep_direction,
        )
        assert arm_beyond(step.q) < 1e-11


def test_a_step_ends_where_a_rope_does():
    """The tip, 1.34 from the hook, pulled away from it: by 0.01, which is had, and by more than the
    rope has.
    """
    system = arm()
    a = np.arctan2(0.9, 1.2) + np.arccos(0.75)
    q = np.array([a, np.arctan2(0.9 - np.sin(a), 1.2 - np.cos(a)) - a])
    p = np.array([1.2, 0.9])
    inside = 1.5 - np.hypot(p[0], p[1] - 1.5)
    out = np.array([p[0], p[1] - 1.5]) / np.hypot(p[0], p[1] - 1.5)
    step = system.ik_step(q, np.append(0.1 * out, np.zeros(4)), "tip", 0.1)
    after = system.fk(step.q, "tip")[:2, 3]
    assert np.hypot(after[0], after[1] - 1.5) == pytest.approx(1.5 - inside + 0.01, abs=1e-3)
    far = system.ik_step(q, np.append(10.0 * out, np.zeros(4)), "tip", 0.5, velocity_limits=np.inf)
    assert arm_beyond(far.q) < 1e-11


def test_a_path_stops_where_the_rope_ends():
    system = arm()
    t = np.linspace(0.0, 1.0, 30)
    path = system.ik_path(np.stack([0.3 + 0.9 * t, 1.2 - 1.2 * t], -1), "tip", [1.9, -1.0])
    assert not path.success.all()
    held = ~np.isnan(path.q).any(axis=1)
    inside = np.hypot(0.3 + 0.9 * t, 1.2 - 1.2 * t - 1.5) <= 1.5
    assert np.array_equal(held, inside)
    assert (arm_beyond(path.q[held]) < 2e-9).all()


# ---- laws of coordinates


def with_law(kind, text, limits=(-np.inf, np.inf)):
    m = Mechanism("law", dim=2)
    m.revolute("A", m.ground, m.body("one"), limits=limits)
    m.revolute("B", m.ground, m.body("two"), at=(1, 0))
    m.frame("tip", "one", at=(1, 0))
    getattr(m, kind)("law", text, of=("A", "B"))
    return m.build()


@pytest.mark.parametrize("kind", ["equation", "inequality"])
def test_laws_tell_turns_apart(kind, hunt):
    system = with_law(kind, "1.2 - A + B/2")
    rng = hunt.rng()
    q = system.assemble(start=rng.uniform(-20.0, 20.0, (hunt.cases(100), 2)))
    law = 1.2 - q.q[:, 0] + q.q[:, 1] / 2
    assert q.success.all()
    assert (law > -1e-8).all()
    if kind == "equation":
        assert (law < 1e-8).all()


def test_targets_are_reached_in_the_turn_that_a_law_allows(hunt):
    """Limits of two turns, of which the law leaves one."""
    system = with_law("inequality", "1.2 - A + 0*B", (-2.0 * np.pi, 2.0 * np.pi))
    for angle in hunt.rng().uniform(-np.pi, np.pi, hunt.cases(50)):
        answer = system.ik([np.cos(angle), np.sin(angle)], "tip", [3.0, 0.0])
        assert answer.success
        assert answer.q[0] <= 1.2 + 1e-9


def test_a_trace_does_not_come_back_by_a_turn_that_a_law_tells_apart():
    path = with_law("inequality", "1.2 - A + 0*B").trace("A", [0.0, 0.1], hold={"B": 0.5})
    assert path.ends[0].startswith("infinity")
    assert path.ends[1] == "the one-sided constraint 'law'"


# ---- motions


def pendulum():
    """A link of length 2 whose tip stays above y = -1."""
    m = Mechanism("pendulum", dim=2)
    m.revolute("A", m.ground, m.body("link"))
    m.frame("tip", "link", at=(2, 0))
    m.frame("low", m.ground, at=(0, -1))
    m.contact("floor", "tip", on="low")
    return m.build()


def test_a_trace_ends_at_a_contact():
    path = pendulum().trace("A", {"A": 1.0})
    assert not path.closed
    assert path.ends == ("the one-sided constraint 'floor'",) * 2
    assert np.sort(path.q[[0, -1], 0]) == pytest.approx([-np.pi / 6, 7 * np.pi / 6], abs=1e-9)
    path = pendulum().trace("A", {"A": 1.0}, limits=False)  # that is about limits of coordinates
    assert not path.closed


def test_a_trace_that_begins_beyond_a_contact_is_refused():
    path = pendulum().trace("A", {"A": -1.0})
    assert not path.success
    assert "'floor' is violated by 0.682942" in str(path)


def test_a_drive_is_held_at_a_contact():
    motion = pendulum().drive({"A": np.linspace(1.0, -1.0, 21)})
    assert motion.held.sum() == np.sum(np.linspace(1.0, -1.0, 21) < -np.pi / 6)
    assert motion.q[-1, 0] == pytest.approx(-np.pi / 6, abs=1e-9)
    assert "beyond the one-sided constraint 'floor'" in str(motion)


def test_a_loop_is_traced_between_contacts():
    bound = above_line()
    free = kempe.load("four_bar")
    path = bound.trace("A", {"A": 1.5})
    assert path.ends == ("the one-sided constraint 'line'",) * 2
    heights = free.fk(path.q, "coupler_point")[:, 1, 3]
    assert heights.min() == pytest.approx(0.25, abs=1e-9)
    assert heights[[0, -1]] == pytest.approx([0.25, 0.25], abs=1e-9)


# ---- bad input


@pytest.mark.parametrize(
    ("constraint", "said"),
    [
        (Contact("ball", radius=-0.1), "radius"),
        (Contact("ball", radius=np.nan), "radius"),
        (Contact("ball", "ball"), "itself"),
        (Contact("ball", "dot"), "particle"),
        (Contact("nothing"), "no frame or body"),
        (Contact("ball", shape="cube"), "shape"),
        (InBox("ball", (1, 0, 0), (0, 1, 1)), "leave nothing"),
        (Distance("ball", "dot", at_least=2.0, at_most=1.0), "leave nothing"),
        (Distance("ball", "dot", at_most=-1.0), "negative"),
    ],
)
def test_bad_input_is_refused(constraint, said):
    m = Mechanism("bad")
    m.free("F", m.ground, m.body("ball"))
    m.free("G", m.ground, m.particle("dot"))
    with pytest.raises(kempe.KempeError, match=said):
        m.constrain(constraint, name="c")
        m.build()
