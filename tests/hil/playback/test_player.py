"""Replay onto a bus: every frame of every format in order, and failures of the bus."""

from __future__ import annotations

import uuid
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hil_support import frames_of

import liftgate_hil as lh
from liftgate_hil.codec.frames import EXTENDED, Frames, empty_frames, logged
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.open import open_writer
from liftgate_hil.loop.listener import Listener
from liftgate_hil.playback import player
from liftgate_hil.playback.player import Played, Player, Replay
from liftgate_hil.playback.selection import Selection
from liftgate_hil.signals import columns_of
from liftgate_hil.transport import find
from liftgate_hil.transport.base import LinkCounts
from liftgate_hil.transport.find import Way

SUFFIXES = (".log", ".asc", ".blf", ".trc", ".mf4", ".mcap")
FRAMES = [(0x100 + k % 5 if k % 7 else 0x18F00300 | EXTENDED, bytes([k, 1])) for k in range(60)]


def write(path: Path, frames: list[tuple[int, bytes]], is_sent: list[bool], step: float = 1e-3) -> Path:
    """Record frames, `step` s apart, with their directions; return the path."""
    rows = logged(frames_of(frames), 0, True)
    rows["time_ns"] = (np.arange(len(frames)) * step * 1e9).astype(np.int64) + 5_000_000
    rows["is_sent"] = is_sent
    recorder = open_writer(path, Content(columns_of(2), "can0"), is_salvaged=False)
    recorder.begin(0)
    recorder.write_frames(rows)
    recorder.close()
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write(tmp_path / "run.log", FRAMES, [True] * 60)


def play(path: Path, stopped: Any = lambda: False, **how: Any) -> tuple[Played, list[can.Message]]:
    """Play a recording onto a virtual bus; return the result and the messages on the bus."""
    channel = f"replay-{uuid.uuid4()}"
    with can.Bus(interface="virtual", channel=channel) as bus:
        way = Way({"interface": "virtual", "channel": channel}, None, how.pop("is_fd", False))
        told = Player(Replay(path, **how), way, Listener(), stopped, lambda seconds, end, sent: None)
        told.run()
        messages = []
        while (message := bus.recv(0.0)) is not None:
            messages.append(message)
    return told.played, messages


def sent_rows(messages: list[can.Message]) -> list[tuple[int, bytes]]:
    """Return identifier with flags and payload of each message."""
    return [(m.arbitration_id | (EXTENDED if m.is_extended_id else 0), bytes(m.data)) for m in messages]


@pytest.mark.filterwarnings("ignore")  # asammdf's own
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_frame_of_every_format_is_replayed_once_and_in_order(tmp_path: Path, suffix: str) -> None:
    if suffix in (".mf4", ".mcap"):
        pytest.importorskip({".mf4": "asammdf", ".mcap": "mcap"}[suffix])
    path = write(tmp_path / f"run{suffix}", FRAMES, [True] * len(FRAMES))
    played, messages = play(path)
    assert sent_rows(messages) == FRAMES
    assert (played.frames_sent, played.frames_not_sent, played.is_complete) == (60, 0, True)
    assert played.lateness.count == 60
    assert played.played_s == pytest.approx(0.059)


def test_without_a_direction_the_sent_frames_are_replayed_or_all_if_none_was_sent(tmp_path: Path) -> None:
    ways = [k % 3 == 0 for k in range(60)]
    path = write(tmp_path / "run.log", FRAMES, ways)
    _, messages = play(path)
    assert sent_rows(messages) == [each for each, is_sent in zip(FRAMES, ways, strict=True) if is_sent]
    _, messages = play(path, selection=Selection("received"))
    assert len(messages) == 40
    played, messages = play(write(tmp_path / "their.log", FRAMES, [False] * 60))
    assert (len(messages), played.direction) == (60, "both")


def test_several_rounds_of_a_replay_repeat_the_same_frames(tmp_path: Path) -> None:
    path = write(tmp_path / "run.log", FRAMES[:20], [True] * 20, 1e-4)
    played, messages = play(path, times=3, speed=2.0)
    assert sent_rows(messages) == FRAMES[:20] * 3
    assert (played.rounds, played.played_s) == (3, pytest.approx(3 * 19 * 0.5e-4))


def test_recordings_larger_than_the_ring_are_replayed_completely_in_each_round(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = player.empty_schedule
    monkeypatch.setattr(player, "empty_schedule", lambda places=16: small(places))
    path = write(tmp_path / "run.log", FRAMES, [True] * 60, 1e-5)
    _, messages = play(path, times=2)
    assert sent_rows(messages) == FRAMES * 2


def test_a_bad_recording_is_reported_before_the_bus_is_opened(tmp_path: Path, path: Path) -> None:
    way = Way({"interface": "nobody", "channel": "x"}, None, False)
    (tmp_path / "rows.csv").write_text("time_s,left_current_a\n0,1\n")
    for replay, said in (
        (Replay(path, Selection("received")), "no frame received in the recording"),
        (Replay(path, Selection(begin=9.0)), "no frame sent matches the selection"),
        (Replay(tmp_path / "rows.csv"), "holds only rows; allowed: a recording with frames"),
        (Replay(tmp_path / "none.log"), "no such file"),
    ):
        with pytest.raises(ConfigError) as caught:
            Player(replay, way, Listener(), lambda: False, lambda seconds, end, sent: None).run()
        assert said in str(caught.value)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"speed": 0.0}, "`speed` 0.0: allowed: 0.001 to 1000"),
        ({"times": 0}, "`times` 0: allowed: a whole number from 1 to"),
        ({"times": 2, "loop": True}, "`times` 2: not allowed with `loop`"),
        ({"realtime": False, "cpu": 0}, "`cpu` 0: allowed: together with `realtime`"),
        ({"direction": "up"}, "`direction` 'up': allowed: one of sent, received, both"),
        ({"from_s": 3.0, "to_s": 2.0}, "`from_s` 3: not before `to_s` 2"),
        ({"only": "Nobody"}, "`only` Nobody"),
        ({"without": "Nobody"}, "`without` Nobody"),
        ({"serial": "loop://"}, "`serial` and `bus`"),
    ],
)
def test_contradictory_or_invalid_replay_options_are_refused(path: Path, how: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        lh.replay(path, bus="virtual:refused", **how)
    assert said in str(caught.value)


def test_a_recording_is_played_from_python(path: Path) -> None:
    with can.Bus("python", interface="virtual", receive_own_messages=False) as bus:
        played = lh.replay(path, bus="virtual:python", speed=10.0, rig="liftgate")
        assert (played.frames_sent, played.is_complete, played.stop_reason) == (60, True, "end")
        assert bus.recv(0.0) is not None
    assert played.to_dict()["provenance"]["sources"]["recording"]["path"] == str(path)


class Wire:
    """A transport that cannot send frames whose first byte is in `lost`, and keeps that of the others."""

    name, is_up = "wire", True

    def __init__(self, lost: range) -> None:
        self._lost = lost
        self.seen: list[int] = []
        self._failed = 0
        self.came_ns = np.zeros(0, dtype=np.int64)

    def receive(self, timeout: float = 0.0) -> Frames:
        return empty_frames(0)

    def send(self, frames: Frames) -> None:
        for row in range(frames.count):
            number = int(frames.data[row, 0])
            if number in self._lost:
                self._failed += 1
            else:
                self.seen.append(number)

    def counts(self) -> LinkCounts:
        return LinkCounts(send_failures=self._failed)

    def close(self) -> None:
        pass


def test_a_bus_lost_for_a_while_loses_only_the_frames_due_meanwhile(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wire = Wire(range(20, 30))
    monkeypatch.setattr(find, "open_transport", lambda way: wire)
    way = Way({"interface": "any", "channel": "x"}, None, False)
    course: list[tuple[float, float, int]] = []
    told = Player(Replay(path), way, Listener(), lambda: False, lambda *where: course.append(where))
    told.run()
    ends = {end for _, end, _ in course}
    assert ends == {told.played.played_s}  # all of it fits into the ring, so that its end is known at once
    assert all(0.0 <= seconds <= end and sent <= 60 for seconds, end, sent in course)
    assert wire.seen == [*range(20), *range(30, 60)]
    played = told.played
    assert (played.frames_due, played.frames_sent, played.frames_not_sent) == (60, 50, 10)
    assert played.lateness.count == 50
    assert "not sent: 10 frames" in played.lines()


def test_a_replay_stops_on_request_and_reports_the_frames_sent_so_far(tmp_path: Path) -> None:
    path = write(tmp_path / "run.log", FRAMES, [True] * 60, 10.0)
    asked = 0

    def stopped() -> bool:
        nonlocal asked
        asked += 1
        return asked > 5

    played, messages = play(path, stopped)
    assert not played.is_complete
    assert played.frames_sent == len(messages) < 60
