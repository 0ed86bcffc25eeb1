"""Numbers of things in sentences."""

from __future__ import annotations

SMALL = ("no", "one", "two", "three", "four", "five", "six")
"""Numbers that are written out."""


def counted(n: int, what: str) -> str:
    """A number of things in digits: '3 starts', '1 start'."""
    return f"{n} {what}{'' if n == 1 else 's'}"


def in_words(n: int, what: str) -> str:
    """A number of things with small numbers written out: 'two joints'."""
    return f"{SMALL[n] if n < len(SMALL) else n} {what}{'' if n == 1 else 's'}"
