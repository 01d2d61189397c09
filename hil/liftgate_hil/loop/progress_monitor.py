"""Progress monitor: reports a run's status, what it waits for, refused frames and the ECU's events while it runs.

Of the refused frames it reports the first one for each cause. It looks a few times a second, from outside the
loop.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from liftgate_hil.codec.refusals import (
    ACCEPTED,
    BAD_CHECKSUM,
    BAD_COUNTER,
    FOREIGN,
    OUT_OF_RANGE,
    REMOTE_FRAME,
    WRONG_LENGTH,
)
from liftgate_hil.loop.listener import Listener, Status
from liftgate_hil.signals import BUS_INPUTS, COLUMN_PLACE

if TYPE_CHECKING:
    from liftgate_hil.codec.receive import Reception
    from liftgate_hil.config.rig import Rig
    from liftgate_hil.ecu.events import Event
    from liftgate_hil.loop.tick import LoopConfig

_EVERY_S = 0.1  # between two looks
_PATIENCE_S = 2.0  # without a command, after which it reports that it waits
_REFUSED = (REMOTE_FRAME, WRONG_LENGTH, OUT_OF_RANGE, BAD_CHECKSUM, BAD_COUNTER)
_ANGLE, _LEFT, _RIGHT = (COLUMN_PLACE[name] for name in ("gate_angle_deg", "left_current_a", "right_current_a"))


class Moment(NamedTuple):
    """State of a loop at a moment, as the progress monitor needs it."""

    tick: int  # since the scenario's time 0
    row: Any  # (ROW_WIDTH,) of the last tick
    sent: int  # frames
    overruns: int


class ProgressMonitor:
    """Reports on a loop by its `reception`, which the loop writes in place.

    `events` returns what the ECU in this process has reported after the first so many events. The scenario's time
    0 is `ticks_before` ticks after the loop's. `apart` says how to keep the bus apart from another bench's.
    """

    def __init__(
        self,
        rig: Rig,
        config: LoopConfig,
        reception: Reception,
        listener: Listener,
        events: Callable[[int], Sequence[Event]] = lambda since: (),
        clock: Callable[[], float] = time.monotonic,
        ticks_before: int = 0,
        apart: str = "",
    ) -> None:
        self._before = ticks_before
        self._rig = rig
        self._config = config
        self._reception = reception
        self._listener = listener
        self._events = events
        self._clock = clock
        self._reported_events = 0
        self._listed_causes: set[int] = set()
        self._apart = f"; {apart}" if apart else ""
        self._sent = {rig.identifier(wire.message): wire.message for wire in rig.outputs}
        self._has_reported_another = False
        self._command = rig.command_message()
        self._row = _row_of(config, rig.command_identifier())
        self._next = 0.0
        self._heard = math.inf  # when the command was last valid, or the time of the first look
        self._was_heard = False
        self._is_waiting = False
        self._has_named_foreign = False

    def look(self, moment: Moment, is_last: bool = False) -> None:
        """Report what is new; most calls come too soon, and cost nothing."""
        now = self._clock()
        if now < self._next and not is_last:
            return
        self._next = now + _EVERY_S
        self._heard = min(self._heard, now)
        time_s = moment.tick * self._config.step
        for event in self._events(self._reported_events):
            self._reported_events += 1
            self._listener.happened(event.time, event.text)
        for cause in _REFUSED:
            if self._reception.refusals[cause].count and cause not in self._listed_causes:
                self._listed_causes.add(cause)
                self._listener.say(self._refusal(cause))
        if not is_last:
            self._look_for_another(time_s)
            self._look_at_command(time_s, now)
            self._listener.status(self._status(moment))

    def _look_for_another(self, time_s: float) -> None:
        """Report another gate on the bus if the first foreign frame is one that this gate sends."""
        others = self._reception.refusals[FOREIGN]
        name = self._sent.get(int(others.found)) if others.count else None
        if name is not None and not self._has_reported_another:
            self._has_reported_another = True
            self._listener.say(
                f"{time_s:.3f} s: received {name} (0x{int(others.found) & 0x1FFFFFFF:X}), which this gate sends: "
                f"another bench or a replay is on this bus{self._apart}"
            )

    def _look_at_command(self, time_s: float, now: float) -> None:
        """Report when the command arrives or times out and, where it is missing for long, what is waited for."""
        if self._reception.seen_ns[self._row] >= 0:
            if self._is_waiting:
                self._listener.say(f"{time_s:.3f} s: {self._command} received")
            self._heard, self._was_heard, self._is_waiting = now, True, False
        elif self._was_heard:
            self._listener.say(f"{time_s:.3f} s: {self._command} timed out: motors off")
            self._was_heard, self._is_waiting = False, True
        elif not self._is_waiting and now - self._heard > _PATIENCE_S:
            foreign = self._foreign()
            heard = f"; {foreign}" if foreign else ""
            self._listener.say(f"{time_s:.3f} s: waits for {self._waited_for()}, motors off{heard}")
            self._is_waiting, self._has_named_foreign = True, bool(foreign)
        elif self._is_waiting and not self._has_named_foreign and not self._reception.refusals[ACCEPTED].count:
            foreign = self._foreign()
            if foreign:
                self._listener.say(f"{time_s:.3f} s: {foreign}; waits for {self._waited_for()}")
                self._has_named_foreign = True

    def _waited_for(self) -> str:
        return f"{self._command} (0x{self._rig.messages[self._command].frame_id:X})"

    def _foreign(self) -> str:
        """Return a text on the first foreign frame; "": there is none but those of the rig's database."""
        others = self._reception.refusals[FOREIGN]
        if not others.count or int(others.found) in self._rig.ordering:
            return ""
        apart = "" if self._has_reported_another else self._apart
        return f"0x{int(others.found) & 0x1FFFFFFF:X} is on the bus, but not received by this rig{apart}"

    def _status(self, moment: Moment) -> Status:
        counts = self._reception.refusals["count"]
        seen_ns = int(self._reception.seen_ns[self._row])
        now_s = (moment.tick + self._before) * self._config.step
        age = now_s - seen_ns * 1e-9 if seen_ns >= 0 else None
        return Status(
            time_s=moment.tick * self._config.step,
            angle_deg=float(moment.row[_ANGLE]),
            left_current_a=float(moment.row[_LEFT]),
            right_current_a=float(moment.row[_RIGHT]),
            command_age_s=age,
            sent=moment.sent,
            accepted=int(counts[ACCEPTED]),
            rejected=sum(int(counts[cause]) for cause in _REFUSED),
            foreign=int(counts[FOREIGN]),
            overruns=moment.overruns,
        )

    def _refusal(self, cause: int) -> str:
        """Return a text on the first frame that was refused for a cause."""
        refusal = self._reception.refusals[cause]
        name = self._message_name(int(refusal.message))
        head = f"{refusal.time_ns * 1e-9:.3f} s: {name} refused"
        options = self._rig.options.get(name)
        if cause == REMOTE_FRAME:
            return f"{head}: a remote frame; allowed: a data frame"
        if cause == WRONG_LENGTH:
            return f"{head}: {refusal.found:.0f} bytes; expected {refusal.expected:.0f}"
        if cause == BAD_CHECKSUM:
            signal = (options and options.checksum) or "checksum"
            found, expected = (
                int(each) & 0xFFFFFFFFFFFFFFFF for each in (refusal.checksum, refusal.right_checksum)
            )
            if found == expected:
                return f"{head}: data ID or counter does not belong to this message ({signal} is correct)"
            return f"{head}: {signal} is 0x{found:X}; expected 0x{expected:X}"
        if cause == BAD_COUNTER:
            signal = (options and options.counter) or "counter"
            if math.isnan(refusal.expected):
                return f"{head}: {signal} is {refusal.found:.0f}; expected one of its values"
            return f"{head}: {signal} is {refusal.found:.0f}; expected {refusal.expected:.0f}"
        return f"{head}: {self._out_of_range(int(refusal.signal), float(refusal.found))}"

    def _out_of_range(self, row: int, found: float) -> str:
        table = self._config.inputs.signals[row]
        quantity = list(BUS_INPUTS)[int(table.quantity)]
        mapping = next(wire for wire in self._rig.inputs if wire.quantity == quantity)
        signal = self._rig.messages[mapping.message].get_signal_by_name(mapping.signal)
        unit = f" {signal.unit}" if signal.unit else ""
        head = f"{mapping.signal} is {found:g}{unit}"
        if not table.low <= found <= table.high:
            least, most = signal.minimum, signal.maximum
            low, high = (table.low, table.high) if least is None or most is None else (least, most)
            return f"{head}; allowed by the database: {low:g} to {high:g}{unit}"
        ours = BUS_INPUTS[quantity]
        allowed = f"{ours.low:g} to {ours.high:g}" + (f" {ours.unit}" if ours.unit else "")
        return f"{head}; allowed for {quantity}: {', '.join(ours.values) or allowed}"

    def _message_name(self, row: int) -> str:
        identifier = int(self._config.inputs.messages[row].identifier) & 0x1FFFFFFF
        for name, message in self._rig.messages.items():
            if message.frame_id == identifier:
                return name
        return f"0x{identifier:X}"


def _row_of(config: LoopConfig, identifier: int) -> int:
    """Return the row of a message among those that are received."""
    known: list[int] = config.inputs.messages["identifier"].tolist()
    return known.index(identifier)
