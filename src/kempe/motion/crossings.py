"""Singular points of a curve of configurations: where they are, and which branches meet there.

Also curves along which the rank is low throughout.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from kempe.equations.closure import LEAST, Closure, DrivenClosure
from kempe.numerics.clock import TimeLimit
from kempe.numerics.curves import NONE, Node, correct_point, find_next_node, make_node
from kempe.numerics.newton import run_gauss_newton, run_many_gauss_newton, solve_least_squares
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

DIFFERENCE = 1e-5
"""Step of the central differences of the Jacobian; error about 1e-10, which only slows Newton's
method."""
SINGULAR = 1e-11
"""Residual below which a point counts as singular: lengths given with eleven digits cross, not
nearly cross."""
PROBE = 2e-3
"""Distance at which a direction is checked to be that of a branch."""
SAME_LINE = 1e-4
"""Directions nearer than this are one."""
NO_FORM = 1e-7
"""Size of second-order forms up to which they are errors of differences."""
DOUBLE = 1e-3
"""Derivative of the second-order forms, relative to their size, below which a direction counts as
double."""
AHEAD = 0.8
"""Cosine between a chord and the direction of a branch at a singular point for them to be the same
branch."""

REACH = 0.1
"""Distance from a singular point within which a curve may be hidden by rounding, or steps become
too short."""
RADII = (0.02, 0.06, 0.2, 0.4)
"""Radii of the spheres, in radians and characteristic lengths: branches that touch closely part
farther out."""
INWARDS = 0.8 ** np.arange(12)
LEAST_SAMPLES = 6
"""Parts of the radius at which a half-branch is sampled, and the least number of samples of one
that is used."""
PARTED = 5e-7
"""Singular value, relative to the largest and to 1, above which a sample is regular: rounding of
equations moves points of the curve by less than the distance of another branch then."""
CIRCLE = 128
CHORDS = 40
HALVINGS = 24
"""Directions on a circle in the null space, most steps of a chord iteration, and halvings of an
interval."""
STARTS = 32
MOST_STARTS = 512
LOOKS = 3
MOST_SEARCHED = 6
"""Starts on a sphere in the null space, times 2 to the power of its dimension, most of them,
repetitions, and the dimension above which these are too few."""
VALLEY = 32
CLUSTER = 0.4
"""Places along a valley, and the part of its length within which roots belong to the point at its
center."""
MOST_NUMBERS = 10**7
"""Most numbers of the Jacobians of one such batch."""
LINE_STARTS = 40
MOST_DOUBLINGS = 8
MOST_LINES = 128
"""Starts for lines along which forms vanish, times 2 to the power of their dimension or of this one,
and the lines after which the search ends: a flat row of n parallelograms has 2^n branches."""
DEGREE = 8
"""Degree of the polynomials that describe both halves of a branch."""
UNLIKE = 1e-3
"""Deviation of samples from a polynomial, as a part of the radius, above which two halves are not
one branch."""
CLEAR = 5.0
"""How many times better two halves of a branch must fit than other pairs do."""
ALONG = 0.5
"""Cosine between the tangents of two halves that continue each other, or leave side by side."""
SURE = 0.3
ALIKE = 0.1
"""Distance of a point from its half-branch, as parts of that from the next one and of that from the
center."""
RESTS = 1e-6
"""Entries of the tangent of a cusp below this are zero."""


# ---- singular points and tangent cones

# At a singular point of the constraints the Jacobian loses rank: there are more null directions
# than the curve has, and as many new combinations of equations that vanish to first order. Their
# second-order forms on the null space tell the directions of the branches: the tangent cone
# (Müller, *J. Mechanisms Robotics* 8, 2016; Allgower, Georg, 1990, 8.3).


def differentiate_jacobian(equations: Closure, x: Array, left: Array, along: Array) -> Array:
    """Compute the derivatives (n, k, d) of `J.T @ left` along the columns of `along` (n, d).

    `left` is (rows, k).
    """
    out = np.empty((equations.n, left.shape[1], along.shape[1]))
    for j in range(along.shape[1]):
        y = DIFFERENCE * along[:, j]
        change = equations.compute_jacobian(
            equations.move_point(x, y)
        ) - equations.compute_jacobian(equations.move_point(x, -y))
        out[:, :, j] = change.T @ left / (2.0 * DIFFERENCE)
    return out


def locate_singular_point(
    equations: Closure, x: Array, nullity: int, reach: float, tries: int = 20
) -> Array | None:
    """Find the singular point near `x` at which the null space has dimension `nullity`.

    The loops are closed there, and it is at most `reach` away.

    Newton's method on the equations together with ``J.T @ left = 0`` and a normalisation of the
    left null vectors, which is regular where branches cross transversally (Moore, *Numer. Funct.
    Anal. Optim.* 1980). None where there is no such point.
    """
    n = equations.n
    left = Spectrum(equations.compute_jacobian(x)).left[:, n - nullity :]
    rows, k = left.shape
    fixed = left
    start = x
    nq = len(x)

    def evaluate_equations(z: Array) -> tuple[Array, Array]:
        """Return the residuals at z, coordinates and left null vectors, and the Jacobian there."""
        F, J = equations.evaluate_equations(z[:nq])
        near = np.linalg.norm(equations.compute_difference(start, z[:nq])) <= reach
        return np.concatenate([F, (z[nq:].reshape(k, rows) @ J).ravel()]) if near else np.full(
            1, np.inf
        ), J

    def compute_newton_step(z: Array, missing: Array, J: Array) -> Array:
        """Compute Newton's step for coordinates and left null vectors."""
        x = z[:nq]
        left = z[nq:].reshape(k, rows).T
        A = np.zeros((rows + n * k + k * k, n + rows * k))
        A[:rows, :n] = J
        A[rows : rows + n * k, :n] = (
            differentiate_jacobian(equations, x, left, np.eye(n))
            .transpose(1, 0, 2)
            .reshape(n * k, n)
        )
        for i in range(k):
            columns = slice(n + rows * i, n + rows * (i + 1))
            A[rows + n * i : rows + n * (i + 1), columns] = J.T
            A[rows + n * k + k * i : rows + n * k + k * (i + 1), columns] = fixed.T
        return solve_least_squares(A, np.concatenate([-missing, np.zeros(k * k)]))

    found = run_gauss_newton(
        evaluate_equations,
        np.append(x, left.T),
        tries,
        step=compute_newton_step,
        met=1e-15,
        move=lambda z, y: np.append(equations.move_point(z[:nq], y[:n]), z[nq:] + y[n:]),
    )
    if not found.size <= SINGULAR:
        return None
    x = found.x[:nq]
    found = _compute_nullity(equations, x)
    if found <= nullity:
        return x if found == nullity else None
    # more equations, which make it regular again
    better = locate_singular_point(equations, x, found, reach, tries)
    return x if better is None else better


def _compute_nullity(equations: Closure, x: Array) -> int:
    """Compute the dimension of the null space of scaled equations."""
    return equations.n - Spectrum(equations.compute_jacobian(x), LEAST).compute_rank(Level.CLOSED)


class TangentCone(NamedTuple):
    """Unit vectors `lines` (k, n), of either sign: along these directions of the null space the
    equations hold to second order.

    `degenerate` says whether some are double, or second order does not tell any: then they need not
    be tangents of branches. Where it is not `complete` the search ended early.
    """

    lines: Array
    degenerate: bool
    complete: bool = True


def compute_tangent_cone(equations: Closure, x: Array, toward: Array | None = None) -> TangentCone:
    """Compute the tangent cone at `x`; the search begins at the direction `toward` (n,)."""
    spectrum = Spectrum(equations.compute_jacobian(x), LEAST)
    n = equations.n
    null_space = spectrum.compute_null_space(Level.CLOSED)
    d = null_space.shape[1]
    if d <= 1:
        return TangentCone(null_space.T, False)
    left = spectrum.left[:, n - d :]
    forms = np.einsum(
        "nd,nke->kde", null_space, differentiate_jacobian(equations, x, left, null_space)
    )
    forms = 0.5 * (forms + forms.transpose(0, 2, 1))
    size = np.abs(forms).max()
    if size < NO_FORM:
        return TangentCone(np.zeros((0, n)), True)
    forms = forms / size
    complete = True
    if d == 2:
        found = _solve_two_forms(forms)
    else:
        first = None if toward is None else null_space.T @ toward
        found, complete = _solve_many_forms(forms, equations.budget, first)
    # rank d - 1 where a zero is simple
    least = [Spectrum(forms @ u).values[d - 2] for u in found]
    return TangentCone(found @ null_space.T, min(least, default=1.0) < DOUBLE, complete)


def _solve_two_forms(forms: Array) -> Array:
    """Find the common real zeros (k, 2) of quadratic forms (m, 2, 2)."""
    rows = np.stack([forms[:, 0, 0], 2.0 * forms[:, 0, 1], forms[:, 1, 1]], axis=1)
    # a u^2 + b u v + c v^2, the combination of the forms that is largest
    a, b, c = Spectrum(rows).right[0]
    root = b * b - 4.0 * a * c
    if root < -1e-8:
        return np.zeros((0, 2))
    w = -0.5 * (b + np.copysign(np.sqrt(max(root, 0.0)), b))
    found = [np.array(v) / np.hypot(*v) for v in ((w, a), (c, w)) if np.hypot(*v) > 1e-6]
    lines = np.array(found if root > 1e-8 else found[:1])
    other = np.einsum("ki,mij,kj->km", lines, forms, lines)
    return lines[np.abs(other).max(axis=1) < 1e-6]


def _solve_many_forms(
    forms: Array, budget: TimeLimit, start: Array | None = None
) -> tuple[Array, bool]:
    """Find the common real zeros (k, d) of quadratic forms (m, d, d), and whether it seems that none
    is missing.

    Newton's method is used from `start` (d,), and from many starts on the sphere.
    """
    d: int = forms.shape[1]
    rng = np.random.default_rng(0)
    found = np.zeros((0, d))
    often = np.zeros(0, dtype=np.int64)

    def evaluate_forms(u: Array, _: np.ndarray) -> tuple[Array, Array]:
        """Return the values of the forms at unit vectors, and their derivatives."""
        slopes = np.concatenate([2.0 * np.einsum("mij,kj->kmi", forms, u), u[:, None]], axis=1)
        values = 0.5 * np.einsum("kmi,ki->km", slopes, u)
        values[:, -1] = 0.0
        return values, slopes

    def move_on_sphere(u: Array, y: Array) -> Array:
        """Return unit vectors moved by steps."""
        return (u + y) / np.linalg.norm(u + y, axis=1, keepdims=True)

    starts = LINE_STARTS * 2 ** min(d, MOST_DOUBLINGS)
    batch = max(1, min(MOST_STARTS, MOST_NUMBERS // forms.size))
    for first in range(0, starts, batch):
        budget.check_time()
        u = rng.normal(size=(min(batch, starts - first), d))
        if not first and start is not None and start.any():
            u[0] = start
        u = run_many_gauss_newton(
            evaluate_forms,
            u / np.linalg.norm(u, axis=1, keepdims=True),
            40,
            level=Level.ROUNDING,
            last=1e-15,
            move=move_on_sphere,
        )
        left, _ = evaluate_forms(u, np.arange(len(u)))
        u = u[np.abs(left).max(axis=1) < 1e-9]
        while len(u):
            same = np.abs(np.abs(u @ found.T) - 1.0) <= SAME_LINE
            often += same.sum(axis=0)
            u = u[~same.any(axis=1)]
            if not len(u):
                break
            if len(found) == MOST_LINES:
                return found, False
            found = np.concatenate([found, u[:1]])
            often = np.append(often, 0)
    # where each is found more than once, few are missing (Good, *Biometrika* 40, 1953)
    return found, d <= MOST_DOUBLINGS and bool((often > 1).all())


class Branches(NamedTuple):
    """Directions `lines` (k, n) of the branches through a singular point; not all of them where
    they are not `complete`.

    Where second order does not tell them there is the `germ` of the curve.
    """

    lines: Array
    germ: Germ | None = None
    complete: bool = True


def find_touching_branches(equations: Closure, x: Array) -> Germ | None:
    """Find the germ of the curve at a singular point, where second order does not tell its
    branches.
    """
    return find_germ(equations, x) if compute_tangent_cone(equations, x).degenerate else None


def find_branches(equations: Closure, x: Array, toward: Array | None = None) -> Branches:
    """Find the branches through a singular point; the search begins at the direction `toward` (n,)."""
    cone = compute_tangent_cone(equations, x, toward)
    germ = find_germ(equations, x) if cone.degenerate else None
    if germ is not None:
        return Branches(germ.lines, germ)
    lines = _select_walkable_directions(equations, x, cone.lines)
    return Branches(lines, complete=cone.complete)


def _select_walkable_directions(equations: Closure, x: Array, directions: Array) -> Array:
    """Select the directions (k, n) of the tangent cone along which the curve can be followed."""
    lines: list[Array] = []
    for t in directions:
        for sign in (1.0, -1.0):
            other = correct_point(equations, equations.move_point(x, sign * PROBE * t), t)
            if other is None:
                continue
            y = equations.compute_difference(x, other.x) * sign
            if (
                y @ t < 0.9 * np.linalg.norm(y)
                or make_node(equations, other.x, None, other.J).nullity > 1
            ):
                continue
            if all(abs(t @ v) < 1.0 - SAME_LINE for v in lines):
                lines.append(t)
            break
    return np.array(lines).reshape(-1, equations.n)


def make_singular_node(
    equations: Closure, x: Array, toward: Array, came: Array | None = None
) -> Node | None:
    """Return the node at a singular point on the branch nearest to the direction `toward` (n,).

    It is None at a cusp.

    Where several branches have that direction it is the one of the point `came` (nq,), which is
    before the other.
    """
    lines, germ, complete = find_branches(equations, x, toward)
    if germ is not None:
        before = None if came is None else germ.find_half_branch(equations, [came])
        half = int(np.argmax(germ.tangents @ toward)) if before is None else germ.partner[before]
        cosines = germ.tangents @ toward / max(float(np.linalg.norm(toward)), 1e-300)
        alike = before is None and int(np.sum(cosines > cosines[half] - SAME_LINE)) > 1
        return (
            None if cosines[half] < AHEAD or alike or germ.is_cusp(half) else germ.make_node(half)
        )
    if not len(lines):
        return None
    cosines = lines @ toward / max(float(np.linalg.norm(toward)), 1e-300)
    best = int(np.argmax(np.abs(cosines)))
    if abs(cosines[best]) < AHEAD:
        return None
    at = make_node(equations, x)
    t = lines[best] * np.sign(cosines[best])
    return Node(x, t, at.sigma, max(at.nullity, 2), at.matrix, at.image, lines, complete)


def find_passage(
    equations: Closure, points: Sequence[Array], known: Sequence[Germ], period: Array
) -> SingularNode | None:
    """Find the node at which a curve leaves a singular point where its steps became too short.

    `points` (nq,) are the last ones of the curve. Germs that are `known` come first, whole periods
    (nv,) away: where branches touch closely, rounding leaves open where exactly.
    """
    for germ in known:
        moved = germ.move_germ(equations, points[-1], period)
        if (
            np.linalg.norm(equations.compute_difference(moved.x, points[-1]))
            < np.linalg.norm(germ.samples[:, -1], axis=1).max()
        ):
            if (found := _find_leaving_node(equations, moved, points)) is not None:
                return found
    here = points[-1]
    along = equations.compute_difference(points[-2], points[-1])
    for nullity in (2, 3, 4):
        x = (
            locate_singular_point(equations, here, nullity, REACH)
            if nullity <= equations.n
            else None
        )
        germ = None if x is None else find_germ(equations, x, nullity)
        if germ is not None and nullity == 2:
            x = find_singular_center(
                equations, germ.x, germ.tangents[0], float(np.linalg.norm(germ.samples[0, 0]))
            )
            germ = None if x is None else find_germ(equations, x, nullity)
        if (found := _find_leaving_node(equations, germ, points)) is not None:
            return found
    for reach in RADII[1:]:
        x = find_singular_center(equations, here, along, reach)
        germ = None if x is None else find_germ(equations, x, 2)
        if (found := _find_leaving_node(equations, germ, points)) is not None:
            return found
    return None


def _find_leaving_node(
    equations: Closure, germ: Germ | None, points: Sequence[Array]
) -> SingularNode | None:
    """Return the node at which a curve leaves a singular point that it came to by points (nq,).

    It is None where it did not come there.
    """
    half = None if germ is None else germ.find_half_branch(equations, points)
    return None if germ is None or half is None else germ.make_node(germ.partner[half])


def find_singular_center(equations: Closure, x: Array, along: Array, reach: float) -> Array | None:
    """Find the singular point (nq,) near x (nq,) along a tangent (n,) of the curve.

    It is found where Newton's method stops early.

    Over the tangent the reduced equation has a valley, whose depth is a power of the distance from
    the point. The mean of the roots of its polynomial near by is known far better than each (Zeng,
    *Math. Comp.* 74, 2005). None where there are no roots, or the loops are not closed there.
    """
    for _ in range(3):
        z = _Sphere.make_sphere(equations, x, 2).find_valley(along, reach)
        if z is None:
            return None
        x = equations.move_point(x, z)
    return (
        x
        if np.abs(equations.compute_residuals(x)).max(initial=0.0) < equations.compute_tolerance(x)
        else None
    )


def find_crossing(equations: Closure, a: Node, b: Node) -> Node | None:
    """Find the singular point between two neighbours of one branch, or None."""
    y = equations.compute_difference(a.x, b.x)
    h = float(np.linalg.norm(y))
    f = a.sigma / max(a.sigma + b.sigma, 1e-300)
    guess = equations.move_point(a.x, f * y)
    for nullity in (2, 3, 4):
        if nullity > equations.n:
            break
        x = locate_singular_point(equations, guess, nullity, 2.0 * h)
        if x is None:
            continue
        z = equations.compute_difference(a.x, x)
        along = float(z @ y) / h
        if -1e-9 <= along <= h + 1e-9 and np.linalg.norm(z - along * y / h) <= 0.25 * h:
            return make_singular_node(equations, x, y, a.x)
    return None


# ---- half-branches

# Where the cone is degenerate, at cusps and where branches touch, small spheres around the point
# show the half-branches (Milnor, *Singular Points of Complex Hypersurfaces*, 1968, sections 2 and
# 3).


@dataclass(frozen=True, eq=False)
class Germ:
    """The half-branches of a curve at a singular point `x` (nq,), and which two are one branch.

    `samples` (k, m, n) are tangent vectors from `x` to m points on each of k half-branches, the
    farthest first, `tangents` (k, n) unit vectors along which they leave `x`, `partner` (k,) the
    index of the other half. `curves` (k, DEGREE, n) are the coefficients of polynomials without
    constant term that describe the half-branches, in the distance from `x` or its square root (at a
    cusp) or cube root, as `roots` (k,) say.
    """

    x: Array
    nullity: int
    samples: Array
    tangents: Array
    partner: tuple[int, ...]
    roots: tuple[int, ...]
    curves: Array

    @property
    def lines(self) -> Array:
        """Directions (k, n) of the branches."""
        return self.tangents[[i for i, j in enumerate(self.partner) if i < j]]

    def is_cusp(self, half: int) -> bool:
        """Tell whether a half-branch and its partner leave side by side."""
        return float(self.tangents[half] @ self.tangents[self.partner[half]]) > 0.0

    def make_node(self, half: int) -> SingularNode:
        """Return the node at `x` from which a half-branch leaves."""
        others = [i for i, j in enumerate(self.partner) if i < j and half not in (i, j)]
        lines = self.tangents[[half, *others]]
        return SingularNode(
            self.x, self.tangents[half], 0.0, self.nullity, NONE, NONE, lines, germ=self, half=half
        )

    def make_first_node(self, equations: Closure, half: int) -> Node:
        """Return the regular node of a half-branch nearest to `x`, with its tangent away from `x`."""
        z = self.samples[half, -1]
        return make_node(equations, equations.move_point(self.x, z), z)

    def move_germ(self, equations: Closure, x: Array, period: Array) -> Germ:
        """Return the germ moved by whole periods (nv,) as near as possible to a point (nq,)."""
        y = equations.compute_difference(self.x, x) * equations.unit
        turns = np.round(np.divide(y, period, out=np.zeros_like(y), where=period > 0.0))
        return replace(
            self, x=equations.system.structure.layout.integrate_velocity(self.x, turns * period)
        )

    def find_half_branch(self, equations: Closure, points: Sequence[Array]) -> int | None:
        """Find the half-branch on which points (nq,) at different distances from `x` lie.

        It is None where they do not tell.
        """
        for x in points:
            z = equations.compute_difference(self.x, x)
            size = float(np.linalg.norm(z))
            if size > np.linalg.norm(self.samples[:, 0], axis=1).min():
                continue
            gaps = np.array(
                [
                    np.linalg.norm(_compute_powers(np.array([size]), self.roots[i]) @ c - z)
                    for i, c in enumerate(self.curves)
                ]
            )
            first, second = np.argsort(gaps)[:2]
            if gaps[first] < min(SURE * gaps[second], ALIKE * size):
                return int(first)
        return None


@dataclass(frozen=True, eq=False)
class SingularNode(Node):
    """A node at the singular point of a germ, on one of its half-branches."""

    germ: Germ = field(kw_only=True, repr=False)
    half: int = field(kw_only=True)

    def reverse_direction(self) -> SingularNode:
        """Return the same point with the opposite direction."""
        return replace(self, t=-self.t, half=self.germ.partner[self.half])

    def make_opposite_node(self) -> SingularNode:
        """Return the node from which the other half of the branch leaves."""
        return self.germ.make_node(self.germ.partner[self.half])

    def list_arrival_nodes(self) -> list[Node]:
        """Return the node at which the other half of a cusp arrives, as a list.

        It is empty for a branch without a cusp.
        """
        t = -self.germ.tangents[self.germ.partner[self.half]]
        return (
            [Node(self.x, t, self.sigma, self.nullity, NONE, NONE)]
            if self.germ.is_cusp(self.half)
            else []
        )

    def may_contain_points(self, equations: Closure, points: Sequence[Array]) -> bool:
        """Tell whether points (nq,) near by may lie on the branch of this node.

        They do not lie on another one.
        """
        half = self.germ.find_half_branch(equations, points)
        return half is None or half in (self.half, self.germ.partner[self.half])


def find_germ(equations: Closure, x: Array, nullity: int = 0) -> Germ | None:
    """Find the germ of the curve at a singular point.

    It is None where there is none, or one that small spheres do not tell.

    The null space there has the dimension `nullity`, where that is given, up to what the digits of
    `x` leave.
    """
    nullity = nullity or _compute_nullity(equations, x)
    if isinstance(equations, DrivenClosure) or not 2 <= nullity <= MOST_SEARCHED:
        return None
    sphere = _Sphere.make_sphere(equations, x, nullity)
    for radius in RADII:
        points = sphere.search_circle(radius) if nullity == 2 else sphere.search_sphere(radius)
        if points is None:
            return None  # more than a curve
        halves = [sphere.trace_branch_inwards(z) for z in points]
        count = min((len(h) for h in halves), default=0)
        if count < LEAST_SAMPLES or len(halves) % 2:
            continue
        germ = _pair_half_branches(x, np.array([h[:count] for h in halves]), sphere.null_space)
        if germ is not None:
            return germ
    return None


@dataclass(frozen=True, eq=False)
class _Sphere:
    """Small spheres around a singular point, and where they meet the curve.

    The curve lies over the null space (n, d): what is across it follows from the equations whose
    derivatives there do not vanish, with the pseudo-inverse `inverse` (n, rows); the others, those
    of `left` (rows, k), are then equations in the null space (Lyapunov, Schmidt; Golubitsky,
    Schaeffer, 1985, chapter VII).
    """

    equations: Closure
    x: Array
    null_space: Array
    inverse: Array
    left: Array

    @staticmethod
    def make_sphere(equations: Closure, x: Array, nullity: int) -> _Sphere:
        """Make the spheres around a point (nq,) with a null space of `nullity` dimensions."""
        spectrum = Spectrum(equations.compute_jacobian(x))
        rank = equations.n - nullity
        U = spectrum.left
        Vt = spectrum.right
        inverse = (Vt[:rank].T / spectrum.values[:rank]) @ U[:, :rank].T
        return _Sphere(equations, x, Vt[rank:].T, inverse, U[:, rank:])

    def find_valley(self, tangent: Array, reach: float) -> Array | None:
        """Find the tangent vector (n,) from `x` to the singular point near by.

        It is sought along a tangent (n,) of the curve.

        The null space has two dimensions. None where the valley has no roots near by.
        """
        t = self.null_space.T @ tangent
        t /= np.linalg.norm(t)
        a = reach * np.cos(np.pi * (np.arange(VALLEY) + 0.5) / VALLEY)
        b = np.zeros(VALLEY)
        h = 1e-3 * reach
        axes = np.stack([t, [-t[1], t[0]]])

        def compute_values(a: Array, b: Array) -> Array:
            """Compute the reduced equations (m, k) at coordinates along the tangent and across."""
            return self.reduce_vectors(np.stack([a, b], axis=1) @ axes @ self.null_space.T)[1]

        own = Spectrum(
            compute_values(np.append(a, a), np.repeat([h, -h], VALLEY))
        ).thin_decomposition[2][0]
        for _ in range(4):
            low, at, high = (compute_values(a, b + k * h) @ own for k in (-1, 0, 1))
            bent = high - 2.0 * at + low
            b = b - np.clip(
                np.where(
                    bent != 0.0, 0.5 * h * (high - low) / np.where(bent != 0.0, bent, 1.0), 0.0
                ),
                -0.1 * reach,
                0.1 * reach,
            )
        chebyshev: Any = np.polynomial.chebyshev  # its types are not known
        depth = chebyshev.chebfit(a / reach, compute_values(a, b) @ own, VALLEY // 2)
        roots: np.ndarray = np.asarray(chebyshev.chebroots(depth))
        near = roots[np.abs(roots) < CLUSTER]
        if not len(near):
            return None
        at = reach * float(np.real(near).mean())
        aside = chebyshev.chebval(at / reach, chebyshev.chebfit(a / reach, b, VALLEY // 2))
        return self.reduce_vectors((np.array([[at, aside]]) @ axes) @ self.null_space.T)[0][0]

    def reduce_vectors(self, z: Array) -> tuple[Array, Array]:
        """Solve for what is across the null space (Lyapunov-Schmidt reduction).

        Returned are tangent vectors (m, n) with the components of z (m, n) in the null space, and
        the values (m, k) of the equations there.
        """
        z, F = np.array(z), np.zeros((len(z), self.left.shape[0]))
        for _ in range(CHORDS):
            F = self.equations.evaluate_many_points(self.equations.move_point(self.x, z), False)[0]
            y = F @ self.inverse.T
            z -= y
            if np.abs(y).max(initial=0.0) < 1e-15:
                break
        return z, F @ self.left

    def search_circle(self, radius: float) -> list[Array]:
        """Find tangent vectors to the points of the curve over a circle in a plane null space."""
        angles = 2.0 * np.pi * np.arange(CIRCLE) / CIRCLE + 0.1

        def reduce_angles(angles: Array) -> tuple[Array, Array]:
            """Return tangent vectors and values of the equations at angles on the circle."""
            return self.reduce_vectors(
                radius * np.stack([np.cos(angles), np.sin(angles)], axis=1) @ self.null_space.T
            )

        values = reduce_angles(angles)[1]
        if not np.isfinite(values).all():
            return []
        out: list[Array] = []
        for own in Spectrum(values, 1e-8).compute_row_space(Level.GENERIC).T:
            a, b = self._find_brackets(
                angles, values @ own, lambda angles, own=own: reduce_angles(angles)[1] @ own
            )
            for _ in range(HALVINGS if len(a[0]) else 0):
                middle = 0.5 * (a[0] + b[0])
                value = reduce_angles(middle)[1] @ own
                left = (value > 0.0) == (a[1] > 0.0)
                a = np.where(left, middle, a[0]), np.where(left, value, a[1])
                b = np.where(left, b[0], middle), np.where(left, b[1], value)
            out += [] if not len(a[0]) else list(reduce_angles(0.5 * (a[0] + b[0]))[0])
        return self._correct_vectors(out)

    @staticmethod
    def _find_brackets(
        angles: Array, values: Array, function: Callable[[Array], Array]
    ) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Find intervals of a circle at whose ends a function has different signs.

        Returned are their ends, with the values there.

        Between samples of one sign the least one may be beside two zeros: it is followed to where
        the sign changes.
        """
        step = float(angles[1] - angles[0])
        ahead = np.roll(values, -1)
        change = np.flatnonzero((values > 0.0) != (ahead > 0.0))
        starts = [angles[change]]
        first = [values[change]]
        ends = [angles[change] + step]
        last = [ahead[change]]
        size = np.abs(values)
        behind = np.roll(values, 1)
        same = ((values > 0.0) == (ahead > 0.0)) & ((values > 0.0) == (behind > 0.0))
        dip = np.flatnonzero(same & (size <= np.abs(ahead)) & (size <= np.abs(behind)))
        center = angles[dip]
        sign = np.sign(values[dip])
        low = center - step
        high = center + step
        for _ in range(HALVINGS):
            if not len(center):
                break
            third = (high - low) / 3.0
            a = low + third
            b = high - third
            fa = sign * function(a)
            fb = sign * function(b)
            k = np.minimum(fa, fb) < 0.0
            for side in (-step, step):
                starts.append(center[k] + side)
                first.append(sign[k])
                ends.append(np.where(fa < fb, a, b)[k])
                last.append(-sign[k])
            low = np.where(fa > fb, a, low)[~k]
            high = np.where(fa > fb, high, b)[~k]
            center = center[~k]
            sign = sign[~k]
        return (np.concatenate(starts), np.concatenate(first)), (
            np.concatenate(ends),
            np.concatenate(last),
        )

    def search_sphere(self, radius: float) -> list[Array] | None:
        """Find tangent vectors to the points of the curve over a sphere in the null space.

        Newton's method is used from many starts.

        None where the points are not isolated: more than a curve leads there.
        """
        e = self.equations
        (n, d) = self.null_space.shape
        rng = np.random.default_rng(0)
        out = list[Array]()

        def evaluate_equations(x: Array, _: np.ndarray) -> tuple[Array, Array]:
            """Return residuals and Jacobians of the equations."""
            return e.evaluate_many_points(x)

        def evaluate_on_sphere(x: Array, _: np.ndarray) -> tuple[Array, Array]:
            """Return residuals and Jacobians of the equations and of the sphere."""
            F, J = e.evaluate_many_points(x)
            z = e.compute_difference(self.x, x)
            over = 0.5 * (np.sum(z * z, axis=1) - radius * radius) / radius
            return np.append(F, over[:, None], axis=1), np.append(J, z[:, None] / radius, axis=1)

        for _ in range(LOOKS):
            e.budget.check_time()
            count = max(8, min(STARTS * 2**d, MOST_STARTS, MOST_NUMBERS // (e.rows * n)))
            z = rng.normal(size=(count, d)) @ self.null_space.T
            z *= radius / np.linalg.norm(z, axis=1, keepdims=True)
            x = run_many_gauss_newton(
                evaluate_equations,
                e.move_point(self.x, z),
                6,
                level=Level.ROUGH,
                longest=radius,
                move=e.move_point,
            )
            z = e.compute_difference(self.x, x)
            size = np.linalg.norm(z, axis=1, keepdims=True)
            z = (radius / size * z)[(size > 0.1 * radius)[:, 0]]
            x = run_many_gauss_newton(
                evaluate_on_sphere,
                e.move_point(self.x, z),
                30,
                level=Level.GENERIC,
                longest=radius,
                move=e.move_point,
            )
            left, J = evaluate_on_sphere(x, np.arange(len(x)))
            good = np.abs(left).max(axis=1, initial=0.0) < 1e-9
            few = J[good][:8, :-1]
            if len(few) and np.median(Spectrum(few, 1.0).compute_ranks(PARTED)) < n - 1:
                return None
            known = len(out)
            out = self._correct_vectors([*out, *e.compute_difference(self.x, x[good])])
            if len(out) == known:
                break
        return out

    def _correct_vectors(self, vectors: Sequence[Array]) -> list[Array]:
        """Return tangent vectors to the points of the curve near given ones, each once."""
        out: list[Array] = []
        for z in vectors:
            found = self._correct_vector(z)
            if found is not None and all(
                np.linalg.norm(found[0] - o) > 1e-4 * np.linalg.norm(o) for o in out
            ):
                out.append(found[0])
        return out

    def _correct_vector(self, z: Array) -> tuple[Array, Array] | None:
        """Return the tangent vector to the regular point of the curve in the plane across z (n,).

        The direction of the curve there is returned, too; or None where there is no such point.
        """
        e = self.equations
        size = float(np.linalg.norm(z))
        there = correct_point(e, e.move_point(self.x, z), z / size)
        if there is None:
            return None
        found = e.compute_difference(self.x, there.x)
        spectrum = Spectrum(there.J, 1.0)
        direction = spectrum.right[-1]
        near = np.linalg.norm(found - z) < 0.5 * size
        return (found, direction) if near and spectrum.compute_rank(PARTED) >= e.n - 1 else None

    def trace_branch_inwards(self, z: Array) -> Array:
        """Trace a half-branch from z (n,) towards the center, as tangent vectors (m, n).

        The next one is looked for on the parabola through the center and the last one, with the
        direction there.
        """
        out = list[Array]()
        radius = float(np.linalg.norm(z))
        there = self._correct_vector(z)
        while there is not None:
            z, t = there
            out.append(z)
            if len(out) == len(INWARDS):
                break
            size = float(np.linalg.norm(z))
            along = float(t @ z) / size
            rate = z / size
            rate = t / along if abs(along) > 0.1 else rate
            part = INWARDS[len(out)] * radius / size
            there = self._correct_vector(
                (2.0 * part - part * part) * z - (part - part * part) * size * rate
            )
        return np.array(out)


def _compute_powers(distance: Array, root: int) -> Array:
    """Compute powers (m, DEGREE) of a root of distances (m,), the parameter of a half-branch."""
    return (distance ** (1.0 / root))[:, None] ** np.arange(1.0, DEGREE + 1.0)


def _fit_coefficients(A: Array, B: Array) -> Array:
    """Return the X (n, k) that makes |A X - B| least."""
    return Spectrum(A).solve_least_squares(B, Level.ROUNDING)


def _pair_half_branches(x: Array, samples: Array, null_space: Array) -> Germ | None:
    """Pair half-branches (k, m, n) to branches, and return their germ, or None.

    Two are one branch if one polynomial describes both.
    """
    size = np.linalg.norm(samples, axis=2)
    turned = (-1.0) ** np.arange(1, DEGREE + 1)
    k = len(samples)
    radius = float(size.max())
    rates = samples[:, -1] / size[:, -1, None]
    fits: list[tuple[float, int, int, int, Array]] = []
    for i in range(k):
        for j in range(i):
            cosine = float(rates[i] @ rates[j])
            for root in () if abs(cosine) < ALONG else (2,) if cosine > 0.0 else (1, 3):
                there = np.vstack(
                    [_compute_powers(size[i], root), _compute_powers(size[j], root) * turned]
                )
                scale = np.abs(there).max(axis=0)
                both = np.vstack([samples[i], samples[j]])
                c = np.zeros((DEGREE, samples.shape[2]))
                fitted = _fit_coefficients((there / scale)[:, root - 1 :], both)
                c[root - 1 :] = fitted / scale[root - 1 :, None]
                fits.append((float(np.abs(there @ c - both).max()) / radius, i, j, root, c))
    partner = [-1] * k
    roots = [1] * k
    left = set(range(k))
    curves = np.zeros((k, DEGREE, samples.shape[2]))
    tangents = np.array(rates)
    for off, i, j, root, c in sorted(fits, key=lambda fit: fit[0]):
        if i not in left or j not in left or off > UNLIKE:
            continue
        others = [o for o, a, b, *_ in fits if len({a, b} & {i, j}) == 1 and {a, b} <= left]
        if off * CLEAR > min(others, default=np.inf):
            return None  # too near to tell: farther out branches have parted
        left -= {i, j}
        partner[i] = j
        partner[j] = i
        roots[i] = root
        roots[j] = root
        curves[i], curves[j] = c, c * turned[:, None]
        t = null_space @ (null_space.T @ c[root - 1])
        t /= np.linalg.norm(t)
        if root == 2:
            t[np.abs(t) < RESTS] = 0.0
        tangents[i], tangents[j] = t, t if root == 2 else -t
    return (
        None
        if left
        else Germ(x, null_space.shape[1], samples, tangents, tuple(partner), tuple(roots), curves)
    )


# ---- curves of low rank (deflation)

# Along some curves the equations touch: the Jacobian has a larger null space all along than the
# curve has tangents. There the curve is where the equations hold and the small singular values of
# the Jacobian vanish, too. These equations together are regular if the null space is cut down to a
# tangent to second order (deflation: Leykin, Verschelde, Zhao, *Theor. Comput. Sci.* 359, 2006).

ALIGNED = 0.7
"""Least singular value of the product of two bases from which one need not follow the other."""


class RankEquations:
    """Equations that keep the rank of other ones: ``left.T @ J @ null_space = 0``.

    The bases of the two null spaces are those of the point itself, as near as may be to the last
    ones used, so that the equations change continuously.
    """

    def __init__(self, equations: Closure, x: Array):
        J = equations.compute_jacobian(x)[: equations.real]
        spectrum = Spectrum(J)
        self._left = spectrum.compute_left_null_space(Level.CLOSED)
        self._null_space = spectrum.compute_null_space(Level.CLOSED)
        self.nullity = self._null_space.shape[1]
        self._before = len(equations.more)

    @property
    def count(self) -> int:
        """Number of the equations."""
        return self._left.shape[1] * self.nullity

    def write_equations(
        self, equations: Closure, x: Array, F: Array, J: Array, at: int, with_matrix: bool
    ) -> None:
        """Write the residuals of these equations and their derivatives into F and J (., n) from row
        `at` on.
        """
        own = J[:at] if with_matrix else equations.evaluate_equations(x, True, self._before)[1][:at]
        spectrum = Spectrum(own)
        rank = own.shape[1] - self.nullity
        here = slice(at, at + self.count)
        left = self._align_basis(spectrum.left[:, rank:], self._left)
        null_space = self._align_basis(spectrum.right[rank:].T, self._null_space)
        if (
            min(
                _find_least_value(left.T @ self._left),
                _find_least_value(null_space.T @ self._null_space),
            )
            < ALIGNED
        ):
            self._left = left
            self._null_space = null_space
        F[here] = (left.T @ own @ null_space).ravel()
        if with_matrix:
            padded = np.zeros((equations.rows, left.shape[1]))
            padded[:at] = left
            before = _Before(equations, self._before)
            J[here] = (
                differentiate_jacobian(before, x, padded, null_space)
                .transpose(1, 2, 0)
                .reshape(self.count, -1)
            )

    @staticmethod
    def _align_basis(basis: Array, to: Array) -> Array:
        """Return the basis of the same space that is nearest to another one (Procrustes)."""
        return basis @ Spectrum(basis.T @ to).orthogonal


class _Before(Closure):
    """Equations without the `further` ones from a number on."""

    def __init__(self, equations: Closure, further: int):
        vars(self).update(vars(equations))
        self._equations = equations
        self._further_ones = further

    def compute_jacobian(self, x: Array) -> Array:
        """Derivative (rows, n) of these equations at `x`."""
        return self._equations.evaluate_equations(x, True, self._further_ones)[1]


def hold_rank(
    equations: Closure, x: Array, curve: Callable[[], tuple[Closure, Node]], length: float = PROBE
) -> bool:
    """Hold the rank at a point (nq,) if the equations then leave a curve through it.

    True is returned if they do.

    `curve` gives the equations of the curve, these or equations made of them, and its node at the
    point. The curve must have this `length` on both sides: branches that touch closely look like
    one of low rank near by.
    """
    low = RankEquations(equations, x)
    if not low.count or is_rank_held(equations):
        return False
    equations.add_equations(low)
    along, here = curve()
    if here.nullity == 1 and all(
        _can_follow_curve(along, n, length) for n in (here, here.reverse_direction())
    ):
        return True
    equations.remove_equations(low)
    return False


def _can_follow_curve(curve: Closure, a: Node, length: float) -> bool:
    """Tell whether the curve can be followed from a node over a length, by steps that double."""
    h = PROBE
    gone = 0.0
    here = a
    while gone < length:
        there = find_next_node(curve, here, h)
        if there is None:
            return False
        h, gone, here = 2.0 * h, gone + h, there
    return True


def is_rank_held(equations: Closure) -> bool:
    """Tell whether the equations hold the rank."""
    return any(isinstance(m, RankEquations) for m in equations.more)


def _find_least_value(A: Array) -> float:
    """Compute the least singular value of a matrix."""
    return float(Spectrum(A).values.min(initial=1.0))
