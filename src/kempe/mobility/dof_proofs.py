"""Proofs of degrees of freedom: theorems whose hypotheses are checked numerically.

Each cluster of loops is proven separately. Dimensions of clusters add up, for clusters share no
unknowns. What is zero to rounding counts as exactly zero.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kempe.equations.closure_rows import evaluate_constraints
from kempe.first_order.constraint_graph import (
    Cluster,
    ConstraintGraph,
    LoopSizes,
    build_constraint_graph,
)
from kempe.first_order.counting import compute_group_basis, spans_lie_algebra
from kempe.first_order.rank import Rank
from kempe.first_order.screws import Screws, compute_screws
from kempe.mobility import lyapunov_schmidt
from kempe.mobility.local_equations import Equations
from kempe.mobility.lyapunov_schmidt import Split
from kempe.numerics.newton import Certificate, bound_rounding_error, make_certificate
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

if TYPE_CHECKING:
    from kempe.model.model import Model


# ---- motions in closed form

# Angles turn in fixed ratios, as those of parallelograms do, or tangents of half of them, as those
# of Bennett's linkage. Along such motions the equations are trigonometric polynomials, or rational
# functions, of a degree that the joints bound. One that vanishes at random points all around
# vanishes, with probability one, everywhere.

PARTS = 12
"""Ratios are multiples of one over this."""
NEARLY = 1e-6
"""How far a ratio that was found may be from it."""
POINTS = 48
"""Random points at which the equations must vanish."""
ZERO = 1e-12
"""Values of equations, in radians and typical lengths, that are rounding."""


def find_family_dimension(equations: Equations, q: Array, spans: Iterable[Array]) -> int:
    """Find the largest dimension of a family of motions with angles in fixed ratios.

    The closed configurations of the family pass through q (nq,), with rates in some of `spans` (nv,
    k).
    """
    e = equations
    angles = np.zeros(e.nv, dtype=bool)
    angles[e.system.structure.layout.vector_v] = True
    angles &= e.turning & ~e.sliding
    best = 0
    for span in spans:
        k = span.shape[1]
        if k <= best or np.abs(span[~angles]).max(initial=0.0) > NEARLY:
            continue
        K = _find_ratios(span)
        if K is None:
            continue
        s = np.random.default_rng(0).uniform(-np.pi, np.pi, size=(POINTS, k)) * PARTS
        value = evaluate_constraints(e.system, e.move_configurations(q, s @ K.T), False, True)[0]
        if np.abs(value).max(initial=0.0) < ZERO:
            best = k
    return best


def is_half_angle_motion(
    equations: Equations, q: Array, axes: Array, places: Sequence[int], null_space: Array
) -> bool:
    """Return whether tangents of half angles of four hinges keep fixed products or ratios.

    `axes` (6, 4) are the screws of the hinges around the loop, in its sense, `places` where their
    angles are, `null_space` (nv,) the velocity. Angles are those between common normals of
    neighbouring axes. Bennett, 1903: opposite angles are then equal, up to their signs.
    """
    z = axes[3:].T
    normal = np.cross(z, np.roll(z, -1, axis=0))
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    if size.min() < NEARLY:
        return False
    x = normal / size
    before = np.roll(x, 1, axis=0)
    theta = np.arctan2(np.sum(np.cross(before, x) * z, axis=1), np.sum(before * x, axis=1))
    rate = null_space[list(places)]
    if np.abs(np.sin(theta[:2])).min() < NEARLY or np.abs(rate).min() < NEARLY:
        return False
    opposite = rate[2:] / rate[:2]
    if np.abs(np.abs(opposite) - 1.0).max() > NEARLY:
        return False
    a, b = np.tan(0.5 * theta[:2])
    turn = np.random.default_rng(0).uniform(-np.pi, np.pi, POINTS)
    u = np.tan(0.5 * turn)
    for other in (2.0 * np.arctan(a * b / u), 2.0 * np.arctan(b / a * u)):
        for sense in (1.0, -1.0):
            by = sense * np.stack([turn - theta[0], other - theta[1]], axis=1)
            step = np.zeros((POINTS, equations.nv))
            step[:, places] = np.concatenate([by, by * np.sign(opposite)], axis=1)
            if (
                np.abs(
                    evaluate_constraints(
                        equations.system, equations.move_configurations(q, step), False, True
                    )[0]
                ).max()
                < ZERO
            ):
                return True
    return False


def _find_ratios(span: Array) -> Array | None:
    """Find a basis of ratios for a span: multiples of 1 / 12, None if there is none.

    Each column is 1 in one row in which the others are 0.
    """
    K = np.array(span)
    for j in range(K.shape[1]):
        left = np.abs(K[:, j:]).max(axis=1)
        i = int(np.argmax(left > 0.5 * left.max()))
        k = j + int(np.argmax(np.abs(K[i, j:])))
        if abs(K[i, k]) < NEARLY:
            return None
        K[:, [j, k]] = K[:, [k, j]]
        K[:, j] /= K[i, j]
        for other in range(K.shape[1]):
            if other != j:
                K[:, other] -= K[i, other] * K[:, j]
    near = np.round(K * PARTS) / PARTS
    return near if np.abs(K - near).max() < NEARLY else None


# ---- leading forms

# Let g(s) = 0 be what the reduction of Lyapunov and Schmidt leaves at a singular configuration, c
# equations in delta unknowns, and G its leading forms. Upper bounds hold for complex solutions, so
# that dimensions drop by one at most with each equation added:
#
# - one unknown: any coefficient that is not zero isolates the configuration;
# - one equation: solutions have delta - 1 dimensions where g has both signs at all small distances,
#   for they part these;
# - quadratic forms without a common complex zero on a subspace of codimension d: at most d
#   dimensions (Macaulay, 1916, decides that by a rank); a definite combination of them: none;
# - coordinates held, so that loop by loop all others are isolated: at most as many dimensions as
#   are held.
#
# A zero of the quadratic forms where their derivatives are independent is the tangent of a branch
# of delta - c dimensions (implicit function theorem, after a blow-up): a lower bound.

CLEAR = 1e-5
"""Numbers above this part of what they would be at most are not zero, where they are not computed
to more digits."""
ROUNDING = 1e-11
"""Singular values below this part of the largest are rounding, or what is left where roots are
double."""
SINGULAR = 1e-12
"""Singular values below this part of the largest are zero to rounding. Where they are not, but too
small for a proof that they are not zero, only what holds in both cases is proven."""
GAP = 1e3
"""Ratio of the last singular value that counts to the first that does not from which the rank is
beyond doubt."""
LINES = 24
MIXTURES = 400
"""Random lines on which signs are looked at, and random combinations of forms that may be
definite."""
VARIABLES = 5
"""Unknowns of quadratic forms up to which common zeros are excluded by a rank."""
MANY = 40
"""Unknowns above which forms are not looked at."""
HELD = 24
"""Choices of held coordinates that are tried."""


class Here(NamedTuple):
    """Equations of a part at a configuration: reduced Jacobian `matrix`, singular values, split.

    `basis` (m, k) are the rows that are looked at, `clear` whether the rank is beyond doubt,
    `exact` whether what does not count is zero to rounding.
    """

    matrix: Array
    values: Array
    split: Split
    basis: Array
    clear: bool
    exact: bool


def split_rows(q: Array, J: Array, basis: Array, columns: np.ndarray) -> Here:
    """Split the equations of the rows `basis` (m, k) of J (m, nv) in the unknowns `columns`.

    All other unknowns are held.
    """
    m, nv = J.shape
    A = basis.T @ J[:, columns]
    n = len(columns)
    spectrum = Spectrum(A, lyapunov_schmidt.LEAST)
    left = spectrum.left
    sigma = spectrum.values
    most = float(spectrum.largest)
    rank = spectrum.compute_rank(Level.GENERIC)
    rest = float(sigma[rank]) if rank < len(sigma) else 0.0
    last = float(sigma[rank - 1]) if rank else np.inf
    clear = last > GAP * max(rest, ROUNDING * most)
    null_space = np.zeros((nv, n - rank))
    inverse = np.zeros((nv, m))
    null_space[columns] = spectrum.compute_null_space(Level.GENERIC)
    inverse[columns] = spectrum.compute_pseudo_inverse(Level.GENERIC) @ basis.T
    padded = np.concatenate([np.full(nv - n, most), sigma])
    return Here(
        A,
        sigma,
        Split(q, padded, null_space, basis @ left[:, rank:], inverse),
        basis,
        clear,
        rest <= SINGULAR * most,
    )


def decide_dimension(
    equations: Equations,
    here: Here,
    rows: Sequence[Array],
    uses: Sequence[np.ndarray],
    known: int,
    order: int,
    rng: np.random.Generator,
    tangents: Sequence[Array],
) -> tuple[int, int | None, str] | None:
    """Decide the dimension by leading forms, if they suffice.

    Returns dimension, number of branches (None: unknown) and reason; `known` is a proven lower
    bound.

    `rows` (m, k) and `uses` are the equations and unknowns of each loop, `tangents` (nv, k) belong
    to motions found.
    """
    at = here.split
    found = lyapunov_schmidt.measure_obstruction(equations, at, order, rng)
    k = _find_clear_order(found)
    if k is None:
        return None
    if at.delta == 1:
        return 0, 0, f"the only velocity is obstructed at order {k}"
    directions = _list_directions(at, tangents)
    if at.corank == 1:
        return _decide_one_equation(equations, here, k, found.noise, rng, directions)
    if k > 2 or at.delta > MANY or not here.exact:
        return None
    B = compute_quadratic_forms(equations, at)
    lower = max(
        known, at.delta - at.corank if any(_has_regular_zero(B, d) for d in directions) else 0
    )
    if lower == 0 and _has_definite_combination(B, rng):
        return 0, 0, "second-order terms of one sign obstruct all velocities"
    t = at.delta - lower
    if _has_no_zero(B, t, rng) or _can_isolate_others(
        equations, here, rows, uses, lower, order, rng
    ):
        return (
            lower,
            0 if lower == 0 else None,
            "the zeros of the leading forms have no more dimensions",
        )
    return None


def _find_clear_order(found: lyapunov_schmidt.Obstruction) -> int | None:
    """Find the first order at which the reduced equations are clearly not zero."""
    k = found.order
    return None if k is None or found.size[k] < GAP * found.noise[k] else k


def _list_directions(at: Split, tangents: Sequence[Array]) -> list[Array]:
    """List unit vectors along known motions, in the basis of the null space."""
    out: list[Array] = []
    for T in tangents:
        for d in (at.null_space.T @ T).T:
            size = float(np.linalg.norm(d))
            if size > 0.1:
                out.append(d / size)
    return out


# ---- leading forms: one equation


def _decide_one_equation(
    equations: Equations,
    here: Here,
    k: int,
    noise: Array,
    rng: np.random.Generator,
    directions: list[Array],
) -> tuple[int, int | None, str] | None:
    """Decide the dimension where one reduced equation remains, by its signs."""
    at = here.split
    delta = here.split.delta
    if k > 2 and not here.exact:
        return None
    lines = [*lyapunov_schmidt.sample_unit_vectors(rng, LINES, delta), *directions]
    eigen = np.zeros(delta)
    if k == 2 and delta <= MANY:
        eigen, V = np.linalg.eigh(compute_quadratic_forms(equations, at)[0])
        clear = np.abs(eigen) > CLEAR * np.abs(eigen).max()
        if clear.all() and (eigen > 0).all() or clear.all() and (eigen < 0).all():
            if not here.exact:
                return None  # a small sphere passes through q where the equation has a linear term
            return 0, 0, "second-order terms of one sign obstruct all velocities"
        lines += list(V.T)
    g, slow = lyapunov_schmidt._solve_coefficients(
        equations, at, lyapunov_schmidt.make_lines(np.array(lines), len(noise) - 1), None
    )
    signs: set[int] = set()
    for row in (g / slow)[..., 0]:
        seen = np.flatnonzero(np.abs(row) > np.maximum(lyapunov_schmidt.NOT_ZERO, GAP * noise))
        if not seen.size or np.abs(row[: seen[0]]).max(initial=0.0) > lyapunov_schmidt.ZERO:
            continue
        sign = int(np.sign(row[seen[0]]))
        signs |= {sign, sign * (-1) ** int(seen[0])}
    if len(signs) < 2:
        return None
    crossing = (
        here.exact
        and delta == 2
        and k == 2
        and bool((np.abs(eigen) > CLEAR * np.abs(eigen).max()).all())
    )
    why = "the one equation that is left has both signs at all small distances"
    return delta - 1, 2 if crossing else None, why


# ---- leading forms: quadratic forms


def compute_quadratic_forms(equations: Equations, at: Split) -> Array:
    """Compute the quadratic forms (c, delta, delta) of the reduced equations as symmetric matrices."""
    delta = at.delta
    pairs = list(combinations(range(delta), 2))
    d = np.zeros((delta + len(pairs), delta))
    d[:delta] = np.eye(delta)
    for n, (i, j) in enumerate(pairs, delta):
        d[n, [i, j]] = np.sqrt(0.5)
    g = lyapunov_schmidt._solve_coefficients(
        equations, at, lyapunov_schmidt.make_lines(d, 2), None
    )[0][:, 2]
    B = np.zeros((at.corank, delta, delta))
    B[:, range(delta), range(delta)] = g[:delta].T
    for n, (i, j) in enumerate(pairs, delta):
        B[:, i, j] = B[:, j, i] = g[n] - 0.5 * (g[i] + g[j])
    return B


def _has_regular_zero(B: Array, d: Array) -> bool:
    """Return whether the forms have a regular zero near d (delta,).

    It is regular if the derivatives of the forms are independent there.
    """
    c, delta, _ = B.shape
    if c >= delta:
        return False
    size = float(np.abs(B).max())
    for _ in range(20):
        D = 2.0 * B @ d
        if np.linalg.norm(B @ d @ d) < 1e-13 * size:
            return bool(Spectrum(D).smallest > CLEAR * size)
        d = d - Spectrum(D).solve_least_squares(B @ d @ d, Level.ROUGH)
        d = d / np.linalg.norm(d)
    return False


def _has_definite_combination(B: Array, rng: np.random.Generator) -> bool:
    """Return whether some combination of the forms is definite."""
    mix = np.concatenate(
        [np.eye(len(B)), lyapunov_schmidt.sample_unit_vectors(rng, MIXTURES, len(B))]
    )
    eigen = np.linalg.eigvalsh(np.einsum("nc,cij->nij", mix, B))
    size = CLEAR * np.abs(eigen).max()
    return bool(np.any(eigen[:, 0] > size) or np.any(eigen[:, -1] < -size))


def _has_no_zero(B: Array, t: int, rng: np.random.Generator) -> bool:
    """Return whether the forms have no common complex zero but 0 on a random subspace.

    The subspace has t dimensions.

    They have none if and only if their multiples by all monomials of degree t - 1 span all forms of
    degree t + 1.
    """
    c, delta, _ = B.shape
    if t <= 0:
        return True
    if t > VARIABLES or c < t:
        return False
    L = np.linalg.qr(rng.normal(size=(delta, delta)))[0][:, :t]
    forms = np.einsum("cij,ia,jb->cab", B, L, L)
    sizes = np.abs(forms).max(axis=(1, 2))
    forms = forms[sizes > CLEAR * sizes.max()] / sizes[sizes > CLEAR * sizes.max(), None, None]
    low = list(combinations_with_replacement(range(t), t - 1))
    place = {m: i for i, m in enumerate(combinations_with_replacement(range(t), t + 1))}
    M = np.zeros((len(forms) * len(low), len(place)))
    for n, m in enumerate(low):
        for i in range(t):
            for j in range(t):
                M[n * len(forms) : (n + 1) * len(forms), place[tuple(sorted((*m, i, j)))]] += forms[
                    :, i, j
                ]
    if len(M) < len(place):
        return False
    return Spectrum(M).compute_rank(CLEAR) == len(place)


# ---- leading forms: coordinates held


def _can_isolate_others(
    equations: Equations,
    here: Here,
    rows: Sequence[Array],
    uses: Sequence[np.ndarray],
    count: int,
    order: int,
    rng: np.random.Generator,
) -> bool:
    """Return whether holding some `count` coordinates isolates all others, loop by loop."""
    at = here.split
    J = equations.linearise_equations(at.q)[1][0]
    moving = np.flatnonzero(np.abs(at.null_space).max(axis=1) > CLEAR)
    unknown = np.unique(np.concatenate(list(uses)))
    choices: list[tuple[int, ...]] = list(combinations(moving.tolist(), count))
    if len(choices) > HELD:
        choices = [choices[i] for i in rng.choice(len(choices), HELD, replace=False)]
    return any(
        _is_isolated_stepwise(equations, at.q, J, rows, uses, np.setdiff1d(unknown, c), order, rng)
        for c in choices
    )


def _is_isolated_stepwise(
    equations: Equations,
    q: Array,
    J: Array,
    rows: Sequence[Array],
    uses: Sequence[np.ndarray],
    left: np.ndarray,
    order: int,
    rng: np.random.Generator,
) -> bool:
    """Return whether the unknowns `left` are isolated, those of one loop after the other."""
    pending = list(range(len(rows)))
    while len(left):
        waiting: list[int] = []
        for k in pending:
            own = np.intersect1d(uses[k], left)
            if not len(own) or _is_isolated(equations, split_rows(q, J, rows[k], own), order, rng):
                left = np.setdiff1d(left, own)
            else:
                waiting.append(k)
        if len(waiting) == len(pending):
            return False
        pending = waiting
    return True


def _is_isolated(equations: Equations, here: Here, order: int, rng: np.random.Generator) -> bool:
    """Return whether the configuration is an isolated complex solution in the given unknowns."""
    at = here.split
    if not here.clear or at.delta > VARIABLES:
        return False
    if at.delta == 0:
        return True
    if at.corank == 0:
        return False
    k = _find_clear_order(lyapunov_schmidt.measure_obstruction(equations, at, order, rng))
    if k is None or at.delta == 1:
        return k is not None
    return (
        k == 2
        and here.exact
        and _has_no_zero(compute_quadratic_forms(equations, at), at.delta, rng)
    )


# ---- clusters and theorems

# The theorems, in the order in which they are tried:
#
# - *Regular*: the loop equations, reduced to the group of motions that the joints of each loop
#   generate (Herve, 1978), have a Jacobian of full rank, beyond rounding and the error of the
#   configuration (`kempe.numerics.newton`). Then the closed configurations are a manifold of as
#   many dimensions as its null space has (implicit function theorem).
# - *Two groups*: a loop whose joints part into two chains, each of which fills a group of motions:
#   what both groups share moves, and the number is the same everywhere.
# - *Families*: a motion in closed form keeps all loops closed.
# - *Forms*: what the reduction of Lyapunov and Schmidt leaves has leading forms that decide.

SAME = 1e-12
"""Parts of a unit screw below this are rounding: the screw lies in the group of motions of the
others."""
LONG = 12
"""Joints of a loop up to which it is parted into two chains."""


class Part(NamedTuple):
    """Equations of one cluster: a basis (m, k) of sufficient rows for each loop and law.

    `columns` are the velocities of the cluster, `uses` those of each loop or law.
    """

    cluster: Cluster
    rows: list[Array]
    columns: np.ndarray
    uses: list[np.ndarray]


@dataclass(frozen=True)
class Proof:
    """A proven dimension, the number of branches (None: unknown), and the reason."""

    dim: int
    branches: int | None
    why: str


# ---- ranks beyond rounding


def has_full_rank(system: Model, rank: Rank, residual: float) -> bool:
    """Return whether every cluster of loops has full rank for sure at the closed configuration."""
    s = build_constraint_graph(system)
    at = rank.screws
    return all(
        _certify_cluster(s, at, c.cluster, c.values * c.size, c.jacobian, residual, True).regular
        for c in rank.clusters
    )


def _certify_cluster(
    s: ConstraintGraph,
    at: Screws,
    c: Cluster,
    values: Array,
    J: Array,
    residual: float,
    short: bool,
) -> Certificate:
    """Certify the rank of the equations of a cluster from the singular values of J."""
    if c.bent:  # of whose second derivatives no bound is known
        return Certificate(False, 0.0, np.inf)
    size = c.measure_loops(s, short)
    reach = at.reach
    residual *= len(c.loops) * (1.0 + reach) + 1.0  # loops are sums of others, and read elsewhere
    out = make_certificate(
        values,
        J.shape,
        residual,
        _bound_second_derivatives(size, at, 2.0 * reach),
        bound_rounding_error(size.joints, reach),
        J.size,
    )
    if out.regular or not len(c.loops):
        return out
    spans = [  # large mechanisms have small loops
        _find_largest_distance(np.concatenate([at.F[i, :3, 3], at.M[i, :3, 3]]), at.M[i[0], :3, 3])
        for i in c.list_loop_paths(s, short)
    ]
    bend = _bound_second_derivatives(size, at, 2.0 * max(spans) / at.length)
    return make_certificate(
        values,
        J.shape,
        residual,
        bend,
        bound_rounding_error(size.joints, reach),
        int(np.count_nonzero(J)),
    )


def _find_largest_distance(points: Array, center: Array) -> float:
    """Return the largest distance of points (n, 3) from a center (3,)."""
    d = points - center
    return float(np.sqrt(np.max(np.sum(d * d, axis=1), initial=0.0)))


def _bound_second_derivatives(size: LoopSizes, at: Screws, D: float) -> float:
    """Bound the norm of the second derivatives of loop equations.

    The joints of a loop are at most D lengths apart.

    Two unit turns change the pose at the end of a chain by at most its reach, and by 1 as a
    rotation; a slide counts one length more. So a loop of n joints has second derivatives of norm n
    sqrt((D + 1)^2 + 1) at most, and loops that share no joint do not add up.
    """
    bend = float(np.hypot(D + 1.0, 1.0))
    if len(size.rods):
        rods = (
            np.linalg.norm(at.M[size.rods, :3, 3] - at.F[size.rods, :3, 3], axis=1).min()
            / at.length
        )
        bend = max(bend, (D + 1.0) * (D + 1.0 + rods) / max(rods, 1e-300))
    return size.most * bend


# ---- one proof for all clusters


class Prover:
    """Proofs of dimensions at one closed configuration q (nq,)."""

    def __init__(self, system: Model, equations: Equations, q: Array):
        self.system = system
        self.equations = equations
        self.q = q
        self.structure = build_constraint_graph(system)
        self.at = compute_screws(system, q)
        self.value, self.jacobian = (x[0] for x in equations.linearise_equations(q))
        self.parts = _reduce_clusters(system, self.structure, self.at, equations, self.jacobian)
        self.manifolds: dict[int, Proof | _Open | None] = {}

    def prove_manifold(self) -> Proof | None:
        """Prove the dimension, if the solution set is a manifold of the null space's dimension.

        None if that cannot be proven.
        """
        found: list[Proof] = []
        for k in range(len(self.parts)):
            proof = self._prove_cluster(k)
            if not isinstance(proof, Proof):
                return None
            found.append(proof)
        return self._combine_proofs(found)

    def prove_dimension(self, order: int, tangents: Sequence[Array]) -> Proof | None:
        """Prove the dimension, by leading forms too, if possible.

        `tangents` (nv, k), in scaled coordinates, span known motions.
        """
        rng = np.random.default_rng(0)  # what is proven depends on no seed
        found: list[Proof] = []
        for k, part in enumerate(self.parts):
            proof = self._prove_cluster(k)
            if isinstance(proof, _Open):
                proof = _prove_by_forms(self.equations, self.q, part, proof, order, rng, tangents)
            if proof is None:
                return None
            found.append(proof)
        return self._combine_proofs(found)

    def _prove_cluster(self, k: int) -> Proof | _Open | None:
        """Prove the dimension of one cluster, once.

        Returns a proof, what remains open, or None where nothing can be proven.
        """
        if k not in self.manifolds:
            self.manifolds[k] = _prove_part(
                self.structure,
                self.at,
                self.equations,
                self.q,
                self.parts[k],
                self.value,
                self.jacobian,
            )
        return self.manifolds[k]

    def _combine_proofs(self, found: Sequence[Proof]) -> Proof:
        """Combine the proofs of all clusters with the coordinates that are in no loop."""
        return _sum_proofs(
            [Proof(self.system.nv - sum(len(p.columns) for p in self.parts), 1, ""), *found]
        )


def _sum_proofs(found: Sequence[Proof]) -> Proof:
    """Sum the dimensions of proofs, and multiply their numbers of branches."""
    total = sum(p.dim for p in found)
    counts = [1 if p.branches == 0 else p.branches for p in found]  # what rests multiplies none
    count = (
        None
        if None in counts
        else int(np.prod([n for n in counts if n is not None]))
        if total
        else 0
    )
    return Proof(total, count, "; ".join(dict.fromkeys(p.why for p in found if p.why)))


def _reduce_clusters(
    system: Model, s: ConstraintGraph, at: Screws, equations: Equations, J: Array
) -> list[Part]:
    """Reduce the equations of each cluster, loop by loop, to those that its motion group leaves."""
    edges = equations.rows_by_name
    out: list[Part] = []
    for c in s.clusters:
        rows: list[Array] = []
        uses: list[np.ndarray] = []
        for k in c.loops:
            path = [i for i, _ in s.loops[k].path]
            own = edges[s.edges[s.loops[k].edge].name]
            rows.append(
                _embed_rows(
                    equations.m,
                    own,
                    _reduce_loop_rows(system, s, at, k, path, J[own], equations.length),
                )
            )
            uses.append(
                np.unique([col.index for i in path for col in s.edges[i].columns if col.index >= 0])
            )
        for law in (s.laws[k] for k in c.laws):
            rows.append(_embed_rows(equations.m, np.array(law.places), np.eye(law.n_rows)))
            uses.append(np.array(law.support, dtype=np.int64))
        out.append(Part(c, rows, c.velocities, uses))
    return out


def _embed_rows(m: int, at: np.ndarray, mix: Array) -> Array:
    """Return combinations of some rows as combinations of all m rows."""
    out = np.zeros((m, mix.shape[1]))
    out[at] = mix
    return out


def _reduce_loop_rows(
    system: Model, s: ConstraintGraph, at: Screws, k: int, path: list[int], J: Array, length: float
) -> Array:
    """Find combinations (rows, d) of a loop's rows that suffice.

    The joints of the loop generate a group of motions of d dimensions.

    The rows of a closing joint read, to first order, the twist of its frame M; so in these
    coordinates the algebra of the group is what rows can become, and nothing else.
    """
    edge = s.edges[s.loops[k].edge]
    rows = s.loops[k].rows
    if not edge.is_joint or edge.particle:
        return np.eye(rows)
    basis = compute_group_basis(np.concatenate([at.twists[i] for i in path], axis=1), SAME)
    if basis.shape[1] >= rows:
        return np.eye(rows)
    there = at.build_shift_matrices([s.loops[k].edge])[0] @ basis
    R = at.M[s.loops[k].edge, :3, :3]
    there = np.concatenate([R.T @ there[:3] * (at.length / length), R.T @ there[3:]])
    U = np.linalg.qr(there if system.dim == 3 else there[[0, 1, 5]])[0]
    return U if np.abs(J - U @ (U.T @ J)).max(initial=0.0) < 1e-10 else np.eye(rows)


class _Open(NamedTuple):
    """A cluster without a proof that it is a manifold, and a proven lower bound of its dimension."""

    here: Here
    lower: int


def _prove_part(
    s: ConstraintGraph,
    at: Screws,
    equations: Equations,
    q: Array,
    part: Part,
    value: Array,
    J: Array,
) -> Proof | _Open | None:
    """Prove the dimension of one cluster by theorems about manifolds.

    Returns what remains open, or None where nothing can be proven.
    """
    here = split_rows(q, J, np.hstack(part.rows), part.columns)
    A = here.matrix
    delta = here.split.delta
    corank = here.split.corank
    own = here.basis.T @ value
    if (
        min(A.shape)
        and _certify_cluster(
            s, at, part.cluster, here.values, A, float(np.linalg.norm(own)), False
        ).regular
    ):
        why = "all constraints are independent in the groups of motions of their loops"
        return Proof(
            max(A.shape[1] - A.shape[0], 0),
            1,
            why if delta else "no velocity keeps the loops closed",
        )
    if not corank or not delta:
        return None if len(A) else Proof(delta, 1, "")
    if not here.clear:
        return None
    if here.exact and _is_two_group_loop(s, at, part.cluster):
        return Proof(delta, 1, "both chains of the loop fill a group of motions")
    lower = find_family_dimension(equations, q, [here.split.null_space])
    if lower == delta:
        return Proof(delta, 1, "angles in fixed ratios keep all loops closed")
    if delta == 1 and _is_bennett_loop(
        s, at, equations, q, part.cluster, here.split.null_space[:, 0]
    ):
        return Proof(1, 1, "tangents of half angles in fixed ratios keep the loop closed")
    return _Open(here, lower)


def _prove_by_forms(
    equations: Equations,
    q: Array,
    part: Part,
    known: _Open,
    order: int,
    rng: np.random.Generator,
    tangents: Sequence[Array],
) -> Proof | None:
    """Prove the dimension of one cluster by leading forms, if they suffice."""
    lower = max(
        known.lower,
        find_family_dimension(
            equations, q, [_restrict_to_columns(t, part.columns) for t in tangents]
        ),
    )
    found = decide_dimension(
        equations, known.here, part.rows, part.uses, lower, order, rng, tangents
    )
    return None if found is None else Proof(*found)


def _restrict_to_columns(T: Array, columns: np.ndarray) -> Array:
    """Return tangents (nv, k) with all rows but `columns` set to zero."""
    out = np.zeros_like(T)
    out[columns] = T[columns]
    return out


def _is_bennett_loop(
    s: ConstraintGraph, at: Screws, equations: Equations, q: Array, c: Cluster, null_space: Array
) -> bool:
    """Return whether the only loop is a Bennett linkage: four hinges that can move."""
    if (
        len(c.loops) != 1
        or c.laws
        or c.has_shared_velocities
        or not s.edges[s.loops[c.loops[0]].edge].is_joint
    ):
        return False
    path = [(i, sign) for i, sign in s.loops[c.loops[0]].path if at.twists[i].shape[1]]
    columns = [x for i, _ in path for x in s.edges[i].columns]
    if len(columns) != 4 or any(
        x.index < 0 or abs(x.multiplier) != 1.0 or x.slides for x in columns
    ):
        return False
    axes = np.stack([sign * at.twists[i][:, 0] for i, sign in path], axis=1)
    if np.abs(np.linalg.norm(axes[3:], axis=0) - 1.0).max() > SAME:
        return False
    return is_half_angle_motion(equations, q, axes, [x.index for x in columns], null_space)


def _is_two_group_loop(s: ConstraintGraph, at: Screws, c: Cluster) -> bool:
    """Return whether the only loop is two chains that each fill a group of motions."""
    if (
        len(c.loops) != 1
        or c.laws
        or c.has_shared_velocities
        or not s.edges[s.loops[c.loops[0]].edge].is_joint
    ):
        return False
    path = [i for i, _ in s.loops[c.loops[0]].path if at.twists[i].shape[1]]
    if len(path) > LONG or any(
        s.edges[i].particle or any(x.index < 0 for x in s.edges[i].columns) for i in path
    ):
        return False
    n = len(path)
    twists = np.concatenate([at.twists[i] for i in path], axis=1)
    first: list[int] = np.cumsum([0, *(at.twists[i].shape[1] for i in path)]).tolist()
    first += [first[-1] + x for x in first[1:]]
    columns = list(range(first[n])) * 2
    alike = [mask.tolist() for mask in _compare_screws(twists)]
    # from column i on, how many are alike in pairs
    runs = [
        max(_count_alike_columns(mask, columns, i) for mask in alike) for i in range(len(columns))
    ]

    def can_fill_group(i: int, k: int) -> bool:
        """Return whether the joints i to k may fill a group, by a quick test."""
        return first[k] - first[i] > 5 or runs[first[i]] >= first[k] - first[i]

    def does_fill_group(i: int, k: int) -> bool:
        """Return whether the joints i to k fill the group that they generate."""
        return spans_lie_algebra(twists[:, columns[first[i] : first[k]]], SAME, CLEAR)

    pairs = [
        (i, k)
        for i in range(n)
        for k in range(i + 1, n)
        if can_fill_group(i, k) and can_fill_group(k, i + n)
    ]
    return any(does_fill_group(i, k) and does_fill_group(k, i + n) for i, k in pairs)


def _count_alike_columns(alike: list[list[bool]], columns: list[int], first: int) -> int:
    """Count the columns from `first` on that are alike in pairs, up to six."""
    for k in range(first, min(first + 6, len(columns))):
        if not all(alike[columns[k]][columns[i]] for i in range(first, k + 1)):
            return k - first
    return 6


def _compare_screws(twists: Array) -> tuple[np.ndarray, np.ndarray]:
    """Compare screws (6, n): masks (n, n) of parallel rotations, and of reciprocal pairs.

    Fewer than six screws fill a group only if all have parallel turns, or all axes meet in one
    point.
    """
    v = twists[:3].T
    w = twists[3:].T
    turned = np.cross(w[:, None], w[None])
    return np.abs(turned).max(axis=2) < CLEAR, np.abs(v @ w.T + w @ v.T) < CLEAR
