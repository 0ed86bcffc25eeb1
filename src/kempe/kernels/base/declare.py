"""Declarations of entry points: the types and shapes of their arguments. The compiler and the
builder of the C layer read them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Length = int | str
"""Length of an axis: a number; a letter, the same wherever the letter stands; "1|N", one or that
many; "n+3", three more; "_", any."""


@dataclass(frozen=True)
class Array:
    """A C-contiguous array of float64 ("f") or int64 ("i") entries."""

    entry: str
    shape: tuple[Length, ...]
    written: bool = False


@dataclass(frozen=True)
class Number:
    """A number by value: "f" float64, "i" int64, "b" a truth value."""

    entry: str


FLOAT = Number("f")
INT = Number("i")
FLAG = Number("b")


def F(*shape: Length) -> Array:
    """Declare an array of float64 that the kernel reads."""
    return Array("f", shape)


def I(*shape: Length) -> Array:  # noqa: E743
    """Declare an array of int64 that the kernel reads."""
    return Array("i", shape)


def OUT(*shape: Length) -> Array:
    """Declare an array of float64 that the kernel writes."""
    return Array("f", shape, written=True)


def OUTI(*shape: Length) -> Array:
    """Declare an array of int64 that the kernel writes."""
    return Array("i", shape, written=True)


@dataclass(frozen=True)
class Entry:
    """A declared entry point: its function, its arguments, whether it returns a whole number, and
    whether other threads may run meanwhile.
    """

    function: Callable
    takes: tuple[Array | Number, ...]
    returns: bool
    nogil: bool

    @property
    def name(self) -> str:
        """The name in the library, "module__function", unique among all kernels."""
        return f"{self.function.__module__.rpartition('.')[2]}__{self.function.__name__}"
