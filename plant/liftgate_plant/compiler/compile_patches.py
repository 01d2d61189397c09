# mypy: allow-untyped-calls
"""Patches of numba that skip, or speed up, repeated work which has no use here.

They do not change what is compiled: the machine code is the same to the byte.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any

from numba.core import (
    errors,
    event,
    funcdesc,
    ir,
    itanium_mangler,
    lowering,
    postproc,
    transforms,
    typeinfer,
    types,
    utils,
)
from numba.core.base import BaseContext as TargetContext
from numba.core.typing import npydecl
from numba.core.typing.context import BaseContext as TypingContext


@contextlib.contextmanager
def patched() -> Iterator[None]:
    """Apply the patches within the context, so that numba compiles faster.

    What a version of numba does not have is left as it is.
    """
    with contextlib.ExitStack() as stack:
        for owner, name, replacement in _REPLACEMENTS:
            _replace(stack, owner, name, replacement)
        for owner, name, key_of in _REMEMBERED:
            if name in vars(owner):
                _replace(stack, owner, name, _once(key_of)(vars(owner)[name]))
        yield


def _replace(stack: contextlib.ExitStack, owner: Any, name: str, replacement: Any) -> None:
    if name in vars(owner):
        stack.callback(setattr, owner, name, vars(owner)[name])
        setattr(owner, name, replacement)


def _collect(value: Any, found: list[ir.Var]) -> None:
    """Collect the variables in a part of an instruction.

    Numba's own version goes through abstract base classes, and makes a list at each level.
    """
    kind = type(value)
    if kind is ir.Var:
        found.append(value)
    elif kind in _PLAIN:
        return
    elif kind is tuple or kind is list:
        for each in value:
            _collect(each, found)
    elif kind is dict:
        for each in value.values():
            _collect(each, found)
    elif isinstance(value, ir.Inst):
        found += value.list_vars()
    elif isinstance(value, ir.Var):
        found.append(value)
    elif isinstance(value, list | tuple):
        for each in value:
            _collect(each, found)


_PLAIN = frozenset({str, int, float, bool, type(None), ir.Loc})


def _list_vars(self: Any, value: Any) -> list[ir.Var]:
    found: list[ir.Var] = []
    _collect(value, found)
    return found


def _nobody_listens(*arguments: Any, **more: Any) -> None:
    """Ignore the start and end of each step, some 60,000 events."""


_of_arrays: Callable[..., Any] = npydecl.NumpyRulesArrayOperator.generic


def _with_arrays_only(self: Any, args: Any, kws: Any) -> Any:
    """Apply numpy's rules to an operator only where an argument may be an array.

    Numba also asks numpy about each sum of two numbers, and then drops the answer as there is no array in it.
    """
    for each in args:
        plain = each.type if isinstance(each, types.Optional) else each
        if not isinstance(plain, types.Number | types.Boolean):
            return _of_arrays(self, args, kws)
    return None


_postprocess: Callable[..., Any] = postproc.PostProcessor.run


def _without_lifetimes(self: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
    """Replacement of numba's PostProcessor.run that skips the analysis of variable lifetimes.

    numba makes that analysis after each pass, but only generators and `emit_dels` need it; for these, its own
    method is called.
    """
    if emit_dels or self.func_ir.is_generator:
        _postprocess(self, emit_dels, extend_lifetimes)
        return
    self.func_ir.blocks = transforms.canonicalize_cfg(self.func_ir.blocks)
    self.func_ir.variable_lifetime = postproc.VariableLifetime(self.func_ir.blocks)
    self.func_ir.generator_info = None


class _InContext:
    """Context that adds what was being done to an error within it.

    Numba's own is a generator, made some 80,000 times.
    """

    __slots__ = ("_arguments", "_format", "_more")

    def __init__(self, format_: str, *arguments: Any, **more: Any) -> None:
        self._format = format_
        self._arguments = arguments
        self._more = more

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        if isinstance(error, errors.NumbaError):
            error.add_context(self._format.format(*self._arguments, **self._more))


def _once(key_of: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator with which a function is called once per key, and its result remembered.

    Numba goes through a function's instructions until no type changes, and asks for all of them each time; and it
    looks for new extensions before each function.
    """

    def remembering(asked: Callable[..., Any]) -> Callable[..., Any]:
        known: dict[Any, Any] = {}

        def remembered(*arguments: Any, **more: Any) -> Any:
            key = key_of(*arguments, **more)
            if key is None:
                return asked(*arguments, **more)
            if key not in known:
                known[key] = asked(*arguments, **more)
            return known[key]

        return remembered

    return remembering


def _call(context: Any, function: Any, arguments: Any, named: Any) -> Any:
    """Return a key of what the type of a call depends on; None where that is not types alone."""
    if named or not all(isinstance(each, types.Type) for each in arguments):
        return None
    return id(context), function, tuple(arguments)


def _operator(function: Any, context: Any, arguments: Any, named: Any) -> Any:
    """Return the key of `_call` where the function itself is asked.

    Lowering does so for each operator.
    """
    return _call(context, function, arguments, named)


def _field(context: Any, kind: Any, name: str) -> Any:
    return id(context), kind, name


def _order(target: Any, templates: Any, fnkey: Any = "") -> Any:
    return target, tuple(templates)


_REMEMBERED: tuple[tuple[Any, str, Callable[..., Any]], ...] = (
    (TypingContext, "resolve_function_type", _call),
    (TypingContext, "resolve_getattr", _field),
    (TypingContext, "refresh", id),
    (TargetContext, "refresh", id),
    (utils, "order_by_target_specificity", _order),
    (utils, "pysignature", lambda function: function),
    (types.BaseFunction, "get_call_type", _operator),
)


def _short_name(name: str, argtypes: Any, *, abi_tags: Any = (), uid: Any = None) -> str:
    """Return a mangled name with a number in place of the arguments' types.

    Numba's own spells out all types, kilobytes for a state, wherever the function is named.
    """
    signature = tuple(argtypes)
    number = _SIGNATURES.setdefault(signature, len(_SIGNATURES))
    tags = (*abi_tags, f"s{number}")
    return str(itanium_mangler.mangle(name, (), abi_tags=tags, uid=uid))


_SIGNATURES: dict[tuple[Any, ...], int] = {}


_REPLACEMENTS: tuple[tuple[Any, str, Any], ...] = (
    (ir.Inst, "_rec_list_vars", _list_vars),
    (postproc.PostProcessor, "run", _without_lifetimes),
    (funcdesc, "default_mangler", _short_name),
    (event, "start_event", _nobody_listens),
    (event, "end_event", _nobody_listens),
    (npydecl.NumpyRulesArrayOperator, "generic", _with_arrays_only),
    (lowering, "new_error_context", _InContext),
    (typeinfer, "new_error_context", _InContext),
)
