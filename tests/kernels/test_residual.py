"""The error of the inverse kinematics, its Jacobian and the Hessian of its energy, against finite
differences.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pytest
from chain_problems import (
    DIRECTION,
    ORIENTATION,
    POSE,
    POSITION,
    POSITION_AXIS,
    distance,
    floating_arm,
    limited,
)
from primitive_tables import pose, random_table
from scipy.spatial.transform import Rotation

from kempe.kernels.base._jit import kernel
from kempe.kernels.base.declare import OUT, F, I
from kempe.kernels.base.vectors import get_pointer, keep_alive
from kempe.kernels.forward.table_layout import SLIDE, TURN
from kempe.kernels.one_frame.descent import fill_hessian
from kempe.kernels.one_frame.ik_problem import (
    count_columns,
    count_problem_floats,
    count_problem_ints,
    make_ik_problem,
    set_goal,
)
from kempe.kernels.one_frame.residual import (
    JACOBIAN_STRIDE,
    compute_error,
    fill_jacobian,
    trace_chain,
)

pytestmark = pytest.mark.slow  # a kernel is compiled
LENGTH = 0.7


def look(ints, floats, limits, task, targets, q, out, e, J, H):
    """Error (6,), Jacobian (6, nv) and Hessian (nv, nv) at one configuration q (1, 1, nq)."""
    columns = count_columns(get_pointer(ints))
    nq = ints[2]
    nv = ints[3]
    notes = np.empty(count_problem_ints(columns, nv), np.int64)
    block = np.empty(count_problem_floats(columns, nq, nv))
    problem = make_ik_problem(
        ints,
        floats,
        limits,
        task,
        targets,
        q,
        0,
        0,
        1,
        1,
        1e-6,
        1e-6,
        0.7,
        out,
        columns,
        get_pointer(notes),
        get_pointer(block),
    )
    chain = problem.chain
    set_goal(chain, problem.targets, 0)
    for i in range(nq):
        chain.q[i] = q[0, 0, i]
    tip = trace_chain(chain)
    found = compute_error(chain.goal, tip)
    fill_jacobian(chain, tip)
    fill_hessian(chain, found, tip, get_pointer(H))
    for i in range(6):
        e[i] = found[i]
        for v in range(nv):
            J[i, v] = chain.jacobian[JACOBIAN_STRIDE * v + i]
    keep_alive(notes)
    keep_alive(block)


@functools.cache
def probe() -> Callable[..., None]:
    """`look` as a kernel, compiled when a test first needs it: that takes seconds."""
    takes = I("_"), F("_"), F(2, "nv"), I("_"), F(1, 4, 4), F(1, 1, "nq"), OUT("_", "_"), OUT(6)
    return kernel(*takes, OUT(6, "nv"), OUT("nv", "nv"), returns=False)(look)


def looked_at(chain, q, target, mask):
    nq = chain.table.nq
    nv = chain.table.nv
    e = np.zeros(6)
    J = np.zeros((6, nv))
    H = np.zeros((nv, nv))
    out = np.zeros((1, nq + 5))
    task = np.r_[np.array((*mask, 0)[:7]), chain.circular]
    limits = np.array([chain.lower, chain.upper])
    probe()(*chain.table.pack(), limits, task, target[None], q[None, None], out, e, J, H)
    return e, J, H


def scales(chain):
    """Units of the velocity coordinates: a radian, or the chain's length for those that only slide."""
    turning = {
        v
        for r in chain.table.rows
        if r.kind != SLIDE
        for v in range(r.iv, r.iv + (1 if r.kind == TURN else 3))
    }
    return np.array([1.0 if v in turning else LENGTH for v in range(chain.table.nv)])


def energy(chain, q, target, mask):
    linear, angular = distance(chain, q, target, mask)
    return 0.5 * ((linear / LENGTH) ** 2 + angular**2)


CHAINS = {
    "turns and slides": lambda: limited(
        random_table(np.random.default_rng(3), 7, chain=True, kinds=(TURN, TURN, SLIDE)), -2.0, 2.0
    ),
    "floating": floating_arm,
}


@pytest.mark.parametrize("mask", [POSE, POSITION, ORIENTATION, DIRECTION, POSITION_AXIS])
@pytest.mark.parametrize("name", CHAINS)
def test_gradient_and_hessian_are_those_of_the_distance(name, mask):
    chain = CHAINS[name]()
    rng = np.random.default_rng(0)
    unit = scales(chain)
    nv = chain.table.nv
    h = 1e-4
    for _ in range(4):
        q = chain.random_q(rng, 1)[0]
        target = pose(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))
        e, J, H = looked_at(chain, q, target, mask)
        assert np.allclose(0.5 * e @ e, energy(chain, q, target, mask), rtol=1e-9)

        def at(v, q=q, target=target):
            return energy(chain, chain.table.moved(q, v * unit), target, mask)

        steps = np.eye(nv) * h
        gradient = np.array([(at(s) - at(-s)) / (2 * h) for s in steps])
        assert np.allclose(-J.T @ e, gradient, atol=1e-6 * (1 + np.abs(gradient).max()))
        if name != "floating":  # along a ball second differences depend on the path
            second = np.array(
                [[at(a + b) - at(a - b) - at(b - a) + at(-a - b) for a in steps] for b in steps]
            )
            second /= 4 * h * h
            assert np.allclose(H, second, atol=2e-4 * (1 + np.abs(second).max()))


@pytest.mark.parametrize("angle", [1e-5, 1e-3, 0.0])
def test_hessian_near_the_goal(angle):
    """There it is J^T J, in which turns about the pointed axis do not count."""
    chain = CHAINS["turns and slides"]()
    rng = np.random.default_rng(1)
    q = chain.random_q(rng, 1)[0]
    target = chain.forward(q)
    target[:3, :3] = Rotation.from_rotvec([angle, 0, 0]).as_matrix() @ target[:3, :3]
    e, J, H = looked_at(chain, q, target, DIRECTION)
    assert np.linalg.norm(e) <= 1.001 * angle + 1e-15 and np.allclose(
        H, J.T @ J, atol=4 * angle + 1e-12
    )
    axis = chain.forward(q)[:3, 2]
    assert np.abs(axis @ J[3:]).max() < 1e-14
