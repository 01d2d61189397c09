"""The example ECU in C, built, and two terminals that are the ends of one serial line."""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import subprocess
import sys
import threading
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[2] / "tools" / "ecu"
needs_compiler = pytest.mark.skipif(
    shutil.which("cc") is None or shutil.which("make") is None, reason="no C compiler or make"
)


def build_ecu(folder: Path) -> tuple[Path, Path]:
    """The example ECU for SocketCAN and for a serial line, made in this folder."""
    subprocess.run(
        ["make", "-C", str(SOURCES), f"OUT={folder.resolve()}", f"PYTHON={sys.executable}"],
        check=True,
        capture_output=True,
        timeout=300,
    )
    return folder / "ecu-can", folder / "ecu-serial"


@contextlib.contextmanager
def serial_line() -> Iterator[tuple[str, str]]:
    """The names of two terminals; what is written to one is read from the other."""
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
