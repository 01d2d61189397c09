"""Simulate the gate of a real-time run again, in model time, with the commands that it received.

log = CommandLog()                                # a sink of the run
...
heard = relevant_frames(rig, log.frames(), expected, begun.stimuli)
StepsAgain(begun, heard, ...)(0.012)              # SteppedAgain, see judging.stepped_again
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import INT_OF_STEP, GivenUpError
from liftgate_hil.codec.frames import FD_FLAGS, frame_flags, no_logged
from liftgate_hil.config.rig import Rig
from liftgate_hil.ecu import wire
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.node import PORT
from liftgate_hil.errors import LiftgateError
from liftgate_hil.judging.expected import Expected
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.stepped_again import SteppedAgain
from liftgate_hil.judging.trace_summary import TraceSummarizer, TraceSummary
from liftgate_hil.judging.verdict import Verdict
from liftgate_hil.loop.episode import Episode, LoopStart
from liftgate_hil.loop.observers import Sink
from liftgate_hil.signals import COLUMN_PLACE
from liftgate_hil.stimuli.bus_fault_tables import RECEIVED
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan

_SAME_DEG = 0.2  # by which a gate stepped again may differ from the recorded one: a few ticks' motion
_MOST = 2_000_000  # frames and rows that are kept; more are too many to step again


class CommandLog:
    """Sink that keeps the frames received by a gate, and the gate's angle in each tick."""

    def __init__(self) -> None:
        self._parts: list[Any] = []
        self._angles: list[NDArray[np.float64]] = []
        self._count = 0

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Keep received frames and the gate's angles; once there are too many, discard all of them."""
        come = frames[frames["is_sent"] == 0]
        self._count += len(come) + len(rows)
        if self._count > _MOST:
            self._parts, self._angles = [], []
            return
        self._angles.append(rows[:, COLUMN_PLACE["gate_angle_deg"]].copy())
        if len(come):
            self._parts.append(np.array(come))

    def frames(self) -> Any | None:
        """Return all frames received (n,) LOGGED; None: there were too many to be kept."""
        if self._count > _MOST:
            return None
        return np.concatenate([no_logged(), *self._parts])

    def angles(self) -> NDArray[np.float64]:
        """Return the gate's angle (n,) in each tick [deg]."""
        return np.concatenate([np.empty(0), *self._angles])


def relevant_frames(rig: Rig, frames: Any, expected: Expected, stimuli: StimulusPlan) -> Any:
    """Return the `frames` (n,) LOGGED, sent and received, that the gate, its tester or expectations read.

    Of the messages that only expectations read, those that the bench itself sends are left out. The frames are in
    the order of their arrival, whose times are in whole microseconds, as in recordings.
    """
    identifiers = [rig.identifier(each.message) for each in rig.inputs]
    if rig.diagnostics is not None:
        identifiers.append(rig.diagnostics.response)
    judged = {rig.identifier(name.partition(".")[0]) for name in expected.signals}
    identifiers += judged - set(stimuli.restbus.everything.messages["identifier"].tolist())
    found = np.array(frames[np.isin(frames["identifier"] & ~FD_FLAGS, identifiers)])
    found["time_ns"] = (found["time_ns"] + 500) // 1000 * 1000
    return found[np.argsort(found["time_ns"], kind="stable")]


class _Angles:
    """Sink that compares the gate's angle with its angle in the original run."""

    def __init__(self, known: NDArray[np.float64]) -> None:
        self._known = known
        self._seen = 0
        self.are_same = True

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Set `are_same` to False unless the angles in these rows are those of the original run."""
        angles = rows[:, COLUMN_PLACE["gate_angle_deg"]]
        known = self._known[self._seen : self._seen + len(angles)]
        self._seen += len(angles)
        self.are_same &= bool(np.all(np.abs(angles[: len(known)] - known) < _SAME_DEG))


@dataclass
class StepsAgain:
    """Function of a lateness [s]: simulates a run's gate again with commands that much earlier and later."""

    begun: LoopStart
    frames: Any  # (n,) LOGGED, see `relevant_frames`
    ticks: int  # of the run
    rig: Rig
    drives: int
    expected: Expected
    rate: float  # Hz
    end: float  # s, of the run and of every window
    angles: NDArray[np.float64]  # deg, the gate's in each tick of the run: it must move as it did then
    stopped: Callable[[], bool] = lambda: False
    _known: dict[float, _Stepped | None] = field(default_factory=dict)  # by commands' shift [s]

    def __call__(self, late: float) -> SteppedAgain | None:
        """Simulate again with the commands as they arrived, and `late` [s] earlier and later; return all verdicts.

        `late` is rounded up to a tick. Returns None where the plant diverged, the gate does not move as in the
        run, or the run is stopped.
        """
        shift = math.ceil(late * self.rate - 1e-6) / self.rate
        as_they_arrived, earlier, later = (self._at(each) for each in (0.0, -shift, shift))
        if as_they_arrived is None or earlier is None or later is None:
            return None
        changes = [
            change_around(as_they_arrived.trace_summaries.get(each.name), each, shift)
            for each in as_they_arrived.verdicts
        ]
        return SteppedAgain(as_they_arrived.verdicts, earlier.verdicts, later.verdicts, changes)

    def _at(self, shift: float) -> _Stepped | None:
        if shift not in self._known:
            try:
                self._known[shift] = self._stepped(shift)
            except (LiftgateError, GivenUpError):
                self._known[shift] = None
        return self._known[shift]

    def _stepped(self, shift: float) -> _Stepped | None:
        """Return verdicts with commands delayed by a shift [s] (0: and summaries); None: stopped, other motion."""
        start = self.begun.with_own_arrays()
        start.stimuli.bus_faults.rows["direction"] &= ~RECEIVED  # what was received is known
        judge = Judge(self.expected, self.rate, self.end)
        summarizer, angles = TraceSummarizer(judge, self.rate), _Angles(self.angles)
        sinks: list[Sink] = [judge] if shift else [judge, summarizer, angles]
        player = _CommandPlayer(self.rig, self.drives, self.frames, shift, self.begun)
        episode = Episode(start, player, sinks, is_recorded=judge.reads_the_bus)
        try:
            episode.begin()
            episode.run(self.ticks, self.stopped)
            if episode.ticks < self.ticks:
                return None
            episode.finish()
        finally:
            episode.close()
        if not angles.are_same:
            return None
        return _Stepped(judge.verdicts(), {} if shift else summarizer.trace_summaries())


class _Stepped(NamedTuple):
    """Result of one repeated simulation: verdicts, and trace summaries by the name of an expectation."""

    verdicts: Sequence[Verdict]
    trace_summaries: Mapping[str, TraceSummary]


class _CommandPlayer(Adapter):
    """Adapter that plays the `frames` (n,) LOGGED of a run to the gate, each `shift` [s] later."""

    kind = PORT

    def __init__(self, rig: Rig, drives: int, frames: Any, shift: float, begun: LoopStart) -> None:
        super().__init__(rig, drives)
        self._frames, self._next = frames, 0
        step_ns = begun.config.step_ns
        # A frame sent after the tick at a time is read by the next tick.
        ahead = step_ns - int(begun.stimuli.origin[0]) * step_ns
        self._due_ns = frames["time_ns"] + round(1e9 * shift) - ahead
        self._callback = INT_OF_STEP(self._on_step)
        port = wire.Port(wire.address_of(self._callback), 0, 0, 0)
        self.node = self.node._replace(port=port)

    def reset(self) -> None:
        """Do nothing: a reset does not change what the ECU has sent."""

    def _on_step(self, instance: int, now_ns: int, inbox: int, count: int, outbox: int, capacity: int) -> int:
        first, last = self._next, self._next
        most = min(len(self._due_ns), first + capacity)
        while last < most and self._due_ns[last] <= now_ns:
            last += 1
        self._next = last
        if last > first:
            frames, rows = self._frames[first:last], self.state.port.outbox.view(np.ndarray)[: last - first]
            rows["id"] = frames["identifier"] & 0xFFFFFFFF
            rows["length"] = frames["length"]
            rows["format"] = frame_flags(frames["identifier"])
            rows["payload"] = frames["payload"]
        return last - first


def change_around(trace_summary: TraceSummary | None, verdict: Verdict, late: float) -> float:
    """Return how far a verdict's deciding quantity changed within `late` [s] of its margin's time, in its unit.

    Only ticks on the same side of the limit count. It is 0 for a verdict without a margin, NaN where it is not
    known.
    """
    at = verdict.margin_time_s
    if at is None:
        return 0.0
    if trace_summary is None or trace_summary.near is None:
        return math.nan
    comparison = next((e for e in trace_summary.condition if e.text == verdict.decided_by), None)
    curves = {curve.side.text: curve for curve in trace_summary.near.curves}
    times = trace_summary.near.times
    chosen = np.abs(times - at) <= late + trace_summary.near.bin_s
    if comparison is None or not chosen.any():
        return math.nan
    gap = np.zeros(int(chosen.sum()))
    for side, sign in ((comparison.left, 1.0), (comparison.right, -1.0)):
        if side.constant is not None:
            gap += sign * side.constant
            continue
        curve = curves.get(side.text)
        if curve is None:
            return math.nan
        gap += sign * 0.5 * (curve.low + curve.high)[chosen]
    place = int(np.nanargmin(np.abs(times[chosen] - at)))
    same = gap[(np.sign(gap) == np.sign(gap[place])) & np.isfinite(gap)]
    return float(same.max() - same.min()) if len(same) else math.nan
