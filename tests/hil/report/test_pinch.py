"""Pinch events: peak force, duration and reversal in rows with known results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes

from liftgate_hil.described_result import json_of
from liftgate_hil.report.pinch import LIMITS, PinchEvent, pinch_event
from liftgate_hil.report.run_plot import DrawnObstacle, RunPicture, command_reversal, plot_run, run_figure

TIMES = np.arange(0.0, 10.0, 0.001)


def rows(peak: float = 120.0, way: float = -1.0, back: float = 3.0) -> dict[str, np.ndarray]:
    """Rows of a gate that moves at 2 deg/s to 40 deg, touches at 4.5 s, turns at 5 s, then backs for `back` s."""
    rate = np.select([TIMES < 5.0, 5.0 + back > TIMES], [2.0 * way, -2.0 * way], 0.0)
    angle = 40.0 - 2.0 * way * abs(TIMES - 5.0)
    angle[5.0 + back <= TIMES] = 40.0 - 2.0 * way * back
    force = np.interp(TIMES, [4.5, 5.0, 5.25], [0.0, peak, 0.0])
    return {
        "time_s": TIMES,
        "gate_angle_deg": angle,
        "gate_rate_degps": rate,
        "pinch_force_n": force,
        "left_current_a": np.sin(TIMES),
        "left_hall_count": np.floor(100 * TIMES),
    }


def event_of(columns: dict[str, np.ndarray]) -> PinchEvent:
    event = pinch_event(columns)
    assert event is not None
    return event


@pytest.mark.parametrize("way", [-1.0, 1.0])
def test_peak_contact_and_reversal_of_a_pinch_are_found_in_both_directions(way: float) -> None:
    event = event_of(rows(way=way))
    assert event.force_n == pytest.approx(120.0)
    assert (event.time_s, event.angle_deg) == (pytest.approx(5.0), pytest.approx(40.0))
    assert event.start_s == pytest.approx(4.5, abs=0.0015)
    assert event.end_s == pytest.approx(5.25, abs=0.0015)
    assert event.reversal_time_s == pytest.approx(0.5, abs=0.0015)
    assert event.further_deg == pytest.approx(1.0, abs=0.003)
    assert event.back_deg == pytest.approx(6.0, abs=0.005)


def test_the_pinch_event_is_the_contact_with_the_largest_force() -> None:
    columns = rows()
    columns["pinch_force_n"] += np.interp(TIMES, [1.0, 1.1, 1.2], [0.0, 80.0, 0.0])
    assert event_of(columns).start_s == pytest.approx(4.5, abs=0.0015)


def test_a_gate_that_keeps_pressing_did_not_reverse() -> None:
    columns = rows()
    columns["gate_rate_degps"] = np.minimum(columns["gate_rate_degps"], 0.0)
    event = event_of(columns)
    assert np.isnan(event.reversal_time_s)
    assert "did not reverse" in event.lines()[-1]
    assert json_of(event)["reversal_time_s"] is None


def test_a_gate_whose_obstacle_is_removed_did_not_reverse() -> None:
    """The gate bounces at the touch, presses on, and springs back when the rod is taken away."""
    columns = rows()
    rate = np.select([TIMES < 4.6, TIMES < 4.65, TIMES < 5.2, TIMES < 5.5], [-2.0, 2.0, 0.0, 3.0])
    event = event_of({**columns, "gate_rate_degps": rate, "pinch_force_n": 100.0 * (abs(TIMES - 4.85) < 0.35)})
    assert np.isnan([event.turn_s, event.back_deg]).all()


def test_motion_after_the_way_back_is_no_further_reversal() -> None:
    """The gate bounces before it goes on into the obstacle, creeps on after its stop, then opens once more."""
    columns = rows(back=1.0)
    columns["gate_rate_degps"] *= 3.0
    columns["gate_rate_degps"][6000:8000] = 0.55
    columns["gate_rate_degps"][4600:4650] = 2.0
    columns["gate_rate_degps"][8000:9000] = 2.0
    columns["gate_angle_deg"][8000:] += 30.0
    event = event_of(columns)
    assert event.turn_s == pytest.approx(5.0, abs=0.0015)
    assert event.back_deg == pytest.approx(2.0, abs=0.005)


def test_a_run_without_contact_has_no_pinch_event() -> None:
    columns = rows(peak=0.0)
    assert pinch_event(columns) is None
    assert pinch_event({name: each[:0] for name, each in columns.items()}) is None


def test_time_over_a_force_limit_is_the_longest_uninterrupted_one() -> None:
    columns = rows()
    # Over 150 N for 0.4 s, below for a moment, and for 0.5 s again: never for 0.75 s in a row.
    force = np.zeros(len(TIMES))
    force[4000:4400] = force[4410:4910] = 200.0
    event = event_of({**columns, "pinch_force_n": force})
    longest = dict(zip([limit.force for limit in LIMITS], event.longest_s, strict=True))
    assert longest == {400.0: 0.0, 150.0: pytest.approx(0.5), 100.0: pytest.approx(0.5)}
    assert [event.over(limit) for limit in LIMITS] == [False, False, True]
    force[4000:4910] = 200.0
    event = event_of({**columns, "pinch_force_n": force})
    assert [event.over(limit) for limit in LIMITS] == [False, True, True]


def test_each_force_limit_is_reported_with_its_source_and_margin() -> None:
    lines = "\n".join(event_of(rows(peak=123.46)).lines())
    assert "at most 123.5 N, at 5.000 s and 40.00 deg" in lines
    for limit in LIMITS:
        assert f"limit {limit.force:.0f} N" in lines
        assert limit.source in lines
    assert "276.5 N left" in lines
    assert "23.5 N over" in lines


# The picture.


def texts_of(picture: RunPicture) -> str:
    figure = run_figure(picture)
    return "\n".join(each.get_text() for each in figure.findobj() if hasattr(each, "get_text"))


def picture_of(columns: dict[str, np.ndarray]) -> RunPicture:
    obstacle = DrawnObstacle(41.0, 0.0, np.inf)
    return RunPicture("a run", columns, pinch_event(columns), [obstacle], [(4.9, "reversal")])


def test_the_pinch_figure_states_peak_limits_margin_and_reversal() -> None:
    said = texts_of(picture_of(rows()))
    for text in (
        "peak 120.0 N", "at 5.000 s, 40.00 deg", "280.0 N below 400 N", "20.0 N above 100 N", "EN 12453", "UN R21",
        "obstacle at 41 deg", "first touch", "turned 499 ms after the first touch", "reversal", "left",
    ):  # fmt: skip
        assert text in said


def test_a_rod_is_drawn_from_the_time_at_which_the_closing_gate_can_hit_it() -> None:
    """The rod is there from the start, but the gate opens past it first."""
    columns = rows()
    opening = TIMES < 2.0
    columns["gate_angle_deg"] = np.where(opening, 22.0 * TIMES, columns["gate_angle_deg"])
    for obstacle, begins in ((DrawnObstacle(41.0, 0.0, 9.0), 41.0 / 22.0), (DrawnObstacle(41.0, 3.0, 9.0), 3.0)):
        axes = run_figure(RunPicture("a run", columns, None, [obstacle])).findobj(Axes)
        (rod,) = [line for line in axes[0].get_lines() if str(line.get_label()).startswith("obstacle")]
        assert rod.get_xdata().tolist() == pytest.approx([begins, 9.0], abs=0.002)
    # One that is met while opening: the gate is never beyond it.
    axes = run_figure(RunPicture("a run", rows(way=1.0), None, [DrawnObstacle(41.0, 0.0, 9.0)])).findobj(Axes)
    (rod,) = [line for line in axes[0].get_lines() if str(line.get_label()).startswith("obstacle")]
    assert rod.get_xdata().tolist() == [0.0, 9.0]


def test_the_ecus_reversal_is_found_at_its_current_peak() -> None:
    columns = rows()
    columns["left_duty"] = np.where(TIMES < 4.8, -0.7, 0.9)
    columns["left_current_a"] = np.interp(TIMES, [4.8, 4.81, 5.0], [-2.0, 25.0, 10.0])
    event = event_of(columns)
    assert command_reversal(columns, event) == (pytest.approx(4.81), pytest.approx(25.0))
    assert texts_of(picture_of(columns)).count("ECU reverses") == 2  # the whole run, and the pinch
    stays = {**columns, "left_duty": np.full(len(TIMES), -0.7)}
    assert command_reversal(stays, event) is None
    assert "ECU reverses" not in texts_of(picture_of(stays))


def test_the_figure_shows_the_current_of_one_drive_or_of_both_separately() -> None:
    columns = rows()
    assert "right" not in texts_of(picture_of(columns))
    both = {**columns, "right_current_a": columns["left_current_a"]}
    axes = run_figure(picture_of(both)).findobj(Axes)
    (current,) = (axis for axis in axes[:4] if axis.get_ylabel() == "motor current [A]")
    drives = {line.get_label(): line for line in current.get_lines()}
    assert drives["left"].get_color() != drives["right"].get_color()
    assert drives["left"].get_linestyle() != drives["right"].get_linestyle()


def test_a_run_without_a_pinch_is_drawn_without_marks(tmp_path: Path) -> None:
    picture = picture_of(rows(peak=0.0))
    assert "peak" not in texts_of(picture)
    plot_run(tmp_path / "run.png", picture)
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
