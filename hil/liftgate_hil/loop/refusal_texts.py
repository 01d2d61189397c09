"""Texts on frames that a gate rejects, or does not receive: the first one for each cause, with what is wrong."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from liftgate_hil.codec.frames import EXTENDED
from liftgate_hil.codec.refusals import (
    BAD_CHECKSUM,
    BAD_COUNTER,
    FD_FRAME,
    FOREIGN,
    OUT_OF_RANGE,
    REMOTE_FRAME,
    WRONG_LENGTH,
)
from liftgate_hil.signals import BUS_INPUTS

if TYPE_CHECKING:
    from liftgate_hil.codec.receive import Reception
    from liftgate_hil.config.rig import Rig
    from liftgate_hil.loop.statistics import Summary
    from liftgate_hil.loop.tick import LoopConfig

ANOTHER = "another bench or a replay is on this bus"
_ECU = "it must not come from the ECU"  # which is the only other node where there is no bus
REFUSED = (REMOTE_FRAME, WRONG_LENGTH, OUT_OF_RANGE, BAD_CHECKSUM, BAD_COUNTER)


def identifier_text(identifier: int) -> str:
    """Return an identifier, which has SocketCAN's flag if it is extended, as text for messages: 0x123."""
    return f"0x{identifier & 0x1FFFFFFF:X}{' (extended, 29 bits)' if identifier & EXTENDED else ''}"


def missing_of(reception: Reception, row: int) -> tuple[int, int]:
    """Return how many frames of a message are missing by its counter, and its cycles so far, those included."""
    return int(reception.lost[row]), int(reception.cycles[row])


def gaps_text(missing: int, cycles: int, name: str) -> str:
    """Return a text on frames of a message that are missing by their counter."""
    return (
        f"{missing} of {cycles} {name} frames are missing by their counter: they are lost, the counter goes in "
        "other steps, or two nodes send them"
    )


class RefusalTexts:
    """Texts on the frames that a loop has rejected; the scenario's time 0 is at `began_s` of the loop's time.

    `is_bus`: others than the ECU may send on the wire, too.
    """

    def __init__(self, rig: Rig, config: LoopConfig, began_s: float = 0.0, is_bus: bool = True) -> None:
        self._rig, self._config, self._began_s = rig, config, began_s
        self._whose = ANOTHER if is_bus else _ECU
        self.command_row = config.inputs.messages["identifier"].tolist().index(rig.command_identifier())
        self.sent = {rig.identifier(wire.message): wire.message for wire in rig.outputs}  # names by identifier

    def awaited(self) -> str:
        """Return the name and the identifier of the command message, as text."""
        return f"{self._rig.command_message()} ({identifier_text(self._rig.command_identifier())})"

    def tell(self, summary: Summary, reception: Reception) -> None:
        """Fill in a run summary's fields on rejected and missing frames."""
        refusals = reception.refusals
        summary.commands_missing, summary.command_cycles = missing_of(reception, self.command_row)
        summary.first_refused = [self.of_first(refusals, cause) for cause in REFUSED if refusals[cause].count]
        summary.first_foreign = self.first_foreign(refusals)
        summary.awaited = self.awaited()
        summary.fd_frames, summary.first_fd_frame = int(refusals[FD_FRAME].count), self._first_fd_frame(refusals)

    def first_foreign(self, refusals: Any) -> str:
        """Return as text the first identifier that the rig does not receive; "": none, or that of a test bench."""
        others = refusals[FOREIGN]
        if not others.count or int(others.found) in self._rig.ordering:
            return ""
        sent = f", which this gate sends: {self._whose}" if int(others.found) in self.sent else ""
        return identifier_text(int(others.found)) + sent

    def _first_fd_frame(self, refusals: Any) -> str:
        """Return the first CAN FD frame by name and identifier, with its time; "": there was none."""
        first = refusals[FD_FRAME]
        if not first.count:
            return ""
        name, text = self._message_name(int(first.found)), identifier_text(int(first.found))
        time_s = self._time_of(first)
        when = f"at {time_s:.3f} s" if time_s >= 0.0 else "in the precondition"
        return f"{text if name == text else f'{name} ({text})'} {when}"

    def _time_of(self, refusal: Any) -> float:
        """Return a rejected frame's time [s] since the scenario's time 0; negative: in the precondition."""
        return float(refusal.time_ns * 1e-9 - self._began_s)

    def of_first(self, refusals: Any, cause: int) -> str:
        """Return a text on the first frame that was rejected for a cause."""
        refusal = refusals[cause]
        name = self._message_name(int(self._config.inputs.messages[int(refusal.message)].identifier))
        time_s = self._time_of(refusal)
        head = f"{f'{time_s:.3f} s' if time_s >= 0.0 else 'precondition'}: {name} refused"
        options = self._rig.options.get(name)
        if cause == REMOTE_FRAME:
            return f"{head}: a remote frame; allowed: a data frame"
        if cause == WRONG_LENGTH:
            return f"{head}: {refusal.found:.0f} bytes; expected {refusal.expected:.0f}"
        counter = (options and options.counter) or "counter"
        unknown = f"{head}: {counter} is {refusal.found:.0f}; expected one of its values"
        if cause == BAD_CHECKSUM:
            signal = (options and options.checksum) or "checksum"
            found, expected = (
                int(each) & 0xFFFFFFFFFFFFFFFF for each in (refusal.checksum, refusal.right_checksum)
            )
            if found == expected and math.isnan(refusal.expected):
                return unknown
            if found == expected:
                return f"{head}: data ID does not belong to this message ({signal} is correct)"
            return f"{head}: {signal} is 0x{found:X}; expected 0x{expected:X}"
        if cause == BAD_COUNTER and math.isnan(refusal.expected):
            return unknown
        if cause == BAD_COUNTER:
            return f"{head}: {counter} is {refusal.found:.0f}; expected {refusal.expected:.0f}"
        return f"{head}: {self._out_of_range(int(refusal.signal), float(refusal.found))}"

    def _out_of_range(self, row: int, found: float) -> str:
        """Return a text on the value `found` of the input signal in a row, and the range it is outside of."""
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

    def _message_name(self, identifier: int) -> str:
        """Return the name of the message with an identifier; if the rig has none, the identifier as text."""
        wanted = identifier & ~EXTENDED, bool(identifier & EXTENDED)
        for name, message in self._rig.messages.items():
            if (message.frame_id, message.is_extended_frame) == wanted:
                return name
        return identifier_text(identifier)
