"""Base of all results: their sentence, text, HTML and JSON.

An answer is true where its question was answered.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from textwrap import fill, shorten
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from kempe.arguments import explain_method_errors
from kempe.arrays import is_array, is_whole, unwrap_scalar
from kempe.errors import InputError, KempeError, MissingPackageError, format_value
from kempe.status import Status, name_outcomes
from kempe.units import METRE, name_lengths
from kempe.words import (
    Quantities,
    Quantity,
    Unit,
    align_columns,
    convert_sentence_angles,
    format_fixed,
    format_html_image,
    format_html_paragraphs,
    format_html_table,
    format_html_topics,
    format_json,
    format_topics,
    to_json_data,
)

MOST_JUDGED = 1_000_000
"""Coordinates up to which configurations are judged for their `data`."""
ROWS = 30
"""Rows of a table that a text shows: with a headline and reasons they fill a screen."""
WIDE = 8
"""Numbers in a row up to which a text shows it as a line; longer rows are columns, as many beside
each other at most."""


class Table(NamedTuple):
    """Rows of texts and numbers under the heads of columns; numbers are a `Quantity` each.

    As a `record` each row is a name, what it is, and what limits it; else rows are alike, and a
    `grid` of them is always in columns. `more` is how many rows there are beyond these. What is not
    `printed` by `print` is in the `text` and in HTML.
    """

    heads: Sequence[str]
    rows: Sequence[Sequence[Any]]
    record: bool = False
    grid: bool = False
    more: int = 0
    title: str = ""
    printed: bool = True

    def list_lines(self) -> list[str]:
        """List the lines of the table: "name = value" for a record, else each value after its head."""
        if self.grid:
            return self.align_columns()
        texts = [[_format_digits(x) for x in row] for row in self.rows]
        if self.record:
            out = [f"{row[0]} = {row[1]}" for row in texts]
        else:
            label = not self.heads[0]  # what has no head begins the line
            out = [
                f"{row[0]:>3s}  " * label
                + ", ".join(
                    f"{h} = {x}" for h, x in zip(self.heads[label:], row[label:], strict=True) if x
                )
                for row in texts
            ]
        return self._add_title(out)

    def to_html(self) -> str:
        """Convert the table to HTML."""
        heads, columns, _ = self._format_columns(False, not self.grid)
        title, more = self._list_outer_lines()
        table = format_html_table(heads, zip(*columns, strict=True))
        return format_html_paragraphs(title) + table + format_html_paragraphs(more)

    def align_columns(self, degrees: bool = False) -> list[str]:
        """List the lines of the table with columns of equal width, in radians or degrees."""
        heads, columns, right = self._format_columns(degrees)
        if sum(right) > WIDE and not self.record:
            return self._add_title(_arrange_blocks(heads, columns))
        return self._add_title(align_columns(heads, columns, right))

    def _format_columns(
        self, degrees: bool, digits: bool = False
    ) -> tuple[list[str], list[list[str]], list[bool]]:
        """Format the cells: heads of columns, texts by column, and which columns are numbers.

        Empty columns are left out; numbers have nine `digits`, or fixed decimals.
        """
        heads = list(self.heads or ("", ""))
        cells = [list(column) for column in zip(*self.rows, strict=True)] or [[] for _ in heads]
        units = [self._find_unit(column) for column in cells]
        texts = [
            [
                _format_digits(x) if digits else _format_decimals(x, degrees, self.record)
                for x in column
            ]
            for column in cells
        ]
        right = [any(_is_number(x) or isinstance(x, int) for x in column) for column in cells]
        if None in units:
            # numbers in several units: each row has one
            last = len(right) - right[::-1].index(True)
            texts.insert(last, [_find_row_unit(row, degrees) for row in self.rows])
            heads.insert(last, "unit")
            right.insert(last, False)
        else:
            heads = [
                h + _format_unit(_convert_unit(u, degrees))
                for h, u in zip(heads, units, strict=True)
            ]
        keep = [k for k, column in enumerate(texts) if any(column)] or range(len(texts))
        shown = [heads[k] for k in keep]
        return shown if any(shown) else [], [texts[k] for k in keep], [right[k] for k in keep]

    def _find_unit(self, column: Sequence[Any]) -> str | None:
        """Find the common unit of the numbers in a column; None if each row has its own unit."""
        units = {x.unit for x in column if _is_number(x)}
        return None if len(units) > 1 or (units and self.record) else "".join(units)

    def _add_title(self, lines: list[str]) -> list[str]:
        """Put the title above lines, and the number of further rows below."""
        title, more = self._list_outer_lines()
        return [*title, *lines, *more]

    def _list_outer_lines(self) -> tuple[list[str], list[str]]:
        """Return the line above the table, and the line below about further rows; empty if none."""
        return [self.title] * bool(self.title), [f"... and {self.more} more"] * bool(self.more)


def _is_number(x: Any) -> bool:
    """Whether a cell is a single number with a unit."""
    return isinstance(x, Quantity) and np.ndim(x.value) == 0


def _find_row_unit(row: Sequence[Any], degrees: bool) -> str:
    """Find the unit of the numbers in a row."""
    return next((_convert_unit(x.unit, degrees) for x in row if _is_number(x)), "")


def _format_unit(unit: str) -> str:
    """Format a unit in brackets; '' without a unit."""
    return f" [{unit}]" if unit else ""


def _convert_unit(unit: str | None, degrees: bool) -> str:
    """Convert the unit of angles to degrees if these are requested."""
    return Unit(unit or "").convert_units(degrees)


def _format_digits(x: Any) -> str:
    """Format a cell with nine digits of its number."""
    if _is_number(x):
        return f"{x.value:.9g}"
    return _format_decimals(x, False)


def _format_decimals(x: Any, degrees: bool, bare: bool = False) -> str:
    """Format a cell with a fixed number of decimals; an interval as '[-2, 2] rad'.

    An interval that is `bare` has no unit; '' for an interval without ends.
    """
    if isinstance(x, Quantities):
        return ", ".join(f"{label} {_format_decimals(y, degrees)}".lstrip() for label, y in x.each)
    if not isinstance(x, Quantity):
        return str(x)
    x = x.convert_units(degrees)
    if np.ndim(x.value):
        low, high = x.value
        unit = "" if bare else x.unit
        return f"[{low:.5g}, {high:.5g}] {unit}".rstrip() if np.isfinite(x.value).any() else ""
    return format_fixed(float(x.value), 4 if x.unit == "deg" else 6)


def _arrange_blocks(heads: Sequence[str], columns: Sequence[Sequence[str]]) -> list[str]:
    """Arrange rows as columns, in blocks of at most `WIDE` beside each other."""
    out: list[str] = []
    count = len(columns[0])
    blocks = math.ceil(count / WIDE)
    for k in range(blocks):
        part = slice(k * count // blocks, (k + 1) * count // blocks)
        shown = [list(heads), *zip(*(column[part] for column in columns), strict=True)]
        out += [""] * bool(out) + align_columns((), shown, [False] + [True] * (len(shown) - 1))
    return out


class Nearest(Protocol):
    """The nearest mechanism that closes exactly, as `kempe.assemble.nearest_exact` finds it."""

    @property
    def system(self) -> Any:
        """The nearest mechanism as a system, with the same coordinates."""
        ...

    @property
    def tolerance(self) -> float:
        """Largest change of a joint's placement [m, rad]."""
        ...

    @property
    def freedoms(self) -> int:
        """Number of freedoms of the nearest mechanism."""
        ...

    @property
    def sentence(self) -> Any:
        """Sentence about the distance to the nearest mechanism, and about its mobility."""
        ...

    @property
    def least(self) -> str:
        """Description of the distance of the given numbers to the nearest mechanism."""
        ...

    @property
    def exactly(self) -> str:
        """Description of the mobility of the given mechanism if its numbers are taken exactly."""
        ...

    @property
    def lines(self) -> list[str]:
        """Lines about the changed numbers, the largest change first, and about contradictions."""
        ...

    def data(self) -> dict[str, Any]:
        """Return all numbers and texts as plain Python objects."""
        ...


@explain_method_errors
class Result:
    """Base of all results: `Answer`, which has configurations, and `Report`, which has findings.

    A result is true if all of `success` is true. Printing a result shows its findings.

    Attributes
    ----------
    success
        Mask (...) of what was found; a bool for a single call.
    code
        `Status`, or an array of status numbers for a batch.
    status
        Sentences that state the outcome and its reason.
    """

    success: Any
    code: Any
    status: Any
    within: Nearest | None = None
    """The nearest mechanism that closes exactly, which was solved in place of the given one; None:
    it was itself."""
    _entries: ClassVar[tuple[str, ...]] = ()
    """Names of members that are entries of the `data`; `system` stands for its name."""
    _has_angles: ClassVar[bool] = False
    """Whether the data have angles, which are degrees where that is requested."""
    _pictured = False
    """Whether a notebook shows its `plot`, too: where the picture says more than the numbers."""

    def data(self, degrees: bool = False) -> dict[str, Any]:
        """Return all numbers and texts as plain Python objects, ready for JSON.

        `code` has the names of `Status`, NaN becomes None.

        With `degrees` the angles of configurations are degrees; errors and tolerances stay radians.
        """
        said = {
            "success": np.asarray(self.success).tolist(),
            "code": name_outcomes(self.code),
            "status": self.status,
        }
        own = self._collect_data()
        head = {
            name: own.pop(name) for name in ("system", "frame") if name in own
        } | self._collect_head_data()
        unit = {"angle_unit": "deg" if degrees else "rad"} if self._has_angles else {}
        return to_json_data(head | unit | said | own, degrees)

    def to_json(self, degrees: bool = False) -> str:
        """Return the `data` as JSON text."""
        return format_json(self.data(degrees))

    def to_dataframe(self, degrees: bool = False) -> Any:
        """Return the rows of the result as a `DataFrame` of pandas.

        Errors: `MissingPackageError` without pandas.
        """
        try:
            from pandas import DataFrame
        except ImportError:
            raise MissingPackageError("pandas") from None
        names, rows = self._list_dataframe_rows(degrees)
        return DataFrame(rows, columns=names)  # type: ignore[arg-type]

    def _list_dataframe_rows(self, degrees: bool) -> tuple[Sequence[str], Any]:
        """Return the names of columns, and the rows, of the first table."""
        for table in self._make_tables():
            heads = table.heads or ("name", "value")
            rows = [[_convert_cell(x, degrees) for x in row] for row in table.rows]
            return heads, rows
        return ("status",), np.reshape(np.asarray(self.status, dtype=object), (-1, 1)).tolist()

    def _collect_head_data(self) -> dict[str, Any]:
        """Return the first entries of the `data`, which say what the result is about."""
        return {}

    def _collect_data(self) -> dict[str, Any]:
        """Return the entries of the `data` that are particular to this class: those of `_entries`."""
        own: dict[str, Any] = {name: getattr(self, name) for name in self._entries}
        return own | {"system": own["system"].name} if "system" in own else own

    # ---- as text and HTML

    def _make_headline(self) -> str:
        """Return the first line of the text."""
        return str(self.status)

    def _make_tables(self) -> Sequence[Table]:
        """Make the tables of the text and of HTML."""
        return ()

    def _list_notes(self, degrees: bool = False) -> Sequence[str]:
        """List the last lines of the text: reasons, and facts that no table has."""
        return ()

    @property
    def _unit(self) -> str:
        """Unit of the lengths in the text."""
        return getattr(getattr(self, "system", None), "unit", METRE)

    def __bool__(self) -> bool:
        return bool(np.all(self.success))

    def __str__(self) -> str:
        return name_lengths(self._compose_text(), self._unit)

    def _compose_text(self) -> str:
        """Compose the printed text."""
        lines = [
            line for table in self._make_tables() if table.printed for line in table.list_lines()
        ]
        return "\n".join(
            [self._make_headline(), *(f"  {x}" for x in (*lines, *self._list_notes()))]
        )

    def __repr__(self) -> str:
        """Text as printed, at most one screen of it: what an interactive session shows."""
        return _cut_to_screen(str(self))

    def text(self, degrees: bool = False, width: int = 0) -> str:
        """Return the text with tables in columns; with `degrees`, angles are in degrees.

        With a `width`, longer sentences are broken. Errors: `InputError` for a width that is no
        whole number.
        """
        width = _check_line_width(width)
        head, *notes = (
            _wrap_line(convert_sentence_angles(x, degrees), width)
            for x in (self._make_headline(), *self._list_notes(degrees))
        )
        parts = [head]
        parts += ["\n".join(["", *table.align_columns(degrees)]) for table in self._make_tables()]
        if notes and len(parts) > 1:
            parts += ["", *notes]
        else:
            parts += [f"  {x}" for x in notes]
        return name_lengths("\n".join(parts), self._unit)

    def _repr_html_(self) -> str:
        return name_lengths(self._compose_html(), self._unit) + self._render_image()

    def _compose_html(self) -> str:
        """Compose the text as HTML."""
        tables = "".join(table.to_html() for table in self._make_tables())
        head = format_html_paragraphs([self._make_headline()])
        return head + tables + format_html_paragraphs(self._list_notes())

    def _render_image(self) -> str:
        """Render the picture of `plot` as HTML if `_pictured`; '' if nothing can be drawn."""
        if not self._pictured:
            return ""
        self_: Any = self
        try:
            axes = self_.plot()
        except (KempeError, ValueError, ArithmeticError):
            return ""
        return format_html_image(
            np.ravel(axes)[0].figure, name_lengths(self._make_headline(), self._unit)
        )


by_code: Any = property(
    lambda self: unwrap_scalar(np.asarray(self.code) == Status.SOLVED),
    doc="Whether (...) it is answered.",
)
"""The `success` of results that have only a `code`."""


@explain_method_errors
class Report(Result):
    """Result with findings about a system and their reasons. Its `status` is one sentence."""

    code: Any = Status.SOLVED
    success = by_code

    def __init_subclass__(cls, **options: Any) -> None:
        """Let the sentence of each report name lengths by the unit of its system."""
        super().__init_subclass__(**options)
        own = cls.__dict__.get("status")
        compose = own.fget if isinstance(own, property) else getattr(own, "func", None)
        if compose is not None:
            made: Any = property(
                lambda self: name_lengths(compose(self), self._unit), doc=own.__doc__
            )
            setattr(cls, "status", made)  # noqa: B010

    @property
    def status(self) -> Any:
        """Result in one sentence; an array of sentences for a batch."""
        raise NotImplementedError

    @property
    def sentence(self) -> Any:
        """Result in one sentence: another name of `status`."""
        return self.status

    def topics(self) -> Sequence[tuple[str, Sequence[str]]]:
        """List the reasons as pairs of a title and its lines."""
        return ()

    def _compose_text(self) -> str:
        topics = self.topics()
        return format_topics(self._make_headline(), topics) if topics else super()._compose_text()

    def text(self, degrees: bool = False, width: int = 0) -> str:
        """Return the text with tables in columns; with `degrees`, angles are in degrees.

        With a `width`, longer sentences are broken. Errors: `InputError` for a width that is no
        whole number.
        """
        topics = self.topics()
        if not topics:
            return super().text(degrees, width)
        width = _check_line_width(width)
        text = format_topics(_wrap_line(self._make_headline(), width), topics, width=width)
        return name_lengths(convert_sentence_angles(text, degrees), self._unit)

    def _repr_html_(self) -> str:
        return (
            name_lengths(self._compose_html(), self._unit)
            if self.topics()
            else super()._repr_html_()
        )

    def _compose_html(self) -> str:
        topics = self.topics()
        return (
            format_html_paragraphs([self._make_headline()]) + format_html_topics(topics)
            if topics
            else super()._compose_html()
        )


NARROWEST = 40
"""Columns of a line at least, where lines are broken: indents need some."""


def _check_line_width(width: Any) -> int:
    """Check the number of columns of a line, 0 for any. Errors: `InputError`."""
    if not is_whole(width) or width < 0:
        raise InputError(
            f"width is {format_value(width)}; it must be a whole number of columns, 0 for any"
        )
    return max(int(width), NARROWEST) if width else 0


def _wrap_line(line: str, width: int) -> str:
    """Wrap a line that is longer than the width."""
    return fill(line, width, subsequent_indent="  ") if width and len(line) > width else line


def _convert_cell(x: Any, degrees: bool) -> Any:
    """Convert a cell to a value of a `DataFrame`."""
    return x.convert_units(degrees).value if isinstance(x, Quantity) else x


SCREEN = 25
"""Rows of a screen that an answer fills at most in an interactive session."""
COLUMNS = 100
"""Characters in a row of such a screen; longer lines take several rows."""


def _cut_to_screen(text: str) -> str:
    """Cut a text to the first rows of a screen, with a line about what is left out."""
    lines = text.splitlines()
    rows = np.cumsum([max(1, math.ceil(len(line) / COLUMNS)) for line in lines])
    if not lines or rows[-1] <= SCREEN:
        return text
    kept = max(1, int(np.searchsorted(rows, SCREEN - 1, side="right")))
    lines[0] = shorten(lines[0], SCREEN * COLUMNS // 2, placeholder=" ...")
    return "\n".join([*lines[:kept], "... print(answer) shows all of it"])


# ---- parts of answers on one line

FEW = 16
"""Entries of an array, or of a tuple, that are shown."""


def summarize_fields(self: Any) -> str:
    """Summarize the fields of a part of an answer on one line; large arrays by their shape."""
    shows = [f for f in fields(self) if f.repr]
    return f"{type(self).__name__}({', '.join(f'{f.name}={_summarize_value(getattr(self, f.name))}' for f in shows)})"


def _summarize_value(x: Any) -> str:
    """Summarize a value on one line; large arrays by their shape."""
    given: Any = x
    if is_array(x):
        return f"array {x.shape}" if x.size > FEW else " ".join(repr(x).split())
    if isinstance(x, Result):
        return f"{type(x).__name__}(...)"
    if isinstance(x, dict):
        return f"{{{', '.join(f'{k!r}: {_summarize_value(v)}' for k, v in given.items())}}}"
    if isinstance(x, tuple) and len(given) > FEW:
        return f"({', '.join(map(_summarize_value, given[:2]))}, ... {len(given)} in all)"
    return repr(given)
