import numpy as np
import pytest
from primitive_tables import Row, Table, pose, random_pose, random_table

from kempe.kernels.compiled import bound, table_sweep
from kempe.kernels.forward.table_layout import (
    BALL,
    BODY,
    SLIDE,
    TURN,
    WORLD,
    WORLD_ALIGNED,
    fuse_table,
)

FRAMES = (WORLD_ALIGNED, WORLD, BODY)
SIZES = (0, 1, 2, 5, 8, 13, 40)


def all_poses(table, q):
    out = np.full((len(q), len(table.outputs), 4, 4), 7.0)
    return table_sweep.compute_poses(*table.pack(), q, out), out


def all_jacobians(table, q, frame):
    T = np.full((len(q), 4, 4), 7.0)
    J = np.full((len(q), 6, table.nv), 7.0)
    return table_sweep.compute_jacobians(*table.pack(), q, frame, T, J), T, J


def close(a, b, scale=1.0):
    return np.abs(a - b).max(initial=0.0) < 2e-13 * scale


@pytest.mark.parametrize("n_rows", SIZES)
@pytest.mark.parametrize("chain", [False, True])
def test_poses_of_random_tables(n_rows, chain):
    rng = np.random.default_rng(n_rows + 100 * chain)
    table = random_table(rng, n_rows, n_out=1 if chain else 9, chain=chain, particles=True)
    q = table.random_q(rng, 7)
    bad, out = all_poses(table, q)
    assert bad == 0 and close(out, np.array([table.poses(x) for x in q]))
    single = np.empty(out.shape[1:])
    for i, x in enumerate(q):
        assert table_sweep.compute_single_poses(*table.pack(), x, single) == 0 and np.array_equal(
            single, out[i]
        )
        assert bound.compute_pose(fuse_table(*table.pack()), x, single[0]) == 0 and close(
            single[0], out[i, 0]
        )


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("chain", [False, True])
@pytest.mark.parametrize("n_rows", SIZES)
def test_jacobians_of_random_tables(n_rows, chain, frame):
    rng = np.random.default_rng(n_rows)
    table = random_table(rng, n_rows, chain=chain, particles=True)
    q = table.random_q(rng, 5)
    bad, T, J = all_jacobians(table, q, frame)
    assert bad == 0 and close(T, np.array([table.poses(x)[0] for x in q]))
    assert close(J, np.array([table.jacobian(x, frame) for x in q]), 100.0)
    T1 = np.empty((4, 4))
    J1 = np.empty((6, table.nv))
    assert bound.compute_pose_jacobian(fuse_table(*table.pack(), frame), q[0], T1, J1) == 0
    only = np.empty_like(J1)
    assert bound.compute_jacobian(
        fuse_table(*table.pack(), frame), q[0], only
    ) == 0 and np.array_equal(only, J1)
    assert np.array_equal(T1, T[0]) and np.array_equal(J1, J[0])


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("seed", range(6))
def test_jacobians_are_derivatives_of_poses_on_the_manifold(seed, frame):
    rng = np.random.default_rng(seed)
    table = random_table(rng, 6, chain=True, particles=seed == 0)
    packed = table.pack()
    q = table.random_q(rng, 1)[0]
    h = 1e-6
    T = np.empty((4, 4))
    J = np.empty((6, table.nv))
    bound.compute_pose_jacobian(fuse_table(*packed, frame), q, T, J)
    p = T[:3, 3]
    R = T[:3, :3]
    there = np.empty((4, 4))
    back = np.empty((4, 4))
    for i, v in enumerate(np.eye(table.nv)):
        bound.compute_pose(fuse_table(*packed), table.moved(q, h * v), there)
        bound.compute_pose(fuse_table(*packed), table.moved(q, -h * v), back)
        rate = (there - back) / (2 * h)
        W = rate[:3, :3] @ R.T
        linear = rate[:3, 3]
        angular = np.array([W[2, 1], W[0, 2], W[1, 0]])
        if frame == WORLD:
            linear = linear + np.cross(p, angular)
        elif frame == BODY:
            linear = R.T @ linear
            angular = R.T @ angular
        assert np.abs(J[:, i] - np.r_[linear, angular]).max() < 2e-8


def test_empty_batches():
    table = random_table(np.random.default_rng(0), 4, n_out=3)
    assert all_poses(table, np.empty((0, table.nq)))[0] == 0
    assert all_jacobians(table, np.empty((0, table.nq)), WORLD)[0] == 0


def test_frames_on_the_ground():
    X = random_pose(np.random.default_rng(0))
    table = Table([], [(-1, False, X), (-1, True, X)], 2, 2)
    bad, out = all_poses(table, np.full((3, 2), np.nan))
    assert (
        bad == 0
        and np.array_equal(out[:, 0], [X] * 3)
        and np.array_equal(out[:, 1], [pose(p=X[:3, 3])] * 3)
    )
    bad, T, J = all_jacobians(table, np.full((3, 2), np.nan), WORLD)
    assert bad == 0 and np.array_equal(T, [X] * 3) and not J.any()


BAD = [np.nan, np.inf, -np.inf]


def poisoned(table, row, value):
    """A configuration in which the coordinate of `row` is bad, and the rows that depend on it."""
    q = table.random_q(np.random.default_rng(0), 1)[0]
    r = table.rows[row]
    q[r.iq : r.iq + (4 if r.kind == BALL else 1)] = value
    hit = [r.iq == other.iq for other in table.rows]
    for i, other in enumerate(table.rows):
        hit[i] |= other.parent >= 0 and hit[other.parent]
    return q, hit


@pytest.mark.parametrize("value", [*BAD, 0.0])
def test_bad_coordinates_spoil_what_depends_on_them_and_nothing_else(value):
    rng = np.random.default_rng(4)
    table = random_table(rng, 14, n_out=20, particles=True)
    # a zero is bad for a ball only
    rows = [k for k in range(14) if value != 0.0 or table.rows[k].kind == BALL]
    assert rows
    for row in rows:
        q, hit = poisoned(table, row, value)
        good = table.random_q(rng, 1)[0]
        bad, out = all_poses(table, np.array([good, q, good]))
        spoilt = [parent >= 0 and hit[parent] for parent, _, _ in table.outputs]
        assert bad == int(any(spoilt))
        assert (
            np.isnan(out[1][spoilt][:, :3]).all()
            and not np.isnan(out[1][np.logical_not(spoilt)]).any()
        )
        assert np.array_equal(out[:, :, 3], np.broadcast_to([0.0, 0, 0, 1], out[:, :, 3].shape))
        assert not np.isnan(out[[0, 2]]).any()
        T = np.empty((4, 4))
        J = np.empty((6, table.nv))
        assert bound.compute_pose_jacobian(
            fuse_table(*table.pack(), WORLD_ALIGNED), q, T, J
        ) == int(spoilt[0])
        assert np.isnan(T[:3]).all() == np.isnan(J).all() == spoilt[0]
        assert np.isnan(T[:3]).any() == np.isnan(J).any() == spoilt[0]
        assert bound.compute_pose(fuse_table(*table.pack()), q, T) == int(spoilt[0])


@pytest.mark.parametrize("turn", [1e8, -1e8, 3e12])
def test_the_gauge_keeps_far_turns_exact(turn):
    """cos and sin of a turn by 1e8, and one beyond the polynomial's reach, beside a gauge angle."""
    table = Table([Row(TURN, -1, 0, 0, np.eye(4), offset=0.3)], [(0, False, np.eye(4))], 1, 1, True)
    for out in (
        all_poses(table, np.array([[turn]]))[1][0, 0],
        all_jacobians(table, np.array([[turn]]), 0)[1][0],
    ):
        c = np.cos(turn)
        s = np.sin(turn)
        expected = [c * np.cos(0.3) - s * np.sin(0.3), s * np.cos(0.3) + c * np.sin(0.3)]
        assert np.abs(out[:2, 0] - expected).max() < 1e-15


@pytest.mark.parametrize("size", [1.0, 1e-290, 1e-150, 1e150, 1e300])
def test_quaternions_of_any_size_are_normalised(size):
    table = Table([Row(BALL, -1, 0, 0, np.eye(4))], [(0, False, np.eye(4))], 4, 3, True, [(0, 0)])
    unit = np.array([0.1, -0.7, 0.5, 0.5]) / np.linalg.norm([0.1, -0.7, 0.5, 0.5])
    bad, out = all_poses(table, np.array([unit * size]))
    assert bad == 0 and close(out[0, 0], table.poses(unit)[0])


def test_a_long_chain_stays_a_rigid_motion():
    n = 10_000
    rng = np.random.default_rng(0)
    rows = [Row(TURN, i - 1, i, i, random_pose(rng)) for i in range(n)]
    table = Table(rows, [(n - 1, False, np.eye(4))], n, n, True)
    q = table.random_q(rng, 1)
    bad, out = all_poses(table, q)
    assert bad == 0 and np.abs(out[0, 0, :3, :3] @ out[0, 0, :3, :3].T - np.eye(3)).max() < 1e-11
    assert close(all_jacobians(table, q, WORLD)[1][0, :3, 3], out[0, 0, :3, 3], 1e4)


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_pinocchio(seed):
    pin = pytest.importorskip("pinocchio")
    rng = np.random.default_rng(seed)
    table = random_table(rng, 12, plain=True)
    model = pin.Model()
    joints = {TURN: pin.JointModelRZ, SLIDE: pin.JointModelPZ, BALL: pin.JointModelSpherical}
    for i, r in enumerate(table.rows):
        model.addJoint(r.parent + 1, joints[r.kind](), pin.SE3(r.X[:3, :3], r.X[:3, 3]), f"j{i}")
    row, _, X = table.outputs[0] = (11, False, table.outputs[0][2])
    frame = model.addFrame(
        pin.Frame("f", row + 1, 0, pin.SE3(X[:3, :3], X[:3, 3]), pin.FrameType.OP_FRAME)
    )
    data = model.createData()
    q = table.random_q(rng, 1)[0]
    theirs = np.empty(model.nq)
    columns = []
    for i, r in enumerate(table.rows):
        joint = model.joints[i + 1]
        values = q[r.iq : r.iq + joint.nq]
        if r.kind == BALL:
            values = np.roll(values / np.linalg.norm(values), -1)
        theirs[joint.idx_q : joint.idx_q + joint.nq] = values
        columns += [(r.iv + k, joint.idx_v + k) for k in range(joint.nv)]
    pin.framesForwardKinematics(model, data, theirs)
    for ours, reference in (
        (WORLD_ALIGNED, pin.LOCAL_WORLD_ALIGNED),
        (WORLD, pin.WORLD),
        (BODY, pin.LOCAL),
    ):
        expected = np.zeros((6, table.nv))
        J = pin.computeFrameJacobian(model, data, theirs, frame, reference)
        for a, b in columns:
            expected[:, a] = J[:, b]
        bad, T, J = all_jacobians(table, q[None], ours)
        assert (
            bad == 0
            and close(T[0], data.oMf[frame].homogeneous, 10.0)
            and close(J[0], expected, 100.0)
        )
