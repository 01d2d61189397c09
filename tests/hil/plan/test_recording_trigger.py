"""Triggered recording: exactly the rows and frames near a tick in which a condition is true."""

from __future__ import annotations

import itertools
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hil_support import CALM, frames_of, shipped_rig
from hypothesis import given
from hypothesis import strategies as st
from recording_support import rows_from

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.codec.frames import logged, no_logged
from liftgate_hil.conversion.compare import compare_tables
from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.open import open_recording
from liftgate_hil.formats.suffixes import RECORDED, TABLES, WITH_FRAMES
from liftgate_hil.plan.recording_trigger import Trigger, Triggered, trigger_of
from liftgate_hil.signals import COLUMN_PLACE

TIME, FORCE = COLUMN_PLACE["time_s"], COLUMN_PLACE["pinch_force_n"]
GATE = 0x220


def trigger(when: list[str], before: float = 0.003, after: float = 0.002) -> Trigger:
    return trigger_of(when, before, after, 1000.0, {"most": 5.0}, shipped_rig().messages, 2)


@cache
def pressed() -> Trigger:
    return trigger(["pinch_force_n > $most"])


def rows_with(forces: list[float]) -> np.ndarray:
    rows = rows_from(0, len(forces))
    rows[:, FORCE] = forces
    return rows


def frames_at(times_us: list[int]) -> Any:
    """Return frames at these times [µs]."""
    frames = logged(frames_of([(0x100 + k % 3, bytes([k % 256])) for k in range(len(times_us))]), 0, True)
    frames["time_ns"] = np.array(times_us, dtype=np.int64) * 1000
    return frames


@given(
    data=st.data(),
    before=st.integers(0, 12),
    after=st.integers(0, 12),
    true=st.sets(st.integers(0, 59), max_size=6),
    cuts=st.lists(st.integers(0, 60), max_size=5),
)
@CALM
def test_exactly_the_rows_and_frames_near_a_true_tick_are_kept_for_any_blocks(
    data: st.DataObject, before: int, after: int, true: set[int], cuts: list[int]
) -> None:
    rows = rows_with([9.0 if k in true else 0.0 for k in range(60)])
    times = sorted(data.draw(st.lists(st.integers(0, 60_000), max_size=40)))
    frames = frames_at(times)
    near = [(1000 * (k - before), 1000 * (k + after)) for k in true]
    sieve = Triggered(pressed()._replace(before=1e-3 * before, after=1e-3 * after))
    kept_rows, kept_frames, edges = [], [], [0, *sorted(cuts), 60]
    for first, end in itertools.pairwise(edges):
        low, high = np.searchsorted(times, [1000 * first, 1000 * end] if end < 60 else [1000 * first, 10**9])
        part = frames[low:high]
        more, others = sieve.kept(rows[first:end], part, part)
        kept_rows.append(more)
        kept_frames.append(others)
    found = np.concatenate(kept_rows)
    wanted = [k for k in range(60) if any(low <= 1000 * k <= high for low, high in near)]
    assert found.tolist() == rows[wanted].tolist()
    told = np.concatenate(kept_frames)["time_ns"] // 1000
    assert told.tolist() == [t for t in times if any(low <= t <= high for low, high in near)]


def test_adjacent_trigger_windows_are_merged_and_separate_ones_are_kept_apart() -> None:
    sieve = Triggered(trigger(["pinch_force_n > 5", "time_s == 0.05"], 0.003, 0.002))
    forces = [0.0] * 60
    for k in (10, 11, 15, 30):
        forces[k] = 6.0
    sieve.kept(rows_with(forces), no_logged(), no_logged())
    assert np.round(sieve.windows, 6).tolist() == [[0.007, 0.017], [0.027, 0.032], [0.047, 0.052]]


def test_frames_logged_late_are_kept_however_long_the_bus_is_silent() -> None:
    sieve = Triggered(trigger(["pinch_force_n > 5"], 0.01, 0.01))
    frames = frames_at([2_000, 3_000])
    kept = [sieve.kept(rows_with([9.0] + [0.0] * 9), frames[:1], frames)[1]]
    for k in range(100):
        rows = rows_from(10 + 50 * k, 50)
        rows[:, FORCE] = 9.0 if k == 50 else 0.0
        kept.append(sieve.kept(rows, no_logged(), no_logged())[1])
    kept.append(sieve.kept(np.zeros((0, rows.shape[1])), frames[1:], no_logged())[1])
    assert np.concatenate(kept)["time_ns"].tolist() == [2_000_000, 3_000_000]


def test_past_trigger_windows_are_counted_and_discarded() -> None:
    sieve = Triggered(trigger(["pinch_force_n > 5"], 0.0, 0.0))
    for k in range(0, 5000, 50):
        rows = rows_from(k, 50)
        rows[:, FORCE] = [9.0, *[0.0] * 49]
        assert len(sieve.kept(rows, no_logged(), no_logged())[0]) == 1
    assert sieve.count == 100
    assert len(sieve.windows) < 10


def test_pre_trigger_buffers_do_not_grow_without_a_trigger() -> None:
    sieve = Triggered(trigger(["pinch_force_n > 5"], 0.01, 0.0))
    sizes = sieve._rows.rows.nbytes, sieve._frames.rows.nbytes
    for k in range(200):
        rows = rows_from(100 * k, 100)
        rows[:, FORCE] = 0.0
        kept, frames = sieve.kept(rows, frames_at([100_000 * k] * 3), no_logged())
        assert (len(kept), len(frames)) == (0, 0)
    assert (sieve._rows.rows.nbytes, sieve._frames.rows.nbytes) == sizes
    last = rows_from(20_000, 1)
    last[:, FORCE] = 9.0
    kept, _ = sieve.kept(last, no_logged(), no_logged())
    assert kept[:, TIME] == pytest.approx(np.arange(19_990, 20_001) / 1000.0)


def test_a_trigger_condition_may_read_bus_signals() -> None:
    message = shipped_rig().messages["Gate"]
    quiet = {"Angle": 10.0, "LatchState": 0, "TerminalVoltage": 12.0}
    loud = {**quiet, "Angle": 40.0}
    payloads = [message.encode(each, strict=False) for each in (quiet, loud, quiet)]
    frames = logged(frames_of([(GATE, each) for each in payloads]), 0, True)
    frames["time_ns"] = [5_000_000, 20_000_000, 22_000_000]
    sieve = Triggered(trigger(["Gate.Angle > 30"], 0.001, 0.0))
    kept = [sieve.kept(rows_with([0.0] * 40)[k : k + 8], frames[:0], frames)[0] for k in (0,)]
    rows = rows_with([0.0] * 40)
    kept = [sieve.kept(rows[8:], frames[:0], frames[:0])[0], *kept]
    times = np.concatenate(kept)[:, TIME]
    assert times == pytest.approx([0.019, 0.020, 0.021])


@pytest.mark.parametrize(
    ("when", "said"),
    [
        ("pinch_force_n >", "`record_when` pinch_force_n >: the condition ends; allowed: a column"),
        ("nobody > 1", "`record_when` nobody > 1: nobody: no such column"),
        ("Gate.Nobody > 1", "no such signal in the rig's database"),
        ("time_s + 1", "is not a comparison"),
    ],
)
def test_an_invalid_trigger_condition_is_reported(when: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        trigger([when])
    assert said in str(caught.value)


def test_a_pre_trigger_time_too_long_or_a_condition_on_a_missing_drive_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"`record_before` 600: allowed: up to \d+ s at 1000 Hz"):
        trigger(["time_s > 1"], 600.0)
    one = shipped_rig().messages
    with pytest.raises(ConfigError, match="this gate has one drive"):
        trigger_of(["right_current_a > 1"], 0.0, 0.0, 1000.0, {}, one, 1)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same run recorded as a whole, with a trigger, and with a trigger that never fires."""
    for name in ("asammdf", "mcap", "pyarrow"):
        pytest.importorskip(name)
    folder = tmp_path_factory.mktemp("triggered")
    for name, how in {
        "whole": {},
        "part": {
            "record_when": "gate_angle_deg > 1 and gate_angle_deg < 1.2",
            "record_before": 0.1,
            "record_after": 0.05,
        },
        "none": {"record_when": ["pinch_force_n > 1000"]},
    }.items():
        files = [folder / f"{name}{suffix}" for suffix in RECORDED]
        result = lh.run("demo", duration=2.0, record=files, **how)
        assert result.verdict == "pass"
        assert result.summary.recording_windows == {"whole": None, "part": 1, "none": 0}[name]
    return folder


@pytest.mark.filterwarnings("ignore")  # asammdf's own
@pytest.mark.parametrize("suffix", RECORDED)
def test_triggered_recordings_have_the_rows_frames_and_times_of_the_whole_run(runs: Path, suffix: str) -> None:
    whole, part = (open_recording(runs / f"{name}{suffix}") for name in ("whole", "part"))
    if whole.signals:
        compared = compare_tables((whole, part))
        assert all(each.is_equal for each in compared.columns)
        assert compared.alone[1] == 0
        times = np.concatenate(list(part.rows(["time_s", "gate_angle_deg"])))
        near = times[(times[:, 1] > 1.0) & (times[:, 1] < 1.2), 0]
        assert times[0, 0] == pytest.approx(near[0] - 0.1)
        assert times[-1, 0] == pytest.approx(near[-1] + 0.05)
        assert compared.rows == round(1000 * (near[-1] - near[0] + 0.15)) + 1
    if whole.channel is not None:
        every, some = (np.concatenate(list(each.frames())) for each in (whole, part))
        inside = (every["time_ns"] >= some["time_ns"][0]) & (every["time_ns"] <= some["time_ns"][-1])
        assert some.tobytes() == every[inside].tobytes()
        assert 0 < len(some) < len(every) / 2


def test_a_triggered_recording_states_its_trigger(runs: Path) -> None:
    told = json.loads(open_recording(runs / "part.mcap").about)["recorded"]
    assert told == {
        "when": ["gate_angle_deg > 1 and gate_angle_deg < 1.2"], "before_s": 0.1, "after_s": 0.05,
    }  # fmt: skip
    assert "recorded" not in json.loads(open_recording(runs / "whole.mcap").about)
    lines = (runs / "part.asc").read_text().splitlines()
    assert any(each.startswith("// recorded only from 0.1 s before to 0.05 s after") for each in lines)


@pytest.mark.filterwarnings("ignore")  # asammdf's own
@pytest.mark.parametrize("suffix", RECORDED)
def test_times_outside_a_triggered_recording_are_inconclusive(runs: Path, tmp_path: Path, suffix: str) -> None:
    window = open_recording(runs / "part.csv")
    times = np.concatenate(list(window.rows(["time_s"])))[:, 0]
    middle = float(times[len(times) // 2])
    (tmp_path / "s.toml").write_text(
        "duration = 2.0\n"
        '[[expect]]\nname = "all"\nalways = "gate_angle_deg < 80"\n'
        f'[[expect]]\nname = "in"\nalways = "gate_angle_deg < 80"\nafter = {middle}\nwithin_s = 0.01\n'
        '[[expect]]\nname = "bus"\nalways = "Gate.Angle < 80"\n'
        f'[[expect]]\nname = "in bus"\nalways = "Gate.Angle < 80"\nafter = {middle}\nwithin_s = 0.01\n'
    )
    found = lh.judge([runs / f"part{suffix}"], tmp_path / "s.toml").verdicts
    verdicts = {name: each.verdict for name, each in found.items()}
    has_rows = suffix in TABLES
    has_frames = suffix in WITH_FRAMES
    decided = {True: "pass", False: "inconclusive"}
    assert verdicts == {
        "all": "inconclusive", "bus": "inconclusive",
        "in": decided[has_rows], "in bus": decided[has_frames],
    }  # fmt: skip
    said = "rows are missing from 0 s to " if has_rows else "its window, to 2 s, was cut off"
    assert found["all" if has_rows else "bus"].reason.startswith(said)
    empty = lh.judge([runs / f"none{suffix}"], tmp_path / "s.toml").verdicts
    assert {each.reason for each in empty.values()} == {"nothing was recorded"}


def test_the_recorder_process_of_a_real_time_run_triggers_in_the_same_way(tmp_path: Path) -> None:
    files = [tmp_path / "run.csv", tmp_path / "run.log"]
    line = ["--bus", "virtual:triggered", "--duration", "0.6", "--overrun-limit", "60", "--quiet"]
    for file in files:
        line += ["--record", str(file)]
    line += ["--record-when", "time_s > 0.3 and time_s < 0.35", "--record-when", "time_s == 0.5"]
    assert main([*line, "--record-before", "0.02", "--record-after", "0.01"]) == 0
    times = np.concatenate(list(open_recording(files[0]).rows(["time_s"])))[:, 0]
    wanted = [*range(281, 360), *range(480, 511)]
    assert np.round(1000 * times).astype(int).tolist() == wanted
    stamps = np.concatenate([each["time_ns"] for each in open_recording(files[1]).frames()]) * 1e-9
    gap = np.diff(stamps)
    assert len(stamps) > 50
    assert (gap > 0.1).sum() == 1


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--record-when", "time_s > 1"], "--record-when time_s > 1: allowed: together with --record"),
        (["--record-before", "1", "--record", "x.csv"], "--record-before 1: allowed: together with"),
        (["--record-after", "-1"], "argument --record-after: '-1'; allowed: 0 to 600 s"),
    ],
)
def test_trigger_flags_that_need_others_or_are_out_of_range_are_reported(
    more: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--bus", "virtual:x", "--duration", "0.1", *more]) == 2
    assert said in capsys.readouterr().err
