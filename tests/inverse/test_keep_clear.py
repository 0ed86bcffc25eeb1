"""`ik` with clearances: kept as closed forms measure, found where a grid of configurations finds an
answer, and said where none is found.
"""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
from command import Result
from scipy.optimize import nnls

import kempe
from kempe.constraints import Clearance, Pose, Position, Posture
from kempe.description.toml_writer import write_toml
from kempe.errors import InputError, KempeError, UnknownNameError, UnsupportedError
from kempe.kernels.servo.step_constants import SLOW

pytest.importorskip("coal")

LENGTH = 0.4
THICK = 0.03
AT_LEAST = 0.02


def planar_arm(rng: np.random.Generator, discs: int = 8, dim: int = 2) -> kempe.System:
    """Three links of a planar arm as capsules among discs."""
    m = kempe.Mechanism("arm", dim=dim)
    last = m.ground
    for k in range(3):
        link = m.body(f"link {k}")
        at = (LENGTH if k else 0.0, 0.0, 0.0)[:dim]
        m.revolute(f"q{k}", last, link, at=at, limits=(-2.8, 2.8))
        m.shape(link, "capsule", radius=THICK, length=LENGTH, at=(LENGTH / 2, 0, 0), axis="x")
        last = link
    m.frame("tip", last, at=(LENGTH, 0.0, 0.0)[:dim])
    for k in range(discs):
        angle = rng.uniform(-np.pi, np.pi)
        away = rng.uniform(0.35, 1.1)
        at = (away * np.cos(angle), away * np.sin(angle), 0.0)
        m.obstacle(f"disc {k}", "sphere", radius=rng.uniform(0.05, 0.12), at=at)
    return m.build()


def discs_of(system: kempe.System) -> tuple[np.ndarray, np.ndarray]:
    """Centres (n, 2) and radii (n,) of the discs."""
    bodies = system.mechanism.bodies
    names = [name for name in bodies if name.startswith("disc")]
    centers = np.array([system.fk(system.neutral, name)[:2, 3] for name in names])
    return centers, np.array([bodies[name].shapes[0].geometry.radius for name in names])


def distance(system: kempe.System, q: np.ndarray) -> np.ndarray:
    """The smallest distance (...) of the links from discs, and of the first link from the third."""
    turned = np.cumsum(q, axis=-1)
    steps = LENGTH * np.stack([np.cos(turned), np.sin(turned)], axis=-1)
    joints = np.concatenate([np.zeros_like(steps[..., :1, :]), np.cumsum(steps, axis=-2)], axis=-2)
    centers, radii = discs_of(system)
    out = np.full(q.shape[:-1], np.inf)
    for k in range(3):
        a, b = joints[..., k, :], joints[..., k + 1, :]
        for center, radius in zip(centers, radii, strict=True):
            out = np.minimum(out, to_segment(center, a, b) - radius - THICK)
    first, third = joints[..., :2, :], joints[..., 2:, :]
    crossed = (side(first, third[..., 0, :]) != side(first, third[..., 1, :])) & (
        side(third, first[..., 0, :]) != side(third, first[..., 1, :])
    )
    for p, (a, b) in (
        (third[..., 0, :], (first[..., 0, :], first[..., 1, :])),
        (third[..., 1, :], (first[..., 0, :], first[..., 1, :])),
        (first[..., 0, :], (third[..., 0, :], third[..., 1, :])),
        (first[..., 1, :], (third[..., 0, :], third[..., 1, :])),
    ):
        out = np.minimum(out, to_segment(p, a, b) - 2 * THICK)
    return np.where(crossed, -2 * THICK, out)


def to_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance of points from segments."""
    t = np.clip(np.sum((p - a) * (b - a), axis=-1) / LENGTH**2, 0.0, 1.0)
    return np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1)


def side(line: np.ndarray, p: np.ndarray) -> np.ndarray:
    """On which side of lines (..., 2, 2) points are."""
    along, away = line[..., 1, :] - line[..., 0, :], p - line[..., 0, :]
    return along[..., 0] * away[..., 1] > along[..., 1] * away[..., 0]


def grid_of_solutions(target: np.ndarray) -> np.ndarray:
    """Configurations (n, 3) within limits that reach a target: all of a grid of first angles."""
    first = np.linspace(-2.8, 2.8, 2000)
    p = target - LENGTH * np.stack([np.cos(first), np.sin(first)], axis=-1)
    c = (np.sum(p * p, axis=-1) - 2 * LENGTH**2) / (2 * LENGTH**2)
    there = np.abs(c) <= 1.0
    out = []
    for sign in (1.0, -1.0):
        q2 = sign * np.arccos(c[there])
        angle = np.arctan2(p[there, 1], p[there, 0]) - q2 / 2
        q1 = np.mod(angle - first[there] + np.pi, 2 * np.pi) - np.pi
        out.append(np.stack([first[there], q1, q2], axis=-1))
    q = np.concatenate(out)
    return q[(np.abs(q) <= 2.8).all(axis=-1)]


@pytest.mark.parametrize("dim", [2, 3])
def test_found_where_a_grid_of_configurations_finds_an_answer(dim, hunt):
    rng = hunt.rng()
    asked = there = kept = 0
    for _ in range(hunt.cases(3)):
        s = planar_arm(rng, dim=dim)
        angle, away = rng.uniform(-np.pi, np.pi, 12), rng.uniform(0.2, 1.1, 12)
        targets = away[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        exists = np.array(
            [max(distance(s, grid_of_solutions(t)), default=-1.0) > AT_LEAST for t in targets]
        )
        wide = np.pad(targets, ((0, 0), (0, dim - 2)))
        found = s.ik([Position("tip", wide), Clearance("self", at_least=AT_LEAST)])
        clear = distance(s, found.q) >= AT_LEAST - 1e-6
        assert clear[found.success].all()
        np.testing.assert_allclose(
            s.fk(found.q[found.success], "tip")[:, :2, 3], targets[found.success], atol=1e-5
        )
        assert (s.geometry.clearance(found.q[found.success]) >= AT_LEAST).all()
        asked += len(exists)
        there += exists.sum()
        kept += (found.success & exists).sum()
    assert 0 < there < asked
    assert kept >= 0.97 * there


def test_what_is_not_found_is_said_with_the_pair_and_its_distance():
    s = planar_arm(np.random.default_rng(3))
    center = discs_of(s)[0][0]
    a = s.ik([Position("tip", center), Clearance("self", at_least=AT_LEAST)])
    assert not a.success and a.code == kempe.Status.NOT_FOUND and not a.proven
    assert "'link 2' and 'disc 0' overlap by" in a.status and "at least 0.02 m" in a.status
    assert a.closest.pairs == (("link 2", "disc 0"),)
    short = AT_LEAST - distance(s, a.q)
    np.testing.assert_allclose(a.errors["Clearance of all bodies"], [short, 0.0], atol=1e-5)
    np.testing.assert_allclose(a.closest.distance, AT_LEAST - short, atol=1e-5)
    assert pickle.loads(pickle.dumps(a)).status == a.status


def test_a_batch_says_each_of_its_rows():
    s = planar_arm(np.random.default_rng(3))
    center = discs_of(s)[0][0]
    a = s.ik([Position("tip", [center, (9.0, 9.0), (0.6, 0.2)]), Clearance(at_least=AT_LEAST)])
    assert a.success.tolist() == [False, False, True]
    assert "overlap" in a.status[0] and "outside the workspace" in a.status[1]
    assert "apart" in a.status[2]
    alone = s.ik([Position("tip", (0.6, 0.2)), Clearance(at_least=AT_LEAST)])
    assert alone.success and s.geometry.clearance(alone.q) >= AT_LEAST
    nothing = s.ik([Position("tip", np.zeros((0, 2))), Clearance(at_least=AT_LEAST)])
    assert nothing.q.shape == (0, 3)


def test_a_free_box_is_led_out_of_a_wall():
    """The pose has quaternions, and corners in turn are nearest."""
    m = kempe.Mechanism("box")
    m.free("F", m.ground, m.body("box"))
    m.shape("box", "box", size=(0.2, 0.3, 0.5))
    m.obstacle("wall", "box", size=(0.2, 4, 4))
    s = m.build()
    rng = np.random.default_rng(0)
    for _ in range(10):
        q = s.random(rng)
        q[:3] = rng.uniform(-0.2, 0.2, 3)
        a = s.ik(Clearance("box", "wall", at_least=0.1), start=q)
        assert a.success, a
        R, x = (X := s.fk(a.q, "box"))[:3, :3], X[0, 3]
        half = np.abs(R[0]) @ [0.1, 0.15, 0.25]
        assert abs(x) - half - 0.1 >= 0.1 - 1e-6  # the support function of a box
        assert s.geometry.clearance(a.q) >= 0.1


def test_two_arms_reach_at_the_same_time_and_keep_apart():
    m = kempe.Mechanism("two arms")
    for name, x in (("left", 0.0), ("right", 0.7)):
        last = m.ground
        for k, axis in enumerate("zyyzyy"):
            link = m.body(f"{name} {k}")
            m.revolute(
                f"{name} q{k}", last, link, at=(0, 0, 0.2) if k else (x, 0, 0), axis=axis,
                limits=(-2.9, 2.9),
            )  # fmt: skip
            m.shape(link, "sphere", radius=0.06, at=(0, 0, 0.1))
            last = link
        m.frame(f"{name} hand", last, at=(0, 0, 0.15))
    m.obstacle("post", "sphere", radius=0.1, at=(0.35, 0.1, 0.5))
    s = m.build()
    q = s.random(np.random.default_rng(1), 300)
    q = q[s.geometry.clearance(q) >= AT_LEAST][:30]
    wanted = [Position(f"{n} hand", s.fk(q, f"{n} hand")[:, :3, 3]) for n in ("left", "right")]
    a = s.ik([*wanted, Clearance("self", at_least=AT_LEAST)])
    assert a.success.all()
    centers = s.fk(a.q)[..., :3, 3] + 0.1 * s.fk(a.q)[..., :3, 2]
    bodies = list(s.body_names)
    for one, other in s.geometry.pairs:
        p, r = (
            np.array([0.35, 0.1, 0.5]) if n == "post" else centers[:, bodies.index(n)]
            for n in (one, other)
        )
        radii = 0.06 + (0.1 if "post" in (one, other) else 0.06)
        assert (np.linalg.norm(p - r, axis=-1) - radii >= AT_LEAST - 1e-9).all()


def test_groups_and_several_clearances():
    s = planar_arm(np.random.default_rng(2))
    near = Clearance("link 2", ["disc 0", "disc 1"], at_least=0.05)
    a = s.ik([near, Clearance("link 1", at_least=0.01), Posture([0.1, 0.2, 0.3])])
    assert a.success
    assert s.geometry.clearance(a.q, [("link 2", "disc 0"), ("link 2", "disc 1")]) >= 0.05
    of_link = [pair for pair in s.geometry.pairs if "link 1" in pair]
    assert s.geometry.clearance(a.q, of_link) >= 0.01
    assert set(a.errors) >= {near.label, "Clearance of 'link 1' and all other bodies"}


@pytest.mark.parametrize(
    ("made", "error", "said"),
    [
        (lambda: Clearance("self", at_least=-0.1), InputError, "must not be negative"),
        (lambda: Clearance("self", at_least=np.nan), InputError, "must be finite"),
        (lambda: Clearance("self", at_least=[0.1, 0.2]), InputError, "one for all"),
        (lambda: Clearance("self", "disc 0"), InputError, "leave b out"),
        (lambda: Clearance(3), InputError, "a list of names"),
        (lambda: Clearance("link 0", []), InputError, "a list of names"),
        (lambda: Clearance("self", weight=2.0), InputError, "has a weight"),
        (lambda: Clearance("self", at_least=0.1).soft(), InputError, "has a weight"),
    ],
)
def test_bad_clearances(made, error, said):
    with pytest.raises(error, match=said):
        made()


def test_bad_bodies():
    s = planar_arm(np.random.default_rng(2))
    there = Position("tip", (0.6, 0.2))
    with pytest.raises(UnknownNameError, match="link 2"):
        s.ik([there, Clearance("link2")])
    with pytest.raises(InputError, match="'ground' has no collision shape"):
        s.ik([there, Clearance("ground")])
    with pytest.raises(InputError, match="no two of these bodies can touch"):
        s.ik([there, Clearance(["disc 0", "disc 1"], "disc 2")])
    with pytest.raises(InputError, match="no body of .* has a collision shape"):
        kempe.load("puma560").ik(Clearance())


@pytest.mark.parametrize(
    "call",
    [
        lambda s, c: s.ik_path([c, Position("tip", [(0.6, 0.2), (0.5, 0.2)])]),
        lambda s, c: s.assemble(also=[c]),
        lambda s, c: s.mechanism.constrain(c),
        lambda s, c: kempe.tasks.error(s, c, s.mid),
    ],
)
def test_what_does_not_take_a_clearance_refuses_it(call):
    s = planar_arm(np.random.default_rng(2))
    with pytest.raises(KempeError) as caught:
        call(s, Clearance(at_least=AT_LEAST))
    assert isinstance(caught.value, UnsupportedError) and "not here" in str(caught.value)


def test_the_answer_is_the_same_every_time():
    s = planar_arm(np.random.default_rng(5), dim=3)
    q = s.random(np.random.default_rng(0), 40)
    X = s.fk(q[s.geometry.clearance(q) >= AT_LEAST][:4], "tip")
    wanted = [Pose("tip", X), Clearance(at_least=AT_LEAST)]
    a, b = s.ik(wanted), s.ik(wanted)
    np.testing.assert_array_equal(a.q, b.q)
    assert a.success.all()


def test_ik_all_leaves_out_what_comes_too_near():
    s = planar_arm(np.random.default_rng(3))
    keep = Clearance("self", at_least=AT_LEAST)
    X = s.fk(s.random(np.random.default_rng(0), 60), "tip")
    every, kept = s.ik_all(X, "tip"), s.ik_all(X, "tip", clearance=keep)
    clear = distance(s, every.q) >= AT_LEAST
    assert 0 < (clear & every.mask).sum() < every.mask.sum()
    np.testing.assert_array_equal(kept.mask.sum(axis=1), (clear & every.mask).sum(axis=1))
    assert (distance(s, kept.q[kept.mask]) >= AT_LEAST).all()
    np.testing.assert_array_equal(kept.success, (clear & every.mask & every.inside).any(axis=1))
    k = int(np.flatnonzero((every.mask & ~clear).sum(axis=1) == 2)[0])
    one = s.ik_all(X[k], "tip", clearance=[keep])
    assert one.code is kempe.Status.TOO_NEAR
    assert not one.success and len(one.q) == 0 and "2 are left out that come too near" in one.status
    with pytest.raises(InputError, match="must be a kempe.constraints.Clearance"):
        s.ik_all(X[0], "tip", clearance=0.02)
    with pytest.raises(KempeError, match="loops"):
        kempe.load("four_bar").ik_all((0.1, 0.1), "coupler", clearance=keep)


def test_the_command_line_keeps_clear(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    system = planar_arm(np.random.default_rng(3))
    Path("cell.toml").write_text(write_toml(system.mechanism))
    Path("t.toml").write_text(
        '[[task]]\ntype = "position"\nframe = "tip"\ntarget = [0.6, 0.2]\n'
        '[[task]]\ntype = "clearance"\na = "self"\nat_least = 0.02\n'
    )
    call = ("ik", "cell.toml")
    for given in (
        ("--frame", "tip", "--target", "0.6,0.2", "--clearance", "0.02"),
        ("--tasks", "t.toml"),
    ):
        data = Result(*call, *given, "--json").json()
        assert data["success"] and distance(system, system.q(data["q"])) >= AT_LEAST - 1e-6
    found = Result(
        *call, "--frame", "tip", "--target", "0.6,0.2,0.3", "--all", "--clearance", "0.02"
    )
    assert found.code == 1 and "2 are left out that come too near" in found.out
    Path("t.toml").write_text('[[task]]\ntype = "clearance"\na = "nobody"\nat_least = 0.02\n')
    assert "nobody" in Result(*call, "--tasks", "t.toml").err


def test_paths_and_lists_of_poses_keep_clear_on_the_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    system = planar_arm(np.random.default_rng(3))
    Path("cell.toml").write_text(write_toml(system.mechanism))
    rng = np.random.default_rng(0)
    X = system.fk(system.random(rng, 20), "tip")
    Path("poses.csv").write_text(
        "x,y\n" + "".join(f"{float(x)!r},{float(y)!r}\n" for x, y in X[:, :2, 3])
    )
    keep = Clearance("self", at_least=AT_LEAST)
    for more, clearance in (((), None), (("--clearance", "0.02"), keep)):
        data = Result("reach", "cell.toml", "poses.csv", "--frame", "tip", "--json", *more).json()
        wanted = system.reach.poses(X[:, :2, 3], "tip", clearance=clearance)
        assert data["reached"] == wanted.reached.tolist()
    targets = system.fk(np.linspace(system.neutral, system.random(rng), 30), "tip")
    np.save("targets.npy", targets[:, :2, 3])
    for more, clearance in (((), None), (("--clearance", "0.02"), keep)):
        call = ("path", "cell.toml", "--frame", "tip", "--targets", "targets.npy", "--json", *more)
        data = Result(*call).json()
        wanted = system.ik_path(targets[:, :2, 3], "tip", clearance=clearance)
        assert data["success"] == bool(wanted.success.all()) == (clearance is None)


# ---- steps


def find_unbalanced_pull(s: kempe.System, q: np.ndarray, J: np.ndarray, miss: np.ndarray) -> float:
    """Part of the pull towards a target that limits and near bodies do not balance at q (Kuhn and
    Tucker): zero where no motion leads nearer.
    """
    near = s.geometry.nearest(q)
    kept = near.gradient[near.distance < AT_LEAST + 1e-4]
    every = np.eye(s.nv)
    out = np.concatenate([-kept, every[q > s.upper - 1e-9], -every[q < s.lower + 1e-9]])
    pull = J.T @ miss
    left = nnls(out.T, pull)[1] if len(out) else np.linalg.norm(pull)
    return float(left / np.linalg.norm(pull))


@pytest.mark.parametrize("dim", [2, 3])
def test_steps_are_never_nearer_than_asked_and_rest_where_no_motion_leads_nearer(dim):
    stopped = reached = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        s = planar_arm(rng, dim=dim)
        q = s.random(rng, 400)
        q = q[distance(s, q) >= AT_LEAST + 1e-3][0]
        target = (*rng.uniform(-0.8, 0.8, 2), 0.0)[:dim]
        wanted = [Position("tip", target), Clearance("self", at_least=AT_LEAST)]
        for _ in range(300):
            step = s.ik_step(q, wanted, dt=0.01)
            q = step.q
            assert distance(s, q) >= AT_LEAST
        miss = np.array(target[:2]) - s.fk(q, "tip")[:2, 3]
        if np.linalg.norm(miss) < 1e-6:
            reached += 1
            continue
        assert np.abs(step.velocity).max() <= SLOW * np.pi
        assert find_unbalanced_pull(s, q, s.jacobian(q, "tip")[:2], miss) < 1e-3
        if step.held_apart:
            stopped += 1
            assert "kept apart: '" in step.status
            assert distance(s, q) < AT_LEAST + 1e-4
    assert stopped > 2 and reached


def test_a_body_that_turns_and_slides_freely_stops_at_an_obstacle():
    """Its orientation is a quaternion: derivatives of distances are by its angular velocity."""
    m = kempe.Mechanism("bar")
    m.free("f", m.ground, m.body("bar"))
    m.shape("bar", "capsule", radius=0.05, length=0.8, axis="x")
    m.obstacle("ball", "sphere", radius=0.2, at=(0.3, 0.1, 0.0))
    s = m.build()
    q = s.neutral.copy()
    q[:3] = 0.0, 0.0, 0.6
    goal = np.eye(4)
    goal[2, 3] = -0.1
    wanted = [Pose("bar", goal), Clearance(at_least=0.03)]
    for _ in range(400):
        step = s.ik_step(q, wanted, dt=0.01)
        q = step.q
        assert s.geometry.clearance(q) >= 0.03
    assert s.geometry.clearance(q) < 0.03 + 1e-4
    assert step.held_apart == (("bar", "ball"),) and np.abs(step.velocity).max() < 1e-6


def test_a_linkage_is_held_apart_from_an_obstacle():
    """Steps of closed loops take the rows of near bodies, too."""
    m = kempe.Mechanism("four-bar", dim=2)
    crank, coupler, rocker = (m.body(name) for name in ("crank", "coupler", "rocker"))
    m.revolute("A", m.ground, crank, at=(0, 0))
    m.revolute("B", crank, coupler, at=(0.3, 0))
    m.revolute("C", coupler, rocker, at=(0.8, 0))
    m.revolute("D", rocker, m.ground, at=(0.5, 0))
    m.shape("crank", "sphere", radius=0.02, at=(0.3, 0, 0))
    m.obstacle("peg", "sphere", radius=0.05, at=(0, 0.3, 0))
    s = m.build()
    q = s.assemble({"A": 0.4}).q
    assert s.geometry.clearance(q) > 0.05
    for _ in range(200):
        step = s.ik_step(q, [Posture({"A": 2.5}), Clearance(at_least=0.02)], dt=0.01)
        q = step.q
        assert np.abs(s.loops.closure_error(q)).max() < 1e-9
        assert s.geometry.clearance(q) >= 0.02
    assert s.geometry.clearance(q) < 0.02 + 1e-4 and step.held_apart == (("crank", "peg"),)


def test_two_spheres_that_are_pushed_together_stop_at_the_distance():
    m = kempe.Mechanism("sliders")
    for name, x in (("left", -0.5), ("right", 0.5)):
        m.prismatic(name[0], m.ground, m.body(name), at=(x, 0, 0), axis="x")
        m.shape(name, "sphere", radius=0.1)
    s = m.build()
    q = s.neutral
    wanted = [
        Position("left", (0.2, 0, 0), weight=1.0),
        Position("right", (-0.2, 0, 0), weight=1.0),
        Clearance("left", "right", at_least=0.05),
    ]
    for _ in range(200):
        q = s.ik_step(q, wanted, dt=0.005).q
        assert 1.0 - q[0] + q[1] - 0.2 >= 0.05
    assert 1.0 - q[0] + q[1] - 0.2 < 0.051


def test_steps_lead_out_of_a_collision():
    """Where it stands between two discs that are too near, it may stay there."""
    s = planar_arm(np.random.default_rng(3))
    q = s.random(np.random.default_rng(0), 100)
    d = distance(s, q)
    begun = q[(d < 0.0) & (d > -0.04)][:6]
    out = 0
    for x in begun:
        for _ in range(60):
            before = distance(s, x)
            x = s.ik_step(x, Clearance(at_least=AT_LEAST), dt=0.01).q
            assert distance(s, x) >= min(before, AT_LEAST) - 1e-6
        assert distance(s, x) > 0.0
        out += bool(distance(s, x) >= AT_LEAST - 1e-6)
    assert out >= len(begun) / 2


# ---- paths


def straight_targets(s: kempe.System, start: np.ndarray, goal: np.ndarray, n: int) -> np.ndarray:
    """Targets (n, dim) on the straight way of the tip to a goal (2,)."""
    tip = s.fk(start, "tip")[:2, 3]
    way = tip + np.linspace(0, 1, n)[:, None] * (goal - tip)
    return np.pad(way, ((0, 0), (0, s.dim - 2)))


def test_hunt_paths_are_clear_in_dense_samples(hunt):
    rng = hunt.rng()
    keep = Clearance("self", at_least=AT_LEAST)
    clear = stopped = 0
    for case in range(hunt.cases(10)):
        s = planar_arm(rng, discs=5, dim=2 + case % 2)
        start = s.random(rng, 200)
        start = start[distance(s, start) > AT_LEAST + 0.01][0]
        targets = straight_targets(s, start, rng.uniform(-0.9, 0.9, 2), 25)
        path = s.ik_path(targets, "tip", start, clearance=keep)
        n = int(path.success.sum())
        assert path.success[:n].all()
        np.testing.assert_allclose(s.fk(path.q[:n], "tip")[:, :2, 3], targets[:n, :2], atol=1e-8)
        u = np.linspace(0, 1, 60)[:, None, None]
        q = path.q[:n]
        dense = (q[:-1] + u * (q[1:] - q[:-1])).reshape(-1, 3)
        assert distance(s, dense).min(initial=np.inf) >= AT_LEAST - 1e-6
        assert s.geometry.check_path(path, keep)
        if path:
            clear += 1
        elif path.encounters:
            stopped += 1
            met = path.encounters[0]
            assert met.piece == n - 1 and f"from target {n - 1} to {n}" in path.status
            assert all(repr(name) in path.status for name in met.pair)
    assert clear or stopped


def test_self_motions_lead_a_path_past_what_the_shortest_steps_meet():
    rng = np.random.default_rng(11)
    s = planar_arm(rng, discs=3)
    start = s.random(rng, 200)
    start = start[distance(s, start) > AT_LEAST + 0.01][0]
    targets = straight_targets(s, start, rng.uniform(-0.9, 0.9, 2), 25)
    keep = Clearance("self", at_least=AT_LEAST)
    without = s.ik_path(targets, "tip", start)
    assert without and not s.geometry.check_path(without, keep)
    path = s.ik_path(targets, "tip", start, clearance=keep)
    assert path and s.geometry.check_path(path, keep)


def test_the_branch_that_is_clear_is_taken():
    """The elbow of one branch meets a disc, that of the other does not."""
    m = kempe.Mechanism("arm", dim=2)
    for name, last, at in (("upper", m.ground, (0, 0)), ("lower", "upper", (0.4, 0))):
        m.revolute(f"of {name}", last, m.body(name), at=at)
        m.shape(name, "capsule", radius=0.03, length=0.4, at=(0.2, 0, 0), axis="x")
    m.frame("tip", "lower", at=(0.4, 0))
    m.obstacle("disc", "sphere", radius=0.05, at=(0.3, 0.3, 0))
    s = m.build()
    keep = Clearance("self", at_least=AT_LEAST)
    targets = np.linspace((0.6, -0.1), (0.45, 0.1), 12)
    up = s.ik([Position("tip", targets[0])], start=[0.9, -1.5]).q
    begun = s.ik_path(targets, "tip", up)
    assert begun and not s.geometry.check_path(begun, keep)
    assert s.geometry.check_path(begun.q[:1], keep)
    stopped = s.ik_path(targets, "tip", up, clearance=keep)
    assert not stopped and "'upper' and 'disc'" in stopped.status
    assert "is reached by a jump" in stopped.status
    best = s.ik_path(targets, "tip", up, clearance=keep, branches="best")
    assert best and (np.sin(best.q[:, 1]) > 0).all() and s.geometry.check_path(best, keep)
    again = s.ik_path(targets, "tip", up, clearance=keep, restart=True)
    assert again.success.all() and len(again.jumps) == 1
    for q in np.split(again.q, again.jumps):
        assert s.geometry.check_path(q, keep)


def test_a_path_whose_first_target_is_not_clear_does_not_begin():
    s = planar_arm(np.random.default_rng(3))
    center = discs_of(s)[0][0]
    path = s.ik_path([center, center], "tip", clearance=Clearance(at_least=AT_LEAST))
    assert not path.success.any() and "target 0 is not reached" in path.status
    assert "'link 2' and 'disc 0' overlap by" in path.status
    with pytest.raises(InputError, match="must be a kempe.constraints.Clearance"):
        s.ik_path([center], "tip", clearance=AT_LEAST)


# ---- the free part of the workspace


def test_a_capability_map_counts_what_is_reached_clear_of_bodies():
    s = planar_arm(np.random.default_rng(3))
    keep = Clearance("self", at_least=AT_LEAST)
    box = [[-1.2, -1.2], [1.2, 1.2]]
    found = s.reach.capability("tip", box, 6, 5, clearance=keep)
    every = s.reach.capability("tip", box, 6, 5)
    expected = np.zeros_like(found.reached)
    for i, j, k in np.ndindex(6, 6, 5):
        x, y = found.directions[k, :2]
        target = (found.axes[0][i], found.axes[1][j], np.arctan2(y, x))
        answer = s.ik_all(target, "tip", task="pose", limits=True)
        expected[i, j, k, 0] = (distance(s, answer.q) >= AT_LEAST).any()
    np.testing.assert_array_equal(found.reached, expected)
    assert 0 < found.reached.sum() < every.reached.sum()
    targets = s.fk(s.random(np.random.default_rng(0), 12), "tip")
    study = s.reach.poses(targets, "tip", clearance=keep)
    clear = s.geometry.clearance(study.q[study.reached]) >= AT_LEAST
    assert 0 < study.reached.sum() < 12 and clear.all()
    blocked = int(np.flatnonzero(~study.reached)[0])
    assert "apart" in study.reason(blocked)
