"""The models that come with Kempe, each built once: for rows that depend on what a model is."""

from __future__ import annotations

import functools

import kempe
from kempe import library


@functools.cache
def shipped() -> dict[str, kempe.System]:
    """All of them by name, in the order of the alphabet."""
    return {name: kempe.load(name) for name in library.list_models()}


def with_loops() -> list[str]:
    """Names of those with closed loops."""
    return [name for name, system in shipped().items() if system.structure.closures]
