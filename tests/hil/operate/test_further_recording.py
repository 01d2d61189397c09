"""Recordings started and stopped during a run, with a real recorder process and real files."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from recording_support import rows_from, table_in

from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.errors import ConfigError, RecordingError
from liftgate_hil.formats.open import holds_nothing
from liftgate_hil.loop.listener import Listener
from liftgate_hil.loop.rings import Memory
from liftgate_hil.operate.further_recording import RECORDING, STARTING, FurtherRecording
from liftgate_hil.plan.plan import Plan, plan_of
from liftgate_hil.plan.request import Job, RunRequest

EPOCH_NS = 1_700_000_000_000_000_000


@pytest.fixture
def memory() -> Iterator[Memory]:
    found = Memory(4096, 4096)
    found.shared.control.epoch_ns = EPOCH_NS
    yield found
    found.close()


def plan(folder: Path, *record: str) -> Plan:
    files = [folder / each for each in record]
    request = RunRequest("demo", ON_A_BUS, "realtime", record=files, bus="virtual:further")
    return plan_of(Job(request, request))


def put(memory: Memory, first: int, count: int) -> None:
    """Put rows, numbered from `first` on, into the ring."""
    rows, control = rows_from(first, count), memory.shared.control
    for row in rows:
        memory.shared.rows[int(control.rows[0]) % len(memory.shared.rows)] = row
        control.rows += 1


def until(recording: FurtherRecording, phase: str | None) -> None:
    """Wait until the recording is in this phase; None: until no recording is open."""
    deadline = time.monotonic() + 60
    while (state := recording.in_force()) is not None or phase is not None:
        if state is not None and state["phase"] == phase:
            return
        assert time.monotonic() < deadline, state
        time.sleep(0.005)


class Heard(Listener):
    """Keeps the messages of a run, and which of them are alarms."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.alarms: list[str] = []

    def say(self, text: str) -> None:
        self.said.append(text)

    def alarm(self, text: str) -> None:
        self.alarms.append(text)
        super().alarm(text)


class Bench:
    """A further recording, with its messages and the marks that it gives to the run's own recordings."""

    def __init__(self, memory: Memory, folder: Path, *record: str) -> None:
        self.heard = Heard()
        self.said = self.heard.said
        self.marks: list[tuple[float, str]] = []
        own = plan(folder, *record)
        self.recording = FurtherRecording(own, "can0", "virtual", memory, self.heard, self.mark)

    def mark(self, time_s: float, text: str) -> bool:
        self.marks.append((time_s, text))
        return True


@pytest.fixture
def bench(memory: Memory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.chdir(tmp_path)
    found = Bench(memory, tmp_path)
    yield found
    found.recording.close()


def test_a_further_recording_holds_the_rows_between_start_and_stop_and_the_marks(
    bench: Bench, memory: Memory, tmp_path: Path
) -> None:
    from asammdf import MDF

    recording = bench.recording
    put(memory, 0, 10)
    recording.start("part.mf4")
    assert recording.in_force() == {"file": "part.mf4", "phase": STARTING}
    recording.mark(0.0045, "early")  # before it records: kept until then
    put(memory, 10, 2)
    until(recording, RECORDING)
    put(memory, 12, 3)
    recording.mark(0.0125, "here")
    recording.stop()
    put(memory, 15, 10)
    until(recording, None)
    assert recording.files == [str(tmp_path / "part.mf4")]
    assert table_in(tmp_path / "part.mf4")["time_s"] == pytest.approx(rows_from(10, 5)[:, 0])
    with MDF(tmp_path / "part.mf4") as measured:
        marks = [(each.name, each.value) for each in measured.events]
        assert marks == [("early", pytest.approx(0.0045)), ("here", pytest.approx(0.0125))]
        assert b'"seed"' in measured.extract_attachment(0)[0]  # the provenance
    assert bench.said == [
        "record part.mf4: recording from 0.010 s on",
        f"recorded: {tmp_path / 'part.mf4'}, 0.010 to 0.014 s",
    ]
    recording.start("next.csv")
    until(recording, RECORDING)
    put(memory, 25, 2)
    recording.close()
    assert len(table_in(tmp_path / "next.csv")["time_s"]) == 2


def test_a_further_recording_ends_where_it_was_stopped_even_before_its_process_was_ready(
    bench: Bench, memory: Memory, tmp_path: Path
) -> None:
    """Rows that come while its process starts, or completes the file, do not belong to it."""
    bench.recording.prepare()
    put(memory, 0, 3)
    bench.recording.start("x.csv")
    put(memory, 3, 4)
    bench.recording.stop()
    put(memory, 7, 9)
    until(bench.recording, None)
    assert table_in(tmp_path / "x.csv")["time_s"] == pytest.approx(rows_from(3, 4)[:, 0])
    assert bench.said[-1] == f"recorded: {tmp_path / 'x.csv'}, 0.003 to 0.006 s"


def test_a_spare_recorder_that_has_ended_is_replaced(bench: Bench, memory: Memory, tmp_path: Path) -> None:
    bench.recording.prepare()
    spare = bench.recording._spare
    assert spare is not None
    spare._process.kill()
    spare._process.wait()
    bench.recording.start("x.csv")
    put(memory, 0, 4)
    bench.recording.stop()
    until(bench.recording, None)
    assert len(table_in(tmp_path / "x.csv")["time_s"]) == 4


def test_a_spare_recorder_ends_with_its_run(bench: Bench, tmp_path: Path) -> None:
    bench.recording.prepare()
    spare = bench.recording._spare
    assert spare is not None
    bench.recording.close()
    assert not spare.is_there
    assert list(tmp_path.iterdir()) == []
    bench.recording.prepare()
    assert bench.recording._spare is None


def test_lost_rows_of_a_further_recording_are_reported(bench: Bench, memory: Memory, tmp_path: Path) -> None:
    """As its process starts, more rows come than the rings hold."""
    bench.recording.start("x.csv")
    put(memory, 0, 5000)
    bench.recording.stop()
    until(bench.recording, None)
    assert bench.said[-1].endswith("x.csv, 0.905 to 4.999 s; 905 rows and frames lost")


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "../x.csv", "/tmp/x.csv", "a/b.csv", "x", "x.txt", "x.csv\n", ".x.csv", "a\\b.csv", 7, None],
)
def test_a_recording_name_with_a_folder_or_an_unknown_suffix_is_refused(bench: Bench, name: object) -> None:
    with pytest.raises(ConfigError, match="allowed: "):
        bench.recording.start(name)
    assert bench.recording.in_force() is None


def test_a_further_recording_replaces_no_file(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("mine")
    with pytest.raises(ConfigError, match=r"x\.csv already exists: choose another name"):
        bench.recording.start("x.csv")
    assert (tmp_path / "x.csv").read_text() == "mine"


def test_one_recording_is_open_at_a_time_and_cannot_be_stopped_twice(bench: Bench) -> None:
    with pytest.raises(ConfigError, match="no recording is open"):
        bench.recording.stop()
    bench.recording.start("x.csv")
    with pytest.raises(ConfigError, match=r"x\.csv is open"):
        bench.recording.start("y.csv")
    until(bench.recording, RECORDING)
    bench.recording.stop()
    with pytest.raises(ConfigError, match="no recording is open"):
        bench.recording.stop()


@pytest.mark.parametrize("text", ["", "x" * 201, "two\nlines", None, 3])
def test_a_mark_is_1_to_200_printable_characters(bench: Bench, text: object) -> None:
    with pytest.raises(ConfigError, match="1 to 200 printable characters"):
        bench.recording.mark(1.0, text)


def test_a_mark_needs_an_open_recording_that_can_hold_it(bench: Bench) -> None:
    with pytest.raises(ConfigError, match=r"no recording is open that holds marks; allowed: in \.mf4"):
        bench.recording.mark(1.0, "x")
    bench.recording.start("x.csv")
    until(bench.recording, RECORDING)
    with pytest.raises(ConfigError, match="no recording is open that holds marks"):
        bench.recording.mark(1.0, "x")


def test_marks_go_to_the_runs_own_recording_and_further_files_to_its_folder(
    memory: Memory, tmp_path: Path
) -> None:
    (tmp_path / "own").mkdir()
    bench = Bench(memory, tmp_path / "own", "run.mf4")
    bench.recording.mark(1.0, "x")
    assert bench.marks == [(1.0, "x")]
    bench.recording.start("y.csv")
    until(bench.recording, RECORDING)
    bench.recording.close()
    assert (tmp_path / "own" / "y.csv").is_file()
    assert bench.recording.in_force() is None


def test_a_further_recording_not_ready_in_time_is_reported_and_another_can_be_started(
    bench: Bench, memory: Memory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("liftgate_hil.isolate.recorder_process._READY_S", 0.0)
    bench.recording.start("x.csv")
    until(bench.recording, None)
    assert "x.csv" in bench.said[0]
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    bench.recording.start("y.csv")
    until(bench.recording, RECORDING)


def process_of(bench: Bench) -> int:
    assert bench.recording._process is not None
    return bench.recording._process._process.pid


def test_marks_for_a_stalled_recorder_are_refused_without_waiting(bench: Bench) -> None:
    """Once the recorder's pipe is full, marks are refused without waiting."""
    bench.recording.start("x.mf4")
    until(bench.recording, RECORDING)
    os.kill(process_of(bench), signal.SIGSTOP)
    try:
        with pytest.raises(ConfigError, match="does not keep up"):
            [bench.recording.mark(1.0, "x" * 200) for _ in range(2000)]
    finally:
        os.kill(process_of(bench), signal.SIGCONT)


def test_rows_lost_by_a_slow_recorder_are_reported_even_if_no_row_is_left(bench: Bench, memory: Memory) -> None:
    """The machine stands still, and the loop catches up by more rows than the rings hold."""
    bench.recording.start("x.csv")
    until(bench.recording, RECORDING)
    pid = process_of(bench)
    os.kill(pid, signal.SIGSTOP)
    put(memory, 0, 10)
    bench.recording.stop()
    memory.shared.control.rows += 2 * len(memory.shared.rows)
    os.kill(pid, signal.SIGCONT)
    until(bench.recording, None)
    assert bench.said[-1].endswith("x.csv, without rows; 10 rows and frames lost")


def test_a_further_recording_ends_when_its_recorder_is_killed(bench: Bench) -> None:
    bench.recording.start("x.mf4")
    until(bench.recording, RECORDING)
    os.kill(process_of(bench), signal.SIGKILL)
    until(bench.recording, None)
    assert ["ended from outside" in each for each in bench.heard.alarms] == [True]
    assert bench.heard.alarms[0] in bench.said
    with pytest.raises(ConfigError, match="no recording is open"):
        bench.recording.mark(1.0, "x")
    bench.recording.start("y.csv")
    until(bench.recording, RECORDING)


@pytest.mark.parametrize(
    ("name", "words"),
    [("ü" * 150 + ".csv", "allowed: a file name, without a folder"), ("dangling.csv", "already exists")],
)
def test_a_name_too_long_or_a_link_to_elsewhere_is_refused(
    bench: Bench, tmp_path: Path, name: str, words: str
) -> None:
    (tmp_path / "dangling.csv").symlink_to(tmp_path / "elsewhere" / "x.csv")
    with pytest.raises(ConfigError, match=words):
        bench.recording.start(name)


def test_a_full_disk_ends_a_further_recording_and_is_reported_once(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = f"`record` {tmp_path / 'x.csv'}: recording ended: No space left on device"

    class Full:
        files: list[str] = []  # noqa: RUF012
        is_there = True

        def __init__(self, *_: object) -> None:
            self.say: Any = None

        def order(self, *_: object, say: Any, **more: object) -> None:
            self.say = say

        def end_at(self, place: object) -> None:
            pass

        def wait_until_ready(self) -> None:
            self.say(text)

        def close(self) -> None:
            if self.say is not None:
                raise RecordingError(text)

    monkeypatch.setattr("liftgate_hil.operate.further_recording.RecorderProcess", Full)
    bench.recording.start("x.csv")
    until(bench.recording, None)
    assert bench.said == ["record x.csv: recording ended: No space left on device"]


def test_a_recording_stopped_before_its_first_row_can_be_read(bench: Bench, tmp_path: Path) -> None:
    for suffix in (".mcap", ".mf4", ".csv"):
        bench.recording.start(f"none{suffix}")
        until(bench.recording, RECORDING)
        bench.recording.stop()
        until(bench.recording, None)
        assert holds_nothing(tmp_path / f"none{suffix}")


def test_a_note_too_long_for_a_mark_is_truncated(memory: Memory, tmp_path: Path) -> None:
    bench = Bench(memory, tmp_path, "run.mf4")
    assert bench.recording.note(1.0, "é" * 5000)
    assert bench.marks == [(1.0, "é" * 199 + "…")]
