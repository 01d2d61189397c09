# mypy: allow-untyped-calls, allow-untyped-decorators
"""numba extensions for this package's functions and types, registered on import; `_lower_…` emit LLVM code."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils
from numba.core.typing.templates import signature
from numba.extending import lower_builtin, type_callable, typeof_impl
from numba.np.arrayobj import load_item, store_item

from liftgate_compiler.calls import System, call_long_int, call_step, last_error
from liftgate_compiler.tuples import ROOM, all_finite, fill, overlay, picked, put_text, unflattened, with_item

types: Any = numba.types
_KINDS = {"i": types.int32, "l": types.int64}
_ERRNO = "__errno_location"  # of the C library: int *(void)


@typeof_impl.register(System)
def _type_of_system(value: System, context: Any) -> Any:
    """Return numba's type for a System: an external C function."""
    arguments = [_KINDS[kind] for kind in value.arguments]
    return types.ExternalFunction(value.name, _KINDS[value.result](*arguments))


def _typed(function: Callable[..., Any], signature_of: Callable[..., Any]) -> None:
    """Register `signature_of` with numba: called with argument types, it returns the function's signature."""

    def typing(context: Any) -> Any:
        return signature_of

    type_callable(function)(typing)


_INT, _LONG = _KINDS["i"], _KINDS["l"]

_typed(last_error, lambda: signature(_INT))
_typed(call_long_int, lambda address, a, b: _INT(_LONG, _LONG, _INT))
_typed(call_step, lambda address, a, b, c, d, e, f: _INT(_LONG, _LONG, _LONG, _LONG, _INT, _LONG, _INT))
_typed(fill, lambda target, at, numbers: types.void(target, types.intp, numbers))
_typed(picked, lambda source, places: _tuple_of(source.dtype, places)(source, places))
_typed(unflattened, lambda row, like: like(row, like))
_typed(with_item, lambda numbers, place, value: numbers(numbers, types.intp, types.float64))
_typed(overlay, lambda upper, lower: lower(upper, lower))
_typed(
    put_text,
    lambda target, at, source, start, length: types.void(target, types.intp, source, types.intp, types.intp),
)
_typed(all_finite, lambda numbers: signature(types.boolean, numbers))


def _tuple_of(item: Any, places: Any) -> Any:
    """Return numba's type for a NamedTuple like `places` whose values are all of the type `item`."""
    return types.BaseTuple.from_types([item] * len(places), places.instance_class)


@lower_builtin(last_error)
def _lower_last_error(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    kind = ir.FunctionType(ir.IntType(32).as_pointer(), [])
    return builder.load(builder.call(cgutils.get_or_insert_function(builder.module, kind, _ERRNO), []))


@lower_builtin(call_long_int, _LONG, _LONG, _INT)
@lower_builtin(call_step, _LONG, _LONG, _LONG, _LONG, _INT, _LONG, _INT)
def _lower_call_at_address(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    kind = ir.FunctionType(ir.IntType(32), [each.type for each in values[1:]])
    return builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])


def _values_of(builder: Any, numbers: Any, value: Any) -> list[Any]:
    """Return the LLVM values of all numbers in a tuple."""
    return [builder.extract_value(value, place) for place in range(len(numbers))]


@lower_builtin(fill, types.Array, types.intp, types.BaseTuple)
def _lower_fill(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kind, _, numbers = signature.args
    array = context.make_array(kind)(context, builder, value=arguments[0])
    for place, value in enumerate(_values_of(builder, numbers, arguments[2])):
        index = builder.add(arguments[1], context.get_constant(types.intp, place))
        pointer = cgutils.get_item_pointer(context, builder, kind, array, [index])
        store_item(context, builder, kind, value, pointer)
    return context.get_dummy_value()


@lower_builtin(picked, types.Array, types.BaseTuple)
def _lower_picked(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kind, places = signature.args
    array = context.make_array(kind)(context, builder, value=arguments[0])
    values = []
    for place in _values_of(builder, places, arguments[1]):
        pointer = cgutils.get_item_pointer(context, builder, kind, array, [place])
        values.append(load_item(context, builder, kind, pointer))
    return context.make_tuple(builder, signature.return_type, values)


@lower_builtin(unflattened, types.Array, types.BaseTuple)
def _lower_unflattened(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kind = signature.args[0]
    array = context.make_array(kind)(context, builder, value=arguments[0])
    taken = 0

    def made(part: Any) -> Any:
        nonlocal taken
        if isinstance(part, types.BaseTuple):
            return context.make_tuple(builder, part, [made(each) for each in part])
        place = context.get_constant(types.intp, taken)
        taken += 1
        pointer = cgutils.get_item_pointer(context, builder, kind, array, [place])
        return load_item(context, builder, kind, pointer)

    return made(signature.return_type)


@lower_builtin(with_item, types.BaseTuple, types.intp, types.float64)
def _lower_with_item(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    numbers, place, value = arguments
    memory = cgutils.alloca_once_value(builder, numbers)
    builder.store(value, cgutils.gep_inbounds(builder, memory, 0, place))
    return builder.load(memory)


@lower_builtin(overlay, types.BaseTuple, types.BaseTuple)
def _lower_overlay(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    upper, lower = (
        _values_of(builder, kind, value) for kind, value in zip(signature.args, arguments, strict=True)
    )
    chosen = [
        builder.select(builder.fcmp_unordered("uno", above, above), below, above)
        for above, below in zip(upper, lower, strict=True)
    ]
    return context.make_tuple(builder, signature.return_type, chosen)


@lower_builtin(all_finite, types.BaseTuple)
def _lower_all_finite(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    # x − x is 0, or NaN for infinity and NaN; summed as a tree, as in a chain each sum would wait for the last.
    values = _values_of(builder, signature.args[0], arguments[0])
    parts = [builder.fsub(value, value) for value in values]
    while len(parts) > 1:
        odd = parts[len(parts) // 2 * 2 :]
        parts = [builder.fadd(a, b) for a, b in zip(parts[::2], parts[1::2], strict=False)] + odd
    return builder.fcmp_ordered("==", parts[0], ir.Constant(parts[0].type, 0.0))


@lower_builtin(put_text, types.Array, types.intp, types.Array, types.intp, types.intp)
def _lower_put_text(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    # Where both arrays have ROOM bytes, all are read before any is written: short text costs two moves each way.
    room = context.get_constant(types.intp, ROOM)
    places, is_near = [], builder.icmp_signed("<=", arguments[4], room)
    for kind, value, first in (
        (signature.args[0], arguments[0], arguments[1]),
        (signature.args[2], arguments[2], arguments[3]),
    ):
        array = context.make_array(kind)(context, builder, value=value)
        places.append(builder.gep(array.data, [first]))
        end = builder.add(first, room)
        is_near = builder.and_(is_near, builder.icmp_signed("<=", end, array.nitems))
    target, source = places
    with builder.if_else(is_near) as (near, far):
        with near:
            words = ir.VectorType(ir.IntType(8), ROOM).as_pointer()
            read = builder.load(builder.bitcast(source, words), align=1)
            builder.store(read, builder.bitcast(target, words), align=1)
        with far:
            cgutils.raw_memmove(builder, target, source, arguments[4], 1)
    return context.get_dummy_value()
