"""Results of verbs: the base of all answers, with the sentence, text, HTML and JSON.

An answer is true where its question was answered.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, NamedTuple, Protocol

import numpy as np

from kempe.arguments import explained_methods
from kempe.arrays import is_array, plain
from kempe.errors import KempeError
from kempe.status import Status, named
from kempe.words import (
    by_topic,
    image_html,
    json_text,
    jsonable,
    paragraphs,
    table_html,
    topics_html,
)

MOST_JUDGED = 1_000_000
"""Coordinates up to which configurations are judged for their `data`."""
Cells = tuple[Sequence[str], Sequence[Sequence[str]]]
"""Heads of columns (none: each row is a name and what it is) and rows of a table."""


class Nearest(Protocol):
    """The nearest mechanism that closes exactly, as `kempe.assemble.nearest_exact` finds it."""

    @property
    def system(self) -> Any:
        """That mechanism as a system, with the same coordinates."""
        ...

    @property
    def tolerance(self) -> float:
        """The largest change of a placement, in metres and radians."""
        ...

    @property
    def freedoms(self) -> int:
        """The number of its freedoms."""
        ...

    @property
    def sentence(self) -> Any:
        """How far the given numbers are from it, and what moves, in one sentence."""
        ...

    @property
    def least(self) -> str:
        """How far the given numbers are from it."""
        ...

    @property
    def exactly(self) -> str:
        """What the given numbers say if they are taken exactly."""
        ...

    @property
    def lines(self) -> list[str]:
        """What differs, the largest change first, and what the given numbers contradict."""
        ...

    def data(self) -> dict[str, Any]:
        """All numbers and texts as plain Python."""
        ...


@explained_methods
class Result:
    """Base of all results: `Answer`, which has configurations, and `Report`, which has findings.

    `success` (...) says whether the question was answered, `code` (...) is its `Status` (of a batch
    an array of their numbers), `status` (...) the sentence that says so. A result is true where all
    of `success` is; `print` it.
    """

    success: Any
    code: Any
    status: Any
    within: Nearest | None = None
    """The nearest mechanism that closes exactly, which was solved in place of the given one; None:
    it was itself."""
    _pictured = False
    """Whether a notebook shows its `plot`, too: where the picture says more than the numbers."""

    def data(self) -> dict[str, Any]:
        """All numbers and texts as plain Python, ready for JSON; `code` by the names of `Status`,
        NaN as None.
        """
        said = {
            "success": np.asarray(self.success).tolist(),
            "code": named(self.code),
            "status": self.status,
        }
        return jsonable(self._head() | said | self._data())

    def to_json(self) -> str:
        """The `data` as JSON."""
        return json_text(self.data())

    def _head(self) -> dict[str, Any]:
        """What the data begin with: of what they are."""
        return {}

    def _data(self) -> dict[str, Any]:
        """The numbers and texts of its own."""
        return {}

    # ---- as text and HTML

    def _headline(self) -> str:
        """The first line of the text."""
        return str(self.status)

    def _cells(self) -> Cells:
        """What the text has as lines under the headline, and HTML as a table."""
        return (), ()

    def _notes(self) -> Sequence[str]:
        """The last lines."""
        return ()

    def _lines(self) -> Sequence[str]:
        """The `_cells` as lines of text."""
        heads, rows = self._cells()
        if not heads:
            return [" = ".join(row) for row in rows]
        return [", ".join(f"{h} = {x}" for h, x in zip(heads, row, strict=True)) for row in rows]

    def __bool__(self) -> bool:
        return bool(np.all(self.success))

    def __str__(self) -> str:
        return "\n".join(
            [self._headline(), *(f"  {line}" for line in (*self._lines(), *self._notes()))]
        )

    def _repr_html_(self) -> str:
        cells = self._cells()
        head = paragraphs([self._headline()])
        body = table_html(*cells) if len(cells[1]) else paragraphs(self._lines())
        return head + body + paragraphs(self._notes()) + self._image()

    def _image(self) -> str:
        """What `plot` draws, as HTML, where `_pictured` says so; '' where nothing can be drawn."""
        if not self._pictured:
            return ""
        self_: Any = self
        try:
            axes = self_.plot()
        except (KempeError, ValueError, ArithmeticError):
            return ""
        return image_html(np.ravel(axes)[0].figure, self._headline())


by_code: Any = property(
    lambda self: plain(np.asarray(self.code) == Status.SOLVED), doc="Whether (...) it is answered."
)
"""The `success` of results that have only a `code`."""


@explained_methods
class Report(Result):
    """Findings about a system, with their reasons. The `sentence` is the `status`."""

    code: Any = Status.SOLVED
    success = by_code

    @property
    def status(self) -> Any:
        """The result in one sentence; of a batch an array of sentences."""
        raise NotImplementedError

    @property
    def sentence(self) -> Any:
        """The result in one sentence: another name of `status`."""
        return self.status

    def topics(self) -> Sequence[tuple[str, Sequence[str]]]:
        """The reasons as (title, lines)."""
        return ()

    def __str__(self) -> str:
        topics = self.topics()
        return by_topic(self._headline(), topics) if topics else super().__str__()

    def _repr_html_(self) -> str:
        topics = self.topics()
        return (
            paragraphs([self._headline()]) + topics_html(topics)
            if topics
            else super()._repr_html_()
        )


class Words(NamedTuple):
    """Functions that put a report into words: one sentence, reasons as (title, lines), and data."""

    sentence: Callable[[Any], str]
    lines: Callable[[Any], list[tuple[str, list[str]]]]
    data: Callable[[Any], dict[str, Any]]


class Worded(Report):
    """A report by `name` that functions put into words."""

    name: str

    def _words(self) -> Words:
        raise NotImplementedError

    @property
    def status(self) -> str:
        """The result in one sentence."""
        return self._words().sentence(self)

    def topics(self) -> list[tuple[str, list[str]]]:
        """The reasons as (title, lines)."""
        return self._words().lines(self)

    def _headline(self) -> str:
        return f"{self.name}: {self.status}"

    def _data(self) -> dict[str, Any]:
        return self._words().data(self)


# ---- answers on one line

FEW = 16
"""Entries of an array, or of a tuple, that are shown."""


def brief(self: Any) -> str:
    """The fields of an answer on one line, of large arrays only the shape."""
    shows = [f for f in fields(self) if f.repr]
    return f"{type(self).__name__}({', '.join(f'{f.name}={_brief(getattr(self, f.name))}' for f in shows)})"


def _brief(x: Any) -> str:
    given: Any = x
    if is_array(x):
        return f"array {x.shape}" if x.size > FEW else " ".join(repr(x).split())
    if isinstance(x, dict):
        return f"{{{', '.join(f'{k!r}: {_brief(v)}' for k, v in given.items())}}}"
    if isinstance(x, tuple) and len(given) > FEW:
        return f"({', '.join(map(_brief, given[:2]))}, ... {len(given)} in all)"
    return repr(given)
