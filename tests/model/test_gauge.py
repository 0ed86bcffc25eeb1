import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from primitive_tables import Row, Table, pose, random_pose, random_table, turn_x, turn_z

from kempe.kernels.compiled import chain, table_sweep
from kempe.kernels.forward.table_layout import (
    BALL,
    FORM,
    GENERAL,
    HEADER,
    IS_CHAIN,
    RX,
    RX_FLAT,
    SLIDE,
    TURN,
)
from kempe.model.gauge import regauge_table, split_turns


def forms(ints):
    return ints[HEADER : HEADER + 6 * ints[0]].reshape(-1, 6)[:, FORM]


def differences(table, n=40):
    """Largest differences of poses and Jacobians, over the size of the robot, and of the two
    kernels.
    """
    rng = np.random.default_rng(0)
    q = table.random_q(rng, n)
    size = 1.0 + sum(
        np.linalg.norm(X[:3, 3]) for X in [r.X for r in table.rows] + [table.outputs[0][2]]
    )
    size += np.abs(q).max() * sum(abs(r.multiplier) for r in table.rows if r.kind == SLIDE)
    before = table.pack()
    after = regauge_table(*before)
    results = []
    for packed in (before, after):
        T = np.empty((n, 4, 4))
        J = np.empty((n, 6, table.nv))
        table_sweep.compute_jacobians(*packed, q, 0, T, J)
        C = np.empty((n, 4, 4))
        chain.compute_chain_poses(*packed, q, C.reshape(n, 16))
        results += [(T, J, C)]
    return after[0], [np.abs(a - b).max() / size for a, b in zip(*results, strict=True)]


@pytest.mark.parametrize(
    "kinds", [(TURN,), (SLIDE,), (TURN, SLIDE), (TURN, BALL), (TURN, SLIDE, BALL)]
)
@pytest.mark.parametrize("n_rows", [1, 2, 3, 7, 20])
def test_random_chains_stay_the_same(n_rows, kinds):
    table = random_table(
        np.random.default_rng(n_rows), n_rows, chain=True, kinds=kinds, particles=True
    )
    ints, errors = differences(table)
    assert max(errors) < 3e-15
    if kinds == (TURN,):
        assert (forms(ints)[1:] != GENERAL).all()


@pytest.mark.parametrize(
    "alpha", [0.0, np.pi / 2, -np.pi / 2, np.pi, 1e-17, 1e-12, 1e-6, 0.4, np.pi - 1e-9, 3.0]
)
@pytest.mark.parametrize("kinds", [(TURN,), (TURN, SLIDE)], ids=str)
def test_axes_at_special_angles(kinds, alpha):
    rng = np.random.default_rng(0)
    table = random_table(rng, 8, chain=True, kinds=kinds)
    for r in table.rows:
        r.X = turn_z(rng.uniform(-3, 3)) @ turn_x(alpha) @ turn_z(rng.uniform(-3, 3))
        r.X[:3, 3] = rng.normal(size=3)
    ints, errors = differences(table)
    assert max(errors) < 3e-15
    if kinds == (TURN,):
        flat = abs(np.sin(alpha)) > 0.5 or abs(np.sin(alpha)) < 1e-16
        assert (forms(ints)[1:] == (RX_FLAT if flat else RX)).all()


def test_a_robot_of_denavit_and_hartenberg_is_found_again():
    rng = np.random.default_rng(0)
    rows = []
    links = [(0.3, 0.0), (0.1, np.pi / 2), (0.4, 0.0), (0.0, -np.pi / 2)]
    for i, (a, alpha) in enumerate(links):
        hidden = turn_z(rng.uniform(-3, 3)) @ pose(p=(0, 0, rng.normal()))
        rows.append(Row(TURN, i - 1, i, i, turn_x(alpha) @ pose(p=(a, 0, 0)) @ hidden))
    table = Table(rows, [(3, False, np.eye(4))], 4, 4, True)
    ints, errors = differences(table)
    assert max(errors) < 1e-15 and (forms(ints)[1:] == RX_FLAT).all()
    placements = regauge_table(*table.pack())[1][: 16 * 4].reshape(4, 16)[:, :12].reshape(4, 3, 4)
    for (a, alpha), X in zip(links[1:], placements[1:], strict=True):
        assert abs(abs(X[0, 3]) - a) < 1e-15 and abs(X[2, 2] - np.cos(alpha)) < 1e-15


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e-18, 1e-16, 1e-14, 1e-8, 1e-3, 1.0]))
def test_split_turns_multiplies_back(seed, tilt):
    rng = np.random.default_rng(seed)
    X = (
        turn_z(rng.uniform(-4, 4))
        @ turn_x(tilt * rng.normal() + np.pi * rng.integers(2))
        @ turn_z(rng.uniform(-4, 4))
    )
    X[:3, 3] = rng.normal(size=3)
    (ca, sa), middle, (cb, sb) = split_turns(X[:3])
    back = turn_z(np.arctan2(sa, ca)) @ np.r_[middle, [[0, 0, 0, 1]]] @ turn_z(np.arctan2(sb, cb))
    assert np.abs(back - X).max() < 3e-15
    assert np.array_equal(middle[0, :3], [1, 0, 0]) and middle[1, 0] == middle[2, 0] == 0.0


def test_arguments_stay_and_trees_are_refused():
    table = random_table(np.random.default_rng(0), 5, chain=True)
    ints, floats = table.pack()
    copies = ints.copy(), floats.copy()
    regauge_table(ints, floats)
    assert np.array_equal(ints, copies[0]) and np.array_equal(floats, copies[1])
    ints[IS_CHAIN] = 0
    with pytest.raises(ValueError, match="chain"):
        regauge_table(ints, floats)


def test_nothing_to_do_on_the_ground():
    table = Table([], [(-1, False, random_pose(np.random.default_rng(0)))], 1, 1, True)
    for a, b in zip(table.pack(), regauge_table(*table.pack()), strict=True):
        assert np.array_equal(a, b)


def test_a_ball_ends_what_can_be_pushed():
    rng = np.random.default_rng(1)
    rows = [
        Row(k, i - 1, 4 * i, 3 * i, random_pose(rng))
        for i, k in enumerate((TURN, BALL, TURN, TURN))
    ]
    table = Table(rows, [(3, False, np.eye(4))], 16, 12, True, [(4, 3)])
    ints, errors = differences(table)
    assert (
        max(errors) < 3e-15 and list(forms(ints))[:3] == [GENERAL] * 3 and forms(ints)[3] != GENERAL
    )


@pytest.mark.parametrize("n_rows", [2, 3, 5])
def test_what_is_pushed_through_a_last_slide_goes_into_the_frame(n_rows):
    table = random_table(np.random.default_rng(n_rows), n_rows, chain=True, kinds=(TURN, SLIDE))
    table.rows[-2].kind = TURN
    table.rows[-1].kind = SLIDE
    ints, errors = differences(table)
    assert max(errors) < 3e-15 and forms(ints)[-1] != GENERAL
