"""Sweeps of redundant chains: independent closed forms on dense grids, ends of intervals, gauge,
singular arms.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hunts import some
from linkages import planar_arm

import kempe
from kempe import spatial
from kempe.description.dh import from_dh
from kempe.errors import InputError, UnknownNameError, UnsupportedError
from kempe.inverse.arm_angle import compute_arm_angle, compute_rotations, solve_three_turns
from kempe.inverse.sweep import ik_sweep
from kempe.numerics.intervals import join_arcs, split_circle, unite_intervals

H = math.pi / 2
PI = math.pi
LIMITS = np.radians([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0])
ALPHA = (-H, H, H, -H, -H, H, 0.0)
D = (0.36, 0.0, 0.42, 0.0, 0.4, 0.0, 0.126)
"""KUKA LBR iiwa 14 R820, standard Denavit-Hartenberg parameters (Faria and others, 2018)."""


def iiwa(base=None, tool=None, limits=LIMITS) -> kempe.System:
    rows = [
        {"alpha": a, "d": d, "limits": (-x, x)} for a, d, x in zip(ALPHA, D, limits, strict=True)
    ]
    return from_dh(rows, "standard", "iiwa", base, tool).build()


def iiwa_at(T, psi: float) -> np.ndarray:
    """All configurations (8, 7) of the iiwa with its flange at T and its elbow turned by psi from
    straight above SW.

    The elbow is placed on its circle; then each joint follows from the directions of the two links.
    """
    S = np.array([0.0, 0.0, D[0]])
    W = T[:3, 3] - D[6] * T[:3, 2]
    length = np.linalg.norm(W - S)
    v = (W - S) / length
    r = np.array([0.0, 0.0, 1.0]) - v[2] * v
    r /= np.linalg.norm(r)
    cosine = (D[2] ** 2 + length**2 - D[4] ** 2) / (2 * D[2] * length)
    if abs(cosine) > 1:
        return np.zeros((0, 7))
    side = math.cos(psi) * r + math.sin(psi) * np.cross(v, r)
    E = S + D[2] * (cosine * v + math.sqrt(1 - cosine**2) * side)
    upper = (E - S) / D[2]
    lower = (W - E) / D[4]
    out = []
    for a in (1, -1):
        q2 = a * math.acos(np.clip(upper[2], -1, 1))
        q1 = math.atan2(a * upper[1], a * upper[0])
        A = spatial.rot_z(q1)[:3, :3] @ spatial.rot_y(q2)[:3, :3]
        x, y, z = A.T @ lower
        for b in (1, -1):
            q4 = b * math.acos(np.clip(z, -1, 1))
            q3 = math.atan2(-b * y, -b * x)
            B = A @ spatial.rot_z(q3)[:3, :3] @ spatial.rot_y(-q4)[:3, :3]
            R = B.T @ T[:3, :3]
            for c in (1, -1):
                q6 = c * math.acos(np.clip(R[2, 2], -1, 1))
                q5 = math.atan2(c * R[1, 2], c * R[0, 2])
                q7 = math.atan2(c * R[2, 1], -c * R[2, 0])
                out.append([q1, q2, q3, q4, q5, q6, q7])
    return np.array(out)


def wrapped(x):
    return (np.asarray(x) + PI) % (2 * PI) - PI


def apart(a, b) -> float:
    """The largest distance from any configuration of one set to the nearest of the other, both
    ways.
    """
    d = np.abs(wrapped(np.asarray(a)[:, None] - np.asarray(b)[None])).max(axis=-1)
    return max(d.min(axis=0).max(), d.min(axis=1).max())


def lies_in(intervals, x: float, period: float = math.inf) -> bool:
    laps = (0.0,) if period == math.inf else (-period, 0.0, period)
    return any(low <= x + k <= high for low, high in intervals for k in laps)


def deviation(system, frame, q, target) -> float:
    X = system.fk(q, frame)
    target = np.asarray(target)
    if target.shape == X.shape[-2:]:
        return float(np.abs(X - target).max())
    return float(np.abs(X[..., : len(target), 3] - target).max())


# ---- the arm angle


def test_the_test_model_is_the_iiwa():
    system = iiwa()
    rng = np.random.default_rng(1)
    for q in system.random(rng, 20):
        T = system.fk(q, "tool")
        some = iiwa_at(T, compute_arm_angle(system, q, "tool"))
        assert apart([q], some[[np.abs(wrapped(some - q)).max(axis=1).argmin()]]) < 1e-9
        assert deviation(system, "tool", some, T) < 1e-12


@pytest.mark.parametrize("seed", some(range(6), 3))
def test_arm_angle_against_the_elbow_on_its_circle(seed):
    """Intervals, counts and configurations against a closed form in plain numpy."""
    system = iiwa()
    q = system.random(np.random.default_rng(seed))
    T = system.fk(q, "tool")
    sweep = ik_sweep(system, T, "tool", n=181)
    assert sweep.exact and sweep.parameter == "arm_angle" and sweep and sweep.q.shape == (181, 8, 7)
    assert deviation(system, "tool", sweep.q[sweep.mask], T) < 1e-9
    grid = np.linspace(-PI, PI, 721)[1:-1]
    marks = np.array([x for rows in sweep.intervals for interval in rows for x in interval])
    grid = grid[np.abs(wrapped(marks[:, None] - grid)).min(axis=0) >= 1e-9]
    assert len(grid) > 700
    for psi in grid:
        good = (np.abs(iiwa_at(T, psi)) <= LIMITS).all(axis=1)
        assert good.sum() == sum(lies_in(rows, psi, 2 * PI) for rows in sweep.intervals), psi
        assert good.any() == lies_in(sweep.feasible, psi, 2 * PI), psi
    for i in range(0, 181, 20):
        assert apart(sweep.q[i], iiwa_at(T, sweep.values[i])) < 1e-7
    at = sweep.at(compute_arm_angle(system, q, "tool"))
    assert np.abs(at.q - q).max(axis=1).min() < 1e-8 and at.residual.max() < 1e-9
    assert np.all(np.diff(at.inside.astype(int)) <= 0)
    assert np.allclose(compute_arm_angle(system, at.q, "tool"), at.value, atol=1e-8)


@pytest.mark.parametrize("seed", range(10, 16))
def test_ends_of_intervals(seed):
    """A hair inside an end a solution respects the limits, a hair outside one less does, by the
    other closed form.
    """
    system = iiwa()
    T = system.fk(system.random(np.random.default_rng(seed)), "tool")
    sweep = ik_sweep(system, T, "tool")
    ends = 0
    for low, high in (i for rows in sweep.intervals for i in rows):
        if high - low > 2 * PI - 1e-9:
            continue
        for end, out in ((low, -1.0), (high, 1.0)):
            within, beyond = (
                (np.abs(iiwa_at(T, end + s * 1e-8)) <= LIMITS).all(axis=1).sum()
                for s in (-out, out)
            )
            shared = sum(
                abs(wrapped(x - end)) < 1e-9 for rows in sweep.intervals for i in rows for x in i
            )
            assert within > 0 and (within > beyond or shared > 1), end
            ends += 1
    assert ends > 0


def test_rows_are_branches_without_jumps():
    system = iiwa()
    T = system.fk(system.random(np.random.default_rng(3)), "tool")
    sweep = ik_sweep(system, T, "tool", n=4001)
    both = sweep.inside[1:] & sweep.inside[:-1]
    steps = np.abs(np.diff(sweep.q, axis=0)).max(axis=-1)
    assert both.any() and steps[both].max() < 0.2
    sides = np.broadcast_to([1] * 4 + [-1] * 4, sweep.mask.shape)
    assert np.array_equal(np.sign(sweep.q[:, :, 3][sweep.mask]), sides[sweep.mask])


def test_base_and_tool_change_nothing():
    plain = iiwa()
    rng = np.random.default_rng(8)
    base = spatial.pose_from_xyz_rpy(rng.uniform(-1, 1, 6))
    tool = spatial.pose_from_xyz_rpy(rng.uniform(-1, 1, 6))
    moved = iiwa(base, tool)
    for q in plain.random(rng, 4):
        a = ik_sweep(plain, plain.fk(q, "tool"), "tool", n=50)
        b = ik_sweep(moved, moved.fk(q, "tool"), "tool", n=50)
        assert compute_arm_angle(plain, q, "tool") == pytest.approx(
            compute_arm_angle(moved, q, "tool"), abs=1e-9
        )
        assert np.abs(wrapped(a.q - b.q)).max() < 1e-8
        for rows, others in zip(a.intervals, b.intervals, strict=True):
            assert np.allclose(rows, others, atol=1e-8)


def odd_arm(seed: int) -> kempe.System:
    """Axes of shoulder and wrist at odd angles, an elbow axis out of the plane of both and offset,
    odd limits.
    """
    rng = np.random.default_rng([seed, 4])
    m = kempe.Mechanism("odd")
    last = m.ground
    for i in range(7):
        at = rng.uniform(-0.3, 0.3, 3) if i in (0, 3, 4) else (0.0, 0.0, 0.0)
        body = m.body(f"b{i + 1}")
        low = rng.uniform(-3.0, -1.0)
        limits = None if i == 2 else (low, low + rng.uniform(2.0, 8.0))
        m.revolute(f"j{i + 1}", last, body, at=at, rpy=rng.uniform(-PI, PI, 3), limits=limits)
        last = body
    m.frame("tool", last, at=(0.1, 0.05, 0.2), rpy=(0.3, -0.4, 1.0))
    return m.build()


@pytest.mark.parametrize("seed", some(range(6), 3))
def test_odd_angles_and_offsets(seed):
    """Shoulders and wrists that cannot point everywhere, offset elbows, limits wider than a turn."""
    system = odd_arm(seed)
    q = system.random(np.random.default_rng(seed))
    T = system.fk(q, "tool")
    sweep = ik_sweep(system, T, "tool", start=q, n=1001)
    assert deviation(system, "tool", sweep.q[sweep.mask], T) < 1e-9
    psi = compute_arm_angle(system, q, "tool")
    at = sweep.at(psi)
    assert np.abs(wrapped(at.q - q)).max(axis=1).min() < 1e-7 and lies_in(
        sweep.feasible, psi, 2 * PI
    )
    low = system.lower
    high = system.upper
    for k in range(8):
        found = sweep.q[sweep.mask[:, k], k]
        spans = sweep.spans[k]
        rows = sweep.intervals[k]
        fits = ((found >= low - 1e-9) & (found <= high + 1e-9)).all(axis=1)
        marks = np.array([x for i in (*rows, *spans) for x in i if abs(x) != PI])
        for x, there in zip(sweep.values, sweep.mask[:, k], strict=True):
            if not marks.size or np.abs(wrapped(marks - x)).min() > 1e-6:
                assert there == lies_in(spans, x, 2 * PI), (k, x)
        for x, good in zip(sweep.values[sweep.mask[:, k]], fits, strict=True):
            if not marks.size or np.abs(wrapped(marks - x)).min() > 1e-6:
                assert good == lies_in(rows, x, 2 * PI), (k, x)


@pytest.mark.parametrize("seed", some(range(3), 3))
def test_the_arm_angle_and_the_joint_agree(seed):
    """The same chain over its third joint: every solution inside the limits has an arm angle inside
    the intervals.
    """
    system = iiwa()
    T = system.fk(system.random(np.random.default_rng(100 + seed)), "tool")
    arm = ik_sweep(system, T, "tool")
    joint = ik_sweep(system, T, "tool", "q3", n=101)
    q = joint.q[joint.inside]
    assert len(q) > 10 and deviation(system, "tool", joint.q[joint.mask], T) < 1e-9
    for x in compute_arm_angle(system, q, "tool"):
        assert lies_in([(a - 1e-7, b + 1e-7) for a, b in arm.feasible], x, 2 * PI)
    wide = [(k, a, b) for k, rows in enumerate(arm.intervals) for a, b in rows]
    third = np.concatenate([arm.at(np.linspace(a, b, 50)[1:-1]).q[:, k, 2] for k, a, b in wide])
    assert all(lies_in([(a - 1e-7, b + 1e-7) for a, b in joint.feasible], x) for x in third)


def test_stretched_arm_and_wrist_above_the_shoulder():
    system = iiwa()
    for q in (
        [0.3, 0.7, 0.2, 0.0, -0.4, 0.9, 0.1],
        [0.3, 0.0, 0.2, 0.0, -0.4, 0.9, 0.1],
        [0.3, -0.6, 0.0, 1.1794021664297616, 0.0, 0.5, 0.1],
        [0.4, 0.0, 0.7, 0.0, 0.2, 0.0, 0.1],
    ):
        T = system.fk(q, "tool")
        psi = compute_arm_angle(system, q, "tool")
        at = ik_sweep(system, T, "tool").at([psi, 0.4, -2.5])
        assert at.mask.any(axis=1).all() and deviation(system, "tool", at.q[at.mask], T) < 1e-9
        for row, mask, value in zip(at.q, at.mask, at.value, strict=True):
            assert (
                np.abs(wrapped(compute_arm_angle(system, row[mask], "tool") - value)).max() < 1e-5
            )
    stretched = system.fk([0.3, 0.7, 0.2, 0.0, -0.4, 0.9, 0.1], "tool")
    # both ways to bend the elbow have merged
    assert len(ik_sweep(system, stretched, "tool").at(0.5)) == 4


def test_the_arm_angle_of_a_stretched_arm_is_a_limit():
    """By definition that of the arm that bends to the side "+", here q4 > 0; the other side is half
    a turn away.
    """
    system = iiwa()
    for q in system.random(np.random.default_rng(6), 5):
        a, b, c = (
            compute_arm_angle(system, [*q[:3], x, *q[4:]], "tool") for x in (0.0, 1e-7, -1e-7)
        )
        assert abs(wrapped(a - b)) < 1e-5 and abs(abs(wrapped(a - c)) - PI) < 1e-5


def test_rows_without_limits_turn_on():
    """Joints without limits pass half a turn without a jump."""
    system = iiwa(limits=np.full(7, math.inf))
    T = system.fk([0.2, 1.2, 0.4, 1.4, 0.3, 1.0, 3.0], "tool")
    sweep = ik_sweep(system, T, "tool", n=2001)
    steps = np.abs(np.diff(sweep.q, axis=0)).max()
    assert sweep.inside.all() and steps < 0.2 and np.abs(sweep.q).max() > PI + 0.1


def test_another_reference():
    system = iiwa()
    q = system.random(5)
    T = system.fk(q, "tool")
    a, b = (ik_sweep(system, T, "tool", ("arm_angle", z)) for z in (None, (1.0, 0.2, 0.0)))
    x, y = (compute_arm_angle(system, q, "tool", reference=z) for z in (None, (1.0, 0.2, 0.0)))
    assert apart(a.at(x).q, b.at(y).q) < 1e-9 and abs(x - y) > 1e-3
    shift = wrapped(y - x)
    for rows, others in zip(a.intervals, b.intervals, strict=True):
        lows = [[wrapped(low + s) for low, _ in i] for i, s in ((rows, shift), (others, 0.0))]
        assert np.allclose(*(np.sort(low) for low in lows), atol=1e-9)


def test_out_of_reach():
    system = iiwa()
    sweep = ik_sweep(system, spatial.pose(p=[2.0, 0.0, 0.3]), "tool", n=5)
    assert not sweep and not any(sweep.spans) and not sweep.mask.any() and sweep.feasible == ()
    assert "no solution" in sweep.status and len(sweep.at(0.3)) == 0 and sweep.best() is None
    tight = iiwa(limits=np.full(7, 1e-3))
    sweep = ik_sweep(tight, tight.fk(np.full(7, 0.5), "tool"), "tool")
    assert not sweep and any(sweep.spans) and "outside the limits" in sweep.status


@pytest.mark.slow
def test_best():
    system = iiwa()
    T = system.fk(system.random(21), "tool")
    sweep = ik_sweep(system, T, "tool")
    best = sweep.best()
    room = np.min(1.0 - np.abs(best.q) / LIMITS)
    assert (
        best.score == pytest.approx(room, abs=1e-12) and deviation(system, "tool", best.q, T) < 1e-9
    )
    dense = [q for psi in np.linspace(-PI, PI, 3001) for q in iiwa_at(T, psi)]
    most = np.max(np.min(1.0 - np.abs(dense) / LIMITS, axis=1))
    assert most <= room + 1e-9 and room - most < 1e-3
    up = sweep.best(lambda q: -np.abs(q[:, 0]))
    assert abs(up.q[0]) <= np.abs([q[0] for q in dense if (np.abs(q) <= LIMITS).all()]).min() + 1e-3
    with pytest.raises(InputError, match="objective"):
        sweep.best("speed")


# ---- joints


@pytest.mark.slow
def test_panda_over_its_last_joint():
    system = kempe.load("panda")
    rng = np.random.default_rng(0)
    for q in system.random(rng, 3):
        T = system.fk(q, "tool")
        sweep = ik_sweep(system, T, "tool", "panda_joint7", n=151)
        assert not sweep.exact and deviation(system, "tool", sweep.q[sweep.mask], T) < 1e-9
        requested = sweep.at(sweep.values)
        assert np.array_equal(requested.mask.sum(axis=1), sweep.mask.sum(axis=1))
        assert np.array_equal(requested.inside.sum(axis=1), sweep.inside.sum(axis=1))
        assert lies_in(sweep.feasible, q[6])
        assert np.all(sweep.q[..., 6][sweep.mask] == sweep.values[np.nonzero(sweep.mask)[0]])
        ends = [x for rows in sweep.intervals for i in rows for x in i if abs(x) < 2.8973 - 1e-6]
        for x in ends:
            a, b = (sweep.at(x + s).inside.sum() for s in (-1e-8, 1e-8))
            shared = sum(abs(x - y) < 2e-8 for y in ends)
            assert a != b or shared > 1, x


@pytest.mark.slow
@pytest.mark.parametrize(("k", "joint"), [(0, "panda_joint1"), (6, "panda_joint7")])
def test_few_samples_find_the_curves_that_they_meet(k, joint):
    """Six values of the parameter: most pieces of the curves lie between two of them, some have
    folds at both ends.
    """
    system = kempe.load("panda")
    rng = np.random.default_rng(0)
    q = [system.random(rng) for _ in range(7)]
    sweep = ik_sweep(
        system, system.fk(q[k], "tool"), "tool", joint, n=60, budget=kempe.Budget(points=6)
    )
    requested = sweep.at(sweep.values)
    assert len(sweep.labels) >= 12 and np.array_equal(
        requested.mask.sum(axis=1), sweep.mask.sum(axis=1)
    )
    assert np.array_equal(requested.inside.sum(axis=1), sweep.inside.sum(axis=1))


@pytest.mark.slow
def test_folds_close_to_each_other():
    """Three folds within two hundredths of a radian, between two samples."""
    system = kempe.load("panda")
    T = system.fk([2.30586, -0.3471, -2.2574, -0.56815, -2.17032, 3.73783, -1.80355], "tool")
    sweep = ik_sweep(system, T, "tool", "panda_joint7")
    folds = {round(x, 9) for rows in sweep.spans for i in rows for x in i if -1.2 < x < -1.0}
    assert len(folds) == 2
    for x in (*np.linspace(min(folds), max(folds), 7)[1:-1], min(folds) - 1e-6, max(folds) + 1e-6):
        assert len(sweep.at(x)) == sum(lies_in(rows, x) for rows in sweep.spans), x


def test_planar_arm_with_four_joints():
    """Ends of the span over the last joint: where the first two links are in line, by the law of
    cosines.
    """
    lengths = (0.5, 0.4, 0.35, 0.2)
    system = planar_arm(*lengths)
    q = np.array([0.3, 0.9, -0.7, 0.5])
    T = system.fk(q, "tip")
    sweep = ik_sweep(system, T, "tip", "q4", n=200)
    assert deviation(system, "tip", sweep.q[sweep.mask], T) < 1e-9
    angle = q.sum()
    p3 = T[:2, 3] - lengths[3] * np.array([math.cos(angle), math.sin(angle)])
    # joint 3 is at p3 - l3 (cos, sin)(angle - q4): at most l1 + l2 from the origin, at least l1 -
    # l2
    away = np.linalg.norm(p3)
    towards = math.atan2(p3[1], p3[0])
    known = []
    for reach in (lengths[0] + lengths[1], lengths[0] - lengths[1]):
        c = (away**2 + lengths[2] ** 2 - reach**2) / (2 * away * lengths[2])
        if abs(c) < 1:
            known += [
                wrapped(angle - towards - math.acos(c)),
                wrapped(angle - towards + math.acos(c)),
            ]
    ends = [x for rows in sweep.spans for i in rows for x in i if abs(abs(x) - PI) > 1e-9]
    ends = sorted({round(x, 9) for x in ends})
    assert known and np.allclose(ends, np.sort(known), atol=1e-9)
    assert ik_sweep(system, T, "tip").parameter in system.coordinate_names


@pytest.mark.slow
def test_position_with_four_joints_in_space():
    rows = [
        {"alpha": H, "d": 0.3},
        {"a": 0.1, "alpha": -H},
        {"a": 0.3, "alpha": H, "d": 0.2},
        {"a": 0.25},
    ]
    system = from_dh([{**r, "limits": (-2.6, 2.4)} for r in rows], "standard", "four").build()
    for q in system.random(np.random.default_rng(2), 3):
        target = system.fk(q, "tool")[:3, 3]
        sweep = ik_sweep(system, target, "tool", "q1", n=100)
        assert (
            sweep
            and deviation(system, "tool", sweep.q[sweep.mask], target) < 1e-9
            and lies_in(sweep.feasible, q[0])
        )
        found = sweep.at(sweep.values)
        assert np.array_equal(found.inside.sum(axis=1), sweep.inside.sum(axis=1))


@pytest.mark.slow
def test_more_freedoms_than_one():
    system = iiwa()
    q = system.random(4)
    target = system.fk(q, "tool")[:3, 3]
    sweep = ik_sweep(system, target, "tool", "q1", start=q, n=60)
    assert len(sweep.held) == 3 and "held" in str(sweep)
    assert deviation(system, "tool", sweep.q[sweep.mask], target) < 1e-9 and lies_in(
        sweep.feasible, q[0]
    )
    for name, x in sweep.held.items():
        assert np.all(sweep.q[sweep.mask][:, system.coordinate_names.index(name)] == x)


# ---- what is refused, and what is shown


def test_what_is_refused():
    system = iiwa()
    panda = kempe.load("panda")
    six = kempe.load("puma560")
    T = system.fk(system.random(1), "tool")
    with pytest.raises(UnsupportedError, match="no arm angle.*last three axes do not meet"):
        ik_sweep(panda, T, "tool", "arm_angle")
    with pytest.raises(UnsupportedError, match="no arm angle"):
        compute_arm_angle(panda, panda.neutral, "tool")
    with pytest.raises(UnsupportedError, match="no freedom to spare"):
        ik_sweep(six, six.fk(six.random(0), "tool"), "tool")
    with pytest.raises(UnsupportedError, match="arm angle is for poses"):
        ik_sweep(system, T[:3, 3], "tool", "arm_angle")
    with pytest.raises(UnknownNameError, match="'q9'"):
        ik_sweep(system, T, "tool", "q9")
    several = {"fixed": {"q1": [0.0, 1.0]}}
    for bad in (
        {"n": 1},
        {"n": 2.5},
        {"parameter": ("arm_angle", (0, 0, 0))},
        {"start": np.full(7, np.nan)},
        several,
    ):
        with pytest.raises(InputError):
            ik_sweep(system, T, "tool", **bad)
    for bad_pose in (2.0 * T, T * np.array([1.0, 1.0, -1.0, 1.0])):
        with pytest.raises(InputError, match="not a pose"):
            ik_sweep(system, bad_pose, "tool")
    with pytest.raises(InputError, match="one target"):
        ik_sweep(system, np.stack([T, T]), "tool")
    with pytest.raises(InputError, match="finite"):
        ik_sweep(system, T, "tool").at(math.nan)


def test_text():
    system = iiwa()
    sweep = ik_sweep(system, system.fk(system.random(0), "tool"), "tool")
    low, high = sweep.feasible[0]
    assert f"[{low:.6g}, {high:.6g}]" in sweep.status and "closed form" in sweep.status
    assert str(sweep).startswith("'tool' of iiwa, pose") and "q2+ q4+ q6+" in sweep._repr_html_()


# ---- parts


def test_three_turns():
    rng = np.random.default_rng(0)
    for _ in range(20):
        h = rng.normal(size=(3, 3))
        h /= np.linalg.norm(h, axis=1, keepdims=True)
        angles = rng.uniform(-PI, PI, (50, 3))
        R = (
            compute_rotations(h[0], angles[:, 0])
            @ compute_rotations(h[1], angles[:, 1])
            @ compute_rotations(h[2], angles[:, 2])
        )
        found, d2 = solve_three_turns(h, R)
        again = (
            compute_rotations(h[0], found[..., 0])
            @ compute_rotations(h[1], found[..., 1])
            @ compute_rotations(h[2], found[..., 2])
        )
        assert np.all(d2 > -1e-12) and np.abs(again - R[:, None]).max() < 1e-9
        assert np.abs(wrapped(found - angles[:, None])).max(axis=-1).min(axis=-1).max() < 1e-5


def test_intervals():
    parts = split_circle([1.0, -2.0, 1.0 + 2 * PI, 3.0])
    assert np.allclose(parts, [(-2.0, 1.0), (1.0, 3.0), (3.0, 2 * PI - 2.0)])
    assert np.allclose(join_arcs(parts, [False, True, True]), [(1.0, 2 * PI - 2.0)])
    assert np.allclose(join_arcs(parts, [True, False, True]), [(3.0, 2 * PI + 1.0)])
    assert join_arcs(parts, [True] * 3) == [(-PI, PI)] and join_arcs(parts, [False] * 3) == []
    assert unite_intervals([(3.0, 4.0), (-PI, -3.0)], True) == ((3.0, 4.0),)
    assert unite_intervals([(0.0, 1.0), (0.5, 2.0), (3.0, 4.0)], False) == ((0.0, 2.0), (3.0, 4.0))
    assert unite_intervals([(-1.0, 3.5), (3.0, 6.0)], True) == ((-PI, PI),)


def test_arcs_between_angles():
    assert split_circle([]) == [(-np.pi, np.pi)]
    assert split_circle([0.5]) == [(0.5, 0.5 + 2 * np.pi)]
    assert np.allclose(
        split_circle([0.5, 2 * np.pi + 0.5, -1.0]), [(-1.0, 0.5), (0.5, 2 * np.pi - 1.0)]
    )
    assert len(split_circle([np.pi, -np.pi])) == 1
