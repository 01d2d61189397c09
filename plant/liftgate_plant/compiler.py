"""The one place that knows the compiler (numba).

A function marked `compilable` stays a plain Python function: called from Python it runs as such, so that
it can be debugged, covered and tested without a compiler. An entry point handed to `compiled` becomes
machine code that holds no interpreter lock, together with all compilable functions it calls.

`LIFTGATE_COMPILE=0` in the environment switches the compiler off: `compiled` then returns its argument.

A `System` is a function of the C library that both can call.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import functools
import hashlib
import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

_compilable: list[Callable[..., Any]] = []
_known_to_numba: set[Callable[..., Any]] = set()

# IEEE results instead of exceptions: a division by zero gives inf, which the loop's divergence check sees.
_OPTIONS: dict[str, Any] = {"error_model": "numpy"}
# A NamedTuple is passed as its scalars, over a hundred of them, so that a call may cost more than its callee.
_HELPER_OPTIONS: dict[str, Any] = {"forceinline": True}


def compilable(function: F) -> F:
    """Mark a function as usable inside compiled code; it stays plain Python outside."""
    _compilable.append(function)
    return function


def compiled(function: F) -> F:
    """The machine code of `function`, compiled at its first call (or read from the cache)."""
    if not enabled():
        return function
    return _compiled(function)  # type: ignore[return-value]


def is_cached(function: Callable[..., Any]) -> bool:
    """Whether the machine code of `function` is in the disk cache, so that it is ready at once."""
    if not enabled():
        return True
    try:
        return any(cache_folder().rglob(f"*.{function.__qualname__}-*.nbi"))
    except OSError:  # a folder that this user may not look into
        return False


class System:
    """A function of the C library for compilable code: numbers in, a number out.

    `result` and `arguments` are "i" for int and "l" for long, size_t and addresses (`array.ctypes.data`).
    """

    def __init__(self, name: str, result: str, arguments: str) -> None:
        self.name = name
        self.result = result
        self.arguments = arguments

    @functools.cached_property
    def _plain(self) -> Callable[..., int]:
        kinds = {"i": ctypes.c_int, "l": ctypes.c_long}
        function = getattr(ctypes.CDLL(None, use_errno=True), self.name)
        function.restype = kinds[self.result]
        function.argtypes = [kinds[kind] for kind in self.arguments]
        return function  # type: ignore[no-any-return]

    def __call__(self, *arguments: int) -> int:
        """Call it from plain Python."""
        return self._plain(*(int(argument) for argument in arguments))


# C functions at addresses that are known only at run time; ctypes makes callbacks of the same kinds.
INT_OF_LONG_INT = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int64, ctypes.c_int)
INT_OF_STEP = ctypes.CFUNCTYPE(
    ctypes.c_int,
    ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int, ctypes.c_int64, ctypes.c_int,
)  # fmt: skip


def call_long_int(address: int, a: int, b: int) -> int:
    """Call `int f(int64_t or pointer, int)`."""
    return int(INT_OF_LONG_INT(address)(a, b))


def call_step(address: int, a: int, b: int, c: int, d: int, e: int, f: int) -> int:
    """Call `int f(pointer, int64_t, pointer, int, pointer, int)`."""
    return int(INT_OF_STEP(address)(a, b, c, d, e, f))


def last_error() -> int:
    """The error number (errno) of this thread's last System call that failed."""
    return ctypes.get_errno()


def borrowed(value: T) -> T:
    """A NamedTuple with the same arrays, whose references compiled code does not count.

    For what its caller keeps alive and what nothing returns: counting costs a third of a tick. In plain Python
    the value itself.
    """
    return value


def fill(target: Any, at: int, numbers: tuple[float, ...]) -> None:
    """Write a NamedTuple of floats into an array (n,) from a place on.

    In machine code one store after the other; a loop over a tuple looks each value up in a jump table.
    """
    target[at : at + len(numbers)] = numbers


def all_finite(numbers: tuple[float, ...]) -> bool:
    """Whether a NamedTuple of floats has neither infinity nor NaN in it."""
    return all(math.isfinite(number) for number in numbers)


def enabled() -> bool:
    """Whether `compiled` compiles."""
    return os.environ.get("LIFTGATE_COMPILE", "1") != "0"


@functools.cache
def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    cache = _prepare_cache()
    import numba
    from numba.extending import register_jitable

    _teach_system_calls()
    _teach_foreign_calls()
    _teach_borrowing()
    _teach_tuples()
    for helper in _compilable:
        if helper not in _known_to_numba:
            register_jitable(**_OPTIONS, **_HELPER_OPTIONS)(helper)
            _known_to_numba.add(helper)
    machine_code: Any = numba.njit(nogil=True, cache=cache, **_OPTIONS)(function)
    if cache:
        _compile_once(
            machine_code, cache_folder() / f"{function.__module__}.{function.__qualname__}.lock"
        )
    return machine_code  # type: ignore[no-any-return]


class _SharedCache:
    """numba's disk cache of a function, in which one process at a time compiles; others wait and load.

    numba's own would have each of them compile, and may mix up what they save at the same time.
    """

    def __init__(self, cache: Any, path: Path) -> None:
        self._cache = cache
        self._path = path
        self._lock: IO[bytes] | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cache, name)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """What is kept for the signature; where there is None it is this process's turn to compile."""
        found = self._cache.load_overload(signature, context)
        if found is None and self._lock is None:
            # Without locks, or in a folder that this user may not write to, each compiles by itself.
            with contextlib.suppress(OSError):
                self._lock = self._path.open("ab")
                fcntl.flock(self._lock, fcntl.LOCK_EX)
                found = self._cache.load_overload(signature, context)
        return found

    def release(self) -> None:
        """Let another process have its turn."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None


def _compile_once(machine_code: Any, path: Path) -> None:
    cache = machine_code._cache = _SharedCache(machine_code._cache, path)
    compile_here = machine_code.compile

    def compile_in_turn(signature: Any) -> Any:
        try:
            return compile_here(signature)
        finally:
            cache.release()

    machine_code.compile = compile_in_turn


@functools.cache
def _teach_system_calls() -> None:
    """Tell numba what a System is, and where errno lies."""
    import numba
    from numba.extending import overload, typeof_impl

    types: Any = numba.types
    carray: Any = numba.carray  # type: ignore[attr-defined]
    kinds = {"i": types.int32, "l": types.int64}

    @typeof_impl.register(System)
    def type_of_system(value: System, context: Any) -> Any:
        arguments = [kinds[kind] for kind in value.arguments]
        return types.ExternalFunction(value.name, kinds[value.result](*arguments))

    address = types.ExternalFunction("__errno_location", types.CPointer(types.int32)())

    @overload(last_error)
    def error_number() -> Any:
        return lambda: carray(address(), 1)[0]


@functools.cache
def _teach_foreign_calls() -> None:
    """Tell numba how to call a function at an address."""
    import numba
    from llvmlite import ir  # type: ignore[import-untyped]
    from numba.extending import intrinsic, overload

    types: Any = numba.types
    word, long = types.int32, types.int64

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kind = ir.FunctionType(ir.IntType(32), [each.type for each in values[1:]])
        return builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])

    @intrinsic
    def long_int(typing_context: Any, address: Any, a: Any, b: Any) -> Any:
        return word(long, long, word), generate

    @intrinsic
    def step(
        typing_context: Any, address: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any
    ) -> Any:
        return word(long, long, long, long, word, long, word), generate

    # numba wants the very same signatures; the intrinsics get their context by themselves.
    @overload(call_long_int)
    def long_int_in_machine_code(address: Any, a: Any, b: Any) -> Any:
        def implementation(address: Any, a: Any, b: Any) -> Any:
            return long_int(address, a, b)  # type: ignore[call-arg]

        return implementation

    @overload(call_step)
    def step_in_machine_code(address: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any) -> Any:
        def implementation(address: Any, a: Any, b: Any, c: Any, d: Any, e: Any, f: Any) -> Any:
            return step(address, a, b, c, d, e, f)  # type: ignore[call-arg]

        return implementation


@functools.cache
def _teach_borrowing() -> None:
    """Tell numba that a borrowed array has no owner (no `meminfo`), so that there is nothing to count."""
    import numba
    from numba.core import cgutils
    from numba.extending import intrinsic, overload

    types: Any = numba.types

    def without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.Array):
            array = context.make_array(kind)(context, builder, value=value)
            array.meminfo = cgutils.get_null_value(array.meminfo.type)  # type: ignore[no-untyped-call]
            return array._getvalue()
        if isinstance(kind, types.BaseTuple):
            for place, each in enumerate(kind):
                part = without_owner(context, builder, each, builder.extract_value(value, place))
                value = builder.insert_value(value, part, place)
        return value

    @intrinsic
    def borrow(typing_context: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return without_owner(context, builder, signature.args[0], arguments[0])

        return value(value), generate

    @overload(borrowed)
    def borrowed_in_machine_code(value: Any) -> Any:
        def implementation(value: Any) -> Any:  # numba wants the very same signature
            return borrow(value)  # type: ignore[call-arg]  # it gets the context by itself

        return implementation


@functools.cache
def _teach_tuples() -> None:
    """Tell numba how to go through a NamedTuple of floats without loops."""
    import numba
    from llvmlite import ir
    from numba.core import cgutils
    from numba.extending import intrinsic, overload
    from numba.np.arrayobj import store_item

    types: Any = numba.types

    def values_of(builder: Any, numbers: Any, value: Any) -> list[Any]:
        return [builder.extract_value(value, place) for place in range(len(numbers))]

    def generate_fill(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind, _, numbers = signature.args
        array = context.make_array(kind)(context, builder, value=arguments[0])
        for place, value in enumerate(values_of(builder, numbers, arguments[2])):
            index = builder.add(arguments[1], context.get_constant(types.intp, place))
            pointer = cgutils.get_item_pointer(context, builder, kind, array, [index])  # type: ignore[no-untyped-call]
            store_item(context, builder, kind, value, pointer)  # type: ignore[no-untyped-call]
        return context.get_dummy_value()

    def generate_finite(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        # x − x is 0, or NaN; added up as a tree, as in a chain each sum would wait for the one before.
        values = values_of(builder, signature.args[0], arguments[0])
        parts = [builder.fsub(value, value) for value in values]
        while len(parts) > 1:
            odd = parts[len(parts) // 2 * 2 :]
            parts = [
                builder.fadd(a, b) for a, b in zip(parts[::2], parts[1::2], strict=False)
            ] + odd
        return builder.fcmp_ordered("==", parts[0], ir.Constant(parts[0].type, 0.0))

    @intrinsic
    def store(typing_context: Any, target: Any, at: Any, numbers: Any) -> Any:
        return types.void(target, types.intp, numbers), generate_fill

    @intrinsic
    def finite(typing_context: Any, numbers: Any) -> Any:
        return types.boolean(numbers), generate_finite

    @overload(fill)
    def fill_in_machine_code(target: Any, at: Any, numbers: Any) -> Any:
        def implementation(target: Any, at: Any, numbers: Any) -> Any:
            return store(target, at, numbers)  # type: ignore[call-arg]

        return implementation

    @overload(all_finite)
    def finite_in_machine_code(numbers: Any) -> Any:
        def implementation(numbers: Any) -> Any:
            return finite(numbers)  # type: ignore[call-arg]

        return implementation


def _prepare_cache() -> bool:
    """Point numba's disk cache at a folder named by the hash of all sources it could compile.

    numba itself looks only at the file of the entry point, so an edit of a helper in another file would
    go unnoticed. Returns False, and so compiles afresh, where no such folder can be made.
    """
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    import numba

    # Where numba was imported before, it has read the environment already.
    numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
    return True


def cache_folder() -> Path:
    """Where the machine code of these very sources is kept."""
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "liftgate-hil"
    return root / sources_digest(_packages())


def _packages() -> frozenset[Path]:
    """The folders of the packages with compilable functions, wherever each of them is installed."""
    names = {function.__module__.partition(".")[0] for function in _compilable}
    found = (getattr(sys.modules.get(name), "__path__", ()) for name in names)
    return frozenset(Path(folder) for folders in found for folder in folders)


@functools.cache
def sources_digest(packages: frozenset[Path]) -> str:
    """A hash over all sources in these folders with compilable functions or with the types that they take."""
    digest = hashlib.sha256()
    for package in sorted(packages, key=lambda folder: folder.name):
        for source in sorted(package.rglob("*.py")):
            content = source.read_bytes()
            if b"@compilable" in content or b"NamedTuple" in content:
                digest.update(str(source.relative_to(package.parent)).encode() + content)
    return digest.hexdigest()[:16]
