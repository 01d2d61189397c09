# mypy: allow-untyped-calls
"""What numba does over and over during a compilation without any use here is left out, or done with less ado.

Nothing of it changes what is compiled: the machine code is the same to the byte.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from numba.core import event, ir, types
from numba.core.typing import npydecl


@contextlib.contextmanager
def hastened() -> Iterator[None]:
    """Within it numba compiles faster. What a version of it does not have is left as it is."""
    with contextlib.ExitStack() as stack:
        for owner, name, replacement in _REPLACEMENTS:
            if name in vars(owner):
                stack.callback(setattr, owner, name, vars(owner)[name])
                setattr(owner, name, replacement)
        yield


def _collect(value: Any, found: list[ir.Var]) -> None:
    """The variables in a part of an instruction. Numba's own goes through abstract base classes, and makes a list
    at each level.
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
    """Of the start and end of each step, some 60,000 of them."""


_of_arrays: Callable[..., Any] = npydecl.NumpyRulesArrayOperator.generic


def _with_arrays_only(self: Any, args: Any, kws: Any) -> Any:
    """Numba asks numpy about each sum of two numbers, and then drops the answer as there is no array in it."""
    for each in args:
        plain = each.type if isinstance(each, types.Optional) else each
        if not isinstance(plain, types.Number | types.Boolean):
            return _of_arrays(self, args, kws)
    return None


_REPLACEMENTS: tuple[tuple[Any, str, Any], ...] = (
    (ir.Inst, "_rec_list_vars", _list_vars),
    (event, "start_event", _nobody_listens),
    (event, "end_event", _nobody_listens),
    (npydecl.NumpyRulesArrayOperator, "generic", _with_arrays_only),
)
