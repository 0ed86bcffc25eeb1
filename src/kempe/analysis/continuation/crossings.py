"""Singular points of a curve of configurations: where exactly, and which branches meet there.

At a singular point of the constraints the Jacobian loses rank: there are more null directions than the curve has,
and as many new combinations of equations that vanish to first order. Their second-order forms on the null space tell
the directions of the branches: the tangent cone (Müller, *J. Mechanisms Robotics* 8, 2016; Allgower, Georg, 1990, 8.3).
"""

from __future__ import annotations

import numpy as np

from kempe.analysis.continuation.continuation import Closure
from kempe.kinematics.common.gauss_newton import gauss_newton, least_squares
from kempe.singular_values import svd
from kempe.solvers.common.clock import TimeLimit
from kempe.solvers.common.tracing import RANK, Node, correct, node
from kempe.spatial import Array

DIFFERENCE = 1e-5
"""Step of the central differences of the Jacobian; error about 1e-10, which only slows Newton's method."""
SINGULAR = 1e-11
"""Residual below which a point counts as singular: lengths given with eleven digits cross, not nearly cross."""
PROBE = 2e-3
"""Distance at which a direction is checked to be that of a branch."""
SAME_LINE = 1e-4
"""Directions nearer than this are one."""
AHEAD = 0.8
"""Cosine between a chord and the direction of a branch at a singular point for them to be the same branch."""


def second_order(equations: Closure, x: Array, left: Array, along: Array) -> Array:
    """Derivatives (n, k, d) of `J.T @ left` (left: (rows, k)) along the columns of `along` (n, d)."""
    out = np.empty((equations.n, left.shape[1], along.shape[1]))
    for j in range(along.shape[1]):
        y = DIFFERENCE * along[:, j]
        change = equations.matrix(equations.move(x, y)) - equations.matrix(equations.move(x, -y))
        out[:, :, j] = change.T @ left / (2.0 * DIFFERENCE)
    return out


def locate(equations: Closure, x: Array, nullity: int, reach: float, tries: int = 20) -> Array | None:
    """The point near `x`, at most `reach` away, where the loops are closed and the null space has dimension `nullity`.

    Newton's method on the equations together with ``J.T @ left = 0`` and a normalisation of the left null vectors,
    which is regular where branches cross transversally (Moore, *Numer. Funct. Anal. Optim.* 1980). None where there
    is no such point.
    """
    n = equations.n
    left: Array = np.asarray(svd(equations.matrix(x))[0][:, n - nullity :], dtype=float)
    rows, k = left.shape
    fixed, start, nq = left, x, len(x)

    def both(z: Array) -> tuple[Array, Array]:
        F, J = equations.both(z[:nq])
        near = np.linalg.norm(equations.between(start, z[:nq])) <= reach
        return np.concatenate([F, (z[nq:].reshape(k, rows) @ J).ravel()]) if near else np.full(1, np.inf), J

    def newton(z: Array, missing: Array, J: Array) -> Array:
        x, left = z[:nq], z[nq:].reshape(k, rows).T
        A = np.zeros((rows + n * k + k * k, n + rows * k))
        A[:rows, :n] = J
        A[rows : rows + n * k, :n] = second_order(equations, x, left, np.eye(n)).transpose(1, 0, 2).reshape(n * k, n)
        for i in range(k):
            columns = slice(n + rows * i, n + rows * (i + 1))
            A[rows + n * i : rows + n * (i + 1), columns] = J.T
            A[rows + n * k + k * i : rows + n * k + k * (i + 1), columns] = fixed.T
        return least_squares(A, np.concatenate([-missing, np.zeros(k * k)]))

    found = gauss_newton(both, np.append(x, left.T), tries, step=newton, met=1e-15,
                         move=lambda z, y: np.append(equations.move(z[:nq], y[:n]), z[nq:] + y[n:]))  # fmt: skip
    if not found.size <= SINGULAR:
        return None
    x = found.x[:nq]
    s = svd(equations.matrix(x), compute_uv=False)
    found = int(np.sum(s <= RANK * s[0]))
    if found <= nullity:
        return x if found == nullity else None
    better = locate(equations, x, found, reach, tries)  # more equations, which make it regular again
    return x if better is None else better


def cone(equations: Closure, x: Array) -> Array:
    """Directions (k, n), of length 1 and without sign, in which second order lets the null space at `x` move."""
    U, s, Vt = svd(equations.matrix(x))
    n = equations.n
    d = int(np.sum(s <= RANK * max(s[0], 1e-300)))
    if d <= 1:
        return Vt[n - d :]
    null_space, left = Vt[n - d :].T, U[:, n - d :]
    forms = np.einsum("nd,nke->kde", null_space, second_order(equations, x, left, null_space))
    forms = 0.5 * (forms + forms.transpose(0, 2, 1))
    size = np.abs(forms).max()
    if size < 1e-9:
        return np.zeros((0, n))
    found = _two(forms / size) if d == 2 else _many(forms / size, equations.budget)
    return found @ null_space.T


def _two(forms: Array) -> Array:
    """Common real zeros (k, 2) of quadratic forms (m, 2, 2)."""
    rows = np.stack([forms[:, 0, 0], 2.0 * forms[:, 0, 1], forms[:, 1, 1]], axis=1)
    Vt = svd(rows)[2]
    a, b, c = Vt[0]  # a u^2 + b u v + c v^2, the combination of the forms that is largest
    root = b * b - 4.0 * a * c
    if root < -1e-8:
        return np.zeros((0, 2))
    w = -0.5 * (b + np.copysign(np.sqrt(max(root, 0.0)), b))
    found = [np.array(v) / np.hypot(*v) for v in ((w, a), (c, w)) if np.hypot(*v) > 1e-6]
    lines = np.array(found if root > 1e-8 else found[:1])
    other = np.einsum("ki,mij,kj->km", lines, forms, lines)
    return lines[np.abs(other).max(axis=1) < 1e-6]


def _many(forms: Array, budget: TimeLimit) -> Array:
    """Common real zeros (k, d) of quadratic forms (m, d, d), by Newton's method from many starts on the sphere."""
    d: int = forms.shape[1]
    rng = np.random.default_rng(0)
    found: list[Array] = []

    def both(u: Array) -> tuple[Array, Array]:
        return np.append(np.einsum("i,mij,j->m", u, forms, u), 0.0), np.vstack([2.0 * forms @ u, u])

    def onto(u: Array, y: Array) -> Array:
        return (u + y) / np.linalg.norm(u + y)

    for _ in range(40 * 2**d):
        budget.check()
        u = rng.normal(size=d)
        u = u / np.linalg.norm(u)
        u, left, _ = gauss_newton(both, u, 40, cut=1e-12, last=1e-15, move=onto)
        if np.abs(left).max() < 1e-9 and all(abs(abs(u @ v) - 1.0) > SAME_LINE for v in found):
            found.append(u)
    return np.array(found).reshape(-1, d)


def branch_lines(equations: Closure, x: Array) -> Array:
    """Directions (k, n) of the curves through a singular point: those of the tangent cone along which one can walk."""
    lines: list[Array] = []
    for t in cone(equations, x):
        for sign in (1.0, -1.0):
            other = correct(equations, equations.move(x, sign * PROBE * t), t)
            if other is None:
                continue
            y = equations.between(x, other.x) * sign
            if y @ t < 0.9 * np.linalg.norm(y) or node(equations, other.x, None, other.J).nullity > 1:
                continue
            if all(abs(t @ v) < 1.0 - SAME_LINE for v in lines):
                lines.append(t)
            break
    return np.array(lines).reshape(-1, equations.n)


def singular_node(equations: Closure, x: Array, toward: Array) -> Node | None:
    """The node at a singular point on the branch whose direction is nearest to `toward` (n,)."""
    lines = branch_lines(equations, x)
    if not len(lines):
        return None
    cosines = lines @ toward / max(float(np.linalg.norm(toward)), 1e-300)
    best = int(np.argmax(np.abs(cosines)))
    if abs(cosines[best]) < AHEAD:
        return None
    at = node(equations, x)
    t = lines[best] * np.sign(cosines[best])
    return Node(x, t, at.sigma, max(at.nullity, 2), at.matrix, at.image, lines)


def crossing(equations: Closure, a: Node, b: Node) -> Node | None:
    """The singular point between two neighbours of one branch, or None."""
    y = equations.between(a.x, b.x)
    h = float(np.linalg.norm(y))
    f = a.sigma / max(a.sigma + b.sigma, 1e-300)
    guess = equations.move(a.x, f * y)
    for nullity in (2, 3, 4):
        if nullity > equations.n:
            break
        x = locate(equations, guess, nullity, 2.0 * h)
        if x is None:
            continue
        z = equations.between(a.x, x)
        along = float(z @ y) / h
        if -1e-9 <= along <= h + 1e-9 and np.linalg.norm(z - along * y / h) <= 0.25 * h:
            return singular_node(equations, x, y)
    return None
