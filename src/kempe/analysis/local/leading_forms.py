"""What the reduced equations at a singular configuration prove: dimensions from their leading
forms.

Let g(s) = 0 be what the reduction of Lyapunov and Schmidt leaves, c equations in delta unknowns,
and G its leading forms. Upper bounds hold for complex solutions, so that dimensions drop by one at
most with each equation added:

- one unknown: any coefficient that is not zero isolates the configuration;
- one equation: solutions have delta - 1 dimensions where g has both signs at all small distances,
  for they part these;
- quadratic forms without a common complex zero on a subspace of codimension d: at most d dimensions
  (Macaulay, 1916, decides that by a rank); a definite combination of them: none;
- coordinates held, so that loop by loop all others are isolated: at most as many dimensions as are
  held.

A zero of the quadratic forms where their derivatives are independent is the tangent of a branch of
delta - c dimensions (implicit function theorem, after a blow-up): a lower bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, combinations_with_replacement
from typing import NamedTuple

import numpy as np

from kempe.analysis.local import reduction
from kempe.analysis.local.local_equations import Equations
from kempe.analysis.local.reduction import Split
from kempe.singular_values import svd
from kempe.spatial import Array

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
    """Equations of a part at a configuration: their reduced Jacobian `matrix`, its singular values
    and its split.

    `basis` (m, k) are the rows that are looked at, `clear` whether the rank is beyond doubt,
    `exact` whether what does not count is zero to rounding.
    """

    matrix: Array
    values: Array
    split: Split
    basis: Array
    clear: bool
    exact: bool


def split_of(q: Array, J: Array, basis: Array, columns: np.ndarray) -> Here:
    """The reduced equations of the rows `basis` (m, k) of J (m, nv) in the unknowns `columns`, all
    others held.
    """
    m, nv = J.shape
    A = basis.T @ J[:, columns]
    n = len(columns)
    U, sigma, Vt = svd(A)
    most = max(float(sigma[0]) if sigma.size else 0.0, reduction.LEAST)
    rank = int(np.sum(sigma > reduction.RANK * most))
    rest = float(sigma[rank]) if rank < len(sigma) else 0.0
    last = float(sigma[rank - 1]) if rank else np.inf
    clear = last > GAP * max(rest, ROUNDING * most)
    null_space = np.zeros((nv, n - rank))
    inverse = np.zeros((nv, m))
    null_space[columns] = Vt[rank:].T
    inverse[columns] = (Vt[:rank].T / sigma[:rank]) @ (basis @ U[:, :rank]).T
    padded = np.concatenate([np.full(nv - n, most), sigma])
    return Here(
        A,
        sigma,
        Split(q, padded, null_space, basis @ U[:, rank:], inverse),
        basis,
        clear,
        rest <= SINGULAR * most,
    )


def decide(
    equations: Equations,
    here: Here,
    rows: Sequence[Array],
    uses: Sequence[np.ndarray],
    known: int,
    order: int,
    rng: np.random.Generator,
    tangents: Sequence[Array],
) -> tuple[int, int | None, str] | None:
    """Dimension, number of branches (None: unknown) and reason, if the forms decide; `known` is a
    proven lower bound.

    `rows` (m, k) and `uses` are the equations and unknowns of each loop, `tangents` (nv, k) belong
    to motions found.
    """
    at = here.split
    found = reduction.obstruction(equations, at, order, rng)
    k = _order(found)
    if k is None:
        return None
    if at.delta == 1:
        return 0, 0, f"the only velocity is obstructed at order {k}"
    directions = _directions(at, tangents)
    if at.corank == 1:
        return _one_equation(equations, here, k, found.noise, rng, directions)
    if k > 2 or at.delta > MANY or not here.exact:
        return None
    B = quadratic(equations, at)
    lower = max(known, at.delta - at.corank if any(_regular_zero(B, d) for d in directions) else 0)
    if lower == 0 and _definite(B, rng):
        return 0, 0, "second-order terms of one sign obstruct all velocities"
    t = at.delta - lower
    if _no_zero(B, t, rng) or _holding(equations, here, rows, uses, lower, order, rng):
        return (
            lower,
            0 if lower == 0 else None,
            "the zeros of the leading forms have no more dimensions",
        )
    return None


def _order(found: reduction.Obstruction) -> int | None:
    """The first order at which the reduced equations are clearly not zero."""
    k = found.order
    return None if k is None or found.size[k] < GAP * found.noise[k] else k


def _directions(at: Split, tangents: Sequence[Array]) -> list[Array]:
    """Unit vectors, in the basis of the null space, along motions that were found."""
    out: list[Array] = []
    for T in tangents:
        for d in (at.null_space.T @ T).T:
            size = float(np.linalg.norm(d))
            if size > 0.1:
                out.append(d / size)
    return out


# ---- one equation


def _one_equation(
    equations: Equations,
    here: Here,
    k: int,
    noise: Array,
    rng: np.random.Generator,
    directions: list[Array],
) -> tuple[int, int | None, str] | None:
    at = here.split
    delta = here.split.delta
    if k > 2 and not here.exact:
        return None
    lines = [*reduction.unit_directions(rng, LINES, delta), *directions]
    eigen = np.zeros(delta)
    if k == 2 and delta <= MANY:
        eigen, V = np.linalg.eigh(quadratic(equations, at)[0])
        clear = np.abs(eigen) > CLEAR * np.abs(eigen).max()
        if clear.all() and (eigen > 0).all() or clear.all() and (eigen < 0).all():
            if not here.exact:
                return None  # a small sphere passes through q where the equation has a linear term
            return 0, 0, "second-order terms of one sign obstruct all velocities"
        lines += list(V.T)
    g, slow = reduction._solve(
        equations, at, reduction.lines(np.array(lines), len(noise) - 1), None
    )
    signs: set[int] = set()
    for row in (g / slow)[..., 0]:
        seen = np.flatnonzero(np.abs(row) > np.maximum(reduction.NOT_ZERO, GAP * noise))
        if not seen.size or np.abs(row[: seen[0]]).max(initial=0.0) > reduction.ZERO:
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


# ---- quadratic forms


def quadratic(equations: Equations, at: Split) -> Array:
    """The quadratic forms (c, delta, delta) of the reduced equations, as symmetric matrices."""
    delta = at.delta
    pairs = list(combinations(range(delta), 2))
    d = np.zeros((delta + len(pairs), delta))
    d[:delta] = np.eye(delta)
    for n, (i, j) in enumerate(pairs, delta):
        d[n, [i, j]] = np.sqrt(0.5)
    g = reduction._solve(equations, at, reduction.lines(d, 2), None)[0][:, 2]
    B = np.zeros((at.corank, delta, delta))
    B[:, range(delta), range(delta)] = g[:delta].T
    for n, (i, j) in enumerate(pairs, delta):
        B[:, i, j] = B[:, j, i] = g[n] - 0.5 * (g[i] + g[j])
    return B


def _regular_zero(B: Array, d: Array) -> bool:
    """Whether the forms have a zero near d (delta,) at which their derivatives are independent."""
    c, delta, _ = B.shape
    if c >= delta:
        return False
    size = float(np.abs(B).max())
    for _ in range(20):
        D = 2.0 * B @ d
        if np.linalg.norm(B @ d @ d) < 1e-13 * size:
            sigma = svd(D, compute_uv=False)
            return bool(sigma[c - 1] > CLEAR * size)
        d = d - np.linalg.lstsq(D, B @ d @ d, rcond=CLEAR)[0]
        d = d / np.linalg.norm(d)
    return False


def _definite(B: Array, rng: np.random.Generator) -> bool:
    """Whether some combination of the forms is definite."""
    mix = np.concatenate([np.eye(len(B)), reduction.unit_directions(rng, MIXTURES, len(B))])
    eigen = np.linalg.eigvalsh(np.einsum("nc,cij->nij", mix, B))
    size = CLEAR * np.abs(eigen).max()
    return bool(np.any(eigen[:, 0] > size) or np.any(eigen[:, -1] < -size))


def _no_zero(B: Array, t: int, rng: np.random.Generator) -> bool:
    """Whether the forms have no common complex zero but 0 on a random subspace of t dimensions.

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
    sigma = svd(M, compute_uv=False)
    return bool(sigma[-1] > CLEAR * sigma[0])


# ---- coordinates held


def _holding(
    equations: Equations,
    here: Here,
    rows: Sequence[Array],
    uses: Sequence[np.ndarray],
    count: int,
    order: int,
    rng: np.random.Generator,
) -> bool:
    """Whether some `count` coordinates, when held, leave all others isolated, loop by loop."""
    at = here.split
    J = equations.linearise(at.q)[1][0]
    moving = np.flatnonzero(np.abs(at.null_space).max(axis=1) > CLEAR)
    unknown = np.unique(np.concatenate(list(uses)))
    choices: list[tuple[int, ...]] = list(combinations(moving.tolist(), count))
    if len(choices) > HELD:
        choices = [choices[i] for i in rng.choice(len(choices), HELD, replace=False)]
    return any(
        _triangular(equations, at.q, J, rows, uses, np.setdiff1d(unknown, c), order, rng)
        for c in choices
    )


def _triangular(
    equations: Equations,
    q: Array,
    J: Array,
    rows: Sequence[Array],
    uses: Sequence[np.ndarray],
    left: np.ndarray,
    order: int,
    rng: np.random.Generator,
) -> bool:
    """Whether the unknowns `left` are isolated, those of one loop after the other."""
    pending = list(range(len(rows)))
    while len(left):
        waiting: list[int] = []
        for k in pending:
            own = np.intersect1d(uses[k], left)
            if not len(own) or _isolated(equations, split_of(q, J, rows[k], own), order, rng):
                left = np.setdiff1d(left, own)
            else:
                waiting.append(k)
        if len(waiting) == len(pending):
            return False
        pending = waiting
    return True


def _isolated(equations: Equations, here: Here, order: int, rng: np.random.Generator) -> bool:
    """Whether the configuration is an isolated complex solution of some equations in some unknowns."""
    at = here.split
    if not here.clear or at.delta > VARIABLES:
        return False
    if at.delta == 0:
        return True
    if at.corank == 0:
        return False
    k = _order(reduction.obstruction(equations, at, order, rng))
    if k is None or at.delta == 1:
        return k is not None
    return k == 2 and here.exact and _no_zero(quadratic(equations, at), at.delta, rng)
