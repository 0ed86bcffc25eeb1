"""Arguments that several solvers take, checked."""

from __future__ import annotations

import numpy as np

from kempe.errors import InputError


def start_count(starts: object) -> int:
    """The number of starts. Errors: `InputError`."""
    if isinstance(starts, bool) or not isinstance(starts, (int, np.integer)) or not 1 <= starts < 2**62:
        raise InputError(f"starts is {starts!r}; it must be a whole number, at least 1")
    return int(starts)


def seed_number(rng: object) -> int:
    """A whole number to draw from, of a generator or a number. Errors: `InputError`."""
    if isinstance(rng, np.random.Generator):
        return int(rng.integers(2**62))
    if isinstance(rng, bool) or not isinstance(rng, (int, np.integer)) or not 0 <= rng < 2**62:
        raise InputError(f"rng is {rng!r}; it must be a generator or a whole number, not negative")
    return int(rng)
