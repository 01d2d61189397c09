"""Recordings of the emulator and tables of `simulate` are read as measurements without a map."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hil_support import CLOSE, COAST, OPEN, both, command_frame, frames_of, loop_config, outside, start_of
from measurement_files import read

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.codec.frames import empty_frames, logged
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.open import open_writer
from liftgate_hil.formats.recording import AS_IT_IS
from liftgate_hil.measurement.table import read_measurement
from liftgate_hil.plan.setup import rig_from
from liftgate_hil.signals import ON_TIME, columns_of


def run(rig: Rig, fast_tick: Callable[..., Any], folder: Path) -> tuple[Path, Path]:
    """A run of 0.6 s: released and opening, closing, coasting; recorded as a table and as a bus log."""
    config = loop_config(rig=rig)
    state = start_of(config)
    table, log = (open_writer(folder / name, Content(columns_of(2))) for name in ("run.csv", "bus.log"))
    log.begin(10**18)
    orders = [both(60, OPEN, 1), both(30, CLOSE), both(0, COAST)]
    for k in range(600):
        frames = empty_frames(0)
        if k % 10 == 0:
            frames = frames_of([command_frame(rig, k // 10, **orders[k // 200])])
            log.write_frames(logged(frames, k * 10**6, is_sent=False))
        state, replies, truth, sensed = fast_tick(config, state, frames, outside())
        table.write_rows(np.array([[*truth, *sensed, *ON_TIME]]))
        log.write_frames(logged(replies, (k + 1) * 10**6, is_sent=True))
    table.close()
    log.close()
    return folder / "run.csv", folder / "bus.log"


def test_the_inputs_of_a_recording_hold_from_their_row_on(
    tmp_path: Path, rig: Rig, fast_tick: Callable[..., Any]
) -> None:
    table, _ = run(rig, fast_tick, tmp_path)
    raw = np.genfromtxt(table, delimiter=",", names=True)
    m = read(table)
    assert not m.through_sensors
    assert np.array_equal(m.times, raw["time_s"])
    assert not {"left_voltage_v", "right_voltage_v"} & set(m.columns)
    # The row at 0.2 s is the state when the gate is told to close.
    for name in ("left_duty", "right_duty"):
        assert np.array_equal(
            np.round(m.columns[name], 9), np.select([m.times < 0.2 - 1e-9, m.times < 0.4 - 1e-9], [0.6, -0.3], 0.0)
        )
    assert np.array_equal(m.columns["left_coast"] == 1.0, m.times >= 0.4 - 1e-9)
    # Duty times supply over a step is the voltage in the row that it leads to.
    driven = m.columns["left_coast"][:-1] == 0.0
    voltage = (m.columns["left_duty"] * m.columns["supply_voltage_v"])[:-1]
    assert np.allclose(voltage[driven], raw["left_voltage_v"][1:][driven], atol=1e-9)
    assert np.array_equal(m.columns["latch_released"][:-1], 1.0 - raw["latched"][1:])
    assert np.array_equal(m.columns["left_current_a"], raw["left_current_a"])


def test_table_and_bus_log_of_a_run_agree(tmp_path: Path, rig: Rig, fast_tick: Callable[..., Any]) -> None:
    table, log = run(rig, fast_tick, tmp_path)
    true, seen = read(table), read_measurement(log, {}, rig)
    assert seen.through_sensors
    assert not any("refused" in note or "missing" in note for note in seen.notes), seen.notes
    for name, quantum in (("left_current_a", 0.5), ("left_hall_count", 1.0)):
        there = np.isfinite(seen.columns[name])
        assert np.sum(there) >= 119
        at = np.interp(seen.times[there], true.times, true.columns[name])
        # The current passes the sensor's filter first; here it is only told from a mix-up of columns.
        assert np.median(np.abs(seen.columns[name][there] - at)) < quantum
    rows = np.searchsorted(true.times, seen.times + 1e-9) - 1
    same = rows >= 0
    for name in ("left_duty", "right_duty", "left_coast", "right_coast"):
        assert np.allclose(seen.columns[name][same], true.columns[name][rows[same]], atol=1e-9)


def test_the_output_of_simulate_is_a_measurement_without_a_map(tmp_path: Path) -> None:
    columns = {}
    for suffix in ("csv", "mf4", "mcap"):
        target = tmp_path / f"out.{suffix}"
        source = tmp_path / "in.csv"
        source.write_text("time_s,voltage_v\n0,0\n0.01,6\n0.05,-3\n")
        assert main(["simulate", "--input", str(source), "--duration", "0.1", "--output", str(target)]) == 0
        m = read(target)
        assert np.allclose(m.times, np.arange(101) * 0.001, rtol=0, atol=1e-12)
        held = np.select([m.times < 0.01 - 1e-9, m.times < 0.05 - 1e-9], [0.0, 6.0], -3.0)
        assert np.array_equal(m.columns["left_voltage_v"], held)
        assert m.notes == ()
        columns[suffix] = m.columns
    assert "left_position_rev" in columns["csv"]
    for suffix in ("mf4", "mcap"):
        assert list(columns["csv"]) == list(columns[suffix])
        for name, values in columns["csv"].items():
            assert np.array_equal(values, columns[suffix][name])


def test_an_mf4_table_without_the_given_recording_channel_is_refused(tmp_path: Path) -> None:
    """The options for reading recordings also apply to tables that are read as measurements."""
    path, rig = tmp_path / "run.mf4", rig_from("liftgate")
    lh.run("demo", duration=0.1, record=path)
    assert read_measurement(path, {}, rig, how=dataclasses.replace(AS_IT_IS, channel="can0"))
    with pytest.raises(ConfigError, match=r"`recording_channel` can7: not in .*; allowed: can0"):
        read_measurement(path, {}, rig, how=dataclasses.replace(AS_IT_IS, channel="can7"))
