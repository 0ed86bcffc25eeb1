"""Numbers of things in sentences, and reports by topic as text and HTML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

SMALL = ("no", "one", "two", "three", "four", "five", "six")
"""Numbers that are written out."""


def counted(n: int, what: str) -> str:
    """A number of things in digits: '3 starts', '1 start'."""
    return f"{n} {what}{'' if n == 1 else 's'}"


def in_words(n: int, what: str) -> str:
    """A number of things with small numbers written out: 'two joints'."""
    return f"{SMALL[n] if n < len(SMALL) else n} {what}{'' if n == 1 else 's'}"


def cut(lines: list[str], most: int) -> list[str]:
    """The first `most` lines, and how many more there are."""
    return lines if len(lines) <= most else [*lines[:most], f"... and {len(lines) - most} more"]


def by_topic(headline: str, topics: Iterable[tuple[str, Sequence[str]]]) -> str:
    """A report as text: the headline, and under it the lines of each (title, lines) that are not empty."""
    out = [headline]
    for title, lines in topics:
        for k, line in enumerate(x for x in lines if x):
            out.append(f"  {title if k == 0 else '':<16}{line}")
    return "\n".join(out)


def topics_html(topics: Iterable[tuple[str, Sequence[str]]]) -> str:
    """The (title, lines) of a report as a table of HTML, without lines that are empty."""
    rows = "".join(
        f"<tr><th style='text-align:left;vertical-align:top'>{escape(title)}</th>"
        f"<td style='text-align:left'>{'<br>'.join(escape(x) for x in lines if x)}</td></tr>"
        for title, lines in topics
    )
    return f"<table>{rows}</table>"
