"""The catalogue: the plant's quantities, and those of bus and loop.

A rig file wires `BUS_INPUTS` and `BUS_OUTPUTS` to signals of a database; recordings and `simulate` have `COLUMNS`;
scenarios move `PROFILES`. All of them derive from the rows, here and in `liftgate_plant.signals`: a new sensor
signal is a field of `Sensed`, and with that a column, and an output that a rig can wire.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

from liftgate_plant.signals import (
    EDGE_AGE,
    LATCH_CINCHED,
    LATCH_RELEASED,
    PINCH_FORCE,
    Drives,
    Sensed,
    Signal,
    Surroundings,
    Truth,
    bus_name,
    signals_of,
)

DIRECTIONS = ("coast", "open", "close", "brake")
LATCH_COMMANDS = ("hold", "release")
CINCH_COMMANDS = ("off", "pull")
EDGE_NUMBERS = 256  # an edge's number is told modulo this
EMULATOR_STATES = ("waiting", "running", "timeout", "stopped")

_DUTY = Signal("%", -100.0, 100.0, "PWM duty; signed where no direction is mapped")
_DIRECTION = Signal("", 0.0, 3.0, "bridge state", DIRECTIONS)
_TIME = Signal("µs", 0.0, 1e12, "")


class Command(NamedTuple):
    """What the ECU says. NaN: not there."""

    left_duty: Annotated[float, _DUTY]
    right_duty: Annotated[float, _DUTY]
    left_direction: Annotated[float, _DIRECTION]
    right_direction: Annotated[float, _DIRECTION]
    latch_release: Annotated[float, Signal("", 0.0, 1.0, "drives the latch open", LATCH_COMMANDS)]
    latch_cinch: Annotated[
        float,
        Signal("", 0.0, 1.0, "drives the cinching motor, of a latch as built", CINCH_COMMANDS),
    ]


class Rod(NamedTuple):
    """The obstacle that a test bench's panel sets, met while closing."""

    obstacle_angle: Annotated[float, Signal("deg", -10.0, 180.0, "where the gate meets it")]
    obstacle_rate: Annotated[
        float, Signal("N/mm", 0.0, 1e4, "the obstacle's spring rate; 0 is no obstacle")
    ]


# An obstacle as scenarios and programs describe it.
OBSTACLE: dict[str, Signal] = {
    "angle_deg": signals_of(Rod)["obstacle_angle"],
    "distance": Signal("m", 0.01, 10.0, "from the hinge"),
    "stiffness": Signal("N/m", 1.0, 1e7, "of its spring"),
    "damping": Signal("N s/m", 0.0, 1e6, "beside the spring"),
    "lateral": Signal("m", -5.0, 5.0, "from the gate's middle, positive to the left"),
    "gap": Signal("m", -1.0, 1.0, "before the gate touches it at that angle"),
}


_NUMBER = Signal("", 0.0, EDGE_NUMBERS - 1.0, "Hall edges so far, modulo 256", is_whole=True)
_AGES = [
    EDGE_AGE._replace(meaning=f"since the last Hall edge {which}; before it since the start")
    for which in ("", "but one", "but two", "but three")
]


class EdgeTimes(NamedTuple):
    """The last Hall edges of each drive, for an ECU's timer; all of them are recorded beside the rows."""

    left_edge_number: Annotated[float, _NUMBER]
    left_edge_age_1: Annotated[float, _AGES[0]]
    left_edge_age_2: Annotated[float, _AGES[1]]
    left_edge_age_3: Annotated[float, _AGES[2]]
    left_edge_age_4: Annotated[float, _AGES[3]]
    right_edge_number: Annotated[float, _NUMBER]
    right_edge_age_1: Annotated[float, _AGES[0]]
    right_edge_age_2: Annotated[float, _AGES[1]]
    right_edge_age_3: Annotated[float, _AGES[2]]
    right_edge_age_4: Annotated[float, _AGES[3]]


class Status(NamedTuple):
    """What the emulator says of itself."""

    tick_overruns: Annotated[float, Signal("", 0.0, 1e18, "periods skipped", is_whole=True)]
    command_timeouts: Annotated[
        float, Signal("", 0.0, 1e18, "times the command went stale", is_whole=True)
    ]
    rejected_frames: Annotated[
        float, Signal("", 0.0, 1e18, "frames of ours that were refused", is_whole=True)
    ]
    emulator_state: Annotated[float, Signal("", 0.0, 3.0, "of this program", EMULATOR_STATES)]
    pinch_force_max: Annotated[
        float, PINCH_FORCE._replace(meaning="the largest pinch force since its last frame")
    ]


class Timing(NamedTuple):
    """How well the loop keeps time; NaN on a clock that is not real time."""

    lateness_p50: Annotated[float, _TIME._replace(meaning="median lateness of a tick")]
    lateness_p99: Annotated[float, _TIME._replace(meaning="99 % of the ticks are not later")]
    lateness_p999: Annotated[float, _TIME._replace(meaning="99.9 % of the ticks are not later")]
    lateness_max: Annotated[float, _TIME._replace(meaning="of the latest tick")]
    execution_p50: Annotated[float, _TIME._replace(meaning="median time that a tick takes")]
    execution_max: Annotated[float, _TIME._replace(meaning="of the longest tick")]
    command_delay_p50: Annotated[float, _TIME._replace(meaning="command to feedback, median")]
    command_delay_max: Annotated[float, _TIME._replace(meaning="command to feedback, longest")]
    command_delay_force: Annotated[float, Signal("N", 0.0, 1e9, "what that is on the 10 N/mm rod")]


class Bench(NamedTuple):
    """Of each tick, how well the bench itself kept up; zeros on a clock that waits for nobody."""

    ticks_missed: Annotated[
        float,
        Signal("", 0.0, 1e18, "ticks so far that the loop missed and made up for", is_whole=True),
    ]
    frames_dropped: Annotated[
        float,
        Signal(
            "", 0.0, 1e18, "frames so far that were lost before the gate read them", is_whole=True
        ),
    ]
    command_delay_s: Annotated[
        float,
        Signal(
            "s",
            0.0,
            1e9,
            "the longest that a frame waited which this tick took, or that an ECU in this process waited for its "
            "turn; 0: none",
        ),
    ]
    stimuli_not_made: Annotated[
        float,
        Signal(
            "",
            0.0,
            1e18,
            "what scenario, test bench or operator have asked for and this bench has not made: a program that "
            "restarts the ECU and is not at its end or has failed, bus_off on a real bus",
            is_whole=True,
        ),
    ]


ON_TIME = Bench(0.0, 0.0, 0.0, 0.0)


# Scenarios' profiles, and what a panel or a program may set: column of Surroundings.
PROFILES: dict[str, Signal] = signals_of(Surroundings)

# What a test bench's panel moves, not the ECU: the rod, and all surroundings by their names on a bus.
PANEL: dict[str, Signal] = {
    **signals_of(Rod),
    **{bus_name(name, signal): signal for name, signal in PROFILES.items()},
}
BUS_INPUTS: dict[str, Signal] = {**signals_of(Command), **PANEL}

_SENSED = signals_of(Sensed)
_TRUTH = signals_of(Truth)

TRUE_PREFIX = "true_"


def _true_name(column: str, signal: Signal) -> str:
    """What a rig calls a quantity of the truth. Always so, whether or not a sensor gives it: a sensor that is
    added takes a plain name that nobody has.
    """
    return TRUE_PREFIX + bus_name(column, signal)


_Parts = dict[str, dict[str, Signal]]  # what a table is made of: parts with their signals


def whole(parts: Mapping[str, Mapping[str, Signal]]) -> dict[str, Signal]:
    """The signals of all parts in their order. Raises ValueError where a name stands twice: one would take the
    other's meaning, and all behind it another's place.
    """
    found: dict[str, Signal] = {}
    for part in parts.values():
        for name, signal in part.items():
            if name in found:
                raise ValueError(f"{name}: two signals have this name; allowed: one")
            found[name] = signal
    return found


def _starts(name: str, parts: _Parts) -> Any:
    """Where each part begins."""
    starts, length = [], 0
    for part in parts.values():
        starts.append(length)
        length += len(part)
    return namedtuple(name, parts)(**dict(zip(parts, starts, strict=True)))


def _places(name: str, signals: dict[str, Signal]) -> Any:
    return namedtuple(name, signals)(*range(len(signals)))


# What a rig can wire to be sent.
_OUTPUTS: _Parts = {
    "sensed": {bus_name(name, signal): signal for name, signal in _SENSED.items()},
    "truth": {_true_name(name, signal): signal for name, signal in _TRUTH.items()},
    "status": signals_of(Status),
    "timing": signals_of(Timing),
    "edges": signals_of(EdgeTimes),
}
BUS_OUTPUTS: dict[str, Signal] = whole(_OUTPUTS)


def renamed_output(name: str) -> str:
    """The name of an output that was called `name`, a quantity of the truth that no sensor gives; "": none was."""
    is_old = name not in BUS_OUTPUTS and TRUE_PREFIX + name in BUS_OUTPUTS
    return TRUE_PREFIX + name if is_old else ""


INPUT_COUNT = len(BUS_INPUTS)
OUTPUT_COUNT = len(BUS_OUTPUTS)

# Where each stands, for compiled code: `values[IN.left_duty]`; of outputs also where each row begins.
IN: Any = _places("InputPlaces", BUS_INPUTS)
IN_SURROUNDINGS = Surroundings(
    **{name: getattr(IN, bus_name(name, signal)) for name, signal in PROFILES.items()}
)
OUT: Any = _places("OutputPlaces", BUS_OUTPUTS)
OUT_ROWS: Any = _starts("OutputRows", _OUTPUTS)

# Columns of recordings and of `simulate`.
SENSED_PREFIX = "sensed_"
_RECORDED: _Parts = {
    "truth": _TRUTH,
    "sensed": {SENSED_PREFIX + name: signal for name, signal in _SENSED.items()},
    "bench": signals_of(Bench),
}
COLUMNS: dict[str, Signal] = whole(_RECORDED)
COLUMN_ROWS: Any = _starts("ColumnRows", _RECORDED)
ROW_WIDTH = len(COLUMNS)
COLUMN_PLACE: dict[str, int] = {name: place for place, name in enumerate(COLUMNS)}

# Of what a rig can wire the column that it is in recordings; of loop and edges there is none.
OUTPUT_COLUMNS: dict[str, str] = {
    **{bus_name(name, signal): SENSED_PREFIX + name for name, signal in _SENSED.items()},
    **{_true_name(name, signal): name for name, signal in _TRUTH.items()},
}


# What `simulate`, measured files and identification may be given.
INPUT_SIGNALS: dict[str, Signal] = {
    **signals_of(Drives),
    **PROFILES,
    "latch_released": LATCH_RELEASED,
    "latch_cinched": LATCH_CINCHED,
}
# What says nothing new beside the inputs that a file of `simulate` was made from, and holds from its row on, where
# a recording's led to it; and what only a bench has.
_LEFT_OUT = {*INPUT_SIGNALS, *Bench._fields} - {"left_voltage_v", "right_voltage_v"}


def columns_of(drives: int, offline: bool = False) -> list[str]:
    """The columns of a recording, or of `simulate`, that a gate with so many drives has."""
    return [
        name
        for name in COLUMNS
        if (drives == 2 or not name.removeprefix(SENSED_PREFIX).startswith("right_"))
        and not (offline and name in _LEFT_OUT)
    ]
