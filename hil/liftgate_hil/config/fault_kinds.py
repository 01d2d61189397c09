"""Kinds of faults, each with keys, meaning and effect: on constants of the gate model, or on frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from liftgate_hil.config.described import REQUIRED, Field
from liftgate_hil.config.kinds import Choice, Kind, Level, Number, Text, Whole
from liftgate_hil.signals import DIRECTIONS
from liftgate_hil.stimuli import bus_fault_tables
from liftgate_hil.stimuli.faults import ADD, SCALE, SET, Edit
from liftgate_plant.signals import SIDES

WHERE = (*SIDES, "both")

# What a kind of fault affects.
DRIVE, GATE, MESSAGE, BUS = "a drive", "the gate", "a message", "the bus"

# A disconnected drive is one whose clutch slips at once, so that it can engage again in any position.
_NO_FORCE = 1e-9  # N
_JAMMED = 1e6  # N m of dry friction, which no motor overcomes

# Flags without which the plant skips broken lines and faults of its inputs.
_BROKEN, _INPUTS = Edit("plant.lines_broken", SET, 1.0), Edit("faults.inputs", SET, 1.0)

Values = Mapping[str, Any]


@dataclass(frozen=True)
class FaultKind:
    """A kind of fault: meaning, keys, and its edits as a function of values and side ("": the whole gate)."""

    name: str
    meaning: str
    edits: Callable[[Values, str], Sequence[Edit]]
    keys: tuple[Field, ...] = ()
    of: str = DRIVE
    group: str = ""  # of the part that it is a fault of, in words

    @property
    def has_place(self) -> bool:
        """Whether faults of the kind have the key `where`: a drive or a message."""
        return self.of in (DRIVE, MESSAGE)


def _line(field: str, how: int) -> Callable[[Values, str], Sequence[Edit]]:
    """Return a kind's `edits`: SET, SCALE or ADD (`how`) a field of a drive's line with the key `ohm`, else 1."""
    return lambda values, side: [_BROKEN, Edit(f"plant.{side}.line.{field}", how, float(values.get("ohm", 1.0)))]


def _hall(field: str, key: str = "") -> Callable[[Values, str], Sequence[Edit]]:
    """Return a kind's function `edits`: set a field of a drive's Hall faults to the key `key`; "": to 1."""
    return lambda values, side: [
        Edit(f"faults.{side}.hall.is_on", SET, 1.0),
        Edit(f"faults.{side}.hall.{field}", SET, float(values[key]) if key else 1.0),
        *([Edit(f"faults.{side}.hall.seed", SET, float(values["seed"]))] if field in ("missing", "extra") else []),
    ]


def _current(field: str, how: int, key: str = "") -> Callable[[Values, str], Sequence[Edit]]:
    """Return a kind's `edits`: SET, SCALE or ADD (`how`) a drive's current faults with the key `key`; "": 1."""
    return lambda values, side: [
        Edit(f"faults.{side}.current.is_on", SET, 1.0),
        Edit(f"faults.{side}.current.{field}", how, float(values[key]) if key else 1.0),
    ]


def _gain(values: Values, side: str) -> Sequence[Edit]:
    """Return the edits of a current sensor's gain fault, which also scale the offset of earlier faults."""
    offset = Edit(f"faults.{side}.current.offset", SCALE, float(values["factor"]))
    return [*_current("gain", SCALE, "factor")(values, side), offset]


def _short(values: Values, side: str) -> Sequence[Edit]:
    """Return the edits of a motor's short circuit: in its line, and in the current reading."""
    line = Edit(f"plant.{side}.line.is_shorted", SET, 1.0)
    return [_BROKEN, line, *_current("shorted", SET)(values, side)]


def _gate(name: str, how: int, key: str = "") -> Callable[[Values, str], Sequence[Edit]]:
    """Return a kind's `edits`: SET, SCALE or ADD (`how`) the gate's constant `name` with the key `key`; "": 1."""
    also = {"plant.source_open": [_BROKEN], "faults.latch_held": [_INPUTS]}.get(name, [])
    return lambda values, side: [*also, Edit(name, how, float(values[key]) if key else 1.0)]


def _bridge(values: Values, side: str) -> Sequence[Edit]:
    """Return the edits of a bridge that stays in the state that is the fault's key `state`."""
    return [_INPUTS, Edit(f"faults.{side}.bridge", SET, float(DIRECTIONS.index(values["state"])))]


def _drive(how: int, value: float | None, *names: str) -> Callable[[Values, str], Sequence[Edit]]:
    """Return a kind's `edits`: SET, SCALE or ADD (`how`) a drive's constants with `value`; None: key `factor`."""
    return lambda values, side: [
        Edit(f"plant.{side}.{name}", how, float(values["factor"]) if value is None else value) for name in names
    ]


def _none(values: Values, side: str) -> Sequence[Edit]:
    """Stand in for the edits of a kind that has none; never called."""
    raise AssertionError("made of the vehicle, or of the bus")


def _key(name: str, kind: Kind, meaning: str, default: object = REQUIRED) -> tuple[Field, ...]:
    """Return a kind's required key, or optional one with a default, as a tuple that can be joined with others."""
    return (Field(kind, meaning, name=name, default=default),)


_DIRECTION = _key("direction", Choice(list(bus_fault_tables.DIRECTIONS)), "as seen from the gate")
_LEVEL = _key("value", Level(), "level at which it is stuck")
_GROUPS = {
"Supply, motors and bridges": (
    FaultKind("supply_open", "no current can be drawn from or fed into the supply; braking still works",
              _gate("plant.source_open", SET), of=GATE),
    FaultKind("motor_open", "the line between bridge and motor is open: no current flows any more",
              _line("is_open", SET)),
    FaultKind("motor_short", "the motor's terminals are shorted: the motor's voltage is 0, and the shunt "
              "reads the converter's limit while the bridge drives", _short),
    FaultKind("bridge_stuck", "the bridge stays in one state, at full voltage, whatever is commanded",
              _bridge, _key("state", Choice(DIRECTIONS), "state of the bridge")),
    FaultKind("contact_resistance", "there is a resistance in series with the motor", _line("resistance", ADD),
              _key("ohm", Number(0.0, 1e6, "Ω"), "additional resistance")),
),
"Hall sensors": (
    FaultKind("hall_a_stuck", "Hall A is stuck at a level", _hall("level_a", "value"), _LEVEL),
    FaultKind("hall_b_stuck", "Hall B is stuck at a level", _hall("level_b", "value"), _LEVEL),
    FaultKind("hall_missing", "decoder and timer miss edges; at the edge after a missed one both levels have "
              "changed, and the decoder does not count it",
              _hall("missing", "probability"),
              _key("probability", Number(0.0, 1.0), "probability that an edge is missed")),
    FaultKind("hall_extra", "additional edges without motion of the shaft, on A or B at random",
              _hall("extra", "rate"),
              _key("rate", Number(0.0, 1e5, "1/s"), "mean rate of these edges")),
    FaultKind("hall_swapped", "Hall A and B are exchanged: the count runs backwards", _hall("swapped")),
),
"Current and angle readings": (
    FaultKind("current_offset", "an offset is added to the current reading; several offsets and gains "
              "act in the order in which they are listed",
              _current("offset", ADD, "value"),
              _key("value", Number(-1e3, 1e3, "A"), "offset of the reading")),
    FaultKind("current_gain", "the current reading is multiplied by a factor; several offsets and gains "
              "act in the order in which they are listed",
              _gain, _key("factor", Number(-100.0, 100.0), "factor on the reading")),
    FaultKind("current_frozen", "the current reading keeps its last value, offsets and gains included",
              _current("frozen", SET)),
    FaultKind("angle_offset", "an offset is added to the angle reading",
              _gate("sensors.angle_offset", ADD, "value"),
              _key("value", Number(-360.0, 360.0, "deg", math.radians(1.0)), "offset of the reading"), of=GATE),
    FaultKind("angle_frozen", "the angle reading keeps its last value, offset included",
              _gate("faults.angle_frozen", SET), of=GATE),
),
"Springs and drives": (
    FaultKind("spring_lost", "the drive's spring has no force left",
              _drive(SCALE, 0.0, "spring.health")),
    FaultKind("spring_weak", "the drive's spring has less force", _drive(SCALE, None, "spring.health"),
              _key("factor", Number(0.0, 10.0), "factor on its force")),
    FaultKind("drive_disconnected", "the drive turns without moving the gate, and the gate cannot turn it",
              _drive(SET, _NO_FORCE, "clutch_force")),
    FaultKind("spindle_jammed", "the drive is blocked: neither its motor nor the gate can turn it",
              _drive(SET, _JAMMED, "friction.coulomb")),
    FaultKind("friction", "the drive's friction is multiplied by a factor: dry, viscous and load-dependent",
              _drive(SCALE, None, "friction.coulomb", "friction.viscous", "load_friction"),
              _key("factor", Number(0.0, 1e4), "factor on the friction")),
),
"Latch": (
    FaultKind("latch_stuck", "the latch switch keeps one reading, whatever the latch does",
              _gate("faults.latch_reading", SET, "value"),
              _key("value", Level(("open", "latched")), "the reading"), of=GATE),
    FaultKind("latch_not_releasing", "the latch does not release, whatever drives it",
              _gate("faults.latch_held", SET), of=GATE),
),
"Vehicle parameters": (
    FaultKind("parameter", "a number of the vehicle file gets another value", _none, (
        *_key("key", Text("a key of the vehicle file"), "for example `gate.mass` or `left.motor.resistance`"),
        *_key("value", Number(-1e15, 1e15), "new value, in the file's unit"),
        *_key("ramp_s", Number(0.0, 1e6, "s"), "duration of the linear transition to it", 0.0),
    ), of=GATE),
),
"Frames": (
    FaultKind("frame_lost", "frames do not arrive", _none, (
        *_DIRECTION, *_key("probability", Number(0.0, 1.0), "probability that a frame is lost", 1.0)), of=MESSAGE),
    FaultKind("frame_delayed", "frames arrive later", _none, (
        *_DIRECTION, *_key("delay_s", Number(0.0, 10.0, "s"), "how much later each frame arrives")),
        of=MESSAGE),
    FaultKind("frame_repeated", "each frame is repeated once", _none, _DIRECTION, of=MESSAGE),
    FaultKind("frame_corrupted", "one random bit of the data is inverted, in a frame that is valid on the bus; "
              "bits on the wire, where the frame's own CRC would detect it, cannot be changed", _none, _DIRECTION,
              of=MESSAGE),
    FaultKind("wrong_counter", "the alive counter keeps its value of the last frame before the fault; the "
              "checksum is correct", _none, _DIRECTION, of=MESSAGE),
    FaultKind("wrong_checksum", "all bits of the checksum are inverted", _none, _DIRECTION, of=MESSAGE),
    FaultKind("wrong_length", "the frame has the next shorter valid length", _none, _DIRECTION, of=MESSAGE),
    FaultKind("frame_frozen", "the data remain those of the last frame before the fault, counter and checksum "
              "included", _none, _DIRECTION, of=MESSAGE),
),
"Bus": (
    FaultKind("babbling", "a node keeps sending frames of eight zero bytes (a babbling idiot)", _none, (
        *_DIRECTION,
        *_key("id", Whole(0, 0x1FFFFFFF), "identifier; above 0x7FF an extended one"),
        *_key("rate", Number(0.0, 1e5, "1/s"), "rate of the frames"),
    ), of=BUS),
    FaultKind("bus_off", "the gate neither sends nor receives. A real CAN controller cannot be taken off its bus: "
              "there the gate only stops sending and receiving, and the scenario is inconclusive", _none, of=BUS),
),
}  # fmt: skip

FAULT_KINDS: Mapping[str, FaultKind] = {
    kind.name: replace(kind, group=group) for group, kinds in _GROUPS.items() for kind in kinds
}
