"""Packed layers of kernels against dense or brute-force ones: the envelope, the active set, merged
rows, their order.

Helpers run as Python, with memory that is checked (`plain_kernels`), so that what a compiler makes
of them is not the judge, and each is looked at alone.
"""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hunts import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_kernels import Pointer, plain, pointer, room

import kempe
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.constraints import loop_layout as L
from kempe.model.packed_loops import find_explicit_joints, get_packed_loops

SEEDS = st.integers(0, 2**32 - 1)
TIED = ["four_bar", "stewart", "delta_ss", "row_of_four_bars", "bennett"]
SOLVER = {"max_examples": examples(60), "deadline": None}


# ---- the envelope of J J^T


class Packed(NamedTuple):
    """Packed loops of which the blocks are random: what kernels read, and the same Jacobian (m, nv)
    as a matrix.
    """

    loops: Any
    J: np.ndarray
    size: int


def packed(
    plan: np.ndarray, nv: int, rng: np.random.Generator, q: Any = None, weights: Any = None
) -> Packed:
    """Loops of a plan with random blocks; the dense Jacobian is read off the uses of each velocity."""
    blocks = rng.normal(size=int(plan[L.BLOCKS]))
    J = np.zeros((int(plan[L.N_ROWS]), nv))
    for v in range(nv):
        first, last = plan[plan[L.AT_VARS] + v : plan[L.AT_VARS] + v + 2]
        for use in range(first, last):
            tie, column = plan[plan[L.AT_USES] + L.USE_INTS * use :][: L.USE_INTS]
            at = plan[L.AT_TIES] + L.TIE_INTS * tie
            rows = plan[at + L.ROWS]
            row = plan[at + L.FIRST_ROW]
            block = plan[at + L.BLOCK]
            J[row : row + rows, v] += blocks[block + rows * column : block + rows * (column + 1)]
    loops = SimpleNamespace(
        plan=Pointer(plan),
        blocks=Pointer(blocks),
        nv=nv,
        q=q,
        weights=weights,
        error=room(len(J)),
        nq=nv,
    )
    return Packed(loops, J, int(plan[L.ENVELOPE]))


def random_plan(rng: np.random.Generator, ties: int, nv: int) -> np.ndarray:
    """A plan of ties with up to three rows each, over random velocities; its envelope begins where
    rows share one.
    """
    rows = rng.integers(1, 4, ties)
    of = [np.flatnonzero(rng.random(nv) < 0.5) for _ in range(ties)]
    first = np.cumsum([0, *rows])
    block = np.cumsum([0, *(r * len(v) for r, v in zip(rows, of, strict=True))])
    table = np.zeros((ties, L.TIE_INTS), dtype=np.int64)
    table[:, L.ROWS], table[:, L.FIRST_ROW], table[:, L.BLOCK] = rows, first[:-1], block[:-1]
    uses = [
        [(k, int(np.flatnonzero(of[k] == v)[0])) for k in range(ties) if v in of[k]]
        for v in range(nv)
    ]
    begins = []
    envelope = []
    for k in range(ties):
        before = [j for j in range(k + 1) if set(of[j]) & set(of[k])]
        for i in range(first[k], first[k + 1]):
            begins.append(int(min([first[j] for j in before] + [i])))
            envelope.append(i + 1 - begins[-1])
    starts = np.cumsum([0, *envelope])
    parts = {
        L.AT_TIES: table.ravel(),
        L.AT_VARS: np.cumsum([0, *map(len, uses)]),
        L.AT_USES: np.array([x for u in uses for pair in u for x in pair]),
        L.AT_ROWS: np.array([x for pair in zip(begins, starts, strict=False) for x in pair]),
        L.AT_PLACES: np.array([x for v in range(nv) for x in (v, L.SLIDE, 0)]),
    }
    plan = np.zeros(L.HEAD, dtype=np.int64)
    plan[[L.N_TIES, L.N_ROWS, L.BLOCKS, L.ENVELOPE]] = ties, first[-1], block[-1], starts[-1]
    for place, part in parts.items():
        plan[place] = len(plan)
        plan = np.concatenate([plan, part.astype(np.int64)])
    return plan


def plan_of(name: str) -> tuple[np.ndarray, int]:
    """The plan of a shipped system, and its number of velocities."""
    system = kempe.load(name)
    return get_packed_loops(system, find_explicit_joints(system)).plan, system.nv


def within(a: np.ndarray, plan: np.ndarray) -> np.ndarray:
    """The lower triangle (m, m) that an envelope holds, zero outside of it."""
    m = int(plan[L.N_ROWS])
    out = np.zeros((m, m))
    for i in range(m):
        first, at = plan[plan[L.AT_ROWS] + L.ENVELOPE_INTS * i :][: L.ENVELOPE_INTS]
        out[i, first : i + 1] = a[at : at + i + 1 - first]
    return out


def check_envelope(plan: np.ndarray, nv: int, rng: np.random.Generator) -> None:
    """Products, J J^T, its factors and solutions against dense ones, some columns left out."""
    kernel = plain("envelope")
    p = packed(plan, nv, rng)
    m = len(p.J)
    y = rng.normal(size=m)
    x = float(rng.normal())
    v = int(rng.integers(nv))
    assert kernel.multiply_column(p.loops, v, Pointer(y)) == pytest.approx(p.J[:, v] @ y, abs=1e-10)
    to = pointer(y)
    kernel.add_product(p.loops, v, x, to, 1)
    assert np.allclose(to.array, y + x * p.J[:, v], atol=1e-10)
    out = rng.random(nv) < 0.3
    damping = 10.0 ** rng.uniform(-3, 0)
    a = room(p.size)
    column = room(m)
    step = pointer(np.where(out, np.nan, 0.0))
    kernel.write_normal_matrix(p.loops, step, damping, a, column)
    used = np.where(out, 0.0, p.J)
    whole = used @ used.T + damping * np.eye(m)
    assert np.allclose(within(a.array, plan), np.tril(whole), atol=1e-10), (
        "or the envelope does not hold it"
    )
    kernel.factor_envelope(p.loops, a, 1e-14)
    lower = within(a.array, plan)
    D = np.diag(lower).copy()
    lower = np.tril(lower, -1) + np.eye(m)
    assert np.allclose(lower * D @ lower.T, whole, atol=1e-8) and np.all(D > 0.0)
    solved = pointer(y)
    kernel.solve_envelope(p.loops, a, solved)
    assert np.allclose(
        whole @ solved.array,
        y,
        atol=1e-8 * (1.0 + np.abs(solved.array).max() * np.abs(whole).max()),
    )


@settings(**SOLVER)
@given(seed=SEEDS, ties=st.integers(1, 6), nv=st.integers(1, 8))
def test_the_envelope_is_the_dense_matrix(seed, ties, nv):
    rng = np.random.default_rng(seed)
    check_envelope(random_plan(rng, ties, nv), nv, rng)


@pytest.mark.parametrize("name", TIED)
def test_the_envelope_of_shipped_systems_holds_all_that_is_not_zero(name):
    plan, nv = plan_of(name)
    check_envelope(plan, nv, np.random.default_rng(0))


def test_a_pivot_that_is_rounding_becomes_the_least():
    """Two equal rows: without damping the second pivot is zero, and the second multiplier is left
    to the least.
    """
    rng = np.random.default_rng(1)
    plan = random_plan(rng, 1, 3)
    while plan[L.N_ROWS] != 2:
        plan = random_plan(rng, 1, 3)
    p = packed(plan, 3, rng)
    p.loops.blocks.array[1::2] = p.loops.blocks.array[::2]
    a = room(p.size)
    plain("envelope").write_normal_matrix(p.loops, pointer(np.zeros(3)), 0.0, a, room(2))
    plain("envelope").factor_envelope(p.loops, a, 1e-14)
    assert within(a.array, plan)[1, 1] == 1e-14


# ---- the active set


def exhaustive(
    J: np.ndarray,
    e: np.ndarray,
    weak: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    wish: np.ndarray,
    ends: np.ndarray,
) -> np.ndarray:
    """The step d (nv,) by trying all sets: each coordinate free or at an end, each row between
    bounds at one or not.

    It minimises |d - wish|^2 / 2 + sum (miss of e + J d from [low, high])^2 / (2 weak), ends[0] <=
    d <= ends[1].
    """
    best = np.zeros(len(wish))
    least = math.inf
    between = np.flatnonzero(low < high)
    for stops in itertools.product((None, 0, 1), repeat=len(wish)):
        fixed = np.array([i for i, s in enumerate(stops) if s is not None], dtype=int)
        free = np.array([i for i, s in enumerate(stops) if s is None], dtype=int)
        d = np.array([0.0 if s is None else ends[s, i] for i, s in enumerate(stops)])
        for sides in itertools.product((None, low, high), repeat=len(between)):
            counting = [
                i
                for i in range(len(e))
                if i not in between or sides[list(between).index(i)] is not None
            ]
            to = low.copy()
            for i, side in zip(between, sides, strict=True):
                to[i] = low[i] if side is None else side[i]
            S = J[counting] / np.sqrt(weak[counting])[:, None]
            r = (to - e - J[:, fixed] @ d[fixed])[counting] / np.sqrt(weak[counting])
            M = np.concatenate([S[:, free], np.eye(len(free))])
            d[free] = np.linalg.lstsq(M, np.concatenate([r, wish[free]]), rcond=None)[0]
            if np.all(d >= ends[0] - 1e-12) and np.all(d <= ends[1] + 1e-12):
                x = e + J @ d
                miss = np.maximum(low - x, 0.0) + np.maximum(x - high, 0.0)
                value = 0.5 * ((d - wish) ** 2).sum() + 0.5 * (miss**2 / weak).sum()
                if value < least:
                    best = d.copy()
                    least = value
    return best


@settings(max_examples=examples(40), deadline=None)
@given(seed=SEEDS, ties=st.integers(1, 2), nv=st.integers(1, 4))
def test_the_active_set_is_the_best_of_all_sets(seed, ties, nv):
    """One quadratic programme: slides between limits, rows that are lowered, some of them between
    bounds.
    """
    rng = np.random.default_rng(seed)
    kernel = plain("task_search")
    p = packed(random_plan(rng, ties, nv), nv, rng)
    m = len(p.J)
    q = rng.normal(size=nv)
    ends = np.array([-rng.uniform(0.05, 1.0, nv), rng.uniform(0.05, 1.0, nv)])
    weights = np.zeros(L.SCALES + 5 * nv)
    L.view_velocity_lists(weights, nv)[:3] = np.ones(nv), q + ends[0], q + ends[1]
    p.loops.q = pointer(q)
    p.loops.weights = pointer(weights)
    value = rng.normal(size=m)
    weak = 10.0 ** rng.uniform(-2, 0, m)
    wish = 0.3 * rng.normal(size=nv)
    low = np.where(rng.random(m) < 0.5, 0.0, -rng.uniform(0.1, 0.5, m))
    high = np.where(low < 0.0, rng.uniform(0.1, 0.5, m), 0.0)
    outside = value - np.clip(value, low, high)
    counts = (low == high) | (outside != 0.0)
    work = SimpleNamespace(
        step=room(nv),
        stop=room(nv),
        wish=pointer(wish),
        mark=room(nv),
        way=room(nv),
        value=pointer(value),
        low=pointer(low),
        high=pointer(high),
        weak=pointer(weak),
        damp=pointer(np.where(counts, weak, kernel.OFF)),
        y=room(m),
        ahead=room(m),
        column=room(m),
        a=room(p.size),
    )
    p.loops.error.array[:] = outside
    kernel.free_coordinates(p.loops, work)
    kernel.write_step(p.loops, work, 4 * (nv + m) + 8, True, True)
    best = exhaustive(p.J, value, weak, low, high, wish, ends)
    assert np.allclose(work.step.array, best, atol=1e-6)


# ---- solutions that are one, and their order


def found_rows(merging: Any, thetas: np.ndarray, rng: np.random.Generator) -> Any:
    """Solutions as the kernel keeps them, each regular or not, and once a root or more."""
    n = thetas.shape[1]
    rows = np.zeros((merging.MOST_SOLUTIONS + 1, merging.SOLUTION + n))
    rows[: len(thetas), merging.SOLUTION :] = thetas
    rows[: len(thetas), merging.TURNS] = rng.integers(1, 4, len(thetas))
    rows[: len(thetas), merging.WEAKEST] = np.where(rng.random(len(thetas)) < 0.8, 0.0, 1.0)
    kinds = pointer((rng.random(n) < 0.3).astype(np.int64), np.int64)
    model = SimpleNamespace(n=n, kinds=kinds)
    return SimpleNamespace(model=model, rows=pointer(rows.ravel()), linear=1e-9, angular=1e-9), rows


def apart(a: np.ndarray, b: np.ndarray, slides: np.ndarray) -> float:
    """The largest difference of two solutions, of turns the shorter way round, by complex numbers."""
    turned = np.abs(np.angle(np.exp(1j * (a - b))))
    return float(np.where(slides, np.abs(a - b), turned).max())


@settings(**SOLVER)
@given(seed=SEEDS, count=st.integers(1, 12), n=st.integers(1, 6))
def test_united_rows_are_those_of_comparing_all_pairs(seed, count, n):
    """Solutions a whole turn apart or nearer than `SAME` are one; roots are counted together, none
    is lost.
    """
    rng = np.random.default_rng(seed)
    merging = plain("merging")
    true = rng.uniform(-3.0, 3.0, (max(1, count // 2), n))
    thetas = true[rng.integers(0, len(true), count)] + rng.choice(
        [0.0, 0.2 * merging.SAME], (count, 1)
    )
    found, rows = found_rows(merging, thetas, rng)
    slides = found.model.kinds.array == 1
    thetas += np.where(slides, 0.0, 2.0 * np.pi * rng.integers(-1, 2, thetas.shape))
    rows[:count, merging.SOLUTION :] = thetas
    found.rows.array[:] = rows.ravel()
    left = merging.unite_solutions(found, count)
    after = found.rows.array.reshape(rows.shape)[:left]
    weak = rows[:count, merging.WEAKEST] < merging.MERGED
    assert after[:, merging.TURNS].sum() == rows[:count, merging.TURNS].sum()
    for k in range(count):
        assert (
            min(apart(thetas[k], x, slides) for x in after[:, merging.SOLUTION :]) <= merging.SAME
        )
    if weak.all():
        places = [
            next(j for j in range(count) if apart(x, thetas[j], slides) <= merging.SAME)
            for x in thetas
        ]
        assert left == len(set(places))
    else:
        assert left >= (~weak).sum()


@settings(**SOLVER)
@given(seed=SEEDS, slides=st.booleans())
def test_a_coordinate_is_the_turn_inside_the_limits_that_is_nearest(seed, slides):
    """Against trying all turns: inside if one is, of those the nearest to `near`, else the nearest
    of all.
    """
    rng = np.random.default_rng(seed)
    merging = plain("merging")
    numbers = np.zeros(A.JOINT_FLOATS)
    low = rng.uniform(-8.0, 4.0)
    factor = float(rng.choice([1.0, -1.0, 0.5, 2.0]))
    offset = float(rng.normal())
    numbers[[A.FACTOR, A.OFFSET, A.LOW, A.HIGH]] = factor, offset, low, low + rng.uniform(0.5, 9.0)
    theta = rng.uniform(-np.pi, np.pi)
    near = float(rng.uniform(-9.0, 9.0))
    q, inside = merging.choose_coordinate(slides, theta, Pointer(numbers), near, merging.EDGE)
    every = (theta - offset + 2.0 * np.pi * (np.zeros(1) if slides else np.arange(-9, 10))) / factor
    fitting = every[(every >= numbers[A.LOW]) & (every <= numbers[A.HIGH])]
    assert inside == bool(len(fitting))
    among = fitting if inside else every
    assert (
        abs(q - near) == pytest.approx(np.abs(among - near).min(), abs=1e-9)
        and np.abs(among - q).min() < 1e-9
    )


@settings(**SOLVER)
@given(seed=SEEDS, slots=st.integers(1, 12), n=st.integers(1, 4))
def test_rows_are_arranged_as_sorting_them_does(seed, slots, n):
    """Those in use first: inside the limits, then by their distance from `near`."""
    rng = np.random.default_rng(seed)
    merging = plain("merging")
    out = rng.normal(size=(slots, n + A.INFO))
    near = rng.normal(size=n)
    out[:, n + A.CODE] = rng.integers(-1, 4, slots)
    joints = np.ones((n, A.JOINT_FLOATS))
    joints[:, A.FACTOR] = rng.choice([1.0, 2.0], n)
    used = out[out[:, n + A.CODE] >= 0.0]
    far = ((joints[:, A.FACTOR] * (used[:, :n] - near)) ** 2).sum(axis=1)
    wanted = used[np.lexsort([far, used[:, n + A.CODE] % 2 == 0])]
    to = pointer(out.ravel())
    assert merging.sort_rows(n, Pointer(joints.ravel()), Pointer(near), to, slots) == len(used)
    assert np.array_equal(to.array.reshape(out.shape)[: len(used)], wanted)


# ---- the stand-ins themselves


def test_memory_is_checked():
    block = pointer([1.0, 2.0])
    further = plain("scratch").advance_pointer(block, 1)
    assert further[0] == 2.0 and further[-1] == 1.0
    with pytest.raises(IndexError, match="entry 2 of 2"):
        further[1] = 0.0
    with pytest.raises(IndexError, match="entry -1 of 2"):
        block[-1]
