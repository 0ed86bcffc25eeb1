"""All postures of six-joint chains: published arms, known postures, gauges, singular goals.

The forward motion here is numpy's own; the kernels' is not used.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hunts import examples, some

from kempe.kernels.closed_form.analytic_layout import FORMULATIONS
from kempe.kernels.compiled import elimination_batch, elimination_score
from kempe.kernels.forward.table_layout import SLIDE

CANDIDATES = 24
ODD = 1
"""Room for the candidates of a goal, and the bit of doubt for an odd number of them."""

PI = np.pi
NEARLY_SINGULAR = 1e-5
"""Smallest singular value of the Jacobian below which a posture may be missed (a few in 100
000)."""
TURNS = np.zeros(6, np.int64)

# a, alpha [degrees], d, offset [degrees] of each joint; lengths in any unit. (*): dimensions as
# commonly given, not checked against the maker's document; the tests need the kind of geometry, not
# the millimetre.
STANDARD = {
    # Manseur and Doty 1989, "A robot manipulator with 16 real inverse kinematic solution sets"
    "manseur": [(0.3, 90, 0, 0), (1, 1, 0, 0), (0, 90, 0.2, 0), (1.5, 1, 0, 0), (0, 90, 0, 0), (0, 1, 0, 0)],
    # Kinova Jaco2: D1 to D6 and e2 of Kinova's "DH Parameters of Jaco", wrist of 60 degrees
    "jaco2": [(0, 90, 0.2755, 0), (0.41, 180, 0, 0), (0, 90, -0.0098, 0), (0, 60, -0.2501, 0), (0, 60, -0.0856, 0),
              (0, 180, -0.2028, 0)],
    # UFactory xArm6: docs.ufactory.cc, "Kinematic and Dynamic Parameters of xArm 6"
    "xarm6": [(0, -90, 267, 0), (289.49, 0, 0, -79.35), (77.5, -90, 0, 79.35), (0, 90, 342.5, 0), (76, -90, 0, 0),
              (0, 0, 97, 0)],
    # Yaskawa HC10 (*)
    "hc10": [(0, -90, 275, 0), (700, 180, 0, -90), (0, -90, 0, 0), (0, 90, -500, 0), (0, -90, -162, 0),
             (0, 180, -170, 0)],
    # Doosan M1013 (*)
    "m1013": [(0, -90, 152.5, 0), (620, 0, 34.5, -90), (0, 90, 0, 90), (0, -90, 559, 0), (0, 90, 0, 0), (0, 0, 121, 0)],
    # Universal Robots UR10e: "DH parameters for calculations of kinematics and dynamics"
    "ur10e": [(0, 90, 180.7, 0), (-612.7, 0, 0, 0), (-571.55, 0, 0, 0), (0, 90, 174.15, 0), (0, -90, 119.85, 0),
              (0, 0, 116.55, 0)],
    # Puma 560 (*)
    "puma": [(0, 90, 0, 0), (431.8, 0, 0, 0), (20.3, -90, 150.05, 0), (0, 90, 431.8, 0), (0, -90, 0, 0),
             (0, 0, 56.3, 0)],
}  # fmt: skip
# the same with a and alpha of the link before each joint
MODIFIED = {
    # FANUC CRX-10iA (*)
    "crx10": [(0, 0, 245, 0), (0, -90, 0, -90), (540, 180, 0, 0), (0, -90, -540, 0), (0, 90, 150, 0),
              (0, -90, -160, 0)],
    # AgileX Piper (*)
    "piper": [(0, 0, 123, 0), (0, -90, 0, -172.22), (285.03, 0, 0, -102.78), (-21.98, 90, 250.75, 0), (0, -90, 0, 0),
              (0, 90, 91, 0)],
}  # fmt: skip


def table(name) -> np.ndarray:
    """The table of a published arm, angles in radians."""
    rows = np.array(STANDARD.get(name) or MODIFIED[name], dtype=float)
    rows[:, [1, 3]] *= PI / 180
    return rows


def screw(axis, angle, along) -> np.ndarray:
    """Turn by `angle` about axis x (0) or z (2) with a slide along it."""
    c = np.cos(angle)
    s = np.sin(angle)
    T = np.eye(4)
    i = (axis + 1) % 3
    j = (axis + 2) % 3
    T[i, i], T[i, j], T[j, i], T[j, j] = c, -s, s, c
    T[axis, 3] = along
    return T


def from_table(rows, modified=False) -> tuple[np.ndarray, np.ndarray]:
    """Lines (6, 8) and the tip's pose at zero, of Denavit-Hartenberg parameters, angles in radians."""
    T = np.eye(4)
    lines = np.zeros((6, 8))
    for i, (a, alpha, d, offset) in enumerate(rows):
        if modified:
            T = T @ screw(0, alpha, a)
        lines[i, :3], lines[i, 4:7] = T[:3, 2], T[:3, 3]
        T = T @ screw(2, offset, d)
        if not modified:
            T = T @ screw(0, alpha, a)
    return lines, T


def scaled(lines) -> np.ndarray:
    """The chain in units of its size, near the origin: what the kernels are promised."""
    lines = lines.copy()
    o = lines[:, 4:7] - lines[:, 4:7].mean(axis=0)
    lines[:, 4:7] = o / np.sqrt((o * o).sum(axis=1).mean())
    return lines


def arm(name, error=0.0) -> np.ndarray:
    """A published arm, its parameters off by normal errors: lengths relative to the largest, angles
    in radians.
    """
    rows = table(name)
    rows[:, [0, 2]] /= abs(rows[:, [0, 2]]).max()
    rows += error * np.random.default_rng(7).standard_normal(rows.shape)
    return scaled(from_table(rows, name in MODIFIED)[0])


def random_arm(seed) -> np.ndarray:
    lines = np.random.default_rng(seed).standard_normal((6, 8))
    lines[:, :3] /= np.linalg.norm(lines[:, :3], axis=1)[:, None]
    lines[:, [3, 7]] = 0.0
    lines[:, 4:7] *= 0.7
    return lines


def motions(line, theta, kind) -> np.ndarray:
    """E of one joint for each theta: (N, 4, 4)."""
    h = line[:3]
    o = line[4:7]
    T = np.tile(np.eye(4), (len(theta), 1, 1))
    if kind == SLIDE:
        T[:, :3, 3] = theta[:, None] * h
        return T
    H = np.array([[0, -h[2], h[1]], [h[2], 0, -h[0]], [-h[1], h[0], 0]])
    T[:, :3, :3] += np.sin(theta)[:, None, None] * H + (1 - np.cos(theta))[:, None, None] * (H @ H)
    T[:, :3, 3] = o - T[:, :3, :3] @ o
    return T


def reach(lines, theta, kinds=TURNS) -> np.ndarray:
    """Goals (N, 12) of postures (N, 6)."""
    T = np.tile(np.eye(4), (len(theta), 1, 1))
    for i in range(6):
        T = T @ motions(lines[i], theta[:, i], kinds[i])
    return np.ascontiguousarray(T[:, :3].reshape(-1, 12))


def weakest(lines, theta) -> float:
    """Smallest singular value of the Jacobian (lines as they stand, by their direction and moment)."""
    J = np.empty((6, 6))
    T = np.eye(4)
    for i in range(6):
        h = T[:3, :3] @ lines[i, :3]
        o = T[:3, :3] @ lines[i, 4:7] + T[:3, 3]
        J[:3, i], J[3:, i] = h, np.cross(o, h)
        T = T @ motions(lines[i], theta[i : i + 1], 0)[0]
    return np.linalg.svd(J, compute_uv=False)[-1]


def postures(n, seed=0, kinds=TURNS) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.where(kinds == SLIDE, rng.uniform(-1, 1, (n, 6)), rng.uniform(-PI, PI, (n, 6)))


def best_forms(lines, kinds=TURNS) -> list[int]:
    """Formulations with a score, best first."""
    scores = np.empty(FORMULATIONS)
    useful = elimination_score.score_formulations(kinds, lines, scores)
    assert useful == (scores > 0).sum() and (scores <= 1.0).all()
    return [int(f) for f in np.argsort(-scores, kind="stable") if scores[f] > 0.0]


def run(lines, goals, formulation, kinds=TURNS):
    """Thetas (N, CANDIDATES, 6), NaN where there is none, and suspects (N,)."""
    n = len(goals)
    thetas = np.full((n, CANDIDATES, 6), np.nan)
    counts = np.empty(n, np.int64)
    suspects = np.empty(n, np.int64)
    found = elimination_batch.eliminate_goals(
        kinds, lines, goals, formulation, thetas, counts, suspects
    )
    assert found == (suspects != 0).sum()
    assert np.array_equal(np.isfinite(thetas).all(axis=2), np.arange(CANDIDATES) < counts[:, None])
    assert np.array_equal(counts % 2 == 1, suspects & ODD != 0)
    return thetas, suspects


def gaps(a, b, kinds=TURNS) -> np.ndarray:
    """Largest difference of the coordinates of postures, angles by the shorter way; infinite with
    NaN.
    """
    d = a - b
    d = np.where(kinds == SLIDE, d, (d + PI) % (2 * PI) - PI)
    d = abs(d).max(axis=-1)
    return np.where(np.isnan(d), np.inf, d)


def has(thetas, theta, kinds=TURNS, tolerance=1e-5) -> np.ndarray:
    return gaps(thetas, theta[:, None, :], kinds).min(axis=1) < tolerance


def solve(lines, goals, forms, kinds=TURNS) -> tuple[list[np.ndarray], np.ndarray]:
    """Distinct postures of each goal, by more formulations where the one before was suspect; first
    suspects.
    """
    answers = [np.empty((0, 6)) for _ in goals]
    left = np.arange(len(goals))
    first = None
    for f in forms[:4]:
        thetas, suspects = run(lines, goals[left], f, kinds)
        first = suspects if first is None else first
        for i, found in zip(left, thetas, strict=True):
            for theta in found[np.isfinite(found[:, 0])]:
                if not (gaps(answers[i], theta, kinds) < 1e-5).any():
                    answers[i] = np.vstack([answers[i], theta])
        left = left[suspects != 0]
        if not len(left):
            break
    assert first is not None
    return answers, first


def same_sets(a, b, tolerance=1e-7) -> bool:
    """Whether two sets of postures are the same."""
    return len(a) == len(b) and all((gaps(b, theta) < tolerance).sum() == 1 for theta in a)


ARMS = {
    name: arm(name) for name in ("manseur", "jaco2", "crx10", "xarm6", "hc10", "m1013", "piper")
}
ARMS |= {
    f"{name} {error:g}": arm(name, error)
    for name in ("ur10e", "puma")
    for error in (1e-3, 1e-5, 1e-7)
}
ARMS |= {f"random {seed}": random_arm(seed) for seed in range(3)}
FORMS: dict[str, list[int]] = {}


def forms_of(name) -> list[int]:
    if name not in FORMS:
        FORMS[name] = best_forms(ARMS[name])
    return FORMS[name]


def battery(name, n, seed):
    """Assert that known postures are found, and that no doubt goes without saying."""
    lines = ARMS[name]
    theta = postures(n, seed)
    goals = reach(lines, theta)
    answers, suspects = solve(lines, goals, forms_of(name))
    found = np.array([(gaps(a, t) < 1e-5).any() for a, t in zip(answers, theta, strict=True)])
    assert merged(lines, theta[~found]), f"{(~found).sum()} postures of {n} not found"
    assert (suspects != 0).mean() < 0.15  # each costs another formulation
    for i, postures_ in enumerate(answers):
        if len(postures_):
            back = reach(lines, postures_)
            assert abs(back - goals[i]).max() < 1e-8
            assert (postures_ > -PI).all() and (postures_ <= PI).all()
    first, doubts = run(lines, goals, forms_of(name)[0])
    assert merged(lines, theta[(doubts == 0) & ~has(first, theta)]), "a miss that was not suspected"


def merged(lines, missed) -> bool:
    """Whether all that was missed is as good as singular, and rare: there it merges with another
    within accuracy.
    """
    return len(missed) < 10 and all(weakest(lines, t) < NEARLY_SINGULAR for t in missed)


@pytest.mark.parametrize("name", some(list(ARMS), 4))
def test_known_postures_are_found(name):
    battery(name, 300, 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(ARMS))
def test_known_postures_are_found_always(name):
    battery(name, examples(20_000), 2)


def test_sixteen_postures_of_manseur_and_doty():
    lines, M = from_table(table("manseur"))
    R = np.array(
        [[-0.760117, -0.641689, 0.102262], [0.133333, 0, 0.991071], [-0.635959, 0.766965, 0.085558]]
    )
    u, _, vt = np.linalg.svd(R)
    target = np.eye(4)
    target[:3, :3] = u @ vt
    target[:3, 3] = (-1.140175, 0, 0)
    goal = np.ascontiguousarray((target @ np.linalg.inv(M))[:3].reshape(1, 12))
    forms = best_forms(lines)
    answers = [run(lines, goal, f) for f in forms[:6]]
    for thetas, suspects in answers:
        assert suspects[0] == 0 and np.isfinite(thetas[0]).all(axis=1).sum() == 16
        assert same_sets(thetas[0, :16], answers[0][0][0, :16])
        assert abs(reach(lines, thetas[0, :16]) - goal).max() < 1e-10


def test_every_formulation_of_a_general_arm_gives_the_same():
    lines = ARMS["random 0"]
    goals = reach(lines, postures(5, 4))
    answers, _ = solve(lines, goals, forms_of("random 0"))
    for f in range(FORMULATIONS):
        thetas, suspects = run(lines, goals, f)
        for i in np.flatnonzero(suspects == 0):
            assert same_sets(thetas[i][np.isfinite(thetas[i, :, 0])], answers[i]), (f, i)
        assert (suspects == 0).sum() >= 4


@pytest.mark.parametrize("seed", range(4))
def test_gauges_change_nothing(seed):
    """Base moved, origins shifted along their axes, axes flipped, zeros moved: the same postures."""
    rng = np.random.default_rng(seed)
    lines = [ARMS["random 1"], ARMS["jaco2"], ARMS["crx10"], ARMS["ur10e 0.001"]][seed]
    goals = reach(lines, postures(20, seed))
    forms = best_forms(lines)
    answers, _ = solve(lines, goals, forms)

    X = np.eye(4)
    X[:3, :3] = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    X[:3, :3] *= np.linalg.det(X[:3, :3])
    X[:3, 3] = rng.standard_normal(3)
    zero = rng.uniform(-1, 1, 6)
    flip = rng.choice([-1.0, 1.0], 6)
    T = X.copy()
    moved = lines.copy()
    for i in range(6):  # at the new zero the line is where the joints before it carry it
        h = T[:3, :3] @ lines[i, :3]
        o = T[:3, :3] @ lines[i, 4:7] + T[:3, 3]
        moved[i, :3] = flip[i] * h
        moved[i, 4:7] = o + rng.standard_normal() * h
        T = T @ motions(lines[i], zero[i : i + 1], 0)[0]
    G = np.tile(np.eye(4), (20, 1, 1))
    G[:, :3] = goals.reshape(-1, 3, 4)
    new_goals = np.ascontiguousarray((X @ G @ np.linalg.inv(T))[:, :3].reshape(-1, 12))
    others, _ = solve(moved, new_goals, best_forms(moved))
    for a, b in zip(answers, others, strict=True):
        assert same_sets(a, flip * b + zero)


@pytest.mark.parametrize("name", some(list(ARMS), 4))
def test_right_angles_and_half_turns(name):
    """Neither half-angle tangents at infinity nor parallel and crossing axes lose a posture that is
    not singular.
    """
    lines = ARMS[name]
    rng = np.random.default_rng(3)
    theta = postures(120, 3)
    special = rng.random((120, 6)) < rng.choice([0.3, 0.6, 1.0], (120, 1))
    theta[special] = rng.choice([0.0, PI / 2, -PI / 2, PI], (120, 6))[special]
    theta = theta[[weakest(lines, t) > 1e-3 for t in theta]]
    assert len(theta) > 40
    goals = reach(lines, theta)
    answers, _ = solve(lines, goals, forms_of(name))
    assert all((gaps(a, t) < 1e-5).any() for a, t in zip(answers, theta, strict=True))
    assert all((a <= PI).all() and (a > -PI).all() for a in answers)
    thetas, suspects = run(lines, goals, forms_of(name)[0])
    assert has(thetas, theta)[suspects == 0].all(), "a miss that was not suspected"


@pytest.mark.parametrize("slide", range(6))
def test_a_slide_anywhere(slide):
    kinds = TURNS.copy()
    kinds[slide] = SLIDE
    lines = random_arm(20 + slide)
    theta = postures(200, slide, kinds)
    forms = best_forms(lines, kinds)
    assert all(f % 6 != slide for f in forms) and len(forms) > 8
    goals = reach(lines, theta, kinds)
    thetas, suspects = run(lines, goals, forms[0], kinds)
    assert (suspects != 0).mean() < 0.05
    answers, _ = solve(lines, goals, forms, kinds)
    for a, t, g in zip(answers, theta, goals, strict=True):
        assert (gaps(a, t, kinds) < 1e-5).any()
        assert abs(reach(lines, a, kinds) - g).max() < 1e-8


@pytest.mark.parametrize("slides", [(0, 1), (0, 3), (2, 5)])
def test_two_slides(slides):
    kinds = TURNS.copy()
    kinds[list(slides)] = SLIDE
    lines = random_arm(31)
    theta = postures(100, 5, kinds)
    forms = best_forms(lines, kinds)
    answers, _ = solve(lines, reach(lines, theta, kinds), forms, kinds)
    assert all((gaps(a, t, kinds) < 1e-5).any() for a, t in zip(answers, theta, strict=True))


def test_chains_out_of_scope_have_no_formulation():
    kinds = TURNS.copy()
    kinds[:4] = SLIDE
    assert best_forms(random_arm(0), kinds) == []
    planar = random_arm(1)
    planar[:, :3] = 0.0, 0.0, 1.0
    assert best_forms(planar) == []


@pytest.mark.parametrize("name", ["ur10e", "puma", "random 0", "crx10"])
def test_singular_goals_end_well(name):
    """Exactly singular postures may be suspect; candidates are finite and right, or there are none."""
    lines = ARMS.get(name)
    lines = arm(name) if lines is None else lines
    theta = np.array(list(itertools.product([0.0, PI / 2, PI], repeat=6)))[::5]
    goals = reach(lines, theta)
    for f in range(FORMULATIONS):
        thetas, _ = run(lines, goals[f::FORMULATIONS].copy(), f)
        for found, goal in zip(thetas, goals[f::FORMULATIONS], strict=True):
            found = found[np.isfinite(found[:, 0])]
            assert not len(found) or abs(reach(lines, found) - goal).max() < 1e-8


def test_goals_out_of_reach_or_not_finite():
    lines = ARMS["random 1"]
    goals = reach(lines, postures(6))
    goals[0, 3] = 100.0
    goals[1, 0] = np.nan
    goals[2, 11] = np.inf
    goals[3, 3] = 1e200
    for f in range(FORMULATIONS):
        thetas, _ = run(lines, goals, f)
        assert np.isnan(thetas[:4]).all() and np.isfinite(thetas[4:, :2]).all()
