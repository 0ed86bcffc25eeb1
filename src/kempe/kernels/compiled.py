"""The entry points of the kernels, as the library that was built with the package has them, or
compiled here.

``from kempe.kernels.compiled import table_sweep`` gives what `forward/table_sweep.py` declares with
`@kernel`, and nothing else of it: the sources of kernels are for the compiler, no other module
imports them. Names of modules are unique over all folders of kernels. The library carries the
digest of the sources that it was built from. Where they were edited since, it is not used, and each
module of kernels is compiled by Numba in the process that asks for it. The library has variants for
processors of several levels; the best that runs here is taken, or what the environment variable
KEMPE_KERNELS says: the name of a variant, or "jit" to compile.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from kempe.errors import KernelsError
from kempe.kernels.digest import compute_source_digests, find_first_difference, list_sources

VARIABLE = "KEMPE_KERNELS"
JIT = "jit"
"""The environment variable that names a variant, and the name of what is compiled in this
process."""

_HELP = (
    "install a wheel of Kempe for this platform, or compile the kernels by installing from the "
    "sources once more (`pip install .`, for a checkout `pip install -e .`), or install Numba (the "
    "extra 'jit')"
)


def _load_library() -> Any:
    """Load the library of kernels, at the variant that is requested; None where kernels are
    compiled in the process. Errors: `KernelsError`.
    """
    wanted = os.environ.get(VARIABLE, "")
    guard = os.environ.get("KEMPE_GUARD", "")
    if guard not in ("", "after", "before"):
        raise KernelsError(f"KEMPE_GUARD is {guard!r}; allowed: 'after', 'before'")
    if wanted == JIT:
        why = f"{VARIABLE} is {JIT!r}"
    elif importlib.util.find_spec("kempe.kernels._native") is None:
        why = "the kernels of this installation are not compiled"
    else:
        try:
            from kempe.kernels import _native  # pyright: ignore
        except ImportError as error:
            how = f"{_HELP} and set {VARIABLE}={JIT}"
            raise KernelsError(
                f"the library of kernels cannot be loaded: {error}; {how}"
            ) from error
        sources = compute_source_digests()
        if sources in (_native.SOURCES, ""):
            _native.use(_choose_variant(_native.VARIANTS, wanted))
            return _native
        changed = find_first_difference(_native.SOURCES, sources)
        why = f"the sources of the kernels were edited after they were compiled ({changed})"
    if wanted not in ("", JIT):
        raise KernelsError(f"{VARIABLE} is {wanted!r}, but {why}; {_HELP}")
    if importlib.util.find_spec("numba") is None:
        raise KernelsError(
            f"{why}, but there is no Numba; {_HELP}" if wanted == JIT else f"{why}; {_HELP}"
        )
    if wanted != JIT and not os.environ.get("KEMPE_QUIET"):
        print(
            f"kempe: {why}; compiling what is used in this process ...", file=sys.stderr, flush=True
        )
    return None


def _choose_variant(variants: dict[str, bool], wanted: str) -> str:
    """Choose the variant that runs: the requested one, else the best that this processor runs.
    Errors: `KernelsError`.
    """
    running = [name for name, runs in variants.items() if runs]
    if wanted and wanted not in running:
        what = (
            "this processor does not run it"
            if wanted in variants
            else "this library does not have it"
        )
        allowed = ", ".join(map(repr, [*running, JIT]))
        raise KernelsError(f"{VARIABLE} is {wanted!r}, but {what}; allowed here: {allowed}")
    return wanted or running[0]


_native = _load_library()
VARIANT: str = JIT if _native is None else _native.variant()
"""Which variant of the kernels this process runs."""


def _group_entry_points() -> dict[str, SimpleNamespace]:
    """Group the entry points of the library by their module of kernels."""
    modules: dict[str, dict[str, Any]] = {}
    for key in filter(lambda key: "__" in key.strip("_"), dir(_native)):
        module, _, name = key.partition("__")
        modules.setdefault(module, {})[name] = getattr(_native, key)
    return {module: SimpleNamespace(**entries) for module, entries in modules.items()}


if _native is not None:
    globals().update(_group_entry_points())


def __getattr__(name: str) -> Any:
    """A module of kernels, compiled now."""
    if _native is None and (place := list_sources().get(name)):
        return importlib.import_module(f"{__package__}.{place}")
    raise AttributeError(f"there are no kernels {name!r}")


def make_allocator(*shape: int) -> Callable[[], np.ndarray]:
    """Make a function that allocates float64 arrays of this shape, their entries unset; faster than
    numpy's `empty`.
    """
    return partial(np.empty, shape) if _native is None else _native.maker(shape)
