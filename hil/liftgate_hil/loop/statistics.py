"""Figures of a run, reported at its end."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

from liftgate_hil import signals
from liftgate_hil.codec.frames import Frames, bits_of
from liftgate_hil.codec.receive import NO_COUNTS, Counts, rejected
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.errors import number_of
from liftgate_hil.loop.histogram import NOTHING, Quantiles
from liftgate_hil.transport.base import LinkCounts
from liftgate_plant.obstacle import ROD_STIFFNESS


class BusLoad:
    """Counter of the bits on the bus."""

    def __init__(self) -> None:
        self.bits = 0

    def add(self, frames: Frames) -> None:
        """Count the bits of frames, in either direction."""
        count = frames.count
        self.bits += sum(map(bits_of, frames.identifiers[:count].tolist(), frames.lengths[:count].tolist()))

    def percent(self, bitrate: float, seconds: float) -> float:
        """Return the bus load [%] by these frames in a time [s] at a bit rate [bit/s]; 0 in no time."""
        return 100.0 * self.bits / (bitrate * seconds) if seconds > 0.0 else 0.0


EDGE_SPEED = 0.20  # m/s, largest one of the edge of `suv` while the reference ECU closes it: 11.7 deg/s at 1 m


def force_of(delay_us: float) -> float:
    """Return the pinch force [N] that grows during a delay [µs] on a rod of 10 N/mm, at the speed EDGE_SPEED."""
    return delay_us * 1e-6 * EDGE_SPEED * ROD_STIFFNESS


class LoopTiming(NamedTuple):
    """Timing of a real-time loop: lateness, execution time and delay."""

    lateness: Quantiles = NOTHING  # how late ticks began
    execution: Quantiles = NOTHING  # how long a tick took
    delay: Quantiles = NOTHING  # from a command on the bus to the first feedback that shows it

    def on_bus(self) -> signals.Timing:
        """Return the timing figures as they are sent on the bus; NaN where there is none."""
        late, took, delay = self
        return signals.Timing(
            lateness_p50=late.p50_us,
            lateness_p99=late.p99_us,
            lateness_p999=late.p999_us,
            lateness_max=late.max_us,
            execution_p50=took.p50_us,
            execution_max=took.max_us,
            command_delay_p50=delay.p50_us,
            command_delay_max=delay.max_us,
            command_delay_force=force_of(delay.max_us),
        )


NO_TIMING = LoopTiming()
_MOST_LISTED = 5  # injections or commands that are listed, at most
_CYCLES_S = 0.1  # s in which every message of a rig is usually sent
# Counters of a link that are printed with words of their own.
_USUAL_FAULTS = ("losses", "send_failures", "send_queue_full", "receive_failures", "dropped")
# What became of received frames that never acted; the page has one number for both.
DROPPED = "lost: bench too slow"
STALE = "ignored: waited longer than the message's time-out"
DROPPED_OR_STALE = "lost or ignored: bench too slow"


# Frames that came to the gate, by what became of them.
_RECEIVED = {
    "accepted": "valid frames of mapped messages",
    "foreign": "frames with identifiers that the rig does not receive",
    "error": "error frames that the controller reported",
    "remote": "remote requests for mapped messages",
    "wrong_length": "rejected: length is not the message's",
    "out_of_range": "rejected: a value is outside the range of database, rig or quantity, or NaN",
    "checksum": "rejected: wrong checksum",
    "counter": "rejected: alive counter did not change, or is out of sequence",
    "unqualified": "valid frame, but the E2E state is not (yet) valid",
    "lost": "frames missing between two alive counters, never received",
}

# fmt: off
# A field with its description is a row of a table.


@dataclass
class Summary(DescribedResult):
    """Figures of a run, reported at its end."""

    clock: Annotated[str, Shown("clock of the run: `realtime`, `lockstep` or `free`")] = "realtime"
    ticks: Annotated[int, Shown("ticks that were done")] = 0
    model_time_s: Annotated[float, Shown("model time at the end [s]")] = 0.0
    overruns: Annotated[int, Shown("ticks that were missed")] = 0
    timing: LoopTiming = NO_TIMING
    bus_load_percent: float = 0.0
    frames_sent: Annotated[int, Shown("frames that the gate sent")] = 0
    command_timeouts: Annotated[int, Shown("times that the ECU's commands failed to come")] = 0
    received: Annotated[Counts, Shown("frames that came to the gate, by outcome", parts=_RECEIVED)] = NO_COUNTS
    discarded: Annotated[int, Shown("frames of the ECU that were in flight where the precondition ended")] = 0
    first_refused: Annotated[list[str], Shown("the first frame that was refused for each cause, as texts with "
        "their times")] = field(default_factory=list)
    first_foreign: Annotated[str, Shown("identifier of the first frame that the rig does not receive, as text; "
        "empty: none")] = ""
    fd_frames: int = 0  # CAN FD frames received, whatever became of them
    first_fd_frame: str = ""  # the first of them, with its time
    awaited: str = ""  # the command message, with its identifier
    commands_missing: int = 0  # frames of that message that are missing by its counter
    command_cycles: int = 0  # its cycles so far, those included
    link: Annotated[LinkCounts, Shown("errors of the link, see Link")] = field(default_factory=LinkCounts)
    link_error: Annotated[str, Shown("the operating system's text for the link's last error; empty: none")] = ""
    recordings: Annotated[list[str], Shown("files that were written")] = field(default_factory=list)
    recording_windows: Annotated[int | None, Shown("triggers around which was recorded; null: the whole run "
        "was")] = None
    recording_lost_rows: Annotated[int, Shown("rows for which the recorder was too slow")] = 0
    unseen_rows: Annotated[int, Shown("rows and frames that were not judged, because an ECU in this process "
        "delayed it")] = 0
    injections: Annotated[int, Shown("injections of a test bench that were carried out")] = 0
    injected: Annotated[list[str], Shown("the first of them, as texts with their "
        "times")] = field(default_factory=list)
    injections_refused: Annotated[int, Shown("injections that were refused as invalid")] = 0
    commands: Annotated[int, Shown("commands of an operator that were carried out")] = 0
    commanded: Annotated[list[str], Shown("the first of them, as texts with their "
        "times")] = field(default_factory=list)
    ecu_dropped_frames: Annotated[int, Shown("frames for which an ECU in this process had no room")] = 0

    @property
    def known_bus_load_percent(self) -> Annotated[float, Shown("bus load over the run [%]; null: the run is "
            "shorter than 0.1 s", key="bus_load_percent")]:
        """Bus load [%]; NaN for a run shorter than 0.1 s, a cycle in which every message is usually sent."""
        return math.nan if self.model_time_s < _CYCLES_S else self.bus_load_percent

    @property
    def lateness(self) -> Annotated[Quantiles, Shown("how late ticks began", prefix="lateness")]:
        """Lateness with which ticks began, as quantiles [µs]."""
        return self.timing.lateness

    @property
    def execution(self) -> Annotated[Quantiles, Shown("execution time of a tick", prefix="execution")]:
        """Execution time of a tick, as quantiles [µs]."""
        return self.timing.execution

    @property
    def delay(self) -> Annotated[Quantiles, Shown("command delay", prefix="command_delay")]:
        """Delay from a command on the bus to the first feedback that shows its effect, as quantiles [µs]."""
        return self.timing.delay

    @property
    def command_delay_force_n(self) -> Annotated[float, Shown("pinch force that grows during the largest command "
            "delay, on the rod of 10 N/mm [N]; null: no delay was measured")]:
        """Pinch force that grows during the largest command delay [N]; NaN: no delay was measured."""
        return force_of(self.timing.delay.max_us)

    @property
    def rejected_frames(self) -> Annotated[int, Shown("all rejected frames: remote, wrong length, out of range, "
            "checksum, counter")]:
        """Number of all rejected frames."""
        return rejected(self.received)

    # fmt: on
    def refusals_text(self) -> str:
        """Return how many frames the gate rejected for which causes, as text; "": it rejected none."""
        causes = ("wrong_length", "out_of_range", "checksum", "counter", "remote")
        counts = {cause.replace("_", " "): getattr(self.received, cause) for cause in causes}
        return ", ".join(f"{number} {cause}" for cause, number in counts.items() if number)

    def silence_reported(self) -> str:
        """Return why the gate accepted no command, as text; "": it accepted one."""
        if self.received.accepted:
            return ""
        if rejected(self.received):
            return f"no command was accepted, {rejected(self.received)} were rejected"
        if self.received.foreign:
            which = f", the first {self.first_foreign}" if self.first_foreign else ""
            text = f"{self.received.foreign} frames have identifiers that the rig does not receive{which}"
            return f"no command was accepted, {text}" + (f"; awaited: {self.awaited}" if self.awaited else "")
        return "no command arrived: the ECU sent nothing"

    def injections_reported(self) -> str:
        """Return as text how many injections a test bench made, how many were refused, and the first ones."""
        first = "; ".join(self.injected[:_MOST_LISTED])
        more = "; …" if self.injections > _MOST_LISTED else ""
        text = f": {first}{more}" if first else ""
        times = number_of(self.injections, "time")
        return f"injected by the test bench {times}, {self.injections_refused} refused{text}"

    def _link_lines(self) -> list[str]:
        """Return a line on the losses and errors of the link; none if there were none."""
        link = self.link._replace(before_start=0)  # which is no fault
        if not any(link):
            return []
        words = link.in_words()
        if link.stale_frames:
            words["stale_frames"] = f"{number_of(link.stale_frames, 'received frame')} {STALE}"
        rarer = [f", {each}" for name, each in words.items() if name not in _USUAL_FAULTS]
        return [
            f"link: lost {number_of(link.losses, 'time')}, {number_of(link.send_failures, 'frame')} not sent "
            f"({link.send_queue_full} because the queue was full), "
            f"{number_of(link.receive_failures, 'receive error')}, "
            f"{number_of(link.dropped, 'received frame')} {DROPPED}"
            + "".join(rarer)
            + (f", last: {self.link_error}" if self.link_error else "")
        ]

    def lines(self) -> list[str]:
        """Return the figures as lines of text for a person."""
        received = self.received
        why = self.refusals_text()
        percent = self.known_bus_load_percent
        load = "" if math.isnan(percent) else f", bus load {percent:.1f} %"
        discarded = f", {self.discarded} discarded after the precondition" if self.discarded else ""
        lines = [
            f"ticks {self.ticks}, model time {self.model_time_s:.3f} s, clock {self.clock}",
            f"frames sent {self.frames_sent}, commands accepted {received.accepted}, rejected "
            f"{rejected(received)}{f' ({why})' if why else ''}, lost {received.lost}{discarded}, foreign "
            f"{received.foreign}, error frames {received.error}",
            f"command time-outs {self.command_timeouts}{load}",
        ]
        if self.clock == "realtime":
            lines[1:1] = [
                f"overruns {self.overruns}, lateness {in_words(self.timing.lateness)}",
                f"tick {in_words(self.timing.execution)}",
            ]
        if received.unqualified:
            lines.append(f"correct, but E2E state not valid: {received.unqualified} frames")
        delay = self.timing.delay
        if delay.count:
            lines.append(
                f"command to feedback {in_words(delay)}: of the force on a 10 N/mm rod "
                f"{force_of(delay.p50_us):.1f} N are due to this delay, {force_of(delay.max_us):.1f} N with the "
                "longest one"
            )
        if self.link.before_start:
            lines.append(
                f"{self.link.before_start} frames arrived before the loop was ready, or a lost link was back, "
                "and were dropped"
            )
        lines += self._link_lines()
        if self.injections or self.injections_refused:
            lines.append(self.injections_reported())
        if self.commands:
            first = "; ".join(self.commanded[:_MOST_LISTED])
            rest = self.commands - min(len(self.commanded), _MOST_LISTED)
            more = f"; and {rest} more" if rest > 0 else ""
            lines.append(f"commanded by the operator {number_of(self.commands, 'time')}: {first}{more}")
        if self.ecu_dropped_frames:
            lines.append(f"the ECU had no room for {self.ecu_dropped_frames} frames")
        if self.recording_lost_rows:
            lines.append(f"recording: {self.recording_lost_rows} rows lost, the disk was too slow")
        if (many := self.recording_windows) is not None:
            times = {0: "never came", 1: "came once"}.get(many, f"came {many} times")
            lines.append(f"recorded only around the trigger, which {times}")
        if self.recordings:
            lines.append(f"written: {', '.join(self.recordings)}")
        return lines


def in_words(times: Quantiles) -> str:
    """Return the quantiles of a duration [µs] as text; "not known" without samples."""
    if not times.count:
        return "not known"
    return (
        f"p50 {times.p50_us:.1f} µs, p99 {times.p99_us:.1f} µs, p99.9 {times.p999_us:.1f} µs, "
        f"max {times.max_us:.1f} µs"
    )
