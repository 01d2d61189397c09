"""Helpers shared by the tests of recordings."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import can
import numpy as np
from hil_support import frames_of

from liftgate_hil.codec.frames import EXTENDED, logged
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.guarded import GuardedWriter
from liftgate_hil.formats.open import open_writer
from liftgate_hil.signals import COLUMNS, columns_of

EPOCH_NS = 1_700_000_000 * 10**9
BOTH = Content(columns_of(2), "bench")
# Each column a value of its own.
ROW = np.array([float(n) if signal.is_whole else 0.1 * n for n, signal in enumerate(COLUMNS.values())])


def rows_from(first: int, count: int) -> np.ndarray:
    """Return rows in which every cell is unique; the time is a millisecond per row."""
    rows = np.array([1000.0 * k + ROW for k in range(first, first + count)])
    rows[:, list(COLUMNS).index("time_s")] = 0.001 * np.arange(first, first + count)
    return rows


def sent(rows: list[tuple[int, bytes]], seconds: float = 0.0, is_sent: bool = True) -> Any:
    """Return frames as log records with their time and direction."""
    return logged(frames_of(rows), round(seconds * 1e9), is_sent)


def started(path: Path, **how: Any) -> GuardedWriter:
    """Return a writer that has begun, with three rows and a frame."""
    recorder = open_writer(path, BOTH, **how)
    recorder.begin(0)
    recorder.write_rows(rows_from(0, 3))
    recorder.write_frames(sent([(0x120, b"a")]))
    return recorder


def recorded_rows(path: Path, *blocks: np.ndarray, content: Content = BOTH, epoch_ns: int = 0) -> Path:
    """Write a recording of these blocks of rows, and return its path."""
    recorder = open_writer(path, content)
    recorder.begin(epoch_ns)
    for block in blocks:
        recorder.write_rows(block)
        recorder.flush()
    recorder.close()
    assert recorder.failure == ""
    assert recorder.files == [str(path)]
    return path


def told_in(path: Path) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """Return the messages of an MCAP file by topic: time [ns] and content, by the official reader."""
    from mcap.reader import make_reader

    told: dict[str, list[tuple[int, dict[str, Any]]]] = {}
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            told.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
    return told


def messages_in(path: Path) -> list[can.Message]:
    """Return the frames of a recording as python-can or, of MCAP, the official reader gives them."""
    if path.suffix == ".mcap":
        return [
            can.Message(
                timestamp=time / 1e9,
                arbitration_id=each["id"],
                is_extended_id=each["extended"],
                is_fd=each["fd"],
                is_remote_frame=each["remote"],
                is_error_frame=each["error"],
                is_rx=each["direction"] == "Rx",
                dlc=each["length"],
                data=None if each["remote"] else bytes.fromhex(each["data"]),
            )
            for time, each in told_in(path).get("/can", [])
        ]
    with can.LogReader(path) as reader:
        return list(reader)


def key(message: can.Message) -> tuple[int, bool, bool, bool, bytes]:
    """(identifier, 0 for an error frame; is extended; is remote; is an error; payload) of a message."""
    return (
        message.arbitration_id if not message.is_error_frame else 0,
        message.is_extended_id and not message.is_error_frame,
        message.is_remote_frame,
        message.is_error_frame,
        bytes(message.data),
    )


def many() -> list[tuple[int, bytes]]:
    """Return 300 frames with payloads of 0 to 8 bytes, every third with a 29-bit identifier."""
    return [
        ((0x100 + number % 5) | (EXTENDED if number % 3 == 0 else 0), bytes([number % 256] * (number % 9)))
        for number in range(300)
    ]  # fmt: skip


def read_csv(path: Path) -> list[dict[str, float]]:
    """Return the rows of a CSV file as numbers by column."""
    with path.open(newline="") as stream:
        return [{name: float(text) for name, text in row.items()} for row in csv.DictReader(stream)]


def table_in(path: Path) -> dict[str, np.ndarray]:
    """Return all columns of a recording by name."""
    if path.suffix == ".csv":
        rows = read_csv(path)
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}
    if path.suffix == ".parquet":
        from pyarrow import parquet

        table = parquet.read_table(path)
        return {name: table[name].to_numpy() for name in table.column_names}
    if path.suffix == ".mcap":
        told = told_in(path)
        columns: dict[str, list[float]] = {}
        times = [time for time, _ in told["/truth"]]
        for topic, prefix in (("/truth", ""), ("/sensed", "sensed_"), ("/bench", "")):
            rows = told.get(topic, [])
            assert [time for time, _ in rows] == (times if rows else [])
            for name in rows[0][1] if rows else ():
                if name != "time_s" or topic == "/truth":
                    columns[f"{prefix}{name}"] = [row[name] for _, row in rows]
        return {name: np.array(values, dtype=float) for name, values in columns.items()}
    from asammdf import MDF

    with MDF(path) as measured:
        (group,) = measured.groups
        names = [channel.name for channel in group.channels if channel.name != "time"]
        columns = {name: measured.get(name).samples for name in names}
        return {"time_s": measured.get_master(0), **columns}
