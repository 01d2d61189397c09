# mypy: allow-untyped-calls
"""Faster compilation with numba: helpers are linked into entry points, and only entry points optimised.

Left to itself, numba optimises each function and emits its machine code, with all functions that it calls inlined
into it again. For the entry points here this is most of the compilation time, and none of that code is ever run.
Here each entry point is optimised and emitted once, with all that it calls. This depends on internals of numba, so
that only versions are allowed with which it was tried (`building.NUMBA`).
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm  # type: ignore[import-untyped]
from numba.core import codegen, typed_passes, untyped_passes
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import PassManager


class _Library(codegen.JITCodeLibrary):
    """Base class of libraries optimised at -O1 only, as the entry point is optimised as a whole later."""

    def _optimize_functions(self, ll_module: Any) -> None:
        """Optimise a module as numba does, but with one pass manager for all its functions, and at -O1.

        The entry point is optimised as a whole, at -O3.
        """
        ll_module.data_layout = self._codegen._data_layout
        manager, builder = self._codegen._function_pass_manager(opt=1)
        for function in ll_module.functions:
            if not function.is_declaration:
                manager.run(function, builder)


class HelperLibrary(_Library):
    """numba library of a helper, which contains no machine code, and to which its callees are not linked."""

    _whole: Any = None  # its module, linked with all that it calls
    is_outlined = False  # whether it is called, not inlined

    @property
    def codegen(self) -> Any:
        """The code generator, which ignores the functions' environments."""
        return _WithoutAddresses(self._codegen)

    def finalize(self) -> None:
        """Prepare the library for linking only, without machine code."""
        self._raise_if_finalized()
        for function in self._final_module.functions:
            # So that the linker takes it where it is called, and it can be inlined and dropped.
            if not function.is_declaration and function.linkage == llvm.Linkage.external:
                function.linkage = "linkonce_odr"
                if self.is_outlined:
                    function.add_function_attribute("noinline")
        self._finalize_dynamic_globals()
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """Return the module linked with all its callees, for callers that are numba's own libraries."""
        self._ensure_finalized()
        if self._whole is None:
            self._whole = self._final_module.clone()
            _link(self, self._whole)
        return self._whole


# Numba's two optimisation runs over a module, without its vectorisers: they make a step's sums no faster, while
# the search for vectors takes a twentieth of a compilation.
_NO_VECTORS = {"loop_vectorize": False, "slp_vectorize": False}
_INLINED: dict[str, Any] = {**_NO_VECTORS, "opt": 0, "cost": "cheap"}
_OPTIMISED: dict[str, Any] = _NO_VECTORS


_NAME_LENGTH = 100  # of a function's name for profilers: module and function


class ExportLibrary(_Library):
    """numba library of an entry point, with all helpers that it calls."""

    def emitted(self) -> bytes:
        """Link and optimise the library, and return its object file."""
        self._raise_if_finalized()
        _link(self, self._final_module)
        module = self._final_module
        for number, each in enumerate([*module.functions, *module.global_variables]):
            if not each.is_declaration and each.name != self.name:
                each.linkage = "internal"
                # Numba's own name spells out all argument types, which are kilobytes for a state.
                each.name = f"{each.name[:_NAME_LENGTH]}.{number}"
        for options in _INLINED, _OPTIMISED:
            manager, builder = self._codegen._module_pass_manager(**options)
            manager.run(self._final_module, builder)
        self._final_module.verify()
        self._finalized = True
        return bytes(self._codegen._tm.emit_object(self._final_module))

    def has_addresses(self) -> bool:
        """Whether the library contains addresses of this process, such as of a large constant array."""
        return any(each.has_dynamic_globals for each in _callees_of(self))

    def asked_for(self) -> list[str]:
        """Return the names of external functions that the code calls: declared, but not defined there.

        LLVM's own intrinsics are left out.
        """
        return [
            function.name
            for function in self._final_module.functions
            if function.is_declaration and not function.name.startswith("llvm.")
        ]


class _WithoutAddresses:
    """Wrapper of numba's code generator that ignores `set_env`, as a helper library has no machine code."""

    def __init__(self, whole: Any) -> None:
        self._whole = whole

    def __getattr__(self, name: str) -> Any:
        return getattr(self._whole, name)

    def set_env(self, name: str, environment: Any) -> None:
        """Ignore a function's environment: a helper library has no machine code, so no addresses."""


def _link(library: Any, module: Any) -> None:
    """Link all libraries that `library` calls into `module`, each once."""
    for each in _callees_of(library):
        is_helper = isinstance(each, HelperLibrary)
        # preserve: another entry point may want it too
        module.link_in(each._final_module if is_helper else each._get_module_for_linking(), preserve=True)


def _callees_of(library: Any) -> list[Any]:
    """Return the libraries that `library` calls, directly or not, each after all of its callers.

    The linker drops what nothing has called so far.
    """
    seen: set[Any] = set()
    order: list[Any] = []

    def visit(caller: Any) -> None:
        for called in caller._linking_libraries:
            if called not in seen:
                seen.add(called)
                if isinstance(called, HelperLibrary):
                    visit(called)
                order.append(called)

    visit(library)
    return order[::-1]


class _Passes(PassManager):
    """numba pass manager that only runs the passes.

    Numba's own analyses the function again after each, and describes the pass to listeners, for a fifth of a
    compilation; the passes below analyse it where they need that.
    """

    def _runPass(self, index: int, pss: Any, internal_state: Any) -> None:
        """Run one pass on the compiler's state."""
        pss.analysis = self._analysis
        for run in (pss.run_initialization, pss.run_pass, pss.run_finalizer):
            run(internal_state)


# Without deletions (IRLegalization): nothing counts references, and a deletion only fills with zeros what nobody
# reads. Without the annotated copy for people (AnnotateTypes).
_PASSES: tuple[Any, ...] = (
    untyped_passes.TranslateByteCode,
    untyped_passes.FixupArgs,
    untyped_passes.IRProcessing,
    untyped_passes.RewriteSemanticConstants,
    untyped_passes.DeadBranchPrune,
    untyped_passes.GenericRewrites,
    untyped_passes.ReconstructSSA,
    typed_passes.NopythonTypeInference,
    typed_passes.PreLowerStripPhis,
    typed_passes.NativeLowering,
    typed_passes.NoPythonBackend,
)


class HelperCompiler(Compiler):
    """numba compiler of the functions that an entry point calls.

    It supports no closures, parallel loops or array expressions, as there are none.
    """

    is_outlined = False

    def define_pipelines(self) -> list[Any]:
        """Return the only pipeline, which consists of `_PASSES`."""
        manager = _Passes("liftgate")
        for each in _PASSES:
            manager.add_pass(each, each.__name__)
        manager.finalize()
        return [manager]

    def compile_extra(self, func: Any) -> Any:
        """Compile a function into a HelperLibrary, for linking only."""
        self.state.library = HelperLibrary(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.is_outlined = self.is_outlined
        return super().compile_extra(func)


class OutliningCompiler(HelperCompiler):
    """numba compiler of functions that an entry point calls without inlining them."""

    is_outlined = True

    def define_pipelines(self) -> list[Any]:
        """Clear the flag `forceinline` and return the pipeline, for a function that is called, not inlined.

        Numba compiles a helper once for each set of its callers' flags: those on its stack at this point are the
        same for all, so that there is one.
        """
        self.state.flags.forceinline = False
        return super().define_pipelines()
