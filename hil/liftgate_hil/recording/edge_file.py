"""The edges of the Hall sensors as a file: CSV, a line each, in the order of time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from liftgate_hil.errors import ConfigError, RecordingError
from liftgate_hil.loop.edges import CHANNELS, DRIVES, Edge
from liftgate_hil.recording.target import open_target, why


class EdgeFile:
    """A file to write edges to, their times to the nanosecond. Raises ConfigError."""

    def __init__(self, argument: str, path: Path) -> None:
        self._what = f"`{argument}` {path}"
        try:
            self._stream = open_target(path)
        except ConfigError as error:
            raise ConfigError(f"`{argument}` {error}") from error
        self._write(",".join(Edge._fields) + "\n")

    def write(self, edges: Any) -> None:
        """Edges (n,) EDGE. Raises RecordingError."""
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
