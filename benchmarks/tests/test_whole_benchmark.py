"""The benchmarks of several tasks at once: the same robots and goals for all, judges that are
right, tables.
"""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from kempe_bench import parallel, peers, whole, whole_peers, whole_robots
from kempe_bench.bench import Bench
from kempe_bench.loop_trees import Tree
from kempe_bench.numeric_worker import FEWEST, Answers, answers
from kempe_bench.whole_peers import COARSE, FINE, Newton
from kempe_bench.whole_robots import BASE, HUMANOIDS, Body

import kempe
from kempe import spatial

pin = pytest.importorskip("pinocchio")
BY_TITLE = {robot.title: robot for robot in HUMANOIDS}


@pytest.fixture(scope="module")
def body_of(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bodies")

    def made(title: str) -> Body:
        body = BY_TITLE[title].body(folder)
        if body is None:
            pytest.skip("example-robot-data is not installed")
        return body

    return made


def line_of(body: Body, mass: bool = False, tolerance=FINE, once: bool = False) -> whole.Line:
    return whole.Line("robot", body, mass, tolerance, once)


# ---- robots


@pytest.mark.parametrize("title", BY_TITLE)
def test_the_file_for_all_is_the_robot(body_of, title):
    """Frames, centre of mass and limits as Pinocchio has them of the robot's own file on a free
    flyer.
    """
    body = body_of(title)
    path = peers.robot_file(BY_TITLE[title].file)
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    data = model.createData()
    q = body.anywhere(5, np.random.default_rng(0))
    X, centre = whole_robots.poses(body, q)
    at = [model.joints[model.getJointId(name)].idx_q for name in body.names]
    assert len(at) == model.nq - BASE
    np.testing.assert_array_equal(
        body.limits.T, [model.lowerPositionLimit[at], model.upperPositionLimit[at]]
    )
    for row, frames, c in zip(q, X, centre, strict=True):
        x = np.empty(model.nq)
        x[:BASE] = row[[0, 1, 2, 4, 5, 6, 3]]
        x[at] = row[BASE:]
        np.testing.assert_allclose(pin.centerOfMass(model, data, x), c, atol=1e-12)
        pin.framesForwardKinematics(model, data, x)
        for name, T in zip(body.frames, frames, strict=True):
            np.testing.assert_allclose(data.oMf[model.getFrameId(name)].homogeneous, T, atol=1e-12)


@pytest.mark.parametrize("title", BY_TITLE)
def test_mujoco_and_kempe_have_the_same_robot(body_of, title):
    mujoco = pytest.importorskip("mujoco")
    body = body_of(title)
    q = body.anywhere(5, np.random.default_rng(0))
    X, centre = whole_robots.poses(body, q)
    for i, name in enumerate(body.frames):
        np.testing.assert_allclose(body.system.fk(q, name), X[:, i], atol=1e-12)
    model, place = whole_robots.mujoco_body(body)
    data = mujoco.MjData(model)
    for row, frames, c in zip(q, X, centre, strict=True):
        data.qpos[place] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        np.testing.assert_allclose(data.subtree_com[1], c, atol=1e-12)
        for name, T in zip(body.frames, frames, strict=True):
            np.testing.assert_allclose(data.body(name).xpos, T[:3, 3], atol=1e-12)
            np.testing.assert_allclose(data.body(name).xmat.reshape(3, 3), T[:3, :3], atol=1e-12)


@pytest.mark.parametrize("title", BY_TITLE)
def test_sets_of_configurations(body_of, title):
    body = body_of(title)
    lower, upper = body.limits.T
    assert np.all((body.start[BASE:] >= lower) & (body.start[BASE:] <= upper))
    far = []
    for draw in (body.anywhere, body.standing):
        q = draw(200, np.random.default_rng(2))
        assert q.shape == (200, BASE + len(body.names)) and np.all(
            (q[:, BASE:] >= lower) & (q[:, BASE:] <= upper)
        )
        np.testing.assert_allclose(np.linalg.norm(q[:, 3:BASE], axis=-1), 1.0, atol=1e-12)
        assert np.abs(q[:, :3]).max() <= whole_robots.MOVED
        far.append((np.abs(q - body.start)[:, BASE:] / (upper - lower)).max())
    assert far[1] <= whole_robots.PART < 0.4 < far[0]


# ---- the judge


def test_the_worst_frame_the_centre_and_the_limits_are_judged(body_of):
    body = body_of("G1")
    q = np.repeat(body.standing(1, np.random.default_rng(3)), 9, axis=0)
    goals = whole.goals_of(body, q, True)
    linear, angular = COARSE
    goals[1, 3, :3, 3] += 0.9 * linear * np.array([0.6, 0.0, 0.8])
    goals[2, 3, :3, 3] += 1.1 * linear * np.array([0.6, 0.0, 0.8])
    goals[3, 2, :3, :3] = goals[3, 2, :3, :3] @ spatial.rot_x(0.9 * angular)
    goals[4, 2, :3, :3] = goals[4, 2, :3, :3] @ spatial.rot_x(1.1 * angular)
    goals[5, 4, :3, 3] += 1.1 * linear * np.array([0.0, 1.0, 0.0])
    q[6, BASE:] = np.nan
    q[7, 3:BASE] *= 1.001  # no quaternion
    head = body.names.index("waist_yaw_joint")
    q[8, BASE + head] += 2.0 * np.pi  # the same poses, beyond the limit
    want = [True, True, False, True, False, False, False, False, False]
    assert line_of(body, True, COARSE).reached(q, goals).tolist() == want
    without = line_of(body, False, COARSE).reached(q, goals[:, :-1]).tolist()
    assert without == [True, True, False, True, False, True, False, False, False]
    fine = line_of(body, True, FINE).reached(q, goals)
    assert fine.tolist() == [True] + [False] * 8


# ---- libraries


@pytest.mark.parametrize("mass", [False, True])
def test_derivatives_of_the_newton_steps(body_of, mass):
    body = body_of("Talos")
    solver = Newton(body, mass, FINE, True)
    rng = np.random.default_rng(4)
    q = body.anywhere(2, rng)
    goal = solver.ready(whole.goals_of(body, q[:1], mass))[0]
    x = solver.own(q[1])
    h = 1e-6
    solver.equations(goal, x)
    J = solver.J.copy()
    for v in rng.normal(size=(5, solver.model.nv)):
        ahead, behind = (
            solver.equations(goal, pin.integrate(solver.model, x, s * h * v)).copy()
            for s in (1, -1)
        )
        np.testing.assert_allclose((ahead - behind) / (2.0 * h), J @ v, atol=1e-6)


def test_one_start_is_one_start(body_of):
    body = body_of("G1")
    tried = []

    class Hopeless(whole_peers.WholeBody):
        def prepare(self):
            pass

        def attempt(self, goal, start):
            tried.append(start)

    for once in (True, False):
        tried.clear()
        assert Hopeless(body, False, FINE, once).solve(None, body.start) is None
        np.testing.assert_array_equal(tried[0], body.start)
        assert (len(tried) == 1) == once
    lower, upper = body.limits.T
    assert (
        all(np.all((x[BASE:] >= lower) & (x[BASE:] <= upper)) for x in tried)
        and np.ptp(tried, axis=0).max() > 1.0
    )


@pytest.mark.parametrize(
    "package, mass",
    [(p, True) for p in ("kempe", "pin")]
    + [
        pytest.param(p, m, marks=pytest.mark.slow)
        for p in ("mink", "pin-pink", "drake")
        for m in (False, True)
    ],
)
def test_libraries_reach(body_of, tmp_path, package, mass):
    """Every library that is installed is given the robot, the start and the goals rightly."""
    if package != "kempe" and importlib.util.find_spec(peers.PEERS[package]) is None:
        pytest.skip(f"{package} is not installed")
    body = body_of("Talos")
    line = line_of(body, mass, COARSE, True)
    goals = whole.goals_of(body, body.standing(20, np.random.default_rng(5)), mass)
    answer = answers(package, [whole._case(tmp_path / "case", line, goals, False)])[0]
    assert not answer.trouble and len(answer.q) == 20
    assert line.reached(answer.q, goals).mean() >= 0.75


# ---- tables


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(whole, "GOALS", FEWEST)
    monkeypatch.setattr(whole, "HUMANOIDS", [BY_TITLE["G1"]])


@pytest.mark.slow
def test_a_section_runs(quick, body_of):
    body_of("G1")
    table = whole.standing(Bench([]))
    assert [g.met for g in table.goals] == [True, True]
    assert len(table.rows) == 8 * 3 + 4 * 2 and all(row.value > 0.0 for row in table.rows)
    assert "goals, fewest in a line: Kempe 20" in " ".join(table.remarks)
    lines = table.markdown().splitlines()
    assert "| robot, largest error | Kempe | Kempe, batch |" in lines
    assert "| G1, 0.0001, restarts: success, % | 100 | 100 |" in lines


def test_a_library_that_is_wrong_or_dies(quick, body_of, monkeypatch):
    body_of("G1")

    def pretended(package, cases):
        out = []
        for case in cases:
            n = FEWEST
            q = np.tile(np.load(f"{case.folder}/starts.npy")[:1], (FEWEST, 1))
            out.append(Answers(q, np.full(n, 2_000_000), ""))
        if package != "kempe":
            out[-1] = Answers(np.full((1, q.shape[1]), np.nan), np.empty(0), "signal 6")
        return out

    monkeypatch.setattr(whole, "answers", pretended)
    bench = Bench([])
    bench.versions = {"drake": "1", "mink": "1"}
    table = whole.anywhere(bench)
    assert (
        table.value("Kempe", "G1, 1e-06, restarts: success") == 0.0
        and [g.met for g in table.goals] == [False] * 2
    )
    assert (
        table.value("mink", "G1, 1e-06, one start: median")
        == table.value("mink", "G1, 1e-06, one start: 99th")
        == 2
    )
    assert (
        table.value("Drake", "G1, 1e-06") is None
        and table.value("Drake", "G1, 0.0001, one start: median") == 2.0
    )
    assert "mink fails on G1 and mass, 1e-06, one start: signal 6" in table.remarks


def test_sections_that_cannot_run(monkeypatch):
    monkeypatch.setattr(peers, "robot_file", lambda name: None)
    reported = []
    assert (
        whole.anywhere(Bench([], reported.append)) is None and "example-robot-data" in reported[0]
    )
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert whole.anywhere(Bench([], reported.append)) is None and "Pinocchio" in reported[1]


# ---- parallel robots


@pytest.fixture(scope="module", params=parallel.ROBOTS)
def platform(request):
    tree = Tree(kempe.load(request.param))
    closed = tree.system.assemble(start=tree.guesses(parallel.SIGMA, 6))
    assert closed.success.all()
    return parallel.Goals(tree, parallel.ROBOTS[request.param]), closed.q


def test_platforms_are_where_kempe_has_them(platform):
    goals, q = platform
    system = goals.tree.system
    np.testing.assert_allclose(goals.of(q), system.fk(q, parallel.PLATFORM), atol=1e-12)
    x = goals.tree.coordinates(q)
    assert goals.opening(x).max() < 1e-8
    goals.X = goals.X.copy()
    goals.X[2, :3, 3] += [3e-6, 4e-6, 0.0]
    assert goals.opening(x)[2] == pytest.approx(5e-6, rel=1e-2)
    if len(goals.rows) == 6 or system.dim == 2:
        goals.X[3, :3, :3] = spatial.rot_z(5e-6) @ goals.X[3, :3, :3]
        assert goals.opening(x)[3] == pytest.approx(5e-6, rel=1e-2)
    goals.of(q)
    x[4, 0] += 1e-3
    assert goals.opening(x)[4] > 1e-5


@pytest.mark.parametrize("made", [parallel.MujocoHolding, parallel.PinocchioHolding])
def test_peers_hold_platforms(platform, made):
    """Their equations vanish at Kempe's configurations, their derivatives are right, their answers
    hold.
    """
    if made is parallel.MujocoHolding:
        pytest.importorskip("mujoco")
    goals, q = platform
    peer = made(goals)
    # Kempe's configurations in the library's coordinates
    held = super(parallel.Holding, peer).ready(q)
    for x, goal in zip(held, peer.ready(q), strict=True):
        peer.goal = goal
        assert np.abs(peer.equations(x)[0]).max() < 1e-8
    # near the goal, since the turning rate is the derivative of a rotation's logarithm only there
    x = peer.add(held[-1], 1e-5 * np.ones(peer.nv))
    h = 1e-6
    J = peer.equations(x)[1].copy()
    for v in np.random.default_rng(6).normal(size=(3, peer.nv)):
        ahead, behind = (peer.equations(peer.add(x, s * h * v))[0].copy() for s in (1, -1))
        np.testing.assert_allclose((ahead - behind) / (2.0 * h), J @ v, atol=1e-3)
    assert peer.opening([peer.call(goal) for goal in peer.ready(q)]).max() < peer.tolerance


def test_the_formula_of_the_legs():
    tree = Tree(kempe.load("stewart"))
    q = tree.system.assemble(start=tree.guesses(0.3, 200)).q
    want = np.abs(q[:, [tree.columns[f"leg{i}"] for i in range(1, 7)]])
    np.testing.assert_allclose(parallel.legs(tree, tree.system.fk(q, "platform")), want, atol=1e-8)


def test_platforms_as_a_table(monkeypatch):
    for name, n in (("GOALS", 5), ("BATCH", 12), ("TURNS", 1)):
        monkeypatch.setattr(parallel, name, n)
    bench = Bench([])
    table = parallel.platforms(bench)
    assert [g.met for g in table.goals] == [True]
    assert (
        table.value(parallel.FORMULA, "stewart: success") == 100.0 and len(table.rows) == 3 * 4 + 2
    )
    assert (
        "| robot | Kempe, one call | Kempe, batch | formula, legs only |"
        in table.markdown().splitlines()
    )
