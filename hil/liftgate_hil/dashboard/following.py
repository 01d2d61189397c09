"""Search for the run that follows an ended one on the same bus, as after a restart."""

from __future__ import annotations

from liftgate_hil.errors import ConfigError
from liftgate_hil.operate.attachment import endpoint
from liftgate_hil.operate.attachment.client import Client


class Following:
    """Search for the run that follows the one of a process on the bus `channel`.

    Each run on another bus is asked once, however often one looks: its bench has better to do.
    """

    def __init__(self, channel: str, ended: int) -> None:
        self._channel, self._ended = channel, ended
        self._elsewhere: set[tuple[int, int]] = set()  # processes on other buses, and when their sockets were made

    def look(self) -> Client | None:
        """Return a client of the run; None: there is none yet."""
        for pid, made_ns in endpoint.sockets().items():
            if pid == self._ended or (pid, made_ns) in self._elsewhere:
                continue
            try:
                client = Client(pid)
            except ConfigError:  # it has just ended, is not ready, or is of another version
                continue
            if client.description["channel"] == self._channel:
                return client
            client.close()
            self._elsewhere.add((pid, made_ns))
        return None
