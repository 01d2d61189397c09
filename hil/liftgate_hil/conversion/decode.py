"""Decoder of frames into a table of the signals of their database.

The table has a row for each time at which a frame came, with each signal as of its message's last frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import ERROR, EXTENDED, FD_FLAGS, REMOTE, no_logged
from liftgate_hil.errors import ConfigError
from liftgate_plant.signals import TIME, Signal

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal as BusSignal

Floats = NDArray[np.float64]
# A bench that stood still logs a frame after those which it sends meanwhile, though it came before them.
_LATEST_NS = 10_000_000_000


@dataclass(frozen=True)
class Bits:
    """Payload positions of a signal's bits, MSB first, also within bytes, and conversion to its physical value."""

    places: NDArray[np.intp]
    signed: bool
    is_float: bool
    scale: float
    offset: float

    @property
    def length(self) -> int:
        """Number of bytes that a frame must have to hold the signal."""
        return int(self.places.max()) // 8 + 1

    def raw(self, bits: NDArray[np.uint8]) -> NDArray[Any]:
        """Return the signal's raw number in the bits (n, 512) of frames."""
        count = len(self.places)
        if count > 64:  # rounded: the table's columns are floats
            powers = np.exp2(np.arange(count - 1.0, -1.0, -1.0))
            powers[0] *= -1.0 if self.signed else 1.0
            whole: NDArray[Any] = bits[:, self.places] @ powers
            return whole
        weights = np.uint64(1) << np.arange(count - 1, -1, -1, dtype=np.uint64)
        raw: NDArray[Any] = bits[:, self.places].astype(np.uint64) @ weights
        if self.is_float:
            return raw.astype(f"u{count // 8}").view(f"f{count // 8}").astype(np.float64)
        if self.signed:
            up = np.uint64(64 - count)
            return (raw << up).view(np.int64) >> up.astype(np.int64)
        return raw

    def values(self, bits: NDArray[np.uint8]) -> Floats:
        """Return the signal's physical value in the bits (n, 512) of frames."""
        return self.raw(bits).astype(np.float64) * self.scale + self.offset


def bits_of(signal: BusSignal) -> Bits:
    """Return the bit positions of a database's signal in the payload."""
    if signal.byte_order == "little_endian":
        lowest_first = range(signal.start, signal.start + signal.length)
        places = [8 * (at // 8) + 7 - at % 8 for at in reversed(lowest_first)]
    else:
        first = 8 * (signal.start // 8) + 7 - signal.start % 8
        places = list(range(first, first + signal.length))
    return Bits(
        np.array(places, dtype=np.intp),
        bool(signal.is_signed),
        bool(signal.is_float),
        float(signal.scale),
        float(signal.offset),
    )


class Decoder:
    """Decoder of frames of these messages, in order of time, which holds each signal's last value.

    `source` is the name of the file in error messages.
    """

    def __init__(self, messages: Iterable[Message], source: str = "") -> None:
        self._source = source
        self._messages = {each.frame_id | (EXTENDED if each.is_extended_frame else 0): each for each in messages}
        self._bits = {
            (message.name, signal.name): bits_of(signal)
            for message in self._messages.values()
            for signal in message.signals
        }
        self.signals: dict[str, Signal] = {"time_s": TIME}
        for message in self._messages.values():
            for signal in message.signals:
                meaning = (signal.comment or "").strip()
                self.signals[f"{message.name}.{signal.name}"] = Signal(signal.unit or "", -np.inf, np.inf, meaning)
        self._held = np.full(len(self.signals), np.nan)
        self._last_ns = -(2**62)

    def rows(self, blocks: Iterable[NDArray[np.void]]) -> Iterator[Floats]:
        """Yield rows (n, len(signals)) of decoded signals in order of time.

        Frames may be out of order by up to _LATEST_NS. Raises ConfigError beyond that.
        """
        waiting = no_logged()
        for block in blocks:
            ours = np.isin(block["identifier"] & ~FD_FLAGS, list(self._messages))
            waiting = np.concatenate([waiting, block[ours]])
            if not len(waiting):
                continue
            waiting = waiting[np.argsort(waiting["time_ns"], kind="stable")]
            is_ready = waiting["time_ns"] <= waiting["time_ns"][-1] - _LATEST_NS
            if is_ready.any():
                yield self._table(waiting[is_ready])
                waiting = waiting[~is_ready]
        if len(waiting):
            yield self._table(waiting)

    def _table(self, frames: NDArray[np.void]) -> Floats:
        """Return the rows decoded from frames, one per time. Raises ConfigError if one precedes earlier blocks."""
        times = frames["time_ns"]
        if times[0] < self._last_ns:
            raise ConfigError(
                f"{self._source}: the frame at {times[0] / 1e9:.6f} s comes more than {_LATEST_NS / 1e9:g} s "
                "after a later one; allowed: frames in order of time"
            )
        self._last_ns = int(times[-1])
        stamps, row_of = np.unique(times, return_inverse=True)
        table = np.full((len(stamps), len(self.signals)), np.nan)
        is_there = np.zeros(table.shape, dtype=bool)
        place = {name: k for k, name in enumerate(self.signals)}
        for number, message in self._messages.items():
            those = np.flatnonzero((frames["identifier"] & ~FD_FLAGS) == number)
            if not len(those):
                continue
            bits = np.unpackbits(frames["payload"][those], axis=1)
            for signal in message.signals:
                there = self._is_there(message, signal, frames["length"][those], bits)
                values = self._bits[message.name, signal.name].values(bits[there])
                # Of several frames in one row the last one counts.
                where = row_of[those[there]], place[f"{message.name}.{signal.name}"]
                table[where], is_there[where] = values, True
        self._fill(table, is_there)
        table[:, 0] = stamps / 1e9
        return table

    def _is_there(
        self, message: Message, signal: BusSignal, lengths: Any, bits: NDArray[np.uint8]
    ) -> NDArray[np.bool_]:
        """Return the mask (n,) of a message's frames that contain a signal.

        Such frames are long enough, in `lengths` (n,) [bytes], and have a value of the multiplexer, nested ones
        included, that selects the signal. `bits` (n, 512) are the payloads' bits.
        """
        there: NDArray[np.bool_] = lengths >= self._bits[message.name, signal.name].length
        if signal.multiplexer_signal and signal.multiplexer_ids:
            selector = message.get_signal_by_name(signal.multiplexer_signal)
            chosen = self._bits[message.name, selector.name].raw(bits)
            there = there & np.isin(chosen.astype(np.int64), signal.multiplexer_ids)
            there &= self._is_there(message, selector, lengths, bits)
        return there

    def _fill(self, table: Floats, is_there: NDArray[np.bool_]) -> None:
        """Replace what is not there in each signal's column by its last value, also from the blocks before."""
        rows = np.arange(len(table))[:, np.newaxis]
        since = np.maximum.accumulate(np.where(is_there, rows, -1), axis=0)
        held = np.take_along_axis(table, np.maximum(since, 0), axis=0)
        table[:] = np.where(since >= 0, held, self._held)
        self._held = table[-1].copy()


def seen_in(blocks: Iterable[NDArray[np.void]], messages: Mapping[str, Message]) -> list[Message]:
    """Return those messages of which there is a frame in the blocks; remote and error frames do not count."""
    found: set[int] = set()
    for block in blocks:
        sound = block["identifier"] & (REMOTE | ERROR) == 0
        found.update(np.unique(block["identifier"][sound] & ~FD_FLAGS).tolist())
    return [
        each for each in messages.values() if each.frame_id | (EXTENDED if each.is_extended_frame else 0) in found
    ]
