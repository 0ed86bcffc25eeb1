"""Compile modules of kernels to one object for one family of processors:
`python emit.py VARIANT OBJECT MODULE ...`.

A process of its own, for Numba fixes the processor when it is imported: NUMBA_CPU_NAME and
NUMBA_CPU_FEATURES say which. Numba's compiler makes LLVM's intermediate code of each kernel, linked
with all its helpers and optimised, but no machine code and no wrappers; all of it becomes one
module, of which LLVM makes one position-independent object. What the C layer needs to know is
written beside it, as JSON.
"""

from __future__ import annotations

import gc
import importlib
import inspect
import json
import os
import stat
import sys
import threading
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "src"))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import library
import llvmlite.binding as llvm
import numba
from elf import sizes
from numba.core import compiler

from kempe.kernels.base import _jit
from kempe.kernels.base._jit import CodeOnly
from kempe.kernels.base.declare import Entry

OUTSIDE = {
    "NRT_MemInfo_alloc_aligned",
    "NRT_MemInfo_call_dtor",
    "NRT_Free",  # in layer.c
    "sin",
    "cos",
    "tan",
    "atan2",
    "hypot",
    "pow",
    "log10",
    "sqrt",
    "fabs",
    "memset",
    "memcpy",
    "memmove",
    "exp",
    "log",
    "asin",
    "acos",
    "atan",
    "sinh",
    "cosh",
    "tanh",
    "asinh",
    "acosh",
    "atanh",
}
"""Functions that kernels may call and that are not compiled with them."""


class LinkedLibrary(CodeOnly):
    """Code linked with all that it needs and optimised."""

    def _finalize_final_module(self) -> None:
        self._finalized = True


class EntryCompiler(compiler.Compiler):
    """Numba's compiler for entry points that are called from C."""

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any):
        if library is None:
            library = LinkedLibrary(target.codegen(), "kempe")
        super().__init__(typing, target, library, *rest)


def triple() -> str:
    """The kind of system that the object is for, as LLVM names it."""
    usual = llvm.get_default_triple()
    processor = usual.partition("-")[0]
    if sys.platform == "darwin":
        return f"{processor}-apple-macosx{library.MACOS}"
    return library.WINDOWS if sys.platform == "win32" else usual


class Refused(Exception):
    """A kernel that cannot be compiled ahead of time."""


class Emitter:
    """Collects kernels as their modules are imported, and makes one object of them."""

    def __init__(self, variant: str):
        self.variant = variant
        self.rows: list[dict[str, Any]] = []
        self.whole: Any = None
        self.exported: set[str] = set()
        self.since = time.perf_counter()

    def add(self, entry: Entry) -> Any:
        """The dispatcher of a kernel whose code is added. Errors: `Refused`."""
        names = list(inspect.signature(entry.function).parameters)
        if len(names) != len(entry.takes):
            raise Refused(
                f"{entry.name} declares {len(entry.takes)} arguments, but has {len(names)}"
            )
        dispatcher = numba.njit(
            fastmath=_jit.FLAGS,
            error_model="numpy",
            nogil=entry.nogil,
            no_cpython_wrapper=True,
            no_cfunc_wrapper=True,
            pipeline_class=EntryCompiler,
        )(entry.function)
        dispatcher.compile(_jit.make_signature(entry))
        dispatcher.disable_compile()
        (result,) = dispatcher.overloads.values()
        module = result.library._final_module
        if any(value.name.startswith("numba.dynamic.globals") for value in module.global_variables):
            raise Refused(f"{entry.name} refers to an object of this process by its address")
        self._link(module, result.fndesc.llvm_func_name, f"kempe_{entry.name}_{self.variant}")
        now = time.perf_counter()
        self.rows.append(
            {
                "name": entry.name,
                "label": entry.name.replace("__", "."),
                "names": names,
                "returns": entry.returns,
                "takes": [asdict(taken) for taken in entry.takes],
                "nogil": entry.nogil,
                "seconds": now - self.since,
            }
        )
        self.since = now
        return dispatcher

    def _link(self, module: Any, numbas: str, ours: str) -> None:
        for function in module.functions:
            if function.name == numbas:
                function.name = ours
                function.linkage = "external"
                self.exported.add(ours)
            elif not function.is_declaration:
                function.linkage = "linkonce_odr"  # several kernels bring the same helper
        for value in module.global_variables:
            if not value.is_declaration and value.name.startswith("_ZN08NumbaEnv"):
                value.linkage = "internal"
        if self.whole is None:
            self.whole = module
        else:
            self.whole.link_in(module, preserve=True)

    def object(self) -> bytes:
        """All that was added, as one object."""
        cpu = os.environ["NUMBA_CPU_NAME"]
        features = os.environ["NUMBA_CPU_FEATURES"]
        machine = llvm.Target.from_triple(triple()).create_target_machine(
            cpu=cpu, features=features, opt=3, reloc="pic", codemodel="default"
        )
        for function in self.whole.functions:
            if function.name in self.exported:
                function.visibility = "hidden"
            elif not function.is_declaration:
                function.linkage = "internal"
        for value in self.whole.global_variables:
            if not value.is_declaration and not value.name.startswith("llvm."):
                value.linkage = "internal"
        passes = llvm.create_new_module_pass_manager()
        passes.add_global_dead_code_eliminate_pass()
        passes.run(
            self.whole,
            llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=3)),
        )
        left = {
            f.name
            for f in self.whole.functions
            if f.is_declaration and not f.name.startswith("llvm.")
        }
        if left - OUTSIDE:
            raise Refused(
                f"kernels call what they do not bring: {', '.join(sorted(left - OUTSIDE))}"
            )
        return machine.emit_object(self.whole)


def main(variant: str, out: str, *modules: str) -> None:
    """Write the object of these modules of kernels, and a JSON file beside it."""
    start = time.perf_counter()
    gc.disable()  # the compiler's many objects live on: to walk them takes a tenth of its time
    emitter = Emitter(variant)
    wanted = {f"kempe.kernels.{name}" for name in modules}
    _jit.compile_entry = lambda entry: (
        emitter.add(entry) if entry.function.__module__ in wanted else entry.function
    )
    for name in modules:
        emitter.since = time.perf_counter()
        importlib.import_module(f"kempe.kernels.{name}")
    compiled = time.perf_counter()
    code = emitter.object()
    Path(out).write_bytes(code)
    rows = emitter.rows
    for row, size in zip(
        rows, sizes(code, [f"kempe_{row['name']}_{variant}" for row in rows]), strict=True
    ):
        row["bytes"] = size
    about = {
        "compile": compiled - start,
        "emit": time.perf_counter() - compiled,
        "bytes": len(code),
        "kernels": rows,
    }
    Path(out).with_suffix(".json").write_text(json.dumps(about))


def end_with_the_parent() -> None:
    """End this process when the one that started it is gone: then standard input, where it is a
    pipe, is at its end.
    """
    if stat.S_ISFIFO(os.fstat(0).st_mode):
        sys.stdin.read()
        os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=end_with_the_parent, daemon=True).start()
    try:
        main(*sys.argv[1:])
    except Refused as error:
        sys.exit(f"kernels cannot be compiled ahead of time: {error}")
