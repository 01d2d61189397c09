"""Helpers shared by tests of `hil`: frames made by cantools and crccheck, rigs from text, a loop's constants,
and what acts on it from outside.
"""

from __future__ import annotations

import functools
import struct
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from crccheck.crc import Crc8SaeJ1850
from hypothesis import settings
from numpy.typing import NDArray

from liftgate_compiler import compiled
from liftgate_hil.codec.bus_config import SignalMapping, build_bus_config
from liftgate_hil.codec.frames import EXTENDED, LOGGED, Frames, empty_frames
from liftgate_hil.codec.messages import Messages
from liftgate_hil.codec.protection import MessageOptions
from liftgate_hil.codec.receive import Counts, Reception, forget_stale, receive
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.codec.transmit import Transmission, first_transmission, transmit
from liftgate_hil.config.database import DatabaseFile, load_messages
from liftgate_hil.config.rig import Rig, load_rig
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.loop.tick import LoopConfig, LoopState, constants_in, copied, initial_loop, tick
from liftgate_hil.plan.plan import loop_config_of
from liftgate_hil.plan.setup import rig_from, vehicle_from
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.stimuli.stimulus_plan import (
    NO_STIMULI,
    Outside,
    StimulusPlan,
    TimedStimuli,
    outside_at,
    stimulus_plan_of,
)
from liftgate_hil.transport.base import LinkCounts
from liftgate_plant.initial import initial_state
from liftgate_plant.signals import Signal

CALM = settings(deadline=None, derandomize=True, database=None, max_examples=100)
FREE = Signal("", -1e300, 1e300, "anything")

COMMAND, BENCH_CONTROL = 0x120, 0x6E1
LEFT_DRIVE, RIGHT_DRIVE, GATE, SENSORS, BENCH_STATUS = 0x210, 0x211, 0x220, 0x230, 0x6E0
LEFT_HALL, RIGHT_HALL = 0x212, 0x213
LEFT_EDGES, RIGHT_EDGES, SWITCHES = 0x214, 0x215, 0x221
# In the order in which they are sent: each tick's, and those of slower cycles.
OF_DRIVES = (LEFT_DRIVE, RIGHT_DRIVE, LEFT_HALL, RIGHT_HALL, LEFT_EDGES, RIGHT_EDGES)
SLOWER = (GATE, SWITCHES, SENSORS, BENCH_STATUS)

COAST, OPEN, CLOSE, BRAKE = 0, 1, 2, 3


def frames_of(rows: Iterable[tuple[int, bytes]]) -> Frames:
    """Return frames made from pairs (identifier with flags, payload)."""
    pairs = list(rows)
    frames = Frames(
        len(pairs),
        np.array([identifier for identifier, _ in pairs], dtype=np.int64),
        np.array([len(payload) for _, payload in pairs], dtype=np.int64),
        np.zeros((len(pairs), 64), dtype=np.uint8),
    )
    for row, (_, payload) in enumerate(pairs):
        frames.data[row, : len(payload)] = np.frombuffer(payload, dtype=np.uint8)
    return frames


def rows_of(frames: Frames) -> list[tuple[int, bytes]]:
    """Return the pairs (identifier with flags, payload) of frames."""
    return [
        (int(frames.identifiers[row]), frames.data[row, : int(frames.lengths[row])].tobytes())
        for row in range(frames.count)
    ]


def logged(rows: Sequence[tuple[int, int, bytes]]) -> NDArray[Any]:
    """Return frames of a log from (time [ns], identifier, payload)."""
    found = np.zeros(len(rows), dtype=LOGGED)
    for row, (time_ns, identifier, payload) in zip(found, rows, strict=True):
        row["time_ns"], row["identifier"], row["length"] = time_ns, identifier, len(payload)
        row["payload"][: len(payload)] = list(payload)
    return found


class Wire:
    """A transport that keeps its frames in lists."""

    name = "wire"
    is_up = True

    def __init__(self) -> None:
        self.inbox: list[tuple[int, bytes]] = []
        self.sent: list[tuple[int, bytes]] = []

    def receive(self, timeout: float = 0.0) -> Frames:
        rows, self.inbox = self.inbox, []
        return frames_of(rows) if rows else empty_frames(0)

    def send(self, frames: Frames) -> None:
        self.sent += rows_of(frames)

    def counts(self) -> LinkCounts:
        return LinkCounts()

    def close(self) -> None:
        pass


def j1850(identifier: int, payload: bytes, skip: int) -> int:
    """Return the checksum (as in the database's comment, by crccheck) of a payload with it in byte `skip`."""
    covered = struct.pack("<H", identifier & 0xFFFF) + payload[:skip] + payload[skip + 1 :]
    return int(Crc8SaeJ1850.calc(covered))


def with_checksum(identifier: int, payload: bytes, at: int = 7) -> bytes:
    """Return the payload with its checksum in byte `at`."""
    return payload[:at] + bytes([j1850(identifier, payload, at)]) + payload[at + 1 :]


def command_payload(rig: Rig, counter: int, **values: float) -> bytes:
    """Return the payload of a DriveCommand of the shipped database."""
    signals: dict[str, float] = {
        "LeftDuty": 0.0,
        "RightDuty": 0.0,
        "LeftDirection": COAST,
        "RightDirection": COAST,
        "LatchRelease": 0,
        "AliveCounter": counter % 16,
        "Checksum": 0,
    }
    payload = rig.messages["DriveCommand"].encode({**signals, **values}, strict=False)
    return with_checksum(COMMAND, payload)


def command_frame(rig: Rig, counter: int, **values: float) -> tuple[int, bytes]:
    """Return a DriveCommand of the shipped database as (identifier, payload)."""
    return COMMAND, command_payload(rig, counter, **values)


def both(duty: float, direction: int, release: int = 0) -> dict[str, float]:
    """Return signal values of a DriveCommand, the same for both motors."""
    return {
        "LeftDuty": duty,
        "RightDuty": duty,
        "LeftDirection": direction,
        "RightDirection": direction,
        "LatchRelease": release,
    }


def panel_frame(rig: Rig, **values: float) -> tuple[int, bytes]:
    """Return a BenchControl of the shipped database as (identifier, payload)."""
    signals: dict[str, float] = {
        "ObstacleAngle": 0.0,
        "ObstacleRate": 0.0,
        "RoadSlope": 0.0,
        "SupplyVoltage": 12.0,
        "HandForce": 0.0,
    }
    return BENCH_CONTROL, rig.messages["BenchControl"].encode({**signals, **values})


def decoded(rig: Rig, frames: Frames, name: str) -> list[dict[str, Any]]:
    """Return the frames of one message as decoded by cantools."""
    message = rig.messages[name]
    identifier = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
    return [
        dict(message.decode(payload, decode_choices=False, allow_excess=False))
        for frame, payload in rows_of(frames)
        if frame == identifier
    ]


def loop_config(
    rate: float = 1000.0, rig: Rig | None = None, settings: Sequence[str] = (), seed: int = 0
) -> LoopConfig:
    """Return a loop's constants for the shipped vehicle."""
    vehicle = vehicle_from("suv", settings, ideal=True)
    return loop_config_of(vehicle, rig or shipped_rig(), rate, seed)


def stimulus_plan(
    config: LoopConfig, stimuli: TimedStimuli = NO_STIMULI, requests: Sequence[Request] = ()
) -> StimulusPlan:
    """Return the stimuli of one run; they have memory, so each run needs its own."""
    return stimulus_plan_of(constants_in(config), stimuli, requests)


@cache
def _shipped() -> LoopConfig:
    return loop_config()


def stimuli_alone(stimuli: TimedStimuli = NO_STIMULI) -> StimulusPlan:
    """Return the stimuli where only they are tested, and no gate is run."""
    return stimulus_plan(_shipped(), stimuli)


@cache
def _nothing() -> StimulusPlan:
    return stimuli_alone()


def outside(
    around: StimulusPlan | None = None,
    time: float = 0.0,
    missed: int = 0,
    silent: bool = False,
    stop: bool = False,
) -> Outside:
    """Return the stimuli of one tick that begins at a time [s], without posted commands."""
    given = _nothing() if around is None else around
    return compiled(outside_at)(given, time, 0.001, missed, silent, stop)


Ticked = list[tuple[LoopState, Frames, Any, Any]]


def catch_up(
    call: Callable[..., Any],
    config: LoopConfig,
    state: LoopState,
    frames: Frames,
    steps: int,
    missed: int = 0,
    around: StimulusPlan | None = None,
) -> Ticked:
    """Run several ticks at once, and return the results of each; the first gets the frames, all but the last are
    silent to make up for a missed tick. `missed` ticks were missed before.
    """
    ticked: Ticked = []
    for left in range(steps - 1, -1, -1):
        silent = left > 0
        missed += silent
        given = outside(around, state.tick * config.step, missed, silent=silent)
        ticked.append(call(config, state, frames, given))
        state, frames = ticked[-1][0], empty_frames(0)
    return ticked


@functools.cache
def shipped_rig() -> Rig:
    """Return the shipped rig; its database is read only once."""
    return rig_from("liftgate")


def start_of(config: LoopConfig, angle: float = 0.0, latched: bool = True) -> LoopState:
    """Return the state of a loop at rest at an angle [rad]."""
    return initial_loop(config, initial_state(config.plant, angle, latched=latched))


def wait_for(happened: Callable[[], object], what: str = "it did not happen", patience: float = 120.0) -> None:
    """Wait until something has happened; how long [s] it may take is not judged."""
    deadline = time.monotonic() + patience
    while not happened():
        assert time.monotonic() < deadline, what
        time.sleep(0.005)


def text_file(path: Path, text: str) -> Path:
    """Write a text to a file, and return the path."""
    path.write_text(text, encoding="utf-8")
    return path


def issues_of(call: Callable[..., object], *arguments: Any, **named: Any) -> list[str]:
    """Return the lines of the ConfigError of a call, none of which may have a control character."""
    with pytest.raises(ConfigError) as caught:
        call(*arguments, **named)
    assert all(issue.isprintable() for issue in caught.value.issues)
    return caught.value.issues


def keys_of(issues: Iterable[str]) -> list[str]:
    """Return the key in a file that each of these issues names."""
    return [issue.split(": ")[1] for issue in issues]


def database_of(body: str, cycle_ms: int = 10, nodes: str = "ECU Gate") -> str:
    """Return a DBC whose messages get this cycle where they have none of their own."""
    attributes = f'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\nBA_DEF_DEF_ "GenMsgCycleTime" {cycle_ms};\n'
    return f'VERSION ""\nBS_:\nBU_: {nodes}\n{body}{attributes}'


def messages_in(path: Path) -> Messages:
    """Return the messages of a database that has no issue."""
    issues = ConfigIssues("r.toml")
    messages = load_messages(issues, DatabaseFile(path))
    assert not issues.lines
    return messages


def write_rig(folder: Path, database: str, text: str) -> Path:
    """Write a rig file beside its database `their.dbc`."""
    (folder / "their.dbc").write_text(database, encoding="cp1252")
    return text_file(folder / "their.toml", text)


def rig_of(folder: Path, database: str, text: str) -> Rig:
    """Write a rig file beside its database, and load it."""
    return load_rig(write_rig(folder, database, text))


def bus_config_of(
    messages: Mapping[str, Any],
    mappings: Sequence[SignalMapping],
    options: Mapping[str, MessageOptions] | None = None,
    quantities: Mapping[str, Signal] | None = None,
    sending: bool = False,
) -> BusConfig:
    """Return tables for signals whose quantities may have any value."""
    issues = ConfigIssues("test")
    bus = build_bus_config(
        messages,
        mappings,
        options or {},
        quantities or {wire.quantity: FREE for wire in mappings},
        issues,
        sending,
    )
    issues.raise_if_any()
    return bus


# The codec and the tick as functions of their arguments: what they remember in arrays is copied first.


def taken(
    bus: BusConfig,
    reception: Reception,
    counts: Counts,
    frames: Frames,
    now_ns: int,
    call: Callable[..., Counts] = receive,
) -> tuple[Reception, Counts]:
    """Return the reception and its counts after these frames."""
    after = copied(reception)
    return after, call(bus, after, counts, frames, now_ns)


def forgotten(bus: BusConfig, reception: Reception, now_ns: int) -> tuple[Reception, int]:
    """Return the reception at a later time, and how many messages became stale."""
    after = copied(reception)
    return after, forget_stale(bus, after, now_ns)


def transmitted(
    bus: BusConfig,
    values: Sequence[float] | NDArray[np.float64],
    before: Transmission | None = None,
    now_ns: int = 0,
    everything: bool = True,
    call: Callable[..., Frames] = transmit,
) -> tuple[Transmission, Frames]:
    """Return the transmission state after these values, and the frames sent."""
    after = copied(before) if before else first_transmission(bus, len(values))
    after.values[:] = values
    return after, copied(call(bus, after, now_ns, everything))


def pure(call: Callable[..., Any]) -> Callable[..., Any]:
    """Return the tick `call` as a function that does not modify its state, and whose frames stay unchanged."""

    def ticked(config: LoopConfig, state: LoopState, frames: Frames, given: Outside) -> Any:
        after, replies, truth, sensed = call(config, copied(state), frames, given)
        return after, copied(replies), truth, sensed

    return ticked


plain_tick = pure(tick)
