"""Public reports about units, pasted matrices, quaternions, and which Jacobian is meant."""

from __future__ import annotations

import numpy as np
import pytest
from public_oracles import PI, jacobian_by_differences, nearest, pose_errors

import kempe
from kempe import Mechanism, System

# ---- Jacobians


def test_the_jacobian_is_the_velocity_of_the_point_in_axes_of_the_ground():
    """pinocchio, issues 1525, 1140 and 1974: which one of three Jacobians is the default, and what
    are the others?
    """
    s = kempe.load("gen3")
    rng = np.random.default_rng(1)
    none = np.zeros((3, 3))
    for _ in range(20):
        q = rng.uniform(-2, 2, 7)
        J = s.jacobian(q, "tool")
        np.testing.assert_allclose(
            J, jacobian_by_differences(lambda v: s.fk(v, "tool"), q), atol=1e-7
        )
        R = s.fk(q, "tool")[:3, :3]
        np.testing.assert_allclose(
            np.block([[R, none], [none, R]]) @ s.jacobian(q, "tool", "body"), J, atol=1e-10
        )


def test_the_jacobian_of_the_world_is_that_of_the_point_at_the_origin():
    """pinocchio, issue 1140: the "WORLD" Jacobian surprised; it is the velocity of the body's point
    at the origin.
    """
    s = kempe.load("gen3")
    q = np.random.default_rng(2).uniform(-2, 2, 7)
    J = s.jacobian(q, "tool")
    place = s.fk(q, "tool")[:3, 3]
    at_origin = J[:3] + np.cross(place, J[3:], axisb=0).T
    np.testing.assert_allclose(s.jacobian(q, "tool", "world")[:3], at_origin, atol=1e-9)


# ---- units


def arm(unit: float) -> System:
    """Six-axis arm whose lengths are metres divided by `unit`."""
    rows = [
        (0.75, 0.35, -PI / 2),
        (0, 1.15, 0),
        (0, 0.041, -PI / 2),
        (1.0, 0, PI / 2),
        (0, 0, -PI / 2),
        (0.215, 0, 0),
    ]
    table = [
        {"d": d * unit, "a": a * unit, "alpha": alpha, "limits": (-2.9, 2.9)}
        for d, a, alpha in rows
    ]
    return kempe.from_dh(table).build()


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e-3, 1e-6])
def test_angles_do_not_depend_on_the_unit_of_length(unit):
    """KDL, issue 33; compas_fab, issue 192; mujoco, issue 1086: the same arm in metres,
    millimetres, kilometres.
    """
    metres = arm(1.0)
    s = arm(unit)
    for seed in range(60):
        q = metres.random(seed)
        X = metres.fk(q, "tool").copy()
        X[:3, 3] *= unit
        answer = s.ik(X, "tool", start=np.zeros(6))
        distance, angle = pose_errors(s.fk(answer.q, "tool"), X)
        assert answer and distance / unit < 1e-6 and angle < 1e-6, seed
        assert nearest(s.ik_all(X, "tool").q, q) < 1e-6, seed


# ---- rotation matrices and quaternions


def pose_of(rotation: list[list[float]]) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3] = rotation
    X[:3, 3] = 0.4, 0.2, 0.3
    return X


SIX_DIGITS = [
    [0.00923097, 0.969766, -0.243866],
    [0.999943, -0.0102479, -0.00290165],
    [-0.00531284, -0.243825, -0.969805],
]
FIVE_DIGITS = [
    [0.33638, -0.01749, 0.94156],
    [-0.02078, -0.99972, -0.01114],
    [0.94150, -0.01582, -0.33665],
]
THREE_DIGITS = [[-0.003, -0.362, 0.932], [-0.009, -0.932, -0.362], [1.0, -0.009, 0]]
REFLECTION = [
    [0.02269121, 0.99974055, -0.00198294],
    [-0.99970877, 0.0227067, 0.00817137],
    [-0.00821428, -0.00179695, -0.99996465],
]


@pytest.mark.filterwarnings("ignore:the rotation of target")
def test_a_pasted_rotation_with_six_digits_is_accepted():
    """KDL, request 116: a pose is pasted as it was printed, with six digits."""
    assert kempe.load("ur5").ik(pose_of(SIX_DIGITS), "tool").status


@pytest.mark.filterwarnings("ignore:the rotation of target")
@pytest.mark.parametrize(
    "rotation", [FIVE_DIGITS, THREE_DIGITS], ids=["five digits", "three digits"]
)
def test_a_coarser_rotation_is_accepted_or_refused_with_a_way_out(rotation):
    """pypose, issue 83; ur5_simulation, issue 6: the matrix was printed with five or three digits."""
    try:
        assert kempe.load("ur5").ik(pose_of(rotation), "tool").status
    except kempe.KempeError as error:
        assert "nearest" in str(error) or "fit_pose" in str(error)


def test_a_reflection_is_refused():
    """opencv, issue 16778: a decomposition gave a matrix with determinant -1; is it taken for a
    rotation?
    """
    assert np.linalg.det(np.array(REFLECTION)) < 0
    with pytest.raises(kempe.KempeError, match="mirror|reflect|det|rotation"):
        kempe.load("ur5").ik(pose_of(REFLECTION), "tool")


def box() -> System:
    m = Mechanism("box")
    m.free("F", m.ground, m.body("box"))
    return m.build()


def test_a_quaternion_and_its_negative_are_one_orientation():
    """quaternion, issue 150; idto, issue 17: distance, difference and interpolation of q and -q."""
    s = box()
    space = s.configuration_space
    for seed in range(50):
        q = s.random(seed)
        other = s.random(seed + 100)
        same = q * [1, 1, 1, -1, -1, -1, -1]
        assert space.distance(q, same) < 1e-12 and np.abs(space.difference(q, same)).max() < 1e-12
        assert space.distance(q, other) == pytest.approx(space.distance(same, other), abs=1e-12)
        halves = [s.fk(space.interpolate(v, other, 0.5), "box") for v in (q, same)]
        np.testing.assert_allclose(halves[0], halves[1], atol=1e-9)


def test_a_quaternion_of_another_length_is_the_same_orientation():
    """Quadrotor-NMPC, issue 1: a quaternion with norm 1.7 is given to fk, and as the start of ik."""
    s = box()
    q = s.random(3)
    longer = q * [1, 1, 1, 1.7, 1.7, 1.7, 1.7]
    X = s.fk(q, "box")
    np.testing.assert_allclose(s.fk(longer, "box"), X, atol=1e-12)
    answer = s.ik(X, "box", start=longer)
    assert answer and np.linalg.norm(answer.q[3:]) == pytest.approx(1, abs=1e-9)
