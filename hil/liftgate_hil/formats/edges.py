"""Edges of the Hall sensors as a CSV file: one line each, in order of time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from liftgate_hil.errors import ConfigError, RecordingError
from liftgate_hil.formats.target import open_target, why
from liftgate_plant.edge_ring import EdgeRing, edges_after

DRIVES = ("left", "right")
CHANNELS = ("a", "b")


class Edge(NamedTuple):
    """Hall edge: model time [s], drive (`left`, `right`), channel (`a`, `b`), and the level after the edge."""

    time_s: float
    drive: str
    channel: str
    level: int


def edges_since(ring: EdgeRing, seen: int) -> list[Edge]:
    """Return the edges that came after the first `seen` ones."""
    return [
        Edge(time, DRIVES[drive], CHANNELS[channel], level)
        for time, drive, channel, level in edges_after(ring, seen).tolist()
    ]


class EdgeFile:
    """File that edges are written to, their times to the nanosecond. Raises ConfigError."""

    def __init__(self, argument: str, path: Path) -> None:
        self._what = f"`{argument}` {path}"
        try:
            self._stream = open_target(path)
        except ConfigError as error:
            raise ConfigError(f"`{argument}` {error}") from error
        self._write(",".join(Edge._fields) + "\n")

    def write(self, edges: Any) -> None:
        """Write edges (n,) EDGE. Raises RecordingError."""
        self._write(
            "".join(
                f"{time:.9f},{DRIVES[drive]},{CHANNELS[channel]},{level}\n"
                for time, drive, channel, level in edges.tolist()
            )
        )

    def close(self) -> None:
        """Complete the file. Raises RecordingError."""
        self._try(self._stream.close)

    def _write(self, text: str) -> None:
        self._try(self._stream.write, text.encode())

    def _try(self, action: Callable[..., object], *arguments: object) -> None:
        try:
            action(*arguments)
        except OSError as error:
            raise RecordingError(f"{self._what}: recording ended: {why(error)}") from error
