"""The one way to compile: explicit signatures, safe fast-math flags, no GIL, a cache that cannot go stale.

Numba keys its cache on the source file of the compiled function alone: after an edit of a *callee* in another file a
cached caller would live on. Here the cache folder's name is a digest of all kernel sources, Numba's version and the
interpreter's; Numba itself adds the processor. Without a writable folder kernels are compiled in memory.
"""

from __future__ import annotations

import atexit
import gc
import hashlib
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
from numba import types
from numba.core import config
from numba.core.typing.templates import Signature

from kempe.kernels._link import HelperCompiler

FLAGS = {"contract", "nsz", "arcp"}
"""Fast-math flags under which NaN and infinity survive and sums are not reassociated."""

F1 = types.Array(types.float64, 1, "C", readonly=True)
F2 = types.Array(types.float64, 2, "C", readonly=True)
F3 = types.Array(types.float64, 3, "C", readonly=True)
I1 = types.Array(types.int64, 1, "C", readonly=True)
OUT1 = types.Array(types.float64, 1, "C")
OUT2 = types.Array(types.float64, 2, "C")
OUT3 = types.Array(types.float64, 3, "C")
OUT4 = types.Array(types.float64, 4, "C")
OUTI1 = types.Array(types.int64, 1, "C")
OUTI2 = types.Array(types.int64, 2, "C")

_SECONDS_BEFORE_NOTICE = 0.7
_lock = threading.Lock()
_said = threading.Event()

compiled: dict[str, int] = {}
"""Kernels compiled (not loaded from the cache) by this process: name -> count."""


def _folders() -> list[Path]:
    """Candidate folders for compiled kernels, best first."""
    given = os.environ.get("KEMPE_CACHE_DIR")
    if given:
        return [Path(given)]
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    homes = [Path(base) / "kempe"] if os.path.isabs(base) else []  # without a home '~' stays '~'
    return [*homes, Path(__file__).parent / "__pycache__" / "compiled"]


@lru_cache(1)
def source_digest() -> str:
    """Digest of all kernel sources with the versions that shape machine code."""
    digest = hashlib.sha256(f"{numba.__version__} {sys.version}".encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@lru_cache(1)
def cache_folder() -> Path | None:
    """Folder that holds the compiled kernels of this very source, or None where there is none and none can be made.

    A filled folder that cannot be written (a warmed-up image, run read-only) is used through a temporary copy, for
    Numba loads from writable folders only.
    """
    folders = [folder / source_digest() for folder in _folders()]
    for folder in folders:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    for folder in folders:
        try:
            if any(folder.iterdir()):
                copy = tempfile.mkdtemp(prefix="kempe-")
                atexit.register(shutil.rmtree, copy, ignore_errors=True)
                return Path(shutil.copytree(folder, copy, dirs_exist_ok=True))
        except OSError:
            continue
    return None


def _say_once() -> None:
    """Tell the user, once and on stderr, that kernels are being compiled."""
    if not _said.is_set() and not os.environ.get("KEMPE_QUIET"):
        _said.set()
        where = "kept for next time" if cache_folder() else "not kept: no writable cache folder, see KEMPE_CACHE_DIR"
        print(f"kempe: compiling kernels for this machine, once ({where}) ...", file=sys.stderr, flush=True)


@contextmanager
def _notice(dispatcher: Any) -> Iterator[None]:
    """Tell the user if a kernel is not loaded but compiled, and that takes its time."""
    done = threading.Event()

    def watch() -> None:
        while not done.wait(_SECONDS_BEFORE_NOTICE):
            if sum(dispatcher.stats.cache_misses.values()) or cache_folder() is None:
                _say_once()

    threading.Thread(target=watch, daemon=True).start()
    try:
        yield
    finally:
        done.set()


@contextmanager
def _garbage_stays() -> Iterator[None]:
    """Collect no garbage meanwhile: the compiler's many objects live on, and to walk them takes a tenth of its time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def kernel(*signatures: Signature, nogil: bool = True) -> Callable:
    """Decorator: compile an entry point now, for exactly these signatures, or load it from the cache.

    `nogil=False` is for kernels of a fraction of a microsecond: to hand the lock over and back costs 40 ns.
    """

    def wrap(function: Callable) -> Callable:
        folder = cache_folder()
        with _lock:
            before = getattr(config, "CACHE_DIR", "")
            setattr(config, "CACHE_DIR", str(folder) if folder else before)  # noqa: B010
            try:
                dispatcher = numba.njit(
                    nogil=nogil,
                    fastmath=FLAGS,
                    error_model="numpy",
                    cache=folder is not None,
                )(function)
            finally:
                setattr(config, "CACHE_DIR", before)  # noqa: B010
            with _notice(dispatcher), _garbage_stays():
                for signature in signatures:
                    dispatcher.compile(signature)
            dispatcher.disable_compile()
        hits = sum(dispatcher.stats.cache_hits.values()) if folder else 0
        if hits < len(signatures):
            compiled[function.__name__] = len(signatures) - hits
        return dispatcher

    return wrap


_HELPER = {
    "nogil": True,
    "fastmath": FLAGS,
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": HelperCompiler,
}


def device(function: Callable) -> Callable:
    """Decorator: a helper that kernels call; compiled into each caller, never cached on its own."""
    return numba.njit(forceinline=True, **_HELPER)(function)


def routine(function: Callable) -> Callable:
    """Decorator: a helper too large to be copied into callers; compiled once a kernel, never cached alone.

    `forceinline` is said aloud, for Numba hands a `device`'s wish to be copied down to all that it calls. Constants
    among its arguments are numbers like others: Numba would compile it again for each of them.
    """
    helper: Any = numba.njit(forceinline=False, **_HELPER)(function)
    template = helper.get_call_template
    helper.get_call_template = lambda args, kws: template([types.unliteral(x) for x in args], kws)
    return helper
