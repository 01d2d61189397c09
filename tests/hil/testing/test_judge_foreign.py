"""Judging recordings of other loggers: other names, units, rasters, clocks, gaps and buses."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hil_support import CALM
from hypothesis import given
from hypothesis import strategies as st

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.errors import ConfigError
from liftgate_hil.testing.judged_suite import judge_suite, recorded_cases_of
from liftgate_hil.testing.recorded_run import ColumnSamples
from liftgate_hil.testing.rejudge import expectations_of
from liftgate_hil.testing.request import JudgeRequest

CAR = Path(__file__).parents[3] / "docs/examples/their_car"
ANGLE = "gate_angle_deg=HK_Status.HK_Winkel"


def scenario(folder: Path, *expectations: str, head: str = "") -> Path:
    path = folder / "s.toml"
    path.write_text(head + "".join(f"[[expect]]\n{each}\n" for each in expectations))
    return path


def table(path: Path, head: str, rows: list[tuple[float, ...]]) -> Path:
    path.write_text("".join(",".join(map(repr, row)) + "\n" for row in rows))
    path.write_text(f"{head}\n{path.read_text()}")
    return path


def ramp(path: Path, times: list[float], head: str = "time_s,gate_angle_deg") -> Path:
    """Write a table whose second column is ten times the time; return its path."""
    return table(path, head, [(time, 10.0 * time) for time in times])


def even(rate: float, end: float) -> list[float]:
    """Return times from 0 s to `end`, inclusive, at a rate [Hz]."""
    return [k / rate for k in range(round(rate * end) + 1)]


@pytest.mark.parametrize("rig", ["theirs.toml", "theirs.dbc"])
def test_a_car_loggers_recording_is_judged_by_its_own_names(rig: str) -> None:
    maps = [ANGLE]
    if rig == "theirs.dbc":  # which says nothing of what stands for what
        maps += [f"sensed_{a}_current_a=HK_Motor.HK_Strom{b}" for a, b in (("left", "Links"), ("right", "Rechts"))]
    found = lh.judge([CAR / "closing.log"], CAR / "closing.toml", rig=CAR / rig, maps=maps).verdicts
    back, far, fuse, pinch = found.values()
    assert (back.verdict, far.verdict, fuse.verdict) == ("pass", "pass", "pass")
    assert back.window_s is not None
    assert 1.0 < back.window_s[0] < back.time_s < back.window_s[0] + 0.2  # type: ignore[operator]
    assert (far.margin_unit, far.margin) == ("deg", pytest.approx(4.47, abs=0.01))  # in rad on their bus
    assert (fuse.margin_unit, fuse.margin) == ("A", pytest.approx(4.5, abs=0.1))  # in mA
    assert pinch.verdict == "inconclusive"
    assert pinch.reason == "not in the recording: pinch_force_n"


def test_a_map_sets_names_units_and_scales_for_judging(tmp_path: Path) -> None:
    path = table(
        tmp_path / "m.csv", "t;Winkel [rad];I".replace(";", ","), [(0.1 * k, 0.1 * k, -k) for k in range(9)]
    )
    own = scenario(
        tmp_path,
        'name = "a"\nalways = "gate_angle_deg < 90"',
        'name = "i"\nalways = "sensed.left_current_a < 0.02"',
    )
    maps = ["time_s=t", "gate_angle_deg=Winkel[rad]", "sensed_left_current_a=I[mA]*-2"]
    found = lh.judge([path], own, maps=maps).verdicts
    assert found["a"].margin == pytest.approx(90 - math.degrees(0.8))
    assert found["i"].margin == pytest.approx(0.02 - 0.016)
    (tmp_path / "map.toml").write_text(
        '[columns]\ntime_s = "t"\ngate_angle_deg = { name = "Winkel", unit = "rad" }\n'
        'sensed_left_current_a = { name = "I", unit = "mA", scale = -2 }\n'
    )
    assert lh.judge([path], own, maps=[str(tmp_path / "map.toml")]).verdicts == found


def test_foreign_parquet_and_mf4_files_are_judged_like_csv(tmp_path: Path) -> None:
    import pyarrow as pa
    from asammdf import MDF, Signal
    from pyarrow import parquet

    own = scenario(
        tmp_path, 'name = "a"\neventually = "gate_angle_deg >= 14.9"\nfor_s = 0.2', head="duration = 2\n"
    )
    times = even(50.0, 2.0)
    angles = [10.0 * time for time in times]
    found = [lh.judge([ramp(tmp_path / "m.csv", times, "time_s,W")], own, maps=["gate_angle_deg=W"]).verdicts]
    parquet.write_table(pa.table({"time_s": times, "W": angles}), tmp_path / "m.parquet")
    found.append(lh.judge([tmp_path / "m.parquet"], own, maps=["gate_angle_deg=W"]).verdicts)
    with MDF(version="4.10") as file:
        file.append([Signal(np.radians(angles), np.array(times), unit="rad", name="W")])
        # Another raster, which ends where the run does.
        file.append([Signal(np.ones(5), np.linspace(0.0, 2.0, 5), name="other")])
        file.save(tmp_path / "m.mf4")
    found.append(lh.judge([tmp_path / "m.mf4"], own, maps=["gate_angle_deg=W"]).verdicts)
    assert found[0] == found[1]
    assert found[0]["a"].time_s == found[2]["a"].time_s == 1.7
    assert found[2]["a"].margin == pytest.approx(found[0]["a"].margin)
    (nothing,) = lh.judge([tmp_path / "m.mf4"], own).verdicts.values()
    assert nothing.reason == "not in the recording: gate_angle_deg"


@pytest.mark.parametrize("rate", [100.0, 37.0])
def test_windows_and_hold_times_are_counted_in_ticks_at_any_sampling_rate(tmp_path: Path, rate: float) -> None:
    own = scenario(
        tmp_path,
        'name = "w"\neventually = "gate_angle_deg >= 10"\nafter = 0.5\nwithin_s = 0.4',
        'name = "h"\neventually = "gate_angle_deg >= 10"\nfor_s = 0.2',
        head="duration = 2\n",
    )
    found = lh.judge([ramp(tmp_path / "m.csv", even(rate, 2.0))], own).verdicts
    first = math.ceil(rate) / rate  # the sample that shows it; it holds until the next one
    assert found["w"].verdict == "fail"
    assert found["w"].margin == pytest.approx(10 * math.floor(0.9 * rate) / rate - 10)
    assert found["h"].time_s == pytest.approx(first + 0.2, abs=1.1e-3)


def test_jitter_of_timestamps_is_no_gap_and_longer_intervals_are(tmp_path: Path) -> None:
    draw = np.random.default_rng(1)
    times = [0.01 * k + draw.uniform(0.0, 0.009) for k in range(200)]
    expectations = (
        'name = "x"\nalways = "gate_angle_deg < 30"',
        'name = "early"\nalways = "gate_angle_deg < 30"\nwithin_s = 0.8',
    )
    own = scenario(tmp_path, *expectations)
    found = lh.judge([ramp(tmp_path / "m.csv", times)], own).verdicts
    assert {each.verdict for each in found.values()} == {"pass"}
    gone = [time for time in times if not 1.0 < time < 1.1]
    path = ramp(tmp_path / "m.csv", gone)
    found = lh.judge([path], own).verdicts
    assert (found["x"].verdict, found["early"].verdict) == ("inconclusive", "pass")
    assert found["x"].reason.startswith("there is no sample of gate_angle_deg from 0.99")
    assert lh.judge([path], own, longest_gap=0.2).verdicts["x"].verdict == "pass"
    assert lh.judge([path], own, longest_gap=0.011).verdicts["early"].verdict == "inconclusive"


def test_a_gap_concerns_its_column_only_and_an_early_end_counts_as_a_gap(tmp_path: Path) -> None:
    a = ramp(tmp_path / "a.csv", even(100.0, 1.0))
    b = table(tmp_path / "b.csv", "time_s,left_current_a", [(time, 1.0) for time in even(100.0, 2.0)])
    own = scenario(
        tmp_path, 'name = "a"\nalways = "gate_angle_deg < 30"', 'name = "b"\nalways = "left_current_a < 30"',
        'name = "first"\nalways = "gate_angle_deg < 30"\nwithin_s = 0.9',
        'name = "opened"\nalways = "left_current_a < 30"\nafter = "gate_angle_deg > 5"',
    )  # fmt: skip
    found = lh.judge([a, b], own, one_run=True).verdicts
    assert {name: each.verdict for name, each in found.items()} == {
        "a": "inconclusive", "b": "pass", "first": "pass", "opened": "inconclusive"
    }  # fmt: skip
    assert found["a"].reason == "there is no sample of gate_angle_deg from 1 s to 2 s"


def test_wall_clock_times_count_from_the_first_timestamp_and_must_be_in_all_files(tmp_path: Path) -> None:
    epoch = 1_751_364_005.25
    log = tmp_path / "m.log"
    log.write_text("".join(f"({epoch + 0.01 * k:.6f}) can1 393#{400 * k:04X}00\n" for k in range(101)))
    own = scenario(tmp_path, 'name = "x"\neventually = "HK_Status.HK_Winkel > 0.405 and left_current_a > 4.5"')
    late = table(tmp_path / "m.csv", "time_s,left_current_a", [(epoch + time, 10 * time) for time in even(100, 1)])
    found = lh.judge([late, log], own, rig=CAR / "theirs.dbc", one_run=True).verdicts
    assert found["x"].time_s == pytest.approx(0.51)  # 0.01 rad a frame, from -0.1
    other = table(tmp_path / "o.csv", "time_s,left_current_a", [(time, 1.0) for time in even(100, 1)])
    with pytest.raises(ConfigError, match=r"m\.log: wall-clock timestamps, but none in .*o\.csv"):
        lh.judge([other, log], own, rig=CAR / "theirs.dbc", one_run=True)


def test_a_time_0_after_the_end_is_refused(tmp_path: Path) -> None:
    path, own = (
        ramp(tmp_path / "m.csv", [1.0, 2.0]),
        scenario(tmp_path, 'name = "a"\nalways = "gate_angle_deg < 90"'),
    )
    with pytest.raises(
        ConfigError, match="ends 8 s before time 0 of the run, at 10 s by its times; allowed: an `orig"
    ):
        lh.judge([path], own, origin=10.0)


def test_local_dates_of_a_table_are_read_in_the_given_time_zone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wall-clock log beside the table covers the same times in one time zone only."""
    begin = 1_759_122_000  # 2025-09-29 13:00:00 in Shanghai, 05:00 UTC
    for zone in ("UTC", "Asia/Shanghai"):  # this computer's counts for nothing
        monkeypatch.setenv("TZ", zone)
        time.tzset()
        lines = [f"2025-09-29 13:00:0{k // 10}.{k % 10},{k}" for k in range(50)]
        path = tmp_path / "m.csv"
        path.write_text("\n".join(["t,gate_angle_deg", *lines]) + "\n")
        log = tmp_path / "m.log"
        log.write_text("".join(f"({begin + 0.1 * k:.6f}) can0 123#00\n" for k in range(50)))
        own = scenario(tmp_path, 'name = "a"\nalways = "gate_angle_deg < 90"')
        found = lh.judge([path, log], own, maps=["time_s=t"], timezone="Asia/Shanghai", one_run=True).verdicts
        assert found["a"].verdict == "pass"
        with pytest.raises(ConfigError, match="8 h after"):
            lh.judge([path, log], own, maps=["time_s=t"], timezone="UTC", one_run=True)
    monkeypatch.undo()
    time.tzset()


@pytest.mark.parametrize(
    ("maps", "said"),
    [
        (["gate_angle_deg=Nobody"], "gate_angle_deg: no column 'Nobody'; allowed: time_s, W"),
        (["gate_angle_deg=W[kg]"], r"gate_angle_deg: unit 'kg'; allowed: rev, deg"),
        (["no_such=W"], "no_such: unknown column; allowed: time_s"),
        (["gate_angle_deg=HK_Status.HK_Winkel"], "no column 'HK_Status.HK_Winkel'; allowed: time_s, W"),
        (["left_current_a=W[rad]"], "unit 'rad'; allowed: A"),
        ([], "time_s: missing"),
    ],
)
def test_a_map_of_an_unknown_column_or_unit_is_refused(tmp_path: Path, maps: list[str], said: str) -> None:
    own = scenario(tmp_path, 'name = "x"\nalways = "gate_angle_deg < 30"')
    path = ramp(tmp_path / "m.csv", even(100.0, 1.0), "time_s,W" if maps else "t,gate_angle_deg")
    with pytest.raises(ConfigError, match=said):
        lh.judge([path], own, maps=maps, rig=CAR / "theirs.dbc")


def test_judging_ignores_frames_that_fail_the_rigs_protection(tmp_path: Path) -> None:
    (tmp_path / "theirs.dbc").write_bytes((CAR / "theirs.dbc").read_bytes())
    (tmp_path / "r.toml").write_text(
        (CAR / "theirs.toml").read_text() + '[messages.HK_Motor]\ncounter = "HK_Spannung"\n'
    )
    own = scenario(tmp_path, 'name = "x"\nnever = "sensed.left_current_a > 0.5"')
    frames = [
        (0.01 * k, f"392#{0 if k != 7 else 2000:04X}0000{(k if k != 7 else 6) % 4096:03X}0") for k in range(50)
    ]
    (tmp_path / "m.log").write_text("".join(f"({time:010.6f}) can0 {said}\n" for time, said in frames))
    assert lh.judge([tmp_path / "m.log"], own, rig=tmp_path / "r.toml").verdicts["x"].verdict == "pass"
    assert lh.judge([tmp_path / "m.log"], own, rig=CAR / "theirs.toml").verdicts["x"].verdict == "fail"


def by_hand(track: ColumnSamples, at: list[int]) -> list[float]:
    """Return the last value at or before each time [µs], NaN before the first."""
    seen: Callable[[int], list[float]] = lambda now: [  # noqa: E731
        value for time, value in zip(track.times_us.tolist(), track.values.tolist(), strict=True) if time <= now
    ]
    return [seen(now)[-1] if seen(now) else math.nan for now in at]


@CALM
@given(st.lists(st.integers(0, 40), unique=True, max_size=12), st.lists(st.integers(-5, 45), max_size=12))
def test_a_column_has_its_latest_sample_in_each_tick(times: list[int], at: list[int]) -> None:
    track = ColumnSamples(np.array(sorted(times), dtype=np.int64), np.arange(len(times), dtype=float))
    np.testing.assert_equal(track.held(np.array(at, dtype=np.int64)), by_hand(track, at))


@pytest.mark.parametrize(
    "head", ["left_current_a/mA", "left_current_a_mA", "left_current_a{mA}", "left_current_a in mA"]
)
def test_a_unit_after_a_catalogue_name_is_understood_in_any_form(tmp_path: Path, head: str) -> None:
    path = table(tmp_path / "m.csv", f"time_s,{head}", [(0.1 * k, 500.0) for k in range(9)])
    own = scenario(tmp_path, 'name = "i"\nalways = "left_current_a < 1"')
    assert lh.judge([path], own).verdicts["i"].margin == pytest.approx(0.5)


@pytest.mark.parametrize("head", ["left_current_ma", "left_current_kA"])
def test_a_unit_that_replaces_that_of_a_catalogue_name_is_refused(tmp_path: Path, head: str) -> None:
    path = table(tmp_path / "m.csv", f"time_s,{head}", [(0.1 * k, 500.0) for k in range(9)])
    own = scenario(tmp_path, 'name = "i"\nalways = "left_current_a < 1"')
    unit = head[-2:].replace("ma", "mA")
    with pytest.raises(
        ConfigError, match=rf"{head}: unexpected unit; allowed: `maps` 'left_current_a={head}\[{unit}\]'"
    ):
        lh.judge([path], own)


SNA = """
VERSION ""
BU_: Gate Ecu
BO_ 256 Befehl: 2 Ecu
 SG_ Tast : 0|16@1- (0.1,0) [-100|100] "%" Gate
BO_ 257 Lage: 3 Gate
 SG_ Winkel : 0|16@1- (0.1,0) [-100|200] "deg" Gate
 SG_ Schloss : 16|2@1+ (1,0) [0|3] "" Gate
VAL_ 257 Schloss 0 "offen" 1 "Hauptraste" 2 "Vorraste" 3 "SNA";
"""


@pytest.mark.parametrize("also", [False, True], ids=["alone", "beside the latch"])
def test_an_unmapped_database_label_does_not_affect_other_signals_of_its_frame(tmp_path: Path, also: bool) -> None:
    (tmp_path / "their.dbc").write_text(SNA)
    (tmp_path / "rig.toml").write_text(
        'dbc = "their.dbc"\nbitrate = 500000\n[inputs]\nleft_duty = "Befehl.Tast"\nright_duty = "Befehl.Tast"\n'
        '[outputs]\ngate_angle = { signal = "Lage.Winkel" }\n'
        'latch_state = { signal = "Lage.Schloss", values = { open = "offen", latched = "Hauptraste" } }\n'
        "[messages]\nLage = { cycle_ms = 20 }\nBefehl = { cycle_ms = 20 }\n"
    )
    log = tmp_path / "m.log"
    frames = [(950 if k in (150, 151) else 400, 3 if k in (150, 151) else 0) for k in range(300)]
    lines = (
        f"({0.02 * k:.6f}) can0 101#{a.to_bytes(2, 'little').hex()}{s:02X}\n" for k, (a, s) in enumerate(frames)
    )
    log.write_text("".join(lines))
    more = ['name = "unlatches"\neventually = "sensed.latched == 0"'] if also else []
    own = scenario(tmp_path, 'name = "stop"\nnever = "sensed.gate_angle_deg > 90"', *more)
    found = lh.judge([log], own, rig=tmp_path / "rig.toml").verdicts
    assert (found["stop"].verdict, found["stop"].margin) == ("fail", pytest.approx(-5.0))
    about = expectations_of(JudgeRequest((), own, rig=tmp_path / "rig.toml"))
    (outcome,) = judge_suite(recorded_cases_of([(log,)], about), is_summarized=False)
    said = "Lage.Schloss: 3 (SNA) at 3.000 s is no value of latch_state; left out in 2 frames"
    assert outcome.result is not None
    assert [note for note in outcome.result.notes if "Lage" in note] == ([said] if also else [])


@pytest.mark.parametrize("suffix", [".csv", ".mcap", ".parquet", ".mf4"])
def test_a_decoded_table_is_judged_like_its_log(tmp_path: Path, suffix: str) -> None:
    """Its units are read, rows before a message's first frame have no value, and its rows are unevenly spaced."""
    log, table_ = CAR / "closing.log", tmp_path / f"closing{suffix}"
    assert main(["convert", str(log), str(table_), "--rig", str(CAR / "theirs.dbc")]) == 0
    own = scenario(
        tmp_path,
        'name = "far"\nalways = "sensed.gate_angle_deg < 90"',
        'name = "fuse"\nalways = "sensed.left_current_a < 30"',
    )
    maps = ["sensed_gate_angle_deg=HK_Status.HK_Winkel", "sensed_left_current_a=HK_Motor.HK_StromLinks"]
    theirs = lh.judge([log], own, rig=CAR / "theirs.dbc", maps=maps).verdicts
    rig = CAR / "theirs.dbc" if suffix == ".csv" else None  # has no units
    ours = lh.judge([table_], own, maps=maps, rig=rig).verdicts
    for name, verdict in theirs.items():
        assert (ours[name].verdict, ours[name].margin) == ("pass", pytest.approx(verdict.margin)), name


def test_rows_that_come_in_pairs_have_no_gaps_between_them(tmp_path: Path) -> None:
    """Such as rows of two messages sent one after the other."""
    times = [0.01 * k + part for k in range(100) for part in (0.0, 0.0005)]
    own = scenario(tmp_path, 'name = "a"\nalways = "gate_angle_deg < 90"')
    assert lh.judge([ramp(tmp_path / "m.csv", times)], own).verdicts["a"].verdict == "pass"
    missing = [each for each in times if not 0.3 < each < 0.4]
    assert lh.judge([ramp(tmp_path / "m.csv", missing)], own).verdicts["a"].verdict == "inconclusive"


def test_a_log_without_frames_is_inconclusive_and_its_unparsed_lines_are_noted(tmp_path: Path) -> None:
    """An ASC file with another suffix, none of whose lines can be parsed."""
    (tmp_path / "m.log").write_text(
        "date Sun Jun 15 14:00:00 2025\nbase hex timestamps absolute\n0.1 1 123 Rx d 1 00\n"
    )
    own = scenario(tmp_path, 'name = "a"\nalways = "gate_angle_deg < 90"')
    (outcome,) = judge_suite(
        recorded_cases_of([(tmp_path / "m.log",)], expectations_of(JudgeRequest((), own))), is_summarized=False
    )
    assert outcome.verdict == "inconclusive"
    assert outcome.result is not None
    assert any("3 lines left out (not understood)" in note for note in outcome.result.notes)


@pytest.mark.parametrize("origin", [2.0, 1_749_988_802.0], ids=["after the first frame", "by the wall clock"])
def test_an_origin_sets_time_0_of_a_log_with_wall_clock_times(tmp_path: Path, origin: float) -> None:
    log = tmp_path / "m.log"
    log.write_text("".join(f"({1_749_988_800 + 0.01 * k:.6f}) can1 393#{100 * k:04X}00\n" for k in range(401)))
    own = scenario(tmp_path, 'name = "x"\neventually = "HK_Status.HK_Winkel > 0.85"')
    found = lh.judge([log], own, rig=CAR / "theirs.dbc", origin=origin).verdicts
    assert found["x"].verdict == "pass"
    assert found["x"].time_s == pytest.approx(
        lh.judge([log], own, rig=CAR / "theirs.dbc").verdicts["x"].time_s - 2.0, abs=0.02
    )
