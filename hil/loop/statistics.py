"""What a run says at its end."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from hil.codec.frames import EXTENDED, Frames
from hil.codec.receive import NO_COUNTS, Counts, rejected
from hil.transport.base import LinkCounts

_BINS = 100_000  # of 1 µs


class Lateness:
    """A histogram of 1 µs bins up to 100 ms, and the maximum."""

    def __init__(self) -> None:
        self._bins = [0] * (_BINS + 1)
        self.count = 0
        self.maximum_us = 0.0

    def add(self, late_ns: int) -> None:
        """Note one deadline that was met so many ns late."""
        microseconds = late_ns / 1000.0
        self._bins[min(int(microseconds), _BINS)] += 1
        self.count += 1
        self.maximum_us = max(self.maximum_us, microseconds)

    def quantile(self, share: float) -> float:
        """The lateness [µs] that a share of the deadlines did not exceed."""
        target = share * self.count
        seen = 0
        for index, number in enumerate(self._bins):
            seen += number
            if seen >= target and number:
                return self.maximum_us if index == _BINS else min(index + 1.0, self.maximum_us)
        return 0.0


class BusLoad:
    """Bits on the wire, without stuffing: 47 + 8 n for a base frame of n bytes, 67 + 8 n for an extended one
    (ISO 11898-1, with the interframe space). For CAN FD it is a rough upper bound.
    """

    def __init__(self) -> None:
        self.bits = 0

    def add(self, frames: Frames) -> None:
        """Count frames, either way."""
        for row in range(frames.count):
            extended = int(frames.identifiers[row]) & EXTENDED
            self.bits += (67 if extended else 47) + 8 * int(frames.lengths[row])

    def percent(self, bitrate: float, seconds: float) -> float:
        """Share of the bus's time, in %."""
        return 100.0 * self.bits / (bitrate * seconds) if seconds > 0.0 else 0.0


@dataclass
class Summary:
    """The figures of a run."""

    clock: str = "realtime"
    ticks: int = 0
    model_time_s: float = 0.0
    overruns: int = 0
    lateness_p50_us: float = 0.0
    lateness_p99_us: float = 0.0
    lateness_max_us: float = 0.0
    bus_load_percent: float = 0.0
    frames_sent: int = 0
    command_timeouts: int = 0
    received: Counts = NO_COUNTS
    link: LinkCounts = field(default_factory=LinkCounts)

    def as_dict(self) -> dict[str, Any]:
        """For --json."""
        return {
            **asdict(self),
            "received": self.received._asdict(),
            "rejected_frames": rejected(self.received),
            "link": self.link._asdict(),
        }

    def lines(self) -> list[str]:
        """For a person."""
        received = self.received
        causes = {
            "wrong length": received.wrong_length,
            "out of range": received.out_of_range,
            "checksum": received.checksum,
            "counter": received.counter,
            "remote": received.remote,
        }
        why = ", ".join(f"{number} {cause}" for cause, number in causes.items() if number)
        lines = [
            f"ticks {self.ticks}, model time {self.model_time_s:.3f} s, clock {self.clock}",
            f"frames sent {self.frames_sent}, commands accepted {received.accepted}, rejected "
            f"{rejected(received)}{f' ({why})' if why else ''}, lost {received.lost}, foreign "
            f"{received.foreign}, error frames {received.error}",
            f"command time-outs {self.command_timeouts}, bus load {self.bus_load_percent:.1f} %",
        ]
        if self.clock == "realtime":
            lines.insert(
                1,
                f"overruns {self.overruns}, lateness p50 {self.lateness_p50_us:.0f} µs, p99 "
                f"{self.lateness_p99_us:.0f} µs, max {self.lateness_max_us:.0f} µs",
            )
        if any(self.link):
            rarer = list(self.link._asdict().items())[2:]
            lines.append(
                f"link: {self.link.send_failures} frames not sent, "
                f"{self.link.receive_failures} receive errors"
                + "".join(f", {count} {name.replace('_', ' ')}" for name, count in rarer if count)
            )
        return lines
