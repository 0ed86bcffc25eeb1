"""The kernel of dyads: operations on poses against matrices, blocks and lanes, bad numbers."""

from __future__ import annotations

import numpy as np
import pytest
from dyad_chains import random_chain

from kempe.assemble.dyad_decomposition import Code
from kempe.assemble.dyads import Plan, find_closed_form
from kempe.kernels.compiled import dyads_program
from kempe.kernels.dyads import dyads_layout as K

SIZES = (0, 1, 7, 8, 9, 63, 64, 65)
IDENTITY = (1.0, 0.0, 0.0, 0.0)


def matrix(c, s, x, y):
    return np.array([[c, -s, x], [s, c, y], [0, 0, 1.0]])


def random_pose(rng):
    angle = rng.uniform(-3, 3)
    return np.cos(angle), np.sin(angle), *rng.uniform(-1, 1, 2)


def run(code: Code, known, values, near=None, signs=None):
    """q and status of a program whose known coordinates come first."""
    ints, floats = code.pack_arrays(list(range(known)))
    q = np.full((len(values), code.nq), 7.0)
    status = np.full((len(values), 3), 7.0)
    near = np.zeros((1, code.nq)) if near is None else near
    signs = np.ones((1, code.signs)) if signs is None else signs
    assert dyads_program.run_program(ints, floats[None], values, signs, near, q, status) == len(
        values
    )
    return q, status


def reading(code: Code, a: int, b: int, slot: int, limits=(-np.inf, np.inf)) -> None:
    """Let the coordinate be the angle of part b seen from part a, whose origins should coincide."""
    ints = [
        code.get_register(a),
        code.get_register(b),
        code.get_coordinate(slot),
        code.get_target(slot),
        0,
    ]
    code.append_operation(K.READ_TURN, ints, [1, 0, 1, 0, 2 * np.pi, *limits, 0, 0, 0, 0, 1])


@pytest.mark.parametrize("n", SIZES)
def test_turns_and_slides_are_products_of_matrices(n):
    """Ground, a turn, a slide, then the pose read as an angle, a length along x, and the opening."""
    rng = np.random.default_rng(n)
    code = Code(3, 4)
    places = [random_pose(rng) for _ in range(4)]
    r = code.get_register
    code.append_operation(
        K.TURN, [r(1), r(0), code.get_coordinate(0)], [2.0, *places[0], *places[1]]
    )
    code.append_operation(
        K.SLIDE, [r(2), r(1), code.get_coordinate(1)], [-1.5, *places[2], *places[3]]
    )
    reading(code, 0, 2, 2)
    ints = [r(0), r(2), code.get_coordinate(3), code.get_target(3), 0]
    code.append_operation(K.READ_SLIDE, ints, [0, 0, 1, 0, 0, 0, 1, 0, 1, 0, 1, 0])
    values = rng.uniform(-2, 2, (n, 2))
    q, status = run(code, 2, values)
    A, B, C, D = (matrix(*p) for p in places)
    for i, (a, d) in enumerate(values):
        X = A @ matrix(np.cos(2 * a), np.sin(2 * a), 0, 0) @ B @ C @ matrix(1, 0, -1.5 * d, 0) @ D
        assert np.abs(q[i] - [a, d, np.arctan2(X[1, 0], X[0, 0]), X[0, 2]]).max() < 1e-14
        opening = np.hypot(np.hypot(*X[:2, 2]), X[1, 2])
        assert abs(status[i, 0] - opening) < 1e-14 and status[i, 1] == 0


def test_registers_are_carried_and_turned_round():
    """CARRY: 1 = 2 1; DIVIDE: 1 = 1 inverse(2); REBASE: both seen from the first."""
    rng = np.random.default_rng(1)
    A = random_pose(rng)
    B = random_pose(rng)
    XA = matrix(*A)
    XB = matrix(*B)
    inverse = np.linalg.inv
    for op, expected in (
        (K.CARRY, XB @ XA),
        (K.DIVIDE, XA @ inverse(XB)),
        (K.REBASE, inverse(XA) @ XB),
    ):
        code = Code(4, 2)
        r = code.get_register
        code.append_operation(K.TURN, [r(1), r(0), code.get_coordinate(0)], [0.0, *A, *IDENTITY])
        code.append_operation(K.TURN, [r(2), r(0), code.get_coordinate(0)], [0.0, *B, *IDENTITY])
        code.append_operation(op, [r(1), r(2)] if op != K.REBASE else [r(1), r(2), r(3), r(1)])
        reading(code, 0, 1, 1)
        q, status = run(code, 1, np.zeros((1, 1)))
        assert abs(q[0, 1] - np.arctan2(expected[1, 0], expected[0, 0])) < 1e-14
        assert abs(status[0, 0] - np.hypot(*expected[:2, 2])) < 1e-14
        if op == K.REBASE:
            code.ops.pop()
            reading(code, 0, 3, 1)
            back = run(code, 1, np.zeros((1, 1)))[1][0, 0]
            assert abs(back - np.hypot(*inverse(XA)[:2, 2])) < 1e-14


def test_sums_and_expectations():
    code = Code(1, 2)
    code.append_operation(K.SET, [code.get_coordinate(1)], [0.25])
    code.append_operation(K.ADD, [code.get_coordinate(1), code.get_coordinate(0)], [-3.0])
    code.append_operation(K.SET, [K.SPARE], [-1.0])
    code.append_operation(K.ADD, [K.SPARE, code.get_coordinate(1)], [1.0])
    code.append_operation(K.EXPECT_ZERO, [K.SPARE], [2.0])
    q, status = run(code, 1, np.array([[0.5], [-0.25]]))
    assert q[:, 1].tolist() == [-1.25, 1.0] and status[:, 0].tolist() == [4.5, 0.0]


@pytest.mark.parametrize(
    "low, high", [(-np.inf, np.inf), (-1.0, 1.0), (2.0, 2.0 + 2 * np.pi), (-20.0, -10.0)]
)
def test_representatives(low, high):
    """Nearest to the target; then inside the limits, where a whole number of turns leads there."""
    code = Code(2, 2)
    r = code.get_register
    code.append_operation(K.TURN, [r(1), r(0), code.get_coordinate(0)], [1.0, *IDENTITY, *IDENTITY])
    reading(code, 0, 1, 1, (low, high))
    rng = np.random.default_rng(2)
    values = rng.uniform(-3, 3, (200, 1))
    targets = rng.uniform(-30, 30, (200, 1))
    q = run(code, 1, values, np.hstack([np.zeros((200, 1)), targets]))[0][:, 1]
    turns = (q - values[:, 0]) / (2 * np.pi)
    assert np.abs(turns - np.round(turns)).max() < 1e-14
    candidates = values + 2 * np.pi * np.arange(-12, 13)
    inside = (candidates >= low) & (candidates <= high)
    for i in range(200):
        if inside[i].any():
            assert low - 1e-12 <= q[i] <= high + 1e-12
            if low <= targets[i, 0] <= high:
                assert np.abs(candidates[i] - q[i]).min() < 1e-12
        else:
            assert abs(q[i] - targets[i, 0]) <= np.pi + 1e-12


def test_lanes_do_not_depend_on_each_other():
    """A bad row is NaN, one beyond the polynomials' reach goes by the library of C, and the others
    stay as they are.
    """
    code = Code(2, 2)
    r = code.get_register
    code.append_operation(K.TURN, [r(1), r(0), code.get_coordinate(0)], [1.0, *IDENTITY, *IDENTITY])
    reading(code, 0, 1, 1)
    values = np.random.default_rng(3).uniform(-3, 3, (20, 1))
    clean = run(code, 1, values)
    values[[2, 9, 19], 0] = np.nan, np.inf, 1e12
    q, status = run(code, 1, values)
    assert np.isnan(q[[2, 9], 1]).all() and np.isnan(status[[2, 9], 0]).all()
    assert abs(q[19, 1] - np.arctan2(np.sin(1e12), np.cos(1e12))) < 1e-15
    rest = np.setdiff1d(np.arange(20), [2, 9, 19])
    assert np.array_equal(q[rest], clean[0][rest]) and np.array_equal(status[rest], clean[1][rest])


@pytest.mark.parametrize("kind", ["RRR", "RRP", "RPR", "PRR"])
def test_the_margin_is_the_sine_of_the_angle_between_the_links(kind):
    """It says how far two branches are apart; of a link on a slider, the angle is that to the
    normal of the slide.
    """
    for seed in range(10):
        chain = random_chain(seed, (kind,), most=1, variable=False)
        system = chain.system()
        plan = find_closed_form(system, chain.known)
        assert isinstance(plan, Plan)
        start = system.q(chain.values)
        values = np.array([[chain.values[name] for name in plan.known]])
        q, status = plan._run_program(values, plan.branch_of(start)[None], start[None])
        X = system.fk(q[0])
        first, line, last = (plan._locate_line(X, end) for end in plan.dyads[-1].ends)
        a = last[0] - first[0]
        if plan.dyads[-1].along:
            expected = abs(line[1] @ a) / np.linalg.norm(a)
        else:
            b = last[0] - line[0]
            expected = abs(a[0] * b[1] - a[1] * b[0]) / (np.linalg.norm(a) * np.linalg.norm(b))
        assert abs(status[0, 2] - expected) < 1e-12
