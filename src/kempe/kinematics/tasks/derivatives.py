"""Derivatives of functions that users give: supplied and checked, by complex steps, or by central
differences.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from kempe.errors import InputError
from kempe.model.tree.coordinate_layout import Layout
from kempe.reals import reals
from kempe.spatial import Array

SUPPLIED = "supplied"
COMPLEX = "complex step"
DIFFERENCES = "central differences"
"""Where a derivative comes from."""
IMAGINARY_STEP = 1e-30
"""A complex step has no cancellation, so it can be this small (Squire, Trapp, 1998)."""
REAL_STEP = float(np.finfo(float).eps) ** (1.0 / 3.0)
"""Step of central differences: their error is of second order, that of rounding of order -1."""
AGREE = 1e-5
"""How far, relative to 1 and the largest entry, a derivative may be from central differences and be
taken as right."""


def tangent(layout: Layout, q: Array) -> Array:
    """Matrix (nq, nv) that takes velocity coordinates to time derivatives of the entries of q."""
    out = np.zeros((layout.nq, layout.nv))
    out[layout.vector_q, layout.vector_v] = 1.0
    for iq, iv in zip(layout.quaternion_q, layout.quaternion_v, strict=True):
        w, x, y, z = q[iq : iq + 4]
        # q' = q (0, w) / 2
        out[iq : iq + 4, iv : iv + 3] = 0.5 * np.array(
            [[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]]
        )
    return out


def differences(function: Callable[[Array], Any], layout: Layout, q: Array) -> Array:
    """Derivatives (m, nv) by the velocity coordinates, by central differences on the manifold of q."""
    steps = REAL_STEP * np.eye(layout.nv)
    ends = [
        [np.asarray(function(layout.integrate(q, s * e)), dtype=float).ravel() for s in (1, -1)]
        for e in steps
    ]
    if not ends:
        return np.zeros((np.size(function(q)), 0))
    return np.stack([(a - b) / (2.0 * REAL_STEP) for a, b in ends], axis=-1)


def complex_steps(function: Callable[[Array], Any], layout: Layout, q: Array) -> Array:
    """Derivatives (m, nv) by the velocity coordinates, by imaginary steps; the function must be
    analytic.
    """
    steps = 1j * IMAGINARY_STEP * tangent(layout, q).T
    out = [np.imag(function(q + step)).ravel() / IMAGINARY_STEP for step in steps]
    return np.stack(out, axis=-1) if out else np.zeros((np.size(function(q)), 0))


def jacobian_of(
    function: Callable[[Array], Any],
    derivative: Callable[[Array], Any] | None,
    how: str,
    layout: Layout,
    q: Array,
) -> Array:
    """Derivatives (m, nv) of a function of q in the way that `how` says."""
    if derivative is not None:
        return reals(derivative(q), "the Jacobian of a constraint")
    return (
        complex_steps(function, layout, q) if how == COMPLEX else differences(function, layout, q)
    )


def way_of(function: Callable[[Array], Any], layout: Layout, q: Array) -> str:
    """`COMPLEX` where the function takes complex numbers and derives rightly with them at q, else
    `DIFFERENCES`.
    """
    real = differences(function, layout, q)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "error"
            )  # numpy only warns where an imaginary part is thrown away
            found = complex_steps(function, layout, q)
    except (TypeError, ValueError, AttributeError, ArithmeticError, Warning):
        return DIFFERENCES
    return COMPLEX if found.shape == real.shape and _agree(found, real) else DIFFERENCES


def checked_value(name: str, function: Callable[[Array], Any], q: Array) -> Array:
    """What the function of a constraint gives at q, () or (m,). Errors: `InputError` for anything
    else.
    """
    found = function(q)
    try:
        value = reals(found, "the value")
    except InputError:
        value = np.full((), np.nan)
    if value.ndim > 1 or not np.isfinite(value).all():
        raise InputError(
            f"constraint {name!r} gives {found!r}; it must give a number or an array (m,), finite"
        )
    return value


def check_supplied(
    name: str,
    function: Callable[[Array], Any],
    derivative: Callable[[Array], Any],
    layout: Layout,
    q: Array,
    columns: tuple[str, ...],
) -> None:
    """Refuse a supplied Jacobian that differs from central differences at q, with its worst entry."""
    real = np.atleast_2d(differences(function, layout, q))
    given = reals(derivative(q), f"constraint {name!r}: its Jacobian")
    if given.shape != real.shape:
        raise InputError(
            f"constraint {name!r}: its Jacobian has shape {given.shape}; it must have {real.shape}"
        )
    if not _agree(given, real):
        off = np.where(np.isfinite(given), np.abs(given - real), math.inf)
        i, k = np.unravel_index(np.argmax(off), off.shape)
        raise InputError(
            f"constraint {name!r}: its Jacobian is wrong: the derivative of row {i} by "
            f"{columns[k]!r} is given as {given[i, k]:.6g}, central differences give "
            f"{real[i, k]:.6g}"
        )


def _agree(a: Array, b: Array) -> bool:
    scale = 1.0 + float(np.max(np.abs(b), initial=0.0))
    return bool(np.all(np.abs(a - b) <= AGREE * scale))  # not a number fails
