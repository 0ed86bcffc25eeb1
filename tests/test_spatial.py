"""Rotations and poses against scipy, matrix exponentials and the axioms of groups; the hard places
on purpose.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from kempe import spatial
from kempe.errors import InputError

vectors = arrays(float, 3, elements=st.floats(-1e3, 1e3))
angles = arrays(float, 3, elements=st.floats(-np.pi, np.pi))
quaternions = arrays(float, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 1e-3)
SIZES = [0.0, 1e-300, 1e-160, 1e-16, 1e-9, 1e-8, 1e-5, 9.9e-5, 1.01e-4, 1e-3, 9.9e-3, 1.01e-2, 0.1, 1.0, 3.0,
         np.pi - 1e-2, np.pi - 1e-5, np.pi - 1e-9, np.pi]  # fmt: skip
DIRECTIONS = [
    (1, 0, 0),
    (0, -1, 0),
    (0, 0, 1),
    (0.6, 0, -0.8),
    (1 / 3, -2 / 3, 2 / 3),
    (1e-9, 1, 0),
    (-1, 1e-5, 1e-9),
]


def is_rotation(R, tolerance=1e-14):
    R = np.asarray(R)
    return (
        np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max() < tolerance
        and np.abs(np.linalg.det(R) - 1).max() < tolerance
    )


def random_pose(rng, shape=()):
    return spatial.pose(
        Rotation.random(int(np.prod(shape)), rng).as_matrix().reshape(*shape, 3, 3),
        rng.normal(size=(*shape, 3)),
    )


# ------------------------------------------------------------------ vectors, poses


@given(a=vectors, b=vectors)
def test_skew_is_the_cross_product(a, b):
    np.testing.assert_allclose(spatial.skew(a) @ b, np.cross(a, b), rtol=0, atol=1e-9)


@pytest.mark.parametrize("scale", [5e-324, 1e-300, 1e-160, 1.0, 1e160, 1e300])
def test_unit_at_all_sizes(scale):
    v = spatial.unit(np.array([1.0, -2.0, 2.0]) * scale)
    expected = (
        np.array([1, -2, 2]) * scale / scale / np.linalg.norm(np.array([1, -2, 2]) * scale / scale)
    )
    np.testing.assert_allclose(v, expected, rtol=0, atol=2e-16)


@pytest.mark.parametrize("bad", [(0, 0, 0), (np.nan, 1, 0), (np.inf, 1, 0), (1, -np.inf, np.inf)])
def test_unit_of_nothing_is_nan(bad):
    assert np.isnan(spatial.unit(np.array(bad, dtype=float))).all()


def test_inverse_and_shapes():
    X = random_pose(np.random.default_rng(0), (2, 3))
    np.testing.assert_allclose(
        X @ spatial.inverse(X), np.broadcast_to(np.eye(4), X.shape), atol=1e-15
    )
    np.testing.assert_allclose(spatial.inverse(X), np.linalg.inv(X), atol=1e-14)
    assert spatial.pose().shape == (4, 4) and spatial.pose(p=np.ones((5, 3))).shape == (5, 4, 4)
    assert spatial.pose(np.broadcast_to(np.eye(3), (2, 1, 3, 3)), np.ones((3, 3))).shape == (
        2,
        3,
        4,
        4,
    )


@pytest.mark.parametrize("shape", [(), (0,), (2, 0, 3), (4,), (2, 3)], ids=str)
def test_every_function_broadcasts(shape):
    rng = np.random.default_rng(1)
    three = rng.normal(size=(*shape, 3))
    six = rng.normal(size=(*shape, 6))
    four = rng.normal(size=(*shape, 4))
    R = spatial.exp_so3(three)
    X = spatial.exp_se3(six)
    sizes = {
        "skew": (three, (3, 3)),
        "unit": (three, (3,)),
        "align_z": (three, (3, 3)),
        "exp_so3": (three, (3, 3)),
        "rpy_to_matrix": (three, (3, 3)),
        "matrix_to_rpy": (R, (3,)),
        "log_so3": (R, (3,)),
        "exp_se3": (six, (4, 4)),
        "quat_wxyz_to_matrix": (four, (3, 3)),
        "matrix_to_quat_wxyz": (R, (4,)),
        "quat_wxyz_exp": (three, (4,)),
        "quat_wxyz_log": (four, (3,)),
        "quat_wxyz_conjugate": (four, (4,)),
        "inverse": (X, (4, 4)),
        "log_se3": (X, (6,)),
        "adjoint": (X, (6, 6)),
        "pose_from_xyz_rpy": (six, (4, 4)),
        "xyz_rpy_from_pose": (X, (6,)),
    }
    for name, (argument, core) in sizes.items():
        function = getattr(spatial, name)
        out = function(argument)
        assert out.shape == (*shape, *core), name
        for i in np.ndindex(*shape):
            np.testing.assert_allclose(out[i], function(argument[i]), atol=1e-15, err_msg=name)
    for rot in (spatial.rot_x, spatial.rot_y, spatial.rot_z):
        assert rot(rng.normal(size=shape)).shape == (*shape, 3, 3)
    assert spatial.quat_wxyz_multiply(four, four[..., :]).shape == (*shape, 4)
    assert spatial.quat_wxyz_multiply(np.ones(4), four).shape == (*shape, 4)


# ------------------------------------------------------------------ rotations


@pytest.mark.parametrize("name", "xyz")
@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, -2.0, 100.0, 1e8])
def test_elementary_turns(name, angle):
    R = getattr(spatial, f"rot_{name}")(angle)
    np.testing.assert_allclose(R, Rotation.from_euler(name, angle).as_matrix(), rtol=0, atol=1e-15)


@given(axis=vectors.filter(lambda v: np.linalg.norm(v) > 1e-200))
def test_align_takes_z_to_the_axis_by_the_smallest_rotation(axis):
    R = spatial.align_z(axis)
    a = spatial.unit(axis)
    assert is_rotation(R, 2e-15)
    np.testing.assert_allclose(R[:, 2], a, rtol=0, atol=1e-15)
    angle = np.linalg.norm(Rotation.from_matrix(R).as_rotvec())
    np.testing.assert_allclose(angle, np.arctan2(np.hypot(a[0], a[1]), a[2]), rtol=0, atol=3e-8)


@pytest.mark.parametrize(
    "axis", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
)
def test_align_is_exact_along_the_axes(axis):
    for scale in (1.0, 3.0, 1e-200, 1e200):
        R = spatial.align_z(np.array(axis) * scale)
        np.testing.assert_array_equal(R[:, 2], axis)
        assert np.array_equal(R, np.round(R)) and np.linalg.det(R) == 1.0
    np.testing.assert_array_equal(spatial.align_z([0, 0, -1]), np.diag([1.0, -1.0, -1.0]))
    np.testing.assert_array_equal(spatial.align_z([0, 0, 2]), np.eye(3))


@pytest.mark.parametrize("z", [1.0, -1.0])
@pytest.mark.parametrize("tilt", [1e-3, 1e-8, 1e-16, 1e-200, 5e-324])
def test_align_near_the_poles(z, tilt):
    R = spatial.align_z([tilt, -tilt, z])
    assert is_rotation(R, 1e-15)
    np.testing.assert_allclose(R[:, 2], [tilt, -tilt, z], rtol=0, atol=1e-2 * tilt)


def test_align_of_no_axis_is_nan():
    assert (
        np.isnan(spatial.align_z([0, 0, 0])).all()
        and np.isnan(spatial.align_z([np.inf, 0, 0])).all()
    )


@given(rpy=angles)
def test_rpy_is_what_urdf_means(rpy):
    R = spatial.rpy_to_matrix(rpy)
    np.testing.assert_allclose(R, Rotation.from_euler("xyz", rpy).as_matrix(), rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        spatial.rpy_to_matrix(spatial.matrix_to_rpy(R)), R, rtol=0, atol=1e-12
    )
    assert abs(spatial.matrix_to_rpy(R)[1]) <= np.pi / 2 + 1e-15


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
@pytest.mark.parametrize("off", [0.0, 1e-14, 1e-9, 1e-6])
def test_rpy_at_the_poles(pitch, off):
    R = spatial.rpy_to_matrix([0.4, pitch - off * np.sign(pitch), -1.1])
    back = spatial.matrix_to_rpy(R)
    np.testing.assert_allclose(spatial.rpy_to_matrix(back), R, rtol=0, atol=1e-9)
    if off == 0.0:
        assert back[0] == 0.0


@given(q=quaternions)
def test_quaternions_of_any_length(q):
    R = spatial.quat_wxyz_to_matrix(q)
    assert is_rotation(R, 2e-15)
    np.testing.assert_allclose(
        R, Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix(), rtol=0, atol=1e-14
    )
    for scale in (1e-200, 1e200, -1.0):
        np.testing.assert_allclose(spatial.quat_wxyz_to_matrix(q * scale), R, rtol=0, atol=1e-14)
    back = spatial.matrix_to_quat_wxyz(R)
    assert back[0] >= 0
    np.testing.assert_allclose(np.abs(back @ spatial.unit(q)), 1.0, rtol=0, atol=1e-14)


def test_zero_quaternion_is_no_rotation():
    assert np.isnan(spatial.quat_wxyz_to_matrix([0, 0, 0, 0])).all()


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_quaternion_of_half_turns(direction):
    a = spatial.unit(direction)
    R = 2 * np.outer(a, a) - np.eye(3)
    np.testing.assert_allclose(
        spatial.quat_wxyz_to_matrix(spatial.matrix_to_quat_wxyz(R)), R, rtol=0, atol=1e-15
    )


@given(a=quaternions, b=quaternions)
def test_quaternion_product_is_the_product_of_rotations(a, b):
    A = spatial.quat_wxyz_to_matrix(a)
    B = spatial.quat_wxyz_to_matrix(b)
    np.testing.assert_allclose(
        spatial.quat_wxyz_to_matrix(spatial.quat_wxyz_multiply(a, b)), A @ B, rtol=0, atol=1e-13
    )
    np.testing.assert_allclose(
        spatial.quat_wxyz_to_matrix(spatial.quat_wxyz_conjugate(a)), A.T, rtol=0, atol=1e-14
    )


# ------------------------------------------------------------------ exponentials and logarithms


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_exp_and_log_of_rotations(size, direction):
    w = spatial.unit(direction) * size
    R = spatial.exp_so3(w)
    assert is_rotation(R, 1e-15)
    np.testing.assert_allclose(R, Rotation.from_rotvec(w).as_matrix(), rtol=0, atol=1e-15)
    back = spatial.log_so3(R)
    if size < np.pi - 1e-6:
        np.testing.assert_allclose(back, w, rtol=1e-12, atol=1e-15)
    else:  # at a half turn both signs are right
        assert min(np.abs(back - w).max(), np.abs(back + w).max()) < 1e-7
    np.testing.assert_allclose(spatial.exp_so3(back), R, rtol=0, atol=1e-14)


@pytest.mark.parametrize("size", SIZES)
def test_log_of_quaternions_is_short_and_sign_blind(size):
    w = np.array([0.6, -0.8, 0.0]) * size
    q = spatial.quat_wxyz_exp(w)
    assert abs(np.linalg.norm(q) - 1) < 1e-15
    np.testing.assert_allclose(spatial.quat_wxyz_log(q), w, rtol=1e-14, atol=1e-320)
    if size < np.pi:
        np.testing.assert_array_equal(spatial.quat_wxyz_log(-q), spatial.quat_wxyz_log(q))
    far = spatial.quat_wxyz_log(
        spatial.quat_wxyz_exp(np.array([0.6, -0.8, 0.0]) * (2 * np.pi - size))
    )
    np.testing.assert_allclose(np.linalg.norm(far), size, rtol=0, atol=1e-14)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("direction", DIRECTIONS[2:5])
def test_exp_and_log_of_poses(size, direction):
    w = spatial.unit(direction) * size
    twist = np.concatenate([[0.3, -1.2, 2.0], w])
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = spatial.skew(w), twist[:3]
    X = spatial.exp_se3(twist)
    np.testing.assert_allclose(X, expm(generator), rtol=0, atol=1e-13)
    back = spatial.log_se3(X)
    np.testing.assert_allclose(spatial.exp_se3(back), X, rtol=0, atol=1e-13)
    if size < np.pi - 1e-6:
        np.testing.assert_allclose(back, twist, rtol=0, atol=1e-12 if size < 3 else 1e-8)


def test_log_of_a_pose_is_the_matrix_logarithm():
    X = random_pose(np.random.default_rng(5), (20,))
    for pose, twist in zip(X, spatial.log_se3(X), strict=True):
        L = logm(pose).real
        np.testing.assert_allclose(twist, [*L[:3, 3], L[2, 1], L[0, 2], L[1, 0]], rtol=0, atol=1e-9)


@pytest.mark.parametrize("turns", [1.0, 10.0, 1e4])
def test_exp_of_many_turns(turns):
    w = np.array([0.0, 0.6, 0.8]) * (2 * np.pi * turns + 0.5)
    np.testing.assert_allclose(
        spatial.exp_so3(w), Rotation.from_rotvec(w).as_matrix(), rtol=0, atol=1e-14 * turns * 10
    )


@given(seed=st.integers(0, 10**6))
def test_adjoint_moves_twists(seed):
    rng = np.random.default_rng(seed)
    X_AB = random_pose(rng)
    X_BC = random_pose(rng)
    twist = rng.normal(size=6)
    Ad = spatial.adjoint
    np.testing.assert_allclose(Ad(X_AB) @ Ad(X_BC), Ad(X_AB @ X_BC), rtol=0, atol=1e-13)
    np.testing.assert_allclose(
        spatial.exp_se3(Ad(X_AB) @ twist),
        X_AB @ spatial.exp_se3(twist) @ spatial.inverse(X_AB),
        rtol=0,
        atol=1e-12,
    )


@given(seed=st.integers(0, 10**6))
def test_xyz_rpy_there_and_back(seed):
    X = random_pose(np.random.default_rng(seed))
    np.testing.assert_allclose(
        spatial.pose_from_xyz_rpy(spatial.xyz_rpy_from_pose(X)), X, rtol=0, atol=1e-12
    )


def test_nan_stays_nan():
    bad = np.full(3, np.nan)
    for name in ("exp_so3", "rpy_to_matrix", "align_z", "quat_wxyz_exp"):
        assert np.isnan(getattr(spatial, name)(bad)).any(), name
    X = np.eye(4)
    X[:3] = np.nan
    assert np.isnan(spatial.log_se3(X)).all() and np.isnan(spatial.xyz_rpy_from_pose(X)).any()


# ---- poses from particles


@pytest.mark.parametrize("dim", [2, 3])
def test_a_pose_is_found_from_its_particles(dim):
    """Without noise exactly; with noise no pose nearby is better, and scipy finds the same
    rotation.
    """
    rng = np.random.default_rng(3)
    X = spatial.pose(
        spatial.rot_z(rng.uniform(-3, 3, 20)), np.pad(rng.normal(size=(20, 2)), ((0, 0), (0, 1)))
    )
    if dim == 3:
        X = spatial.pose(spatial.exp_so3(rng.normal(size=(20, 3))), rng.normal(size=(20, 3)))
    body = rng.normal(size=(5, dim))
    places = body @ np.swapaxes(X[:, :dim, :dim], -1, -2) + X[:, None, :dim, 3]
    fit = spatial.fit_pose(body, places)
    np.testing.assert_allclose(fit.X, X, atol=1e-12)
    np.testing.assert_allclose(fit.residual, 0.0, atol=1e-12)
    noisy = places + 0.05 * rng.normal(size=places.shape)
    fit = spatial.fit_pose(body, noisy)
    np.testing.assert_allclose(fit.distances.shape, (20, 5))
    for _ in range(50):
        twist = 1e-3 * rng.normal(size=6) * ([1, 1, 0, 0, 0, 1] if dim == 2 else 1)
        other = fit.X @ spatial.exp_se3(twist)
        off = body @ np.swapaxes(other[:, :dim, :dim], -1, -2) + other[:, None, :dim, 3] - noisy
        assert (np.sqrt((off**2).sum(axis=-1).mean(axis=-1)) >= fit.residual - 1e-12).all()
    if dim == 3:
        from scipy.spatial.transform import Rotation

        a = body - body.mean(axis=0)
        b = noisy[0] - noisy[0].mean(axis=0)
        np.testing.assert_allclose(
            fit.X[0, :3, :3], Rotation.align_vectors(b, a)[0].as_matrix(), atol=1e-9
        )


def test_particles_that_do_not_fix_a_pose():
    line = [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    triangle = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    for particles, places, match in (
        (line, line, "one line"),
        (triangle, line, "one line"),
        (triangle[:2], triangle[:2], "at least 3"),
        (triangle, [[0, 0]] * 3, "shape"),
        (triangle, [[np.nan, 0, 0], *triangle[1:]], "not finite"),
        ("x", triangle, "x"),
    ):
        with pytest.raises(InputError, match=match):
            spatial.fit_pose(particles, places)
    many = spatial.fit_pose(triangle, [triangle, [[np.nan, 0, 0], *triangle[1:]], line])
    np.testing.assert_allclose(many.X[0], np.eye(4), atol=1e-15)
    assert np.isnan(many.X[1:, :3]).all() and np.isnan(many.residual[1:]).all()
    assert spatial.fit_pose(triangle, np.zeros((0, 3, 3))).X.shape == (0, 4, 4)
    corners = np.vstack([np.eye(3), np.zeros(3)])
    mirrored = spatial.fit_pose(corners, -corners)
    assert np.linalg.det(mirrored.X[:3, :3]) == pytest.approx(1.0) and mirrored.residual > 0.1


@pytest.mark.parametrize(
    "function", [spatial.inverse, spatial.log_se3, spatial.adjoint, spatial.xyz_rpy_from_pose]
)
def test_the_last_row_of_a_pose_is_read(function):
    """A NaN there makes the answer NaN, and other numbers are refused: `ik` does the same."""
    good = spatial.pose_from_xyz_rpy([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    for entry in range(4):
        wrong = good.copy()
        wrong[3, entry] = np.nan
        rows = np.stack([good, wrong])
        assert np.isnan(np.asarray(function(wrong))[..., :3]).any()
        np.testing.assert_array_equal(function(rows)[0], function(good))
        assert np.isnan(np.asarray(function(rows)[1])[..., :3]).any()
        wrong[3, entry] = 5.0
        for X in (wrong, np.stack([good, wrong])):
            with pytest.raises(InputError, match="its last row is .*5.0.*; it must be 0 0 0 1"):
                function(X)
