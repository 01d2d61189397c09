"""The example ECU in C: built as program or library, and a serial line of two terminals."""

from __future__ import annotations

import contextlib
import ctypes
import os
import select
import shutil
import subprocess
import sys
import threading
import tty
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

SOURCES = Path(__file__).parents[2] / "tools" / "ecu"
needs_compiler = pytest.mark.skipif(
    shutil.which("cc") is None or shutil.which("make") is None, reason="no C compiler or make"
)

# cantools loads what it can, though it needs none of these here: a start takes 0.4 s of CPU without, 4 with them.
BARE_CANTOOLS = {"PYTHONPATH": str(Path(__file__).parent / "bare_cantools")}

STOP, OPEN, CLOSE = 0, 1, 2


def build_ecu(folder: Path) -> tuple[Path, Path]:
    """Build the example ECU for SocketCAN and for a serial line in this folder; return the two programs."""
    _make(folder, "ecu-can", "ecu-serial")
    return folder / "ecu-can", folder / "ecu-serial"


def build_library(folder: Path) -> Path:
    """Build the example ECU as a library in this folder; return its path."""
    _make(folder, "liftgate-ecu.so")
    return folder / "liftgate-ecu.so"


def _make(folder: Path, *targets: str) -> None:
    out = folder.resolve()
    subprocess.run(
        ["make", "-C", str(SOURCES), f"OUT={out}", f"PYTHON={sys.executable}"]
        + [str(out / target) for target in targets],
        check=True,
        capture_output=True,
        timeout=300,
        env={**os.environ, **BARE_CANTOOLS},
    )


class Frame(NamedTuple):
    """A frame as written by a test; `length` is set where it differs from that of the data."""

    identifier: int
    data: bytes
    flags: int = 0
    length: int | None = None


class LiftgateFrame(ctypes.Structure):
    """ctypes structure of `struct liftgate_frame`."""

    _fields_ = (
        ("id", ctypes.c_uint32),
        ("length", ctypes.c_uint8),
        ("flags", ctypes.c_uint8),
        ("data", ctypes.c_uint8 * 64),
    )


class LibraryEcu:
    """One ECU of a library; must be closed."""

    def __init__(self, library: Path) -> None:
        self._functions = functions = ctypes.CDLL(str(library))
        functions.liftgate_ecu_create.restype = ctypes.c_void_p
        functions.liftgate_ecu_destroy.argtypes = [ctypes.c_void_p]
        functions.liftgate_ecu_destroy.restype = None
        functions.liftgate_ecu_request.argtypes = [ctypes.c_void_p, ctypes.c_int]
        functions.liftgate_ecu_request.restype = None
        frames = ctypes.POINTER(LiftgateFrame)
        functions.liftgate_ecu_step.argtypes = [
            ctypes.c_void_p, ctypes.c_int64, frames, ctypes.c_int, frames, ctypes.c_int,
        ]  # fmt: skip
        self._ecu = functions.liftgate_ecu_create()
        assert self._ecu

    def close(self) -> None:
        self._functions.liftgate_ecu_destroy(self._ecu)
        self._ecu = None

    def request(self, action: int) -> None:
        self._functions.liftgate_ecu_request(self._ecu, action)

    def step(self, now_ns: int, frames: Sequence[Frame] = (), capacity: int = 4) -> list[Frame]:
        """Frames sent in this step; asserts that nothing beyond `capacity` is written."""
        taken = (LiftgateFrame * len(frames))(*map(_c_frame, frames))
        sent = (LiftgateFrame * (capacity + 1))()
        guard = bytes([0xA5]) * ctypes.sizeof(LiftgateFrame)
        ctypes.memmove(ctypes.byref(sent[capacity]), guard, len(guard))
        count = self._functions.liftgate_ecu_step(
            self._ecu, now_ns, taken if frames else None, len(frames), sent, capacity
        )
        assert 0 <= count <= capacity
        assert bytes(sent[capacity]) == guard
        return [Frame(frame.id, bytes(frame.data[: frame.length]), frame.flags) for frame in sent[:count]]


def _c_frame(frame: Frame) -> LiftgateFrame:
    length = len(frame.data) if frame.length is None else frame.length
    data = (ctypes.c_uint8 * 64)(*frame.data)
    return LiftgateFrame(frame.identifier, length, frame.flags, data)


@contextlib.contextmanager
def serial_line() -> Iterator[tuple[str, str]]:
    """Names of two terminals; what is written to one is read from the other."""
    masters, slaves = zip(*(os.openpty() for _ in range(2)), strict=True)
    for slave in slaves:
        tty.setraw(slave)
    stop = threading.Event()
    copier = threading.Thread(target=_cross, args=(*masters, stop))
    copier.start()
    try:
        yield os.ttyname(slaves[0]), os.ttyname(slaves[1])
    finally:
        stop.set()
        copier.join()
        for descriptor in (*masters, *slaves):
            os.close(descriptor)


def _cross(first: int, second: int, stop: threading.Event) -> None:
    other = {first: second, second: first}
    for each in other:
        os.set_blocking(each, False)
    while not stop.is_set():
        for source in select.select([first, second], [], [], 0.05)[0]:
            with contextlib.suppress(BlockingIOError):  # nobody reads there: lost
                os.write(other[source], os.read(source, 4096))


@contextlib.contextmanager
def running(*command: str) -> Iterator[subprocess.Popen[str]]:
    """Context with a process, which is killed at its end."""
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield child
    finally:
        child.kill()
        child.communicate()
