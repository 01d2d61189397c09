"""Shared ring buffers: a reader gets each row once, in order and complete, or knows that rows were lost."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hil_support import CALM
from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.codec.frames import Frames
from liftgate_hil.loop.rings import ArrivalReader, Memory, RingReader, note_arrivals, note_frames


class Writer:
    """Writer of one-number rows in two halves, between which a reader may look."""

    def __init__(self, capacity: int, batch: int) -> None:
        self.rows = np.full((capacity, 2), -1, dtype=np.int64)
        self.control = np.zeros(1, dtype=[("head", "i8")])
        self.batch = batch
        self._halves = 0  # of the batch that is being written

    @property
    def head(self) -> int:
        return int(self.control["head"][0])

    def half_row(self) -> None:
        """Write the next half of a row; a whole batch is counted with its last half."""
        number = self.head + self._halves // 2
        self.rows[number % len(self.rows), self._halves % 2] = number
        self._halves += 1
        if self._halves == 2 * self.batch:
            self.control["head"][0] += self.batch
            self._halves = 0


class Interrupted:
    """The ring as copied while the writer writes `halves` half rows before row `before` and within the next."""

    def __init__(self, writer: Writer, before: int, halves: int) -> None:
        self.writer, self.before, self.halves = writer, before, halves

    def __len__(self) -> int:
        return len(self.writer.rows)

    def __getitem__(self, index: Any) -> Any:
        chosen = np.empty((len(index), 2), dtype=np.int64)
        for at, row in enumerate(index):
            if at == self.before:
                for _ in range(self.halves):
                    self.writer.half_row()
            chosen[at, 0] = self.writer.rows[row, 0]
            if at == self.before + 1:
                for _ in range(self.halves):
                    self.writer.half_row()
            chosen[at, 1] = self.writer.rows[row, 1]
        return chosen


looks = st.tuples(st.integers(0, 40), st.integers(0, 10), st.integers(0, 40))


@CALM
@given(st.integers(1, 12), st.integers(1, 4), st.lists(looks, max_size=12))
def test_rows_are_read_once_in_order_and_complete_and_lost_ones_are_counted(
    capacity: int, batch: int, params: list[tuple[int, int, int]]
):
    writer = Writer(capacity, batch)
    reader = RingReader(writer.rows, writer.control, "head", batch)
    got: list[int] = []
    for halves, before, meanwhile in params:
        for _ in range(halves):
            writer.half_row()
        reader._rows = Interrupted(writer, before, meanwhile)
        head = writer.head
        rows = reader.take()
        assert all(first == second for first, second in rows)
        got += [int(first) for first, _ in rows]
        assert len(got) + reader.lost == head
    assert got == sorted(set(got))
    reader._rows = writer.rows
    # In the end it is told of all that was counted.
    last = reader.take()
    assert len(got) + len(last) + reader.lost == writer.head


def test_rows_read_from_a_ring_are_copies():
    writer = Writer(4, 1)
    reader = RingReader(writer.rows, writer.control, "head")
    writer.half_row()
    writer.half_row()
    rows = reader.take()
    writer.rows[:] = 99
    assert rows.tolist() == [[0, 0]]


@pytest.mark.parametrize(("capacity", "batch"), [(8, 1), (8, 3), (3, 4)])
def test_a_slow_reader_knows_how_many_rows_it_lost(capacity: int, batch: int):
    writer = Writer(capacity, batch)
    reader = RingReader(writer.rows, writer.control, "head", batch)
    for _ in range(2 * batch * 100):
        writer.half_row()
    rows = reader.take()
    assert [int(row[0]) for row in rows] == list(range(100 * batch - max(capacity - batch, 0), 100 * batch))
    assert reader.lost == 100 * batch - len(rows)


CHILD = """
import sys
from liftgate_hil.loop.rings import Memory, RingReader
memory = Memory(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), others_write=True)
shared = memory.shared
rows = RingReader(shared.rows, shared.control, "rows").take()
frames = RingReader(shared.frames, shared.control, "frames").take()
print(rows[:, 0].tolist(), frames["identifier"].tolist(), frames["payload"][:, 63].tolist())
print(int(shared.histograms.sum()))
shared.control[0].stop = 1
"""


def test_two_processes_share_the_same_memory():
    memory = Memory(5, 7, others_write=True)
    shared = memory.shared
    shared.rows[:3, 0] = [1.0, 2.0, 3.0]
    shared.control[0].rows = 3
    shared.frames[:2].identifier = [0x120, 1 << 32]
    shared.frames[1].payload[63] = 255
    shared.control[0].frames = 2
    shared.histograms[2, -1] = 41
    done = subprocess.run(
        [sys.executable, "-c", CHILD, "5", "7", str(memory.descriptor)],
        pass_fds=[memory.descriptor], capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stderr == ""
    assert done.stdout.splitlines() == ["[1.0, 2.0, 3.0] [288, 4294967296] [0, 255]", "41"]
    assert shared.control[0].stop == 1
    memory.close()


def test_the_shared_memory_cannot_be_written_through_its_descriptor():
    memory = Memory(5, 7)
    memory.shared.control[0].rows = 3
    with pytest.raises(PermissionError):
        os.pwrite(memory.descriptor, b"rubbish" * 99, 0)
    reader = Memory(5, 7, os.dup(memory.descriptor))
    assert reader.shared.control[0].rows == 3
    with pytest.raises(ValueError, match="read-only"):
        reader.shared.control[0].rows = 4
    reader.close()
    memory.close()


def test_the_arrays_of_the_shared_memory_do_not_overlap():
    memory = Memory(3, 2)
    for number, array in enumerate(memory.shared):
        array.view(np.uint8).reshape(-1)[:] = number + 1
    for number, array in enumerate(memory.shared):
        assert set(array.view(np.uint8).reshape(-1).tolist()) == {number + 1}
    memory.close()


def frames_of(*numbers: int) -> Frames:
    """Return empty frames with these identifiers."""
    count = len(numbers)
    return Frames(count, np.array(numbers), np.zeros(count, np.int64), np.zeros((count, 64), np.uint8))


@CALM
@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 3), st.booleans()), max_size=60))
def test_each_received_frame_is_read_once_among_sent_frames(ticks: list[tuple[int, int, bool]]):
    memory = Memory(4, 4096)
    reader, arrivals, came, seen = ArrivalReader(memory.shared), np.zeros(2, np.int64), [], []
    for number, (received, sent, is_looked_at) in enumerate(ticks):
        own = [2 * number + k for k in range(received)]
        note_arrivals(memory.shared, frames_of(*own), arrivals, 0)
        note_frames(memory.shared, frames_of(*[999] * sent), 0, 1)
        came += own
        if is_looked_at:
            seen += reader.take()["identifier"].tolist()
            assert seen == came
    seen += reader.take()["identifier"].tolist()
    assert seen == came
    memory.close()


def test_a_frame_counted_before_it_is_written_is_read_once_written():
    memory = Memory(4, 64)
    control, reader = memory.shared.control, ArrivalReader(memory.shared)
    note_arrivals(memory.shared, frames_of(7), np.zeros(1, np.int64), 0)
    control["frames"][0] -= 1  # the loop is held up between the two counts
    assert len(reader.take()) == 0
    assert len(reader.take()) == 0
    control["frames"][0] += 1
    assert reader.take()["identifier"].tolist() == [7]
    assert len(reader.take()) == 0
    memory.close()
