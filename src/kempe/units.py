"""Units of length in which a mechanism can be given: the table, and the words for what they measure.

A unit is a label. Numbers go in and come out in it, and nothing converts them, except where a
mechanism meets another one, a file format or a library that has a unit of its own.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from kempe.arrays import is_array, is_sequence
from kempe.errors import InputError, format_value

METRE = "m"
"""Unit of mechanisms that declare none."""
METRES = {
    METRE: Fraction(1),
    "cm": Fraction(1, 100),
    "mm": Fraction(1, 1000),
    "in": Fraction(254, 10000),
}
"""Metres in one unit of each name; fractions, so that 40 mm become the same number as 0.04 m."""
NAMES = {METRE: "metres", "cm": "centimetres", "mm": "millimetres", "in": "inches"}
"""The units as words of a sentence."""


def check_unit(unit: object) -> str:
    """Return the name of a unit of length. Errors: `InputError`."""
    if isinstance(unit, str) and unit in METRES:
        return unit
    *names, last = (f"{name!r} ({NAMES[name]})" for name in METRES)
    raise InputError(
        f"unit is {format_value(unit)}; it must be a unit of length: {', '.join(names)} or {last}"
    )


def from_metres(length: float, unit: str) -> float:
    """Return a length in metres, such as a default tolerance, as a number of another unit."""
    return scale_lengths(length, 1 / METRES[unit])


def make_tolerance(tolerance: float, unit: str) -> tuple[float, float]:
    """Return a default tolerance in metres and radians as a pair, of `unit` and radians."""
    return from_metres(tolerance, unit), tolerance


def scale_lengths(x: Any, factor: Fraction) -> Any:
    """Multiply lengths by a fraction: a number, an array, an expression, or sequences of them.

    What is zero or None stays the same object.
    """
    if is_sequence(x):
        items = tuple(scale_lengths(item, factor) for item in x)
        return x if all(a is b for a, b in zip(items, x, strict=True)) else items
    if x is None or (not is_array(x) and x == 0.0):
        return x
    # a product or a quotient alone rounds once: 40 mm are the same number as 0.04 m
    x = x if factor.numerator == 1 else x * float(factor.numerator)
    return x if factor.denominator == 1 else x / float(factor.denominator)


def name_unit(of_row: str, unit: str) -> str:
    """Return a unit of a row with the mechanism's unit of length: "m/s" becomes "mm/s".

    Angles, and numbers without a unit, stay as they are.
    """
    return of_row.replace(METRE, unit, 1) if of_row[:1] == METRE else of_row
