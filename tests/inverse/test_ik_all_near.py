"""`complete` of `ik_all` next to self-motions, for chains with slides whose axes nearly meet, and
for few joints.
"""

from __future__ import annotations

import analytic_oracle as oracle
import arms
import continuation
import numpy as np
import pytest
from hunts import some
from ik_all_checks import assert_found_near_singular

import kempe

PI = np.pi
H = np.pi / 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed", "number"),
    some([("rail_xarm5", 3, 17), ("concurrent234", 3, 22), ("puma_1e-7", 12, 7)], 3),
)
def test_next_to_self_motions_what_is_missed_is_said(name, seed, number):
    """A slide that is nearly free, 17 lengths away; a fold whose roots are 3e-5 apart; an odd
    number, and no fold.
    """
    assert_found_near_singular(arms.arms()[name], seed, number)


@pytest.mark.slow
def test_near_singularities_of_structured_arms(hunt):
    """Arms with right angles, equal lengths, zeros and slides."""
    rng = hunt.rng()
    count = hunt.cases(6)
    for i in range(count):
        arm = continuation.structured_arm(rng, i)
        plan = arm.system.ik_all(arm.model.fk(arm.random(0, 1)), arm.frame).plan
        if plan.method.word != "search" and not plan.locked:
            assert_found_near_singular(arm, int(rng.integers(1 << 30)), 2)


POLAR = {  # rows (a, alpha, d, kind) and a task
    "RRP": ([(0, H, 0.2, "R"), (0, H, 0, "R"), (0.3, 0, 0, "P")], "position"),
    "PRR": ([(0, H, 0, "P"), (0, H, 0.2, "R"), (0.3, 0, 0, "R")], "position"),
    "PPRRR": (
        [(0, H, 0, "P"), (0, H, 0.2, "P"), (0, H, 0, "R"), (0, -H, 0, "R"), (0.1, 0, 0.1, "R")],
        "pose",
    ),
    "RRPRRR": (
        [
            (0, H, 0.2, "R"),
            (0, H, 0, "R"),
            (0, 0, 0, "P"),
            (0, H, 0, "R"),
            (0, -H, 0, "R"),
            (0.1, 0, 0.1, "R"),
        ],
        "pose",
    ),
}


@pytest.mark.parametrize("name", POLAR)
@pytest.mark.parametrize("error", [1e-5, 1e-4, 1e-3])
def test_axes_that_meet_but_for_calibration_are_no_unit_for_slides(name, error):
    """Offsets of hundredths of a millimetre beside slides of a metre."""
    rows, task = POLAR[name]
    e = error * np.random.default_rng(1).standard_normal((len(rows), 4))
    kinds = {"P": "prismatic", "R": "revolute"}
    table = [
        (a + x[0], t + x[1], d + x[2], x[3], kinds[k])
        for (a, t, d, k), x in zip(rows, e, strict=True)
    ]
    arm = arms.table(name, table, "polar", 16)
    q = np.random.default_rng(0).uniform(-2, 2, (60, len(rows)))
    answer = arm.system.ik_all(arm.model.fk(q), arm.frame, task=task)
    theta = arm.model.theta(np.where(answer.mask[..., None], answer.q, 0.0))
    gap = np.where(answer.mask, arm.model.apart(theta, arm.model.theta(q)[:, None]), np.inf).min(
        axis=1
    )
    assert gap.max() < 1e-6
    assert answer.complete.mean() > 0.5


FEW = [
    ("RRRRR", "pose"),
    ("RRRRR", "position_axis"),
    ("RPRRR", "pose"),
    ("PRRRR", "position_axis"),
    ("RRPRR", "position_axis"),
    ("RRRR", "pose"),
    ("RRR", "position"),
    ("RRR", "orientation"),
    ("RPR", "position"),
    ("PRR", "position"),
    ("RRP", "position"),
]


@pytest.mark.parametrize(("kinds", "task"), some(FEW, 4))
def test_structured_arms_of_few_joints(kinds, task, hunt):
    """Judged by what gave the target, and by solutions of targets aside that Newton's method
    follows to it.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(1)):
        error = 10.0 ** rng.uniform(-6, -3) if rng.random() < 1 / 3 else 0.0
        rows = []
        for kind in kinds:
            e = error * rng.standard_normal(4)
            a, t, d = (
                rng.choice(x)
                for x in (continuation.LENGTHS, continuation.TWISTS, continuation.LENGTHS)
            )
            rows.append(
                (a + e[0], t + e[1], d + e[2], e[3], "prismatic" if kind == "P" else "revolute")
            )
        arm = arms.table(kinds, rows, "structured", 16)
        assert not false_of(arm, task, rng, 20), f"{rows}"


WRIST = [(0, H, 0), (0, -H, 0), (0, 0, 0.1)]
SHOULDER = [(0, H, 0.4), (0.3, 0, 0), (0.1, H, 0)]
"""Rows (a, alpha, d) of three axes through a point, and of an axis across two that are parallel."""

STRUCTURES = {  # rows (a, alpha, d), kinds, tasks
    "shoulder": (SHOULDER, "RRR", ["position"]),
    "meeting": ([(0, H, 0), (0.1, 0, 0), (0.35, H, 0)], "RRR", ["position"]),
    "slide first": ([(0, H, 0), (0, H, 0.2), (0.3, 0, 0)], "PRR", ["position"]),
    "slide last": ([(0, H, 0.2), (0, H, 0), (0.3, 0, 0)], "RRP", ["position"]),
    "slide between": ([(0, H, 0), (0.2, H, 0), (0.3, 0, 0.1)], "RPR", ["position"]),
    "cylinder": ([(0, H, 0), (0.35, 0, 0.1), (0, 0, 0)], "RPR", ["position"]),
    "wrist": (WRIST, "RRR", ["orientation", "direction"]),
    "parallel": ([(0.3, 0, 0), (0.2, 0, 0), (0.1, 0, 0)], "RRR", ["pose"]),
    "scara": (
        [(0.3, 0, 0.2), (0.2, PI, 0), (0, 0, 0), (0, 0, 0.1)],
        "RRPR",
        ["pose", "position_axis"],
    ),
    "four": ([*SHOULDER[:2], (0.2, 0, 0), (0.1, H, 0)], "RRRR", ["pose"]),
    "five": (
        [*SHOULDER[:2], (0.2, H, 0), (0, 0, 0.1), (0, H, 0.1)],
        "RRRRR",
        ["pose", "position_axis"],
    ),
    "three parallel": (
        [*SHOULDER[:2], (0.25, 0, 0), (0, H, 0.1), (0, -H, 0.1), (0, 0, 0.1)],
        "RRRRRR",
        ["pose"],
    ),
    "spherical wrist": ([*SHOULDER[:2], (0.1, H, 0), (0, H, 0.3), *WRIST[1:]], "RRRRRR", ["pose"]),
    "orthogonal": (
        [(0, H, 0.3), (0.1, H, 0), (0, -H, 0.2), (0.2, H, 0), (0, -H, 0.1), (0, 0, 0.1)],
        "RRRRRR",
        ["pose"],
    ),
    "Stanford": ([(0, -H, 0.4), (0, H, 0.1), (0, 0, 0), *WRIST], "RRPRRR", ["pose"]),
    "slides": ([(0, H, 0), (0, H, 0), (0, 0, 0), *WRIST], "PPPRRR", ["pose"]),
}


def nearly_structured(name: str, rng: np.random.Generator) -> tuple[arms.Arm, str, list[tuple]]:
    """An arm of which some numbers, or all, are off by 1e-12 to 1e-6, a task, and its rows."""
    table, kinds, tasks = STRUCTURES[name]
    size = 10.0 ** rng.uniform(-12, -6)
    part = rng.choice([0.1, 0.3, 1.0])
    rows: list[tuple] = []
    for row, kind in zip(table, kinds, strict=True):
        off = size * rng.standard_normal(3) * (rng.random(3) < part)
        values = (float(x + e) for x, e in zip(row, off, strict=True))
        rows.append((*values, 0.0, "prismatic" if kind == "P" else "revolute"))
    return arms.table(name, rows, "nearly structured", 16), str(rng.choice(tasks)), rows


@pytest.mark.parametrize("name", some(STRUCTURES, 3))
def test_nearly_structured_arms_lose_no_solution(name, hunt):
    """Arms whose numbers are off by what rounding and calibration leave: equations that are nearly
    apart are solved.
    """
    rng = hunt.rng()
    for _ in range(hunt.cases(6)):
        arm, task, rows = nearly_structured(name, rng)
        assert not false_of(arm, task, rng, 20), f"{task}, {rows}"
        q = rng.uniform(-PI, PI, (50, len(rows))) * np.where(
            arm.model.kinds == oracle.SLIDE, 0.2, 1.0
        )
        assert not false_of(arm, task, rng, q=q), f"{task}, {rows}"


@pytest.mark.slow
@pytest.mark.parametrize("name", STRUCTURES)
def test_nearly_structured_arms_lose_no_solution_often(name, hunt):
    rng = hunt.rng()
    for _ in range(hunt.cases(60)):
        arm, task, rows = nearly_structured(name, rng)
        assert not false_of(arm, task, rng, 20), f"{task}, {rows}"


def test_three_joints_off_by_rounding_of_their_table():
    """A shoulder whose axes meet, and two parallel ones, but for nanometres: one in nine solutions
    was missing.
    """
    for seed in range(2):
        rng = np.random.default_rng(seed)
        rows = STRUCTURES["meeting"][0]
        off = 3e-9 * rng.standard_normal((3, 3))
        table = [
            (*(x + e for x, e in zip(row, o, strict=True)), 0.0)
            for row, o in zip(rows, off, strict=True)
        ]
        arm = arms.table("rounded", table, "nearly structured", 16)
        q = rng.uniform(-PI, PI, (100, 3))
        answer = arm.system.ik_all(arm.model.fk(q), arm.frame, task="position")
        assert answer.complete.all()
        assert not false_of(arm, "position", rng, q=q)


@pytest.mark.parametrize(
    "rows",
    [
        [
            (0.35, 0.7, -5e-8),
            (6e-8, H - 6e-8, 5e-9),
            (0.1, PI - 2.3e-8, 4e-8),
            (-0.2, PI - 5.6e-9, 0.35),
            (0, 0.7, 0.1),
        ],
        [
            (0.5, 0.7, 0.35),
            (0.5, PI + 2.3e-9, 0.0),
            (0.5, PI - 2.1e-9, 0.0),
            (0.5, H, 0.35),
            (0.1, 0.7, -0.2),
        ],
    ],
)
def test_three_axes_that_are_parallel_to_rounding_have_no_point_in_common(rows):
    """The point in which they meet lies anywhere: it was computed from a singular matrix."""
    arm = arms.table("parallel", [(*row, 0.0) for row in rows], "nearly structured", 16)
    rng = np.random.default_rng(0)
    assert not false_of(arm, "position_axis", rng, q=rng.uniform(-PI, PI, (20, 5)))


def false_of(
    arm: arms.Arm, task: str, rng: np.random.Generator, count: int = 0, q=None
) -> list[tuple]:
    """Regular solutions that answers said to be complete have not: (q that gave the target,
    solution).
    """
    m = arm.model
    if q is None:
        shape = (count, arm.system.nq)
        q = 0.25 * PI * rng.integers(-4, 5, shape) + np.where(
            rng.random(shape) < 0.4, rng.uniform(-1, 1, shape), 0.0
        )
    shape = q.shape
    X = m.fk(q)
    answer = arm.system.ik_all(X, arm.frame, task=task)
    if answer.plan.locked or answer.plan.method.word == "search":
        return []
    scale = np.where(m.kinds == oracle.SLIDE, m.size, 1.0)
    near = arm.system.ik_all(m.fk(q + 1e-4 * rng.standard_normal(shape)), arm.frame, task=task)
    at = np.append(np.arange(len(q)), np.nonzero(near.mask)[0])
    starts = np.concatenate([m.theta(q), m.theta(near.q[near.mask])])
    known = answer.complete[at]
    at = at[known]
    starts = starts[known]
    theta, done = oracle.newton(m, X[at], starts, task)
    regular = done & (m.condition(theta, task) >= 1e-4) if len(at) else done
    false = []
    for i, solution in zip(at[regular], theta[regular], strict=True):
        off = np.abs(m.wrapped(m.theta(answer.q[i][answer.mask[i]]) - solution) / scale).max(
            axis=-1
        )
        if off.min(initial=np.inf) > 1e-5:
            false.append((q[i].tolist(), solution.tolist()))
    return false


def lined_up(rng, kinds, size):
    """A chain of joints (`R` turns, `P` slides) along the axes of the ground; lengths are zero or a
    part of `size`.
    """
    m = kempe.Mechanism("lined up")
    below = m.ground
    axes = np.eye(3)
    for i, kind in enumerate(kinds):
        body = m.body(f"b{i}")
        at = size * rng.choice([0.0, 0.0, 0.5, 1.0], 3)
        add = m.revolute if kind == "R" else m.prismatic
        add(f"j{i}", below, body, at=at, axis=axes[rng.integers(3)] * rng.choice([-1.0, 1.0]))
        below = body
    m.frame("tip", below, at=size * rng.choice([0.0, 0.3, 0.8], 3))
    return m.build()


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_slide_along_the_axis_of_a_turn_loses_no_solution(hunt, size):
    """The target's orientation is any, not that of the chain: plans must not rest on what holds for
    the latter only.
    """
    rng = hunt.rng()
    regular = 0
    for i in range(hunt.cases(60)):
        kinds = ("RP", "PR", "RRP", "RPR", "PRP", "RPP")[i % 6]
        arm = lined_up(rng, kinds, size)
        turns = np.array([k == "R" for k in kinds])
        unit = np.where(turns, 1.0, size)
        q = rng.uniform(-2.0, 2.0, (8, len(kinds))) * unit
        scaled = arm.jacobian(q, "tip")[:, :3] * unit / size
        X = arm.fk(q, "tip")[:, :3, 3]
        for k in np.flatnonzero(np.linalg.svd(scaled, compute_uv=False)[:, -1] > 1e-2):
            answer = arm.ik_all(X[k], "tip")
            off = (answer.q - q[k]) / unit
            off[:, turns] = np.angle(np.exp(1j * off[:, turns]))
            assert answer.complete <= bool((np.abs(off).max(axis=1) < 1e-6).any()), (
                kinds,
                answer.status,
            )
            regular += 1
    assert regular > 0
