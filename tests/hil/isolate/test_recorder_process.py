"""Process that writes recordings from the shared ring buffers."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hil_support import frames_of
from recording_support import BOTH, EPOCH_NS, messages_in, read_csv, rows_from

from liftgate_hil.errors import ConfigError, RecordingError
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.guarded import Say, silent
from liftgate_hil.formats.rotation import Limit
from liftgate_hil.isolate.recorder_process import RecorderProcess
from liftgate_hil.isolate.recorders import RingRecorder, place_in
from liftgate_hil.loop.rings import Memory, note_frames

PATIENCE = 120.0  # s until something must have happened; nothing is judged by it
MS = 10**6


@pytest.fixture
def memory() -> Iterator[Memory]:
    memory = Memory(4096, 8192)
    memory.shared.control.epoch_ns = EPOCH_NS
    yield memory
    memory.close()


def log(memory: Memory, number: int, time_ns: int, is_sent: int) -> None:
    """Put a frame whose payload is its number into the ring, with its time and direction."""
    frames = frames_of([(0x100, bytes([number]))])
    note_frames(memory.shared, frames, time_ns, is_sent)


def write(memory: Memory, rows: np.ndarray) -> None:
    """Put rows into the ring."""
    head = int(memory.shared.control.rows[0])
    memory.shared.rows[head : head + len(rows)] = rows
    memory.shared.control.rows[0] = head + len(rows)


class Notes:
    """Recorder that keeps the frames and marks that it gets, and counts the rows."""

    written = 0

    def __init__(self) -> None:
        self.epochs: list[int] = []
        self.frames: list[tuple[int, int, int]] = []
        self.rows = 0
        self.marks: list[tuple[float, str, int]] = []  # with the rows before it

    def begin(self, epoch_ns: int) -> None:
        self.epochs.append(epoch_ns)

    def write_rows(self, rows: np.ndarray) -> None:
        self.rows += len(rows)

    def write_mark(self, time_s: float, text: str) -> None:
        self.marks.append((time_s, text, self.rows))

    def write_frames(self, frames: Any) -> None:
        for row in frames:
            self.frames.append((int(row["payload"][0]), int(row["time_ns"]), int(row["is_sent"])))

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass


def recorder(
    paths: list[Path], content: Content, limit: Limit | None, memory: Memory, say: Say = silent
) -> RecorderProcess:
    """Start a recorder process, with the order to write these files."""
    process = RecorderProcess(memory, [str(path) for path in paths])
    process.order(paths, content, limit, say)
    return process


def test_frames_are_written_in_order_of_time_even_if_logged_late(memory: Memory) -> None:
    """A tick logs its sent frames; frames received meanwhile, with earlier times, are logged by the next tick."""
    notes = Notes()
    writer = RingRecorder(memory, Content(()))
    writer.write_to([notes])
    log(memory, 1, 2 * MS, 1)
    log(memory, 0, 1 * MS, 0)  # came before the first frame that was sent
    writer.take()
    log(memory, 3, 4 * MS, 1)
    log(memory, 2, 3 * MS, 0)
    log(memory, 4, 4 * MS, 1)
    writer.take()
    for number in range(5, 200):
        log(memory, number, number * MS, number % 2)
        writer.take()
    writer.take(is_last=True)
    assert [number for number, _, _ in notes.frames] == list(range(200))
    times = [time for _, time, _ in notes.frames]
    assert times == sorted(times)
    assert [way for _, _, way in notes.frames][:5] == [0, 1, 0, 1, 1]
    assert writer.lost == 0


def test_a_recorder_writes_rows_up_to_its_read_position_and_none_after_the_end_of_the_run(memory: Memory) -> None:
    """The end position is known a moment before it is reported: until then no row after it may be written."""
    notes = Notes()
    writer = RingRecorder(memory, Content(()))
    writer.write_to([notes])
    write(memory, rows_from(0, 3))
    seen = place_in(memory)
    write(memory, rows_from(3, 4))
    end = place_in(memory)
    write(memory, rows_from(7, 5))
    writer.take(seen)
    assert notes.rows == 3
    writer.end_at(end)
    writer.take(place_in(memory))
    writer.take(is_last=True)
    assert notes.rows == 7


def test_a_recorder_gets_the_start_of_the_run_once(memory: Memory) -> None:
    notes = Notes()
    writer = RingRecorder(memory, Content(()))
    writer.write_to([notes])
    memory.shared.control.epoch_ns = 0  # not begun
    writer.take()
    assert notes.epochs == []
    memory.shared.control.epoch_ns = EPOCH_NS
    for k in range(3):
        write(memory, rows_from(k, 1))
        writer.take()
    assert (notes.epochs, notes.rows) == ([EPOCH_NS], 3)


def test_rows_that_arrive_while_files_are_opened_are_written_in_order() -> None:
    """A ring of 64 rows has turned twice before the files are open."""
    memory, notes = Memory(64, 8192), Notes()
    memory.shared.control.epoch_ns = EPOCH_NS
    writer = RingRecorder(memory, Content(()))
    for k in range(4):
        head = int(memory.shared.control.rows[0])
        memory.shared.rows[(head + np.arange(40)) % 64] = rows_from(40 * k, 40)
        memory.shared.control.rows[0] = head + 40
        log(memory, k, k * MS, 1)
        writer.take()
        if k == 1:
            writer.mark(0.08, "a squeak")
    assert notes.epochs == []
    writer.write_to([notes])
    assert (notes.epochs, notes.rows, notes.marks) == ([EPOCH_NS], 160, [(0.08, "a squeak", 80)])
    writer.take(is_last=True)
    assert [number for number, _, _ in notes.frames] == [0, 1, 2, 3]
    assert (writer.lost, writer.span) == (0, (0.0, 0.159))
    memory.close()


def test_timestamps_before_the_first_sent_frame_are_equal_in_asc_and_log(memory: Memory, tmp_path: Path) -> None:
    paths = [tmp_path / "run.log", tmp_path / "run.asc"]
    process = recorder(paths, BOTH, None, memory)
    process.wait_until_ready()
    for number, (stamp, is_sent) in enumerate([(5, 1), (3, 0), (4, 0), (6, 1)]):
        log(memory, number, stamp * MS, is_sent)
    process.close()
    ours, theirs = (messages_in(path) for path in paths)
    assert [(m.data[0], m.is_rx) for m in ours] == [(1, True), (2, True), (0, False), (3, False)]
    assert [(m.data[0], m.is_rx) for m in theirs] == [(m.data[0], m.is_rx) for m in ours]
    times = [0.003, 0.004, 0.005, 0.006]
    assert [m.timestamp - EPOCH_NS / 1e9 for m in ours] == pytest.approx(times, abs=1e-6)
    assert [m.timestamp for m in theirs] == pytest.approx(times, abs=1e-6)


def test_the_written_files_are_reported_and_complete(memory: Memory, tmp_path: Path) -> None:
    process = recorder([tmp_path / "run.csv"], BOTH, Limit(10**6), memory)
    process.wait_until_ready()
    write(memory, rows_from(0, 3000))
    process.close()
    assert len(process.files) > 1
    times = [row["time_s"] for name in process.files for row in read_csv(Path(name))]
    assert times == [0.001 * k for k in range(3000)]


def test_a_recorder_that_is_killed_is_reported_at_once_and_at_the_end(memory: Memory, tmp_path: Path) -> None:
    heard = threading.Event()
    said: list[str] = []

    def say(text: str) -> None:
        said.append(text)
        heard.set()

    process = recorder([tmp_path / "run.csv"], BOTH, None, memory, say)
    process.wait_until_ready()
    os.kill(process._process.pid, signal.SIGKILL)
    assert heard.wait(PATIENCE)
    with pytest.raises(RecordingError, match="the recording process was ended from outside"):
        process.close()
    assert len(said) == 1
    assert "ended from outside" in said[0]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_reported_at_once_and_at_the_end(memory: Memory, tmp_path: Path) -> None:
    heard = threading.Event()
    said: list[str] = []

    def say(text: str) -> None:
        said.append(text)
        heard.set()

    full, good = tmp_path / "full.csv", tmp_path / "good.csv"
    full.symlink_to("/dev/full")
    process = recorder([full, good], BOTH, None, memory, say)
    process.wait_until_ready()
    write(memory, rows_from(0, 10))
    assert heard.wait(PATIENCE)
    write(memory, rows_from(10, 10))
    with pytest.raises(RecordingError, match="No space left on device"):
        process.close()
    assert said == [f"`record` {full}: recording ended at 0.009 s: No space left on device"]
    assert len(read_csv(good)) == 20, "the other recording goes on"


def test_a_file_that_cannot_be_opened_is_reported_before_the_run(memory: Memory, tmp_path: Path) -> None:
    process = recorder([tmp_path / "nosuch" / "x.csv"], BOTH, None, memory)
    with pytest.raises(ConfigError, match=r"^`record` .*cannot be written: No such file"):
        process.wait_until_ready()
    process.close()


def test_a_file_that_cannot_be_opened_leaves_no_temporary_files_of_the_others(tmp_path: Path, memory: Memory):
    good, bad = tmp_path / "a.blf", tmp_path / "nowhere" / "b.csv"
    process = recorder([good, bad], BOTH, None, memory)
    with pytest.raises(ConfigError, match="nowhere"):
        process.wait_until_ready()
    process.close()
    assert [each.name for each in tmp_path.iterdir()] == ["a.blf"]
