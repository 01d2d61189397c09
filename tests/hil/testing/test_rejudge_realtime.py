"""Judging real-time recordings: rows of ticks caught up, timestamps of a wall clock."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hil_support import shipped_rig

import liftgate_hil as lh
from liftgate_hil.codec.frames import LOGGED, no_logged
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.drive.result import silence_of, tolerance_of
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.open import open_writer
from liftgate_hil.formats.writer import truncated_to_us
from liftgate_hil.isolate.recorders import write_block
from liftgate_hil.judging.expected import expected_of
from liftgate_hil.judging.judge import Judge
from liftgate_hil.judging.verdict import Verdict
from liftgate_hil.signals import COLUMN_PLACE, ROW_WIDTH, columns_of

FORMATS = [
    ["run.csv", "run.log"],
    ["run.parquet", "run.log"],
    ["run.csv", "run.blf"],
    ["run.parquet", "run.asc"],
    ["run.csv", "run.trc"],
    ["run.mf4"],
    ["run.mcap"],
    ["run.mf4", "run.log"],
]
FILES = sorted({name for each in FORMATS for name in each})
EPOCH_NS = 1_764_000_000_123_456_789  # no whole microsecond

SCENARIO = """
duration = 0.6
timing_tolerance_s = 0.002
[[expect]]
name = "counts"
eventually = "Gate.Angle > 59.9 and pinch_force_n > 70"
after = "Gate.Angle > 55"
[[expect]]
name = "follows"
always = "Gate.Angle - gate_angle_deg < 59"
within_s = 0.2
[[expect]]
name = "soft"
always = "pinch_force_n < 90"
after = 0.1
within_s = 0.08
[[expect]]
name = "softer"
always = "pinch_force_n < 60"
after = 0.1
within_s = 0.08
[[expect]]
name = "late"
always = "pinch_force_n < 90"
after = 0.25
within_s = 0.1
[[expect]]
name = "dropped"
never = "pinch_force_n > 90"
after = 0.45
within_s = 0.1
"""
# What the bus said in each of these ticks, to which frames came to the nanosecond.
SCENARIO += "".join(
    f'[[expect]]\nname = "{tick}"\nalways = "Gate.Angle > -1"\nafter = {1e-3 * tick}\nwithin_s = 0\n'
    for tick in range(20, 290, 10)
)


def late_run(seed: int) -> tuple[Any, Any]:
    """Rows and frames of a slightly late bench as the real-time loop passes them on, received frames after those
    sent meanwhile.
    """
    draw = np.random.default_rng(seed)
    rows = np.zeros((601, ROW_WIDTH))
    rows[:, COLUMN_PLACE["time_s"]] = np.arange(1, 602) * 1e-3
    rows[:, COLUMN_PLACE["pinch_force_n"]] = draw.uniform(0.0, 80.0, 601)
    rows[:, COLUMN_PLACE["gate_angle_deg"]] = draw.uniform(0.0, 40.0, 601)
    rows[300:, COLUMN_PLACE["ticks_missed"]] = 3.0
    rows[500:, COLUMN_PLACE["frames_dropped"]] = 1.0
    delays = rows[:, COLUMN_PLACE["command_delay_s"]]
    delays[::10] = draw.uniform(0.0, 1e-5, 61)
    message = shipped_rig().messages["Gate"]
    frames = np.zeros(240, dtype=LOGGED)
    # Within a nanosecond of the border between two microseconds, and of a tick.
    ticks = 1_000_000 * np.repeat(np.arange(1, 61) * 10, 4)
    frames["time_ns"] = ticks + draw.choice([-1, 0, 1, 499, 500, 501, 999, 250_000, 1_400_000], 240)
    for row, angle in zip(frames, draw.integers(0, 61, 240).tolist(), strict=True):
        data = message.encode({**{each.name: 0 for each in message.signals}, "Angle": angle})
        row["identifier"], row["length"] = message.frame_id, len(data)
        row["payload"][: len(data)] = list(data)
    return rows, frames


def judged_live(path: Path, rows: Any, frames: Any) -> dict[str, Verdict]:
    """Verdicts as during the run: some rows at a time, with all frames noted by then."""
    scenario = load_scenario(path)
    expected = expected_of(scenario.expectations, {}, shipped_rig().messages, 2, str(path))
    rig = shipped_rig()
    judge = Judge(expected, 1000.0, 0.6, tolerance_of(scenario, rig), silence_of(scenario, rig))
    times = np.round(rows[:, COLUMN_PLACE["time_s"]] * 1e9)
    seen = 0
    for first in range(0, len(rows), 7):
        part = rows[first : first + 7]
        until = int(
            np.searchsorted(frames["time_ns"] // 10_000_000, times[first + len(part) - 1] // 10_000_000, "right")
        )
        until = max(until, seen)
        judge.take(part, frames[seen:until])
        seen = until
    return {each.name: each for each in judge.verdicts()}


@pytest.fixture(scope="module", params=[1, 2])
def late(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Verdict]]:
    """A folder with a late run recorded in every format, and the verdicts of the run."""
    folder = tmp_path_factory.mktemp("late")
    (folder / "s.toml").write_text(SCENARIO)
    rows, frames = late_run(request.param)
    content = Content(columns_of(2))
    recorders = [open_writer(folder / name, content) for name in FILES]
    for each in recorders:
        each.begin(truncated_to_us(EPOCH_NS))
    write_block(recorders, content, rows, frames[np.argsort(frames["time_ns"], kind="stable")])
    for each in recorders:
        each.close()
    return folder, judged_live(folder / "s.toml", rows, frames)


@pytest.mark.parametrize("files", FORMATS, ids="+".join)
def test_a_recording_of_a_late_bench_gives_the_verdicts_of_the_run(
    late: tuple[Path, dict[str, Verdict]], files: list[str]
) -> None:
    folder, live = late
    assert live["soft"].uncertainty
    assert {"pass", "fail", "inconclusive"} == {each.verdict for each in live.values()}
    assert lh.judge([folder / name for name in files], folder / "s.toml").verdicts == live


def test_frames_received_while_the_gate_was_sending_count_at_their_arrival(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(
        'duration = 0.02\n[[expect]]\nname = "x"\neventually = "Gate.Angle == 7"\nwithin_s = 0.012\n'
    )
    rows = np.zeros((20, ROW_WIDTH))
    rows[:, COLUMN_PLACE["time_s"]] = np.arange(1, 21) * 1e-3
    message = shipped_rig().messages["Gate"]
    frames = np.zeros(2, dtype=LOGGED)
    frames["time_ns"] = 12_300_000, 11_500_000  # sent for long, and what had come meanwhile
    for row, angle in zip(frames, (0, 7), strict=True):
        data = message.encode({"Angle": angle, "LatchState": 0, "TerminalVoltage": 0})
        row["identifier"], row["length"] = message.frame_id, len(data)
        row["payload"][: len(data)] = list(data)
    expected = expected_of(load_scenario(tmp_path / "s.toml").expectations, {}, shipped_rig().messages, 2, "s")
    judge = Judge(expected, 1000.0, 0.02)
    judge.take(rows[:11], no_logged())
    judge.take(rows[11:], frames)
    assert [(each.verdict, each.time_s) for each in judge.verdicts()] == [("pass", 0.012)]


REALTIME = """
duration = 0.7
initial = 40
[[request]]
time = 0.1
action = "open"
[[expect]]
name = "moves"
eventually = "gate_rate_degps > 1 and LeftDrive.MotorCurrent > 0.5"
[[expect]]
name = "commands"
always = "DriveCommand.LeftDuty <= 100 and abs(Gate.Angle - gate_angle_deg) < 0.5"
after = "Gate.Angle > 40.05"
within_s = 0.3
"""


def test_a_recording_of_a_real_time_run_gives_the_verdicts_of_the_run(tmp_path: Path) -> None:
    # However late this machine is: a recording tells that as the run did.
    (tmp_path / "s.toml").write_text(REALTIME)
    files = [tmp_path / name for name in FILES]
    live = lh.run(tmp_path / "s.toml", clock="realtime", record=files)
    assert live.verdict != "error"
    for names in FORMATS:
        again = lh.judge([tmp_path / name for name in names], tmp_path / "s.toml").verdicts
        assert again == dict(live.expectations), names
