"""Any source -> Mechanism: finds out what a path or a text is, and calls its reader."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from kempe.calls import explained
from kempe.description.mechanism import Mechanism
from kempe.description.source import SIZE_LIMIT, collecting_later, expanded, fail, no_file, shorten
from kempe.description.toml.toml import read_toml
from kempe.description.urdf.urdf import read_urdf
from kempe.description.urdf.xacro import XACRO_ADVICE, expand_xacro
from kempe.errors import DescriptionError, Fault, InputError, UnknownNameError, UnsupportedError, Where
from kempe.library import names as library_models
from kempe.library import path as library_path

FORMATS = ("urdf", "toml")
"""Formats that are read."""

_BY_SUFFIX = {".urdf": "urdf", ".toml": "toml", ".sdf": "sdf", ".world": "sdf", ".mjcf": "mjcf"}
_ROOT_TAG = re.compile(r"<([A-Za-z_][\w.:-]*)")
_LATER = {"sdf": "SDF", "mujoco": "MJCF (MuJoCo)", "mjcf": "MJCF (MuJoCo)"}


class _How(NamedTuple):
    """How a description is read: the options of `read`, with the folders for meshes and the names of files beside."""

    format: str | None
    base: str | None
    root: str | None
    package_dirs: tuple[str | Path, ...]
    lenient_limits: bool
    beside: tuple[str, ...] = ()


class Check(NamedTuple):
    """What `check` found: `problems`, which keep a description from being used, and `notes`, which do not."""

    problems: tuple[Fault, ...]
    notes: tuple[str, ...]


@explained
def read(
    source: str | Path | bytes,
    *,
    format: str | None = None,
    base: str | None = None,
    root: str | None = None,
    package_dirs: Iterable[str | Path] = (),
    xacro: bool = False,
    lenient_limits: bool = False,
) -> Mechanism:
    """Mechanism from a file (its path), from text (URDF or TOML), or from a model of the library (its name).

    `format` is "urdf" or "toml", found out where None. ``base="free"``, `root` and `lenient_limits` are for URDF, see
    `read_urdf`. A path may begin with ``~``, the home folder. Meshes may lie in the file's folder and in
    `package_dirs`. ``xacro=True`` expands a xacro file first, which is a program and must be trusted. Errors:
    `DescriptionError` with file, line, what is wrong and what is allowed.
    """
    if format is not None and format not in FORMATS:
        raise InputError(f"format is {format!r}; it must be {' or '.join(map(repr, FORMATS))}")
    how = _How(format, base, root, tuple(expanded(d) for d in package_dirs), bool(lenient_limits))
    if isinstance(source, bytes) or (isinstance(source, str) and _is_text(source)):
        if xacro:
            raise InputError("xacro is expanded from a file, not from text; give its path")
        return _read_text(source, "<text>", how)
    if not isinstance(source, (str, Path)):
        raise InputError(f"source is a {type(source).__name__}; it must be a path, text or bytes")
    path = expanded(source)
    if isinstance(source, str) and not os.path.exists(path) and source in library_models():
        return _read_text(library_path(source).read_bytes(), f"{source}.toml", how._replace(format="toml"))
    return _read_file(path, how, xacro)


def check(
    source: str | Path | bytes,
    *,
    format: str | None = None,
    base: str | None = None,
    root: str | None = None,
    package_dirs: Iterable[str | Path] = (),
    xacro: bool = False,
    lenient_limits: bool = False,
) -> Check:
    """All problems and notes of a description, which is read and compiled; arguments as in `read`."""
    try:
        mechanism = read(
            source, format=format, base=base, root=root, package_dirs=package_dirs, xacro=xacro,
            lenient_limits=lenient_limits,
        )  # fmt: skip
        mechanism.build()
    except DescriptionError as error:
        return Check(error.problems, ())
    except (InputError, UnknownNameError, UnsupportedError) as error:
        where = Where("<text>" if isinstance(source, bytes) or _is_text(str(source)) else str(source))
        return Check((Fault(str(error), "", where),), ())
    return Check((), tuple(mechanism.notes))


def _is_text(source: str) -> bool:
    """Whether a string is a description itself rather than a path to one."""
    start = source.removeprefix("\ufeff").lstrip()
    return "\n" in source or not start or start.startswith("<") or re.match(r"format\s*=", start) is not None


def _read_file(path: Path, how: _How, xacro: bool) -> Mechanism:
    data = _bytes_of(path)
    if path.suffix == ".xacro" and not xacro:
        raise fail("this is a xacro file, a program that writes URDF", Where(str(path)), XACRO_ADVICE)
    if xacro:
        text = expand_xacro(path, package_dirs=how.package_dirs)
        how = how._replace(format="urdf", package_dirs=(path.parent, *how.package_dirs))
        return _read_text(text, f"{path} (expanded)", how)
    format = how.format or _BY_SUFFIX.get(path.suffix.lower())
    beside = tuple(n for n in _models_in(path.parent) if n.endswith(".urdf") and n != path.name)
    how = how._replace(format=format, package_dirs=(path.parent, *how.package_dirs), beside=beside)
    return _read_text(data, str(path), how)


def _bytes_of(path: Path) -> bytes:
    """Contents of a file, of bounded size. Errors: `DescriptionError` that names what lies near."""
    where = Where(str(path))
    if os.path.isdir(path):
        inside = _models_in(path)
        shown = f"give one of its files: {', '.join(inside[:8])}" if inside else "give the path of a file"
        raise fail("this is a folder", where, shown)
    if what := no_file(path):
        raise fail(f"this is {what}", where, "give the path of a plain file")
    try:
        with open(path, "rb") as file:
            return file.read(SIZE_LIMIT + 1)
    except FileNotFoundError:
        raise fail("there is no such file", where, _near(path)) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        where = Where(shorten(path, 200))
        raise fail(f"the file cannot be read: {reason}", where, "check its name and permissions") from None


def _models_in(folder: Path) -> list[str]:
    """Names of the files in a folder that may describe a robot; none where it cannot be listed."""
    try:
        return sorted(n for n in os.listdir(folder) if Path(n).suffix.lower() in (*_BY_SUFFIX, ".xacro"))
    except OSError:
        return []


def _near(path: Path) -> str:
    """What to try instead of a file that does not exist."""
    folder = path.parent
    if not os.path.isdir(folder):
        return f"there is no folder {str(folder)!r} either"
    names = [*(library_models() if folder == Path(".") and not path.suffix else ()), *_models_in(folder)]
    near = difflib.get_close_matches(path.name, names, n=4, cutoff=0.5)
    if near:
        return f"did you mean {' or '.join(map(repr, near))}?"
    shown = ", ".join(names[:8])
    return (
        f"there are: {shown}{', ...' if len(names) > 8 else ''}" if names else "there are no robot files in that folder"
    )


def _read_text(text: str | bytes, name: str, how: _How) -> Mechanism:
    format, found = how.format, _format_of(text, name)
    if found in _LATER or (found == "toml" and format in _LATER):
        kind = _LATER.get(found, "") or _LATER[str(format)]
        raise UnsupportedError(f"{name}: {kind} files are not read yet; Kempe reads URDF and TOML")
    format = "urdf" if found == "urdf" and format != "toml" else format or found
    if format == "toml":
        if how.base is not None or how.root is not None:
            raise InputError("base and root are for URDF; a TOML file names its ground itself")
        if how.lenient_limits:
            raise InputError("lenient_limits is for URDF; a TOML file without limits has none")
        with collecting_later(len(text) >> 8):
            return read_toml(text, name, package_dirs=how.package_dirs)
    with collecting_later(len(text) >> 8):
        return read_urdf(
            text, name, base=how.base, root=how.root, package_dirs=how.package_dirs, beside=how.beside,
            lenient_limits=how.lenient_limits,
        )  # fmt: skip


def _format_of(text: str | bytes, name: str) -> str:
    """What a text is, by its first element where it is XML; what cannot be decoded is left to the readers."""
    if isinstance(text, bytes):
        head = text[:4096]
        text = head.decode("utf-16" if head[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8", "replace")
    start = text.removeprefix("\ufeff").lstrip()
    if not start.startswith("<"):
        return "toml"
    bare = re.sub(r"<!--.*?-->|<\?.*?\?>", "", start[:65536], flags=re.DOTALL)
    tag = _ROOT_TAG.search(bare)
    return tag[1] if tag and tag[1] in _LATER else "urdf"
