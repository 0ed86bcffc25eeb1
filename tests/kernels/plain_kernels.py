"""Kernel modules as plain Python, without the compiler, and with memory that is checked.

The source of a kernel module is run with stand-ins for the decorators that compile, for pointers,
and for the few operations on vectors that the modules tested here use. So helpers that no caller
outside of kernels reaches can be tested one by one, where Numba is not installed, too; an index out
of bounds is an IndexError.
"""

from __future__ import annotations

import builtins
import importlib
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

import kempe

KERNELS = Path(kempe.__file__).parent / "kernels"
WITHOUT_COMPILER = "_layout"
"""End of the names of modules that need no compiler, and are imported as they are."""


class Pointer:
    """A pointer into an array: index 0 is entry `at` of it; reading and writing outside of the
    array is an error.
    """

    def __init__(self, array: np.ndarray, at: int = 0):
        self.array = array
        self.at = at

    def place(self, i: int) -> int:
        """The place of entry i in the array. Errors: `IndexError`."""
        place = self.at + int(i)
        if not 0 <= place < len(self.array):
            raise IndexError(f"entry {place} of {len(self.array)}")
        return place

    def __getitem__(self, i: int) -> Any:
        return self.array[self.place(i)]

    def __setitem__(self, i: int, value: Any) -> None:
        self.array[self.place(i)] = value


def pointer(values: Any, dtype: type = float) -> Pointer:
    """A pointer to a copy of values."""
    return Pointer(np.array(values, dtype=dtype))


def room(n: int) -> Pointer:
    """A pointer to n numbers that are not set."""
    return Pointer(np.full(n, np.nan))


def _as_it_is(function: Any) -> Any:
    return function


def _copy(target: Pointer, source: Pointer, start: int, count: int) -> None:
    for k in range(count):
        target[k] = source[start + k]


class StandIns(SimpleNamespace):
    """What stands for names of a module; others may be imported, and fail where they are called."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)

        def missing(*_: Any) -> Any:
            raise NotImplementedError(f"{name} has no stand-in")

        return missing


STAND_INS: dict[str, Any] = {
    "_jit": SimpleNamespace(device=_as_it_is, routine=_as_it_is, kernel=lambda *_, **__: _as_it_is),
    "scratch": SimpleNamespace(
        advance_pointer=lambda p, n: Pointer(p.array, p.at + int(n)),
        copy_numbers=_copy,
        align_pointer=_as_it_is,
    ),
    "vectors": StandIns(
        LANES=4,
        pack_four=lambda *x: np.array(x),
        load4=lambda p, k: np.array([p[k + i] for i in range(4)]),
        extract_entry=lambda v, i: v[i],
        last_of=lambda v: v[3],
        is_negative=lambda x: np.signbit(x),
        select_where=lambda c, a, b: a if c else b,
        copy_sign=lambda a, b: np.copysign(a, b),
    ),
    "goals": StandIns(),
}
"""What stands for modules that need the compiler, by name."""
_made: dict[str, Any] = {}


def plain(name: str) -> Any:
    """The kernel module of a name (modules of kernels have unique names), run as Python."""
    if name in STAND_INS:
        return STAND_INS[name]
    if name not in _made:
        (path,) = KERNELS.rglob(f"{name}.py")
        module = ModuleType(f"plain_{name}")
        module.__dict__["__builtins__"] = {**vars(builtins), "__import__": _imported}
        _made[name] = module
        sys.modules[module.__name__] = module  # where dataclasses look for their module
        SourceFileLoader(module.__name__, str(path)).exec_module(module)
    return _made[name]


def _imported(
    name: str, scope: Any = None, own: Any = None, wanted: tuple[str, ...] = (), level: int = 0
) -> Any:
    """What `import` gives in such a module: other kernels as they are here, all else as it is."""
    if not name.startswith("kempe.kernels"):
        return builtins.__import__(name, scope, own, wanted, level)
    last = name.rpartition(".")[2]
    if (KERNELS / last).is_dir():  # from a folder import modules
        return SimpleNamespace(**{module: _module(f"{name}.{module}") for module in wanted})
    return _module(name)


def _module(name: str) -> Any:
    last = name.rpartition(".")[2]
    return importlib.import_module(name) if last.endswith(WITHOUT_COMPILER) else plain(last)
