"""The models that come with Kempe: the lecture's systems, one joint of each type, robots from published tables, and
mechanisms with closed loops from the literature.

``kempe.load("puma560")`` loads one by its name. Each is a TOML file whose first comment line says what it is.
"""

from __future__ import annotations

from importlib import resources
from importlib.resources.abc import Traversable

from kempe.errors import UnknownNameError


def names() -> tuple[str, ...]:
    """Names of the models, in the order of the alphabet."""
    files = (f.name for f in resources.files(__name__).iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in files if name.endswith(".toml")))


def path(name: str) -> Traversable:
    """The file of a model, to read its text. Errors: `UnknownNameError` with the nearest names."""
    if name not in names():
        raise UnknownNameError("model", name, names(), "the library")
    return resources.files(__name__) / f"{name}.toml"


def describe(name: str) -> str:
    """What a model is: the first comment line of its file. Errors: `UnknownNameError`."""
    first, _, _ = path(name).read_text(encoding="utf-8").partition("\n")
    return first.removeprefix("#").strip()
