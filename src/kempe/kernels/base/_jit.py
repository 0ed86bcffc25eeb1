"""Compile kernels with Numba: one signature for each kernel, and fast-math flags that keep NaN.
Only builds and edited checkouts import this module.

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
from llvmlite.binding import Linkage
from numba import types
from numba.core import codegen, compiler
from numba.core.compiler_machinery import PassManager

from kempe.kernels.base.declare import Array, Entry, Number

# ----  link

# Compile helpers cheaply: their code is optimised where it is used, once a kernel, and not at
# every level of calls.
#
# Numba makes of each compiled function a library that holds all its callees, optimises it as a
# whole
# and emits machine code, also where only another compiled function calls it: what lies n calls deep
# is optimised n times. Here a helper's library keeps the helper's own code and the list of what it
# needs, and hands out all of it to the kernel that asks. Numba's passes for what no helper here
# contains (closures, array expressions, parallel loops ...) are left out.


_Library: Any = codegen.JITCodeLibrary
_Compiler: Any = compiler.Compiler

_NOT_NEEDED = {
    "DumpParforDiagnostics",
    "FindLiterallyCalls",
    "InlineClosureLikes",
    "InlineInlinables",
    "InlineOverloads",
    "LiteralPropagationSubPipelinePass",
    "LiteralUnroll",
    "MakeFunctionToJitFunction",
    "NoPythonSupportedFeatureValidation",
    "NopythonRewrites",
    "RewriteDynamicRaises",
    "WithLifting",
}
"""Numba's passes that would find nothing to do. A pass that it may gain one day stays in."""


class NoEngine:
    """Stands in for the engine towards code that never runs by itself."""

    def set_env(self, name: str, environment: object) -> None:
        """Do nothing: there is no machine code that could read the environment."""


class CodeOnly(_Library):
    """Code of which no machine code is made in this process."""

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0: the code is never called in this process."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> NoEngine:
        """The stand-in for Numba's engine, which would run the code."""
        return NoEngine()


class _HelperLibrary(CodeOnly):
    """Code of one helper, optimised by itself only."""

    def finalize(self) -> None:
        self._raise_if_finalized()
        self._finalized = True

    def _optimize_functions(self, module: Any) -> None:
        """Optimise all functions that have a body, with one manager of passes."""
        module.data_layout = self._codegen._data_layout
        manager, builder = self._codegen._function_pass_manager()
        for function in module.functions:
            if not function.is_declaration:
                manager.run(function, builder)

    def _get_module_for_linking(self) -> Any:
        """Return the code of the helper and of all functions that it calls, at any depth."""
        self._ensure_finalized()
        if self._shared_module is None:
            whole = self._final_module.clone()
            needed: list[Any] = [self]
            others: list[Any] = []
            for part in needed:  # grows
                for library in part._linking_libraries:
                    known = needed if isinstance(library, _HelperLibrary) else others
                    if library not in known:
                        known.append(library)
            for part in needed[1:]:
                whole.link_in(part._final_module, preserve=True)
            for library in others:  # last: of these only what is requested is taken
                whole.link_in(library._get_module_for_linking(), preserve=True)
            for function in whole.functions:
                if not function.is_declaration and function.linkage == Linkage.external:
                    function.linkage = (
                        "linkonce_odr"  # a kernel may get the same code from several helpers
                    )
            self._shared_module = whole
        return self._shared_module


class HelperCompiler(_Compiler):
    """Numba's compiler for functions that only compiled code calls."""

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any):
        if library is None:
            library = _HelperLibrary(target.codegen(), "kempe")
        super().__init__(typing, target, library, *rest)

    def define_pipelines(self) -> list[Any]:
        """Return Numba's passes without those that find nothing to do in kernels."""
        (whole,) = super().define_pipelines()
        short = PassManager(whole.pipeline_name)
        short.passes = [one for one in whole.passes if one[0].__name__ not in _NOT_NEEDED]
        short.finalize()
        return [short]


FLAGS = {"contract", "nsz", "arcp"}
"""Fast-math flags under which NaN and infinity survive and sums are not reassociated."""

_TYPES = {"f": types.float64, "i": types.int64, "b": types.boolean}
_lock = threading.Lock()


def make_numba_type(taken: Array | Number) -> types.Type:
    """Return Numba's type of an argument. An array that the kernel only reads may be read-only."""
    entry = _TYPES[taken.entry]
    if isinstance(taken, Number):
        return entry
    return types.Array(entry, len(taken.shape), "C", readonly=not taken.written)


def make_signature(entry: Entry) -> Any:
    """Return Numba's signature of an entry point."""
    result = types.int64 if entry.returns else types.void
    return result(*[make_numba_type(taken) for taken in entry.takes])


@contextmanager
def pause_garbage_collection() -> Iterator[None]:
    """Pause Python's garbage collector: to scan the compiler's many objects would take a tenth of
    its time.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def compile_in_memory(entry: Entry) -> Callable:
    """Compile the entry point for this process only."""
    dispatcher = numba.njit(nogil=entry.nogil, fastmath=FLAGS, error_model="numpy")(entry.function)
    with _lock, pause_garbage_collection():
        dispatcher.compile(make_signature(entry))
        dispatcher.disable_compile()
    return dispatcher


compile_entry: Callable[[Entry], Callable] = compile_in_memory
"""What makes a kernel of a declaration."""


def kernel(*takes: Array | Number, returns: bool = True, nogil: bool = True) -> Callable:
    """Make an entry point (decorator) that takes exactly these arguments and returns a whole
    number, or nothing.

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
    """Make a helper (decorator) that is compiled into each kernel that calls it."""
    return numba.njit(forceinline=True, **_HELPER)(function)


def routine(function: Callable) -> Callable:
    """Make a helper (decorator) that is compiled once for each kernel, since it is too large to be
    copied to each call.

    `forceinline` is said aloud, for Numba hands a `device`'s wish to be copied down to all that it
    calls. Constants among its arguments are numbers like others: Numba would compile it again for
    each of them.
    """
    helper: Any = numba.njit(forceinline=False, **_HELPER)(function)
    template = helper.get_call_template
    helper.get_call_template = lambda args, kws: template([types.unliteral(x) for x in args], kws)
    return helper
