"""TOML of many small tables, read line by line: what `tomllib` says, several times as fast.

Only lines of the plainest form are read here: a header of one bare name, or a bare key with text
without escapes, a number, a truth value, or a list of these in one line. A table with any other
line is given to `tomllib` by itself, and where that does not fit together, all of the text is: so
the answer, or what is wrong, is that of `tomllib`.
"""

from __future__ import annotations

import contextlib
import re
import tomllib
from typing import Any

from kempe.description.toml.toml_places import Path

MANY = 100
"""Tables from which on it is worth it."""

_COMMENT = r"(?:#[^\x00-\x08\x0a-\x1f\x7f]*)?"
_HEADER = re.compile(rf"^[ \t]*\[(\[?)([A-Za-z0-9_-]+)\](\]?)[ \t]*{_COMMENT}\r?$", re.MULTILINE)
_LINE = re.compile(
    r"[ \t]*(?:([A-Za-z0-9_-]+)[ \t]*=[ \t]*"
    r'(?:"([^"\\\x00-\x1f\x7f]*)"|([-+.0-9eE]+)|(true|false)|\[([-+.0-9eE, \t]*)\])[ \t]*)?'
    rf"{_COMMENT}\r?"
)
MOST_NAMES = 64
"""Names of a dotted key: the time of `tomllib` grows as their square."""
_LONG_KEY = re.compile(
    # a line, a table, or an inline table begins, or goes on
    r"""(?:^[ \t]*+(?:\[\[?[ \t]*+)?|[{,][ \t]*+)"""
    rf"""(?:(?:[A-Za-z0-9_-]++|"[^"\n]*"|'[^'\n]*')[ \t]*+\.[ \t]*+){{{MOST_NAMES}}}""",
    re.MULTILINE,
)
_STRING_OR_COMMENT = re.compile(
    r'''"""(?:[^\\]|\\.)*?"""|''' r"'''.*?'''" r"""|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'|\#[^\n]*""",
    re.DOTALL,
)
_FLOAT = re.compile(r"[-+]?(?:0|[1-9][0-9]*)(?:\.[0-9]+(?:[eE][-+]?[0-9]+)?|[eE][-+]?[0-9]+)")
_BRACKET = re.compile(r"^[ \t]*\[", re.MULTILINE)
_WHOLE = re.compile(r"[-+]?(?:0|[1-9][0-9]{0,17})")


class _Other(Exception):
    """The text is not of the form that is read here."""


def loads(text: str) -> tuple[dict[str, Any], dict[Path, int] | None]:
    """The data of a TOML text, as of `tomllib.loads`, and where its tables begin; None where that
    is not known.

    Errors: those of `tomllib`.
    """
    if _LONG_KEY.search(text) and (
        found := _LONG_KEY.search(_STRING_OR_COMMENT.sub(_hollow, text))
    ):
        line = found.string.count("\n", 0, found.start()) + 1
        raise ValueError(f"a dotted key of more than {MOST_NAMES} names (at line {line}, column 1)")
    if text.count("\n[") >= MANY:
        with contextlib.suppress(_Other, ValueError, RecursionError):
            return _loads(text)
    return tomllib.loads(text), None


def _hollow(found: re.Match[str]) -> str:
    """What stands for a string or a comment where only keys are looked for: as many lines."""
    return f'"{chr(10) * found[0].count(chr(10))}"' if found[0][0] != "#" else ""


def _loads(text: str) -> tuple[dict[str, Any], dict[Path, int]]:
    heads = list(_HEADER.finditer(text))
    out = _table(text[: heads[0].start() if heads else len(text)])
    places: dict[Path, int] = {}
    arrays: dict[str, list[Any]] = {}
    for head, following in zip(heads, [*heads[1:], None], strict=True):
        double, name, end = head.groups()
        if len(double) != len(end):
            raise _Other
        table = _table(text[head.end() : following.start() if following else len(text)])
        if double and (name in arrays or name not in out):
            if name not in out:
                out[name] = arrays[name] = []
            places[name, len(arrays[name])] = head.start(1) - 1
            arrays[name].append(table)
        elif name in out:
            raise _Other
        else:
            out[name] = table
            places[name,] = head.start(1) - 1
    return out, places


def _table(text: str) -> dict[str, Any]:
    """The keys between two headers."""
    out: dict[str, Any] = {}
    for line in text.split("\n"):
        if not line:
            continue
        match = _LINE.fullmatch(line)
        if match is None:
            return _whole(text)
        key, quoted, number, truth, array = match.groups()
        if key is None:
            continue
        if key in out:
            raise _Other
        if quoted is not None:
            out[key] = quoted
        elif number is not None:
            found = _number(number)
            if found is None:
                return _whole(text)
            out[key] = found
        elif truth is not None:
            out[key] = truth == "true"
        else:
            items = array.strip(" \t").removesuffix(",").split(",") if array.strip(" \t") else []
            numbers = [_number(x.strip(" \t")) for x in items]
            if None in numbers:
                return _whole(text)
            out[key] = numbers
    return out


def _number(text: str) -> int | float | None:
    """The number, None where it is none or one of the rarer forms."""
    if _FLOAT.fullmatch(text):
        return float(text)
    return int(text) if _WHOLE.fullmatch(text) else None


def _whole(text: str) -> dict[str, Any]:
    """The keys of a table that has others than the plainest lines. What may be a header is of
    another table.
    """
    if _BRACKET.search(text):
        raise _Other
    return tomllib.loads(text)
