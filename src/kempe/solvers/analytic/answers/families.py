"""Self-motions: curves, and surfaces, of configurations that all reach one target."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from kempe.calls import explained_methods
from kempe.errors import InputError, UnknownNameError
from kempe.kernels.closed_form import analytic_layout as A
from kempe.reals import reals
from kempe.singular_values import svd
from kempe.solvers.analytic.answers.family_curves import TolerantMotion
from kempe.solvers.analytic.answers.family_points import SINGULAR
from kempe.solvers.analytic.answers.nearest import Aim, aim_of, held_coordinates
from kempe.solvers.analytic.plans.plan import kernel_of
from kempe.spatial import Array
from kempe.words import InWords, counted, in_words, verb

if TYPE_CHECKING:
    from kempe.solvers.analytic.answers.solutions import Solutions

ON = 1e-5
"""Distance (radians, lengths of the chain) below which a solution counts as one of a family."""

MOST = 64
ROOM = 48
"""Families of one target at most; rows in which their samples are looked for, where an answer has
no room for all."""

STRAIGHT = 1e-6
"""How far samples may be from a straight line in a family that is called linear; joints that move
less rest."""

MERGED = 1e-4
"""Joints that move less rest where roots have merged, which the tolerance leaves open to its
root."""

EXACT = 1e-12
"""Largest error of the samples of a family that is exact [m, rad]; beyond, it holds within the
tolerance only."""


@explained_methods
@dataclass(frozen=True, eq=False)
class Family(InWords):
    """A connected set of infinitely many configurations that reach a target; limits are ignored.

    `dimension` is the number of its freedoms. `q` (m, nq) are samples: along a curve in their
    order, angles continuous, and if it is `closed` the first one follows the last; of a family with
    more freedoms some, in any order. `basis` (dimension, nq) are unit vectors along it at the first
    sample. `joints` are those that move; `parameter` is a joint whose value (modulo a turn) picks
    one configuration of a curve, None where there is none. `residual` is the largest error of the
    samples [m, rad].
    """

    dimension: int
    q: Array
    closed: bool
    basis: Array
    joints: tuple[str, ...]
    parameter: str | None
    residual: float
    _motion: TolerantMotion = field(repr=False)
    _theta: Array = field(repr=False)
    _base: Array = field(repr=False)

    @property
    def tangent(self) -> Array:
        """The unit vector (nq,) along a curve at its first sample."""
        return self.basis[0]

    def __len__(self) -> int:
        return len(self.q)

    def at(self, **values: ArrayLike) -> Array:
        """Configurations of the family in which joints have given values: (nq,) where there is one,
        (k, nq) of several.

        As many joints are named as the family has freedoms; of more freedoms than one, one such
        configuration is given. An array (m,) of values of the `parameter`, or another joint with
        one configuration for each, gives (m, nq). Errors: `InputError` where there is none, or for
        a wrong number of joints; `UnknownNameError`.
        """
        names = self._motion.aim.lines.names
        if len(values) != self.dimension:
            given = f"{counted(len(values), 'joint')} {verb(len(values), 'is', 'are')} given"
            raise InputError(f"{given}; the family has {in_words(self.dimension, 'freedom')}")
        for name in values:
            if name not in names:
                raise UnknownNameError("joint", name, names, "the chain")
        values = {name: reals(v, f"joint {name!r}") for name, v in values.items()}
        if not all(np.isfinite(v).all() for v in values.values()):
            raise InputError("values of joints must be finite")
        if self.dimension > 1:
            return self._full(self._hold({n: float(np.asarray(v)) for n, v in values.items()}))
        ((name, value),) = values.items()
        wanted = reals(value, f"joint {name!r}")
        if wanted.ndim == 0:
            found = self._crossings(name, float(wanted))
            return found[0] if len(found) == 1 else found
        each = [self._crossings(name, float(x)) for x in wanted]
        if any(len(found) > 1 for found in each):
            raise InputError(
                f"{name!r} does not tell the configurations of the family apart; give one value"
            )
        return np.concatenate([np.zeros((0, self.q.shape[1])), *each])

    def distance(self, q: ArrayLike) -> Any:
        """How far configurations (..., nq) are from the family: the largest difference of a joint
        [rad, m].

        Angles count modulo turns. Of a family with more freedoms than one, the distance to the next
        configuration that reaches the target.
        """
        q = reals(q, "q")
        lines = self._motion.aim.lines
        theta = lines.theta(q[..., lines.q_index])
        flat = np.array([self._apart(x) for x in theta.reshape(-1, len(lines))])
        return float(flat[0]) if q.ndim == 1 else flat.reshape(q.shape[:-1])

    def describe(self) -> str:
        """What moves, and how: "q4 + q6 = 1.234 while q5 = 0: one freedom"."""
        from kempe.solvers.analytic.answers.explain_ik_all import family_sentence

        return family_sentence(self)

    def __str__(self) -> str:
        return self.describe()

    @cached_property
    def equations(self) -> list[dict[str, float]] | None:
        """Linear equations of a curve that is straight: coefficients by joint, "" for the right
        side; None if it bends.

        Each has two joints, the first of which is the same in all of them.
        """
        lines = self._motion.aim.lines
        if self.dimension > 1 or not self.joints:
            return None
        at = [lines.names.index(n) for n in self.joints]
        x = self._theta[:, at] - self._theta[0, at]
        way = x[np.argmax(np.abs(x).sum(axis=1))]
        way = way / np.linalg.norm(way)
        if np.abs(x - np.outer(x @ way, way)).max() > STRAIGHT:
            return None
        first = at[0]
        out: list[dict[str, float]] = []
        slope = way / lines.multiplier[at]
        for k in range(1, len(at)):
            a = -slope[k]
            b = slope[0]
            size = min(abs(a), abs(b)) * math.copysign(1.0, a)
            a, b = (round(float(c / size), 9) + 0.0 for c in (a, b))
            q = self.q[0, lines.q_index]
            out.append(
                {self.joints[0]: a, self.joints[k]: b, "": float(a * q[first] + b * q[at[k]])}
            )
        return out

    # ---- inside

    def _full(self, theta: Array) -> Array:
        """Configurations (..., nq) of variables (..., n)."""
        out = np.broadcast_to(self._base, (*theta.shape[:-1], len(self._base))).copy()
        out[..., self._motion.aim.lines.q_index] = in_turn(self._motion, theta, self._base)
        return out

    def _crossings(self, name: str, value: float) -> Array:
        """Configurations (k, nq) of a curve in which a joint has a value. Errors: `InputError`."""
        lines = self._motion.aim.lines
        i = lines.names.index(name)
        theta = self._motion.crossings(
            self._theta, self.closed, i, value * lines.multiplier[i] + lines.offset[i]
        )
        if not len(theta):
            x = (self._theta[:, i] - lines.offset[i]) / lines.multiplier[i]
            raise InputError(
                f"the family has no configuration with {name} = {value:.6g}; it goes from "
                f"{x.min():.6g} to {x.max():.6g}"
            )
        q = self._full(theta)
        q[:, lines.q_index[i]] = value
        return q

    def _hold(self, values: dict[str, float]) -> Array:
        """Variables (n,) of a configuration in which joints have values. Errors: `InputError`."""
        lines = self._motion.aim.lines
        at = [lines.names.index(n) for n in values]
        wanted = np.array(list(values.values())) * lines.multiplier[at] + lines.offset[at]
        theta = self._motion.held(self._theta, at, wanted)
        if theta is None:
            raise InputError(f"no configuration of the family was found with {values}")
        return theta

    def _apart(self, theta: Array) -> float:
        """The largest difference of a joint between variables (n,) and the family, in radians and
        metres of q.
        """
        motion = self._motion
        if not np.isfinite(theta).all():
            return math.nan
        if self.dimension == 1:
            nearest = motion.nearest_on(self._theta, theta)
        else:
            nearest = motion.projected(theta, self.dimension)
        apart = np.abs(motion.gap(nearest, theta) / motion.aim.lines.multiplier)
        away = (
            np.abs(motion.gap(self._theta, theta) / motion.aim.lines.multiplier).max(axis=1).min()
        )
        return float(min(apart.max(), away))


def families_of(solutions: Solutions, index: int) -> tuple[list[Family], np.ndarray]:
    """The families of target number `index`, and for each row (K,) of its answer the number of its
    family, or -1.

    A row belongs to a family if the Jacobian of the task is singular there and the chain can move
    away from it without leaving the target: exactly, or within the tolerance, all the way round or,
    where rounding leaves the solution itself undetermined, for a part of it. Joints that were
    locked only because the chain has more than it needs may move. The Jacobian's null space says
    where to start; then each curve is followed (predictor and corrector: Allgower and Georg, 1990).
    """
    plan = solutions.plan
    numbers = solutions._rows[index]
    used = solutions._used[index]
    row_family = np.full(len(numbers), -1, dtype=np.int64)
    if not used.any():
        return [], row_family
    aim = aim_of(solutions, index, spare=True)
    rows = np.flatnonzero(used)
    theta = plan.lines.theta(numbers[rows, : len(plan.lines)])
    motion = TolerantMotion(aim, solutions.question.tolerance)
    J = aim.at(theta)[1]
    if J.shape[2] == 0:
        return [], row_family
    J = motion.shift @ J if len(motion.shift) else J
    if J.shape[1] >= J.shape[2]:
        weak = svd(J, compute_uv=False)[:, -1] < SINGULAR
        rows = rows[weak]
        theta = theta[weak]
    base = solutions._base[index if len(solutions._base) > 1 else 0]
    families: list[Family] = []
    for row, x in zip(rows, theta, strict=True):
        number = _known(families, motion, x)
        if number < 0:
            first = len(families)
            _collect(families, motion, x, base)
            number = _known(families[first:], motion, x)
            number += first if number >= 0 else 0
        row_family[row] = number
    for x in _left_out(solutions, index, aim):
        if _known(families, motion, x) < 0:
            _collect(families, motion, x, base)
    return families, row_family


def _left_out(solutions: Solutions, index: int, aim: Aim) -> Array:
    """Variables (k, n) of samples of families for which the answer had no room, others among them."""
    plan = solutions.plan
    n = len(solutions.plan.lines)
    sampled = solutions._used[index] & (solutions._code[index] < A.MULTIPLICITY_UNIT)
    if plan.method == "search" or not (sampled.any() and solutions._used[index].all()):
        return np.zeros((0, n))
    target = aim.target[None].copy()
    near = solutions._base[index if len(solutions._base) > 1 else 0]
    target[0, :3, 3] = target[0, :3, 3] * plan.lines.length + plan.lines.origin
    out = np.empty((1, ROOM, n + A.INFO))
    counts = np.zeros((1, 2), dtype=np.int64)
    tolerance = solutions.question.tolerance
    locked = held_coordinates(solutions, index)[None]
    kernel_of(plan)(
        plan.ints,
        plan.floats,
        target,
        np.ascontiguousarray(near[plan.lines.q_index])[None],
        locked,
        tolerance,
        tolerance,
        0,
        np.arange(1),
        out,
        counts,
    )
    code = out[0, :, n + A.CODE]
    return plan.lines.theta(out[0, (code >= 0.0) & (code < A.MULTIPLICITY_UNIT), :n])


def _collect(families: list[Family], motion: TolerantMotion, theta: Array, base: Array) -> None:
    """Add the families on which variables (n,) lie, and those that cross them."""

    def known(x: Array) -> bool:
        return any(f.dimension == 1 and _on(f, motion, x) for f in families)

    starts = [theta]
    while starts and len(families) < MOST:
        for curve in motion.through(starts.pop(), known):
            if any(
                f.dimension == curve.dimension and _on(f, motion, curve.theta[0]) for f in families
            ):
                continue
            families.append(_family(motion, curve, base))
            starts += motion.crossings_of(curve) if curve.dimension == 1 else []


def in_turn(motion: TolerantMotion, theta: Array, base: Array) -> Array:
    """Coordinates (..., n) of variables, of each angle the turn that is inside the limits and near
    `base` (nq,).
    """
    lines = motion.aim.lines
    q = (theta - lines.offset) / lines.multiplier
    near = base[lines.q_index]
    (low, high) = lines.limits
    turn = np.where(motion.aim.slides, 0.0, 2.0 * math.pi / np.abs(lines.multiplier))
    unit = np.where(turn > 0.0, turn, 1.0)
    x = q + turn * np.round((near - q) / unit)
    y = x - turn * np.ceil(np.maximum(x - high, 0.0) / unit)
    y = y + turn * np.ceil(np.maximum(low - y, 0.0) / unit)
    return np.where((y >= low) & (y <= high), y, x)


def _known(families: list[Family], motion: TolerantMotion, theta: Array) -> int:
    """The number of the family on which variables (n,) lie, or -1."""
    return next((i for i, f in enumerate(families) if _on(f, motion, theta)), -1)


def _on(family: Family, motion: TolerantMotion, theta: Array) -> bool:
    if family.dimension > 1:
        return motion.joined(theta, family._theta, family.dimension)
    if np.abs(motion.gap(family._theta, theta)).max(axis=1).min() > 1.0:
        return False
    nearest = motion.nearest_on(family._theta, theta)
    return bool(np.abs(motion.gap(nearest, theta)).max() < ON)


def _family(motion: TolerantMotion, curve: Any, base: Array) -> Family:
    """A family with names and units."""
    lines = motion.aim.lines
    theta = curve.theta
    first = lines.theta(in_turn(motion, theta[0], base))
    turns = 2.0 * math.pi * ((first - theta[0]) / (2.0 * math.pi)).round()
    theta = theta + np.where(motion.aim.slides, 0.0, turns)
    q = np.tile(base, (len(theta), 1))
    q[:, lines.q_index] = (theta - lines.offset) / lines.multiplier
    basis = np.zeros((curve.dimension, len(base)))
    basis[:, lines.q_index] = curve.basis / lines.multiplier
    basis /= np.linalg.norm(basis, axis=1, keepdims=True)
    merged = len(motion.null_space(motion.linear(theta[0])[1], 0)) > curve.dimension
    moved = np.ptp(theta, axis=0) > (MERGED if merged else STRAIGHT)
    joints = tuple(n for n, m in zip(lines.names, moved, strict=True) if m)
    parameter = motion.parameter(curve) if curve.dimension == 1 else None
    residual = float(curve.residual)
    return Family(
        curve.dimension,
        q,
        curve.closed,
        basis,
        joints,
        None if parameter is None else lines.names[parameter],
        residual,
        motion,
        theta,
        base,
    )
