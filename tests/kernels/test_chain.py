import numpy as np
import pytest
from hunts import some
from primitive_tables import Row, Table, all_forms, random_pose, random_table
from scipy.spatial.transform import Rotation

from kempe.kernels.compiled import chain
from kempe.kernels.forward.table_layout import BALL, GENERAL, RX, RX_FLAT, SLIDE, TURN

SIZES = (0, 1, 7, 8, 9, 63, 64, 65, 200)


def swept(table, q):
    out = np.full((len(q), 4, 4), 7.0)
    return chain.compute_chain_poses(*table.pack(), q, out.reshape(len(q), 16)), out


def expected(table, q):
    return np.array([table.poses(x)[0] for x in q]).reshape(-1, 4, 4)


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("n_rows", [1, 2, 7, 12])
def test_random_chains(n_rows, n):
    rng = np.random.default_rng(100 * n_rows + n)
    table = random_table(rng, n_rows, chain=True, forms=all_forms(), particles=True)
    q = table.random_q(rng, n)
    bad, out = swept(table, q)
    assert bad == 0 and np.abs(out - expected(table, q)).max(initial=0.0) < 1e-13


@pytest.mark.parametrize("kind", [TURN, SLIDE, BALL])
@pytest.mark.parametrize("form", [GENERAL, RX, RX_FLAT])
def test_each_kind_with_each_form(kind, form):
    rng = np.random.default_rng(9)
    table = random_table(rng, 5, chain=True, kinds=(kind,), forms=(form,))
    q = table.random_q(rng, 10)
    bad, out = swept(table, q)
    assert bad == 0 and np.abs(out - expected(table, q)).max() < 1e-13


def test_frame_on_the_ground():
    X = random_pose(np.random.default_rng(0))
    bad, out = swept(Table([], [(-1, False, X)], 2, 2, True), np.full((70, 2), np.nan))
    assert bad == 0 and np.array_equal(out, [X] * 70)


@pytest.mark.parametrize("n", [3, 8, 65, 200])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.0])
def test_a_bad_row_becomes_nan_and_leaves_the_others_alone(n, value):
    rng = np.random.default_rng(n)
    table = random_table(rng, 8, chain=True, forms=all_forms(), particles=True)
    q = table.random_q(rng, n)
    clean = swept(table, q)[1]
    reached = [r for r in table.rows if value != 0.0 or r.kind == BALL]
    spoilt = sorted({0, n // 2, n - 1})
    for k, i in enumerate(spoilt):
        r = reached[k % len(reached)]
        q[i, r.iq : r.iq + (4 if r.kind == BALL else 1)] = value
    bad, out = swept(table, q)
    assert bad == len(spoilt) and np.isnan(out[spoilt, :3]).all()
    rest = np.setdiff1d(np.arange(n), spoilt)
    assert np.array_equal(out[rest], clean[rest])
    assert np.array_equal(out[:, 3], np.broadcast_to([0.0, 0, 0, 1], (n, 4)))


def test_coordinates_off_the_chain_do_not_matter():
    rng = np.random.default_rng(0)
    table = random_table(rng, 6, chain=True)
    q = table.random_q(rng, 20)
    clean = swept(table, q)
    q[:, -2:] = np.nan
    bad, out = swept(table, q)
    assert bad == clean[0] == 0 and np.array_equal(out, clean[1])


def test_far_coordinates_and_strange_norms_are_right_beside_near_ones():
    rows = [
        Row(TURN, -1, 0, 0, random_pose(np.random.default_rng(1)), offset=1.0),
        Row(BALL, 0, 1, 1, np.eye(4)),
        Row(SLIDE, 1, 5, 4, random_pose(np.random.default_rng(2)), multiplier=-2.0),
    ]
    table = Table(rows, [(2, False, np.eye(4))], 6, 5, True, [(1, 1)])
    q = table.random_q(np.random.default_rng(0), 30)
    clean = expected(table, q)
    q[3, 0] = 5e9
    q[4, 5] = 4e8
    q[7, 0] = 1e8
    q[5, 1:5] *= 1e-150
    q[6, 1:5] *= 1e150
    bad, out = swept(table, q)
    clean[[3, 4, 7]] = expected(table, q[[3, 4, 7]])
    size = np.maximum(1.0, np.abs(clean).max(axis=(1, 2), keepdims=True))
    assert bad == 0 and (np.abs(out - clean) / size).max() < 1e-14


# ---- parts of poses

WIDTHS = {
    12: lambda X: X[:, :3].reshape(-1, 12),
    7: None,
    3: lambda X: X[:, :3, 3],
    16: lambda X: X.reshape(-1, 16),
}


def written(table, q, width):
    out = np.full((len(q), width), 7.0)
    return chain.compute_chain_poses(*table.pack(), q, out), out


def part(width, X):
    """What is written of poses by these widths, quaternions by scipy."""
    if width != 7:
        return WIDTHS[width](X)
    quat = Rotation.from_matrix(X[:, :3, :3].reshape(-1, 3, 3)).as_quat(
        scalar_first=True, canonical=True
    )
    return np.c_[X[:, :3, 3], quat.reshape(-1, 4)]


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("kind", [TURN, SLIDE, BALL])
@pytest.mark.parametrize("form", [GENERAL, RX, RX_FLAT])
@pytest.mark.parametrize("width", some(WIDTHS, 3))
def test_parts_are_those_of_the_poses(width, form, kind, n):
    rng = np.random.default_rng(n)
    table = random_table(rng, 5, chain=True, kinds=(kind,), forms=(form,), particles=True)
    q = table.random_q(rng, n)
    bad, out = written(table, q, width)
    assert bad == 0 and np.abs(out - part(width, expected(table, q))).max(initial=0.0) < 1e-12


@pytest.mark.parametrize("width", WIDTHS)
def test_half_turns_have_quaternions(width):
    """About each axis and between them, where the largest component changes, and w is zero."""
    rng = np.random.default_rng(0)
    axes = np.r_[np.eye(3), rng.normal(size=(20, 3)), [[1, 1, 0], [0, 1, 1], [1, 1, 1]]]
    turns = Rotation.from_rotvec(
        np.pi * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    ).as_matrix()
    for R in turns:
        X = np.eye(4)
        X[:3, :3] = R
        table = Table([Row(TURN, -1, 0, 0, X)], [(0, False, np.eye(4))], 1, 1, is_chain=True)
        q = np.r_[0.0, rng.uniform(-3, 3, 8)][:, None]
        _, out = written(table, q, width)
        poses = expected(table, q)
        if width == 7:
            back = Rotation.from_quat(out[:, 3:], scalar_first=True).as_matrix()
            assert (out[:, 3] >= 0.0).all() and np.abs(back - poses[:, :3, :3]).max() < 1e-14
        else:
            assert np.abs(out - part(width, poses)).max() < 1e-14


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("width", WIDTHS)
def test_a_bad_configuration_leaves_others_alone(width, value):
    rng = np.random.default_rng(1)
    table = random_table(rng, 6, chain=True, forms=all_forms())
    q = table.random_q(rng, 30)
    clean = written(table, q, width)[1]
    q[11] = value
    bad, out = written(table, q, width)
    assert (
        bad == 1
        and np.isnan(out[11, :3]).all()
        and np.array_equal(np.delete(out, 11, 0), np.delete(clean, 11, 0))
    )


@pytest.mark.parametrize("width", WIDTHS)
def test_no_answer_depends_on_the_others(width, hunt):
    """To the last bit: alone, among few, among many, wherever it stands."""
    rng = hunt.rng()
    for _ in range(hunt.cases(20)):
        table = random_table(rng, int(rng.integers(1, 9)), chain=True, forms=all_forms())
        q = table.random_q(rng, 40)
        q[rng.random(40) < 0.1] *= 1e9
        whole = written(table, q, width)[1]
        first = int(rng.integers(0, 39))
        last = int(rng.integers(first + 1, 41))
        assert np.array_equal(written(table, q[first:last].copy(), width)[1], whole[first:last])
