"""`liftgate-hil ecu`: reports on frames that its process did not read in time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from liftgate_hil.drive.ecu_alone import _Losses


def test_dropped_frames_are_reported_once_and_only_if_dropped_after_the_start():
    said: list[str] = []
    peer: Any = SimpleNamespace(dropped=7)
    teller: Any = SimpleNamespace(say=said.append)
    losses = _Losses(peer, "239.0.0.7", teller)
    losses.look(500_000_000)
    assert said == []
    for time_ns in (1_500_000_000, 2_500_000_000):
        peer.dropped += 1
        losses.look(time_ns)
    (text,) = said
    assert text.startswith("1.500 s: frames on 239.0.0.7 are dropped before this process reads them")
