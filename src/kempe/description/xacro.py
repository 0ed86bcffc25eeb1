"""Expansion of xacro text to URDF text, on request, in a process with limits.

xacro is a program, not data.
"""

from __future__ import annotations

import importlib.util
import json
import re
from collections.abc import Iterable, Mapping
from html import unescape
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from kempe.description.formats import join_words
from kempe.description.limited import extract_last_lines, run_limited_code
from kempe.description.packages import Folders, can_search_folder, list_ros_folders
from kempe.description.source import SIZE_LIMIT, list_folders, make_error, shorten_text
from kempe.errors import (
    DescriptionError,
    InputError,
    MissingExtraError,
    UnknownNameError,
    Where,
    format_value,
)

SECONDS = 20
"""Seconds that an expansion may take, of waiting and so of processor time, too; large robots take
about two."""

MEMORY = 2 * 2**30
"""Bytes of memory that an expansion may use."""

XACRO_ADVICE = (
    "load it with xacro=True (it needs the extra kempe[xacro]), only if you trust it: xacro is a "
    "program"
)
"""What to do with a xacro file that was given in place of URDF."""

GIVEN = "xacro={name: value}"
"""How the arguments of a file are given, as messages say it."""

Arguments = Mapping[str, "str | float"]
"""Values of a file's ``<xacro:arg>`` elements by their names: texts, numbers, or True and False."""

_PACKAGE = re.compile(r"PackageNotFoundError\W+(?:Package not found: )?([\w.-]+)")
_NOT_GIVEN = re.compile(r"Undefined substitution argument\W+([\w.-]+)")
_MENTIONS = (
    r"""<!--.*?-->|<xacro:arg\s(?:[^>"']|"[^"]*"|'[^']*')*>"""
    r"""|\$\(\s*arg\s[^)]*\)|\barg\(\s*['"][^'"]*['"]\s*\)"""
)
"""Text that may name an argument, and comments, which do not."""
_USED = re.compile(r"""arg[\s('"]+([\w.-]+)""")
_ATTRIBUTE = re.compile(r"""\s(name|default)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_FEW = 12
"""Arguments of a file that are listed in messages."""

_WORKER = """
import os
import re
import xacrodoc
os.chdir(os.path.dirname(s["path"]))
xacrodoc.packages.update_package_cache(s["packages"])
opened = []
roots = [os.path.realpath(d) + os.sep for d in [*s["roots"], sys.prefix, sys.base_prefix]]
def guard(event, given):
    if event == "open" and isinstance(given[0], (str, bytes)):
        path = os.path.realpath(os.fsdecode(given[0]))
        if os.path.dirname(path) != s["beside"] and not any((path + os.sep).startswith(root) for root in roots):
            raise RuntimeError(f"{path} lies outside the folders of the robot")
        opened.append(path)
    elif event.startswith(("subprocess.", "socket.", "os.exec", "os.fork", "os.posix_spawn", "os.system", "ctypes.")):
        raise RuntimeError(f"{event} is no part of a robot")
sys.addaudithook(guard)
def mentions():
    found = {}
    for path in dict.fromkeys(opened):
        if os.path.isfile(path) and not path.endswith((".py", ".pyc")):
            with open(path, encoding="utf-8", errors="replace") as file:
                found.update(dict.fromkeys(re.findall(s["mentions"], file.read(), re.DOTALL)))
    return list(found)
try:
    document = xacrodoc.XacroDoc.from_file(s["path"], subargs=dict(s["arguments"]), resolve_packages=False)
finally:
    sys.stdout.buffer.write(json.dumps(mentions()).encode() + b"\\n")
sys.stdout.buffer.write(document.dom.toprettyxml(indent="  ").encode("utf-8"))
"""


def check_xacro_arguments(given: Any) -> dict[str, str] | None:
    """Return the option `xacro` as arguments by name; None where nothing is to be expanded.

    True means no arguments, False and None mean no expansion.

    Errors: `InputError` for names and values that xacro cannot have.
    """
    if given is None or isinstance(given, bool):
        return {} if given else None
    values: Any = given
    if not isinstance(values, Mapping):
        raise InputError(
            f"xacro is {format_value(given)}; it must be True, or a dict with values of the file's "
            "<xacro:arg> elements by their names"
        )
    return {_check_name(name): _format_argument(name, value) for name, value in values.items()}  # type: ignore[misc]


def _check_name(name: object) -> str:
    """Return the name of an argument.

    Errors: `InputError`.
    """
    if not isinstance(name, str):
        raise InputError(f"xacro has the key {format_value(name)}; names of arguments are texts")
    return name


def _format_argument(name: object, value: object) -> str:
    """Return the value of an argument as xacro reads it; booleans are written in small letters."""
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, (str, Real)):
        return str(value)
    raise InputError(
        f"xacro argument {name!r} is {format_value(value)}; it must be a text, a number, True or "
        "False"
    )


def expand_xacro(
    path: str | Path,
    *,
    arguments: Arguments | None = None,
    package_dirs: Iterable[str | Path] = (),
    seconds: float = SECONDS,
    strict: bool = True,
) -> str:
    """Return the URDF text of a xacro file, with `arguments` for its ``<xacro:arg>`` elements.

    Only for files that you trust: xacro is a program. It runs in a process with little environment,
    bounded in time, memory and output, which opens files of the package, of its neighbours, of
    `package_dirs` and of ROS only; there `Folders.packages` are what ``$(find package)`` finds.
    Errors: `MissingExtraError` without the extra [xacro], `UnknownNameError` for arguments that the
    file does not have where `strict`, `DescriptionError` with xacro's own message and the arguments of the file.
    """
    if importlib.util.find_spec("xacrodoc") is None:
        raise MissingExtraError("xacrodoc", "xacro")
    where = Where(str(path))
    path = Path(path).resolve()
    package_dirs = list_folders(package_dirs)
    values = check_xacro_arguments(arguments) or {}
    folders = Folders((path.parent, *package_dirs))
    named = Folders(package_dirs).roots
    settings = {
        "path": str(path),
        "arguments": values,
        "mentions": _MENTIONS,
        "packages": {name: str(folder) for name, folder in folders.packages.items()},
        "roots": [
            str(d)
            for d in (*folders.readable, *list_ros_folders())
            if d != path.parent or d in named or can_search_folder(d)
        ],
        "beside": str(path.parent),
    }
    ended = run_limited_code(_WORKER, settings, seconds=seconds, memory=MEMORY, output=SIZE_LIMIT)
    if ended.reason == "time":
        raise make_error(
            f"xacro did not finish in {seconds:g} s", where, "it may call itself without end"
        )
    if ended.reason == "output":
        raise make_error(
            f"xacro wrote more than {SIZE_LIMIT >> 20} MiB", where, "it may call itself without end"
        )
    if ended.reason == "memory":
        raise make_error(
            f"xacro needs more than {MEMORY >> 30} GiB of memory",
            where,
            "it may call itself without end",
        )
    if "RecursionError" in ended.said:
        raise make_error(
            "xacro calls itself without end (RecursionError)",
            where,
            "look for a macro that calls itself",
        )
    head, _, text = ended.output.partition(b"\n")
    defaults = _parse_declared_arguments(json.loads(head)) if head else {}
    unknown = [name for name in values if name not in defaults]
    if ended.reason:
        listed = _format_arguments(defaults, unknown)
        raise _make_xacro_error(
            extract_last_lines(ended.said), where, package_dirs, defaults, listed
        )
    if unknown and strict:
        raise UnknownNameError("xacro argument", unknown[0], defaults, str(where))
    return text.decode("utf-8", "replace")


def _parse_declared_arguments(mentions: Iterable[str]) -> dict[str, str | None]:
    """Return the arguments of a file with their defaults (None without default).

    `mentions` are the texts that name arguments.
    """
    defaults: dict[str, str | None] = {}
    for text in mentions:
        if text.startswith("<xacro:arg"):
            found = {key: unescape(a or b) for key, a, b in _ATTRIBUTE.findall(text)}
            name = found.get("name", "")
            if defaults.get(name) is None:
                defaults[name] = found.get("default")
        elif (used := _USED.search(text)) and not text.startswith("<!--"):
            defaults.setdefault(used[1])
    return {name: defaults[name] for name in defaults if name}


def _format_arguments(defaults: Mapping[str, str | None], unknown: list[str]) -> str:
    """Return the arguments of a file with plain defaults as text, and the given ones it lacks."""
    listed = [
        name if not default or "$" in default else f"{name} (default {shorten_text(default, 40)})"
        for name, default in defaults.items()
    ]
    shown = ", ".join([*listed[:_FEW], "..."] if len(listed) > _FEW else listed)
    return f"{shown or 'none'}{f'; not {join_words(map(repr, unknown))}' if unknown else ''}"


def _make_xacro_error(
    said: str,
    where: Where,
    package_dirs: tuple[str | Path, ...],
    defaults: Mapping[str, str | None],
    listed: str,
) -> DescriptionError:
    """Return the error with the message of xacro: the missing argument, or the missing package."""
    if needed := _NOT_GIVEN.search(said):
        late = defaults.get(needed[1]) is not None
        return make_error(
            f"xacro needs the argument {needed[1]!r}"
            + (", used before its <xacro:arg>" if late else ""),
            where,
            f"give it by {GIVEN}; arguments of this file: {listed}",
        )
    if missing := _PACKAGE.search(said):
        looked = ", ".join(repr(str(d)) for d in package_dirs)
        return make_error(
            f"xacro finds no package {missing[1]!r}" + (f" in {looked}" if looked else ""),
            where,
            "name by package_dirs a folder that holds one of this name, with or without a "
            "package.xml",
        )
    return make_error(
        f"xacro failed: {said}",
        where,
        "correct the file, or name its folders by package_dirs"
        + (f", or give its arguments by {GIVEN}: {listed}" if defaults else ""),
    )
