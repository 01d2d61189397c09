# mypy: allow-untyped-calls, allow-untyped-decorators
"""What numba is told about this package's own functions and types; importing it tells it."""

from __future__ import annotations

from typing import Any

import numba
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils
from numba.extending import intrinsic, overload, typeof_impl
from numba.np.arrayobj import load_item, store_item

from liftgate_plant.compiler.calls import System, call_long_int, call_step, last_error
from liftgate_plant.compiler.tuples import all_finite, fill, overlay, picked, with_item

types: Any = numba.types
_KINDS = {"i": types.int32, "l": types.int64}
_ERRNO = "__errno_location"  # of the C library: int *(void)


@typeof_impl.register(System)
def _type_of_system(value: System, context: Any) -> Any:
    arguments = [_KINDS[kind] for kind in value.arguments]
    return types.ExternalFunction(value.name, _KINDS[value.result](*arguments))


def _read_errno(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    kind = ir.FunctionType(ir.IntType(32).as_pointer(), [])
    return builder.load(
        builder.call(cgutils.get_or_insert_function(builder.module, kind, _ERRNO), [])
    )


@intrinsic
def _errno(typing_context: Any) -> Any:
    return types.int32(), _read_errno


@overload(last_error)
def _last_error() -> Any:
    def implementation() -> Any:
        return _errno()  # type: ignore[call-arg]

    return implementation


def _call_address(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    kind = ir.FunctionType(ir.IntType(32), [each.type for each in values[1:]])
    return builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])


# numba wants the very same signatures of an overload; the intrinsics get their context by themselves.
@intrinsic
def _long_int(typing_context: Any, address: Any, a: Any, b: Any) -> Any:
    return types.int32(types.int64, types.int64, types.int32), _call_address


@overload(call_long_int)
def _call_long_int(address: Any, a: Any, b: Any) -> Any:
    def implementation(address: Any, a: Any, b: Any) -> Any:
        return _long_int(address, a, b)  # type: ignore[call-arg]

    return implementation


@intrinsic
def _step(typing_context: Any, address: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any) -> Any:
    word, long = types.int32, types.int64
    return word(long, long, long, long, word, long, word), _call_address


@overload(call_step)
def _call_step(address: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any) -> Any:
    def implementation(address: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any) -> Any:
        return _step(address, a, b, c, d, e, f)  # type: ignore[call-arg]

    return implementation


def _values_of(builder: Any, numbers: Any, value: Any) -> list[Any]:
    return [builder.extract_value(value, place) for place in range(len(numbers))]


def _store_all(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kind, _, numbers = signature.args
    array = context.make_array(kind)(context, builder, value=arguments[0])
    for place, value in enumerate(_values_of(builder, numbers, arguments[2])):
        index = builder.add(arguments[1], context.get_constant(types.intp, place))
        pointer = cgutils.get_item_pointer(context, builder, kind, array, [index])
        store_item(context, builder, kind, value, pointer)
    return context.get_dummy_value()


def _load_all(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    kind, places = signature.args
    array = context.make_array(kind)(context, builder, value=arguments[0])
    values = []
    for place in _values_of(builder, places, arguments[1]):
        pointer = cgutils.get_item_pointer(context, builder, kind, array, [place])
        values.append(load_item(context, builder, kind, pointer))
    return context.make_tuple(builder, signature.return_type, values)


def _replace_one(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    numbers, place, value = arguments
    memory = cgutils.alloca_once_value(builder, numbers)
    builder.store(value, cgutils.gep_inbounds(builder, memory, 0, place))
    return builder.load(memory)


def _choose_all(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    upper, lower = (
        _values_of(builder, kind, value)
        for kind, value in zip(signature.args, arguments, strict=True)
    )
    chosen = [
        builder.select(builder.fcmp_unordered("uno", above, above), below, above)
        for above, below in zip(upper, lower, strict=True)
    ]
    return context.make_tuple(builder, signature.return_type, chosen)


def _look_at_all(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    # x − x is 0, or NaN; added up as a tree, as in a chain each sum would wait for the one before.
    values = _values_of(builder, signature.args[0], arguments[0])
    parts = [builder.fsub(value, value) for value in values]
    while len(parts) > 1:
        odd = parts[len(parts) // 2 * 2 :]
        parts = [builder.fadd(a, b) for a, b in zip(parts[::2], parts[1::2], strict=False)] + odd
    return builder.fcmp_ordered("==", parts[0], ir.Constant(parts[0].type, 0.0))


@intrinsic
def _store(typing_context: Any, target: Any, at: Any, numbers: Any) -> Any:
    return types.void(target, types.intp, numbers), _store_all


@intrinsic
def _pick(typing_context: Any, source: Any, places: Any) -> Any:
    parts = [source.dtype] * len(places)
    kind = types.BaseTuple.from_types(parts, places.instance_class)
    return kind(source, places), _load_all


@intrinsic
def _with_item(typing_context: Any, numbers: Any, place: Any, value: Any) -> Any:
    return numbers(numbers, types.intp, types.float64), _replace_one


@intrinsic
def _overlay(typing_context: Any, upper: Any, lower: Any) -> Any:
    return lower(upper, lower), _choose_all


@intrinsic
def _finite(typing_context: Any, numbers: Any) -> Any:
    return types.boolean(numbers), _look_at_all


@overload(fill)
def _fill(target: Any, at: Any, numbers: Any) -> Any:
    def implementation(target: Any, at: Any, numbers: Any) -> Any:
        return _store(target, at, numbers)  # type: ignore[call-arg]

    return implementation


@overload(picked)
def _picked(source: Any, places: Any) -> Any:
    def implementation(source: Any, places: Any) -> Any:
        return _pick(source, places)  # type: ignore[call-arg]

    return implementation


@overload(with_item)
def _with_another(numbers: Any, place: Any, value: Any) -> Any:
    def implementation(numbers: Any, place: Any, value: Any) -> Any:
        return _with_item(numbers, place, value)  # type: ignore[call-arg]

    return implementation


@overload(overlay)
def _overlaid(upper: Any, lower: Any) -> Any:
    def implementation(upper: Any, lower: Any) -> Any:
        return _overlay(upper, lower)  # type: ignore[call-arg]

    return implementation


@overload(all_finite)
def _all_finite(numbers: Any) -> Any:
    def implementation(numbers: Any) -> Any:
        return _finite(numbers)  # type: ignore[call-arg]

    return implementation
