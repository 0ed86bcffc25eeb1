"""Wording shared by all answers, and formatting as text, HTML and JSON."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Sequence
from textwrap import fill
from typing import Any, NamedTuple, cast

import numpy as np

# ---- wording

SMALL = ("no", "one", "two", "three", "four", "five", "six")
"""Numbers that are written out."""


PLURALS = {
    "body": "bodies",
    "axis": "axes",
    "branch": "branches",
    "mesh": "meshes",
    "entry": "entries",
    "velocity": "velocities",
    "assembly": "assemblies",
}
"""Nouns whose plural has more than an s."""


def make_plural(n: float, what: str) -> str:
    """Return the noun in singular or plural for a count: 'start', 'planar joints', 'bodies'."""
    if n == 1:
        return what
    before, _, noun = what.rpartition(" ")
    return f"{before} {PLURALS.get(noun, f'{noun}s')}".lstrip()


def format_count(n: int, what: str) -> str:
    """Format a count with its noun: '3 starts', '1 start', '2 bodies'."""
    return f"{n} {make_plural(n, what)}"


def choose_verb(n: int, one: str, more: str) -> str:
    """Choose the singular or plural form of a verb: ``choose_verb(n, "is", "are")``."""
    return one if n == 1 else more


def format_share(good: int, n: int, what: str) -> str:
    """Format a share: '2 of 3 targets reached', '1 of 1 target reached'. `what` begins with a
    plural noun.
    """
    first, _, rest = what.partition(" ")
    return f"{good} of {n} {first.removesuffix('s') if n == 1 else first} {rest}".rstrip()


def spell_count(n: int, what: str) -> str:
    """Format a count with its noun, small numbers spelled out: 'two joints'."""
    return f"{SMALL[n] if n < len(SMALL) else n} {make_plural(n, what)}"


def cut_lines(lines: list[str], most: int) -> list[str]:
    """Return the first `most` lines and one that counts the rest."""
    return lines if len(lines) <= most else [*lines[:most], f"... and {len(lines) - most} more"]


def join_first_words(words: Sequence[str], most: int) -> str:
    """Join the first `most` words with commas, and dots for the others: 'a, b, ...'."""
    return ", ".join([*words[:most], *(["..."] if words[most:] else [])])


def join_words(words: Sequence[str]) -> str:
    """Join words as a list in a sentence: 'a, b and c'; 'nothing' for an empty list."""
    if not words:
        return "nothing"
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


# ---- text, HTML, JSON


def format_topics(
    headline: str, topics: Iterable[tuple[str, Sequence[str]]], wide: int = 16, width: int = 0
) -> str:
    """Format a report as text: the headline, then the lines of each (title, lines). Empty lines are
    left out.

    Titles take `wide` columns; with a `width`, longer lines are broken.
    """
    out = [headline]
    for title, lines in topics:
        for k, line in enumerate(x for x in lines if x):
            head = f"  {title if k == 0 else '':<{wide}}"
            wrapped = (
                fill(line, width, initial_indent=head, subsequent_indent=" " * (len(head) + 2))
                if width
                else ""
            )
            out.append(wrapped or head + line)
    return "\n".join(out)


def format_fixed(x: float, decimals: int = 6) -> str:
    """Format a number with fixed decimals, without negative zero."""
    text = f"{x:.{decimals}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def align_columns(
    heads: Sequence[str], columns: Sequence[Sequence[str]], right: Sequence[bool] = ()
) -> list[str]:
    """Format columns of equal width under their heads; columns marked in `right` are right-aligned."""
    full = [
        [head, *column] for head, column in zip(heads or [""] * len(columns), columns, strict=True)
    ]
    width = [max(map(len, column)) for column in full]
    lines = [
        "  ".join(
            x.rjust(w) if r else x.ljust(w) for x, w, r in zip(row, width, right, strict=False)
        )
        for row in zip(*full, strict=True)
    ]
    return [line.rstrip() for line in lines[0 if heads else 1 :]]


def _escape_html(text: str) -> str:
    """Escape text for HTML."""
    # sentences are made at start-up, and need no HTML; so with JSON and images below
    from html import escape

    return escape(text)


def format_html_paragraphs(lines: Iterable[str]) -> str:
    """Format lines as paragraphs of HTML."""
    return "".join(f"<p>{_escape_html(line)}</p>" for line in lines)


class InWords:
    """Base of parts of results; notebooks show their text."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return format_html_paragraphs(str(self).splitlines())


def format_html_image(figure: Any, said: str) -> str:
    """Format a Matplotlib figure as an image of HTML with alternative text."""
    from base64 import b64encode

    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=72, bbox_inches="tight")
    return (
        f'<p><img alt="{_escape_html(said)}" '
        f'src="data:image/png;base64,{b64encode(data.getvalue()).decode()}"/></p>'
    )


def format_html_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format rows as a table of HTML; '' without rows."""
    body = "".join(
        f"<tr>{''.join(f'<td>{_escape_html(x)}</td>' for x in row)}</tr>" for row in rows
    )
    top = f"<tr>{''.join(f'<th>{_escape_html(h)}</th>' for h in heads)}</tr>" if heads else ""
    return f"<table>{top}{body}</table>" if body else ""


def format_html_topics(topics: Iterable[tuple[str, Sequence[str]]]) -> str:
    """Format the (title, lines) of a report as a table of HTML, without empty lines."""
    rows = "".join(
        f"<tr><th style='text-align:left;vertical-align:top'>{_escape_html(title)}</th>"
        f"<td style='text-align:left'>{'<br>'.join(_escape_html(x) for x in lines if x)}</td></tr>"
        for title, lines in topics
    )
    return f"<table>{rows}</table>"


_NUMBERS = re.compile(r"\[\n\s+(?:[-+.\deE]+|null)(?:,\n\s+(?:[-+.\deE]+|null))*\n\s+\]")


def format_json(data: Any, ascii_only: bool = False) -> str:
    """Format data as indented JSON, with lists of numbers on one line."""
    import json

    text = json.dumps(data, indent=2, allow_nan=False, ensure_ascii=ascii_only)
    return _NUMBERS.sub(
        lambda m: "[" + ", ".join(m[0].strip("[]").replace(",", " ").split()) + "]", text
    )


DEGREE = math.pi / 180.0
_RADIANS = re.compile(r"(?<![\w.])(-?\d[\d.]*(?:e[+-]?\d+)?) rad\b(?!/)")


def convert_sentence_angles(text: str, degrees: bool) -> str:
    """Return a sentence with its angles in radians converted to degrees if `degrees` is true.

    An angle keeps its significant digits; from one degree on it has three at least.
    """

    def convert_angle(found: re.Match[str]) -> str:
        """Return one angle in degrees."""
        digits = len(found[1].partition("e")[0].lstrip("-0.").replace(".", ""))
        angle = float(found[1]) / DEGREE
        return f"{angle:.{max(digits, 3 if abs(angle) >= 1.0 else 1)}g} deg"

    return _RADIANS.sub(convert_angle, text) if degrees else text


class Quantity(NamedTuple):
    """A number, an interval (low, high), or an array, with its unit. Radians can be shown as
    degrees.
    """

    value: Any
    unit: str = ""

    def convert_units(self, degrees: bool) -> Quantity:
        """Return the quantity with radians converted to degrees if `degrees` is true."""
        if not degrees or self.unit != "rad":
            return self
        return Quantity(np.asarray(self.value, dtype=float) / DEGREE, "deg")


class Quantities(NamedTuple):
    """Labelled quantities in one cell of a table."""

    each: Sequence[tuple[str, Quantity]]


class Unit(str):
    """The unit of another entry of the data; 'rad' becomes 'deg' where degrees are shown."""

    def convert_units(self, degrees: bool) -> str:
        """Return the unit, 'deg' in place of 'rad' if `degrees` is true."""
        return "deg" if degrees and self == "rad" else str(self)


class ByName(NamedTuple):
    """Values (..., n) of coordinates, with their names and units."""

    names: Sequence[str]
    units: Sequence[str]
    values: Any

    def convert_units(self, degrees: bool) -> Any:
        """Return the values (..., n), angles converted to degrees if `degrees` is true."""
        angles = [degrees and unit == "rad" for unit in self.units]
        return np.asarray(self.values, dtype=float) / np.where(angles, DEGREE, 1.0)

    def to_dict(self, degrees: bool = False) -> Any:
        """Convert the values to a dict by name, several sets to nested lists of dicts. None if all
        are NaN.
        """
        return self._name_values(self.convert_units(degrees))

    def _name_values(self, values: Any) -> Any:
        if np.ndim(values) > 1:
            return [self._name_values(x) for x in values]
        named = dict(zip(self.names, values.tolist(), strict=True))
        return None if named and np.isnan(values).all() else named


def to_json_data(values: Any, degrees: bool = False) -> Any:
    """Convert values to data for JSON: lists, numbers and None for NaN and infinity. Quantities
    lose their unit.
    """
    if isinstance(values, dict):
        items = cast("dict[Any, Any]", values).items()
        return {key: to_json_data(value, degrees) for key, value in items}
    if isinstance(values, Quantity):
        return to_json_data(values.convert_units(degrees).value)
    if isinstance(values, Unit):
        return values.convert_units(degrees)
    if isinstance(values, ByName):
        return to_json_data(values.to_dict(degrees))
    if isinstance(values, np.generic):
        return to_json_data(values.item())
    if isinstance(values, np.ndarray):
        return to_json_data(values.tolist(), degrees)
    if isinstance(values, (list, tuple)):
        return [to_json_data(v, degrees) for v in cast("Sequence[Any]", values)]
    if isinstance(values, float):
        return values + 0.0 if math.isfinite(values) else None
    return values
