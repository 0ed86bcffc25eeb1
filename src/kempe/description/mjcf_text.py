"""MJCF text with its includes resolved, compiled by MuJoCo in a process with limits.

MuJoCo opens no file itself: what a text includes is read here, from the folders of the model only.
"""

from __future__ import annotations

import base64
import importlib.util
import inspect
import json
import os
import re
from bisect import bisect_right
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from kempe.arrays import is_number
from kempe.description import mjcf_worker
from kempe.description.formats import describe_root_fault
from kempe.description.limited import extract_last_lines, run_limited_code
from kempe.description.packages import Folders
from kempe.description.source import (
    SIZE_LIMIT,
    Findings,
    Source,
    list_folders,
    make_error,
    read_bounded_file,
    shorten_text,
)
from kempe.description.xml import make_xml_source, parse_xml
from kempe.errors import DescriptionError, MissingExtraError, UnsupportedError, Where

SECONDS = 30
"""Seconds that MuJoCo's compiler may take; large models take about three."""

MEMORY = 4 * 2**30
"""Bytes of memory that it may use."""

FILE_LIMIT = 1000
"""Files that one model may include."""

REFERENCE = "correct the file: MuJoCo's XML reference says what is allowed"

KNOWN = (
    "MuJoCo's XML reference lists those that it knows; the file may be for another version than "
    "MuJoCo {installed}, which is installed"
)
"""What is allowed for names that a version of MuJoCo knows and another does not."""

_BLANKED = re.compile(r"<!--.*?(?:-->|\Z)|<\?.*?\?>", re.DOTALL)
_INCLUDE = re.compile(r"<include\b([^<>]*?)(?:/>|>\s*</include\s*>)", re.IGNORECASE)
_WITH_FILE = re.compile(r"<(model|flexcomp)\b[^<>]*>")
_FILE = re.compile(r"""\bfile\s*=\s*(["'])(.*?)\1""", re.DOTALL)
_OPENING = re.compile(r"<([A-Za-z_][\w.:-]*)[^<>]*>")
_FOLDER = re.compile(r"""<compiler\b[^<>]*?\b(?:meshdir|assetdir)\s*=\s*(["'])(.*?)\1""")

_NAN = re.compile(r"""["'\s][-+]?nan["'\s]""", re.IGNORECASE)
_VALUE = re.compile(r"""\s(\w+)\s*=\s*(["'])([-+\w.\s]*)\2""")

# ---- the text


class _Piece(NamedTuple):
    """Consecutive lines of a file; `line` is the number of the first line."""

    source: Source
    line: int
    text: str


class Merged:
    """Text of a model with the texts of all files that it includes, one below the other.

    MuJoCo's messages name lines only, so every line of every file has a number of its own here.
    `files` are other files that the text needs while it is parsed, by name.
    """

    def __init__(self, data: bytes | str, source: str, package_dirs: Iterable[str | Path] = ()):
        self.main = make_xml_source(data, source)
        self.sources = [self.main]
        self.files: dict[str, bytes] = {}
        self.text = ""
        self._given = [folder.resolve() for folder in list_folders(package_dirs)]
        self._readable = Folders(self._given)
        self._home = self._given[0] if self._given else None
        self._starts: list[int] = []
        self._pieces: list[_Piece] = []
        self._folders: list[Path | None] = []
        self._lines = 0
        self._size = len(self.main.text)
        self._names: dict[Path, str] = {}
        _check_is_mjcf(self.main)
        self._models = [("", self.main, self._home)]
        while self._models:
            self._add_model(*self._models.pop(0))

    def locate_line(self, line: int) -> Where:
        """Return the place of a line of the merged text in its original file."""
        if line < 1:
            return Where(self.main.name)
        k = self._find_piece(line)
        piece = self._pieces[k]
        return piece.source.locate_line(piece.line + line - self._starts[k])

    def find_folder(self, line: int) -> str:
        """Return the path from the main model's folder to the folder of a line's model."""
        there = self._folders[self._find_piece(line)] if self._pieces else None
        return "" if there == self._home or not there else os.path.relpath(there, self._home)

    def _find_piece(self, line: int) -> int:
        """Return the index of the piece of text that holds a line."""
        return max(bisect_right(self._starts, line) - 1, 0)

    def _add_model(self, name: str, source: Source, folder: Path | None) -> None:
        """Append the text of a model with all files that it includes."""
        text = _check_text(source)
        pieces = self._split_pieces(source, text, (0, len(text)), [folder], {source.name})
        before = self._lines
        for piece in pieces:
            self._starts.append(self._lines + 1)
            self._pieces.append(piece)
            self._folders.append(folder)
            self._lines += piece.text.count("\n") + 1
        whole = "\n" * before + "\n".join(self._rename_files(piece, folder) for piece in pieces)
        if name:
            self.files[name] = whole.encode()
        else:
            self.text = whole

    def _split_pieces(
        self,
        source: Source,
        text: str,
        part: tuple[int, int],
        folders: list[Path | None],
        seen: set[str],
    ) -> list[_Piece]:
        """Return a part of a text in pieces, with included files in place of their <include>."""
        pieces: list[_Piece] = []
        start, stop = part
        for match in _INCLUDE.finditer(text, start, stop):
            named = _FILE.search(match[1])
            if named is None:
                continue
            where = source.locate_offset(match.start())
            path = self._find_file("include", named[2], folders, where)
            if str(path) in seen:
                raise make_error(
                    f"the file {named[2]!r} is included twice", where, "include each file once"
                )
            seen.add(str(path))
            inner = self._read_source(path, named[2], source, where)
            inner_text = _check_text(inner)
            pieces.append(_make_piece(source, text, start, match.start()))
            pieces += self._split_pieces(
                inner,
                inner_text,
                _find_children(inner, inner_text),
                [folders[0], path.parent],
                seen,
            )
            start = match.end()
        return [*pieces, _make_piece(source, text, start, stop)]

    def _rename_files(self, piece: _Piece, folder: Path | None) -> str:
        """Return the text of a piece in which files that MuJoCo reads have the names of `files`."""

        def replace_name(match: re.Match[str]) -> str:
            """Return an element with its file name replaced by the name in `files`."""
            tag = match[0]
            file = _FILE.search(tag)
            if file is None:
                return tag
            where = piece.source.locate_line(piece.line + piece.text.count("\n", 0, match.start()))
            mesh = _FOLDER.search("".join(p.text for p in self._pieces))
            beside = folder / mesh[2] if folder and mesh else folder
            folders = [folder] if match[1] == "model" else [beside, folder]
            path = self._find_file(match[1], file[2], folders, where)
            if path not in self._names:
                self._names[path] = f"file{len(self._names)}{path.suffix}"
                if match[1] == "model":
                    inner = self._read_source(path, file[2], piece.source, where)
                    self._models.append((self._names[path], inner, path.parent))
                else:
                    self.files[self._names[path]] = self._read_bytes(path, where)
            return tag[: file.start(2)] + self._names[path] + tag[file.end(2) :]

        return _WITH_FILE.sub(replace_name, piece.text)

    # ---- files

    def _find_file(self, tag: str, name: str, folders: list[Path | None], where: Where) -> Path:
        """Return the file that an element names, in the folders of the model.

        Errors: `DescriptionError`.
        """
        places = (folder / name for folder in (*folders, *self._given) if folder is not None)
        found, outside = self._readable.find_first_file(places)
        if found is not None:
            return found
        if outside is not None:
            raise make_error(
                f"<{tag}> names {shorten_text(name)}, which lies outside the folders of the model",
                where,
                "name its folder by package_dirs, if you trust it",
            )
        raise make_error(
            f"<{tag}> names {shorten_text(name)}, and there is no such file",
            where,
            "it must lie in the folder of the model, or in one that package_dirs names",
        )

    def _read_source(self, path: Path, name: str, of: Source, where: Where) -> Source:
        """Return the text of a file, under the name that the user would give it."""
        called = os.path.normpath(os.path.join(os.path.dirname(of.name), name))
        if os.path.realpath(called) != str(path):
            called = str(path)
        made = make_xml_source(self._read_bytes(path, where), called)
        self.sources.append(made)
        if len(self.sources) > FILE_LIMIT:
            raise make_error(
                f"more than {FILE_LIMIT} files are included", where, "this is no robot"
            )
        return made

    def _read_bytes(self, path: Path, where: Where) -> bytes:
        """Return the bytes of a file.

        Errors: `DescriptionError`.
        """
        try:
            data = read_bounded_file(path)
        except OSError as error:
            raise make_error(
                f"{shorten_text(path, 200)} cannot be read: {error.strerror or error}",
                where,
                "check its permissions",
            ) from None
        self._size += len(data)
        if self._size > SIZE_LIMIT:
            raise make_error(
                f"the files of the model have more than {SIZE_LIMIT >> 20} MiB",
                where,
                "a description is smaller than that",
            )
        return data


def blank_comments(text: str) -> str:
    """Return the text with blanks in place of comments and declarations; all positions stay."""
    return _BLANKED.sub(lambda m: re.sub(r"[^\r\n]", " ", m[0]), text)


def _check_is_mjcf(source: Source) -> None:
    """Raise `DescriptionError` if the outermost element is not that of MJCF."""
    opening = _OPENING.search(blank_comments(source.text))
    if opening is None:
        said = (
            "there is no element in it" if "<" in source.text else "the file holds no XML element"
        )
        raise make_error(said, source.locate_line(1), "MJCF starts with <mujoco>")
    tag = opening[1]
    if tag == "mujoco":
        return
    where = source.locate_offset(opening.start())
    if tag == "mujocoinclude":
        raise make_error(
            "this is a part of models, <mujocoinclude>", where, "load the model that includes it"
        )
    raise make_error(describe_root_fault(tag), where, "MJCF starts with <mujoco>")


def _check_text(source: Source) -> str:
    """Return the text of a source without comments.

    Errors: `DescriptionError` for a DTD, and for entries that are no numbers.
    """
    text = blank_comments(source.text)
    if (at := text.find("<!DOCTYPE")) >= 0:
        raise make_error(
            "the file has a DTD (<!DOCTYPE ...>)",
            source.locate_offset(at),
            "remove it: a DTD can pull in other files or grow without bound, and is never read",
        )
    _refuse_nan(source, text)
    return text


def _refuse_nan(source: Source, text: str) -> None:
    """Raise `DescriptionError` if a list of numbers has an entry that is none; MuJoCo only warns."""
    for match in _VALUE.finditer(text) if _NAN.search(text) else ():
        words = match[3].split()
        if len(words) > 1 or match[1] in ("ref", "coef", "mass"):
            bad = next((w for w in words if w.lower().strip("+-") == "nan"), None)
            if bad and all(map(is_number, words)):
                raise make_error(
                    f"{match[1]} holds {bad!r}",
                    source.locate_offset(match.start(3)),
                    "it must be finite numbers",
                )


def _make_piece(source: Source, text: str, start: int, stop: int) -> _Piece:
    """Return the piece of a text from `start` to `stop`, with its source and first line."""
    line = source.locate_offset(start).line
    return _Piece(source, line, text[start:stop].replace("\r\n", "\n").replace("\r", "\n"))


def _find_children(source: Source, text: str) -> tuple[int, int]:
    """Return where the children of the outermost element of a file begin and end."""
    opening = _OPENING.search(text)
    if opening and not opening[0].endswith("/>"):
        stop = text.rfind(f"</{opening[1]}")
        if stop > opening.end():
            return opening.end(), stop
    parse_xml(source.text, source.name, Findings())
    raise make_error(
        "this file is included, and there is nothing in it",
        source.locate_line(1),
        "an include has parts",
    )


# ---- the compiler


def compile_mjcf(merged: Merged) -> dict[str, Any]:
    """Return the tables of `kempe.description.mjcf_worker` for a text.

    Errors: `MissingExtraError` without the extra [mjcf], `DescriptionError` with what MuJoCo says.
    """
    if importlib.util.find_spec("mujoco") is None:
        raise MissingExtraError("mujoco", "mjcf")
    files = {name: base64.b64encode(data).decode() for name, data in merged.files.items()}
    code = (
        f"space = {{'__name__': 'worker'}}\n"
        f"exec(compile({inspect.getsource(mjcf_worker)!r}, 'worker', 'exec'), space)\n"
        "space['write_compiled_model'](s)\n"
    )
    ended = run_limited_code(
        code,
        {"text": merged.text, "files": files},
        seconds=SECONDS,
        memory=MEMORY,
        output=2 * SIZE_LIMIT,
    )
    if ended.reason:
        raise _make_stop_error(ended.reason, ended.code, ended.said, merged)
    answer: dict[str, Any] = json.loads(ended.output)
    if "missing" in answer:
        raise UnsupportedError(f"{answer['missing']}; a version of at least 3.6 is needed")
    if "error" in answer:
        raise _make_compiler_error(answer["error"], merged)
    return answer


def _make_stop_error(reason: str, code: int | None, said: str, merged: Merged) -> DescriptionError:
    """Return the error for a compiler process that a limit stopped."""
    limits = {
        "time": f"MuJoCo's compiler did not finish in {SECONDS} s",
        "memory": f"MuJoCo's compiler needs more than {MEMORY >> 30} GiB of memory",
        "output": f"the compiled model has more than {2 * SIZE_LIMIT >> 20} MiB",
    }
    crashed = f"MuJoCo's compiler crashed (signal {-code})" if code is not None and code < 0 else ""
    message = (
        limits.get(reason) or crashed or f"MuJoCo's compiler failed: {extract_last_lines(said)}"
    )
    return make_error(message, merged.locate_line(0), "a smaller model must be given")


_MESSAGES: tuple[tuple[str, str, str], ...] = (
    (
        r"Schema violation: unrecognized attribute: '(.*)'",
        "<{tag}> has no attribute {0!r}",
        KNOWN,
    ),
    (
        r"Schema violation: unrecognized element",
        "<{tag}> is no element that MuJoCo reads there",
        KNOWN,
    ),
    (
        r"Schema violation: (.*)",
        "<{tag}>: {0}",
        REFERENCE,
    ),
    (
        r"invalid keyword: '(.*)'",
        "{0!r} is no keyword that <{tag}> takes",
        KNOWN,
    ),
    (
        r"(?:problem reading|bad format in|number is too large in) attribute '(.*)'",
        "{0} of <{tag}> is not as it must be",
        "it must be finite numbers, separated by blanks",
    ),
    (
        r"attribute '(.*)' does not have enough data",
        "{0} of <{tag}> has too few numbers",
        REFERENCE,
    ),
    (r"attribute '(.*)' has too much data", "{0} of <{tag}> has too many numbers", REFERENCE),
    (
        r"repeated name '(.*)' in (\w+)",
        "there is another {1} of the name {0!r}",
        "names must be unique",
    ),
    (r"unknown element '(.*)' in (.*)", "{1}: there is nothing of the name {0!r}", REFERENCE),
    (
        r"keyframe '.*': invalid (\w+) size, expected (\d+), got (\d+)",
        "its {0} has {2} numbers",
        "it must have {1}",
    ),
    (r"size (\d) must be positive in geom", "its size is not positive", "sizes are above zero"),
    (
        r"mass and inertia of moving bodies must be larger than mjMINVAL",
        "its mass or inertia is too small",
        "it must be above 1e-15",
    ),
    (r"axis too small.*", "its axis is zero", "an axis has a direction"),
    (
        r"more than 6 dofs in body '(.*)'",
        "body {0!r} has more than 6 degrees of freedom",
        "remove some",
    ),
)
"""What MuJoCo says, in other words: pattern, message and what is allowed."""

_TAG = re.compile(r"^Element '(.*)', line (\d+)", re.MULTILINE)
_NAME = re.compile(r"^Element name '(.*)', id -?\d+(?:, line (\d+))?", re.MULTILINE)
_LINE = re.compile(r"Line number=(\d+)")


def _make_compiler_error(said: str, merged: Merged) -> DescriptionError:
    """Return the error for a message of MuJoCo's compiler."""
    if "XML parse error" in said:
        for source in merged.sources:
            parse_xml(source.text, source.name, Findings())
    tag = _TAG.search(said)
    name = _NAME.search(said)
    line = _LINE.search(said)
    number = int(tag[2]) if tag else int(name[2] or 0) if name else int(line[1]) if line else 0
    subject = repr(name[1]) if name and name[1] else ""
    if not number and subject and name:
        called = re.search(rf"""\bname\s*=\s*(["\']){re.escape(name[1])}\1""", merged.text)
        number = merged.text.count("\n", 0, called.start()) + 1 if called else 0
    where = merged.locate_line(number)
    first = re.sub(r"^(XML Error|Error): (Error: )?", "", said.strip().splitlines()[0])
    for pattern, message, allowed in _MESSAGES:
        if found := re.fullmatch(pattern, first):
            words = found.groups()
            text = message.format(*words, tag=tag[1] if tag else "")
            allowed = allowed.format(*words, installed=version("mujoco"))
            return make_error(text, where, allowed, subject)
    return make_error(f"MuJoCo's compiler says: {first}", where, REFERENCE, subject)
