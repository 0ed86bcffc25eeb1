"""Families of solutions of `ik_all`: self-motions, along which a target stays reached.

A solution whose Jacobian is singular lies on a family if there are others on target around it, in
more than two places. Curves are followed by the tracer of `kempe.numerics.curves`, surfaces are
sampled by a random walk.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from kempe.answers import wording
from kempe.arguments import explain_method_errors
from kempe.arrays import is_whole, read_reals
from kempe.errors import InputError
from kempe.inverse.closed_forms.descent import Aim
from kempe.inverse.closed_forms.plan import SEARCH
from kempe.inverse.nearest import list_held_coordinates, make_aim
from kempe.kernels.closed_form import analytic_layout as A
from kempe.model.configurations import shorten_turns
from kempe.numerics.curves import (
    NONE,
    Curve,
    Node,
    find_next_nodes,
    has_returned,
    join_ways,
    walk_curve,
)
from kempe.numerics.newton import GaussNewtonEnd, run_gauss_newton, run_many_gauss_newton
from kempe.numerics.rank import Spectrum
from kempe.spatial import Array
from kempe.words import InWords, join_words, spell_count

if TYPE_CHECKING:
    from kempe.inverse.all_answer import Solutions

SINGULAR = 1e-5
"""Singular values of the Jacobian below this (radians, lengths of the chain) may be zero: whether
the chain can move is decided by moving."""

UNDETERMINED = 5e-9
"""Smallest singular value below which rounding of the target moves a solution by 1e8 times as much.
The part of the curve that is on target within the tolerance then counts as a family."""

CORRECTIONS = 12
ROUNDING = 3e-14
"""Corrections of a point at most, and the error that is rounding."""

SLACK = 1.01
"""How much more than the tolerance the error may be along a family."""

LONG = 1e3
"""Length of a tool, in lengths of the chain, from which errors are measured at the last axis: at
the tip, a turn that is hardly an error would count as a large one."""

REACH = 0.05
NEAR = 3e-3
"""Distance from a solution at which others are looked for, and a smaller one where the solution is
undetermined (radians, lengths of the chain)."""

STRIDE = 0.3
SPANNED = 0.2
"""Where freedoms are counted: distance of the points, in parts of the first one, and singular
values of the directions to them, in parts of the largest, that count."""

DIRECTIONS = 24
"""Directions in which others are looked for where several joints may be free."""

LONGEST = 0.12
MOST_STEPS = 6000
FAR = 50.0
"""The longest step along a curve (radians, lengths of the chain), steps at most, and how many
lengths of the chain a slide is followed."""

HOME = 0.02
"""Distance from its start, in parts of a step, at which a curve has returned to it.

It is known no better where the tolerance leaves a curve some width."""

CLOSE = 0.3
"""Second singular value of a curve below which a crossing with another is looked for."""

SAMPLES = 64
"""Samples by which a family with several freedoms is known."""

ON = 1e-5
"""Distance (radians, lengths of the chain) below which a configuration counts as one of a family."""

MOST = 64
ROOM = 48
"""Families of one target at most, and rows in which samples of them are looked for where an answer
has no room for all."""

STRAIGHT = 1e-6
MERGED = 1e-4
"""How far samples may be from a line that is called straight; joints that move less rest, where
roots have merged, those that move less than the root of the tolerance."""

EXACT = 1e-12
"""Largest error of the samples of a family that is exact [m, rad]; beyond, it holds within the
tolerance only."""

PERTURBED = 0.1
CONDITION = 1e-6
AT_ZERO = 1e-7
"""A joint that rests is a condition of a family if a change of it by PERTURBED makes the family
leave the target at this speed. Its value counts as zero below AT_ZERO: merged roots are known to the
root of rounding."""


# ---- the configurations that reach a target


@dataclass(frozen=True, eq=False)
class SolutionSet(Curve):
    """The set of configurations theta (n,) of a chain that reach a target.

    `allowed` is the error [m, rad] that is tolerated.

    `lever` (3,) leads from the point of the tip's body at which errors of `aim` are measured to the
    tip, in the tip's axes.
    """

    aim: Aim
    allowed: float
    lever: Array

    @classmethod
    def from_solutions(cls, solutions: Solutions, index: int) -> SolutionSet:
        """Make the set of target number `index`.

        Joints that were held only because they are spare may move.
        """
        aim = make_aim(solutions, index, spare=True)
        lines = aim.lines
        lever = lines.tip[:3, :3].T @ (lines.tip[:3, 3] - lines.o[-1])
        if len(aim.rows) < 6 or aim.slide_mask[-1] or np.linalg.norm(lever) <= LONG:
            return cls(aim, solutions.problem.tolerance, np.zeros(3))
        back = np.eye(4)
        back[:3, 3] = -lever
        near = replace(aim, lines=replace(lines, tip=lines.tip @ back), target=aim.target @ back)
        return cls(near, solutions.problem.tolerance, lever)

    @property
    def n(self) -> int:
        """Number of joints of the chain."""
        return len(self.aim.lines)

    def evaluate_batch(self, theta: Array) -> tuple[Array, Array]:
        """Compute residuals (N, m) and Jacobians (N, m, n) at theta (N, n).

        Columns of held joints are zero.
        """
        e, columns = self.aim.linearise_errors(theta)
        J = np.zeros((*e.shape, self.n))
        J[..., self.aim.moves] = columns
        return -e, J

    def evaluate_equations(self, x: Array) -> tuple[Array, Array]:
        """Compute residual (m,) and Jacobian (m, n) at a configuration (n,)."""
        r, J = self.evaluate_batch(x[None])
        return r[0], J[0]

    def measure_error(self, r: Array) -> float:
        """Return the larger of position error [m] and orientation error [rad] of a residual.

        The position is taken at the tip and where it is measured.
        """
        place = self.aim.rows < 3
        size = float(np.linalg.norm(r[place]))
        if self.lever.any():
            size = max(size, float(np.linalg.norm(r[:3] + np.cross(r[3:], self.lever))))
        return max(size * self.aim.lines.length, float(np.linalg.norm(r[~place])))

    def compute_short_difference(self, a: Array, b: Array) -> Array:
        """Compute the difference a - b (..., n); of angles the shortest."""
        return shorten_turns(a - b, ~self.aim.slide_mask)

    def decompose_jacobians(self, J: Array) -> tuple[Array, Array]:
        """Compute singular values (..., k) of Jacobians, ascending, and directions (..., k, n).

        Only joints that may move count.
        """
        moves = self.aim.moves
        spectrum = Spectrum(J[..., moves])
        Vt = spectrum.right
        s = spectrum.values
        values = np.zeros(Vt.shape[:-1])
        values[..., : s.shape[-1]] = s
        directions = np.zeros((*Vt.shape[:-1], self.n))
        directions[..., moves] = Vt
        return values[..., ::-1], directions[..., ::-1, :]

    def find_free_directions(self, x: Array, least: int = 1) -> Array:
        """Find orthonormal directions (d, n) in which the tip hardly moves at x (n,), freest first.

        At least `least` of them.
        """
        s, directions = self.decompose_jacobians(self.evaluate_equations(x)[1])
        return directions[: max(least, int((s <= SINGULAR).sum()))]

    def compute_tangents(self, x: Array, toward: Array) -> Array:
        """Compute orthonormal tangents (d, n) of a family at x (n,), nearest to `toward` (d, n)."""
        free = self.find_free_directions(x, len(toward))
        U, s, Vt = Spectrum(toward @ free.T @ free).thin_decomposition
        return U @ Vt if s[-1] > 0.1 else toward

    def make_node(self, x: Array, toward: Array, J: Array) -> Node:
        """Make the node at a point of a curve, its tangent in the sense of `toward` (n,)."""
        way = toward / np.linalg.norm(toward)
        return Node(x, self.compute_tangents(x, way[None])[0], 1.0, 1, NONE, NONE)

    def minimise_error(self, x: Array, across: Array) -> GaussNewtonEnd:
        """Minimise the error from x (n,), moving only across directions `across` (d, n)."""
        still = np.zeros(len(across))

        def evaluate_rows(x: Array) -> tuple[Array, Array]:
            r, J = self.evaluate_equations(x)
            return np.append(r, still), np.vstack([J, across])

        x, r, J = run_gauss_newton(evaluate_rows, x, CORRECTIONS, met=ROUNDING)
        return GaussNewtonEnd(x, r[: -len(across)], J[: -len(across)])

    def correct_point(self, x: Array, across: Array) -> GaussNewtonEnd | None:
        """Return the point on target near x (n,), moved across `across` (n,) or (d, n); or None."""
        end = self.minimise_error(x, np.atleast_2d(across))
        return end if self.measure_error(end.r) <= SLACK * self.allowed else None

    # ---- around a configuration

    def find_neighbours(self, x: Array, distance: float) -> Array:
        """Find distinct configurations (k, n) on target at a distance from x (n,)."""
        free = self.find_free_directions(x)
        if len(free) == 1:
            ways = np.concatenate([free, -free])
        else:
            c = np.random.default_rng(1).normal(size=(DIRECTIONS, len(free)))
            if len(free) == 2:
                angle = 2.0 * math.pi * (np.arange(DIRECTIONS) + 0.25) / DIRECTIONS
                c = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            ways = c @ free / np.linalg.norm(c, axis=1, keepdims=True)

        def evaluate_rows(theta: Array, _: np.ndarray) -> tuple[Array, Array]:
            away = theta - x
            size = np.linalg.norm(away, axis=1)
            r, J = self.evaluate_batch(theta)
            r[~((size > 0.3 * distance) & (size < 3.0 * distance))] = np.nan
            rows = np.concatenate([J, (away / size[:, None])[:, None]], axis=1)
            return np.concatenate([r, (size - distance)[:, None]], axis=1), rows

        theta = run_many_gauss_newton(evaluate_rows, x + distance * ways, 2 * CORRECTIONS)
        out: list[Array] = []
        for y in theta[np.isfinite(theta[:, 0])]:
            on_target = self.measure_error(self.evaluate_equations(y)[0]) <= SLACK * self.allowed
            if on_target and all(np.abs(y - z).max() >= 0.05 * distance for z in out):
                out.append(y)
        return np.reshape(out, (-1, self.n))

    def find_family_directions(self, x: Array, distance: float) -> Array:
        """Find orthonormal directions (d, n) of the family around x (n,).

        They are the null space of the Jacobian, or a part of it where roots have merged.
        """
        free = self.find_free_directions(x)
        if len(free) == 1:
            return free
        near = self.find_neighbours(x, STRIDE * distance)
        if not len(near):
            return free[:1]
        ways = (near - x) / np.linalg.norm(near - x, axis=1, keepdims=True)
        return Spectrum(ways).compute_row_space(SPANNED).T[: len(free)]

    def find_families(self, x: Array, base: Array, known: Sequence[Family]) -> list[Family]:
        """Find families through a configuration (n,), other than `known`; none if isolated."""
        s, _ = self.decompose_jacobians(self.evaluate_equations(x)[1])
        if s[0] > SINGULAR:
            return []
        distance = REACH
        near = self.find_neighbours(x, distance)
        if not len(near) and s[0] < self.singular_level:
            distance = NEAR
            near = self.find_neighbours(x, distance)
        found = list(known)
        for y in near:
            if any(family.contains(y) for family in found):
                continue
            ways = self.find_family_directions(y, distance)
            way = (y - x) / np.linalg.norm(y - x)
            samples = (
                (*self.sample_random_walk(y, ways, SAMPLES), False)
                if len(ways) > 1
                else self.trace_curve(x if (s <= SINGULAR).sum() == 1 else y, way)
            )
            # merged roots are known better once they are samples
            if samples and not any(family.contains(samples[0][0]) for family in found):
                found.append(Family.from_samples(self, base, *samples))
        return found[len(known) :]

    @property
    def singular_level(self) -> float:
        """Singular value below which a solution is not determined; lower for long chains."""
        return UNDETERMINED / max(1.0, self.aim.lines.length)

    # ---- samples

    def sample_random_walk(self, x: Array, frame: Array, count: int) -> tuple[Array, Array]:
        """Sample a random walk (m, n) from x (n,), with tangents (m, d, n) that begin as `frame`."""
        rng = np.random.default_rng(2)
        x = self.minimise_error(x, frame).x
        frame = self.compute_tangents(x, frame)
        out = [(x, frame)]
        for _ in range(count):
            way = rng.normal(size=len(frame)) @ frame
            end = self.correct_point(x + 0.6 * rng.random() * way / np.linalg.norm(way), frame)
            if end is not None:
                x = end.x
                frame = self.compute_tangents(x, frame)
                out.append((x, frame))
        return np.array([x for x, _ in out]), np.array([frame for _, frame in out])

    def trace_curve(self, x: Array, way: Array) -> tuple[Array, Array, bool] | None:
        """Trace the curve through x (n,): samples (m, n), tangents (m, 1, n), whether it closes.

        None if it leaves the target.
        """
        x, _, J = self.minimise_error(x, way[None])
        first = self.make_node(x, way, J)
        nodes, end = self._trace_half_curve(first)
        other = end
        if end != "closed":
            back, other = self._trace_half_curve(first.reverse_direction())
            nodes = join_ways(back, nodes)
        theta = np.array([a.x for a in nodes])
        if "off" in (end, other) and self.decompose_jacobians(J)[0][0] > self.singular_level:
            worst = max(map(self.measure_error, self.evaluate_batch(theta)[0]))
            if worst > 1e-3 * self.allowed:
                return None
        return theta, np.array([a.t[None] for a in nodes]), end == "closed"

    def _trace_half_curve(self, first: Node) -> tuple[list[Node], str]:
        """Trace nodes one way, with their end: "closed", "far", or "off" the target."""
        nodes = [first]
        for b in walk_curve(first, partial(find_next_nodes, self), LONGEST, REACH):
            a = nodes[-1]
            there = replace(first, x=b.x + self.compute_short_difference(first.x, b.x))
            near = HOME * float(np.linalg.norm(b.x - a.x))
            if len(nodes) > 3 and has_returned(self, a, b, there, near):
                return nodes, "closed"
            nodes.append(b)
            if np.abs(b.x - first.x)[self.aim.slide_mask].max(initial=0.0) > FAR:
                return nodes, "far"
            if len(nodes) == MOST_STEPS:
                break
        return nodes, "off"

    def find_crossings(self, theta: Array, tangents: Array) -> Iterator[Array]:
        """Find points (n,) of a curve at which others may cross it.

        The Jacobian loses one more rank there.
        """
        from scipy import optimize  # only here: most targets have no families

        if len(self.aim.moves) < 2:
            return
        size = self.decompose_jacobians(self.evaluate_batch(theta)[1])[0][:, 1]
        before = np.roll(size, 1)
        after = np.roll(size, -1)
        steep = size <= np.maximum(before, after) - size  # a zero nearby leaves such a kink
        for k in np.flatnonzero((size <= before) & (size <= after) & (size < CLOSE) & steep):

            def compute_point(
                s: float, x: Array = theta[k], way: Array = tangents[k]
            ) -> GaussNewtonEnd:
                return self.minimise_error(x + s * way[0], way)

            def compute_second_value(s: float, point: Any = compute_point) -> float:
                return float(self.decompose_jacobians(point(s).J)[0][1])

            least = cast(Any, optimize).minimize_scalar(
                compute_second_value,
                bounds=(-LONGEST, LONGEST),
                method="bounded",
                options={"xatol": 1e-8},
            )
            if least.fun < SINGULAR:
                yield compute_point(least.x).x


# ---- a family


@explain_method_errors
@dataclass(frozen=True, eq=False)
class Family(InWords):
    """Connected set of infinitely many configurations that reach a target, limits ignored.

    Attributes
    ----------
    freedoms
        Dimension of the set.
    q
        Samples (m, nq). On a curve they are in order, with continuous angles; if `closed`, the
        first sample follows the last one.
    basis
        Unit tangents (freedoms, nq) at the first sample.
    joints
        Names of the joints that move.
    residual
        Largest error of the samples in metres and radians.

    Notes
    -----
    `sample` gives any number of members. ``ik_all(..., fixed={...})`` gives the members with given
    values of some joints.
    """

    freedoms: int
    q: Array
    closed: bool
    basis: Array
    joints: tuple[str, ...]
    residual: float
    _set: SolutionSet = field(repr=False)
    _theta: Array = field(repr=False)
    _tangents: Array = field(repr=False)
    _base: Array = field(repr=False)
    _width: float = field(repr=False)
    """How far from its samples joints may be that rest (radians, lengths of the chain)."""

    @classmethod
    def from_samples(
        cls, target: SolutionSet, base: Array, theta: Array, tangents: Array, closed: bool
    ) -> Family:
        """Make the family with samples theta (m, n) and tangents (m, d, n).

        Joints outside the chain are as in `base` (nq,).
        """
        lines = target.aim.lines
        freedoms = tangents.shape[1]
        basis = np.zeros((freedoms, len(base)))
        basis[:, lines.q_index] = tangents[0] / lines.multiplier
        basis /= np.linalg.norm(basis, axis=1, keepdims=True)
        merged = len(target.find_free_directions(theta[0])) > freedoms
        width = MERGED if merged else STRAIGHT
        moved = np.ptp(theta, axis=0) > width
        joints = tuple(n for n, m in zip(lines.names, moved, strict=True) if m)
        residual = max(map(target.measure_error, target.evaluate_batch(theta)[0]))
        q = _fill_configurations(target, theta, base)
        return cls(
            freedoms, q, closed, basis, joints, residual, target, theta, tangents, base, width
        )

    def __len__(self) -> int:
        return len(self.q)

    def sample(self, n: int) -> Array:
        """Sample members (n, nq): evenly along a curve, by a random walk in other families."""
        if not is_whole(n) or n < 1:
            raise InputError(f"n is {n!r}; it must be a whole number from 1")
        target = self._set
        if self.freedoms > 1:
            members = self._theta[:1]
            while len(members) < n:
                count = 2 * max(n, len(members))
                members = target.sample_random_walk(self._theta[0], self._tangents[0], count)[0]
            return _fill_configurations(target, members[:n], self._base)
        x = self._theta
        t = self._tangents
        if self.closed:
            x = np.vstack([x, x[-1] + target.compute_short_difference(x[0], x[-1])])
            t = np.concatenate([t, t[:1]])
        arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1)))
        theta: list[Array] = []
        ends = n if self.closed else max(1, n - 1)
        for i in range(n):
            s = float(arc[-1]) * i / ends
            k = int(np.sum(arc <= s)) - 1
            theta.append(target.minimise_error(x[k] + (s - arc[k]) * t[k, 0], t[k]).x)
        return _fill_configurations(target, np.array(theta), self._base)

    def distance(self, q: ArrayLike) -> Any:
        """Compute the distance of configurations (..., nq) from the family.

        It is the largest difference of a joint [rad, m].

        Angles count modulo turns.
        """
        q = read_reals(q, "q")
        lines = self._set.aim.lines
        theta = lines.compute_theta(q[..., lines.q_index]).reshape(-1, len(lines))
        far = np.array(
            [np.abs(self._compute_difference(x) / lines.multiplier).max() for x in theta]
        )
        return float(far[0]) if q.ndim == 1 else far.reshape(q.shape[:-1])

    def contains(self, theta: Array) -> bool:
        """Return whether the chain variables (n,) belong to a member of the family."""
        away = np.abs(self._set.compute_short_difference(self._theta, theta)).max(axis=1).min()
        if self.freedoms == 1 and away > 1.0:
            return False
        return bool(np.abs(self._compute_difference(theta)).max() < max(ON, self._width))

    def _compute_difference(self, theta: Array) -> Array:
        """Compute the difference (n,) of theta from the nearest member, found by a walk."""
        target = self._set
        away = target.compute_short_difference(theta, self._theta)
        k = int(np.argmin((away**2).sum(axis=1)))
        x = self._theta[k]
        frame = self._tangents[k]
        rest = target.compute_short_difference(theta, x)
        part = 1.0  # of the way: the whole one may lead beyond, where the family is bent
        for _ in range(MOST_STEPS):
            far = float(np.linalg.norm(rest))
            way = (frame @ rest) @ frame
            size = float(np.linalg.norm(way))
            if not size > max(1e-12, 1e-6 * far) or part < 1e-3:
                break
            end = target.correct_point(x + way * min(part, STRIDE / size), frame)
            if end is None:
                break
            nearer = target.compute_short_difference(theta, end.x)
            if not np.linalg.norm(nearer) < far:
                part = 0.5 * min(part, STRIDE / size)
                continue
            x = end.x
            rest = nearer
            frame = target.compute_tangents(x, frame)
        return rest

    @cached_property
    def text(self) -> str:
        """Description of the motion, such as "q4 + q6 = 1.234 while q5 = 0"."""
        text = self._describe_motion()
        return text if self.residual <= EXACT else f"{text} (on target within {self.residual:.1g})"

    def _describe_motion(self) -> str:
        """Describe the motion of the family as if it were exact."""
        lines = self._set.aim.lines
        names = list(self.joints)
        if self.freedoms > 1:
            return f"{join_words(names)} can move"
        place = [lines.names.index(name) for name in names]
        x = self._theta[:, place] - self._theta[0, place]
        way = x[np.argmax(np.abs(x).sum(axis=1))]
        way = way / np.linalg.norm(way)
        q = self.q[0, lines.q_index]
        if np.abs(x - np.outer(x @ way, way)).max() <= STRAIGHT:
            slopes = way / lines.multiplier[place]
            at_rest = {lines.names[i]: float(q[i]) for i in self._list_conditions()}
            return wording.describe_linear_motion(
                names,
                _fit_equations(names, slopes, q[place]),
                [(name, 0.0 if abs(x) < AT_ZERO else x) for name, x in at_rest.items()],
            )
        way_round = self._theta[-1] - self._set.compute_short_difference(
            self._theta[-1], self._theta[0]
        )
        turns = [round(float(x) / (2.0 * math.pi)) for x in (way_round - self._theta[0])[place]]
        once = [i for i, k in enumerate(turns) if abs(k) == 1]
        turning = self.closed and bool(once)
        first = once[0] if turning else 0
        values = self.q[:, lines.q_index[place[first]]]
        ends = float(values.min()), float(values.max())
        return wording.describe_curved_motion(names, names[first], turning, self.closed, ends)

    def _list_conditions(self) -> list[int]:
        """List joints at rest whose values the family requires."""
        names = self._set.aim.lines.names
        at_rest = [i for i in self._set.aim.moves.tolist() if names[i] not in self.joints]
        others = self._theta[0] + PERTURBED * np.eye(self._set.n)[at_rest]
        speeds = self._set.evaluate_batch(others)[1] @ self._tangents[0, 0]
        return [i for i, v in zip(at_rest, speeds, strict=True) if np.abs(v).max() > CONDITION]

    def __str__(self) -> str:
        return f"{self.text}: {spell_count(self.freedoms, 'freedom')}"


def _fit_equations(names: list[str], slopes: Array, values: Array) -> list[dict[str, float]]:
    """Fit linear equations, each of two joints, to a straight line.

    Coefficients are by joint, the right side under "".
    """
    out: list[dict[str, float]] = []
    for name, slope, value in zip(names[1:], slopes[1:], values[1:], strict=True):
        size = min(abs(slope), abs(slopes[0])) * -math.copysign(1.0, slope)
        a = round(float(-slope / size), 9)
        b = round(float(slopes[0] / size), 9)
        out.append({names[0]: a, name: b, "": float(a * values[0] + b * value)})
    return out


def _fill_configurations(target: SolutionSet, theta: Array, base: Array) -> Array:
    """Fill configurations (m, nq) with variables (m, n); other joints are as in `base` (nq,)."""
    lines = target.aim.lines
    q = np.tile(base, (len(theta), 1))
    q[:, lines.q_index] = (theta - lines.offset) / lines.multiplier
    return q


# ---- the families of a target


def find_families(solutions: Solutions, index: int) -> tuple[list[Family], np.ndarray]:
    """Find the families of target number `index`, and the family's number of each row (K,).

    The number is -1 for isolated solutions.

    A row belongs to a family if the Jacobian of the task is singular there and the chain can move
    away from it without leaving the target: exactly, or within the tolerance, all the way round or,
    where rounding leaves the solution itself undetermined, for a part of it. Joints that were
    locked only because the chain has more than it needs may move.
    """
    numbers = np.full(len(solutions._rows[index]), -1, dtype=np.int64)
    used = np.flatnonzero(solutions._used_rows[index])
    if not len(used):
        return [], numbers
    target = SolutionSet.from_solutions(solutions, index)
    if not len(target.aim.moves):
        return [], numbers
    lines = target.aim.lines
    theta = lines.compute_theta(solutions._rows[index][used, : len(lines)])
    weak = target.decompose_jacobians(target.evaluate_batch(theta)[1])[0][:, 0] < SINGULAR
    base = solutions._base[index if len(solutions._base) > 1 else 0]
    families: list[Family] = []

    def find_family_number(x: Array) -> int:
        return next((i for i, family in enumerate(families) if family.contains(x)), -1)

    for x in (*theta[weak], *_read_left_out_samples(solutions, index)):
        starts = [x] if find_family_number(x) < 0 else []
        while starts and len(families) < MOST:
            for family in target.find_families(starts.pop(), base, families):
                families.append(family)
                if family.freedoms == 1:
                    starts += target.find_crossings(family._theta, family._tangents)
    numbers[used[weak]] = [find_family_number(x) for x in theta[weak]]
    return families, numbers


def _read_left_out_samples(solutions: Solutions, index: int) -> Array:
    """Read variables (k, n) of family samples for which the answer had no room.

    Isolated solutions may be among them.
    """
    plan = solutions.plan
    n = len(plan.lines)
    sampled = solutions._used_rows[index] & (solutions._code[index] < A.MULTIPLICITY_UNIT)
    if plan.method == SEARCH or not (sampled.any() and solutions._used_rows[index].all()):
        return np.zeros((0, n))
    target = make_aim(solutions, index).target[None]
    near = solutions._base[index if len(solutions._base) > 1 else 0]
    target[0, :3, 3] = target[0, :3, 3] * plan.lines.length + plan.lines.origin
    out = np.empty((1, ROOM, n + A.INFO))
    tolerance = solutions.problem.tolerance
    plan.fill_solutions(
        target,
        np.ascontiguousarray(near[plan.lines.q_index])[None],
        list_held_coordinates(solutions, index)[None],
        tolerance,
        tolerance,
        0,
        np.arange(1),
        out,
        np.zeros((1, 2), dtype=np.int64),
    )
    code = out[0, :, n + A.CODE]
    return plan.lines.compute_theta(out[0, (code >= 0.0) & (code < A.MULTIPLICITY_UNIT), :n])
