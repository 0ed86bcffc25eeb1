"""Models that come with Kempe.

They are joints of each type, published robots, mechanisms with loops, and systems of the lecture.

``kempe.load("puma560")`` loads one by its name. Each is a TOML file whose first comment line says
what it is.
"""

from __future__ import annotations

import functools
from pathlib import Path

from kempe.errors import UnknownNameError

FOLDER = Path(__file__).parent


@functools.cache
def list_models() -> tuple[str, ...]:
    """List the names of the models in alphabetical order."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def find_model_file(name: str) -> Path:
    """Return the path of a model's file. Errors: `UnknownNameError` with similar names."""
    if name not in list_models():
        raise UnknownNameError("model", name, list_models(), "the library")
    return FOLDER / f"{name}.toml"


def describe_model(name: str) -> str:
    """Return the description of a model: the first comment line of its file. Errors:
    `UnknownNameError`.
    """
    first, _, _ = find_model_file(name).read_text(encoding="utf-8").partition("\n")
    return first.removeprefix("#").strip()
