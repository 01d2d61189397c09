"""The catalogue of quantities: each once, with one name whose suffix is its unit."""

from __future__ import annotations

from collections import Counter

import pytest

from liftgate_hil import signals
from liftgate_hil.signals import (
    BUS_INPUTS,
    BUS_OUTPUTS,
    COLUMN_PLACE,
    COLUMN_ROWS,
    COLUMNS,
    IN,
    INPUT_SIGNALS,
    OUT,
    OUT_ROWS,
    OUTPUT_COUNT,
    PANEL,
    PROFILES,
    ROW_WIDTH,
    SENSED_PREFIX,
    Bench,
    Command,
    EdgeTimes,
    InForce,
    Rod,
    Status,
    Timing,
    columns_of,
)
from liftgate_hil.stimuli.command_queue import HELD
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.rows import AT, INPUT_COLUMNS
from liftgate_plant.signals import SUFFIXES, Drives, Sensed, Surroundings, Truth, bus_name, signals_of

ROWS = (Drives, Surroundings, Truth, Sensed)


def test_each_signal_name_is_unique_in_every_table() -> None:
    """A dict made of several tables would hide a repetition."""
    panel = [bus_name(name, signal) for name, signal in signals_of(Surroundings).items()]
    inputs = [*Command._fields, *Rod._fields, *panel]
    assert list(BUS_INPUTS) == inputs
    assert list(PANEL) == [*Rod._fields, *panel]
    assert len(set(inputs)) == len(inputs)
    outputs = sum(len(row._fields) for row in (Sensed, Truth, Status, Timing, EdgeTimes))
    assert len(BUS_OUTPUTS) == outputs == OUTPUT_COUNT
    sensed = [f"{SENSED_PREFIX}{name}" for name in Sensed._fields]
    assert list(COLUMNS) == [*Truth._fields, *sensed, *Bench._fields, *InForce._fields]
    assert ROW_WIDTH == len(COLUMNS) == sum(map(len, (Truth._fields, sensed, Bench._fields, InForce._fields)))
    assert list(PROFILES) == list(Surroundings._fields)
    offline = [*Drives._fields, *Surroundings._fields, "latch_released", "latch_cinched"]
    assert list(INPUT_SIGNALS) == list(INPUT_COLUMNS) == offline
    assert len(set(offline)) == len(offline)
    held = [*Surroundings._fields, *(f"obstacle_{name}" for name in Obstacle._fields), *Timing._fields]
    assert list(HELD._fields) == held
    for row in (*ROWS, Command, Rod, Status, Timing, EdgeTimes):
        assert max(Counter(row._fields).values()) == 1


def test_the_offset_of_each_row_is_that_of_its_first_column() -> None:
    starts = {
        "sensed": Sensed, "truth": Truth, "status": Status, "timing": Timing, "edges": EdgeTimes,
    }  # fmt: skip
    assert OUT_ROWS._fields == tuple(starts)
    first = {name: row._fields[0] for name, row in starts.items()}
    assert (first["sensed"], first["truth"]) == ("left_current_a", "time_s")
    first |= {"sensed": "left_current", "truth": "true_time"}  # what a rig calls them
    for name in starts:
        assert getattr(OUT_ROWS, name) == getattr(OUT, first[name])
    assert COLUMN_ROWS.truth == COLUMN_PLACE[Truth._fields[0]]
    assert COLUMN_ROWS.sensed == COLUMN_PLACE[SENSED_PREFIX + Sensed._fields[0]]


@pytest.mark.parametrize(
    ("places", "names"),
    [(IN, BUS_INPUTS), (OUT, BUS_OUTPUTS), (AT, INPUT_COLUMNS), (HELD, HELD._fields)],
    ids=["inputs", "outputs", "offline", "held"],
)
def test_each_index_constant_is_the_position_of_its_name(places: object, names: list[str]) -> None:
    for place, name in enumerate(names):
        assert getattr(places, name) == place
    assert [COLUMN_PLACE[name] for name in COLUMNS] == list(range(ROW_WIDTH))


# Ends in what an ampere's column ends in, and is the level of a Hall sensor.
_NO_UNITS = {f"{prefix}{side}_hall_a" for prefix in ("", SENSED_PREFIX) for side in ("left", "right")}


@pytest.mark.parametrize("row", ROWS)
def test_the_suffix_of_a_column_is_the_unit_of_its_signal(row: type) -> None:
    check_ends(signals_of(row))


@pytest.mark.parametrize("table", ["COLUMNS", "PROFILES", "INPUT_SIGNALS"])
def test_the_suffix_of_a_file_column_is_its_unit(table: str) -> None:
    check_ends(getattr(signals, table))


def check_ends(table: dict) -> None:
    """Check that the suffix of each name is the unit of its signal."""
    units = {suffix: unit for unit, suffix in SUFFIXES.items() if suffix}
    for name, signal in table.items():
        told = units.get("_" + name.rpartition("_")[2], "")
        assert told == ("A" if name in _NO_UNITS else signal.unit), name


def test_no_two_units_have_the_same_suffix() -> None:
    assert len(set(SUFFIXES.values())) == len(SUFFIXES)


def test_quantities_of_left_and_right_drive_correspond() -> None:
    for table in (*map(signals_of, ROWS), BUS_INPUTS, BUS_OUTPUTS, COLUMNS, INPUT_SIGNALS):
        for name, signal in table.items():
            if "left_" in name:
                other = table[name.replace("left_", "right_")]
                assert other == signal._replace(bus_name=signal.bus_name.replace("left_", "right_"))
        assert sum("left_" in name for name in table) == sum("right_" in name for name in table)


def test_a_sensed_and_a_true_quantity_of_the_same_name_have_one_unit_and_range() -> None:
    sensed, truth = signals_of(Sensed), signals_of(Truth)
    both = sensed.keys() & truth.keys()
    assert {"left_current_a", "gate_angle_deg", "latched", "terminal_voltage_v"} <= both
    for name in both:
        assert sensed[name]._replace(bus_name="") == truth[name]._replace(bus_name=""), name


def test_ranges_are_not_empty_and_enumerations_name_all_values() -> None:
    for table in (*map(signals_of, ROWS), BUS_INPUTS, BUS_OUTPUTS):
        for name, signal in table.items():
            assert signal.low < signal.high, name
            assert signal.meaning, name
            if signal.values:
                assert (signal.low, signal.high) == (0.0, len(signal.values) - 1.0), name


def test_bus_quantities_keep_the_names_used_in_rig_files() -> None:
    """Users' rig files contain these names."""
    assert BUS_OUTPUTS.keys() >= {
        "left_current", "left_hall_count", "left_hall_speed", "left_hall_a", "left_hall_b",
        "gate_angle", "latch_state", "terminal_voltage", "ambient_temperature",
        "left_motor_temperature", "road_slope", "gate_acceleration", "pinch_force_max", "true_pinch_force",
        "tick_overruns", "command_timeouts", "rejected_frames", "emulator_state",
        "lateness_p50", "lateness_p99", "lateness_p999", "lateness_max", "execution_p50",
        "execution_max", "command_delay_p50", "command_delay_max", "command_delay_force",
        "true_left_current", "true_gate_angle", "true_latch_state", "true_left_speed",
    }  # fmt: skip
    assert BUS_INPUTS.keys() >= {
        "left_duty", "left_direction", "latch_release", "obstacle_angle", "obstacle_rate",
        "road_slope", "supply_voltage", "hand_force",
    }  # fmt: skip


def test_true_quantities_have_the_prefix_true_on_the_bus() -> None:
    for column, signal in signals_of(Truth).items():
        assert BUS_OUTPUTS[f"true_{bus_name(column, signal)}"] is signal
    true = {name for name in BUS_OUTPUTS if name.startswith("true_")}
    assert len(true) == len(Truth._fields)


def test_adding_a_sensor_does_not_change_the_meaning_of_an_existing_name() -> None:
    """A true quantity never has the plain name, which is reserved for a sensor."""
    sensed = {bus_name(name, signal): signal for name, signal in signals_of(Sensed).items()}
    for column, signal in signals_of(Truth).items():
        name = bus_name(column, signal)
        assert (name in BUS_OUTPUTS) == (name in sensed)
        assert signals.renamed_output(name) == ("" if name in sensed else f"true_{name}")
    assert signals.renamed_output("left_currant") == ""
    assert signals.renamed_output("true_left_speed") == ""


def test_a_duplicate_signal_name_is_refused() -> None:
    one = signals_of(Status)
    with pytest.raises(ValueError, match="pinch_force_max: two signals have this name"):
        signals.whole({"sensed": {"pinch_force_max": one["pinch_force_max"]}, "status": one})


@pytest.mark.parametrize("offline", [False, True])
def test_a_gate_with_one_drive_has_only_the_left_columns(offline: bool) -> None:
    both, one = columns_of(2, offline), columns_of(1, offline)
    assert one == [name for name in both if "right" not in name]
    assert set(both) <= set(COLUMNS)
    assert sum("left" in name for name in both) == len(both) - len(one)
