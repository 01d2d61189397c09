"""Frames on a run's bus: last frame of each message, the ECU's command, and a trace of the latest frames."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil.codec.frames import EXTENDED, FD_FLAGS, no_logged
from liftgate_hil.config.rig import load_rig
from liftgate_hil.dashboard.page_state import CommandValue, HeardMessage, SignalValues, TracedFrame
from liftgate_hil.errors import ConfigError

if TYPE_CHECKING:
    from cantools.database.can import Message
    from numpy.typing import NDArray

    from liftgate_hil.codec.bus_config import SignalMapping


_EXACT = 2**53  # whole numbers up to this are exact as floating-point numbers
_MOST = 500  # messages that are kept


@dataclass
class Heard:
    """A message on the bus, sent or received by the gate: number of its frames, cycle, and last frame."""

    is_sent: bool
    count: int
    time_ns: int
    cycle_ms: float  # between the last two frames
    payload: bytes


class BusView:
    """Messages on the bus of a run, decoded by the database of its rig.

    `not_kept` counts the frames of messages beyond the first 500.
    """

    def __init__(self, rig: Path) -> None:
        self._messages: dict[int, Message] = {}
        self._inputs: list[tuple[int, SignalMapping]] = []  # identifier of the message of each
        self._heard: dict[tuple[int, bool], Heard] = {}
        self.not_kept = 0
        try:
            found = load_rig(rig)
        except ConfigError:  # it cannot be read any more: frames are shown without names
            return
        self._messages = {found.identifier(name): each for name, each in found.messages.items()}
        self._inputs = [(found.identifier(each.message) & ~FD_FLAGS, each) for each in found.inputs]

    def hear(self, frame: Any) -> None:
        """Store a frame, a record of LOGGED, as its message's last one; beyond 500 messages just count it."""
        identifier, is_sent = int(frame["identifier"]) & ~FD_FLAGS, bool(frame["is_sent"])
        before = self._heard.get((identifier, is_sent))
        if before is None and len(self._heard) >= _MOST:
            self.not_kept += 1
            return
        time_ns, length = int(frame["time_ns"]), int(frame["length"])
        self._heard[identifier, is_sent] = Heard(
            is_sent,
            before.count + 1 if before else 1,
            time_ns,
            (time_ns - before.time_ns) * 1e-6 if before else np.nan,
            frame["payload"][:length].tobytes(),
        )

    def command(self) -> dict[str, CommandValue]:
        """Return the ECU's last command, by quantity: value (or its label), unit and signal; {}: none received."""
        found, decoded = dict[str, CommandValue](), dict[int, SignalValues]()
        for identifier, each in self._inputs:
            heard = self._heard.get((identifier, False))
            if heard is None:
                continue
            if identifier not in decoded:
                decoded[identifier] = _decoded(self._messages.get(identifier), heard.payload)
            if each.signal in decoded[identifier]:
                unit = self._messages[identifier].get_signal_by_name(each.signal).unit or ""
                value, name = decoded[identifier][each.signal], f"{each.message}.{each.signal}"
                found[each.quantity] = {"value": value, "unit": unit, "signal": name}
        return found

    def messages(self) -> list[HeardMessage]:
        """Return the last frame of each message on the bus, sorted by identifier."""
        return [
            {
                **self._described(identifier, each.is_sent, each.time_ns, each.payload),
                "count": each.count,
                "cycle_ms": each.cycle_ms,
            }
            for (identifier, _), each in sorted(self._heard.items())
        ]

    def described(self, frames: Any) -> list[TracedFrame]:
        """Return frames (n,) LOGGED in decoded form, in the given order."""
        return [
            self._described(
                int(each["identifier"]) & ~FD_FLAGS,
                bool(each["is_sent"]),
                int(each["time_ns"]),
                each["payload"][: int(each["length"])].tobytes(),
            )
            for each in frames
        ]

    def units(self) -> dict[str, str]:
        """Return the units of the database's signals, by `Message.Signal`; signals without a unit are left out."""
        named = ((f"{each.name}.{one.name}", one.unit) for each in self._messages.values() for one in each.signals)
        return {name: unit for name, unit in named if unit}

    def _described(self, identifier: int, is_sent: bool, time_ns: int, payload: bytes) -> TracedFrame:
        """Return a frame in decoded form; name "" and signals {}: the database has no such message."""
        return {
            "id": f"{identifier & ~EXTENDED:X}{'x' if identifier & EXTENDED else ''}",
            "name": self._messages[identifier].name if identifier in self._messages else "",
            "direction": "sent" if is_sent else "received",
            "time_s": time_ns * 1e-9,
            "data": payload.hex(" "),
            "signals": _decoded(self._messages.get(identifier), payload),
        }


def _decoded(message: Message | None, payload: bytes) -> SignalValues:
    """Return a frame's signals, as labels where they have some; {}: no message, or the frame does not fit it."""
    if message is None:
        return {}
    import cantools

    try:
        found: Any = message.decode(payload, decode_choices=True, allow_truncated=True)
    except (cantools.database.DecodeError, ValueError, OverflowError):
        return {}
    return {name: _plain(value) for name, value in found.items()}


def _plain(value: Any) -> float | str:
    """Return a signal's value for JSON: integers too large for exact JSON numbers as floats, labels as text."""
    if isinstance(value, int) and abs(value) > _EXACT:
        return float(value)
    return value if isinstance(value, int | float) else str(value)


_KEPT = 5000  # frames, of the default rig those of 8 s
MOST_FRAMES = 1000  # of one reply: the page asks twice a second, and says which of more it has missed


class FrameTrace:
    """The latest 5000 frames on a bus, or some more, each with its number, from 1.

    Frames are kept in the blocks in which they were read, so that they cost nothing while nobody asks.
    """

    def __init__(self) -> None:
        self._blocks: deque[tuple[int, NDArray[np.void]]] = deque()  # number of the first frame, frames
        self._count = 0

    def keep(self, frames: NDArray[np.void]) -> None:
        """Add frames, rows of LOGGED; the oldest are dropped."""
        if not len(frames):
            return
        self._blocks.append((self._count + 1, frames))
        self._count += len(frames)
        while self._blocks[0][0] + len(self._blocks[0][1]) <= self._count - _KEPT + 1:
            self._blocks.popleft()

    def after(self, number: int) -> tuple[int, Any]:
        """Return the number of the first kept frame after the given number, and the frames from it on.

        Of more than MOST_FRAMES the latest are returned.
        """
        first = max(number + 1, self._count - MOST_FRAMES + 1, 1)
        parts = [frames[max(0, first - begin) :] for begin, frames in list(self._blocks)]
        found = np.concatenate([no_logged(), *parts])
        return self._count - len(found) + 1, found
