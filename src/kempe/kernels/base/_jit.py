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
from llvmlite.binding import Linkage
from numba import types
from numba.core import codegen, compiler
from numba.core.compiler_machinery import PassManager

from kempe.kernels.base.declare import Array, Entry, Number

# ----  link

# Compile helpers cheaply: their code is optimised where it is used, once a kernel, and not at
# every level of calls.
#
# Numba makes of each compiled function a library that holds all its callees, optimises it as a whole
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
        """No address: it is never called here."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> NoEngine:
        """What stands for the engine that runs code."""
        return NoEngine()


class _HelperLibrary(CodeOnly):
    """Code of one helper, optimised by itself only."""

    def finalize(self) -> None:
        self._raise_if_finalized()
        self._finalized = True

    def _optimize_functions(self, module: Any) -> None:
        """Optimise all functions with one manager of passes, none that is but declared; else as
        Numba does.
        """
        module.data_layout = self._codegen._data_layout
        manager, builder = self._codegen._function_pass_manager()
        for function in module.functions:
            if not function.is_declaration:
                manager.run(function, builder)

    def _get_module_for_linking(self) -> Any:
        """The helper's code with all that it calls, at any depth."""
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
    """Numba's compiler for what only compiled code calls."""

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any):
        if library is None:
            library = _HelperLibrary(target.codegen(), "kempe")
        super().__init__(typing, target, library, *rest)

    def define_pipelines(self) -> list[Any]:
        """Numba's passes without those that are not needed."""
        (whole,) = super().define_pipelines()
        short = PassManager(whole.pipeline_name)
        short.passes = [one for one in whole.passes if one[0].__name__ not in _NOT_NEEDED]
        short.finalize()
        return [short]


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
