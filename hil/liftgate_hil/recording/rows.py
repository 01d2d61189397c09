"""Where `simulate` puts its rows: CSV as they come, MF4 at the end."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.errors import ConfigError

Blocks = Iterable[NDArray[np.float64]]


def check_output(name: str) -> None:
    """Raise ConfigError where `--output` names what cannot be written."""
    path = Path(name)
    if name != "-" and path.suffix not in (".csv", ".mf4"):
        raise ConfigError(
            f"--output {name}: format {path.suffix or 'none'!r}; allowed: .csv, .mf4, - (CSV to stdout)"
        )
    if not path.parent.is_dir():
        raise ConfigError(f"--output {name}: no folder {path.parent}; allowed: one that exists")


def write_rows(
    name: str, blocks: Blocks, names: Sequence[str], integers: Sequence[str], keep: Sequence[int]
) -> None:
    """Write the kept columns of all blocks."""
    if name == "-":
        _write_csv(sys.stdout, blocks, names, integers, keep)
        return
    try:
        if name.endswith(".mf4"):
            _write_mf4(name, blocks, names, keep)
            return
        with Path(name).open("w", encoding="ascii", newline="") as stream:
            _write_csv(stream, blocks, names, integers, keep)
    except OSError as error:
        raise ConfigError(f"--output {name}: cannot be written: {error.strerror}") from error


def _write_csv(
    stream: TextIO,
    blocks: Blocks,
    names: Sequence[str],
    integers: Sequence[str],
    keep: Sequence[int],
) -> None:
    stream.write(",".join(names[i] for i in keep) + "\n")
    whole = [k for k, i in enumerate(keep) if names[i] in integers]
    for rows in blocks:
        lines = []
        for row in rows[:, keep].tolist():
            for k in whole:
                row[k] = int(row[k])
            lines.append(",".join(map(repr, row)))
        stream.write("\n".join(lines) + "\n" if lines else "")


def _write_mf4(name: str, blocks: Blocks, names: Sequence[str], keep: Sequence[int]) -> None:
    try:
        from asammdf import MDF, Signal
    except ImportError as error:
        raise ConfigError(
            f"--output {name}: MF4 needs asammdf; allowed after: pip install 'liftgate-hil[mf4]'"
        ) from error
    rows = np.concatenate(list(blocks))
    with MDF(version="4.10") as measurement:
        measurement.append(
            [
                Signal(
                    samples=np.ascontiguousarray(rows[:, i]),
                    timestamps=np.ascontiguousarray(rows[:, 0]),
                    name=names[i],
                    unit=names[i].rpartition("_")[2],
                )
                for i in keep
                if i
            ],
            comment="liftgate-hil simulate",
        )
        measurement.save(name, overwrite=True)
