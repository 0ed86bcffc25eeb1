"""Growth vectors: dimensions that Lie brackets of the free velocities A(q) v = 0 span.

The fields X_c(q) are velocities in the null space of A(q). D^1 is what they span at q, D^s what
brackets of up to s of them span; the growth vector is (dim D^1, dim D^2, ...). Brackets of random
letters span, one after the other, all brackets of their length: words [X_1, [X_2, ... [X_(s-1),
Y]]] of letters from a basis do (the Jacobi identity), they are linear in each letter, and values of
a polynomial at random points span what all its values do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kempe.budget import check_for_stop
from kempe.equations.velocity import VelocityRows
from kempe.kernels.compiled import lie_brackets
from kempe.numerics.rank import Level, Spectrum
from kempe.spatial import Array

ROUNDING = 30.0
"""How many times its estimated rounding a direction must be long to count."""
SEEN = 3.0
DOUBT = 300.0
"""Between how many times its rounding a direction is doubtful, whether it counts or not."""
EXACT = 1e-15
"""How far a configuration is from where it should be, in units, up to which all error of brackets
is their rounding."""
SHARE = 1e-3
"""The least part of an estimate of rounding that is believed."""
BLIND = 1e-6
"""Part of a bracket that a direction must be long at most, for it to be beyond doubt that there is
none."""
AGAIN = 3
"""How often a doubtful growth vector is sought again."""
MORE = 2
"""Brackets of a length that are tried besides those that may be independent."""
WORK = 4e8
"""Products of series, in numbers, that the longest brackets may take."""
PIECE = 3e7
"""Products of series between two looks at the clock."""
VANISHED = 1e-13
ROUNDED = 1e-14
"""Rows of a size below this part of the largest are rounding, as those are that say twice that a
motion is flat; others have rounding of the other size."""


@dataclass(frozen=True, eq=False)
class Distribution:
    """The null space of constraint rows at q, as smooth vector fields around q."""

    rows: VelocityRows
    q: Array
    t: float
    chosen: np.ndarray
    """Rows that are independent at q."""
    pivots: np.ndarray
    """For each column the row of `inverse`, -1 where it is free."""
    inverse: Array = field(repr=False)
    basis: Array = field(repr=False)
    """Velocities (columns, m) in units, orthonormal, that span the null space."""
    gap: float
    """The last singular value of the rows that counts over the first that does not."""
    condition: float
    """The first singular value over the last that counts."""
    error: float = 1e-15
    """How far q is from where it should be, in units."""
    doubtful: bool = False
    """Whether a row that the user wrote is left out as rounding, because it is so much smaller than
    others."""

    @property
    def dimension(self) -> int:
        """Dimension of the null space; one more with the time among the columns."""
        return self.basis.shape[1]


def compute_distribution(
    rows: VelocityRows,
    q: Array,
    which: Sequence[int] | None = None,
    t: float = 0.0,
    error: float = 1e-15,
) -> Distribution:
    """Compute the null space of some `rows`, or of all, at q (nq,) and the time t.

    q is right up to an `error`.
    """
    requested = np.arange(len(rows.names)) if which is None else np.array(which, dtype=np.int64)
    A, b = rows.evaluate_rows(q, t)
    whole = (
        A[requested] if rows.steady else np.concatenate([A[requested], -b[requested, None]], axis=1)
    )
    return _compute_null_space(rows, q, t, requested, whole * rows.units[: whole.shape[1]], error)


def _compute_null_space(
    rows: VelocityRows, q: Array, t: float, which: np.ndarray, scaled: Array, error: float
) -> Distribution:
    """Compute the null space of scaled rows, with independent rows and pivot columns."""
    n = scaled.shape[1]
    sizes = np.linalg.norm(scaled, axis=1)
    real = np.flatnonzero(sizes > VANISHED * sizes.max(initial=0.0))
    gone = np.setdiff1d(np.flatnonzero(sizes), real)
    written = np.array([rows.names[int(i)].written for i in which.tolist()], dtype=bool)
    doubtful = bool(written[gone].any())
    scaled = scaled[real] / sizes[real, None]
    spectrum = Spectrum(scaled)
    Vt = spectrum.right
    computed = sizes[real[~written[real]]]  # scaled up, with their rounding
    small = float((computed / sizes.max(initial=1e-300)).min(initial=1.0))
    level = max(Level.CLOSED, ROUNDED / small)
    rank = spectrum.compute_rank(level)
    independent = np.sort(_choose_pivots(scaled.T, rank))
    chosen = which[real[independent]]
    columns = np.sort(_choose_pivots(Vt[:rank], rank))
    units = rows.units[:n]
    square: Array = (
        scaled[independent][:, columns] * sizes[real[independent], None] / units[columns]
    )
    pivots = np.full(n, -1, dtype=np.int64)
    pivots[columns] = np.arange(rank)
    inverse = (
        np.ascontiguousarray(np.linalg.inv(square), dtype=np.float64) if rank else np.zeros((0, 0))
    )
    condition = float(spectrum.values[0] / spectrum.values[rank - 1]) if rank else 1.0
    gap = spectrum.compute_rank_gap(level)
    return Distribution(
        rows, q, t, chosen, pivots, inverse, Vt[rank:].T, gap, condition, error, doubtful
    )


def _choose_pivots(matrix: Array, count: int) -> np.ndarray:
    """Choose the columns that a QR decomposition with pivoting takes first."""
    import scipy.linalg  # only here: it takes long

    if not count:
        return np.zeros(0, dtype=np.int64)
    library: Any = scipy.linalg
    _, order = library.qr(matrix, mode="r", pivoting=True, check_finite=False)
    return order[:count].astype(np.int64)


class Words:
    """Random Lie brackets of the fields of a distribution at its point."""

    def __init__(self, at: Distribution, rng: np.random.Generator):
        rows = at.rows
        n = len(at.pivots)
        self.at = at
        self.rng = rng
        place = {int(row): i for i, row in enumerate(at.chosen)}
        outputs = [
            k
            for k, (row, column) in enumerate(rows.entries.tolist())
            if row in place and column < n
        ]
        entries = [
            (place[int(rows.entries[k, 0])], rows.entries[k, 1], rows.tape.outputs[k])
            for k in outputs
        ]
        self.entries = np.array(entries, dtype=np.int64).reshape(-1, 3)
        self.order = rows.find_needed_nodes(outputs)
        state = np.append(at.q, at.t)
        self.inputs = state[rows.inputs]
        slots = rows.slots if not rows.steady else rows.slots[:-1]
        self.slots = np.ascontiguousarray(slots)
        self.state = np.ascontiguousarray(state[: len(slots)])
        self.units = np.ascontiguousarray(rows.units[:n])

    def __call__(self, count: int, length: int) -> tuple[Array, Array]:
        """Evaluate brackets (count, length, columns) of random fields, and their rounding.

        They have `length`, ..., 1 letters; the rounding is (count, length).
        """
        letters = self.rng.normal(size=(count, length, self.at.dimension))
        letters /= np.linalg.norm(letters, axis=-1, keepdims=True)
        return self.evaluate_brackets(letters @ self.at.basis.T)

    def evaluate_brackets(self, letters: Array) -> tuple[Array, Array]:
        """Evaluate brackets (n, length, columns) of given letters, and their rounding.

        Entries of letters that are not free at the point do not count.
        """
        at = self.at
        letters = np.ascontiguousarray(letters)
        count, length, columns = letters.shape
        found = np.empty((count, length, columns))
        noise = np.empty((count, length))
        piece = max(1, int(PIECE / ((len(self.order) + 1) * 3.0**length)))
        for i in range(0, count, piece):
            check_for_stop()
            lie_brackets.evaluate_words(
                *at.rows.packed_tape,
                self.order,
                self.entries,
                at.pivots,
                at.inverse,
                self.slots,
                at.rows.balls,
                self.state,
                self.inputs,
                self.units,
                letters[i : i + piece],
                found[i : i + piece],
                noise[i : i + piece],
            )
        return found, noise


@dataclass(frozen=True)
class Growth:
    """A growth vector: `dimensions` of the spans of brackets of up to 1, 2, ... letters.

    It ends where `reached` directions are spanned, or where nothing was found up to a `limit` of
    letters.
    """

    dimensions: tuple[int, ...]
    limit: int
    doubtful: bool
    basis: Array = field(repr=False, compare=False)
    """Orthonormal directions (columns, k) in units: the first dimensions[s - 1] span D^s."""


class _GrowingSpan:
    """Orthonormal directions that brackets span so far, with estimates of their rounding.

    Words that are known to be in the span show how large its rounding truly is: `shares` are the
    largest parts of the estimates that the latest of them had.
    """

    def __init__(self, basis: Array, rounding: float, least: float):
        self.basis = basis
        self.rounding = np.full(basis.shape[1], rounding)
        self.least = least
        self.shares = [1.0, 1.0]
        self.doubtful = False

    def add_words(self, words: Array, noise: Array, known: bool) -> int:
        """Add the components of brackets (columns, k) outside the span; return the growth.

        `known` says that they should be in it.
        """
        sizes = np.linalg.norm(words, axis=0)
        real = sizes > ROUNDING * np.maximum(noise, self.least)
        # too short to count, and longer than its own rounding
        if not known and self.least <= EXACT:
            self.doubtful |= bool(np.any(~real & (sizes > SEEN * noise) & (sizes > 0.0)))
        words = words[:, real] / sizes[real]
        noise = noise[real] / sizes[real]
        if not words.size:
            return 0
        inside = self.basis.T @ words
        rest = words - self.basis @ inside
        rest -= self.basis @ (self.basis.T @ rest)
        U, values, _ = Spectrum(rest).thin_decomposition
        bound = float(np.max(noise + self.rounding @ np.abs(inside))) * np.sqrt(words.shape[1])
        error = max(self.least, max(self.shares[-2:]) * bound)
        rank = int(np.sum(values > ROUNDING * error))
        if known and not rank:
            self.shares.append(max(values[0] / bound, SHARE))
        if not known:
            near = bool(rank) and values[rank - 1] < DOUBT * error
            missed = rank < len(values) and values[rank] > SEEN * error
            self.doubtful |= near or missed or ROUNDING * error > BLIND
        self.basis = np.concatenate([self.basis, U[:, :rank]], axis=1)
        self.rounding = np.append(self.rounding, error / values[:rank])
        return rank


def compute_growth(
    at: Distribution, rng: np.random.Generator, enough: int, patient: bool
) -> Growth:
    """Compute the growth vector of a distribution at its point, up to `enough` directions.

    Where it is doubtful it is computed again.

    Where nothing is added by one more letter, all brackets of any length are in the span if the
    point is generic, for the span is then involutive around it. If `patient`, longer ones are tried
    all the same, up to a limit of work: at singular points the growth may rest and go on.
    """
    found = _grow_span(at, rng, enough, patient)
    for _ in range(AGAIN):
        if not found.doubtful:
            break
        found = _grow_span(at, rng, enough, patient)
    return found


def _grow_span(at: Distribution, rng: np.random.Generator, enough: int, patient: bool) -> Growth:
    """Compute a growth vector once, with random brackets."""
    words = Words(at, rng)
    m = at.dimension
    span = _GrowingSpan(at.basis, at.error * at.condition, at.error)
    found = [m]
    length = 1
    limit = _limit_bracket_length(words)
    while found[-1] < enough and m > 1 and length < limit:
        length += 1
        made, noise = words(min(enough - found[-1], _bound_bracket_count(m, length)) + MORE, length)
        grown = sum(
            span.add_words(made[:, k].T, noise[:, k], k > 0) for k in range(length - 1, -1, -1)
        )
        found.append(found[-1] + grown)
        if not grown and not patient:
            break
    if m <= 1 and m < enough:  # one field and itself have no bracket
        found.append(m)
    return Growth(tuple(found), limit, bool(span.doubtful) or at.doubtful, span.basis)


def _bound_bracket_count(m: int, length: int) -> int:
    """Bound the number of independent brackets of `length` letters out of m (Witt, 1937)."""
    return max(1, m**length // length)


def _limit_bracket_length(words: Words) -> int:
    """Return the largest number of letters of a bracket that is worth its work."""
    each = len(words.order) + 2 * len(words.entries) + 1
    return max(4, int(np.log(WORK / each) / np.log(3.0)))
