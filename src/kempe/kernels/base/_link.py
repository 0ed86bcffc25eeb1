"""Compile helpers cheaply: their code is optimised where it is used, once a kernel, and not at
every level of calls.

Numba makes of each compiled function a library that holds all its callees, optimises it as a whole
and emits machine code, also where only another compiled function calls it: what lies n calls deep
is optimised n times. Here a helper's library keeps the helper's own code and the list of what it
needs, and hands out all of it to the kernel that asks. Numba's passes for what no helper here
contains (closures, array expressions, parallel loops ...) are left out.
"""

from __future__ import annotations

from typing import Any

from llvmlite.binding import Linkage
from numba.core import codegen, compiler
from numba.core.compiler_machinery import PassManager

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
