"""Jets against Taylor coefficients by Fourier transform of complex matrix products on a circle."""

from __future__ import annotations

import numpy as np
import pytest
from hunts import some
from primitive_tables import pose, random_pose, random_table
from scipy.linalg import expm

from kempe.kernels.compiled import jet, projection
from kempe.kernels.constraints.loop_layout import (
    ALIGN,
    ANGLE,
    CROSS,
    DISTANCE,
    FULL,
    LINEAR,
    NO_TURN,
)
from kempe.kernels.forward.table_layout import BALL, SLIDE, TURN
from kempe.kernels.series.jet_layout import POSE_SIZE, compute_scratch_width

ORDER = 8
RADIUS = 0.15
POINTS = 48
"""The circle: large enough for rounding to be divided by little at order 8, small enough for
aliases to vanish."""


def cross(w):
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def complex_poses(table, q, v):
    """Poses (n_out, 4, 4) after the tangent vector v, which may be complex, from q; no conjugation
    anywhere.
    """
    after = []
    for r in table.rows:
        X = np.eye(4) if r.parent < 0 else after[r.parent]
        if r.kind == BALL:
            R = np.array(table.motion(r, q), dtype=complex)[:3, :3]
            turn = expm(cross(v[r.iv : r.iv + 3]))
            M = pose().astype(complex)
            # of a reversed ball `motion` is the inverse
            M[:3, :3] = R @ turn if r.multiplier > 0 else turn.T @ R
        else:
            x = r.multiplier * (q[r.iq] + v[r.iv])
            M = pose().astype(complex)
            if r.kind == SLIDE:
                M[2, 3] = x
            else:
                c = np.cos(x + r.offset)
                s = np.sin(x + r.offset)
                M[:2, :2] = [[c, -s], [s, c]]
        after.append(X @ r.X @ M)
    out = [(np.eye(4) if row < 0 else after[row]) @ X for row, _, X in table.outputs]
    return np.array(
        [
            np.block([[np.eye(3), T[:3, 3:]], [np.zeros((1, 3)), 1]]) if o[1] else T
            for o, T in zip(table.outputs, out, strict=True)
        ]
    )


def coefficients(function, order=ORDER):
    """Taylor coefficients (order + 1, ...) of an analytic function of one variable at 0 (Lyness,
    Moler, 1967).
    """
    t = RADIUS * np.exp(2j * np.pi * np.arange(POINTS) / POINTS)
    series = np.fft.fft(np.array([function(x) for x in t]), axis=0) / POINTS
    k = np.arange(order + 1).reshape(-1, *(1,) * (series.ndim - 1))
    return (series[: order + 1] / RADIUS**k).real


def ties_of(kinds, numbers, length, relation=()):
    """Packed ties; kinds: (mask, turns) for each."""
    rows = [
        bin(mask).count("1")
        + {NO_TURN: 0, ANGLE: 1, ALIGN: 2, CROSS: 1, FULL: 3, DISTANCE: 1, LINEAR: 1}[turns]
        for mask, turns in kinds
    ]
    ints = [len(kinds)]
    first = 0
    for (mask, turns), n in zip(kinds, rows, strict=True):
        ints += [mask, turns, n, first, len(relation) if turns == LINEAR else 0, 0, -1]
        first += n
    ints += [x for iq, iv, _ in relation for x in (iq, iv)]
    return np.array(ints), np.array([1 / length, *numbers, *[f for *_, f in relation]]), first


def equations(T, kinds, numbers, length, q, v, relation):
    """The equations as they are defined, from poses T of the frames A, B, A, B, ..., complex or
    not.
    """
    out = []
    for k, (mask, turns) in enumerate(kinds):
        if turns == LINEAR:
            out.append(sum(f * (q[iq] + v[iv]) for iq, iv, f in relation) - numbers[k])
            continue
        A = T[2 * k]
        B = T[2 * k + 1]
        d = A[:3, :3].T @ (B[:3, 3] - A[:3, 3])
        R = A[:3, :3].T @ B[:3, :3]
        if turns == DISTANCE:
            out.append((d @ d - numbers[k] ** 2) / (2 * numbers[k] * length))
            continue
        out += [d[i] / length for i in range(3) if mask >> i & 1]
        skew = [(R[2, 1] - R[1, 2]) / 2, (R[0, 2] - R[2, 0]) / 2, (R[1, 0] - R[0, 1]) / 2]
        out += {
            NO_TURN: [],
            FULL: skew,
            ANGLE: skew[2:],
            ALIGN: [-R[1, 2], R[0, 2]],
            CROSS: [R[0, 1]],
        }[turns]
    return np.array(out)


def run(table, ties, numbers, m, q, v, steps=((0, ORDER),)):
    """Series of frames and equations by the kernel, in the given pieces."""
    ints, floats = table.pack()
    n = len(v)
    n_rows = max(len(table.rows), 1)
    depth = v.shape[1]
    poses = np.zeros((n, n_rows, depth, POSE_SIZE))
    extra = np.zeros((n, n_rows, depth, compute_scratch_width(depth - 1)))
    frames = np.zeros((n, len(table.outputs), depth, 12))
    out = np.zeros((n, depth, m))
    for first, last in steps:
        tapes = np.zeros((len(v), 0, depth))
        jet.compute_jets(
            ints, floats, ties, numbers, q, v, first, last, poses, extra, frames, tapes, out
        )
    return frames, out


def random_case(seed, n_rows=7, kinds=(TURN, SLIDE, BALL), particles=False):
    rng = np.random.default_rng(seed)
    held = [(7, FULL), (3, ALIGN), (4, CROSS), (0, DISTANCE), (2, ANGLE), (5, NO_TURN), (0, LINEAR)]
    table = random_table(rng, n_rows, n_out=2 * len(held), kinds=kinds, particles=particles)
    q = table.random_q(rng, 1)
    singles = [(r.iq, r.iv) for r in table.rows if r.kind != BALL][:3]
    relation = [(iq, iv, rng.normal()) for iq, iv in singles]
    numbers = rng.uniform(0.5, 2.0, size=len(held))
    v = 0.4 * rng.normal(size=(1, ORDER + 1, table.nv)) * 0.7 ** np.arange(ORDER + 1)[:, None]
    return table, held, numbers, relation, q, v


def along(v, t):
    return sum(v[k] * t**k for k in range(1, len(v)))


@pytest.mark.parametrize("particles", some([False, True], 2))
@pytest.mark.parametrize("kinds", [(TURN,), (SLIDE, TURN), (BALL,), (TURN, SLIDE, BALL)])
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
def test_series_of_poses_and_equations(seed, kinds, particles):
    table, held, numbers, relation, q, v = random_case(seed, kinds=kinds, particles=particles)
    ties, packed, m = ties_of(held, numbers, 0.7, relation)
    frames, out = run(table, ties, packed, m, q, v)

    def poses(t):
        return complex_poses(table, q[0], along(v[0], t))

    expected = coefficients(lambda t: poses(t)[:, :3])
    got = np.concatenate(
        [frames[0, ..., :9].reshape(-1, ORDER + 1, 3, 3), frames[0, ..., 9:, None]], axis=-1
    )
    scale = np.abs(expected).max(axis=(1, 2, 3)) + 1.0
    assert (np.abs(np.swapaxes(got, 0, 1) - expected).max(axis=(1, 2, 3)) < 1e-8 * scale).all()

    def violation(t):
        return equations(poses(t), held, numbers, 0.7, q[0], along(v[0], t), relation)

    expected = coefficients(violation)
    assert (
        np.abs(out[0] - expected) < 1e-8 * (np.abs(expected).max(axis=1, keepdims=True) + 1.0)
    ).all()
    assert np.abs(out[0, 1:]).max() > 0.1


def test_low_orders_are_exact():
    """A pendulum of length l: p(t) = l (cos t, sin t), whose coefficients are known."""
    rng = np.random.default_rng(0)
    table = random_table(rng, 1, n_out=2, kinds=(TURN,), plain=True)
    table.rows[0].X = np.eye(4)
    table.outputs = [(-1, False, np.eye(4)), (0, False, pose(p=(0.8, 0, 0)))]
    ties, numbers, m = ties_of([(3, NO_TURN)], [0.0], 1.0)
    v = np.zeros((1, ORDER + 1, table.nv))
    v[0, 1, 0] = 1.0
    _, out = run(table, ties, numbers, m, np.zeros((1, table.nq)), v)
    cosine = [0.8, 0, -0.8 / 2, 0, 0.8 / 24, 0, -0.8 / 720, 0, 0.8 / 40320]
    sine = [0, 0.8, 0, -0.8 / 6, 0, 0.8 / 120, 0, -0.8 / 5040, 0]
    assert np.allclose(out[0], np.stack([cosine, sine], axis=1), rtol=1e-15, atol=1e-18)


def test_orders_can_be_computed_one_by_one_with_coefficients_chosen_late():
    table, held, numbers, relation, q, v = random_case(5)
    ties, packed, m = ties_of(held, numbers, 1.3, relation)
    whole = run(table, ties, packed, m, q, v)
    pieces = run(table, ties, packed, m, q, v, [(0, 0), (1, 1), (1, 2), (3, 6), (6, 8)])
    assert all(np.array_equal(a, b) for a, b in zip(whole, pieces, strict=True))
    late = v.copy()
    late[:, 5:] = 7.0
    assert np.array_equal(run(table, ties, packed, m, q, late, [(0, 4)])[1][:, :5], whole[1][:, :5])


def test_several_curves_do_not_disturb_each_other():
    table, held, numbers, relation, q, v = random_case(6)
    ties, packed, m = ties_of(held, numbers, 1.0, relation)
    q3 = np.concatenate([q, q + 0.1, q])
    v3 = np.concatenate([v, 2 * v, -v])
    all_ = run(table, ties, packed, m, q3, v3)[1]
    for i in range(3):
        assert np.array_equal(
            all_[i], run(table, ties, packed, m, q3[i : i + 1], v3[i : i + 1])[1][0]
        )
    signs = (-1.0) ** np.arange(ORDER + 1)
    # v(t) -> -v is not t -> -t: that changes odd orders of v only
    rest = all_[2] - all_[0] * signs[:, None]
    assert np.abs(rest[1:]).max() > 1e-3


@pytest.mark.parametrize("seed", range(4))
def test_values_and_jacobian_are_orders_0_and_1(seed):
    table, held, numbers, relation, q, _ = random_case(seed)
    # a particle has no axes to be in, and no orientation to be held
    for k, (_, turns) in enumerate(held):
        flags = (
            seed % 2 == 1 and turns == DISTANCE,
            seed % 2 == 1 and turns in (DISTANCE, NO_TURN),
        )
        for i, flag in enumerate(flags):
            row, _, X = table.outputs[2 * k + i]
            table.outputs[2 * k + i] = (row, flag, X)
    ties, packed, m = ties_of(held, numbers, 0.7, relation)
    _, _, value, J = projected(table, ties, packed, m, places_of(table), q, q, 0.0, 0)
    v = np.zeros((table.nv, 2, table.nv))
    v[:, 1] = np.eye(table.nv)
    out = run(table, ties, packed, m, np.repeat(q, table.nv, axis=0), v, [(0, 1)])[1]
    assert np.allclose(out[0, 0], value[0], atol=1e-14)
    plain = complex_poses(table, q[0], np.zeros(table.nv)).real
    assert np.allclose(
        value[0],
        equations(plain, held, numbers, 0.7, q[0], np.zeros(table.nv), relation),
        atol=1e-13,
    )
    assert np.allclose(out[:, 1].T, J[0], atol=1e-12)


def places_of(table):
    """Where velocity coordinates sit in q, as `project_configurations` wants it."""
    places = np.full(table.nv, -(10**9), dtype=np.int64)
    for r in table.rows:
        places[r.iv] = -1 - r.iq if r.kind == BALL else r.iq
    places[-1] = table.nq - 1
    return places


def projected(table, ties, numbers, m, places, start, centers, radius, iterations):
    """Points, their residual, distance and iterations, the equations and their Jacobian there."""
    n = len(start)
    out = start.copy()
    info = np.zeros((n, 3))
    value = np.zeros((n, m))
    J = np.zeros((n, m, table.nv))
    projection.project_configurations(
        *table.pack(),
        ties,
        numbers,
        places,
        np.ones(table.nv),
        centers,
        out,
        np.full(n, radius),
        iterations,
        0.2,
        info,
        value,
        J,
    )
    return out, info, value, J


def closed_pair(seed):
    """A table of two arms whose tips are tied, with a configuration where they are."""
    rng = np.random.default_rng(seed)
    table = random_table(rng, 9, n_out=2, plain=True)
    last = [len(table.rows) - 1, len(table.rows) - 2]
    q = table.random_q(rng, 1)
    poses_ = table.row_poses(q[0])[1]
    X = random_pose(rng)
    table.outputs = [
        (last[0], False, X),
        (last[1], False, np.linalg.inv(poses_[last[1]]) @ poses_[last[0]] @ X),
    ]
    ties, numbers, m = ties_of([(7, FULL)], [0.0], 1.0)
    for iq, _ in table.quaternions:
        q[0, iq : iq + 4] /= np.linalg.norm(q[0, iq : iq + 4])
    return table, ties, numbers, m, places_of(table), q, rng


@pytest.mark.parametrize("radius", [0.0, 0.05])
@pytest.mark.parametrize("seed", range(6))
def test_projection_closes_and_keeps_the_distance(seed, radius):
    table, ties, numbers, m, places, q, rng = closed_pair(seed)
    n = 4
    v = rng.normal(size=(n, table.nv)) * 0.02
    start = np.array([table.moved(q[0], x) for x in v])
    out, info, value, J = projected(
        table, ties, numbers, m, places, start, np.repeat(q, n, axis=0), radius, 60
    )
    _, _, again, J_again = projected(table, ties, numbers, m, places, out, out, 0.0, 0)
    assert np.array_equal(value, again) and np.array_equal(J, J_again)
    assert np.abs(value).max() < 1e-12 and info[:, 0].max() < 1e-12
    distance = [apart(table, q[0], x, places) for x in out]
    assert np.allclose(distance, info[:, 1], atol=1e-12)
    if radius:
        assert np.allclose(distance, radius, atol=1e-10)
    else:
        moved = [apart(table, a, b, places) for a, b in zip(start, out, strict=True)]
        assert max(moved) < 0.3  # it goes to what is near


def apart(table, a, b, places):
    """Length of the tangent vector from a to b."""
    from scipy.spatial.transform import Rotation

    total = 0.0
    for p in places:
        if p >= 0:
            total += (b[p] - a[p]) ** 2
        elif p > -(10**9):
            i = -1 - p
            A, B = (Rotation.from_quat(x[[i + 1, i + 2, i + 3, i]]) for x in (a, b))
            total += (A.inv() * B).magnitude() ** 2
    return np.sqrt(total)
