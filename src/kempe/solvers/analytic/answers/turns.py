"""Rows of an answer chosen or ordered: every turn inside the limits, only what is inside, branches
that continue.
"""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np

from kempe.errors import InputError
from kempe.kernels.closed_form import analytic_layout as A
from kempe.kernels.forward.table_layout import SLIDE
from kempe.solvers.analytic.plans.chain_lines import Lines
from kempe.spatial import Array

NEW = 1e3
"""Change of the joints that is as bad as the beginning of a branch."""

MOST_ROWS = 20_000
"""Rows of one target, at most: limits of many turns multiply."""


def inside_rows(rows: Array, single: bool) -> Array:
    """The rows (N, K, n + 2) with those outside the limits not in use; of a single target these
    come last.
    """
    code = rows[..., -A.INFO + A.CODE]
    out = rows.copy()
    out[(code >= 0.0) & (code.astype(np.int64) % 2 == 0), -A.INFO + A.CODE] = A.UNUSED
    return packed(out) if single else out


def packed(rows: Array) -> Array:
    """The rows (N, K, n + 2) with those in use first, in their order."""
    unused = rows[..., -A.INFO + A.CODE] < 0.0
    order = np.argsort(unused, axis=1, kind="stable")
    return np.take_along_axis(rows, order[..., None], axis=1)


def expanded(rows: Array, lines: Lines) -> Array:
    """The rows (N, K, n + 2) with every turn of each angle that is inside the limits; what is
    outside stays as it is.

    Errors: `InputError` where one target would have more than MOST_ROWS.
    """
    for i in range(len(lines) if rows.size else 0):
        low, high = lines.limits[:, i]
        period = 2.0 * math.pi / abs(lines.multiplier[i])
        if lines.kinds[i] == SLIDE or not high - low < math.inf or high - low < period - 1e-9:
            continue
        code = rows[..., -A.INFO + A.CODE]
        q = rows[..., i]
        fits = (code >= 0.0) & (code.astype(np.int64) % 2 == 1)
        first = np.where(fits, np.ceil((low - q) / period - 1e-12), 0.0)
        last = np.where(fits, np.floor((high - q) / period + 1e-12), 0.0)
        count = int(np.nanmax(last - first, initial=0.0)) + 1
        if rows.shape[1] * count > MOST_ROWS:
            raise InputError(
                f"more than {MOST_ROWS} solutions: joint {lines.names[i]!r} alone has {count} turns"
            )
        turns = first[..., None] + np.arange(count)
        more = np.repeat(rows[:, :, None], count, axis=2)
        more[..., i] = np.where(
            fits[..., None], np.clip(q[..., None] + turns * period, low, high), q[..., None]
        )
        more[..., -A.INFO + A.CODE] = np.where(
            turns <= last[..., None], more[..., -A.INFO + A.CODE], A.UNUSED
        )
        rows = packed(more.reshape(len(rows), -1, rows.shape[2]))
        used = rows[..., -A.INFO + A.CODE] >= 0.0
        rows = rows[:, : max(int(used.sum(axis=1).max(initial=0)), 1)]
    return rows


def followed(rows: Array, lines: Lines, length: int) -> Array:
    """The rows (N, K, n + 2) of trajectories of `length` targets, each in the place of the one that
    it continues.
    """
    from scipy import optimize

    out = rows.copy()
    n = len(lines)
    unit = np.abs(lines.multiplier)
    period = np.where(lines.kinds == SLIDE, np.inf, 2.0 * math.pi / unit)
    for first in range(0, len(rows), max(length, 1)):
        last = np.full((rows.shape[1], n), np.nan)  # where each place was last in use
        for i in range(first, min(first + length, len(rows))):
            used = out[i, :, n + A.CODE] >= 0.0
            with np.errstate(invalid="ignore"):
                d = out[i, None, :, :n] - last[:, None]
                d = np.where(np.isinf(period), d, d - period * np.round(d / period))
                cost = np.linalg.norm(d * unit, axis=-1)
            cost = np.where(used, np.where(np.isnan(cost), NEW, np.minimum(cost, NEW)), 2.0 * NEW)
            order: np.ndarray = cast(Any, optimize).linear_sum_assignment(cost)[1]
            out[i] = out[i, order]
            last = np.where((out[i, :, n + A.CODE] >= 0.0)[:, None], out[i, :, :n], last)
    return out
