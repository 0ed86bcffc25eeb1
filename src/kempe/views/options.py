"""Sentences of the library in words of the command line: options in place of keyword arguments."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from typing import Any

WORDS: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...] = (
    (r"hold=\{name: value\}", "--hold NAME=VALUE"),
    (r"\broot=(['\"])(.*?)\1", r"--root \2"),
    (r"\blenient_limits=True\b", "--lenient-limits"),
    (r"\bxacro=True\b", "--xacro"),
    (r"\btolerance=\(([\d.e+-]+), ([\d.e+-]+)\)", r"--tolerance \1,\2"),
    (r"\btolerance=([\d.e+-]+)", r"--tolerance \1"),
    (r"\bpackage_dirs\b", "--package-dir"),
    (r"\bthe option '?(\w+)'? is for\b", lambda found: f"--{found[1].replace('_', '-')} is for"),
    (r"\b(angles|deg)=True\b", r"\1 = true"),
    (r"\bcolumns=\(\.\.\.\)", "--columns A,B,..."),
    (r"kempe\.Budget\(time_limit=\.\.\.\)", "--time-limit"),
    (r"`ik_all`", "ik --all"),
    (r"`ik`", "ik"),
    (r"`start`", "--start"),
    (r"; what motions reach all the same says `classify`", ""),
    (r": system\.manoeuvre\(start, q\)", ""),
    (r"; drive or hold more, or give velocities \(system\.simulate\)", "; drive or hold more"),
    (r": see nearest\(\)", ""),
    (r"\bproject=True takes it", "--project takes it"),
    (r"; loops\.closed_form\(.*?\)\.describe\(\) tells", "; --modes tells"),
    (r"\baxis=\(x, y\)", "axis = [x, y]"),
    (r", such as system\.with_limits\(\{.*?\}\)", ", in the file"),
)
"""What the library says, as regular expressions, and what the command line says in its place."""

PLAIN = ("toml", "name", "file", "system", "written")
"""Keys of data under which there is no sentence."""

_ANY = re.compile("[=`(]|the option|root|lenient_limits|package_dirs")
_WORDS = tuple((re.compile(pattern), words) for pattern, words in WORDS)


def in_options(text: str) -> str:
    """A message of the library in words of the command line: `keyword=value` becomes `--keyword value`."""
    if not _ANY.search(text):
        return text
    for pattern, words in _WORDS:
        text = pattern.sub(words, text)
    return text


def data_in_options(data: Any) -> Any:
    """Data with its sentences as the command line says them; numbers, keys, and what is under `PLAIN` ones stay."""
    if isinstance(data, str):
        return in_options(data)
    given: Any = data
    if isinstance(data, dict):
        return {key: value if key in PLAIN else data_in_options(value) for key, value in given.items()}
    if isinstance(data, list) and not (given and isinstance(given[0], (int, float, type(None)))):
        return [data_in_options(value) for value in given]
    return given


def at_home(argument: str) -> str:
    """An argument whose file begins with ``~``, which a shell leaves alone after ``=`` and in quotes, expanded."""
    option, sign, file = argument.partition("=") if argument.startswith("--") else ("", "", argument)
    return option + sign + os.path.expanduser(file) if re.match(r"~[\w.-]*(/|$)", file) else argument
