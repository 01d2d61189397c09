"""Columns of recordings for faults in force: names, windows, and readers."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.config.scenario_tables import fault_of
from liftgate_hil.config.shipped import find_config
from liftgate_hil.dashboard.recorded import RecordingSource
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.open import open_recording
from liftgate_hil.formats.ours import is_ours
from liftgate_hil.plan.fault_columns import INJECTED, fault_columns_of
from liftgate_hil.signals import COLUMN_PLACE, MOST_FAULTS, ROW_WIDTH, columns_of
from liftgate_hil.stimuli.faults import Injection, faults_of, look
from liftgate_hil.stimuli.moments import Instant, Sheet, no_moments
from liftgate_plant.constants import constants_of

pytestmark = pytest.mark.filterwarnings("ignore")  # asammdf's own

SCENARIO = """
duration = 0.6
initial = 40
[[fault]]
kind = "spring_lost"
where = "left"
start = 0.1
[[fault]]
kind = "spring_weak"
where = "both"
factor = 0.5
start = 0.05
for_s = 0.2
[[fault]]
kind = "frame_lost"
where = "right_current"
direction = "sent"
start = 0.3
end = 0.4
[[fault]]
kind = "spring_lost"
where = "left"
start = "time_s > 0.4995"
"""
COLUMNS = {
    "fault.spring_lost.left": (0.1, math.inf),
    "fault.spring_weak.both": (0.05, 0.25),
    "fault.frame_lost.right_current": (0.3, 0.4),
    "fault.spring_lost.left.2": (0.5, math.inf),
}
FILES = ("run.csv", "run.mf4", "run.mcap", "run.parquet")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("faults")
    (found / "s.toml").write_text(SCENARIO)
    lh.run(found / "s.toml", record=[found / name for name in FILES])
    return found


@pytest.mark.parametrize("name", FILES)
def test_each_fault_has_a_column_that_shows_when_it_was_in_force(folder: Path, name: str) -> None:
    recording = open_recording(folder / name)
    assert list(recording.signals) == [*columns_of(2), *COLUMNS]
    rows = np.concatenate(list(recording.rows(["time_s", *COLUMNS])))
    for place, (begin, end) in enumerate(COLUMNS.values(), 1):
        # A row is what a tick has led to, at its end.
        expected = (rows[:, 0] > begin + 1e-6) & (rows[:, 0] < end + 1e-6)
        assert rows[:, place].tolist() == expected.astype(float).tolist()
    assert is_ours(folder / name)


def test_the_provenance_describes_each_fault_column(folder: Path) -> None:
    faults = json.loads(open_recording(folder / "run.mf4").about)["faults"]
    assert list(faults) == list(COLUMNS)
    weak = faults["fault.spring_weak.both"]
    assert (weak["kind"], weak["where"], weak["factor"]) == ("spring_weak", "both", 0.5)


@pytest.mark.parametrize("clock", ["free", "realtime"])
def test_a_recording_without_faults_has_at_most_the_injected_faults_column(tmp_path: Path, clock: str) -> None:
    lh.run(find_config("scenarios", "demo"), clock=clock, duration=0.05, record=tmp_path / "run.csv")
    recording = open_recording(tmp_path / "run.csv")
    found = [name for name in recording.signals if name.startswith("fault.")]
    assert found == ([INJECTED] if clock == "realtime" else [])
    assert not np.concatenate(list(recording.rows(["time_s", *found])))[:, 1:].any()


def test_springs_are_drawn_with_the_faults_recorded(folder: Path) -> None:
    source = RecordingSource(folder / "run.mf4")

    def health(time: float) -> dict[str, Any]:
        return source.state(time)["acting"]["spring_health"]

    assert health(0.04) == {}
    assert health(0.08) == {"left": 0.5, "right": 0.5}
    assert health(0.2) == {"left": 0.0, "right": 0.5}
    assert health(0.28) == {"left": 0.0}
    # Of a table alone it is not known what its columns mean.
    assert RecordingSource(folder / "run.csv").state(0.2)["acting"]["spring_health"] == {}


def test_injected_faults_share_one_in_force_column() -> None:
    sheet, vehicle = Sheet(), lh.load_vehicle(find_config("vehicles", "suv"))
    own = [fault_of("motor_open", "left", {}), fault_of("supply_open", None, {})]
    faults = faults_of(constants_of(vehicle), [Injection((), Instant(0.0))] * 2, sheet, slots=3)
    columns = fault_columns_of(own, is_open=True)
    content = Content(columns_of(2)).with_faults(columns)

    def stated() -> list[float]:
        look(faults, no_moments(), 1.0)
        rows = np.zeros((2, ROW_WIDTH))
        rows[:, COLUMN_PLACE["faults_in_force"]] = faults.in_force[0]
        return content.whole(rows)[1, content.places[-3:]].tolist()

    assert list(columns) == ["fault.motor_open.left", "fault.supply_open", INJECTED]
    assert stated() == [1, 1, 0]
    faults.rows[3].start, faults.rows[3].rank = 0.5, 1
    faults.rows[1].start = 2.0
    assert stated() == [1, 0, 1]


def test_faults_beyond_the_maximum_number_have_no_columns() -> None:
    many = [fault_of("supply_open", None, {})] * (MOST_FAULTS + 3)
    columns = fault_columns_of(many, is_open=True)
    assert list(columns)[-2:] == [f"fault.supply_open.{MOST_FAULTS}", INJECTED]
    assert columns[INJECTED] == 2**MOST_FAULTS
    faults = faults_of(
        constants_of(lh.load_vehicle(find_config("vehicles", "suv"))), [Injection(())] * len(many), Sheet()
    )
    look(faults, no_moments(), 1.0)
    assert faults.in_force[0] == 2**MOST_FAULTS - 1


def test_a_table_of_simulate_has_fault_columns_too(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = folder / "offline.toml"
    scenario.write_text('duration = 0.1\n[[fault]]\nkind = "spring_lost"\nwhere = "left"\nstart = 0.05\n')
    output = folder / "offline.csv"
    assert main(["simulate", "--scenario", str(scenario), "--voltage", "0", "--output", str(output)]) == 0
    with output.open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["fault.spring_lost.left"] for row in rows] == ["0"] * 50 + ["1"] * (len(rows) - 50)
    assert is_ours(output)
