"""Figures of recordings: curves, marks, captions, and messages for missing columns."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conversion_support import log, table

import liftgate_hil as lh
from liftgate_hil.cli.main import main
from liftgate_hil.config.rig import load_rig
from liftgate_hil.conversion import plot
from liftgate_hil.conversion.figures.pinch import contact_of
from liftgate_hil.conversion.figures.subject import Drawn, FigureSubject, taken
from liftgate_hil.conversion.plot import drawn
from liftgate_hil.conversion.request import FIGURES
from liftgate_hil.conversion.table import open_table
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.setup import vehicle_from
from liftgate_hil.report.pinch import pinch_event
from liftgate_hil.report.run_plot import hall_speed

COLUMNS = (
    "time_s", "gate_angle_deg", "gate_rate_degps", "pinch_force_n",
    "left_voltage_v", "right_voltage_v", "left_current_a", "right_current_a",
    "left_hall_count", "right_hall_count", "left_force_n", "right_force_n",
)  # fmt: skip
TIMES = np.arange(0.0, 1.2, 0.001)
RECORDING = [name for name, kind in FIGURES.items() if kind.of_recording]


def rows_of_a_run(peak: float = 120.0) -> dict[str, np.ndarray]:
    """Rows of a run: closes at 10 deg/s to 20 deg, touches at 0.5 s, reverses at 0.6 s, opens again."""
    rate = np.select([TIMES < 0.1, TIMES < 0.6, TIMES < 1.1], [0.0, -10.0, 12.0], 0.0)
    angle = 25.0 + np.concatenate([[0.0], np.cumsum(rate[:-1])]) * 0.001
    left = {
        "left_voltage_v": np.where(rate < 0.0, -9.0, 12.0) * (rate != 0.0),
        "left_current_a": np.sin(9.0 * TIMES),
        "left_hall_count": np.round(40.0 * angle),
        "left_force_n": 100.0 * np.cos(5.0 * TIMES),
    }
    right = {name.replace("left", "right"): 0.9 * values for name, values in left.items()}
    force = np.interp(TIMES, [0.5, 0.6, 0.7], [0.0, peak, 0.0])
    return {
        "time_s": TIMES, "gate_angle_deg": angle, "gate_rate_degps": rate, "pinch_force_n": force,
        **left, **right,
    }  # fmt: skip


RUN = rows_of_a_run()


def recorded(path: Path, names: tuple[str, ...] = COLUMNS, rows: dict[str, np.ndarray] = RUN) -> Path:
    """Write a recording of these columns; a column's own name may follow after a blank."""
    values = [tuple(map(float, each)) for each in zip(*(rows[name.split()[0]] for name in names), strict=True)]
    return table(path, values, ",".join(name.split()[-1] for name in names) + "\n")


def subject(path: Path, rig: str | None = None, limit: float = 100.0) -> FigureSubject:
    vehicle = vehicle_from("suv", [f"gate.pinch_limit={limit}"])
    return FigureSubject(path.name, open_table(path, rig), rig, vehicle=vehicle, vehicle_name="suv")


def draw(name: str, path: Path, **more: Any) -> Drawn:
    return drawn(name, subject(path, **more))


def curve(axis: Any, label: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of the line with a label."""
    (found,) = [each for each in axis.lines if each.get_label() == label]
    return np.asarray(found.get_xdata()), np.asarray(found.get_ydata())


def texts(axis: Any) -> str:
    return "\n".join(each.get_text() for each in axis.texts)


def legend_hides_nothing(figure: Any) -> None:
    """Check that every legend is above its axes, and that no two legends or titles overlap."""
    figure.canvas.draw()
    for axis in figure.axes:
        if axis.get_legend() is not None:
            assert axis.get_legend().get_window_extent().y0 >= axis.get_window_extent().y1 - 1.0


def curves_differ_without_colour(axis: Any) -> None:
    """Check that any two labelled curves have different dashes or markers."""
    looks = [
        (str(each._unscaled_dash_pattern), each.get_marker())
        for each in axis.lines
        if not each.get_label().startswith("_")
    ]
    assert len(set(looks)) == len(looks)


def test_the_thesis_figure_has_its_quantities_over_time_for_both_drives(tmp_path: Path) -> None:
    figure = draw("thesis", recorded(tmp_path / "run.csv")).figure
    electric, speed, position, angle, force, voltage = figure.axes
    assert [each.get_ylabel() for each in figure.axes] == [
        "motor current\n[A]", "motor speed\n[Hall counts/s]", "motor position\n[Hall counts]",
        "gate angle\n[deg]", "drive force\n[N]", "motor voltage\n[V]",
    ]  # fmt: skip
    for side in ("left", "right"):
        for axis, label, column in (
            (electric, f"current, {side}", f"{side}_current_a"),
            (voltage, f"voltage, {side}", f"{side}_voltage_v"),
            (position, side, f"{side}_hall_count"),
            (force, side, f"{side}_force_n"),
        ):
            times, values = curve(axis, label)
            assert times.tolist() == TIMES.tolist()
            assert values.tolist() == RUN[column].tolist()
        expected = hall_speed(TIMES, RUN[f"{side}_hall_count"])
        assert curve(speed, side)[1].tolist() == expected.tolist()
    assert np.asarray(angle.lines[0].get_ydata()).tolist() == RUN["gate_angle_deg"].tolist()
    assert force.get_xlabel() == "time [s]"
    # Zero is at the same height for currents and voltages, and all of both is shown.
    shares = [-each.get_ylim()[0] / np.ptp(each.get_ylim()) for each in (electric, voltage)]
    assert shares[0] == pytest.approx(shares[1])
    assert electric.get_ylim()[0] < -1.0 < 1.0 < electric.get_ylim()[1]
    assert voltage.get_ylim()[0] < -9.0 < 12.0 < voltage.get_ylim()[1]
    legend_hides_nothing(figure)
    for axis in figure.axes:
        curves_differ_without_colour(axis)


def test_a_gate_with_one_drive_has_no_second_curve(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.csv", tuple(name for name in COLUMNS if not name.startswith("right")))
    electric = draw("thesis", path).figure.axes[0]
    assert [each.get_text() for each in electric.get_legend().get_texts()] == ["current, left", "voltage, left"]


def test_the_phase_portrait_distinguishes_opening_from_closing_and_marks_start_and_end(tmp_path: Path) -> None:
    (axis,) = draw("phase", recorded(tmp_path / "run.csv")).figure.axes
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("gate angle [deg]", "gate rate [deg/s]")
    angles, opening = curve(axis, "opening")
    assert angles.tolist() == RUN["gate_angle_deg"].tolist()
    moves = RUN["gate_rate_degps"] > 0.0
    assert opening[moves].tolist() == RUN["gate_rate_degps"][moves].tolist()
    assert np.isnan(opening[RUN["gate_rate_degps"] < 0.0][1:-1]).all()
    _, closing = curve(axis, "closing")
    closes = RUN["gate_rate_degps"] < 0.0
    assert closing[closes].tolist() == RUN["gate_rate_degps"][closes].tolist()
    assert np.isnan(closing[moves][1:-1]).all()
    start, end = axis.lines[-2:]
    assert (start.get_xdata()[0], start.get_ydata()[0]) == (25.0, 0.0)
    assert end.get_xdata()[0] == pytest.approx(RUN["gate_angle_deg"][-1], rel=1e-12)
    assert start.get_marker() != end.get_marker()
    assert texts(axis) == "start, 0 s\nend, 1.2 s"
    curves_differ_without_colour(axis)
    legend_hides_nothing(axis.figure)


def test_a_phase_portrait_that_ends_where_it_began_has_one_label_for_both(tmp_path: Path) -> None:
    back = {**RUN, "gate_angle_deg": RUN["gate_angle_deg"].copy()}
    back["gate_angle_deg"][-1] = 25.0
    (axis,) = draw("phase", recorded(tmp_path / "run.csv", rows=back)).figure.axes
    assert texts(axis) == "start, 0 s; end, 1.2 s"


def test_a_long_phase_portrait_is_decimated_along_its_path(tmp_path: Path) -> None:
    times = np.arange(0.0, 20.0, 0.001)
    still = times < 19.0
    turn = np.where(still, 0.0, 2.0 * math.pi * (times - 19.0))
    rows = {"time_s": times, "gate_angle_deg": 40.0 - 30.0 * np.cos(turn), "gate_rate_degps": 9.0 * np.sin(turn)}
    (axis,) = draw("phase", recorded(tmp_path / "run.csv", tuple(rows), rows)).figure.axes
    angles, _ = curve(axis, "opening")
    assert 900 < len(angles) <= 1002  # the motion as a whole, the rest once
    assert np.ptp(angles) == pytest.approx(60.0, abs=0.01)


def test_the_pinch_figure_has_limit_peak_impulse_and_time_over_the_limit(tmp_path: Path) -> None:
    found = draw("pinch", recorded(tmp_path / "run.csv"), limit=60.0)
    force, angle, current = found.figure.axes
    assert [each.get_ylabel() for each in found.figure.axes] == [
        "pinch force [N]", "gate angle [deg]", "motor current [A]",
    ]  # fmt: skip
    assert np.asarray(curve(force, "limit 60 N")[1]).tolist() == [60.0, 60.0]
    times, values = (np.asarray(each) for each in force.lines[0].get_data())
    near = np.searchsorted(TIMES, times[0]), np.searchsorted(TIMES, times[-1]) + 1
    assert values.tolist() == RUN["pinch_force_n"][slice(*near)].tolist()
    assert times[0] == pytest.approx(0.5 - 0.12, abs=0.003)
    assert (0.6, 120.0) in [(round(each.get_xdata()[0], 9), each.get_ydata()[0]) for each in force.lines]
    # A triangle of 0.2 s: half its base times its height; above half of its height half of the time.
    assert "peak 120.0 N at 0.600 s, 60.0 N over the limit" in texts(force)
    assert "over the limit for 100 ms, impulse 12.00 N s" in texts(force)
    assert "turned 99 ms after the first touch" in texts(angle)
    marked = {round(each.get_xdata()[0], 3) for each in current.lines if len(set(each.get_xdata())) == 1}
    assert marked == {0.501, 0.6}
    assert curve(current, "right")[1].tolist() == RUN["right_current_a"][slice(*near)].tolist()
    assert force.get_xlim() == angle.get_xlim() == current.get_xlim()
    legend_hides_nothing(found.figure)
    assert "Limit: 60 N, gate.pinch_limit of suv;" in found.caption


def test_a_force_below_the_limit_is_labelled_as_0_ms_over_it(tmp_path: Path) -> None:
    force = draw("pinch", recorded(tmp_path / "run.csv"), limit=300.0).figure.axes[0]
    assert "180.0 N below the limit\nover the limit for 0 ms" in texts(force)
    assert force.get_ylim()[1] > 300.0


def test_impulse_and_time_over_the_limit_equal_exact_integrals() -> None:
    event = pinch_event(RUN)
    assert event is not None
    contact = contact_of(RUN, event, 30.0)
    assert contact.peak == 120.0
    assert contact.impulse == pytest.approx(0.5 * 0.2 * 120.0, rel=1e-9)
    assert contact.over == pytest.approx(0.2 * 0.75, rel=1e-9)


@pytest.mark.parametrize(
    ("figure", "rows", "said"),
    [
        ("pinch", {"pinch_force_n": 0.0 * TIMES}, "pinch_force_n: nothing was pinched; allowed: a recording"),
        ("phase", {"gate_rate_degps": math.nan * TIMES}, "gate_angle_deg, gate_rate_degps: no values"),
        ("phase", {"time_s": np.roll(TIMES, 1)}, "time_s: falls or is not finite; allowed: finite times in order"),
        ("phase", {"time_s": 0.0 * TIMES}, "only one time in the window; allowed: two or more"),
    ],
)
def test_recordings_that_make_no_figure_are_refused(
    tmp_path: Path, figure: str, rows: dict[str, np.ndarray], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        draw(figure, recorded(tmp_path / "run.csv", rows={**RUN, **rows}))


def test_all_missing_columns_are_reported_in_one_message(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.csv", ("time_s", "gate_angle_deg", "left_current_a"))
    with pytest.raises(ConfigError) as error:
        draw("phase", path)
    assert error.value.issues == [
        f"{path}: gate_rate_degps: missing; allowed: a recording that has them as columns, or as sensed_ ones"
    ]
    with pytest.raises(ConfigError) as error:
        draw("thesis", path)
    assert f"{path}: left_voltage_v, left_hall_count, left_force_n: missing; " in error.value.issues[0]
    assert len(error.value.issues) == 1


def test_sensed_values_replace_missing_true_ones_with_a_caption(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.csv", ("time_s", "gate_angle_deg sensed_gate_angle_deg", "gate_rate_degps"))
    found = draw("phase", path)
    assert curve(found.figure.axes[0], "opening")[0].tolist() == RUN["gate_angle_deg"].tolist()
    assert "As the sensors read them: gate_angle_deg." in found.caption
    both = ("time_s", "gate_angle_deg", "gate_rate_degps sensed_gate_angle_deg", "gate_rate_degps")
    found = draw("phase", recorded(tmp_path / "both.csv", both))
    assert curve(found.figure.axes[0], "opening")[0].tolist() == RUN["gate_angle_deg"].tolist()
    assert "sensors" not in found.caption


@pytest.mark.parametrize("name", RECORDING)
@pytest.mark.parametrize("spoilt", [math.nan, 0.0, math.inf, -1e300], ids=["gap", "zero", "infinite", "huge"])
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_gaps_and_extreme_values_are_drawn_without_an_error(tmp_path: Path, name: str, spoilt: float) -> None:
    rows = {column: values.copy() for column, values in RUN.items()}
    for column in COLUMNS[1:]:
        rows[column][:300] = spoilt
    assert draw(name, recorded(tmp_path / "run.csv", rows=rows)).figure.axes


def test_of_rows_at_the_same_time_the_last_one_is_used(tmp_path: Path) -> None:
    path = table(tmp_path / "run.csv", [(0.0, 1.0), (1.0, 2.0), (1.0, 3.0)], "time_s,gate_angle_deg\n")
    found, _ = taken(subject(path), ["gate_angle_deg"])
    assert found["gate_angle_deg"].tolist() == [1.0, 3.0]


# A bus log.

DBC = """VERSION ""
BU_: Gate Control
BO_ 768 Cmd: 8 Control
 SG_ Pwm : 0|8@1- (0.01,0) [-1|1] "1" Gate
BO_ 769 Motion: 8 Gate
 SG_ Phi : 0|16@1- (0.0001,0) [-3|3] "rad" Control
 SG_ Omega : 16|16@1- (0.01,0) [-300|300] "deg/s" Control
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 769 5;
"""
RIG = """dbc = "theirs.dbc"
[inputs]
left_duty = "Cmd.Pwm"
[outputs]
gate_angle = "Motion.Phi"
true_gate_rate = "Motion.Omega"
[messages.Cmd]
cycle_ms = 20
"""


def bus_log(folder: Path) -> Path:
    """Write frames of a foreign database: an angle in rad, a rate in deg/s."""
    (folder / "theirs.dbc").write_text(DBC)
    (folder / "theirs.toml").write_text(RIG)
    pairs = [(100 * k, 500 - 20 * k) for k in range(50)]
    payloads = [b"".join(each.to_bytes(2, "little", signed=True) for each in pair) + bytes(4) for pair in pairs]
    return log(folder / "a.log", [(0x301, each) for each in payloads], [0.005 * k for k in range(50)])


def test_figures_of_a_bus_log_use_mapped_signals_in_our_units(tmp_path: Path) -> None:
    path = bus_log(tmp_path)
    rig = str(tmp_path / "theirs.toml")
    assert load_rig(Path(rig)).outputs[0].scale == pytest.approx(180.0 / math.pi)
    (axis,) = draw("phase", path, rig=rig).figure.axes
    angles, rates = curve(axis, "opening")
    assert angles == pytest.approx(np.degrees(0.01 * np.arange(50)), abs=1e-9)
    assert rates[:20] == pytest.approx(5.0 - 0.2 * np.arange(20), abs=1e-9)


def test_signals_that_the_rig_of_a_bus_log_does_not_map_are_reported(tmp_path: Path) -> None:
    path = bus_log(tmp_path)
    with pytest.raises(ConfigError) as error:
        draw("pinch", path, rig=str(tmp_path / "theirs.toml"))
    assert error.value.issues == [
        f"{path}: pinch_force_n, left_current_a: missing; allowed: a rig that maps true_pinch_force, "
        "left_current, with frames of these in the log"
    ]


@pytest.mark.parametrize(("flags", "limit"), [([], 77.0), (["--vehicle", "suv"], None)])
def test_the_force_limit_is_that_of_the_recorded_vehicle_unless_another_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flags: list[str], limit: float | None
) -> None:
    path, seen = tmp_path / "run.mf4", list[FigureSubject]()
    lh.run("demo", ecu="reference", settings=["gate.pinch_limit=77"], record=[path])
    real = plot.drawn
    monkeypatch.setattr(plot, "drawn", lambda name, subject: (seen.append(subject), real(name, subject))[1])
    assert main(["plot", str(path), "--figure", "pinch", "--output", str(tmp_path / "p.png"), *flags]) == 0
    assert seen[0].vehicle is not None
    assert seen[0].vehicle.gate.pinch_limit == (limit or vehicle_from("suv").gate.pinch_limit)
