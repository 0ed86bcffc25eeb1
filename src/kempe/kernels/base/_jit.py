"""The one way to compile: one signature each, safe fast-math flags. Only builds and edited
checkouts come here.

What is said of a kernel (`declare`) is turned into Numba's types, and helpers are compiled into the
kernels that call them (`_link`). The builder of the library takes over at `compile_entry`; without
it kernels are compiled in this process, into memory.
"""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numba
from numba import types

from kempe.kernels.base._link import HelperCompiler
from kempe.kernels.base.declare import Array, Entry, Number

FLAGS = {"contract", "nsz", "arcp"}
"""Fast-math flags under which NaN and infinity survive and sums are not reassociated."""

_TYPES = {"f": types.float64, "i": types.int64, "b": types.boolean}
_lock = threading.Lock()


def type_of(taken: Array | Number) -> types.Type:
    """Numba's type of an argument; arrays that are only read may be read-only."""
    entry = _TYPES[taken.entry]
    if isinstance(taken, Number):
        return entry
    return types.Array(entry, len(taken.shape), "C", readonly=not taken.written)


def signature_of(entry: Entry) -> Any:
    """Numba's signature of an entry point."""
    result = types.int64 if entry.returns else types.void
    return result(*[type_of(taken) for taken in entry.takes])


@contextmanager
def garbage_stays() -> Iterator[None]:
    """Collect no garbage meanwhile: the compiler's many objects live on, and to walk them takes a
    tenth of its time.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def in_memory(entry: Entry) -> Callable:
    """The entry point, compiled for this process."""
    dispatcher = numba.njit(nogil=entry.nogil, fastmath=FLAGS, error_model="numpy")(entry.function)
    with _lock, garbage_stays():
        dispatcher.compile(signature_of(entry))
        dispatcher.disable_compile()
    return dispatcher


compile_entry: Callable[[Entry], Callable] = in_memory
"""What makes a kernel of a declaration."""


def kernel(*takes: Array | Number, returns: bool = True, nogil: bool = True) -> Callable:
    """Decorator: an entry point that takes exactly this and returns a whole number, or nothing.

    `nogil=False` is for kernels of a fraction of a microsecond: to hand the lock over and back
    costs 40 ns.
    """
    return lambda function: compile_entry(Entry(function, takes, returns, nogil))


_HELPER = {
    "nogil": True,
    "fastmath": FLAGS,
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": HelperCompiler,
}


def device(function: Callable) -> Callable:
    """Decorator: a helper that kernels call; compiled into each caller."""
    return numba.njit(forceinline=True, **_HELPER)(function)


def routine(function: Callable) -> Callable:
    """Decorator: a helper too large to be copied into callers; compiled once a kernel.

    `forceinline` is said aloud, for Numba hands a `device`'s wish to be copied down to all that it
    calls. Constants among its arguments are numbers like others: Numba would compile it again for
    each of them.
    """
    helper: Any = numba.njit(forceinline=False, **_HELPER)(function)
    template = helper.get_call_template
    helper.get_call_template = lambda args, kws: template([types.unliteral(x) for x in args], kws)
    return helper
