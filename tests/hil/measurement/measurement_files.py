"""Files for the tests of measurements."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import can
import numpy as np
import pytest

from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import ConfigError
from liftgate_hil.measurement.mapping import parse_maps
from liftgate_hil.measurement.measurement import Measurement
from liftgate_hil.measurement.table import read_measurement

EPOCH = 1_700_000_000.0

Frame = tuple[float, int, bytes]  # s, identifier (extended above 0x7FF), payload


def no_rig() -> Rig:
    raise AssertionError("only a bus log needs a rig")


def read(path: Path, *maps: str) -> Measurement:
    """Read a file that needs no rig as a measurement, with these maps."""
    return read_measurement(path, parse_maps(maps), no_rig)


def faults_of(path: Path, *maps: str) -> list[str]:
    """Return the issues reported for a file that is no measurement, without the file's name."""
    with pytest.raises(ConfigError) as caught:
        read(path, *maps)
    return [fault.replace(f"{path}: ", "") for fault in caught.value.issues]


def written(folder: Path, text: str | bytes) -> Path:
    """Write a CSV file of this content; return its path."""
    path = folder / "m.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def csv_text(columns: Mapping[str, Sequence[float] | np.ndarray], delimiter: str = ",") -> str:
    lines = [delimiter.join(columns)]
    for row in zip(*columns.values(), strict=True):
        lines.append(delimiter.join("" if np.isnan(cell) else repr(float(cell)) for cell in row))
    return "\n".join(lines) + "\n"


def write_csv(path: Path, columns: Mapping[str, Sequence[float] | np.ndarray]) -> Path:
    path.write_text(csv_text(columns), encoding="utf-8")
    return path


def write_log(path: Path, frames: Iterable[Frame], is_fd: bool = False) -> Path:
    """Write a log by python-can's own writer for the suffix, with times after EPOCH; return its path."""
    with can.Logger(path) as writer:
        for time, identifier, payload in frames:
            kind = {"is_extended_id": identifier > 0x7FF, "is_fd": is_fd, "channel": "can0"}
            writer.on_message_received(can.Message(EPOCH + time, identifier, data=payload, **kind))
    return path
