"""Lockstep: the commands of an ECU are the clock, whatever other frames are on the bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from hil_support import COMMAND, GATE, frames_of, loop_config, panel_frame, rows_of
from loop_fakes import Memory, Notes, Rows, command, loop_of, never

from liftgate_hil.codec.frames import FD, REMOTE, Frames, empty_frames
from liftgate_hil.codec.receive import NO_COUNTS
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import OverrunError
from liftgate_hil.loop.lockstep import Lockstep, Waiting, run_lockstep
from liftgate_hil.loop.python_loop import Loop
from liftgate_hil.plan.setup import rig_from
from liftgate_hil.transport.base import LinkCounts

PERIOD = Lockstep(COMMAND, 10)


def used_up(loop: Loop, transport: Memory) -> Callable[[], bool]:
    """Return a stop check that is true once nothing is left to read and time stands still."""
    seen = -1

    def stopped() -> bool:
        nonlocal seen
        before, seen = seen, loop.state.tick
        return not transport.batches and seen == before

    return stopped


def lockstep(rig: Rig, batches: Sequence[Rows], ticks: int | None = None) -> tuple[Loop, Notes]:
    """Run in lockstep until all batches are read, the first of which is there at the start."""
    first, *later = batches
    transport, notes = Memory([first, [], *later]), Notes()
    loop = loop_of(transport, loop_config(rig=rig), sinks=[notes])
    run_lockstep(loop, PERIOD, ticks, used_up(loop, transport))
    return loop, notes


def test_each_command_advances_one_command_period(rig: Rig):
    loop, notes = lockstep(rig, [[command(rig, n)] for n in range(6)] + [[]])
    assert loop.state.tick == 60
    assert loop.state.counts.accepted == 6
    assert [number for number, rows in enumerate(notes.received) if rows] == [0, 10, 20, 30, 40, 50]


def test_several_commands_in_one_read_each_get_their_own_period(rig: Rig):
    first, *later = (command(rig, n) for n in range(5))
    loop, notes = lockstep(rig, [[first], later, []])
    assert loop.state.tick == 50
    assert [rows for rows in notes.received if rows] == [[command(rig, n)] for n in range(5)]
    assert loop.state.timeouts == 0


def test_other_frames_are_processed_with_the_command_that_follows_them(rig: Rig):
    panel = panel_frame(rig, HandForce=10.0)
    batches: list[Rows] = [
        [command(rig, 9)],
        [panel],
        [(0x55, b"a")],
        [],
        [(0x56, b"b"), command(rig, 0)],
        [],
        [(0x57, b"c"), command(rig, 1), (0x58, b"d")],
        [(COMMAND | REMOTE, b"")],
        [command(rig, 2)],
        [(0x59, b"e")],
        [],
    ]
    loop, notes = lockstep(rig, batches)
    assert loop.state.tick == 40
    assert [rows for rows in notes.received if rows] == [
        [command(rig, 9)],
        [panel, (0x55, b"a"), (0x56, b"b"), command(rig, 0)],
        [(0x57, b"c"), command(rig, 1)],
        [(0x58, b"d"), (COMMAND | REMOTE, b""), command(rig, 2)],
    ]


def test_without_a_command_lockstep_time_stands_still(rig: Rig):
    loop, _ = lockstep(rig, [[(0x55, b"a")], [panel_frame(rig)], []] * 5)
    assert loop.state.tick == 0


def test_frames_from_before_a_lockstep_run_are_dropped_and_counted(rig: Rig):
    batches: list[Rows] = [
        [(0x55, b"a"), command(rig, 0), command(rig, 1)],
        [command(rig, n) for n in range(2, 300)],  # more than is read at once
        [panel_frame(rig, HandForce=10.0), command(rig, 300), (0x56, b"b")],
        *[[], [], []],
        [(0x57, b"c"), command(rig, 301)],
    ]
    transport, notes = Memory(batches), Notes()
    loop = loop_of(transport, loop_config(rig=rig), sinks=[notes], command=COMMAND)
    loop.begin(is_first=True)
    run_lockstep(loop, PERIOD, None, used_up(loop, transport))
    assert loop.state.tick == 20  # a period without a command, for an ECU that waits for an answer
    assert [rows for rows in notes.received if rows] == [[(0x57, b"c"), command(rig, 301)]]
    assert loop.summary("lockstep").link == LinkCounts(before_start=304)


class Answering:
    """Wire to an ECU that answers each `Gate` frame with one command, and sent `said` frames before the run."""

    name = "answering"
    is_up = True

    def __init__(self, rig: Rig, said: int) -> None:
        self._rig = rig
        self.sent = 0
        self.under_way: Rows = []
        self.most = 0  # commands under way after an answer
        for _ in range(said):
            self._say()

    def _say(self) -> None:
        self.under_way.append(command(self._rig, self.sent))
        self.sent += 1

    def receive(self, timeout: float = 0.0) -> Frames:
        rows, self.under_way = self.under_way[:1], self.under_way[1:]
        return frames_of(rows)

    def send(self, frames: Frames) -> None:
        for row, _ in rows_of(frames):
            if row == GATE:
                self._say()
                self.most = max(self.most, len(self.under_way))

    def counts(self) -> LinkCounts:
        return LinkCounts()

    def close(self) -> None:
        pass


@pytest.mark.parametrize("said", [1, 2, 7, 300])
def test_an_ecu_answering_each_frame_never_has_two_commands_pending(rig: Rig, said: int):
    ecu = Answering(rig, said)
    loop = loop_of(ecu, loop_config(rig=rig), command=COMMAND)
    loop.begin(is_first=True)
    run_lockstep(loop, PERIOD, 200, never)
    assert loop.state.tick == 200
    assert ecu.most == 1
    assert loop.state.counts == NO_COUNTS._replace(accepted=19)
    assert loop.before_start == said
    assert loop.state.timeouts == 0


class Silence(Memory):
    """A wire, silent but for `rows` by the number of a waiting read, and the clock that waiting on it advances."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, rows: dict[int, Rows]) -> None:
        super().__init__()
        self.now = 100.0
        self._reads = 0
        self._rows = rows  # by the number of the waiting read
        monkeypatch.setattr("liftgate_hil.loop.lockstep.time", self)

    def monotonic(self) -> float:
        return self.now

    def receive(self, timeout: float = 0.0) -> Frames:
        if timeout == 0.0:
            return empty_frames(0)
        self.now += timeout
        self._reads += 1
        return frames_of(self._rows.get(self._reads - 1, []))


def test_lockstep_reports_that_it_is_ready_and_the_awaited_message(rig: Rig, monkeypatch: pytest.MonkeyPatch):
    wire = Silence(monkeypatch, {50: [command(rig, 0)]})
    loop = loop_of(wire, loop_config(rig=rig))
    said: list[str] = []
    run_lockstep(loop, PERIOD._replace(say=said.append), None, lambda: wire.now > 110.0)
    # Once for each silence, not at every look.
    assert said == [
        "ready: waits for the first command",
        "0.000 s: waits for a command (0x120); `wall_timeout` limits the wait",
        "0.010 s: waits for a command (0x120); `wall_timeout` limits the wait",
    ]


def test_a_short_silence_is_not_reported(rig: Rig, monkeypatch: pytest.MonkeyPatch):
    wire = Silence(monkeypatch, {n: [command(rig, n)] for n in range(0, 100, 15)})
    said: list[str] = []
    loop = loop_of(wire, loop_config(rig=rig))
    run_lockstep(loop, PERIOD._replace(say=said.append), None, lambda: wire.now > 110.0)
    assert said == ["ready: waits for the first command"]
    assert loop.state.tick == 70


@pytest.mark.parametrize(("last", "model_time"), [(None, "0.000 s"), (20, "0.010 s")])
def test_lockstep_gives_up_after_its_wall_timeout_without_a_command(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, last: int | None, model_time: str
):
    # Frames that are no commands don't count.
    rows = {n: [panel_frame(rig)] for n in range(200)}
    if last is not None:
        rows[last] = [command(rig, 0)]
    wire = Silence(monkeypatch, rows)
    loop = loop_of(wire, loop_config(rig=rig))
    with pytest.raises(OverrunError, match=rf"no command for 5 s at {model_time}.*allowed"):
        run_lockstep(loop, PERIOD._replace(wall_timeout=5.0), None, never)
    assert wire.now == pytest.approx(105.1 + (0.0 if last is None else 0.1 * (last + 1)), abs=0.11)


def test_the_time_that_ticks_take_does_not_count_as_silence(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    wire = Silence(monkeypatch, {n: [command(rig, n)] for n in range(3)})
    loop, said = loop_of(wire, loop_config(rig=rig)), list[str]()
    advance = loop.advance_by

    def slowly(frames: Frames, ticks: int) -> None:
        advance(frames, ticks)
        wire.now += 60.0

    monkeypatch.setattr(loop, "advance_by", slowly)
    run_lockstep(loop, PERIOD._replace(wall_timeout=5.0, say=said.append), 30, never)
    assert said == ["ready: waits for the first command"]


@pytest.mark.parametrize("at_once", [False, True])
@pytest.mark.parametrize("ticks", [10, 20, 25])
def test_lockstep_ends_at_its_duration(rig: Rig, at_once: bool, ticks: int):
    first, *later = (command(rig, n) for n in range(6))
    batches = [[first], later] if at_once else [[first], *([each] for each in later)]
    loop, _ = lockstep(rig, [*batches, []], ticks)
    assert loop.state.tick == ticks


def test_lockstep_does_not_depend_on_how_frames_are_batched(rig: Rig):
    rows = [row for n in range(30) for row in (command(rig, n), panel_frame(rig, HandForce=n))]
    one, _ = lockstep(rig, [[row] for row in rows] + [[]])
    all_, _ = lockstep(rig, [rows[:1], rows[1:], []])
    assert one.state.plant == all_.state.plant
    assert one.state.tick == all_.state.tick == 300


def test_lockstep_advances_on_can_fd_commands_too():
    rig = rig_from(str(Path(__file__).parents[2] / "system/foreign/foreign.toml"))
    message = rig.messages["KlappeSoll"]
    payload = message.encode(
        {"SpannungLinks": 0.5, "SpannungRechts": 0.5, "BrueckeLinks": 5, "BrueckeRechts": 5,
         "Schloss": 12}
    )  # fmt: skip
    transport = Memory([[(rig.command_identifier() | FD, payload)], []] * 4)
    loop = loop_of(transport, loop_config(rig=rig))
    run_lockstep(loop, Lockstep(rig.command_identifier(), 10), None, used_up(loop, transport))
    assert loop.state.tick == 40
    assert loop.state.counts == NO_COUNTS._replace(accepted=4)
    assert loop.state.plant.left.speed > 0.0


FOREIGN = (0x55, bytes(8))


class Wire(Memory):
    """A wire that gives a limited number of frames at each read, as buses do."""

    def __init__(self, rows: Rows) -> None:
        super().__init__([rows[start : start + 256] for start in range(0, len(rows), 256)])


class Refilled(Wire):
    """A wire that at each round of reads has a flood of frames followed by a command."""

    def __init__(self, rig: Rig) -> None:
        super().__init__([])
        self._rig = rig
        self.rounds = 0

    def receive(self, timeout: float = 0.0) -> Frames:
        if timeout > 0.0:
            self.rounds += 1
            self.batches = Wire([FOREIGN] * 9000 + [command(self._rig, self.rounds)]).batches
        return super().receive(timeout)


def test_a_command_after_a_flood_of_other_frames_is_read_in_the_same_round(rig: Rig):
    wire = Refilled(rig)
    loop = loop_of(wire, loop_config(rig=rig))
    run_lockstep(loop, PERIOD, 50, never)
    assert wire.rounds == 5  # all of it in one each
    assert loop.state.counts.accepted == 5
    assert loop.state.counts.foreign == 5 * 9000


class Flooded(Wire):
    """A wire that is never empty: each read gives a command among other frames."""

    def __init__(self, rig: Rig) -> None:
        super().__init__([])
        self._rig = rig
        self.reads = 0

    def receive(self, timeout: float = 0.0) -> Frames:
        self.reads += 1
        return frames_of([FOREIGN, command(self._rig, self.reads)])


def test_an_endless_flood_keeps_lockstep_neither_from_ticking_nor_from_stopping(rig: Rig):
    wire = Flooded(rig)
    loop = loop_of(wire, loop_config(rig=rig))
    run_lockstep(loop, PERIOD, None, lambda: loop.state.tick >= 300)
    assert loop.state.tick == 300
    assert wire.reads <= 18 * 64 + 30  # the first round, and one a command


def test_frames_kept_for_a_silent_ecu_are_limited_in_number(rig: Rig, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("liftgate_hil.loop.lockstep._MOST", 1000)
    wire = Wire([FOREIGN] * 2560 + [(0x56, b"")] * 900 + [command(rig, 0)])
    loop = loop_of(wire, loop_config(rig=rig))
    run_lockstep(loop, PERIOD, None, lambda: loop.state.tick > 0)
    kept = loop.state.counts.foreign
    assert 900 <= kept <= 1000
    assert loop.summary("lockstep").link == LinkCounts(dropped=2560 + 900 - kept)


def test_waiting_frames_are_processed_in_order_of_arrival():
    waiting = Waiting(COMMAND)
    waiting.add(frames_of([(1, b"a"), (2, b"b"), (COMMAND, b"c"), (COMMAND | FD, b"d"), (3, b"e")]))
    waiting.add(empty_frames(3))
    waiting.add(frames_of([(COMMAND, b"f"), (4, b"g")]))
    assert [rows_of(each) for each in waiting.commands] == [
        [(1, b"a"), (2, b"b"), (COMMAND, b"c")],
        [(COMMAND | FD, b"d")],
        [(3, b"e"), (COMMAND, b"f")],
    ]


class Echoing(Memory):
    """A bus that returns a node's own frames to it, from a queue of limited size."""

    def __init__(self, batches: Sequence[Rows]) -> None:
        super().__init__(batches)
        self.most = 0
        self._unread = 0

    def send(self, frames: Frames) -> None:
        super().send(frames)
        self._unread += frames.count
        self.most = max(self.most, self._unread)

    def receive(self, timeout: float = 0.0) -> Frames:
        self._unread = 0
        return super().receive(timeout)


def test_queued_commands_are_processed_before_echoes_of_own_frames_fill_the_queue(rig: Rig):
    first, *later = (command(rig, n % 16) for n in range(200))
    transport = Echoing([[first], [], later])
    loop = loop_of(transport, loop_config(rig=rig))
    run_lockstep(loop, PERIOD, None, used_up(loop, transport))
    assert loop.state.tick == 2000
    assert transport.most < 20
