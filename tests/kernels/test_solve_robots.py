import numpy as np
import pytest
from chain_problems import POSE, POSITION, judge, solve
from pinocchio_chains import Arm

ROBOTS = {
    "panda": ("panda.urdf", "panda_hand_tcp"),
    "ur5": ("ur5_robot.urdf", "tool0"),
    "icub": ("icub.urdf", "r_hand"),
    "tiago": ("tiago.urdf", "arm_tool_link"),
    "talos": ("talos_reduced.urdf", "gripper_left_base_link"),
    "so101": ("so101.urdf", "gripper_frame_link"),
}


def arm(name):
    return Arm(*ROBOTS[name])


@pytest.mark.parametrize("name", ROBOTS)
def test_the_table_is_the_robot(name):
    robot = arm(name)
    for q in robot.random_q(np.random.default_rng(0), 5):
        assert np.abs(robot.table.poses(q)[0] - robot.forward(q)).max() < 1e-13


@pytest.mark.parametrize("name", ROBOTS)
def test_reachable_targets(name):
    """All found, judged by Pinocchio, with no more work than when the solver was tuned, and a
    margin.
    """
    robot = arm(name)
    mask = POSITION if name == "so101" else POSE
    targets, _ = robot.reachable(np.random.default_rng(1), 400)
    answers = solve(robot, targets, mask)
    assert judge(robot, answers, targets, mask).all()
    assert (
        np.median(answers.steps) <= 12 and answers.steps.mean() < 30 and answers.starts.mean() < 2
    )
    assert np.median(answers.residual, axis=0).max() < 1e-12


@pytest.mark.parametrize("name", [n for n in ROBOTS if n != "so101"])
def test_half_of_the_joints_at_their_limits(name):
    robot = arm(name)
    rng = np.random.default_rng(2)
    targets = np.array([robot.forward(q) for q in robot.at_limits(rng, 400)])
    answers = solve(robot, targets)
    right = judge(robot, answers, targets)
    assert right.mean() >= 0.995 and answers.starts.mean() < 4


@pytest.mark.parametrize("name", ["panda", "ur5", "tiago"])
def test_a_near_seed_needs_few_steps(name):
    robot = arm(name)
    rng = np.random.default_rng(3)
    q = robot.random_q(rng, 300)
    targets = np.array([robot.forward(x) for x in q])
    seeds = np.clip(q + rng.uniform(-0.05, 0.05, q.shape), robot.lower, robot.upper)
    answers = solve(robot, targets, seeds=seeds[:, None])
    assert (
        judge(robot, answers, targets).all()
        and np.median(answers.steps) <= 4
        and answers.starts.mean() < 1.05
    )
    assert np.quantile(np.abs(answers.q - seeds).max(axis=1), 0.95) < 0.5


@pytest.mark.parametrize("name", ["panda", "talos"])
def test_out_of_reach_the_answer_does_not_depend_on_the_random_starts(name):
    """Different random starts agree on the distance: it is the least one, not just any local
    minimum.
    """
    robot = arm(name)
    rng = np.random.default_rng(4)
    targets, _ = robot.reachable(rng, 25)
    targets[:, :3, 3] += [0.0, 0.0, 2.5]
    first, second = (solve(robot, targets, POSITION, seed=s) for s in (1, 2))
    judge(robot, first, targets, POSITION)
    gap = np.abs(first.residual - second.residual)[:, 0]
    assert (first.status == 1).all() and np.median(gap) < 1e-12 and (gap < 1e-6).mean() >= 0.9
    assert (first.residual[:, 0] > 0.5).all()
