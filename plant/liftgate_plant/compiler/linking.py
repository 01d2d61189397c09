# mypy: allow-untyped-calls
"""Helpers are linked into their entry points only; these are optimised and emitted once, with all that they call.

By itself numba optimises each function and emits its machine code, with all functions that it calls inlined into
it again: for the entry points here most of the time of a compilation, and none of that code is ever run.
This needs numba's inside; `is_possible` says whether that is as it was when this was written.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from typing import Any

import llvmlite.binding as llvm  # type: ignore[import-untyped]
import numba
from numba.core import codegen, typed_passes, untyped_passes
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import PassManager

_TRIED = (0, 63), (0, 68)
# What is used here of numba's inside: what classes have, and what these methods take.
_NEEDED: dict[type, tuple[str, ...]] = {
    codegen.JITCodeLibrary: (
        "_ensure_finalized", "_finalize_dynamic_globals", "_get_module_for_linking", "_optimize_functions",
        "_raise_if_finalized", "add_ir_module", "add_linking_library", "finalize", "has_dynamic_globals",
    ),
    codegen.CPUCodegen: ("_function_pass_manager", "_module_pass_manager", "_pass_builder"),
    Compiler: ("compile_extra", "define_pipelines"),
    PassManager: ("_runPass", "add_pass", "finalize"),
}  # fmt: skip
_SET = {
    "_codegen",
    "_final_module",
    "_finalized",
    "_linking_libraries",
    "_reload_init",
}  # by a library
_OPTIONS = {"opt", "loop_vectorize", "slp_vectorize", "cost"}  # of the pass managers


def is_possible() -> bool:
    """Whether this version of numba is one of those that were tried, and has what is used here."""
    lowest, highest = _TRIED
    version = tuple(int(part) for part in numba.__version__.split(".")[:2])
    return (
        lowest <= version <= highest
        and all(hasattr(owner, name) for owner, names in _NEEDED.items() for name in names)
        and _names_in(codegen.CPUCodeLibrary.__mro__) >= _SET
        and _names_in([codegen.CPUCodegen]) >= _OPTIONS
        and "llvm_module" not in _parameters(codegen.CPUCodegen._function_pass_manager)
    )


def _names_in(classes: Iterable[type]) -> set[str]:
    """What the code of these classes calls attributes, and has as texts."""
    codes = [
        each.__code__
        for owner in classes
        for each in vars(owner).values()
        if inspect.isfunction(each)
    ]
    texts = {text for code in codes for text in code.co_consts if isinstance(text, str)}
    return texts.union(*(code.co_names for code in codes))


def _parameters(function: Callable[..., Any]) -> frozenset[str]:
    return frozenset(inspect.signature(function).parameters)


class _Library(codegen.JITCodeLibrary):
    def _optimize_functions(self, ll_module: Any) -> None:
        """As numba does, but with one pass manager for all functions of a module, and at -O1: the entry point is
        optimised as a whole, at -O3.
        """
        ll_module.data_layout = self._codegen._data_layout
        manager, builder = self._codegen._function_pass_manager(opt=1)
        for function in ll_module.functions:
            if not function.is_declaration:
                manager.run(function, builder)


class HelperLibrary(_Library):
    """What a helper calls is not linked into it, and it has no machine code."""

    _whole: Any = None  # its module with all that it calls
    is_outlined = False  # and not inlined

    @property
    def codegen(self) -> Any:
        """The code generator, but for addresses."""
        return _WithoutAddresses(self._codegen)

    def finalize(self) -> None:
        """Make it ready for the linker only."""
        self._raise_if_finalized()
        for function in self._final_module.functions:
            # So that the linker takes it where it is called, inlines it and drops it.
            if not function.is_declaration and function.linkage == llvm.Linkage.external:
                function.linkage = "linkonce_odr"
                if self.is_outlined:
                    function.add_function_attribute("noinline")
        self._finalize_dynamic_globals()
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """For others than entry points: with all that it calls."""
        self._ensure_finalized()
        if self._whole is None:
            self._whole = self._final_module.clone()
            _link(self, self._whole)
        return self._whole


# Numba's two runs over a module, without its vectorisers: a step's sums are no faster for them, while
# looking for vectors takes a twentieth of a compilation.
_NO_VECTORS = {"loop_vectorize": False, "slp_vectorize": False}
_INLINED: dict[str, Any] = {**_NO_VECTORS, "opt": 0, "cost": "cheap"}
_OPTIMISED: dict[str, Any] = _NO_VECTORS


class ExportLibrary(_Library):
    """The function that is called from outside, with all helpers below it."""

    def emitted(self) -> bytes:
        """Linked, optimised, as an object file."""
        self._raise_if_finalized()
        _link(self, self._final_module)
        for function in self._final_module.functions:
            if not function.is_declaration and function.name != self.name:
                function.linkage = "internal"
        for options in _INLINED, _OPTIMISED:
            manager, builder = self._codegen._module_pass_manager(**options)
            manager.run(self._final_module, builder)
        self._final_module.verify()
        self._finalized = True
        return bytes(self._codegen._tm.emit_object(self._final_module))

    def has_addresses(self) -> bool:
        """Whether addresses in this process are in it, such as that of a large constant array."""
        return any(each.has_dynamic_globals for each in _below(self))

    def asked_for(self) -> list[str]:
        """The functions that others are to have."""
        return [
            function.name
            for function in self._final_module.functions
            if function.is_declaration and not function.name.startswith("llvm.")
        ]


class _WithoutAddresses:
    """The code generator for a library in which nothing has an address."""

    def __init__(self, whole: Any) -> None:
        self._whole = whole

    def __getattr__(self, name: str) -> Any:
        return getattr(self._whole, name)

    def set_env(self, name: str, environment: Any) -> None:
        """Nothing has an address yet, see HelperLibrary."""


def _link(library: Any, module: Any) -> None:
    """Link all below `library` into `module`, each once."""
    for each in _below(library):
        is_helper = isinstance(each, HelperLibrary)
        # preserve: another entry point may want it too
        module.link_in(
            each._final_module if is_helper else each._get_module_for_linking(), preserve=True
        )


def _below(library: Any) -> list[Any]:
    """The libraries that it calls, directly or not; each after all that call it: the linker drops what nothing
    has called so far.
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
    """Runs each pass and no more. Numba's own analyses the function again after each, and describes the pass to
    listeners, for a fifth of a compilation; the passes below analyse it where they need that.
    """

    def _runPass(self, index: int, pss: Any, internal_state: Any) -> None:
        pss.analysis = self._analysis
        for run in (pss.run_initialization, pss.run_pass, pss.run_finalizer):
            run(internal_state)


# Without deletions (IRLegalization): nothing counts references, and to delete is to fill with zeros what nobody
# reads. Without a copy to show to people (AnnotateTypes).
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
    """Compiles what an entry point calls. No closures, no parallel loops, no array expressions: there are none."""

    is_outlined = False

    def define_pipelines(self) -> list[Any]:
        """See CompilerBase."""
        manager = _Passes("liftgate")
        for each in _PASSES:
            manager.add_pass(each, each.__name__)
        manager.finalize()
        return [manager]

    def compile_extra(self, func: Any) -> Any:
        """Compile it, into a library that is linked only."""
        self.state.library = HelperLibrary(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.is_outlined = self.is_outlined
        return super().compile_extra(func)


class OutliningCompiler(HelperCompiler):
    """Compiles what an entry point calls and does not inline."""

    is_outlined = True

    def define_pipelines(self) -> list[Any]:
        """Not inlined itself. Numba compiles a helper once for each set of its callers' flags: those that stand on
        its stack at this point are the same for all, so that there is one.
        """
        self.state.flags.forceinline = False
        return super().define_pipelines()
