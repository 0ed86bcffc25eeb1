"""Defects that were found once, each by an input of a user's kind, so that they do not come back."""

from __future__ import annotations

import math

import numpy as np
import pytest

import kempe
from kempe.errors import DescriptionError, InputError


def test_out_that_overlaps_q_gives_the_same_poses():
    robot = kempe.load("puma560")
    q = robot.random(0, 100)
    for frame, tail in (("tool", (4, 4)), (None, (7, 4, 4))):
        memory = np.zeros(100 * math.prod(tail))
        memory[: q.size] = q.ravel()
        out = robot.fk(memory[: q.size].reshape(q.shape), frame, out=memory.reshape(100, *tail))
        assert np.array_equal(out, robot.fk(q, frame))


def test_transposed_pose_is_refused_as_target():
    robot = kempe.load("puma560")
    X = robot.fk(robot.q("qn"), "tool")
    with pytest.raises(InputError, match="its last row is"):
        robot.ik(X.T, "tool")
    batch = robot.ik(np.stack([X, X.T]), "tool")
    assert batch.success.tolist() == [True, False] and np.isnan(batch.q[1]).all()
    with pytest.raises(InputError, match="real numbers"):
        robot.ik(X.astype(complex), "tool")


def test_orientation_of_a_particle_is_refused_as_target():
    system = kempe.Mechanism("particle")
    system.translation("t", system.ground, system.particle("p"))
    built = system.build()
    target = np.diag([-1.0, -1.0, 1.0, 1.0])
    with pytest.raises(InputError, match="particle"):
        built.ik(target, "p")
    assert built.ik(target, "p", task="position") and built.ik(np.eye(4), "p") and built.ik([1.0, 2.0, 3.0], "p")


def test_limit_is_the_reason_even_where_the_task_has_more_equations_than_freedoms():
    robot = kempe.load("cobra600")
    for joint in ("q1", "q3"):
        i = robot.coordinate_names.index(joint)
        q = robot.mid.copy()
        q[i] = robot.upper[i] + 0.05
        assert f"blocked by the limit of '{joint}'" in robot.ik(robot.fk(q, "tool"), "tool").status


def _geared(driver: tuple[float, float], driven: tuple[float, float], ratio: float, driven_first: bool):
    system = kempe.Mechanism("gear")
    joints = {"x": driver, "y": driven}
    for name in sorted(joints, reverse=driven_first):
        system.revolute(name, system.ground, system.body(f"body_{name}"), limits=joints[name])
    system.gear("y", "x", ratio)
    return system.build()


@pytest.mark.parametrize("driven_first", [False, True])
def test_limits_that_do_not_overlap_name_both_joints_whatever_their_order(driven_first):
    with pytest.raises(DescriptionError, match=r"joint 'y': .*'x' in \[5, 6\], those of joint 'x' for \[-1, 1\]"):
        _geared((-1.0, 1.0), (5.0, 6.0), 1.0, driven_first)


@pytest.mark.parametrize("driven_first", [False, True])
@pytest.mark.parametrize(
    ("driver", "driven"), [((0.3, 0.3), (0.1, 0.1)), ((-1.0, 0.3), (0.1, 2.0)), ((0.3, 1.0), (0.0, 0.1))]
)
def test_limits_that_touch_through_a_gear_are_accepted(driver, driven, driven_first):
    for ratio in (1.0 / 3.0, np.nextafter(1.0 / 3.0, 0.0), np.nextafter(1.0 / 3.0, 1.0)):
        limits = _geared(driver, driven, ratio, driven_first).structure.limits
        np.testing.assert_allclose(limits, [[0.3, 0.3]], rtol=1e-15)
        assert limits[0, 0] <= limits[0, 1]


def test_wrong_arguments_are_named():
    robot = kempe.load("puma560")
    target = robot.fk(robot.q("qn"), "tool")
    with pytest.raises(InputError, match="starts is"):
        robot.ik(target, "tool", budget=kempe.Budget(starts=10**30))
    with pytest.raises(InputError, match=r"it must be \(6,\)$"):
        robot.ik(target, "tool", start=np.zeros((2, 6)))
    with pytest.raises(kempe.KempeError, match="frame of expression"):
        robot.jacobian(robot.neutral, "tool", ["body"])
    assert robot.ik(target, "tool", tolerance=np.array([1e-6, 1e-6]))


def test_swapped_letters_of_a_short_attribute_are_a_slip():
    text = (
        "<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='fixed'><parent link='a'/>"
        "<child link='b'/><origin xzy='1 0 0'/></joint></robot>"
    )
    with pytest.raises(kempe.errors.DescriptionError, match="did you mean 'xyz'"):
        kempe.load(text)


def test_a_jacobian_written_over_its_own_configuration():
    robot = kempe.load("puma560")
    query = robot.query("tool")
    q = robot.random(0)
    J, X = query.jacobian(q), query(q)
    memory = np.zeros(40)
    for start in (0, 3, 30, 34):
        memory[start : start + 6] = q
        out = query.jacobian(memory[start : start + 6], "world_aligned", memory[:36].reshape(6, 6))
        assert np.array_equal(out, J)
    memory[5:11] = q
    assert np.array_equal(query(memory[5:11], memory[:16].reshape(4, 4)), X)
