"""Catalogue of signals: quantities of the plant, of the bus and of the loop.

A rig file maps `BUS_INPUTS` and `BUS_OUTPUTS` to signals of a database; recordings and `simulate` have `COLUMNS`;
scenarios change `PROFILES`. All of them are derived from the NamedTuples here and in `liftgate_plant.signals`: a
new sensor signal is a field of `Sensed`, and thereby a column, and an output that a rig can map.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

from liftgate_hil.errors import Entries
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
EDGE_NUMBERS = 256  # an edge's number is sent modulo this
EMULATOR_STATES = ("waiting", "running", "timeout", "stopped")

_DUTY = Signal("%", -100.0, 100.0, "PWM duty; signed where no direction is mapped")
_DIRECTION = Signal("", 0.0, 3.0, "bridge state", DIRECTIONS)
_TIME = Signal("µs", 0.0, 1e12, "")


class Command(NamedTuple):
    """Command of the ECU to the gate; NaN: not present."""

    left_duty: Annotated[float, _DUTY]
    right_duty: Annotated[float, _DUTY]
    left_direction: Annotated[float, _DIRECTION]
    right_direction: Annotated[float, _DIRECTION]
    latch_release: Annotated[float, Signal("", 0.0, 1.0, "drives the latch open", LATCH_COMMANDS)]
    latch_cinch: Annotated[
        float, Signal("", 0.0, 1.0, "drives the cinching motor of a latch with `[latch] half`", CINCH_COMMANDS)
    ]


class Rod(NamedTuple):
    """An obstacle, set by a test bench's panel, that the gate meets while it closes."""

    obstacle_angle: Annotated[
        float, Signal("deg", -10.0, 180.0, "gate angle at which the gate meets the obstacle")
    ]
    obstacle_rate: Annotated[float, Signal("N/mm", 0.0, 1e4, "spring rate of the obstacle; 0: no obstacle")]


# An obstacle as scenarios and programs describe it.
OBSTACLE: dict[str, Signal] = {
    "angle_deg": signals_of(Rod)["obstacle_angle"],
    "distance": Signal("m", 0.01, 10.0, "distance from the hinge"),
    "stiffness": Signal("N/m", 1.0, 1e7, "stiffness of its spring"),
    "damping": Signal("N s/m", 0.0, 1e6, "damping parallel to the spring"),
    "lateral": Signal("m", -5.0, 5.0, "lateral position from the gate's middle, positive to the left"),
    "gap": Signal("m", -1.0, 1.0, "further travel along the arc from that angle until the gate touches it"),
}


_NUMBER = Signal("", 0.0, EDGE_NUMBERS - 1.0, "number of Hall edges so far, modulo 256", is_whole=True)
_AGES = [
    EDGE_AGE._replace(meaning=f"time since the last Hall edge{which}; before it, since the start")
    for which in ("", " but one", " but two", " but three")
]


class EdgeTimes(NamedTuple):
    """Number and last four ages of each drive's Hall edges, for an ECU's timer; not recorded."""

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
    """Status of the emulator in each tick."""

    tick_overruns: Annotated[float, Signal("", 0.0, 1e18, "number of skipped tick periods", is_whole=True)]
    command_timeouts: Annotated[float, Signal("", 0.0, 1e18, "number of time-outs of the command", is_whole=True)]
    rejected_frames: Annotated[
        float, Signal("", 0.0, 1e18, "number of rejected frames of mapped messages", is_whole=True)
    ]
    emulator_state: Annotated[float, Signal("", 0.0, 3.0, "state of the emulator", EMULATOR_STATES)]
    pinch_force_max: Annotated[
        float, PINCH_FORCE._replace(meaning="largest pinch force since the last frame with it")
    ]


class Timing(NamedTuple):
    """Timing of the loop in each tick; NaN if the clock is not real time."""

    lateness_p50: Annotated[float, _TIME._replace(meaning="median lateness of a tick")]
    lateness_p99: Annotated[float, _TIME._replace(meaning="lateness that 99 % of the ticks do not exceed")]
    lateness_p999: Annotated[float, _TIME._replace(meaning="lateness that 99.9 % of the ticks do not exceed")]
    lateness_max: Annotated[float, _TIME._replace(meaning="largest lateness of a tick")]
    execution_p50: Annotated[float, _TIME._replace(meaning="median execution time of a tick")]
    execution_max: Annotated[float, _TIME._replace(meaning="longest execution time of a tick")]
    command_delay_p50: Annotated[float, _TIME._replace(meaning="median delay from command to feedback")]
    command_delay_max: Annotated[float, _TIME._replace(meaning="longest delay from command to feedback")]
    command_delay_force: Annotated[
        float, Signal("N", 0.0, 1e9, "pinch force that the longest delay adds on the 10 N/mm rod")
    ]


class Bench(NamedTuple):
    """Bench's part of a row: missed ticks, dropped frames, command delay, stimuli not made; see each."""

    ticks_missed: Annotated[
        float, Signal("", 0.0, 1e18, "ticks so far that the loop missed and made up for", is_whole=True)
    ]
    frames_dropped: Annotated[
        float,
        Signal(
            "",
            0.0,
            1e18,
            "frames so far that were lost before the gate read them, or too old by then",
            is_whole=True,
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

MOST_FAULTS = 51  # of a scenario that a row tells apart: a number holds one more bit exactly


class InForce(NamedTuple):
    """Column of the faults in force during each tick, as bits."""

    faults_in_force: Annotated[
        float,
        Signal(
            "",
            0.0,
            2.0 ** (MOST_FAULTS + 1),
            "faults in force, as bits: 0 is the first of the scenario, 51 any that is injected while it runs",
            is_whole=True,
        ),
    ]


# Columns of Surroundings that scenarios' profiles, a panel or a program may set.
PROFILES: dict[str, Signal] = signals_of(Surroundings)

# Inputs set by a test bench's panel, not by the ECU: the rod, and all surroundings by their names on a bus.
PANEL: dict[str, Signal] = {
    **signals_of(Rod),
    **{bus_name(name, signal): signal for name, signal in PROFILES.items()},
}
BUS_INPUTS: dict[str, Signal] = {**signals_of(Command), **PANEL}

_SENSED = signals_of(Sensed)
_TRUTH = signals_of(Truth)

TRUE_PREFIX = "true_"


def _true_name(column: str, signal: Signal) -> str:
    """Return the name of a true value (as opposed to a sensor's) in a rig.

    True values always have the prefix, even without a sensor for them, so that a sensor added later can take the
    plain name.
    """
    return TRUE_PREFIX + bus_name(column, signal)


_Parts = dict[str, dict[str, Signal]]  # the parts of a table with their signals


def whole(parts: Mapping[str, Mapping[str, Signal]]) -> dict[str, Signal]:
    """Return the signals of all parts of a table in one mapping, in order.

    Raises ValueError for a duplicate name: one signal would replace the other, and all later ones would be
    misplaced.
    """
    found: dict[str, Signal] = {}
    for part in parts.values():
        for name, signal in part.items():
            if name in found:
                raise ValueError(f"{name}: two signals have this name; allowed: one")
            found[name] = signal
    return found


def _starts(name: str, parts: _Parts) -> Any:
    """Return the index at which each part of a signal table begins, as a named tuple."""
    starts, length = [], 0
    for part in parts.values():
        starts.append(length)
        length += len(part)
    return namedtuple(name, parts)(**dict(zip(parts, starts, strict=True)))


def _places(name: str, signals: dict[str, Signal]) -> Any:
    """Return the index of each signal in a table, as a named tuple."""
    return namedtuple(name, signals)(*range(len(signals)))


# Outputs that a rig can map to sent signals.
_OUTPUTS: _Parts = {
    "sensed": {bus_name(name, signal): signal for name, signal in _SENSED.items()},
    "truth": {_true_name(name, signal): signal for name, signal in _TRUTH.items()},
    "status": signals_of(Status),
    "timing": signals_of(Timing),
    "edges": signals_of(EdgeTimes),
}
BUS_OUTPUTS: dict[str, Signal] = whole(_OUTPUTS)


def renamed_output(name: str) -> str:
    """Return the present name of an output whose name had no prefix `true_` formerly; "": it is none of these."""
    is_old = name not in BUS_OUTPUTS and TRUE_PREFIX + name in BUS_OUTPUTS
    return TRUE_PREFIX + name if is_old else ""


INPUT_COUNT = len(BUS_INPUTS)
OUTPUT_COUNT = len(BUS_OUTPUTS)

# Index of each signal, for compiled code: `values[IN.left_duty]`; of outputs also where each part begins.
IN: Any = _places("InputPlaces", BUS_INPUTS)
IN_SURROUNDINGS = Surroundings(**{name: getattr(IN, bus_name(name, signal)) for name, signal in PROFILES.items()})
OUT: Any = _places("OutputPlaces", BUS_OUTPUTS)
OUT_ROWS: Any = _starts("OutputRows", _OUTPUTS)

# Columns of recordings and of `simulate`.
SENSED_PREFIX = "sensed_"
_RECORDED: _Parts = {
    "truth": _TRUTH,
    "sensed": {SENSED_PREFIX + name: signal for name, signal in _SENSED.items()},
    "bench": signals_of(Bench),
    "faults": signals_of(InForce),
}
COLUMNS: dict[str, Signal] = whole(_RECORDED)
COLUMN_ROWS: Any = _starts("ColumnRows", _RECORDED)


class ColumnValues(Entries[float]):
    """Values of columns, by name and in their units."""

    what, none = "column", "none before the first step"


ROW_WIDTH = len(COLUMNS)
COLUMN_PLACE: dict[str, int] = {name: place for place, name in enumerate(COLUMNS)}

# Column in recordings of each output that a rig can map; outputs of loop and edges have none.
OUTPUT_COLUMNS: dict[str, str] = {
    **{bus_name(name, signal): SENSED_PREFIX + name for name, signal in _SENSED.items()},
    **{_true_name(name, signal): name for name, signal in _TRUTH.items()},
}


# Inputs of `simulate`, measured files and identification.
INPUT_SIGNALS: dict[str, Signal] = {
    **signals_of(Drives),
    **PROFILES,
    "latch_released": LATCH_RELEASED,
    "latch_cinched": LATCH_CINCHED,
}
# Columns that `simulate` leaves out: the inputs from which its file was made, which hold from their row on, while
# those of a recording led to their row; and those that only a bench has.
_LEFT_OUT = {*INPUT_SIGNALS, *Bench._fields} - {"left_voltage_v", "right_voltage_v"}

# Columns of recordings that state of each fault whether it is in force.
FAULT_PREFIX, FAULT_IN_FORCE = "fault.", Signal("", 0.0, 1.0, "1: the fault is in force", is_whole=True)


def columns_of(drives: int, offline: bool = False) -> list[str]:
    """Return the columns of a recording, or of `simulate` (`offline`), for a gate with `drives` drives.

    Those of a run's faults follow them, see `plan.fault_columns`.
    """
    return [
        name
        for name in COLUMNS
        if (drives == 2 or not name.removeprefix(SENSED_PREFIX).startswith("right_"))
        and name not in InForce._fields
        and not (offline and name in _LEFT_OUT)
    ]
