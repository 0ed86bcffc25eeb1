"""What every answer of `ik_all` must satisfy, checked with the oracle's own forward model."""

from __future__ import annotations

import itertools
import math

import analytic_oracle as oracle
import numpy as np
from arms import Arm

VERIFIED = 1e-9
"""Largest error of an answer, in metres and radians."""

SAME = 1e-6
"""Largest difference of a configuration that counts as found, modulo a turn; nearer answers are the
same one."""


def held(arm: Arm, q) -> dict[str, np.ndarray]:
    """The coordinates that are held for a redundant arm, as in configurations (..., nq)."""
    q = np.asarray(q)
    return {name: q[..., arm.system.coordinate_names.index(name)] for name in arm.held}


def ask(arm: Arm, X, q=None, **options):
    """The answer for targets X; for a redundant arm the coordinates `held` are those of q."""
    if arm.held:
        options["fixed"] = held(arm, q)
    return arm.system.ik_all(
        X, arm.frame, task=(options.pop("task", arm.task), arm.axis), **options
    )


def model(arm: Arm, q=None) -> oracle.Model:
    """The arm's model, with the coordinates `held` as in q (nq,)."""
    return arm.model.held({k: float(v) for k, v in held(arm, q).items()}) if arm.held else arm.model


def rows(answer) -> list[np.ndarray]:
    """The solutions (k, nq) of each target of an answer, a single one or a flat batch."""
    if answer.q.ndim == 2:
        return [answer.q]
    q = answer.q.reshape(-1, *answer.q.shape[-2:])
    mask = answer.mask.reshape(-1, answer.mask.shape[-1])
    return [x[m] for x, m in zip(q, mask, strict=True)]


def assert_sound(arm: Arm, answer, X) -> None:
    """Every solution reaches its target, no two are the same, flags are true."""
    assert_true(arm, answer, X)
    assert_distinct(arm, answer)


def padded(answer) -> tuple[np.ndarray, np.ndarray]:
    """The solutions (N, K, nq) of N targets and which of them are in use (N, K)."""
    if answer.q.ndim == 2:
        return answer.q[None], np.ones((1, len(answer.q)), dtype=bool)
    K = answer.q.shape[-2]
    return answer.q.reshape(-1, K, answer.q.shape[-1]), answer.mask.reshape(-1, K)


def assert_true(arm: Arm, answer, X) -> None:
    """Every solution reaches its target by the oracle's forward model, and is inside the limits if
    it says so.
    """
    X = np.asarray(X).reshape(-1, 4, 4)
    q, mask = padded(answer)
    K = q.shape[1]
    inside = answer.inside.reshape(len(X), K)
    assert np.isfinite(q[mask]).all()
    isolated = mask & (answer.multiplicity.reshape(len(X), K) > 0)
    assert isolated.sum(axis=1).max(initial=0) <= arm.bound, (
        f"{arm.name}: {isolated.sum(axis=1).max()} solutions"
    )
    theta = arm.model.theta(np.where(mask[..., None], q, 0.0))
    position, angle = oracle.error(arm.model.pose(theta), X[:, None], arm.task, arm.axis)
    wrong = mask & ~((position <= VERIFIED) & (angle <= VERIFIED))
    assert not wrong.any(), (
        f"{arm.name}, {np.argwhere(wrong)[:3]}: errors {position[wrong][:3]}, {angle[wrong][:3]}"
    )
    np.testing.assert_array_equal(inside[mask], is_inside(arm, q[mask]))


def assert_distinct(arm: Arm, answer) -> None:
    """No two solutions of a target are the same, slides in lengths of the arm."""
    same = (
        SAME * min(1.0, 0.5 * arm.model.size) if (arm.model.kinds == oracle.SLIDE).any() else SAME
    )
    q, mask = padded(answer)
    theta = arm.model.theta(np.where(mask[..., None], q, 0.0))
    for j, k in itertools.combinations(range(q.shape[1]), 2):
        apart = arm.model.apart(theta[:, j], theta[:, k])
        near = np.flatnonzero(mask[:, j] & mask[:, k] & (apart <= same))
        assert not len(near), (
            f"{arm.name}, {len(near)} targets: solutions {j}, {k} of {near[0]}: "
            f"{apart[near[0]]:.1e}"
        )


def is_inside(arm: Arm, q) -> np.ndarray:
    """Whether configurations (..., nq) are inside the limits as they stand."""
    return ((arm.system.lower <= q) & (q <= arm.system.upper)).all(axis=-1)


def can_be_inside(arm: Arm, q) -> bool:
    """Whether whole turns bring a configuration (nq,) inside the limits."""
    return all(len(turns(arm, q, i)) for i in range(arm.system.nq))


def turns(arm: Arm, q, i: int) -> list[float]:
    """The values of coordinate i inside its limits, whole turns apart; one where there are
    infinitely many.
    """
    low = arm.system.lower[i]
    high = arm.system.upper[i]
    at = np.flatnonzero(arm.model.index == i)
    if not len(at) or arm.model.kinds[at[0]] == oracle.SLIDE:
        return [q[i]] if low <= q[i] <= high else []
    if math.isinf(low) and math.isinf(high):
        return [q[i]]
    period = 2 * math.pi / abs(arm.model.multiplier[at[0]])
    first = math.ceil((low - q[i]) / period)
    last = math.floor((high - q[i]) / period)
    return [q[i] + period * k for k in range(first, last + 1)]


def nearest(arm: Arm, found, theta) -> float:
    """How far the nearest of the solutions `found` (k, nq) is from theta (n,); infinite where there
    is none.
    """
    return float(arm.model.apart(arm.model.theta(found), theta).min(initial=math.inf))


def assert_found(arm: Arm, answer, q, within=SAME, missed: int = 0) -> None:
    """The configurations (N, nq) that gave the targets are among the answers, `within` (N,), or on
    their families.

    All but `missed`, whose answers do not say that they are complete.
    """
    q = np.atleast_2d(q)
    within = np.broadcast_to(within, len(q))
    missing = []
    for i, (found, x) in enumerate(zip(rows(answer), q, strict=True)):
        d = nearest(arm, found, arm.model.theta(x))
        if d > within[i] and not on_a_family(answer, i, x):
            missing.append((i, d))
    false = [(i, d) for i, d in missing if np.ravel(answer.complete)[i]]
    assert not false, (
        f"{arm.name}: complete with {len(false)} of {len(q)} not found, such as {false[:3]}"
    )
    assert len(missing) <= missed, (
        f"{arm.name}: {len(missing)} of {len(q)} not found, such as {missing[:3]}"
    )


def on_a_family(answer, i: int, q) -> bool:
    """Whether q (nq,) is on one of the families of target i."""
    families = answer.families if answer.q.ndim == 2 else answer.families.reshape(-1)[i]
    return any(f.distance(q) < SAME for f in families)


def same_sets(arm: Arm, a, b, tolerance: float = SAME) -> bool:
    """Whether two sets of theta (k, n) are the same, angles modulo a turn."""
    if len(a) != len(b):
        return False
    there = all(arm.model.apart(a, x).min() <= tolerance for x in b)
    return there and all(arm.model.apart(b, x).min() <= tolerance for x in a)


# ---------------------------------------------------------------- near singularities


def square(arm: Arm) -> bool:
    """Whether the task asks for as many numbers as the arm has joints, some of which turn: it has
    singularities.
    """
    singular = (arm.model.kinds == oracle.TURN).any()
    return (
        bool(singular)
        and not arm.held
        and arm.system.dim == 3
        and (arm.task, arm.model.n) in (("pose", 6), ("position", 3), ("orientation", 3))
    )


def on_a_curve(arm: Arm, theta) -> bool:
    """Whether the singular theta (n,) lies on a curve of solutions for its own pose, and not where
    two solutions meet.

    Newton's method returns to a meeting point (or its like) from nearby, but finds a curve where it
    starts.
    """
    m = arm.model
    X = m.pose(theta)
    J = m.jacobian(theta)
    J[:3] /= m.size
    scale = np.where(m.kinds == oracle.SLIDE, m.size, 1.0)
    J = oracle._rows((J * scale)[None], X[None, :3, :3], arm.task, arm.axis)[0]
    null = np.linalg.svd(J)[2][-1] * scale
    away, done = oracle.newton(
        m, X, theta + np.array([[0.05], [-0.05]]) * null, arm.task, arm.axis, steps=80
    )
    return bool(done.all() and (np.abs(away - theta).max(axis=1) > 0.02).all())


def near_singular(arm: Arm, seed: int, number: int, sizes) -> tuple[np.ndarray, np.ndarray]:
    """Thetas (number, len(sizes), n) so far from random singular configurations, and whether these
    are on curves.
    """
    rng = np.random.default_rng([seed, 99])
    out = []
    curves = []
    for _ in range(number):
        theta, direction = oracle.singular_configuration(arm.model, rng, arm.task)
        curves.append(on_a_curve(arm, theta))
        out.append(theta + np.multiply.outer(sizes, direction))
    return np.array(out), np.array(curves)


ROUNDING = 1e-15
"""Rounding of a target, in radians and lengths of the arm."""


def allowed(arm: Arm, theta, curve) -> np.ndarray:
    """How far (...) from theta (..., n) its solution may be found: how far rounding of the target
    moves it.

    Where two solutions meet, the square root of rounding over the curvature of the fold. Near a
    curve of solutions rounding moves the solution along the curve by its size over the smallest
    singular value.
    """
    weak = arm.model.condition(theta, arm.task, arm.axis)
    fold = np.sqrt(
        32.0 * ROUNDING / np.maximum(arm.model.curvature(theta, arm.task, arm.axis), 1e-12)
    )
    return SAME + np.where(curve, 10.0 * ROUNDING / np.maximum(weak, 1e-16), fold) * _unit(arm)


def _unit(arm: Arm) -> float:
    return max(1.0, arm.model.size) if (arm.model.kinds == oracle.SLIDE).any() else 1.0


def assert_found_near_singular(arm: Arm, seed: int, number: int, missed: int | None = None):
    """The answer for configurations moved off random singular ones by 1e-12 to 1e-3: these are
    among the solutions.

    As many as that may be missed where the answer is not complete, by default any number.
    """
    theta, curve = near_singular(arm, seed, number, 10.0 ** -np.arange(3, 13))
    far = allowed(arm, theta, curve[:, None]).ravel()
    theta = theta.reshape(-1, arm.model.n)
    X = arm.model.pose(theta)
    answer = ask(arm, X)
    assert_true(arm, answer, X)
    q = np.zeros((len(X), arm.system.nq))
    q[:, arm.model.index] = (theta - arm.model.offset) / arm.model.multiplier
    assert_found(arm, answer, q, far, len(q) if missed is None else missed)
    return answer
