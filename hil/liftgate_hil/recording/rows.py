"""Where `simulate` puts its rows: CSV as they come, MF4 at the end."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import ConfigError
from liftgate_hil.recording.table import RowText
from liftgate_hil.signals import COLUMN_PLACE, COLUMNS

Blocks = Iterable[NDArray[np.float64]]


def check_output(name: str) -> None:
    """Raise ConfigError where `output` names what cannot be written."""
    path = Path(name)
    if name != "-" and path.suffix not in (".csv", ".mf4"):
        raise ConfigError(
            f"`output` {name}: format {path.suffix or 'none'!r}; allowed: .csv, .mf4, - (CSV to stdout)"
        )
    if not path.parent.is_dir():
        raise ConfigError(f"`output` {name}: no folder {path.parent}; allowed: one that exists")


def write_rows(name: str, blocks: Blocks, names: Sequence[str]) -> None:
    """Write these columns of all blocks of rows (n, ROW_WIDTH)."""
    if name == "-":
        _write_csv(sys.stdout.buffer, blocks, names)
        return
    try:
        if name.endswith(".mf4"):
            _write_mf4(name, blocks, names)
            return
        with Path(name).open("wb") as stream:
            _write_csv(stream, blocks, names)
    except OSError as error:
        raise ConfigError(f"`output` {name}: cannot be written: {error.strerror}") from error


def _write_csv(stream: BinaryIO, blocks: Blocks, names: Sequence[str]) -> None:
    text = RowText(names)
    stream.write(text.head)
    for rows in blocks:
        stream.write(text.lines(rows))


def _write_mf4(name: str, blocks: Blocks, names: Sequence[str]) -> None:
    try:
        from asammdf import MDF, Signal
    except ImportError as error:
        raise ConfigError(
            f"`output` {name}: MF4 needs asammdf; allowed after: pip install 'liftgate-hil[mf4]'"
        ) from error
    rows = np.concatenate(list(blocks))
    times = np.ascontiguousarray(rows[:, COLUMN_PLACE["time_s"]])
    with MDF(version="4.10") as measurement:
        measurement.append(
            [
                Signal(
                    samples=np.ascontiguousarray(rows[:, COLUMN_PLACE[column]]),
                    timestamps=times,
                    name=column,
                    unit=COLUMNS[column].suffix.removeprefix("_"),
                )
                for column in names
                if column != "time_s"
            ],
            comment="liftgate-hil simulate",
        )
        measurement.save(name, overwrite=True)
