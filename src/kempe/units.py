"""Units of length in which a mechanism can be given: the table, and the words for what they measure.

A unit is a label. Numbers go in and come out in it, and nothing converts them, except where a
mechanism meets another one, a file format or a library that has a unit of its own.
"""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Any

import numpy as np

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


_IN_TEXT = re.compile(
    r"(?<=[\d)]\ )m(?=$|[,.;:)\]/^²³<]|\s(?!=))"  # 0.5 m, (1, 2) m, 2 m/s, 3 m^2
    r"|(?<=[\[(])m(?=[\])]|, rad)"  # [m], (m, rad); an array (m, n) has no unit
    r"|(?<=\w\ )m(?=\ (?:apart|away|a\ rad)\b)"  # l1 m apart
    r"|\bmetres\b"
)
"""Where a text names the unit of a length."""


def name_lengths(text: Any, unit: str) -> Any:
    """Return a text, or a sequence of texts, with lengths called by the unit of a mechanism.

    Sentences are made with "m", as rows of equations are; numbers are in the mechanism's unit.
    """
    if unit == METRE:
        return text
    if isinstance(text, str):
        return _IN_TEXT.sub(lambda found: NAMES[unit] if len(found[0]) > 1 else unit, text)
    if is_array(text):
        return np.array([name_lengths(x, unit) for x in text.ravel()], dtype=object).reshape(
            text.shape
        )
    return [name_lengths(x, unit) for x in text]


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
