"""Transport over a serial line: any port that pyserial's serial_for_url accepts.

One thread may send while another receives; nothing here waits for the other end. Reading takes what is there.
Writing passes to the port what it has room for; frames beyond that are dropped whole, and the one that was cut is
ended by the zero that the next write begins with. A port that vanishes is closed and reopened by a thread, because
both can take seconds over a network.
"""

from __future__ import annotations

import select
import threading
import time
from collections import deque
from typing import Any

import numpy as np

from liftgate_hil.codec.frames import CLASSIC_BYTES, FD, FD_FLAGS, Frames, empty_frames
from liftgate_hil.errors import ConfigError, TransportError, words_of
from liftgate_hil.transport.base import WAIT_S, LinkCounts, age_of
from liftgate_hil.transport.cobs import DELIMITER, MAX_IDENTIFIER, MAX_PAYLOAD, CobsDecoder, encode
from liftgate_hil.transport.serial_open import (
    ALLOWED,
    BAUDRATE,
    Reopener,
    check_device,
    close_port,
    has_room,
    is_selectable,
    open_port,
)

CAPACITY = 256
_CHUNK = 4096  # bytes; as much as a Linux terminal holds
_READ_LIMIT = 2 * _CHUNK  # bytes in one call, so that a flood cannot hold up the loop
_DROP_S = 0.2  # s that dropping what a reopened port has held back may take
_POLL_S = 0.0005  # s between polls of a port that cannot be waited for


class SerialTransport:
    """Transport over a serial line. Raises ConfigError for a bad path or URL, TransportError if opening fails."""

    def __init__(self, url: str, baudrate: int = BAUDRATE) -> None:
        self.name = url
        self._baudrate = baudrate
        try:
            check_device(url)
            self._port: Any = open_port(url, baudrate)
        except ConfigError:
            raise
        except Exception as error:  # pyserial and its drivers may raise anything
            detail = words_of(error)
            if "(25, " in detail:  # ENOTTY
                detail = "not a serial device"
            if isinstance(error, ValueError) and "not known" in detail:
                raise ConfigError(f"`serial` {url}: {detail}; {ALLOWED}") from error
            raise TransportError(f"`serial` {url}: cannot be opened: {detail}") from error
        self._decoder = CobsDecoder()
        self._read_last = self._port
        self._arrived: deque[tuple[int, bytes]] = deque()
        self.came_ns = np.zeros(CAPACITY, dtype=np.int64)
        self._emptied_ns = time.monotonic_ns()  # when all arrived frames were last read
        self._before_start = 0
        self._between = False  # whether the last byte written was a zero; not known at first
        self._send_failures = 0
        self._send_queue_full = 0  # those of them for which the port had no room
        self._losses = 0
        self._reopener: Reopener | None = None
        self._lock = threading.Lock()

    @property
    def is_up(self) -> bool:
        """Whether the serial port is open."""
        return self._port is not None

    def receive(self, timeout: float = 0.0) -> Frames:
        """Return the arrived frames, up to CAPACITY; wait up to `timeout` [s] for the first one."""
        deadline = time.monotonic() + timeout
        emptied_ns = self._emptied_ns
        self._read()
        while not self._arrived:
            left = deadline - time.monotonic()
            if left <= 0.0:
                break
            self._wait(min(left, WAIT_S))
            emptied_ns = self._emptied_ns
            self._read()
        frames = empty_frames(CAPACITY)
        count = min(len(self._arrived), CAPACITY)
        now = time.monotonic_ns()
        self.came_ns[:count] = now - age_of(None, now - emptied_ns)
        for row in range(count):
            identifier, payload = self._arrived.popleft()
            # The line has no flag for CAN FD, but only CAN FD frames have so many bytes.
            frames.identifiers[row] = identifier | (FD if len(payload) > CLASSIC_BYTES else 0)
            frames.lengths[row] = len(payload)
            frames.data[row, : len(payload)] = np.frombuffer(payload, dtype=np.uint8)
        return frames._replace(count=count)

    def send(self, frames: Frames) -> None:
        """Send the frames that the line can carry and has room for; count the others as failures."""
        coded = []
        for row in range(frames.count):
            identifier, length = int(frames.identifiers[row]) & ~FD_FLAGS, int(frames.lengths[row])
            # A serial line has neither 29-bit identifiers nor remote and error frames.
            if identifier > MAX_IDENTIFIER or length > MAX_PAYLOAD:
                self._send_failures += 1
            else:
                coded.append(encode(identifier, frames.data[row, :length].tobytes()))
        if not coded:
            return
        lead = 0 if self._between else 1
        written = self._write(DELIMITER * lead + b"".join(coded))
        end = lead
        for number, frame in enumerate(coded):
            end += len(frame)
            # A frame that lacks only its zero gets that with the next write.
            if written < end - 1:
                self._send_failures += len(coded) - number
                self._send_queue_full += len(coded) - number if self.is_up else 0
                break
        if written:
            self._between = written == end

    def counts(self) -> LinkCounts:
        """Return the counts of the line's errors so far."""
        bad = self._decoder.counts
        return LinkCounts(
            send_failures=self._send_failures,
            send_queue_full=self._send_queue_full,
            losses=self._losses,
            before_start=self._before_start,
            cut_frames=bad.cut,
            long_frames=bad.long,
            short_frames=bad.short,
            bad_crcs=bad.crc,
            bad_identifiers=bad.identifier,
        )

    def close(self) -> None:
        """Close the port, or stop reopening it."""
        if self._reopener is not None:
            self._reopener.stop()
            self._reopener = None
        if self._port is not None:
            close_port(self._port)
            self._port = None

    def _read(self) -> None:
        """Decode the port's waiting bytes into frames in `_arrived`; at a reopened port first drop old frames."""
        port = self._open_port()
        if port is not self._read_last:  # the rest of a frame that was cut off will not arrive
            self._read_last = port
            self._decoder.reset()
            if port is not None:
                self._drop_waiting(port)
        taken = 0
        while port is not None and taken < _READ_LIMIT and len(self._arrived) < CAPACITY:
            try:
                data = port.read(_CHUNK)
            except Exception:  # drivers may raise anything if a device is gone
                self._lose(port)
                return
            if not data:
                self._emptied_ns = time.monotonic_ns()
                return
            taken += len(data)
            self._arrived.extend(self._decoder.feed(data))

    def _drop_waiting(self, port: Any) -> None:
        """Drop frames that came before a port was reopened or wait at it, and count them as `before_start`."""
        until = time.monotonic() + _DROP_S
        self._before_start += len(self._arrived)
        self._arrived.clear()
        while time.monotonic() < until:
            try:
                data = port.read(_CHUNK)
            except Exception:  # the next read reports it
                return
            if not data:
                return
            self._before_start += len(self._decoder.feed(data))

    def _write(self, data: bytes) -> int:
        """Write as many bytes as the port has room for; return their number."""
        port = self._open_port()
        if port is None:
            return 0
        try:
            if not has_room(port, len(data)):
                return 0
            return int(port.write(data))
        except Exception:
            self._lose(port)
            return 0

    def _wait(self, timeout: float) -> None:
        """Wait up to `timeout` [s] for something to read; only briefly if the port does not support waiting."""
        port = self._port
        if port is None or not is_selectable(port):
            time.sleep(min(timeout, _POLL_S))
            return
        try:
            select.select([port], [], [], timeout)
        except Exception:
            self._lose(port)

    def _lose(self, port: Any) -> None:
        """Start reopening a lost port; of several threads that see it fail, only one does so."""
        with self._lock:
            if self._port is not port:
                return
            self._port = None
            self._losses += 1
            self._between = False
            self._reopener = Reopener(self.name, self._baudrate, port)

    def _open_port(self) -> Any:
        """Return the open port, perhaps a reopened one; None while it is lost."""
        with self._lock:
            if self._reopener is not None:
                self._port = self._reopener.take()
                if self._port is not None:
                    self._reopener = None
            return self._port
