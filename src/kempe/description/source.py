"""Text of a description: decoding, places in the text, and collection of problems."""

from __future__ import annotations

import codecs
import gc
import math
import os
import re
import stat
from bisect import bisect_right
from collections.abc import Callable, Collection, Container, Generator, Iterable
from contextlib import contextmanager
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from kempe.description.formats import HEAD, find_other_kind, join_titles, list_readable_formats
from kempe.errors import (
    PROBLEM_LIMIT,
    DescriptionError,
    Fault,
    InputError,
    UnknownNameError,
    Where,
    format_value,
    hint,
)

SIZE_LIMIT = 32 * 2**20
"""Bytes of the largest description that is read: about five times a chain of 20 000 links."""

_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8", ""),
    (codecs.BOM_UTF32_LE, "", "UTF-32"),
    (codecs.BOM_UTF32_BE, "", "UTF-32"),
    (codecs.BOM_UTF16_LE, "utf-16-le", ""),
    (codecs.BOM_UTF16_BE, "utf-16-be", ""),
)

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://|(?:https?|ftp|file|package|s3|ssh):/")

_LINE_END = re.compile(r"\r\n|\n|\r")


MANY_BODIES = 1000
"""Bodies from which on it matters how long it takes to make one."""
MANY_PROBLEMS = 1000
"""Problems after which a reader gives up at once, so that a hostile file costs bounded time."""


_KINDS = (
    (stat.S_ISFIFO, "a FIFO, from which reading may never end"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISDIR, "a folder"),
)


def describe_special_file(path: str | Path) -> str:
    """Return what a path is if no plain file, such as "a folder"; '' otherwise."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return ""
    return next((what for is_, what in _KINDS if is_(mode)), "")


@contextmanager
def pause_garbage_collection(count: int = MANY_BODIES) -> Generator[None, None, None]:
    """Pause Python's garbage collector while `count` bodies are made.

    The bodies last, and each collection visits all objects that exist: that takes a third of the
    time. The collector's generations stay as they are, so that cycles that the caller drops are
    collected in their turn.
    """
    if count < MANY_BODIES or not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


class Source:
    """Text with the name of its origin, which locates lines and characters."""

    def __init__(self, name: str, text: str):
        self.name = name
        self.text = text

    @cached_property
    def _line_starts(self) -> list[int]:
        """Indices in the text at which the lines start."""
        return [0, *[m.end() for m in _LINE_END.finditer(self.text)]]

    @cached_property
    def lines(self) -> list[str]:
        """Lines of the text without their ends; ``\\n``, ``\\r\\n`` and ``\\r`` end a line."""
        return _LINE_END.split(self.text)

    def locate_line(self, line: int, column: int = 1) -> Where:
        """Return the place in the text at `line` and `column`, both counted from 1."""
        starts = self._line_starts
        text = ""
        if 0 < line <= len(starts):
            end = starts[line] if line < len(starts) else len(self.text)
            text = self.text[starts[line - 1] : end].rstrip("\r\n")
        return Where(self.name, line, column, text)

    def compute_offset(self, line: int, column: int) -> int:
        """Return the index into `text` of a line and column, both counted from 1."""
        return self._line_starts[line - 1] + column - 1

    def locate_offset(self, offset: int) -> Where:
        """Return the place of an index into `text`."""
        line = bisect_right(self._line_starts, offset)
        return self.locate_line(line, offset - self._line_starts[line - 1] + 1)


class Findings:
    """Problems and notes that a reader collects; problems end in an error, notes do not."""

    def __init__(self) -> None:
        self.problems: list[Fault] = []
        self._notes: list[tuple[int, str]] = []

    def add_problem(
        self, message: str, subject: str = "", where: Where | None = None, allowed: str = ""
    ) -> None:
        """Record a problem; raise an error at once after very many problems."""
        self.problems.append(Fault(message, subject, where, allowed))
        if len(self.problems) >= MANY_PROBLEMS:
            self.raise_problems()

    def add_note(self, message: str, subject: str = "", where: Where | None = None) -> None:
        """Record a note for the user that is no problem."""
        self._notes.append((where.line if where else 0, str(Fault(message, subject, where))))

    @property
    def notes(self) -> list[str]:
        """Notes in the order of the file."""
        return [text for _, text in sorted(self._notes, key=lambda n: n[0])]

    def suggest_name(self, name: str, allowed: Collection[str], but: str = "") -> str:
        """Return the end of a message about an unknown name: which name was probably meant.

        `but` is never suggested.

        Empty where it would not be shown, or cost too much: comparing with 5000 names takes some 50
        ms.
        """
        if (
            len(self.problems) >= PROBLEM_LIMIT
            or len(name) > 200
            or (self.problems and len(allowed) > 5000)
        ):
            return ""
        return hint(name, [n for n in allowed if n != but])

    @contextmanager
    def record_errors(
        self, subject: str = "", where: Where | None = None
    ) -> Generator[None, None, None]:
        """Record errors raised inside as problems of `subject` at `where`, and continue."""
        try:
            yield
        except DescriptionError as error:
            if len(self.problems) >= MANY_PROBLEMS:
                raise
            for p in error.problems:
                self.problems.append(
                    Fault(p.message, p.subject or subject, p.where or where, p.allowed)
                )
        except (InputError, UnknownNameError) as error:
            self.add_problem(str(error).removeprefix(f"{subject}: "), subject, where)

    def read_numbers(
        self, text: str, count: int, what: str, subject: str, where: Callable[[], Where]
    ) -> tuple[float, ...] | None:
        """Return the finite numbers in a text; None after recording a problem."""
        found = parse_numbers(text, count)
        if not isinstance(found, str):
            return found
        self.add_problem(
            f"{what} is {shorten_text(text)}: {found}",
            subject,
            where(),
            describe_allowed_numbers(count),
        )
        return None

    def read_bound(
        self, text: str, unlimited: float, what: str, subject: str, where: Callable[[], Where]
    ) -> float | None:
        """Return the bound in a text, infinite from `unlimited` on; None after recording a problem."""
        special = parse_special_number(text.strip())
        if special is not None and not math.isnan(special):
            return special
        found = self.read_numbers(text, 1, what, subject, where)
        if found is None:
            return None
        return found[0] if abs(found[0]) < unlimited else math.copysign(math.inf, found[0])

    def raise_problems(self) -> None:
        """Raise `DescriptionError` with the problems in the order of the file, if there are any."""
        if self.problems:
            raise DescriptionError(
                sorted(self.problems, key=lambda p: p.where.line if p.where else 0)
            )


def make_error(
    message: str, where: Where, allowed: str = "", subject: str = ""
) -> DescriptionError:
    """Return the error for a problem after which reading cannot continue."""
    return DescriptionError(Fault(message, subject, where, allowed))


def list_folders(given: Any) -> tuple[Path, ...]:
    """Return folders given as a list of paths or a single path.

    Errors: `InputError`.
    """
    entries: Any = given
    single = isinstance(given, (str, Path)) or not isinstance(given, Iterable)
    paths: tuple[Any, ...] = (entries,) if single else tuple(entries)
    if not all(isinstance(path, (str, Path)) for path in paths):
        raise InputError(f"package_dirs is {format_value(entries)}; it must be a list of folders")
    return tuple(expand_path(path) for path in paths)


def expand_path(path: str | Path) -> Path:
    """Return the path of a file, with a leading ``~`` replaced by the home folder.

    Errors: `InputError` for a URL.
    """
    given: object = path
    text: object = os.fspath(path) if isinstance(given, os.PathLike) else given
    if not isinstance(text, str):
        raise InputError(
            f"path is {format_value(given)}; it must be the path of a file, as text or a Path"
        )
    if "\0" in text:
        raise InputError(f"{format_value(text)} holds a zero byte, which no name of a file has")
    scheme = _SCHEME.match(text)
    if scheme:
        # a Path keeps one slash
        url = shorten_text(text if "://" in text else text.replace(":/", "://", 1), 200)
        advice = {
            "file": "give the path alone, without file://",
            "package": "give the path of the file",
        }
        said = advice.get(
            text.partition(":")[0].lower(), "Kempe reads files of this machine: download it first"
        )
        raise InputError(f"{url} is a URL; {said}")
    try:
        return Path(text).expanduser()
    except RuntimeError:  # no such user, or no home
        return Path(text)


def read_bounded_file(path: Path) -> bytes:
    """Return the bytes of a file, at most `SIZE_LIMIT` + 1 of them.

    Errors: `OSError`.
    """
    with open(path, "rb") as file:
        return file.read(SIZE_LIMIT + 1)


def shorten_text(text: object, limit: int = 60) -> str:
    """Return `text` in quotes, cut to `limit` characters."""
    text = str(text)
    return repr(text if len(text) <= limit else text[: limit - 3] + "...")


def choose_numbered_name(name: str, taken: Container[str]) -> str:
    """Return `name`, with a number appended where it is taken."""
    number = 1
    out = name
    while out in taken:
        number += 1
        out = f"{name}_{number}"
    return out


SLIP = 0.8
"""Likeness (of `difflib`) from which on an unknown name is taken for a slip of a known one."""


@lru_cache(maxsize=1024)
def find_intended_name(name: str, known: tuple[str, ...]) -> str | None:
    """Return the known name that an unknown one misspells; None where there is none.

    A name that holds a known one among its words is no misspelling.
    """
    # 'xzy': too short to be like 'xyz' otherwise
    swapped = [k for k in known if sorted(k) == sorted(name)]
    if swapped:
        return swapped[0]
    import difflib  # only here: most names are known

    mine = _split_words(name)
    for k in difflib.get_close_matches(name, known, n=3, cutoff=SLIP):
        own = _split_words(k)
        if len(own) == len(mine) or not any(
            mine[i : i + len(own)] == own for i in range(len(mine))
        ):
            return k
    return None


def _split_words(name: str) -> list[str]:
    """Return the words of a name, separated by underscores, dashes, points or blanks."""
    return [w for w in re.split(r"[_\-.\s]+", name) if w]


_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_PLAIN = re.compile(r"[-+.0-9eE \t\r\n]+")
"""Text in which `float` reads what `_NUMBER` matches, and nothing else."""
_BLANKS = re.compile(r"[ \t\r\n]+")
_SPECIAL = re.compile(r"[+-]?(inf|infinity|nan)", re.IGNORECASE)
LONG = 200
"""Characters of a text of numbers from which on it is not kept for the next one."""


def parse_numbers(text: str, count: int) -> tuple[float, ...] | str:
    """Return the finite numbers in a text, separated by blanks, or the problem as text.

    Any other number of them than `count` is a problem.
    """
    return _kept_numbers(text, count) if len(text) < LONG else _split_numbers(text, count)


def _split_numbers(text: str, count: int) -> tuple[float, ...] | str:
    """Return the finite numbers in a text, or the problem as text."""
    if _PLAIN.fullmatch(text):
        try:
            found = tuple(map(float, text.split()))
        except ValueError:
            found = ()
        if len(found) == count and math.isfinite(sum(found)):
            return found
    pieces = [p for p in _BLANKS.split(text) if p]
    for piece in pieces:
        if _NUMBER.fullmatch(piece):
            if math.isinf(float(piece)):
                return f"{shorten_text(piece)} is not finite"
        elif parse_special_number(piece) is not None:
            return f"{shorten_text(piece)} is not finite"
        elif re.fullmatch(r"[+-]?[0-9]+,[0-9]+", piece):
            return f"{piece!r} is not a number (decimals take a point: {piece.replace(',', '.')})"
        elif "," in piece:
            return f"{shorten_text(piece)} is not a number (no commas between numbers)"
        else:
            return f"{shorten_text(piece)} is not a number"
    if len(pieces) != count:
        return f"{len(pieces)} number{'s' if len(pieces) != 1 else ''}"
    return tuple(float(p) for p in pieces)


_kept_numbers = lru_cache(4096)(_split_numbers)
"""Many elements of a file have the same numbers."""


def describe_allowed_numbers(count: int) -> str:
    """Return the part of a message that says which numbers are allowed."""
    if count == 1:
        return "it must be a finite number"
    return f"it must be {count} finite numbers separated by blanks"


def parse_special_number(piece: str) -> float | None:
    """Return infinity or NaN where the text spells it, in any letter case; None for other texts."""
    match = _SPECIAL.fullmatch(piece)
    return float(match[0]) if match else None


def refuse_other_kinds(data: bytes | str, name: str) -> None:
    """Raise `DescriptionError` for a file that is no description, such as an archive or a web page.

    Errors: `DescriptionError` that says what the file is, and what to do.
    """
    if kind := find_other_kind(data):
        start = data[:HEAD] if isinstance(data, str) else data[:200].decode("ascii", "replace")
        line = "".join(c if c.isprintable() else "\ufffd" for c in _LINE_END.split(start)[0][:200])
        raise make_error(f"this is {kind.what}", Where(name, 1, 1, line), kind.advice)


def decode_text(data: bytes | str, name: str, declared: re.Pattern[bytes] | None = None) -> str:
    """Return the text of a file's bytes: UTF-8, UTF-16 with a byte order mark, or as declared.

    `declared` is a pattern that finds the declaration of another encoding.

    Errors: `DescriptionError` for empty, oversized and wrongly encoded data, with line and column.
    """
    if len(data) > SIZE_LIMIT:
        allowed = "a description is smaller than that"
        raise make_error(f"the file has more than {SIZE_LIMIT >> 20} MiB", Where(name), allowed)
    text = data if isinstance(data, str) else _decode_bytes(data, name, declared)
    text = text.removeprefix("\ufeff")
    if not text.strip():
        what = "empty" if not text else "nothing but blanks"
        raise make_error(
            f"the file is {what}",
            Where(name),
            f"it must hold a description ({join_titles(list_readable_formats())})",
        )
    return text


def _decode_bytes(data: bytes, name: str, declared: re.Pattern[bytes] | None) -> str:
    """Return bytes as text in the encoding of their byte order mark or declaration, else UTF-8."""
    first = Where(
        name, 1, 1, re.split(rb"[\r\n]", data[:200])[0].decode("ascii", "replace").replace("\0", "")
    )
    for mark, encoding, refused in _BYTE_ORDER_MARKS:
        if data.startswith(mark):
            if refused:
                raise make_error(f"the file is {refused}", first, "save it as UTF-8")
            _check_declared_encoding(data[len(mark) :], encoding, first, declared)
            return _apply_codec(
                data[len(mark) :], encoding, name, "the byte order mark at its start"
            )
    if b"\0" in data:
        if [byte == 0 for byte in data[:4]] in ([False, True] * 2, [True, False] * 2):
            raise make_error(
                "the file looks like UTF-16 without its byte order mark", first, "save it as UTF-8"
            )
        raise make_error(
            "the file is binary data and no text: it holds zero bytes",
            first,
            "load the robot description",
        )
    match = declared.match(data[:300]) if declared else None
    if match is None:
        return _apply_codec(data, "utf-8", name, "")
    return _apply_codec(
        data, _choose_codec(match[1].decode("ascii"), first), name, "its first line"
    )


_CODECS = {
    "utf-8": "utf-8",
    "utf8": "utf-8",
    "us-ascii": "ascii",
    "ascii": "ascii",
    "iso-8859-1": "latin-1",
    "latin-1": "latin-1",
    "latin1": "latin-1",
    "iso-8859-15": "iso-8859-15",
    "windows-1252": "cp1252",
}
_ADVICE = "save it as UTF-8 and declare that, or nothing"


def _check_declared_encoding(
    data: bytes, encoding: str, first: Where, declared: re.Pattern[bytes] | None
) -> None:
    """Raise `DescriptionError` if the declared encoding contradicts the byte order mark."""
    head = data[:600].decode(encoding, "replace").encode("utf-8", "replace")
    match = declared.match(head) if declared else None
    given = match[1].decode("ascii") if match else encoding
    if not encoding.replace("-", "").startswith(given.lower().replace("-", "")):
        actual = encoding.upper().removesuffix("-LE").removesuffix("-BE")
        said = (
            f"its first line declares the encoding {given!r}, but its byte order mark says {actual}"
        )
        raise make_error(said, first, "correct the declaration")


def _choose_codec(given: str, first: Where) -> str:
    """Return the codec of Python for a declared encoding.

    Errors: `DescriptionError`.
    """
    said = f"its first line declares the encoding {given!r}"
    if given.lower().startswith("utf-16"):
        raise make_error(
            f"{said}, but the bytes are not UTF-16 with a byte order mark", first, _ADVICE
        )
    if given.lower() not in _CODECS:
        raise make_error(f"{said}, which is not read", first, _ADVICE)
    return _CODECS[given.lower()]


def _apply_codec(data: bytes, encoding: str, name: str, claim: str) -> str:
    """Return bytes decoded by a codec.

    Errors: `DescriptionError` with line and column.
    """
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        before = data[: error.start].decode(encoding, "replace")
        lines = _LINE_END.split(before)
        rest = _LINE_END.split(data[error.start : error.start + 100].decode(encoding, "replace"))[0]
        where = Where(name, len(lines), len(lines[-1]) + 1, lines[-1] + rest)
        said = f" (as {claim} says)" if claim else ""
        if error.end >= len(data) and "16" in encoding:
            raise make_error(
                f"the file ends inside a character of {encoding[:6].upper()}{said}: it is "
                "truncated",
                where,
                "get the whole file",
            ) from None
        byte = data[error.start]
        advice = "save the file as UTF-8"
        if encoding in ("utf-8", "ascii") and byte >= 0xA0:
            advice += f" (in Latin-1 this byte would be {chr(byte)!r})"
        label = "UTF-8" if encoding == "utf-8" else encoding.upper()
        raise make_error(f"byte 0x{byte:02x} is not {label}{said}", where, advice) from None
