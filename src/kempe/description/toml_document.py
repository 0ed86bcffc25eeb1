"""TOML document: its tables with checked form, and the place of every value in the text."""

from __future__ import annotations

import contextlib
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

from kempe import constraints
from kempe.constraints.base import list_fields
from kempe.description.shapes import SHAPES, list_size_names
from kempe.description.source import Findings, Source, make_error, shorten_text
from kempe.errors import Where, hint
from kempe.joints import TYPES, JointType

# ---- places of values

# The standard parser does not say where tables, keys and array elements stand.

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
    """Token of a TOML text: its kind, its text, and its offset."""

    kind: str
    text: str
    offset: int


class Places:
    """Places of the values in a TOML text, by path."""

    def __init__(self, source: Source, tables: dict[Path, int] | None = None):
        self.source = source
        self._tables = tables or {}

    @cached_property
    def _offsets(self) -> dict[Path, int]:
        """Offsets of the values by path."""
        return _scan_offsets(self.source.text)

    def locate_value(self, *path: str | int) -> Where:
        """Return the place of the value at `path`, or of the table that encloses it."""
        path = path[: 2 * DEEPEST]
        if path in self._tables:  # known without looking at what is in them
            return self.source.locate_offset(self._tables[path])
        while path and path not in self._offsets:
            path = path[:-1]
        return self.source.locate_offset(self._offsets.get(path, 0))


def _iterate_tokens(text: str) -> Iterator[_Token]:
    """Iterate over the tokens of a TOML text without comments."""
    for match in _TOKEN.finditer(text):
        kind = match.lastgroup or ""
        if kind != "comment":
            yield _Token(kind, match[0], match.start())
    yield _Token("newline", "", len(text))


def _scan_offsets(text: str) -> dict[Path, int]:
    """Return the offsets of all values of a valid TOML text, by path."""
    offsets: dict[Path, int] = {}
    counts: dict[Path, int] = {}
    section: Path = ()
    tokens = _iterate_tokens(text)
    for token in tokens:
        if token.kind == "newline":
            continue
        if token.text == "[":
            section = _parse_header(token, tokens, counts)
            for depth in range(1, len(section) + 1):
                offsets.setdefault(section[:depth], token.offset)
            continue
        path = (*section, *_parse_key(token, tokens, "="))
        for depth in range(len(section) + 1, len(path)):
            offsets.setdefault(path[:depth], token.offset)
        _record_value(path, tokens, offsets)
    return offsets


def _parse_header(start: _Token, tokens: Iterator[_Token], counts: dict[Path, int]) -> Path:
    """Return the path of ``[a.b]`` or ``[[a.b]]``; an array of tables stands for its last element."""
    first = next(tokens)
    array = first.text == "[" and first.offset == start.offset + 1
    names = _parse_key(next(tokens) if array else first, tokens, "]")
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


def _parse_key(token: _Token, tokens: Iterator[_Token], stop: str) -> list[str]:
    """Return the first names of a dotted key, which `token` begins and `stop` ends."""
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


def _record_value(path: Path, tokens: Iterator[_Token], offsets: dict[Path, int]) -> None:
    """Record the offset of a value, and of the elements of an array; go on to the end of its line."""
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


# ---- fast parsing of many small tables

# Only lines of the plainest form are read here: a header of one bare name, or a bare key with text
# without escapes, a number, a truth value, or a list of these in one line. A table with any other
# line is given to `tomllib` by itself, and where that does not fit together, all of the text is: so
# the answer, or what is wrong, is that of `tomllib`.

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
    """Error for a text that is not of the simple form."""


def parse_toml(text: str) -> tuple[dict[str, Any], dict[Path, int] | None]:
    """Return the data of a TOML text, as of `tomllib.loads`, and the offsets of its tables.

    The offsets are None where they are unknown.

    Errors: those of `tomllib`.
    """
    if _LONG_KEY.search(text) and (
        found := _LONG_KEY.search(_STRING_OR_COMMENT.sub(_blank_match, text))
    ):
        line = found.string.count("\n", 0, found.start()) + 1
        raise ValueError(f"a dotted key of more than {MOST_NAMES} names (at line {line}, column 1)")
    if text.count("\n[") >= MANY:
        with contextlib.suppress(_Other, ValueError, RecursionError):
            return _parse_tables(text)
    return tomllib.loads(text), None


def _blank_match(found: re.Match[str]) -> str:
    """Return as many empty lines as a string or comment has."""
    return f'"{chr(10) * found[0].count(chr(10))}"' if found[0][0] != "#" else ""


def _parse_tables(text: str) -> tuple[dict[str, Any], dict[Path, int]]:
    """Return the data of a TOML text with simple tables, and the offsets of its tables."""
    heads = list(_HEADER.finditer(text))
    out = _parse_table(text[: heads[0].start() if heads else len(text)])
    places: dict[Path, int] = {}
    arrays: dict[str, list[Any]] = {}
    for head, following in zip(heads, [*heads[1:], None], strict=True):
        double, name, end = head.groups()
        if len(double) != len(end):
            raise _Other
        table = _parse_table(text[head.end() : following.start() if following else len(text)])
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


def _parse_table(text: str) -> dict[str, Any]:
    """Return the keys between two headers."""
    out: dict[str, Any] = {}
    for line in text.split("\n"):
        if not line:
            continue
        match = _LINE.fullmatch(line)
        if match is None:
            return _parse_full_table(text)
        key, quoted, number, truth, array = match.groups()
        if key is None:
            continue
        if key in out:
            raise _Other
        if quoted is not None:
            out[key] = quoted
        elif number is not None:
            found = _parse_number(number)
            if found is None:
                return _parse_full_table(text)
            out[key] = found
        elif truth is not None:
            out[key] = truth == "true"
        else:
            items = array.strip(" \t").removesuffix(",").split(",") if array.strip(" \t") else []
            numbers = [_parse_number(x.strip(" \t")) for x in items]
            if None in numbers:
                return _parse_full_table(text)
            out[key] = numbers
    return out


def _parse_number(text: str) -> int | float | None:
    """Return the number in a text; None for other texts and rare forms of numbers."""
    if _FLOAT.fullmatch(text):
        return float(text)
    return int(text) if _WHOLE.fullmatch(text) else None


def _parse_full_table(text: str) -> dict[str, Any]:
    """Return the keys of a table whose lines are not all of the simplest form."""
    if _BRACKET.search(text):
        raise _Other
    return tomllib.loads(text)


# ---- the document

FORMAT = 1
NEWEST = 2
"""Versions of the format that are read. The newer one has all kinds of constraints; files without
them are written in the older one."""

PLACE = ("at", "rpy", "angle", "quat_wxyz", "matrix", "axis", "steps")
"""Keys that place a frame on a body; for the frame on a joint's child with the prefix
``child_``."""

KEYS = {
    "": (
        "format",
        "name",
        "dim",
        "ground",
        "unit",
        "tolerance",
        "notes",
        "parameters",
        "body",
        "joint",
        "frame",
        "shape",
        "constraint",
        "coupling",
        "postures",
        "groups",
        "ignored_pairs",
        "locks",
        "dh",
        "screws",
    ),
    "body": ("name", "particle", "mass", "center", "visuals"),
    "joint": (
        "name",
        "type",
        "parent",
        "child",
        *PLACE,
        *(f"child_{k}" for k in PLACE),
        "limits",
        "velocity",
        "effort",
        "actuated",
        "cut",
    ),
    "frame": ("name", "body", *PLACE),
    "shape": (
        "body",
        "type",
        *dict.fromkeys(size for kind in SHAPES.values() for size in list_size_names(kind)),
        *PLACE,
        "visual",
        "collision",
        "color",
        "name",
    ),
    "constraint": (
        "name",
        "type",
        "parent",
        "child",
        "length",
        *PLACE,
        *(f"child_{k}" for k in PLACE),
    ),
    "coupling": ("of", "sources", "offset"),
    "dh": ("convention", "rows", "on", "base", "tool", "deg", "columns"),
    "screws": ("rows", "home"),
}
"""Keys that each table knows; joints besides those of `list_joint_options`."""

REQUIRED = {
    "body": ("name",),
    "joint": ("name", "type", "parent", "child"),
    "frame": ("name", "body"),
    "shape": ("body", "type"),
    "constraint": ("name", "type"),
    "coupling": ("of", "sources"),
    "dh": ("rows",),
    "screws": ("rows",),
}
"""Keys that each table must have."""

_VALUES: dict[str, tuple[type, str]] = {
    "particle": (bool, "true or false"),
    "visual": (bool, "true or false"),
    "collision": (bool, "true or false"),
    "actuated": (bool, "true or false"),
    "cut": (bool, "true or false"),
    "name": (str, "text in quotes"),
    "ground": (str, "text in quotes"),
    "of": (str, "the name of a coordinate"),
    "on": (str, "the name of a body"),
    "dim": (int, "2 or 3"),
    "notes": (list, "a list of texts"),
    "visuals": (list, "a list of texts"),
    "center": (list, "[x, y] or [x, y, z]"),
    "rows": (list, "a list of tables"),
    "ignored_pairs": (list, "a list of pairs of bodies"),
    "deg": (bool, "true or false"),
    "columns": (list, "a list of texts"),
}
_AT_LINE = re.compile(r" \(at line (\d+), column (\d+)\)$")


def list_joint_options() -> tuple[str, ...]:
    """Return the names of the options of all joint types."""
    return _list_type_options(tuple(TYPES.values()))


@lru_cache(maxsize=8)
def _list_type_options(types: tuple[type[JointType], ...]) -> tuple[str, ...]:
    """Return the names of the options of these joint types."""
    return tuple(dict.fromkeys(name for type_ in types for name in type_.list_defaults()))


def _is_plain_data(data: Any) -> bool:
    """Whether data hold only tables, lists, texts and numbers of at most 64 bits."""
    stack = [data]
    while stack:
        item = stack.pop()
        kind = item.__class__
        if kind is dict:
            stack += item.values()
        elif kind is list:
            stack += item
        elif kind not in (str, float, bool) and not (kind is int and abs(item) < 2**63):
            return False
    return True


class Document:
    """Data of a TOML text, with places of values and findings of its readers."""

    def __init__(self, source: Source):
        self.source = source
        self.data, tables = _parse_source(source)
        self.places = Places(source, tables)
        self.findings = Findings()

    def locate_value(self, *path: str | int) -> Where:
        """Return the place of the value at `path`, or of the table that encloses it."""
        return self.places.locate_value(*path)

    def check_format(self) -> None:
        """Raise an error unless the file has Kempe's format and holds plain data only."""
        given = self.data.get("format")
        if given is None:
            raise make_error(
                "the file has no line 'format = 1'",
                self.locate_value(),
                "every mechanism file starts with it",
            )
        if type(given) is not int or not FORMAT <= given <= NEWEST:
            allowed = f"this version of Kempe reads format {FORMAT} and {NEWEST}"
            raise make_error(f"format is {given!r}", self.locate_value("format"), allowed)
        if not _is_plain_data(self.data):
            self._refuse_other_values()
        self.findings.raise_problems()
        self.check_table("", self.data, ())

    def _refuse_other_values(self) -> None:
        """Record a problem for each value that is neither text, number, list nor table."""
        stack: list[tuple[Path, Any]] = [((), self.data)]
        while stack:
            path, item = stack.pop()
            inner: Any = item
            if isinstance(item, dict):
                stack += [((*path, k), v) for k, v in inner.items()]
            elif isinstance(item, list):
                stack += [((*path, i), v) for i, v in enumerate(inner)]
            elif isinstance(item, int) and abs(item) >= 2**63:
                self.findings.add_problem(
                    "an integer of more than 64 bits",
                    "",
                    self.locate_value(*path),
                    "write it as 1e20",
                )
            elif not isinstance(item, (int, float, str)):
                message = f"{shorten_text(item)} is a date or a time"
                self.findings.add_problem(
                    message, "", self.locate_value(*path), "write text in quotes"
                )

    def check_table(
        self, kind: str, table: Mapping[str, Any], path: Path, subject: str = ""
    ) -> bool:
        """Check that a table has all required keys, no unknown ones, and values of the right types.

        Problems are recorded; return whether there are none.
        """
        before = len(self.findings.problems)
        known = KEYS[kind] + (list_joint_options() if kind == "joint" else ())
        if (
            kind == "constraint"
            and "parent" not in table
            and table.get("type") in constraints.KINDS
        ):
            known = ("name", "type", *list_fields(constraints.KINDS[table["type"]]))
        for key, item in table.items():
            wanted, said = (
                (object, "")
                if (kind, key) == ("constraint", "of")
                else _VALUES.get(key, (object, ""))
            )
            if key not in known:
                place = self.locate_value(*path, key)
                self.findings.add_problem(
                    f"unknown key {shorten_text(key)}{hint(key[:60], known)}", subject, place
                )
            elif not isinstance(item, wanted) or (wanted is int and isinstance(item, bool)):
                self.findings.add_problem(
                    f"{key} is {shorten_text(item)}",
                    subject,
                    self.locate_value(*path, key),
                    f"it must be {said}",
                )
            elif said == "a list of texts" and not all(isinstance(x, str) for x in item):
                place = self.locate_value(*path, key)
                self.findings.add_problem(
                    f"{key} holds something else than text", subject, place, f"it must be {said}"
                )
        self.require_keys(REQUIRED.get(kind, ()), table, path, subject)
        return len(self.findings.problems) == before

    def require_keys(
        self, keys: Sequence[str], table: Mapping[str, Any], path: Path, subject: str
    ) -> bool:
        """Record a problem for each of the keys that a table lacks; return whether it has all."""
        missing = [key for key in keys if key not in table]
        for key in missing:
            self.findings.add_problem(
                f"the key {key!r} is missing",
                subject,
                self.locate_value(*path),
                f"it needs {', '.join(keys)}",
            )
        return not missing

    def get_tables(self, kind: str) -> list[dict[str, Any]]:
        """Return the tables [[kind]]."""
        found = tables = self.data.get(kind, [])
        if isinstance(found, list) and all(isinstance(x, dict) for x in tables):
            return tables
        allowed = f"write [[{kind}]], with double brackets, above each {kind}"
        self.findings.add_problem(
            f"{kind!r} is not a list of tables", "", self.locate_value(kind), allowed
        )
        return []

    def get_table(self, kind: str) -> dict[str, Any]:
        """Return the table [kind], empty where it is missing."""
        found = table = self.data.get(kind, {})
        if isinstance(found, dict):
            return table
        self.findings.add_problem(
            f"{kind!r} is not a table", "", self.locate_value(kind), f"write [{kind}]"
        )
        return {}

    def flatten_table(self, found: Any, path: Path, what: str) -> dict[str, Any]:
        """Return a table by coordinate name; ``J.x = 1`` and ``"J.x" = 1`` mean the same."""
        table: Any = found
        if not isinstance(found, dict):
            allowed = "it must be a table by coordinate name, such as {A = 0.3}"
            self.findings.add_problem(
                f"{what} is {shorten_text(found)}", "", self.locate_value(*path), allowed
            )
            return {}
        out: dict[str, Any] = {}
        stack: list[tuple[Any, Any]] = list(reversed(table.items()))
        while stack:
            key, item = stack.pop()
            inner = item
            if isinstance(item, dict):
                stack += [(f"{key}.{k}", v) for k, v in reversed(inner.items())]
            elif key in out:
                self.findings.add_problem(
                    f"{what} names {key!r} twice", "", self.locate_value(*path), "name it once"
                )
            else:
                out[key] = item
        return out


def _parse_source(source: Source) -> tuple[dict[str, Any], dict[Path, int] | None]:
    """Return the data and the offsets of tables.

    Errors: `DescriptionError` where the text is no TOML.
    """
    try:
        return parse_toml(source.text)
    except RecursionError:
        raise make_error(
            "arrays or tables are nested too deep", source.locate_line(1), "this is no mechanism"
        ) from None
    except ValueError as error:  # TOMLDecodeError, and integers of too many digits
        text = str(error)
        match = _AT_LINE.search(text)
        line = len(source.lines)
        column = len(source.lines[-1]) + 1
        if match:
            line = int(match[1])
            column = int(match[2])
        where = source.locate_line(line, column)
        allowed = "see the caret"
        if re.match(r",\s*\d", where.text[column - 1 :]):
            allowed = "decimals take a point: 1.5"
        elif "end of document" in text:
            allowed = "the file may be truncated"
        text = _AT_LINE.sub("", text).removesuffix(" (at end of document)")
        raise make_error(
            f"this is not TOML: {text[:1].lower()}{text[1:]}", where, allowed
        ) from None
