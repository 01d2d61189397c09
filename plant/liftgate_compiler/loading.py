# mypy: allow-untyped-calls
"""Load machine code from an object file into this process, with LLVM only, without the compiler."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from liftgate_compiler.calls import System
from liftgate_compiler.kinds import Kind
from liftgate_compiler.packing import packer, unpacker

SYMBOL = "liftgate_entry"
FITS, UNFIT, STRANGE_ARRAY = 0, 10_001, 10_002  # return codes, in addition to the compiler's own

_LIBM = "libm.so.6"
_PROTOTYPE = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_char_p, ctypes.c_void_p)


# Python functions that machine code calls in place of functions of the C library: a simulated kernel.
StandIns = Mapping[System, Callable[..., int]]


class MachineCode:
    """Loaded machine code of an entry point for arguments of certain kinds."""

    def __init__(
        self, name: str, code: bytes, arguments: Sequence[Kind], result: Kind, stand_ins: StandIns | None = None
    ) -> None:
        self._name = name
        self._thunks = {system.name: system.thunk(own) for system, own in (stand_ins or {}).items()}
        self._engine = _engine_with(code, self._thunks)
        self._function = _PROTOTYPE(self._engine.get_function_address(SYMBOL))
        self._pack = packer(arguments)
        size, self._unpack = unpacker(result)
        self._room = ctypes.c_char * size

    def takes(self, arguments: tuple[Any, ...]) -> bool:
        """Whether arguments have the code's kinds; details of arrays are checked by the code itself."""
        return self._pack(arguments) is not None

    def call(self, arguments: tuple[Any, ...]) -> tuple[bool, Any]:
        """Call the machine code; return whether it accepts these arguments, and its result.

        Raises RuntimeError.
        """
        packed = self._pack(arguments)
        if packed is None:
            return False, None
        room = self._room()
        code = self._function(packed, ctypes.addressof(room))
        if code == FITS:
            return True, self._unpack(room.raw)
        if code == UNFIT:
            return False, None
        if code == STRANGE_ARRAY:
            raise RuntimeError(
                f"{self._name} returns an array that is not one of its arguments; allowed: its own arguments"
            )
        raise RuntimeError(f"{self._name} raised an exception in machine code")


@functools.cache
def _target() -> Any:
    """Return LLVM's target for this machine, with the C library's mathematical functions loaded."""
    import llvmlite.binding as llvm  # type: ignore[import-untyped]

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    llvm.load_library_permanently(_LIBM)  # LLVM ends the process if it does not find a function
    return llvm.Target.from_triple(llvm.get_process_triple())


def _engine_with(code: bytes, thunks: Mapping[str, Any]) -> Any:
    """Return an LLVM engine with an object file; the C functions named in `thunks` are replaced by these."""
    import llvmlite.binding as llvm

    machine = _target().create_target_machine(codemodel="jitdefault", jit=True)
    module = llvm.parse_assembly("\n".join(f"declare void @{name}()" for name in thunks))
    engine = llvm.create_mcjit_compiler(module, machine)
    for name, thunk in thunks.items():
        engine.add_global_mapping(module.get_function(name), ctypes.cast(thunk, ctypes.c_void_p).value)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def unresolved(names: Sequence[str]) -> list[str]:
    """Return those of these function names that neither this process nor the C library defines."""
    libraries = [ctypes.CDLL(None), ctypes.CDLL(_LIBM)]
    return [name for name in names if not any(hasattr(library, name) for library in libraries)]
