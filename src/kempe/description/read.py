"""Reading, checking and writing of descriptions: file, text or model of the library.

The format is found out, and its reader or writer called.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from kempe.arguments import explain_errors
from kempe.description.formats import (
    DEFAULT,
    FORMATS,
    TOML,
    URDF,
    Format,
    decode_head,
    find_format_by_contents,
    find_format_by_ending,
    join_titles,
    join_words,
    list_readable_formats,
    list_writable_endings,
)
from kempe.description.mechanism import Mechanism
from kempe.description.source import (
    describe_special_file,
    expand_path,
    list_folders,
    make_error,
    pause_garbage_collection,
    read_bounded_file,
    shorten_text,
)
from kempe.errors import (
    DescriptionError,
    Fault,
    InputError,
    UnknownNameError,
    UnsupportedError,
    Where,
    format_value,
)
from kempe.library import find_model_file as library_path
from kempe.library import list_models as library_models

# ---- reading and checking


class _How(NamedTuple):
    """Options for reading a description: its format, and the given options of `read_mechanism`.

    `folders` are those for meshes; with a file, its own is the first of them, and also `home`;
    `arguments` are those of xacro, None where nothing is expanded.
    """

    format: Format | None
    options: dict[str, Any]
    folders: tuple[str | Path, ...]
    home: Path | None = None
    arguments: dict[str, str] | None = None


class Check(NamedTuple):
    """Result of a check: `problems`, which make a description unusable, and harmless `notes`."""

    problems: tuple[Fault, ...]
    notes: tuple[str, ...]


@explain_errors
def read_mechanism(
    source: str | Path | bytes,
    *,
    format: str | None = None,
    base: str | None = None,
    root: str | None = None,
    model: str | None = None,
    package_dirs: Iterable[str | Path] = (),
    xacro: bool | Mapping[str, str | float] = False,
    lenient_limits: bool = False,
    srdf: str | Path | None = None,
) -> Mechanism:
    """Return the mechanism of a file (path), of a text, or of a model of the library (name).

    `format` is a name in `kempe.description.formats.FORMATS`, such as "urdf", found out where None.
    ``base="free"`` and `lenient_limits` are for URDF and SDF, `root` is for URDF, see `read_urdf`,
    and `model` for SDF, see `read_sdf`. `srdf` is a file beside a URDF, with groups, postures and
    more, see `kempe.description.srdf`. A path may begin with ``~``, the home folder. Meshes, and
    files that MJCF includes, may lie in the file's folder and in `package_dirs`, in the packages
    there and the neighbours of these, and in packages of ROS.
    ``xacro=True`` expands a xacro file first, which is a program and must be trusted;
    ``xacro={"name": "ur5e"}`` also gives values of its ``<xacro:arg>`` elements. Errors:
    `DescriptionError` with file, line, what is wrong and what is allowed.
    """
    allowed = [name for name, f in FORMATS.items() if f.read]
    if format is not None and format not in allowed:
        raise InputError(f"format is {format!r}; it must be {join_words(map(repr, allowed))}")
    folders = list_folders(package_dirs)
    arguments = _check_xacro_arguments(xacro)
    options = {
        "base": base,
        "root": root,
        "model": model,
        "lenient_limits": lenient_limits or None,
        "package_dirs": folders or None,
        "srdf": srdf,
    }
    given = {name: value for name, value in options.items() if value is not None}
    how = _How(None if format is None else FORMATS[format], given, folders)
    if isinstance(source, bytes) or (isinstance(source, str) and _is_text(source)):
        if arguments is not None:
            raise InputError("xacro is expanded from a file, not from text; give its path")
        return _read_text(source, "<text>", how)
    if not isinstance(source, (str, Path)):
        raise InputError(f"source is {format_value(source)}; it must be a path, text or bytes")
    path = expand_path(source)
    if isinstance(source, str) and not os.path.exists(path) and source in library_models():
        return _read_text(
            library_path(source).read_bytes(), f"{source}.toml", how._replace(format=TOML)
        )
    return _read_file(path, how, arguments)


def check_description(
    source: str | Path | bytes,
    *,
    format: str | None = None,
    base: str | None = None,
    root: str | None = None,
    model: str | None = None,
    package_dirs: Iterable[str | Path] = (),
    xacro: bool | Mapping[str, str | float] = False,
    lenient_limits: bool = False,
    srdf: str | Path | None = None,
) -> Check:
    """Return all problems and notes of a description, which is read and compiled.

    Arguments are those of `read_mechanism`.
    """
    try:
        mechanism = read_mechanism(
            source,
            format=format,
            base=base,
            root=root,
            model=model,
            package_dirs=package_dirs,
            xacro=xacro,
            lenient_limits=lenient_limits,
            srdf=srdf,
        )
        mechanism.build()
    except DescriptionError as error:
        return Check(error.problems, ())
    except (InputError, UnknownNameError, UnsupportedError) as error:
        where = Where(
            "<text>" if isinstance(source, bytes) or _is_text(str(source)) else str(source)
        )
        return Check((Fault(_remove_place(str(error), where), "", where),), ())
    return Check((), tuple(mechanism.notes))


def _remove_place(message: str, where: Where) -> str:
    """Return a message without the path at its start, which the place of a `Fault` repeats."""
    for path in (
        where.file,
        os.path.expanduser(where.file),
        os.path.normpath(os.path.expanduser(where.file)),
    ):
        for place in (f"{path}: ", f"{path} (expanded): "):
            if message.startswith(place):
                return message.removeprefix(place)
    return message


def _is_text(source: str) -> bool:
    """Whether a string is a description itself rather than the path of a file."""
    start = source.removeprefix("\ufeff").lstrip()
    return "\n" in source or not start or find_format_by_contents(start) is not None


def _check_xacro_arguments(xacro: bool | Mapping[str, str | float]) -> dict[str, str] | None:
    """Return the arguments of a xacro file; None where nothing is to be expanded."""
    if xacro is False:
        return None
    from kempe.description.xacro import check_xacro_arguments

    return check_xacro_arguments(xacro)


def _read_file(path: Path, how: _How, arguments: dict[str, str] | None) -> Mechanism:
    """Return the mechanism of a file; a xacro file is expanded first."""
    data = _read_bytes(path)
    if path.suffix == ".xacro" and arguments is None:
        from kempe.description.xacro import XACRO_ADVICE

        raise make_error(
            "this is a xacro file, a program that writes URDF", Where(str(path)), XACRO_ADVICE
        )
    text = data
    name = str(path)
    if arguments is not None:
        from kempe.description.xacro import expand_xacro

        text = expand_xacro(path, arguments=arguments, package_dirs=how.folders)
        name = f"{path} (expanded)"
        how = how._replace(format=URDF)
    how = how._replace(
        arguments=arguments,
        format=how.format or find_format_by_ending(path.name),
        folders=(path.parent, *how.folders),
        home=path.parent,
    )
    return _read_text(text, name, how)


def _read_bytes(path: Path) -> bytes:
    """Return the contents of a file of bounded size.

    Errors: `DescriptionError` that names similar files.
    """
    where = Where(str(path))
    if os.path.isdir(path):
        inside = _list_model_files(path)
        shown = (
            f"give one of its files: {', '.join(inside[:8])}"
            if inside
            else "give the path of a file"
        )
        raise make_error("this is a folder", where, shown)
    if what := describe_special_file(path):
        raise make_error(f"this is {what}", where, "give the path of a plain file")
    try:
        return read_bounded_file(path)
    except FileNotFoundError:
        raise make_error("there is no such file", where, _suggest_files(path)) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        where = Where(shorten_text(path, 200))
        raise make_error(
            f"the file cannot be read: {reason}", where, "check its name and permissions"
        ) from None


def _list_model_files(folder: Path) -> list[str]:
    """Return the names of the files in a folder that may describe a robot; [] if it is unreadable."""
    try:
        return sorted(
            n for n in os.listdir(folder) if n.endswith(".xacro") or find_format_by_ending(n)
        )
    except OSError:
        return []


def _suggest_files(path: Path) -> str:
    """Return advice on which files to read instead of a file that does not exist."""
    folder = path.parent
    if not os.path.isdir(folder):
        return f"there is no folder {str(folder)!r} either"
    files = _list_model_files(folder)
    shipped = library_models() if folder == Path(".") else ()
    if path.stem in shipped:
        return f"{path.stem!r}, without an ending, is a shipped model"
    names = [*(shipped if not path.suffix else ()), *files]
    import difflib  # only here: most files exist

    by_stem: dict[str, list[str]] = {}  # endings are alike in files that have nothing in common
    for name in names:
        by_stem.setdefault(name.partition(".")[0].casefold(), []).append(name)
    stems = difflib.get_close_matches(path.name.partition(".")[0].casefold(), by_stem, n=4)
    near = [name for stem in stems for name in by_stem[stem]][:4]
    if near:
        return f"did you mean {' or '.join(map(repr, near))}?"
    shown = ", ".join(names[:8])
    return (
        f"there are: {shown}{', ...' if len(names) > 8 else ''}"
        if names
        else "there are no robot files in that folder"
    )


def _read_text(text: str | bytes, name: str, how: _How) -> Mechanism:
    """Return the mechanism of a text in one of the formats."""
    format = _choose_format(text, how.format)
    if format.read is None:
        raise UnsupportedError(
            f"{name}: {format.title} files are not read; Kempe reads {join_titles(list_readable_formats(), 'and')}"
        )
    for option in how.options:
        if option not in format.options:
            wanted = list_readable_formats(option)
            raise InputError(
                f"the option {option!r} is for {join_titles(wanted)}, and this is {format.title}"
                f"{_suggest_conversion(option, wanted, format)}"
            )
    options = dict(how.options)
    if "package_dirs" in format.options:
        options["package_dirs"] = how.folders
    if "srdf" in options:
        options["srdf"] = _read_srdf_source(options["srdf"], how)
    if "beside" in format.options and how.home:
        own = Path(name).name
        options["beside"] = tuple(
            n
            for n in _list_model_files(how.home)
            if n.lower().endswith(format.endings) and n != own
        )
    with pause_garbage_collection(len(text) >> 8):
        return format.read(text, name, **options)


def _suggest_conversion(option: str, wanted: Iterable[Format], given: Format) -> str:
    """Suggest to save a model in a format whose reader has the option; '' if that is impossible."""
    written = next((f for f in wanted if f.write is not None), None)
    if given.write is None or written is None:
        return ""
    return (
        f"; save it as {written.title} first, kempe.read(...).save('robot{written.endings[0]}'), "
        "and load that"
    )


def _read_srdf_source(source: str | Path | bytes, how: _How) -> Any:
    """Return the SRDF in a file or a text; a xacro file is expanded as the file of the robot is."""
    from kempe.description.srdf import read_srdf

    if isinstance(source, bytes) or (isinstance(source, str) and _is_text(source)):
        return read_srdf(source, "<srdf>")
    path = expand_path(source)
    data = _read_bytes(path)
    if path.suffix != ".xacro":
        return read_srdf(data, str(path))
    from kempe.description.xacro import XACRO_ADVICE, expand_xacro

    if how.arguments is None:
        raise make_error(
            "this is a xacro file, a program that writes SRDF", Where(str(path)), XACRO_ADVICE
        )
    text = expand_xacro(path, arguments=how.arguments, package_dirs=how.folders, strict=False)
    return read_srdf(text, f"{path} (expanded)")


def _choose_format(text: str | bytes, given: Format | None) -> Format:
    """Return the given format, or the format recognised from the contents.

    Errors: a format that the contents contradict, or that is not read.
    """
    found = find_format_by_contents(text if isinstance(text, str) else decode_head(text))
    if given and given.read and not (found and not found.read):
        return given
    return found or given or DEFAULT


# ---- writing


def write_mechanism(mechanism: Mechanism, path: str | Path) -> Path:
    """Write a mechanism in the format that the ending of `path` names, and return the path.

    Errors: `InputError` for another ending, `DescriptionError` listing what the format cannot say;
    nothing is written then.
    """
    path = expand_path(path)
    format = find_format_by_ending(path.name)
    if format is None or format.write is None:
        raise InputError(
            f"{path}: the ending decides on the format; it must be {list_writable_endings()}"
        )
    if what := describe_special_file(path):
        raise InputError(f"{path}: this is {what}; name a plain file")
    text = format.write(mechanism)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: it cannot be written: {error.strerror or error}") from None
    return path
