"""Small dense solves: at six unknowns a library call costs more than the arithmetic."""

from __future__ import annotations

from kempe.kernels.base._jit import device


@device
def solve_definite_six(a, b):
    """Solve A y = b for 6 unknowns by A = L D L^T, with A symmetric and positive definite.

    a: its lower triangle, row by row (21 numbers)."""
    (
        a00,
        a10,
        a11,
        a20,
        a21,
        a22,
        a30,
        a31,
        a32,
        a33,
        a40,
        a41,
        a42,
        a43,
        a44,
        a50,
        a51,
        a52,
        a53,
        a54,
        a55,
    ) = a
    # u = L D, l = L below the diagonal; d = 1 / D
    d0 = 1.0 / a00
    l10 = a10 * d0
    l20 = a20 * d0
    l30 = a30 * d0
    l40 = a40 * d0
    l50 = a50 * d0
    d1 = 1.0 / (a11 - l10 * a10)
    u21 = a21 - l20 * a10
    u31 = a31 - l30 * a10
    u41 = a41 - l40 * a10
    u51 = a51 - l50 * a10
    l21 = u21 * d1
    l31 = u31 * d1
    l41 = u41 * d1
    l51 = u51 * d1
    d2 = 1.0 / (a22 - l20 * a20 - l21 * u21)
    u32 = a32 - l30 * a20 - l31 * u21
    u42 = a42 - l40 * a20 - l41 * u21
    u52 = a52 - l50 * a20 - l51 * u21
    l32 = u32 * d2
    l42 = u42 * d2
    l52 = u52 * d2
    d3 = 1.0 / (a33 - l30 * a30 - l31 * u31 - l32 * u32)
    u43 = a43 - l40 * a30 - l41 * u31 - l42 * u32
    u53 = a53 - l50 * a30 - l51 * u31 - l52 * u32
    l43 = u43 * d3
    l53 = u53 * d3
    d4 = 1.0 / (a44 - l40 * a40 - l41 * u41 - l42 * u42 - l43 * u43)
    u54 = a54 - l50 * a40 - l51 * u41 - l52 * u42 - l53 * u43
    l54 = u54 * d4
    d5 = 1.0 / (a55 - l50 * a50 - l51 * u51 - l52 * u52 - l53 * u53 - l54 * u54)
    y0 = b[0]
    y1 = b[1] - l10 * y0
    y2 = b[2] - l20 * y0 - l21 * y1
    y3 = b[3] - l30 * y0 - l31 * y1 - l32 * y2
    y4 = b[4] - l40 * y0 - l41 * y1 - l42 * y2 - l43 * y3
    y5 = b[5] - l50 * y0 - l51 * y1 - l52 * y2 - l53 * y3 - l54 * y4
    y5 = y5 * d5
    y4 = y4 * d4 - l54 * y5
    y3 = y3 * d3 - l43 * y4 - l53 * y5
    y2 = y2 * d2 - l32 * y3 - l42 * y4 - l52 * y5
    y1 = y1 * d1 - l21 * y2 - l31 * y3 - l41 * y4 - l51 * y5
    y0 = y0 * d0 - l10 * y1 - l20 * y2 - l30 * y3 - l40 * y4 - l50 * y5
    return y0, y1, y2, y3, y4, y5


@device
def factor_matrix(a, n):
    """Overwrite the lower triangle of a symmetric n by n matrix with its factors L and D; return
    whether it is positive definite.

    a: pointer to n * n numbers, row by row; A = L D L^T, D on the diagonal.
    """
    for j in range(n):
        d = a[j * n + j]
        for k in range(j):
            d -= a[j * n + k] * a[j * n + k] * a[k * n + k]
        if not d > 0.0:
            return False
        a[j * n + j] = d
        for i in range(j + 1, n):
            s = a[i * n + j]
            for k in range(j):
                s -= a[i * n + k] * a[j * n + k] * a[k * n + k]
            a[i * n + j] = s / d
    return True


@device
def substitute_back(a, n, b):
    """Overwrite b with the solution of A x = b, a as `factor_matrix` leaves it."""
    for i in range(n):
        for k in range(i):
            b[i] -= a[i * n + k] * b[k]
    for i in range(n):
        b[i] /= a[i * n + i]
    for j in range(n):
        i = n - 1 - j
        for k in range(i + 1, n):
            b[i] -= a[k * n + i] * b[k]
