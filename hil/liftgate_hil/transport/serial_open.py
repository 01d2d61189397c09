"""Opening of serial ports: the one that a flag names, and one that was lost.

Any kind of pyserial's ports is opened so that no later call waits for the other end.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import select
import socket
import stat
import threading
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from liftgate_hil.errors import ConfigError

BAUDRATE = 921_600
_MIN_BAUDRATE, _MAX_BAUDRATE = 1200, 20_000_000  # below that a gate cannot be commanded
_REOPEN_S = 0.1
_LEAVE_S = 1.0  # s that closing waits for the thread
ALLOWED = (
    "allowed: a device or URL of pyserial and, after an @, its rate in baud, e.g. /dev/ttyUSB0@921600, "
    "socket://192.168.0.7:7000, rfc2217://192.168.0.7:2217@115200"
)


def parse_serial(text: str) -> tuple[str, int]:
    """Return port or URL and baud rate of PORT[@BAUD]; an @ without a number after it is part of the port.

    Raises ConfigError.
    """
    port, rate = text, str(BAUDRATE)
    found = re.fullmatch(r"(.*)@([0-9]+)", text, re.DOTALL)
    if found:
        port, rate = found.groups()
    if not port:
        raise ConfigError(f"`serial` {text}: no port; {ALLOWED}")
    if len(rate) > 10 or not _MIN_BAUDRATE <= int(rate) <= _MAX_BAUDRATE:
        raise ConfigError(
            f"`serial` {text}: rate {rate}; allowed: {_MIN_BAUDRATE} to {_MAX_BAUDRATE} baud (default: {BAUDRATE})"
        )
    scheme, separator, rest = port.partition("://")
    if scheme.lower() == "loop" and "@" in rest:  # pyserial would ignore it
        raise ConfigError(f"`serial` {text}: rate {rest[1:]!r}; allowed: a whole number of baud")
    if separator and scheme.lower() in ("socket", "rfc2217"):
        try:
            parts = urlsplit(port)
            whole = bool(parts.hostname and parts.port)
        except ValueError:
            whole = False
        if not whole:
            raise ConfigError(
                f"`serial` {text}: no HOST:PORT; allowed: {scheme}://HOST:PORT with a port of 1 to 65535"
            )
    return port, int(rate)


def check_device(name: str) -> None:
    """Raise ConfigError if a serial port's path is no device, OSError if it does not exist; ignore URLs."""
    if "://" in name or os.name != "posix":
        return
    try:
        mode = Path(name).stat().st_mode
    except FileNotFoundError as error:
        port, at, rate = name.rpartition("@")
        hint = f"; {rate!r} is not a baud rate for {port}" if at and Path(port).exists() else ""
        raise FileNotFoundError(f"no such device{hint}") from error
    if not stat.S_ISCHR(mode):
        kinds = {stat.S_IFIFO: "a FIFO", stat.S_IFDIR: "a folder", stat.S_IFREG: "a file"}
        what = kinds.get(stat.S_IFMT(mode), "something else")
        raise ConfigError(f"`serial` {name}: {what}, not a serial device; {ALLOWED}")


def open_port(url: str, baudrate: int) -> Any:
    """Return an open serial port with non-blocking reads and writes. Raises whatever the driver raises."""
    import serial

    port = serial.serial_for_url(url, baudrate, do_not_open=True, timeout=0, exclusive=True)
    if is_selectable(port):
        port.write_timeout = 0  # the others do not support it, or take 0 for a timeout that is too short
    try:
        port.open()
    except BaseException:
        close_port(port)
        raise
    if hasattr(port, "set_low_latency_mode"):
        # Only a hint; drivers and pseudo-terminals that do not support it refuse.
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            port.set_low_latency_mode(True)
    if is_selectable(port) and stat.S_ISSOCK(os.fstat(port.fileno()).st_mode):
        with socket.socket(fileno=os.dup(port.fileno())) as line, contextlib.suppress(OSError):
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return port


def close_port(port: Any) -> None:
    """Close a serial port in whatever state it is."""
    # pyserial leaves a socket that the other end has reset to the garbage collector.
    line = getattr(port, "_socket", None)
    with contextlib.suppress(Exception):
        port.close()
    if line is not None:
        with contextlib.suppress(OSError):
            line.close()


def is_selectable(port: Any) -> bool:
    """Whether `select` works for a serial port; not if pyserial reads ahead in a thread."""
    return type(port).fileno is not io.RawIOBase.fileno


def has_room(port: Any, size: int) -> bool:
    """Whether a port has room for writing now. Raises OSError or ValueError if the port is gone."""
    # pyserial's own non-blocking write spins until a full port has room again, and writes of other ports wait.
    line = port if is_selectable(port) else getattr(port, "_socket", None)
    if line is not None:
        return bool(select.select([], [line], [], 0.0)[1])
    capacity = getattr(port, "buffer_size", None)  # loop://
    return capacity is None or port.out_waiting + size <= capacity


class Reopener:
    """Thread that closes a lost port and tries to open it until that succeeds."""

    def __init__(self, url: str, baudrate: int, lost: Any) -> None:
        self._url = url
        self._baudrate = baudrate
        self._lost = lost
        self._port: Any = None
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"reopen {url}", daemon=True)
        self._thread.start()

    def take(self) -> Any:
        """Return the reopened port once it is open; else None."""
        with self._lock:
            port, self._port = self._port, None
        if port is not None:
            self._thread.join()
        return port

    def stop(self) -> None:
        """Stop reopening; an attempt under way ends later, and closes a port that it opens."""
        with self._lock:
            self._stopped.set()
            port, self._port = self._port, None
        if port is not None:
            close_port(port)
        self._thread.join(_LEAVE_S)

    def _run(self) -> None:
        """Close the lost port, then try to open it until that succeeds or `stop` is called."""
        close_port(self._lost)
        self._lost = None
        while not self._stopped.wait(_REOPEN_S):
            try:
                port = open_port(self._url, self._baudrate)
            except Exception:  # it is not there yet, whatever the driver raises
                continue
            with self._lock:
                if not self._stopped.is_set():
                    self._port = port
                    return
            close_port(port)
