"""The models that come with Kempe: the lecture's systems, one joint of each type, robots from
published tables, and mechanisms with closed loops from the literature.

``kempe.load("puma560")`` loads one by its name. Each is a TOML file whose first comment line says
what it is.
"""

from __future__ import annotations

import functools
from pathlib import Path

from kempe.errors import UnknownNameError

FOLDER = Path(__file__).parent


@functools.cache
def names() -> tuple[str, ...]:
    """Names of the models, in the order of the alphabet."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def path(name: str) -> Path:
    """The file of a model, to read its text. Errors: `UnknownNameError` with the nearest names."""
    if name not in names():
        raise UnknownNameError("model", name, names(), "the library")
    return FOLDER / f"{name}.toml"


def describe(name: str) -> str:
    """What a model is: the first comment line of its file. Errors: `UnknownNameError`."""
    first, _, _ = path(name).read_text(encoding="utf-8").partition("\n")
    return first.removeprefix("#").strip()
