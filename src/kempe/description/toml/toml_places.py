"""Where each table, key and array element of a TOML text stands, which the standard parser does not
say.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

from kempe.description.source import Source
from kempe.errors import Where

Path = tuple[str | int, ...]
"""Keys and indices that lead to a value: ``("joint", 2, "limits")``."""

DEEPEST = 16
"""Names of a dotted key that are told apart: Kempe's own format has six at most, and a long key
must not take long."""

_TOKEN = re.compile(
    r'''(?P<string>"""(?:\\.|[^\\])*?"""(?:""|"|)|\'\'\'.*?\'\'\'(?:\'\'|\'|)|"(?:\\.|[^"\\\n])*"|'[^'\n]*')'''
    r"""|(?P<comment>\#[^\n]*)|(?P<newline>\n)|(?P<mark>[\[\]{},=.])|(?P<bare>[^\s"'\#\[\]{},=.]+)""",
    re.DOTALL,
)


class _Token(NamedTuple):
    kind: str
    text: str
    offset: int


class Places:
    """Answers where the value at a path stands; for an unknown path, where what encloses it stands."""

    def __init__(self, source: Source, tables: dict[Path, int] | None = None):
        self.source = source
        self._tables = tables or {}

    @cached_property
    def _offsets(self) -> dict[Path, int]:
        return _scan(self.source.text)

    def where(self, *path: str | int) -> Where:
        """The place of the value at `path`."""
        path = path[: 2 * DEEPEST]
        if path in self._tables:  # known without looking at what is in them
            return self.source.where_offset(self._tables[path])
        while path and path not in self._offsets:
            path = path[:-1]
        return self.source.where_offset(self._offsets.get(path, 0))


def _tokens(text: str) -> Iterator[_Token]:
    for match in _TOKEN.finditer(text):
        kind = match.lastgroup or ""
        if kind != "comment":
            yield _Token(kind, match[0], match.start())
    yield _Token("newline", "", len(text))


def _scan(text: str) -> dict[Path, int]:
    """Offsets by path, of a text that is valid TOML."""
    offsets: dict[Path, int] = {}
    counts: dict[Path, int] = {}
    section: Path = ()
    tokens = _tokens(text)
    for token in tokens:
        if token.kind == "newline":
            continue
        if token.text == "[":
            section = _header(token, tokens, counts)
            for depth in range(1, len(section) + 1):
                offsets.setdefault(section[:depth], token.offset)
            continue
        path = (*section, *_key(token, tokens, "="))
        for depth in range(len(section) + 1, len(path)):
            offsets.setdefault(path[:depth], token.offset)
        _value(path, tokens, offsets)
    return offsets


def _header(start: _Token, tokens: Iterator[_Token], counts: dict[Path, int]) -> Path:
    """Path of ``[a.b]`` or ``[[a.b]]``; a name of an array of tables stands for its last element."""
    first = next(tokens)
    array = first.text == "[" and first.offset == start.offset + 1
    names = _key(next(tokens) if array else first, tokens, "]")
    path: Path = ()
    for i, name in enumerate(names):
        path = (*path, name)
        last = i == len(names) - 1
        if last and array:
            counts[path] = counts.get(path, -1) + 1
        if path in counts:
            path = (*path, counts[path])
    if array:
        next(tokens, None)
    return path


def _key(token: _Token, tokens: Iterator[_Token], stop: str) -> list[str]:
    """The first names of a dotted key, which `token` begins and `stop` ends."""
    names: list[str] = []
    while token.text != stop or token.kind == "string":
        if len(names) == DEEPEST:
            pass
        elif token.kind == "string":
            names.append(tomllib.loads(f"k={token.text}")["k"])
        elif token.kind == "bare":
            names.append(token.text)
        following = next(tokens, None)
        if following is None:
            break
        token = following
    return names


def _value(path: Path, tokens: Iterator[_Token], offsets: dict[Path, int]) -> None:
    """Record where a value and, in an array, its elements start; go on to the end of its line."""
    depth = 0
    index = 0
    fresh = False
    array = False
    for token in tokens:
        if path not in offsets and token.kind != "newline":
            offsets[path] = token.offset
            array = token.text == "["
        if token.kind == "newline":
            if depth == 0:
                return
            continue
        if array and depth == 1 and fresh and token.text != "]":
            offsets[(*path, index)] = token.offset
            fresh = False
        if token.kind != "mark":
            continue
        if token.text in "[{":
            depth += 1
            fresh = fresh or depth == 1
        elif token.text in "]}":
            depth -= 1
        elif token.text == "," and depth == 1:
            index = index + 1
            fresh = True
