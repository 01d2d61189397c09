"""Selection of the frames of a recording to replay, and their due times."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hil_support import CALM, frames_of, shipped_rig
from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.codec.frames import ERROR, EXTENDED, FD, logged
from liftgate_hil.errors import ConfigError
from liftgate_hil.playback.selection import DueTimes, Selection, identifiers_of, playable

NS = 1_000_000_000


def recorded(times: list[float], identifiers: list[int] | None = None, sent: bool = True) -> Any:
    """Return frames of a recording at these times [s]."""
    frames = logged(frames_of([(each, b"") for each in identifiers or [0x100] * len(times)]), 0, sent)
    frames["time_ns"] = np.round(np.array(times) * 1e9)
    return frames


@given(
    times=st.lists(st.floats(0.0, 50.0), min_size=1, max_size=40),
    cut=st.integers(0, 40),
    speed=st.sampled_from([0.5, 1.0, 3.0]),
)
@CALM
def test_frames_are_due_at_their_recorded_intervals_for_any_blocks(
    times: list[float], cut: int, speed: float
) -> None:
    times = sorted(times)
    frames = recorded(times)
    course = DueTimes(speed)
    parts = [part for part in (frames[:cut], frames[cut:]) if len(part)]
    due = np.concatenate([course.due(part) for part in parts])
    assert due == pytest.approx((frames["time_ns"] - frames["time_ns"][0]) / speed, abs=1.0)
    assert course.set_back == 0


def test_due_times_count_from_the_given_begin_and_not_from_the_first_frame() -> None:
    assert DueTimes(begin=2.0).due(recorded([2.5, 3.0])).tolist() == [NS // 2, NS]


def test_a_frame_with_an_earlier_timestamp_is_due_at_once_and_shifts_no_later_frame() -> None:
    assert DueTimes().due(recorded([0.0, 1.0, 0.95, 2.0])).tolist() == [0, NS, NS, 2 * NS]


def test_replay_time_continues_where_the_loggers_clock_was_set_back() -> None:
    course = DueTimes()
    first = course.due(recorded([100.0, 101.0, 95.0, 96.0]))
    assert first.tolist() == [0, NS, NS, 2 * NS]
    assert course.due(recorded([97.0, 90.0])).tolist() == [3 * NS, 3 * NS]
    assert course.set_back == 2


def test_each_round_of_a_replay_begins_where_the_previous_one_ends() -> None:
    course = DueTimes(2.0)
    assert course.due(recorded([1.0, 2.0])).tolist() == [0, NS // 2]
    course.begin_again()
    assert course.due(recorded([1.0, 2.0])).tolist() == [NS // 2, NS]
    course = DueTimes(begin=1.0, end=5.0)
    course.due(recorded([2.0, 3.0]))
    course.begin_again()
    assert course.due(recorded([2.0])).tolist() == [5 * NS]


def test_a_round_that_takes_no_time_cannot_be_repeated() -> None:
    course = DueTimes()
    course.due(recorded([1.0, 1.0]))
    with pytest.raises(ConfigError, match="all frames have the same time"):
        course.begin_again()


def test_frames_are_chosen_by_time_direction_and_identifier() -> None:
    sent = recorded([0.0, 1.0, 2.0, 3.0], [0x100, 0x200, 0x100 | EXTENDED, 0x300])
    received = recorded([1.5], [0x100], sent=False)
    blocks = [sent, received]

    def left(**how: Any) -> list[float]:
        return [float(t) * 1e-9 for part in Selection(**how).of(iter(blocks)) for t in part["time_ns"]]

    assert left() == [0.0, 1.0, 2.0, 3.0, 1.5]
    assert left(direction="received") == [1.5]
    assert left(direction="sent", begin=1.0, end=2.0) == [1.0, 2.0]
    assert left(only=((0x100, 0x1FF),)) == [0.0, 2.0, 1.5]
    assert left(only=((0x100, 0x1FF),), without=((0x100, 0x100),)) == []
    assert left(without=((0x200, 0x300),)) == [0.0, 2.0, 1.5]


def test_identifiers_are_selected_by_number_range_or_message_name() -> None:
    messages = shipped_rig().messages
    given_ = ["0x7E0-0x7EF", "DriveCommand", "0x18F00311"]
    assert identifiers_of("only", given_, messages) == (
        (0x7E0, 0x7EF), (0x120, 0x120), (0x18F00311, 0x18F00311),
    )  # fmt: skip
    with pytest.raises(ConfigError) as caught:
        identifiers_of("except", ["120", "0x30-0x20", "Nobody", "0x20000000", "0x"], messages)
    assert len(caught.value.issues) == 5
    assert caught.value.issues[0].startswith("`except` 120: allowed: 0x0 to 0x1FFFFFFF")


def test_error_frames_are_left_out_and_can_fd_frames_need_a_can_fd_bus() -> None:
    frames = recorded([0.0, 1.0], [0x100, ERROR | 0x80])
    kept, left_out = playable(frames, False)
    assert (kept["identifier"].tolist(), left_out) == ([0x100], 1)
    fd = recorded([0.0, 1.0], [0x100, 0x100 | FD])
    with pytest.raises(ConfigError, match=r"the frame at 1\.000000 s is CAN FD; allowed: with `is_fd`"):
        playable(fd, False)
    assert len(playable(fd, True)[0]) == 2
