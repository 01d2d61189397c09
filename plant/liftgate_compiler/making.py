# mypy: allow-untyped-calls
"""Compile an entry point to machine code with numba: its object file, and the kind of its result.

The object file exports one function, `int liftgate_entry(const int64_t *arguments, int64_t *result)`, whose memory
`packing` describes. Nothing in it counts references or allocates: arrays belong to the caller.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numba
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba.extending import register_jitable
from numba.np.arrayobj import populate_array
from numba.np.numpy_support import from_dtype

from liftgate_compiler import extensions, linking, packing  # noqa: F401
from liftgate_compiler.kinds import Array, Kind, Nothing, NumberKind, Tuple
from liftgate_compiler.loading import FITS, STRANGE_ARRAY, SYMBOL, UNFIT, unresolved
from liftgate_compiler.storage import Stored

types: Any = numba.types

# IEEE results instead of exceptions: a division by zero gives inf, which the loop's divergence check detects.
# No wrappers for calls from Python and C: the code that calls an entry point is generated here.
OPTIONS: dict[str, Any] = {
    "error_model": "numpy", "no_cfunc_wrapper": True, "no_cpython_wrapper": True, "_nrt": False,
    # A NamedTuple is passed as its scalars, over a hundred of them, so that a call may cost more than its callee.
    "forceinline": True,
}  # fmt: skip

_WORD, _INT = ir.IntType(64), ir.IntType(32)
_NUMBERS = {"f": types.float64, "i": types.int64, "b": types.boolean}
_known_to_numba: set[Callable[..., Any]] = set()


def make(
    function: Callable[..., Any],
    kinds: Sequence[Kind],
    helpers: set[Callable[..., Any]],
    outlined: set[Callable[..., Any]],
) -> Stored:
    """Compile an entry point and its helpers for arguments of these kinds; return object file and result's kind.

    Helpers in `outlined` are called, not inlined. Raises what numba raises.
    """
    # Few objects can be freed before the end; collecting them takes a tenth of the time.
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        for each in helpers - {function} - _known_to_numba:
            _register_helper(each, is_outlined=each in outlined)
        arguments = tuple(numba_type(each) for each in kinds)
        dispatcher: Any = numba.njit(pipeline_class=linking.HelperCompiler, **OPTIONS)(function)
        dispatcher.compile(arguments)
        return _exported(dispatcher.overloads[arguments], kinds)
    finally:
        if was_enabled:
            gc.enable()


def _register_helper(helper: Callable[..., Any], is_outlined: bool) -> None:
    """Register a helper with numba, so that compiled code may call it."""
    pipeline = linking.OutliningCompiler if is_outlined else linking.HelperCompiler
    register_jitable(pipeline_class=pipeline, **OPTIONS)(helper)
    _known_to_numba.add(helper)


def numba_type(kind: Kind) -> Any:
    """Return numba's type for a kind."""
    if isinstance(kind, Tuple):
        return types.BaseTuple.from_types([numba_type(each) for each in kind.parts], kind.type)
    if isinstance(kind, Array):
        dtype = from_dtype(kind.dtype)
        return types.Array(dtype, kind.ndim, kind.layout, readonly=not kind.is_writable)
    return types.none if isinstance(kind, Nothing) else _NUMBERS[kind.letter]


def _kind_of(numba_type: Any) -> Kind:
    """Return the kind for a result of this numba type. Raises TypeError."""
    if isinstance(numba_type, types.BaseTuple):
        parts = tuple(_kind_of(each) for each in numba_type)
        return Tuple(getattr(numba_type, "instance_class", None), parts)
    if isinstance(numba_type, types.Array):
        return Array(np.dtype("f8"), numba_type.ndim, "A", False)  # one of the arguments
    for letter, kind in {"b": types.Boolean, "i": types.Integer, "f": types.Float}.items():
        if isinstance(numba_type, kind) and numba_type != types.uint64:  # whose values may be too large
            return NumberKind(letter)
    if isinstance(numba_type, types.NoneType):
        return Nothing()
    raise TypeError(
        f"compiled code returns {numba_type}; allowed: numbers, bool, None, tuples, arrays of its arguments"
    )


def _exported(compiled: Any, kinds: Sequence[Kind]) -> Stored:
    """Return an entry point's object file, with one exported function, and its result's kind. Raises TypeError."""
    context, signature = compiled.target_context, compiled.signature
    codegen = context.codegen()
    library = linking.ExportLibrary(codegen, SYMBOL)
    module = library.create_ir_module(SYMBOL)
    shape = ir.FunctionType(_INT, [_WORD.as_pointer(), _WORD.as_pointer()])
    function = ir.Function(module, shape, SYMBOL)
    for pointer in function.args:
        pointer.add_attribute("noalias")
    builder = ir.IRBuilder(function.append_basic_block("entry"))
    reader = _Reader(context, builder, function.args[0])
    arguments = [reader.read(kind, each) for kind, each in zip(kinds, signature.args, strict=True)]
    callee = context.declare_function(module, compiled.fndesc)
    status, value = context.call_conv.call_function(
        builder, callee, signature.return_type, signature.args, arguments
    )
    with builder.if_then(status.is_error, likely=False):
        builder.ret(status.code)
    result = _kind_of(signature.return_type)
    _write(context, builder, signature.return_type, value, function.args[1])
    builder.ret(_INT(FITS))
    library.add_ir_module(module)
    library.add_linking_library(compiled.library)
    if library.has_addresses():
        raise TypeError(
            "compiled code refers to a constant array by its address; allowed: contiguous arrays of up to 1 MB"
        )
    code = library.emitted()
    if missing := unresolved(library.asked_for()):
        raise TypeError(f"compiled code calls {', '.join(missing)}; allowed: the C library, libm")
    return Stored(code, result)


def _field(builder: Any, object_: Any, offset: int, kind: Any = _WORD) -> Any:
    """Return the LLVM value of an object's field, at an offset [bytes] from the object's address."""
    address = builder.add(object_, _WORD(offset))
    return builder.load(builder.inttoptr(address, kind.as_pointer()))


def _array_check(module: Any, memory: Any) -> Any:
    """Return a generated LLVM function that checks whether an object is an array as expected.

    It checks type, dimensions, flags, and the type and size of the data. It is called, not inlined: an entry point
    has fifty arrays, and checks each once.
    """
    arguments = [memory, _WORD, _INT, _INT, _INT, _WORD]
    function = ir.Function(module, ir.FunctionType(ir.IntType(1), arguments), f"{SYMBOL}_array")
    function.linkage = "internal"
    function.attributes.add("noinline")
    builder = ir.IRBuilder(function.append_basic_block("entry"))
    accepted, object_, ndim, wanted, number, size = function.args

    def require(condition: Any) -> None:
        with builder.if_then(builder.not_(condition), likely=False):
            builder.ret(ir.Constant(ir.IntType(1), 0))

    kind = _field(builder, object_, packing.TYPE)
    is_accepted = ir.Constant(ir.IntType(1), 0)
    for place in range(packing.HEAD):
        type_ = builder.load(builder.gep(accepted, [_INT(place)]))
        is_accepted = builder.or_(is_accepted, builder.icmp_unsigned("==", kind, type_))
    require(is_accepted)
    flags = _field(builder, object_, packing.FLAGS, _INT)
    dtype = _field(builder, object_, packing.DTYPE)
    for found, expected in (
        (_field(builder, object_, packing.NDIM, _INT), ndim),
        (builder.and_(flags, wanted), wanted),
        (_field(builder, dtype, packing.TYPE_NUMBER, _INT), number),
        (_field(builder, dtype, packing.ITEM_SIZE), size),
    ):
        require(builder.icmp_unsigned("==", found, expected))
    order = _field(builder, dtype, packing.BYTE_ORDER, ir.IntType(8))
    builder.ret(builder.icmp_unsigned("!=", order, order.type(ord(packing.SWAPPED))))
    return function


class _Reader:
    """Generator of LLVM code that reads arguments, or returns UNFIT if an array differs from compilation time."""

    def __init__(self, context: Any, builder: Any, memory: Any) -> None:
        self._context = context
        self._builder = builder
        self._memory = memory
        self._slots: Iterator[Any] = (
            builder.load(builder.gep(memory, [_INT(place)])) for place in range(packing.HEAD, 1 << 30)
        )
        self._fits = _array_check(builder.module, memory.type)

    def read(self, kind: Kind, numba_type: Any) -> Any:
        """Return the generated LLVM value of the next argument, of a kind and numba type."""
        builder, context = self._builder, self._context
        if isinstance(kind, Tuple):
            parts = [self.read(*each) for each in zip(kind.parts, numba_type, strict=True)]
            return context.make_tuple(builder, numba_type, parts)
        if isinstance(kind, Nothing):
            return context.get_dummy_value()
        slot = next(self._slots)
        if isinstance(kind, Array):
            return self._array(kind, numba_type, slot)
        if kind.letter == "f":
            return builder.bitcast(slot, ir.DoubleType())
        if kind.letter == "b":
            return builder.trunc(slot, ir.IntType(1))
        return slot

    def _array(self, kind: Array, numba_type: Any, object_: Any) -> Any:
        """Return the generated LLVM value of an array, after a check of its Python object."""
        builder = self._builder
        wanted = packing.ALIGNED
        wanted |= packing.WRITABLE if kind.is_writable else 0
        wanted |= {"C": packing.C_CONTIGUOUS, "F": packing.F_CONTIGUOUS, "A": 0}[kind.layout]
        self._return_unfit_unless(
            builder.call(
                self._fits,
                [
                    self._memory,
                    object_,
                    _INT(kind.ndim),
                    _INT(wanted),
                    _INT(kind.dtype.num),
                    _WORD(kind.dtype.itemsize),
                ],
            )
        )
        array = self._context.make_array(numba_type)(self._context, builder)
        data = _field(builder, object_, packing.DATA)
        shape, strides = (
            [_field(builder, _field(builder, object_, where), 8 * axis) for axis in range(kind.ndim)]
            for where in (packing.SHAPE, packing.STRIDES)
        )
        populate_array(
            array,
            data=builder.inttoptr(data, array.data.type),
            shape=shape,
            strides=strides,
            itemsize=kind.dtype.itemsize,
            meminfo=None,
            parent=builder.inttoptr(object_, array.parent.type),
        )
        return array._getvalue()

    def _return_unfit_unless(self, condition: Any) -> None:
        """Generate LLVM code that returns UNFIT unless a condition holds."""
        with self._builder.if_then(self._builder.not_(condition), likely=False):
            self._builder.ret(_INT(UNFIT))


def _write(context: Any, builder: Any, numba_type: Any, value: Any, memory: Any) -> None:
    """Generate LLVM code that writes a result to memory.

    The code returns STRANGE_ARRAY for an array that no Python object owns.
    """
    places = iter(range(1 << 30))

    def write(part: Any, value: Any) -> None:
        if isinstance(part, types.BaseTuple):
            for place, each in enumerate(part):
                write(each, builder.extract_value(value, place))
        elif not isinstance(part, types.NoneType):
            word = _word_of(context, builder, part, value)
            builder.store(word, builder.gep(memory, [_INT(next(places))]))

    write(numba_type, value)


def _word_of(context: Any, builder: Any, part: Any, value: Any) -> Any:
    """Return the generated 64-bit LLVM value by which a number or array is written to memory."""
    if isinstance(part, types.Array):
        return _owner_of(context, builder, part, value)
    if isinstance(part, types.Boolean):
        return builder.zext(value, _WORD)
    if isinstance(part, types.Float):
        return builder.bitcast(context.cast(builder, value, part, types.float64), _WORD)
    return context.cast(builder, value, part, types.int64)


def _owner_of(context: Any, builder: Any, part: Any, value: Any) -> Any:
    """Return the generated address of the Python object that owns an array; the code may return STRANGE_ARRAY."""
    array = context.make_array(part)(context, builder, value=value)
    owner = builder.ptrtoint(array.parent, _WORD)
    has_none = builder.icmp_unsigned("==", owner, _WORD(0))
    with builder.if_then(has_none, likely=False):
        builder.ret(_INT(STRANGE_ARRAY))
    pointers = [builder.inttoptr(builder.add(owner, _WORD(at)), _WORD.as_pointer())
                for at in (packing.DATA, packing.SHAPE, packing.STRIDES)]  # fmt: skip
    data, shape, strides = (builder.load(each) for each in pointers)
    same = builder.icmp_unsigned("==", data, builder.ptrtoint(array.data, _WORD))
    axes = builder.load(builder.inttoptr(builder.add(owner, _WORD(packing.NDIM)), _INT.as_pointer()))
    same = builder.and_(same, builder.icmp_unsigned("==", axes, _INT(part.ndim)))
    for base, mine in ((shape, array.shape), (strides, array.strides)):
        for axis in range(part.ndim):
            pointer = builder.inttoptr(builder.add(base, _WORD(8 * axis)), _WORD.as_pointer())
            equal = builder.icmp_unsigned("==", builder.load(pointer), builder.extract_value(mine, axis))
            same = builder.and_(same, equal)
    with builder.if_then(builder.not_(same), likely=False):
        builder.ret(_INT(STRANGE_ARRAY))
    return owner
