"""The benchmark of the numerical inverse model: the same chains for all, a judge that is right,
tables that say so.
"""

from __future__ import annotations

import dataclasses
import importlib.util

import numpy as np
import pytest
from kempe_bench import numeric, numeric_peers, numeric_robots, numeric_worker, peers
from kempe_bench.bench import Bench
from kempe_bench.numeric_robots import ROBOTS
from kempe_bench.numeric_worker import FEWEST, Answers, Case

import kempe

BY_TITLE = {robot.title: robot for robot in ROBOTS}
TOLERANCE = numeric_peers.TOLERANCE


@pytest.fixture(scope="module")
def arm_of(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chains")

    def made(title: str) -> peers.Arm:
        arm = BY_TITLE[title].arm(folder)
        if arm is None:
            pytest.skip("example-robot-data is not installed")
        return arm

    return made


def case_of(folder, arm: peers.Arm, n: int, seconds: float = 60.0) -> tuple[Case, np.ndarray]:
    q, starts = numeric.anywhere(arm, n)
    targets = numeric.poses(arm, q)
    return numeric._case(folder, arm, targets, starts, False, seconds), targets


# ---- chains


@pytest.mark.parametrize("title", [r.title for r in ROBOTS if r.file])
def test_chains_move_as_the_robots_do(arm_of, title):
    """Between two configurations the frame moves as Pinocchio says for the whole robot, read from
    its own file.
    """
    pin = pytest.importorskip("pinocchio")
    robot = BY_TITLE[title]
    arm = arm_of(title)
    path = peers.robot_file(robot.file)
    if path is None:
        pytest.skip("example-robot-data is not installed")
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    frame = model.getFrameId(robot.frame)
    joints = []
    joint = model.frames[frame].parentJoint
    while joint:
        joints.append(joint)
        joint = model.parents[joint]
    moved = joints[::-1][robot.dropped :]
    assert len(moved) == len(arm.links)
    want = []
    for row in arm.random(4):
        q = pin.neutral(model)
        q[[model.joints[j].idx_q for j in moved]] = row
        pin.forwardKinematics(model, data, q)
        want.append(pin.updateFramePlacement(model, data, frame).homogeneous)
    have = arm.pose(arm.random(4))
    for X, Y in zip(want[1:], have[1:], strict=True):
        np.testing.assert_allclose(
            np.linalg.inv(have[0]) @ Y, np.linalg.inv(want[0]) @ X, atol=1e-12
        )
    limits = np.array(
        [
            [model.lowerPositionLimit[i], model.upperPositionLimit[i]]
            for i in (model.joints[j].idx_q for j in moved)
        ]
    )
    np.testing.assert_allclose(arm.limits, limits, atol=1e-12)


@pytest.mark.parametrize("title", BY_TITLE)
def test_pinocchio_and_plain_products_agree(arm_of, title):
    pytest.importorskip("pinocchio")
    arm = arm_of(title)
    q = arm.random(5)
    np.testing.assert_allclose(numeric.poses(arm, q), arm.pose(q), atol=1e-13)


def test_snakes_are_planar_and_one_metre_long(arm_of):
    arm = arm_of("planar 20R")
    np.testing.assert_allclose(arm.pose(np.zeros((1, 20)))[0, :3, 3], [1.0, 0.0, 0.0], atol=1e-12)
    X = arm.pose(arm.random(10))
    assert np.max(np.abs(X[:, 2, 3])) == 0.0 and np.allclose(X[:, 2, 2], 1.0)


def test_robots_without_the_package(monkeypatch, tmp_path):
    monkeypatch.setattr(peers, "robot_file", lambda name: None)
    arms, missing = numeric._arms(tmp_path)
    assert {"Panda", "UR5", "iiwa 14", "SO-101", "planar 40R"} <= set(
        arms
    ) and "Talos torso + arm" in missing
    assert len(arms) + len(missing) == len(ROBOTS)


# ---- targets


@pytest.mark.parametrize("title", ["iiwa 14", "SO-101", "planar 10R"])
def test_sets_of_targets(arm_of, title):
    arm = arm_of(title)
    lower, upper = arm.limits.T
    for draw in (numeric.anywhere, numeric.at_limits, numeric.nearby):
        q, starts = draw(arm, 50)
        for rows in (q, starts):
            assert rows.shape == (50, len(arm.links)) and np.all((rows >= lower) & (rows <= upper))
        ends = np.sum((q == lower) | (q == upper), axis=-1)
        assert np.all(ends == (len(arm.links) // 2 if draw is numeric.at_limits else 0))
        away = np.abs(q - starts)
        if draw is numeric.nearby:
            inside = (starts > lower) & (starts < upper)
            np.testing.assert_allclose(away[inside], numeric.OFF, atol=1e-12)
            assert np.all(away <= numeric.OFF + 1e-12) and inside.mean() > 0.9
        else:
            assert np.median(away) > 0.3


# ---- the judge


def test_distance_and_angle_are_judged(arm_of):
    """iiwa: its last joint only turns the frame, about the frame's own origin, so the angle is
    known.
    """
    arm = arm_of("iiwa 14")
    q = arm.random(5)
    targets = arm.pose(q)
    q[:, 6] += np.array([0.0, 0.9, 1.1, -1.1, 0.0]) * TOLERANCE
    targets[4, :3, 3] += 1.1 * TOLERANCE * np.array([0.6, 0.0, 0.8])
    assert numeric.reached(arm, q, targets).tolist() == [True, True, False, False, False]
    targets[4, :3, 3] -= 0.2 * TOLERANCE * np.array([0.6, 0.0, 0.8])
    assert numeric.reached(arm, q, targets)[4]


def test_the_norm_counts_and_not_the_components(arm_of):
    arm = arm_of("UR5")
    q = arm.random(2)
    targets = arm.pose(q)
    targets[0, :3, 3] += 0.57 * TOLERANCE
    targets[1, :3, 3] += 0.60 * TOLERANCE
    assert numeric.reached(arm, q, targets).tolist() == [True, False]


def test_limits_are_judged(arm_of):
    arm = arm_of("UR5")
    lower, upper = arm.limits[5]
    q = np.repeat(arm.random(1), 6, axis=0)
    q[:, 5] = [
        upper,
        upper + 0.5 * numeric.SLACK,
        upper + 3.0 * numeric.SLACK,
        lower,
        lower - 3.0 * numeric.SLACK,
        1.0,
    ]
    targets = arm.pose(q)
    assert numeric.reached(arm, q, targets).tolist() == [True, True, False, True, False, True]
    q[5, 5] += 2.0 * np.pi  # the same pose
    np.testing.assert_allclose(arm.pose(q[5:]), targets[5:], atol=1e-12)
    assert not numeric.reached(arm, q, targets)[5]


def test_no_answer_is_no_success(arm_of):
    arm = arm_of("SO-101")
    q = np.zeros((2, 5))
    targets = arm.pose(q)
    q[1] = np.nan
    assert numeric.reached(arm, q, targets).tolist() == [True, False]


def test_a_single_failure_is_seen():
    hit = np.ones(10_000, dtype=bool)
    assert numeric.percent(hit) == 100.0
    hit[7] = False
    assert numeric.percent(hit) == pytest.approx(99.9)


# ---- processes


@pytest.mark.slow
def test_a_library_answers_in_a_process(arm_of, tmp_path):
    bad = arm_of("iiwa 14")
    good = arm_of("SO-101")
    cases, targets = zip(
        *(case_of(tmp_path / str(i), arm, 30) for i, arm in enumerate((bad, good))), strict=True
    )
    broken = dataclasses.replace(cases[0], file=str(tmp_path / "none.urdf"))
    first, second = numeric_worker.answers("kempe", [broken, cases[1]])
    assert "none.urdf" in first.trouble and not len(first.nanoseconds)
    assert not numeric.reached(bad, first.q, targets[0][: len(first.q)]).any()
    assert not second.trouble and len(second.nanoseconds) == 30 and np.all(second.nanoseconds > 0)
    assert numeric.reached(good, second.q, targets[1]).all()


def test_a_share_of_the_time_is_kept(arm_of, tmp_path):
    case, _ = case_of(tmp_path / "case", arm_of("planar 10R"), 40, seconds=0.0)
    numeric_worker.work("kempe", case)
    answer = numeric_worker._read("kempe", case, "")
    assert answer.q.shape == (FEWEST, 10) and len(answer.nanoseconds) == FEWEST
    # the target that it ended on
    assert len(numeric_worker._read("kempe", case, "signal 6").q) == FEWEST + 1


@pytest.mark.slow
@pytest.mark.parametrize("package", list(numeric_peers.SOLVERS))
def test_libraries_reach(arm_of, tmp_path, package):
    """Every library that is installed is given the robot and its targets rightly."""
    if package != "kempe" and importlib.util.find_spec(peers.PEERS[package]) is None:
        pytest.skip(f"{package} is not installed")
    arm = arm_of("iiwa 14")
    case, targets = case_of(tmp_path / "case", arm, 20)
    answer = numeric_worker.answers(package, [dataclasses.replace(case, near=True)])[0]
    assert not answer.trouble
    assert numeric.reached(arm, answer.q, targets).mean() >= (0.5 if package == "ikpy" else 0.9)


# ---- tables


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(numeric, "TARGETS", 30)
    monkeypatch.setattr(numeric, "ROBOTS", [BY_TITLE["SO-101"], BY_TITLE["planar 10R"]])


def pretended(package: str, cases: list[Case]) -> list[Answers]:
    """Answers of a library that is right twice of three times, on the first robot, and dies on the
    second.
    """
    targets = np.load(f"{cases[0].folder}/targets.npy")
    system = kempe.load(cases[0].file)
    q = system.ik(targets, numeric_robots.TIP).q
    q[::3, 0] += 1e-4 if package != "kempe" else 0.0
    times = np.full(len(q), 5_000)
    nothing = Answers(np.full((1, 10), np.nan), np.empty(0), "signal 6")
    return [
        Answers(q, times),
        nothing if package != "kempe" else Answers(np.zeros((30, 10)), times),
    ]


def test_tables(quick, monkeypatch):
    monkeypatch.setattr(numeric, "answers", pretended)
    bench = Bench([])
    bench.versions = {"optik-py": "1"}
    table = numeric.random(bench)
    assert (
        table.value("Kempe", "SO-101: success")
        == table.value("Kempe, batch", "SO-101: success")
        == 100.0
    )
    assert table.value("OptIK", "SO-101: success") == pytest.approx(66.6)
    assert table.value("OptIK", "SO-101: median") == table.value("OptIK", "SO-101: 99th") == 5.0
    assert table.value("Kempe", "planar 10R: success") == 0.0 and [g.met for g in table.goals] == [
        False
    ]
    assert (
        table.value("OptIK", "planar 10R") is None
        and "OptIK fails on planar 10R: signal 6" in table.remarks
    )
    lines = table.markdown().splitlines()
    assert "| robot | Kempe | Kempe, batch | OptIK |" in lines
    assert "| SO-101: success, % | 100 | 100 | 66.6 |" in lines
    assert any(
        line.startswith("| planar 10R: median, us | 5 |") and line.endswith("| - |")
        for line in lines
    )


@pytest.mark.slow
@pytest.mark.parametrize("section", [numeric.random, numeric.limits, numeric.warm])
def test_sections_run(quick, section):
    bench = Bench([], targets=25)
    table = section(bench)
    assert [g.met for g in table.goals] == [True]
    assert len(table.rows) == 2 * (3 + 2) and all(row.value > 0.0 for row in table.rows)
    assert "fewest on a robot: Kempe 25" in " ".join(table.remarks)
