"""The reference ECU's trouble codes: which event stores which code.

They have five characters as in SAE J2012, in its manufacturers' ranges, with its failure types.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from liftgate_hil.ecu import events


class EcuDtc(NamedTuple):
    """A trouble code and its meaning."""

    code: str
    meaning: str


TROUBLE_CODES: Mapping[int, EcuDtc] = {
    events.DRIVES_APART: EcuDtc("B1A01-62", "the drives' Hall counts differ: signals do not agree"),
    events.CURRENT_FROZEN: EcuDtc("B1A02-2A", "a moving drive's current does not change: stuck signal"),
    events.CURRENT_LOST: EcuDtc("B1A03-13", "one drive carries the whole load: the other circuit is open"),
    events.OVER_CURRENT: EcuDtc("B1A04-19", "a drive's current is above its limit"),
    events.LATCH_IMPLAUSIBLE: EcuDtc("B1A05-64", "the latch's switch reads closed far from the closed end"),
    events.BLOCKED_CLOSING: EcuDtc("B1A06-97", "the closing gate stops before its end position: blocked"),
    events.BLOCKED_OPENING: EcuDtc("B1A07-97", "the opening gate stops before its end position: blocked"),
    events.FALLS: EcuDtc("B1A08-94", "the gate falls from standstill: unexpected operation"),
    events.TOO_HOT: EcuDtc("B1A09-98", "a motor is too hot to start: over temperature"),
    events.FEEDBACK_LOST: EcuDtc("U1A01-87", "the drives' feedback did not arrive in time: missing message"),
}  # fmt: skip
