"""`liftgate-hil ecu`: what it says of frames that its process did not read in time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from liftgate_hil.drive.ecu_alone import _Losses


def test_the_first_frames_that_are_dropped_are_told_once_those_before_it_began_are_not():
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
