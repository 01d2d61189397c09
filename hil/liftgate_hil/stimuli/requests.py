"""What the driver asks of the ECU."""

from __future__ import annotations

from dataclasses import dataclass

REQUESTS = ("open", "close", "stop")


@dataclass(frozen=True)
class Request:
    """A press of a button: at a time [s], one of REQUESTS."""

    time: float
    action: str
