"""Every quantity keeps its name: from the bus into the plant, from the plant's rows onto the bus and into
recordings. Every value is distinct, and names are compared, never indices.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import loop_fakes
import numpy as np
import pytest
from catalogue_bus import catalogue_rig, input_frames, outputs_in
from hil_support import frames_of, loop_config, outside, start_of, stimuli_alone, stimulus_plan, transmitted

from liftgate_compiler import compiled
from liftgate_hil.codec.frames import Frames, empty_frames
from liftgate_hil.codec.receive import NO_COUNTS
from liftgate_hil.codec.transmit import transmit
from liftgate_hil.config.rig import Rig
from liftgate_hil.loop import advance
from liftgate_hil.loop import tick as tick_module
from liftgate_hil.loop.advance import write_row
from liftgate_hil.loop.observers import Trace
from liftgate_hil.loop.python_loop import Loop, scheduled_tick
from liftgate_hil.loop.rings import Memory, RingReader, next_row
from liftgate_hil.loop.tick import STOPPED, edge_times, line_up, tick
from liftgate_hil.signals import (
    BUS_INPUTS,
    BUS_OUTPUTS,
    COLUMN_PLACE,
    ON_TIME,
    OUTPUT_COUNT,
    ROW_WIDTH,
    Bench,
    EdgeTimes,
    Status,
    Timing,
)
from liftgate_hil.stimuli.command_queue import HELD
from liftgate_hil.stimuli.stimulus_plan import NO_STIMULI, StimulusPlan, TimedStimuli, outside_at
from liftgate_hil.stimuli.timeline import Profile
from liftgate_plant import integrate, sensors
from liftgate_plant.bridge import CLOSE, OPEN, drive_input
from liftgate_plant.dynamics import Inputs
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.signals import Sensed, Surroundings, Truth, bus_name, signals_of
from tests.plant.distinct import distinct

Tick = Callable[..., Any]


class Rows(NamedTuple):
    """All values that the loop puts out."""

    sensed: Sensed
    truth: Truth
    status: Status
    timing: Timing
    edges: EdgeTimes

    def by_name(self) -> dict[str, float]:
        """Values by the names that a rig uses."""
        values = {
            bus_name(name, signal): getattr(self.sensed, name) for name, signal in signals_of(Sensed).items()
        }
        values |= self.status._asdict() | self.timing._asdict() | self.edges._asdict()
        for name, signal in signals_of(Truth).items():
            values[f"true_{bus_name(name, signal)}"] = getattr(self.truth, name)
        return values


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """A rig with a signal for every quantity."""
    return catalogue_rig(tmp_path_factory.mktemp("rig"))


# From the rows onto the bus.


@pytest.mark.parametrize("which", ["plain", "compiled"])
def test_every_output_signal_carries_the_value_of_its_name(whole: Rig, which: str) -> None:
    rows = distinct(Rows)
    fill, send = line_up, transmit
    if which == "compiled":
        fill, send = compiled(line_up), compiled(transmit)
    around = outside()._replace(timing=rows.timing)
    values = np.full(OUTPUT_COUNT, np.nan)
    fill(values, rows.sensed, rows.truth, rows.status, around, rows.edges)
    bus = whole.output_config()
    _, frames = transmitted(bus, values, call=send)
    found = outputs_in(whole, frames)
    assert found == rows.by_name()
    assert len(set(found.values())) == len(BUS_OUTPUTS)


def test_a_tick_returns_its_rows_and_sends_every_output_value(whole: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = distinct(Rows)
    status = Status(
        tick_overruns=107.0,
        command_timeouts=111.0,
        rejected_frames=113.0,
        emulator_state=float(STOPPED),
        pinch_force_max=113.5,
    )
    monkeypatch.setattr(sensors, "sense", lambda *given: (given[4], rows.sensed))
    monkeypatch.setattr(tick_module, "truth_of", lambda *given: rows.truth)
    monkeypatch.setattr(tick_module, "edge_times", lambda *given: rows.edges)
    config = loop_config(rig=whole)
    state = start_of(config)._replace(timeouts=111, counts=NO_COUNTS._replace(wrong_length=113), pinch_hold=113.5)
    around = outside(missed=107, stop=True)._replace(timing=rows.timing)
    _, replies, truth, sensed = tick(config, state, empty_frames(0), around)
    assert (truth, sensed) == (rows.truth, rows.sensed)
    assert outputs_in(whole, replies) == rows._replace(status=status).by_name()


def test_unknown_timing_figures_are_not_sent(whole: Rig, fast_tick: Tick) -> None:
    config = loop_config(rig=whole)
    _, replies, truth, sensed = fast_tick(config, start_of(config), empty_frames(0), outside(stop=True))
    found = outputs_in(whole, replies)
    assert found.keys() == BUS_OUTPUTS.keys() - {*Timing._fields}
    status = Status(0.0, 0.0, 0.0, float(STOPPED), 0.0)
    edges = edge_times(start_of(config).sensors.halls, 0.001)
    told = Rows(sensed, truth, status, Timing(*(0.0 for _ in Timing._fields)), edges).by_name()
    assert found == {name: told[name] for name in found}


# From the bus into the plant. Duties in %, angles in degrees, the rod's rate in N/mm.
SAID = {
    "left_duty": 30.0,
    "right_duty": 55.0,
    "left_direction": float(OPEN),
    "right_direction": float(CLOSE),
    "latch_release": 1.0,
    "latch_cinch": 1.0,
    "obstacle_angle": 20.0,
    "obstacle_rate": 7.0,
    "supply_voltage": 11.0,
    "road_slope": 3.0,
    "ambient_temperature": -8.0,
    "wind_pressure": 17.0,
    "snow_mass": 5.0,
    "hand_force": -40.0,
    "external_torque": 13.0,
    "handle_pulled": 1.0,
    "button_pressed": 1.0,
}


def test_every_input_signal_reaches_the_quantity_of_its_name(whole: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    assert SAID.keys() == BUS_INPUTS.keys()
    given: list[Inputs] = []

    def advance(plant: Any, state: Any, inputs: Inputs, seconds: float) -> Any:
        given.append(inputs)
        return state, integrate.resting(state)

    monkeypatch.setattr(integrate, "advance", advance)
    config = loop_config(rig=whole)
    start = start_of(config, math.radians(60.0), latched=False)
    state, _, _, _ = tick(config, start, frames_of(input_frames(SAID)), outside())
    assert state.counts == NO_COUNTS._replace(accepted=len(BUS_INPUTS))
    (inputs,) = given
    assert inputs.left == drive_input(OPEN, 0.30)
    assert inputs.right == drive_input(CLOSE, 0.55)
    assert inputs.load._asdict() == {
        "supply_voltage": 11.0,
        "supply_rise": 0.0,
        "road_slope": pytest.approx(math.radians(3.0)),
        "ambient_temperature": -8.0,
        "wind_pressure": 17.0,
        "snow_mass": 5.0,
        "hand_force": -40.0,
        "external_torque": 13.0,
        "latch_released": 1.0,
        "latch_cinched": 1.0,
        "handle_pulled": 1.0,
        "button_pressed": 1.0,
        "obstacle": Obstacle(
            angle=pytest.approx(math.radians(20.0)),
            distance=config.obstacle_distance,
            stiffness=7000.0,
            damping=0.0,
            gap=0.0,
            direction=1.0,
            lateral=0.0,
        ),
    }


DRIVEN = {"left_duty": 0.30, "right_duty": -0.55, "left_coast": 0.0, "right_coast": 0.0}
COASTING = {"left_duty": 0.0, "right_duty": 0.0, "left_coast": 1.0, "right_coast": 1.0}
SURROUNDINGS = {column: SAID[bus_name(column, signal)] for column, signal in signals_of(Surroundings).items()}


def shown(call: Tick, config: Any, said: dict[str, float], around: Any) -> dict[str, float]:
    """The input values that the truth of one tick shows."""
    frames = frames_of(input_frames(said)) if said else empty_frames(0)
    truth = call(config, start_of(config), frames, around)[2]
    return {name: getattr(truth, name) for name in (*DRIVEN, *Surroundings._fields)}


def test_the_truth_contains_every_input(whole: Rig, fast_tick: Tick) -> None:
    found = shown(fast_tick, loop_config(rig=whole), SAID, outside())
    assert found == pytest.approx({**DRIVEN, **SURROUNDINGS})


@pytest.mark.parametrize("way", ["profile", "panel", "commanded"])
@pytest.mark.parametrize("column", Surroundings._fields)
def test_a_stimulus_for_one_quantity_changes_no_other(whole: Rig, fast_tick: Tick, column: str, way: str) -> None:
    config = loop_config(rig=whole)
    before = shown(fast_tick, config, {}, outside())
    assert before.items() >= COASTING.items()
    value, said, stimuli = SURROUNDINGS[column], {}, NO_STIMULI
    if way == "profile":
        stimuli = TimedStimuli({column: Profile([(0.0, value)])})
    stimuli = stimuli_alone(stimuli)
    if way == "panel":
        name = bus_name(column, signals_of(Surroundings)[column])
        said = {name: value}
    elif way == "commanded":
        stimuli.held[getattr(HELD, column)] = value
    around = outside_at(stimuli, 0.0, 0.001, 0, False, False)
    assert before[column] != value
    assert shown(fast_tick, config, said, around) == pytest.approx({**before, column: value})


def test_operator_overrides_benchcontrol_and_benchcontrol_the_profile(whole: Rig, fast_tick: Tick) -> None:
    config = loop_config(rig=whole)
    ranges = signals_of(Surroundings)
    levels = {
        way: {
            name: k % 2 if signal.values else 0.25 * k + 0.5 * SURROUNDINGS[name]
            for name, signal in ranges.items()
        }
        for k, way in enumerate(("profile", "panel", "commanded"))
    }
    stimuli = TimedStimuli({name: Profile([(0.0, value)]) for name, value in levels["profile"].items()})
    scheduled, commanded = stimuli_alone(stimuli), stimuli_alone(stimuli)
    panel = {bus_name(name, ranges[name]): value for name, value in levels["panel"].items()}
    for name, value in levels["commanded"].items():
        commanded.held[getattr(HELD, name)] = value

    def found(said: dict[str, float], stimuli: StimulusPlan) -> dict[str, float]:
        around = outside_at(stimuli, 0.0, 0.001, 0, False, False)
        return shown(fast_tick, config, said, around)

    assert found({}, scheduled) == pytest.approx({**COASTING, **levels["profile"]})
    assert found(panel, scheduled) == pytest.approx({**COASTING, **levels["panel"]})
    assert found(panel, commanded) == pytest.approx({**COASTING, **levels["commanded"]})


# From the rows into rings and recordings.


def check_row(row: Any, truth: Truth, sensed: Sensed, bench: Bench = ON_TIME, in_force: float = 0.0) -> None:
    """Check that each column of a row has the value of its name."""
    assert row.shape == (ROW_WIDTH,)
    assert row[COLUMN_PLACE["faults_in_force"]] == in_force
    for name, value in bench._asdict().items():
        assert row[COLUMN_PLACE[name]] == value, name
    for name, value in truth._asdict().items():
        assert row[COLUMN_PLACE[name]] == value, name
    for name, value in sensed._asdict().items():
        assert row[COLUMN_PLACE[f"sensed_{name}"]] == value, name


@pytest.mark.parametrize("which", ["plain", "compiled"])
def test_every_column_of_the_rings_rows_has_the_value_of_its_name(which: str) -> None:
    rows, bench = distinct(Rows), Bench(1.5, 2.5, 3.5, 4.5)
    memory = Memory(4, 4)
    write = write_row if which == "plain" else compiled(write_row)

    def put(bench: Bench) -> None:
        write(memory.shared.rows[next_row(memory.shared)], rows.truth, rows.sensed, bench, 5.0)
        memory.shared.control[0].rows += 1

    for _ in range(3):
        put(bench)
    reader = RingReader(memory.shared.rows, memory.shared.control, "rows")
    taken = reader.take()
    assert len(taken) == 3
    for row in taken:
        check_row(row, rows.truth, rows.sensed, bench, 5.0)
    for _ in range(2):  # once around
        put(ON_TIME)
    assert len(reader.take()) == 2
    memory.close()


class Notes:
    """Recorder that keeps rows."""

    def __init__(self) -> None:
        self.rows: list[Any] = []

    def take(self, rows: Any, frames: Any) -> None:
        self.rows += list(rows)


def test_every_column_of_the_python_loops_rows_has_the_value_of_its_name(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, watched, notes = distinct(Rows), Trace(), Notes()
    config = loop_config(rig=rig)
    loop = Loop(config, start_of(config), stimulus_plan(config), loop_fakes.Memory(), sinks=[notes, watched])

    def tick(config: Any, state: Any, frames: Frames, given: Any) -> Any:
        return state, frames, rows.truth, rows.sensed

    monkeypatch.setattr(advance, "tick", tick)
    loop._tick = scheduled_tick
    loop.advance(empty_frames(0))
    assert len(watched.rows()) == len(notes.rows) == 1
    for row in (*watched.rows(), *notes.rows):
        check_row(row, rows.truth, rows.sensed)


# The Hall sensors' levels.

CODES = {(0, 0): 0, (1, 0): 1, (1, 1): 2, (0, 1): 3}


@pytest.mark.parametrize("rate", [200.0, 1000.0])
def test_hall_a_and_b_agree_with_the_count_in_both_directions(whole: Rig, fast_tick: Tick, rate: float) -> None:
    """At 200 Hz several edges come per tick: the levels still agree with the count. At 1 kHz an ECU that samples A
    and B once per tick counts what the decoder counts.
    """
    config = loop_config(rate, whole)
    state = start_of(config, math.radians(30.0), latched=False)
    counts: dict[str, list[float]] = {"left": [], "right": []}
    codes: dict[str, list[int]] = {"left": [], "right": []}
    for number in range(round(2.0 * rate)):
        direction = OPEN if number < rate else CLOSE
        said = {
            "left_duty": 90.0, "left_direction": direction,
            "right_duty": 60.0, "right_direction": direction,
        }  # fmt: skip
        frames = frames_of(input_frames(said)) if number % 2 == 0 else empty_frames(0)
        state, _, truth, sensed = fast_tick(config, state, frames, outside())
        for side in ("left", "right"):
            count = getattr(sensed, f"{side}_hall_count")
            assert count == getattr(truth, f"{side}_hall_count")
            a, b = (int(getattr(sensed, f"{side}_hall_{which}")) for which in "ab")
            codes[side].append(CODES[a, b])
            counts[side].append(count)
            assert CODES[a, b] == count % 4, (side, number)
    for side in ("left", "right"):
        steps = np.diff(counts[side])
        assert steps.max() > 0 > steps.min()
        assert bool(np.abs(steps).max() > 1) is (rate == 200.0)
        if rate == 1000.0:
            ways = (np.diff(codes[side]) + 1) % 4 - 1
            assert np.array_equal(ways, steps)


def test_the_rig_generated_from_the_catalogue_maps_every_quantity(tmp_path: Path) -> None:
    rig = catalogue_rig(tmp_path)
    assert {wire.quantity for wire in rig.inputs} == BUS_INPUTS.keys()
    assert {wire.quantity for wire in rig.outputs} == BUS_OUTPUTS.keys()
