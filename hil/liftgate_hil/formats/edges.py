"""CSV file of the Hall sensors' edges: one line each, in order of time."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

from liftgate_hil.errors import ConfigError, RecordingError
from liftgate_hil.formats.guarded import Say, silent
from liftgate_hil.formats.target import open_free, why
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
    """Return the Hall edges in a ring buffer after the first `seen` ones."""
    return [
        Edge(time, DRIVES[drive], CHANNELS[channel], level)
        for time, drive, channel, level in edges_after(ring, seen).tolist()
    ]


_HEADER = ",".join(Edge._fields) + "\n"


def _is_ours(path: Path) -> bool:
    """Whether a file is one of Hall edges, written by this program."""
    try:
        with path.open("rb") as stream:
            return stream.readline(2 * len(_HEADER)) == _HEADER.encode()
    except OSError:
        return False


class EdgeFile:
    """Writer of the file of Hall edges, with times to the nanosecond; an existing file is set aside.

    Raises ConfigError, also for one of the `inputs`.
    """

    def __init__(self, argument: str, path: Path, inputs: Iterable[Path] = (), say: Say = silent) -> None:
        self._what = f"`{argument}` {path}"
        try:
            self._stream = open_free(path, inputs, say, _is_ours)
        except ConfigError as error:
            raise ConfigError(f"`{argument}` {error}") from error
        self._write(_HEADER)

    def write(self, edges: Any) -> None:
        """Write Hall edges (n,) EDGE. Raises RecordingError."""
        self._write(
            "".join(
                f"{time:.9f},{DRIVES[drive]},{CHANNELS[channel]},{level}\n"
                for time, drive, channel, level in edges.tolist()
            )
        )

    def close(self) -> None:
        """Complete and close the file. Raises RecordingError."""
        self._try(self._stream.close)

    def _write(self, text: str) -> None:
        self._try(self._stream.write, text.encode())

    def _try(self, action: Callable[..., object], *arguments: object) -> None:
        try:
            action(*arguments)
        except OSError as error:
            raise RecordingError(f"{self._what}: recording ended: {why(error)}") from error
