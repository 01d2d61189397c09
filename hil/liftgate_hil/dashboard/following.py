"""The run that follows another one on the same bus, as after a restart."""

from __future__ import annotations

from liftgate_hil.errors import ConfigError
from liftgate_hil.running.attachment import endpoint
from liftgate_hil.running.attachment.client import Client


def next_run(channel: str, ended: int) -> Client | None:
    """Return a client of a run on the bus of that name, other than that of a process; None: there is none."""
    try:
        found = [pid for pid in endpoint.runs() if pid != ended]
    except ConfigError:
        return None
    for pid in found:
        try:
            client = Client(pid)
        except ConfigError:  # it has just ended, or is of another version
            continue
        if client.description["channel"] == channel:
            return client
        client.close()
    return None
