# mypy: allow-untyped-calls
"""Helpers are linked into their entry points only; these are optimised and emitted once, with all that they call.

By itself numba optimises each function and emits its machine code, with all functions that it calls inlined into
it again: for the entry points here most of the time of a compilation, and none of that code is ever run.
This needs numba's inside; `is_possible` says whether that is as it was when this was written.
"""

from __future__ import annotations

import functools
import gc
import inspect
from collections.abc import Callable
from typing import Any

import llvmlite.binding as llvm  # type: ignore[import-untyped]
import numba
from numba.core import codegen
from numba.core.compiler import Compiler
from numba.core.environment import lookup_environment
from numba.core.runtime.context import NRTContext

_TRIED = (0, 63), (0, 68)
_NEEDED: dict[type, tuple[str, ...]] = {
    codegen.JITCodeLibrary: (
        "_finalize_dynamic_globals", "_finalize_specific", "_finalized", "_get_module_for_linking",
        "_optimize_functions", "_raise_if_finalized", "_verify_declare_only_symbols", "finalize",
    ),
    NRTContext: ("get_meminfos",),
    Compiler: ("compile_extra",),
}  # fmt: skip


def is_possible() -> bool:
    """Whether this version of numba is one of those that were tried, and has what is used here."""
    lowest, highest = _TRIED
    version = tuple(int(part) for part in numba.__version__.split(".")[:2])
    return (
        lowest <= version <= highest
        and all(hasattr(owner, name) for owner, names in _NEEDED.items() for name in names)
        and "llvm_module" not in _parameters(codegen.CPUCodegen._function_pass_manager)
    )


def _parameters(function: Callable[..., Any]) -> frozenset[str]:
    return frozenset(inspect.signature(function).parameters)


class _Library(codegen.JITCodeLibrary):
    def _optimize_functions(self, ll_module: Any) -> None:
        """As numba does, but with one pass manager for all functions of a module."""
        ll_module.data_layout = self._codegen._data_layout
        manager, builder = self._codegen._function_pass_manager()
        for function in ll_module.functions:
            if not function.is_declaration:
                manager.run(function, builder)


class HelperLibrary(_Library):
    """What a helper calls is not linked into it, and it has no machine code."""

    _whole: Any = None  # its module with all that it calls

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


class EntryLibrary(_Library):
    """An entry point with all helpers below it."""

    def finalize(self) -> None:
        """Link, optimise, and make machine code."""
        _link(self, self._final_module)
        for library in self._linking_libraries:
            self._reload_init.update(library._reload_init)
        self._linking_libraries = []
        super().finalize()

    def _verify_declare_only_symbols(self) -> None:
        # Where the symbol is not found at run time, LLVM ends the process.
        for function in self._final_module.functions:
            if function.is_declaration and function.name.startswith("_Z"):
                raise AssertionError(f"{function.name} was not linked into {self.name}")

    def _finalize_specific(self) -> None:
        super()._finalize_specific()
        # A helper has no address where numba could have put its environment, before it was linked here.
        for each in self._final_module.global_variables:
            environment = lookup_environment(each.name)
            if environment is not None:
                self.codegen.set_env(each.name, environment)


class _WithoutAddresses:
    """The code generator for a library in which nothing has an address."""

    def __init__(self, whole: Any) -> None:
        self._whole = whole

    def __getattr__(self, name: str) -> Any:
        return getattr(self._whole, name)

    def set_env(self, name: str, environment: Any) -> None:
        """Nothing has an address yet, see EntryLibrary."""


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


class _References(NRTContext):
    """Looks for references only where a type has some: by itself numba takes all fields of every tuple apart."""

    def get_meminfos(self, builder: Any, ty: Any, val: Any) -> list[tuple[Any, Any]]:
        models = self._context.data_model_manager
        if not _has_references(models, ty):
            return []
        model = models[ty]
        found = [(ty, model.get_nrt_meminfo(builder, val))] if model.has_nrt_meminfo() else []
        for part, getter in model.traverse(builder):
            if _has_references(models, part):
                found.extend(self.get_meminfos(builder, part, getter(val)))
        return found


@functools.cache
def _has_references(models: Any, kind: Any) -> bool:
    return bool(models[kind].contains_nrt_meminfo())


class HelperCompiler(Compiler):
    """Compiles what an entry point calls."""

    def compile_extra(self, func: Any) -> Any:
        """Compile it, into a library that is linked only."""
        _prepare(self.state, HelperLibrary, func)
        return super().compile_extra(func)


def entry_compiler(before: Callable[[], None]) -> type[Compiler]:
    """A compiler of an entry point that calls `before` first."""

    class EntryCompiler(Compiler):
        def __init__(self, *arguments: Any) -> None:
            before()
            super().__init__(*arguments)  # takes in what numba was told

        def compile_extra(self, func: Any) -> Any:
            _prepare(self.state, EntryLibrary, func)
            self.state.library.enable_object_caching()
            # Little of what is made can be freed before the end; looking for it takes a tenth of the time.
            was_enabled = gc.isenabled()
            gc.disable()
            try:
                return super().compile_extra(func)
            finally:
                if was_enabled:
                    gc.enable()

    return EntryCompiler


def _prepare(state: Any, kind: type[_Library], function: Callable[..., Any]) -> None:
    context = state.targetctx
    context.nrt = _References(context, context.enable_nrt)
    state.library = kind(context.codegen(), function.__qualname__)
