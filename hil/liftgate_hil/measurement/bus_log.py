"""Bus logs as measurements: the ECU's command frames are the inputs, the sensors' frames the outputs.

The emulator's own codec judges each frame (length, checksum, counter, ranges), so that what it would refuse on the
bus is refused here, too. Before the first command, and once a command is stale, the motors coast.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.bus_config import SignalMapping
from liftgate_hil.codec.frames import Frames
from liftgate_hil.codec.receive import Counts, rejected
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import ConfigError, number_of
from liftgate_hil.formats.recording import AS_IT_IS, ReadOptions
from liftgate_hil.loop.tick import bridge_command
from liftgate_hil.measurement.log_frames import read_frames
from liftgate_hil.measurement.measurement import INPUTS, OUTPUTS, Floats, Measurement
from liftgate_hil.measurement.walk import events_in
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS, PROFILES, Command
from liftgate_plant.signals import SIDES, Sensed, Signal, bus_name, signals_of

# Our columns by the bus quantities that correspond to exactly one.
_PANEL = {bus_name(column, signal): column for column, signal in PROFILES.items()}
_SENSED = {bus_name(column, signal): column for column, signal in signals_of(Sensed).items() if column in OUTPUTS}
_COMMANDS = Command._fields
_OUT_OF_TURN_NS = 10_000_000
_LONGEST_NS = 10**18  # 32 years: a longer file is no log


@dataclass(frozen=True)
class Track:
    """Quantity over time, decoded from frames: times [ns], and values, NaN where its message went stale."""

    times: NDArray[np.int64]
    values: Floats

    def held(self, at: NDArray[np.int64], before: float) -> Floats:
        """Return the last value at each of the times `at` [ns]; `before` where there is none yet."""
        index = np.searchsorted(self.times, at, side="right") - 1
        return np.where(index >= 0, self.values[np.maximum(index, 0)], before)

    def without_stale(self) -> Track:
        """Return the track without the NaN values at which its message went stale."""
        there = np.isfinite(self.values)
        return Track(self.times[there], self.values[there])


def read_bus_log(path: Path, rig: Rig, before: Mapping[str, float], how: ReadOptions = AS_IT_IS) -> Measurement:
    """Read a bus log as a measurement; `before` holds panel inputs until their first frame. Raises ConfigError."""
    rig = replace(
        rig,
        inputs=tuple(wire for wire in rig.inputs if wire.quantity in (*_COMMANDS, *_PANEL)),
        outputs=tuple(wire for wire in rig.outputs if wire.quantity in _SENSED),
    )
    messages = list(dict.fromkeys(wire.message for wire in (*rig.inputs, *rig.outputs)))
    log = read_frames(path, messages, rig, how=how)
    frames, cut = log.frames, log.notes
    if frames.count == 0:
        instead = f", but {'; '.join(cut)}" if cut else ""
        raise ConfigError(f"{path}: no frame of the rig{instead}; allowed: {_called(rig, messages)}")
    # Loggers have timestamps in microseconds; MF4 has floats of seconds.
    times = (log.times_ns - log.times_ns[0] + 500) // 1000 * 1000
    if not np.all(np.abs(times) <= _LONGEST_NS):
        raise ConfigError(f"{path}: invalid times; allowed: within {_LONGEST_NS / 1e9:g} s of the first frame")
    times = _in_order(path, times)
    given, counts, _ = tracks_of(rig.input_config(), BUS_INPUTS, frames, times)
    sensed, sensor_counts, without = reported(rig, frames, times)
    sensed = {name: track.without_stale() for name, track in sensed.items()}
    _check_content(path, rig, given, sensed, _add(counts, sensor_counts))
    marks = np.unique(np.concatenate([t.times for t in (*given.values(), *sensed.values())]))
    columns = _inputs({wire.quantity for wire in rig.inputs}, given, marks, before)
    for wire in rig.outputs:
        if wire.quantity not in sensed:
            continue
        track, column = sensed[wire.quantity], _SENSED[wire.quantity]
        values = track.values
        if column.endswith("hall_count"):
            values = unwrapped(values, span_of(rig, wire))
        columns[column] = np.full(len(marks), np.nan)
        columns[column][np.searchsorted(marks, track.times)] = values
    _check_ranges(path, columns)
    ordered = {name: columns[name] for name in (*INPUTS, *OUTPUTS) if name in columns}
    refusals = refusals_in(_add(counts, sensor_counts))
    notes = [*cut, *refusals, *without, *_late_panel(given, before)]
    return Measurement(str(path), (marks - marks[0]) / 1e9, ordered, True, tuple(notes))


def unwrapped(values: Floats, span: float) -> Floats:
    """Return a counter that wraps around at `span` without its jumps; span 0: it does not wrap."""
    if span <= 0.0 or len(values) == 0:
        return values
    steps = np.diff(values)
    steps -= span * np.round(steps / span)
    result: Floats = values[0] + np.concatenate([np.zeros(1), np.cumsum(steps)])
    return result


def span_of(rig: Rig, wire: SignalMapping) -> float:
    """Return the span after which a counter signal wraps, in its quantity's unit; 0: it does not wrap."""
    signal = rig.messages[wire.message].get_signal_by_name(wire.signal)
    if signal.is_float or signal.length > 48:
        return 0.0
    return abs(wire.scale * float(signal.scale)) * 2.0**signal.length


def _in_order(path: Path, times: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return timestamps made non-decreasing: frames may be up to 10 ms out of order. Raises ConfigError."""
    rising = np.maximum.accumulate(times)
    late = np.flatnonzero(rising - times > _OUT_OF_TURN_NS)
    if len(late):
        at = int(late[0])
        raise ConfigError(
            f"{path}: time {times[at] / 1e9:.6f} s of frame {at + 1} of the rig comes after "
            f"{rising[at] / 1e9:.6f} s; allowed: rising"
        )
    return rising


def _called(rig: Rig, messages: Sequence[str]) -> str:
    return ", ".join(f"{name} (0x{rig.messages[name].frame_id:X})" for name in messages)


def reported(rig: Rig, frames: Frames, times: NDArray[np.int64]) -> tuple[dict[str, Track], Counts, list[str]]:
    """Decode the quantities that a rig's gate has sent; return their tracks, the frame counts, and notes.

    A value that its quantity cannot have, as an unknown label, is left out and noted; the other signals of its
    frame count. `times` [ns] are those of the frames, and rise.
    """
    layout = rig.output_config(sending=False)
    tracks, counts, without = tracks_of(layout, BUS_OUTPUTS, frames, times, by_signal=True)
    wires = {list(BUS_OUTPUTS).index(wire.quantity): wire for wire in rig.outputs}
    notes = []
    for row in np.flatnonzero(without["count"]).tolist():
        wire, found = wires[int(layout.signals[row].quantity)], without[row]
        choices: Mapping[int, Any] = rig.messages[wire.message].get_signal_by_name(wire.signal).choices or {}
        label = choices.get(int(found.value)) if float(found.value).is_integer() else None
        value = f"{found.value:g}" if label is None else f"{found.value:g} ({label})"
        notes.append(
            f"{wire.message}.{wire.signal}: {value} at {1e-9 * found.time_ns:.3f} s is no value of "
            f"{wire.quantity}; left out in {number_of(int(found['count']), 'frame')}"
        )
    return tracks, counts, notes


def tracks_of(
    layout: BusConfig,
    names: Mapping[str, Signal],
    frames: Frames,
    times: NDArray[np.int64],
    by_signal: bool = False,
) -> tuple[dict[str, Track], Counts, Any]:
    """Decode frames into a track of each quantity; return the frame counts and values left out, too.

    `times` [ns] are those of the frames, and rise.
    """
    at, which, values, counts, without = events_in(layout, frames, times, len(names), by_signal)
    tracks = {}
    for index, name in enumerate(names):
        mine = np.flatnonzero(which == index)
        if len(mine):
            # Of several frames in one microsecond the last one counts.
            last = np.append(np.diff(at[mine]) > 0, True)
            tracks[name] = Track(at[mine][last], values[mine][last])
    return tracks, counts, without


def _add(one: Counts, other: Counts) -> Counts:
    return Counts(*(a + b for a, b in zip(one, other, strict=True)))


def refusals_in(counts: Counts) -> list[str]:
    """Return notes on frames that were refused or lost."""
    causes = ("remote", "wrong_length", "out_of_range", "checksum", "counter", "unqualified")
    reasons = [f"{getattr(counts, cause)} {cause.replace('_', ' ')}" for cause in causes if getattr(counts, cause)]
    notes = []
    if reasons:
        refused = rejected(counts) + counts.unqualified
        notes.append(f"{refused} frames of the rig refused: {', '.join(reasons)}")
    if counts.lost:
        notes.append(f"{counts.lost} frames missing according to the alive counters")
    return notes


def _late_panel(given: Mapping[str, Track], before: Mapping[str, float]) -> list[str]:
    return [
        f"{column}: its first value is also used for the time before it"
        for name, column in _PANEL.items()
        if name in given and column not in before and given[name].times[0] > 0
    ]


def _check_content(
    path: Path, rig: Rig, given: Mapping[str, Track], sensed: Mapping[str, Track], counts: Counts
) -> None:
    """Raise ConfigError unless a bus log holds both commands and sensor values."""
    issues = []
    why = "; ".join(refusals_in(counts))
    why = f" ({why})" if why else ""
    for what, found, wires in (
        ("command", any(name in given for name in ("left_duty", "right_duty")), rig.inputs),
        ("sensor", any(len(track.times) for track in sensed.values()), rig.outputs),
    ):
        if not found:
            names = list(dict.fromkeys(wire.message for wire in wires if wire.quantity not in _PANEL))
            issues.append(f"{path}: no valid {what} frame{why}; allowed: {_called(rig, names)}")
    if issues:
        raise ConfigError(issues)


def _check_ranges(path: Path, columns: Mapping[str, Floats]) -> None:
    issues = []
    for name, values in columns.items():
        signal = {**INPUTS, **OUTPUTS}[name]
        low, high = signal.low, signal.high
        bad = np.flatnonzero((values < low) | (values > high))
        if len(bad):
            issues.append(
                f"{path}: {name}: {values[bad[0]]:.9g} in the frame of row {bad[0] + 1}; "
                f"allowed: {low:g} to {high:g}"
            )
    if issues:
        raise ConfigError(issues)


def _inputs(
    wired: set[str], given: Mapping[str, Track], marks: NDArray[np.int64], before: Mapping[str, float]
) -> dict[str, Floats]:
    """Return the plant's input columns at times `marks` [ns], each value held until the next."""
    columns = {}

    def held(name: str) -> Floats:
        return given[name].held(marks, np.nan) if name in given else np.full(len(marks), np.nan)

    for side in SIDES:
        if f"{side}_duty" not in wired:
            continue
        signed = f"{side}_direction" not in wired
        pairs = zip(held(f"{side}_duty"), held(f"{side}_direction"), strict=True)
        drives = [bridge_command(float(duty), float(to), int(signed)) for duty, to in pairs]
        columns[f"{side}_duty"] = np.array([drive.duty for drive in drives])
        columns[f"{side}_coast"] = np.array([drive.coast for drive in drives])
    for name, column in (("latch_release", "latch_released"), ("latch_cinch", "latch_cinched")):
        if name in wired:
            columns[column] = np.nan_to_num(held(name), nan=0.0)
    for name, column in _PANEL.items():
        if name in given:
            first = before.get(column, float(given[name].values[0]))
            columns[column] = given[name].held(marks, first)
    return columns
