"""A TOML text as tables whose shape is checked and whose every value knows its place."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from kempe import constraints
from kempe.constraints.base import fields_of
from kempe.description.source import Findings, Source, fail, shorten
from kempe.description.toml.toml_fast import loads
from kempe.description.toml.toml_places import Path, Places
from kempe.errors import Where, hint
from kempe.joints import TYPES, JointType

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
        "tolerance",
        "notes",
        "parameters",
        "body",
        "joint",
        "frame",
        "constraint",
        "coupling",
        "postures",
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
"""Keys that each table knows; joints besides those of `joint_options`."""

REQUIRED = {
    "body": ("name",),
    "joint": ("name", "type", "parent", "child"),
    "frame": ("name", "body"),
    "constraint": ("name", "type"),
    "coupling": ("of", "sources"),
    "dh": ("rows",),
    "screws": ("rows",),
}
"""Keys that each table must have."""

_VALUES: dict[str, tuple[type, str]] = {
    "particle": (bool, "true or false"),
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
    "deg": (bool, "true or false"),
    "columns": (list, "a list of texts"),
}
_AT_LINE = re.compile(r" \(at line (\d+), column (\d+)\)$")


def joint_options() -> tuple[str, ...]:
    """Names of the options of all joint types."""
    return _options(tuple(TYPES.values()))


@lru_cache(maxsize=8)
def _options(types: tuple[type[JointType], ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for type_ in types for name in type_.defaults()))


def _plain(data: Any) -> bool:
    """Whether there is nothing in it but tables, lists, text and numbers of at most 64 bits."""
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
    """The data of a TOML text, with its places and the findings of those who read it."""

    def __init__(self, source: Source):
        self.source = source
        self.data, tables = _parse(source)
        self.places = Places(source, tables)
        self.findings = Findings()

    def where(self, *path: str | int) -> Where:
        """The place of the value at `path`, or of what encloses it."""
        return self.places.where(*path)

    def check_format(self) -> None:
        """Raise unless the file has our format, and holds nothing but text, numbers, lists and
        tables.
        """
        given = self.data.get("format")
        if given is None:
            raise fail(
                "the file has no line 'format = 1'",
                self.where(),
                "every mechanism file starts with it",
            )
        if type(given) is not int or not FORMAT <= given <= NEWEST:
            allowed = f"this version of Kempe reads format {FORMAT} and {NEWEST}"
            raise fail(f"format is {given!r}", self.where("format"), allowed)
        if not _plain(self.data):
            self._refuse_others()
        self.findings.finish()
        self.check("", self.data, ())

    def _refuse_others(self) -> None:
        """Record what is neither text, number, list nor table."""
        stack: list[tuple[Path, Any]] = [((), self.data)]
        while stack:
            path, item = stack.pop()
            inner: Any = item
            if isinstance(item, dict):
                stack += [((*path, k), v) for k, v in inner.items()]
            elif isinstance(item, list):
                stack += [((*path, i), v) for i, v in enumerate(inner)]
            elif isinstance(item, int) and abs(item) >= 2**63:
                self.findings.add(
                    "an integer of more than 64 bits", "", self.where(*path), "write it as 1e20"
                )
            elif not isinstance(item, (int, float, str)):
                message = f"{shorten(item)} is a date or a time"
                self.findings.add(message, "", self.where(*path), "write text in quotes")

    def check(self, kind: str, table: Mapping[str, Any], path: Path, subject: str = "") -> bool:
        """Whether a table has all keys that it must have and no others, with the right types."""
        before = len(self.findings.problems)
        known = KEYS[kind] + (joint_options() if kind == "joint" else ())
        if (
            kind == "constraint"
            and "parent" not in table
            and table.get("type") in constraints.KINDS
        ):
            known = ("name", "type", *fields_of(constraints.KINDS[table["type"]]))
        for key, item in table.items():
            wanted, said = (
                (object, "")
                if (kind, key) == ("constraint", "of")
                else _VALUES.get(key, (object, ""))
            )
            if key not in known:
                place = self.where(*path, key)
                self.findings.add(
                    f"unknown key {shorten(key)}{hint(key[:60], known)}", subject, place
                )
            elif not isinstance(item, wanted) or (wanted is int and isinstance(item, bool)):
                self.findings.add(
                    f"{key} is {shorten(item)}",
                    subject,
                    self.where(*path, key),
                    f"it must be {said}",
                )
            elif said == "a list of texts" and not all(isinstance(x, str) for x in item):
                place = self.where(*path, key)
                self.findings.add(
                    f"{key} holds something else than text", subject, place, f"it must be {said}"
                )
        for key in REQUIRED.get(kind, ()):
            if key not in table:
                allowed = f"it needs {', '.join(REQUIRED[kind])}"
                self.findings.add(
                    f"the key {key!r} is missing", subject, self.where(*path), allowed
                )
        return len(self.findings.problems) == before

    def array(self, kind: str) -> list[dict[str, Any]]:
        """The tables [[kind]]."""
        found = tables = self.data.get(kind, [])
        if isinstance(found, list) and all(isinstance(x, dict) for x in tables):
            return tables
        allowed = f"write [[{kind}]], with double brackets, above each {kind}"
        self.findings.add(f"{kind!r} is not a list of tables", "", self.where(kind), allowed)
        return []

    def table(self, kind: str) -> dict[str, Any]:
        """The table [kind], empty where it is missing."""
        found = table = self.data.get(kind, {})
        if isinstance(found, dict):
            return table
        self.findings.add(f"{kind!r} is not a table", "", self.where(kind), f"write [{kind}]")
        return {}

    def flat(self, found: Any, path: Path, what: str) -> dict[str, Any]:
        """A table by coordinate name; ``J.x = 1`` and ``"J.x" = 1`` say the same."""
        table: Any = found
        if not isinstance(found, dict):
            allowed = "it must be a table by coordinate name, such as {A = 0.3}"
            self.findings.add(f"{what} is {shorten(found)}", "", self.where(*path), allowed)
            return {}
        out: dict[str, Any] = {}
        stack: list[tuple[Any, Any]] = list(reversed(table.items()))
        while stack:
            key, item = stack.pop()
            inner = item
            if isinstance(item, dict):
                stack += [(f"{key}.{k}", v) for k, v in reversed(inner.items())]
            elif key in out:
                self.findings.add(
                    f"{what} names {key!r} twice", "", self.where(*path), "name it once"
                )
            else:
                out[key] = item
        return out


def _parse(source: Source) -> tuple[dict[str, Any], dict[Path, int] | None]:
    try:
        return loads(source.text)
    except RecursionError:
        raise fail(
            "arrays or tables are nested too deep", source.where(1), "this is no mechanism"
        ) from None
    except ValueError as error:  # TOMLDecodeError, and integers of too many digits
        text = str(error)
        match = _AT_LINE.search(text)
        line = len(source.lines)
        column = len(source.lines[-1]) + 1
        if match:
            line = int(match[1])
            column = int(match[2])
        where = source.where(line, column)
        allowed = "see the caret"
        if re.match(r",\s*\d", where.text[column - 1 :]):
            allowed = "decimals take a point: 1.5"
        elif "end of document" in text:
            allowed = "the file may be truncated"
        text = _AT_LINE.sub("", text).removesuffix(" (at end of document)")
        raise fail(f"this is not TOML: {text[:1].lower()}{text[1:]}", where, allowed) from None
