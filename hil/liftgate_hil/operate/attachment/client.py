"""Client of a run in another process: reads its memory, queries its progress and sends commands."""

from __future__ import annotations

import array
import contextlib
import os
import select
import socket
import time
from typing import Any

import orjson

from liftgate_hil.errors import ConfigError, RunGoneError
from liftgate_hil.loop.rings import Memory
from liftgate_hil.operate.attachment import endpoint
from liftgate_hil.version import version

JsonObject = dict[str, Any]  # JSON object: a run's description, see Description.as_json, or a reply

_PATIENCE_S = 1.0  # s to wait for a run's reply
_RETRY_S = 0.05
_MOST_ANSWERS = 100  # replies that are kept for `done`
_DESCRIPTOR = 4  # bytes
_ALLOWED = "the process of a run (liftgate-hil --bus …)"


class Client:
    """Client connection to the run of a process, with the run's `memory` and `description`.

    Raises ConfigError where there is no run within `patience` [s].
    """

    def __init__(self, pid: int, patience: float = 0.0) -> None:
        self.pid = pid
        self.end: JsonObject | None = None  # how the run has ended; None: it has not, or has not told it
        self._wire = _reached(pid, patience)
        self._arrivals, self._answers = endpoint.Arrivals(), list[JsonObject]()
        self._count = 0
        try:
            self._wire.settimeout(_PATIENCE_S)
            self.description, self.memory = self._handed()
        except (OSError, ValueError, KeyError, TypeError) as error:
            text = "does not answer, or has the maximum number of clients"
            raise ConfigError(f"`attach` {pid}: {text}; allowed: {_ALLOWED}") from error
        finally:
            if not hasattr(self, "memory"):
                self._wire.close()

    def _handed(self) -> tuple[JsonObject, Memory]:
        _, ancillary, _, _ = self._wire.recvmsg(1, socket.CMSG_SPACE(2 * _DESCRIPTOR))
        descriptors = array.array("i")
        for _, _, data in ancillary:
            descriptors.frombytes(data[: len(data) - len(data) % _DESCRIPTOR])
        with contextlib.ExitStack() as stack:
            for each in descriptors:
                stack.callback(os.close, each)
            if len(descriptors) != 2:
                raise OSError("no memory was handed over")
            memory, about = descriptors
            # `pread`, as other clients have the same open file, with its position.
            description = orjson.loads(os.pread(about, os.fstat(about).st_size, 0))
            if description["version"] != version():
                text = f"runs liftgate-hil {description['version']}, this is {version()}"
                raise ConfigError(f"`attach` {self.pid}: {text}; allowed: a run of the same version")
            return description, Memory(description["rows"], description["frames"], os.dup(memory))

    def has_closed(self) -> bool:
        """Whether the run has closed the connection, which it does at its end."""
        poll = select.poll()
        poll.register(self._wire, select.POLLRDHUP)
        return bool(poll.poll(0))

    def news(self, lines: int) -> JsonObject:
        """Return the run's progress and its log after `lines` lines; {}: no reply in time. Raises RunGoneError."""
        return self._answer(self._ask({"lines": lines}))

    def command(self, command: object) -> JsonObject:
        """Send a command; return its reply, `done` and `time_s`; {}: the run stands still, and executes it later.

        Raises ConfigError where it is refused, RunGoneError.
        """
        return self.done(self.post(command))

    def post(self, command: object) -> int:
        """Send a command without waiting; return its number, for `done`. Raises ConfigError, RunGoneError."""
        return self._ask({"command": command})

    def done(self, number: int) -> JsonObject:
        """Return the reply to a posted command by its number, see `command`."""
        answer = self._answer(number)
        if "issues" in answer:
            raise ConfigError(answer["issues"])
        return answer

    def _ask(self, question: JsonObject) -> int:
        """Send a question to the run, and return the question's number. Raises ConfigError, RunGoneError."""
        self._count += 1
        packed = endpoint.packed({"id": self._count, **question})
        try:
            self._wire.sendall(packed)
        except OSError as error:
            with contextlib.suppress(OSError, ValueError):
                while come := self._wire.recv(65_536):  # what it had sent before it has ended
                    self._keep(come)
            raise RunGoneError(f"the run {self.pid} has ended") from error
        return self._count

    def _keep(self, come: bytes) -> None:
        """Store the replies in received bytes, and the report of the run's end, if any. Raises ValueError."""
        found = self._arrivals.take(come)
        for each in found:
            if "end" in each:
                self.end = each["end"]
        # Late replies are dropped, except those that may still be fetched.
        self._answers = [*self._answers, *found][-_MOST_ANSWERS:]

    def _answer(self, number: int) -> JsonObject:
        """Return the reply to a question, by number; {}: none in time. Stores others. Raises RunGoneError."""
        end = time.monotonic() + _PATIENCE_S
        while time.monotonic() < end:
            for each in self._answers:
                if each.get("id") == number:
                    self._answers.remove(each)
                    return each
            try:
                come = self._wire.recv(65_536)
                self._keep(come)
            except TimeoutError:
                break
            except (OSError, ValueError) as error:
                raise RunGoneError(f"the run {self.pid} has ended") from error
            if not come:
                raise RunGoneError(f"the run {self.pid} has ended")
        return {}

    def close(self) -> None:
        """Close the connection and the memory."""
        self._wire.close()
        self.memory.close()


def _reached(pid: int, patience: float) -> socket.socket:
    """Connect to the run of a process, within `patience` [s]. Raises ConfigError."""
    end = time.monotonic() + patience
    while True:
        try:
            return endpoint.connected(pid)
        except OSError as error:
            if time.monotonic() >= end:
                text = f"`attach` {pid}: no run of yours{endpoint.unusable()}; allowed: {_ALLOWED}"
                raise ConfigError(text) from error
        time.sleep(_RETRY_S)
