"""The bus trace of a page: the latest frames, each once."""

from __future__ import annotations

import numpy as np
import pytest

from liftgate_hil.codec.frames import LOGGED, no_logged
from liftgate_hil.dashboard import heard
from liftgate_hil.dashboard.heard import FrameTrace


def frames(*times: int) -> np.ndarray:
    found = np.zeros(len(times), dtype=LOGGED)
    found["time_ns"] = times
    return found


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch) -> FrameTrace:
    """A trace of ten frames, of which six fit into one reply."""
    monkeypatch.setattr(heard, "_KEPT", 10)
    monkeypatch.setattr(heard, "MOST_FRAMES", 6)
    return FrameTrace()


def after(kept: FrameTrace, number: int) -> tuple[int, list[int]]:
    first, found = kept.after(number)
    return first, found["time_ns"].tolist()


def test_the_frames_after_a_given_number_are_returned_in_order(kept: FrameTrace) -> None:
    assert after(kept, 0) == (1, [])
    kept.keep(frames(10, 20))
    kept.keep(no_logged())
    kept.keep(frames(30))
    assert after(kept, 0) == (1, [10, 20, 30])
    assert after(kept, 1) == (2, [20, 30])
    assert after(kept, 3) == (4, [])
    kept.keep(frames(40))
    assert after(kept, 3) == (4, [40])


def test_a_reply_that_is_full_has_the_latest_frames_and_the_number_of_the_first(kept: FrameTrace) -> None:
    kept.keep(frames(*range(1, 10)))
    assert after(kept, 0) == (4, [4, 5, 6, 7, 8, 9])
    assert after(kept, 2) == (4, [4, 5, 6, 7, 8, 9])
    assert after(kept, 6) == (7, [7, 8, 9])


def test_the_oldest_frames_are_dropped_from_a_full_trace(kept: FrameTrace) -> None:
    for k in range(1, 101):
        kept.keep(frames(k))
    assert len(kept._blocks) == 10
    assert after(kept, 0) == (95, [95, 96, 97, 98, 99, 100])


def test_a_frame_number_beyond_the_last_gives_no_frames(kept: FrameTrace) -> None:
    kept.keep(frames(1, 2))
    assert after(kept, 50) == (3, [])
