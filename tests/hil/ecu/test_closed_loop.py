"""The reference ECU and the emulated gate as a compiled episode."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hil_support import text_file

import liftgate_hil as lh
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.config.shipped import find_config
from liftgate_hil.stimuli.moments import NEVER, START, Instant
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.stimuli.stimulus_plan import NO_STIMULI, TimedStimuli
from liftgate_hil.stimuli.timeline import TimedObstacle
from liftgate_plant.obstacle import Obstacle

ROD = 10_000.0  # N/m, the softest of the regulators' test rods


def rod(angle_deg: float, stiffness: float = ROD, start: Instant = START, end: Instant = NEVER) -> TimedStimuli:
    """Return stimuli with a rod that the closing gate meets at an angle, present from `start` to `end`."""
    body = Obstacle(np.radians(angle_deg), 1.0, stiffness, 0.0, 0.0, 1.0)
    return TimedStimuli({}, [TimedObstacle(body, start, end)])


class Run:
    """A passed run of requests (time [s], action): the texts of its events, and the columns of its trace."""

    def __init__(
        self,
        vehicle: str,
        requests: Sequence[tuple[float, str]],
        seconds: float,
        stimuli: TimedStimuli = NO_STIMULI,
        **more: Any,
    ) -> None:
        asked = tuple(Request(Instant(time), action) for time, action in requests)
        self.result = lh.run(Scenario(stimuli, asked, seconds), vehicle=vehicle, trace=True, **more)
        assert self.result.verdict == "pass", self.result.reason

    def column(self, name: str) -> np.ndarray:
        return self.result.trace[name]

    def texts(self) -> list[str]:
        """Return the texts of the ECU's events, each up to its first bracket or comma."""
        return [event.text.split(" (")[0].split(",")[0] for event in self.result.events]


@pytest.mark.parametrize("vehicle", ["suv", "heavy-suv", "compact"])
def test_the_gate_reverses_from_an_obstacle_and_then_closes_fully(vehicle: str) -> None:
    run = Run(
        vehicle,
        [(0.5, "open"), (13.5, "close"), (22.5, "open"), (29.0, "close")],
        43.0,
        rod(35.0, end=Instant(22.0)),
    )
    assert run.texts() == [
        "opening",
        "open",
        "closing",
        "trapped while closing",
        "reversal done",
        "opening",
        "open",
        "closing",
        "closed and latched",
    ]
    assert run.column("latched")[-1] == 1.0
    # Far below what a stalled drive would press: 3.5 kN at the spindle is over 500 N at the edge.
    assert 20.0 < run.column("pinch_force_n").max() < 200.0
    summary = run.result.summary
    assert summary.command_timeouts == 0
    assert summary.received.checksum == summary.received.counter == 0


@pytest.mark.parametrize("slope", [-8.0, 8.0])
@pytest.mark.parametrize("voltage", [9.5, 15.0])
def test_an_undisturbed_gate_is_not_reversed(slope: float, voltage: float) -> None:
    run = Run(
        "suv",
        [(0.5, "open"), (12.0, "close"), (26.0, "open"), (34.0, "close")],
        48.0,
        settings=[f"environment.road_slope_deg={slope}", f"supply.voltage={voltage}"],
    )
    assert run.texts() == ["opening", "open", "closing", "closed and latched"] * 2


def test_a_learned_load_reference_allows_no_larger_pinch_force_than_an_unlearned_one() -> None:
    first = Run("suv", [(0.5, "open"), (12.0, "close")], 20.0, rod(35.0, start=Instant(12.0)))
    second = Run(
        "suv",
        [(0.5, "open"), (12.0, "close"), (26.0, "open"), (34.0, "close")],
        42.0,
        rod(35.0, start=Instant(34.0)),
    )
    assert "trapped while closing" in second.texts()
    assert second.column("pinch_force_n").max() <= first.column("pinch_force_n").max()


@pytest.mark.parametrize("stiffness", [20_000.0, 65_000.0])
def test_stiff_obstacles_are_detected_while_closing(stiffness: float) -> None:
    run = Run("suv", [(0.5, "open"), (12.0, "close")], 20.0, rod(35.0, stiffness))
    assert "trapped while closing" in run.texts()


def test_two_different_drives_stay_synchronous() -> None:
    run = Run("suv", [(0.5, "open")], 12.0, settings=["right.motor.resistance=0.9", "right.spring.health=0.8"])
    apart = np.abs(run.column("left_hall_count") - run.column("right_hall_count"))
    travelling = run.column("gate_angle_deg") < 78.0
    assert apart[travelling].max() < 25.0  # under 1 % of 2950 counts


def test_the_gate_arrives_slowly_at_its_learned_open_end() -> None:
    run = Run("suv", [(0.5, "open"), (12.0, "close"), (26.0, "open")], 36.0)
    late = run.column("time_s") > 26.0
    arriving = late & (run.column("gate_angle_deg") > 79.5)
    assert run.texts()[-1] == "open"
    assert run.column("left_speed_rps")[arriving].max() < 45.0
    assert run.column("left_current_a")[arriving].max() < 4.0  # it does not run into the stop


def test_a_rig_without_latch_signals_can_be_opened_and_latched(tmp_path: Path) -> None:
    shipped = find_config("rigs", "liftgate").read_text()
    lines = [line for line in shipped.splitlines() if not line.startswith("latch_")]
    rig = text_file(tmp_path / "no-latch.toml", "\n".join(lines))
    run = Run("suv", [(0.5, "open"), (12.0, "close")], 26.0, rig=str(rig))
    assert run.texts() == ["opening", "open", "closing", "closed and latched"]
    assert run.column("latched")[-1] == 1.0


def test_the_driver_can_stop_and_reverse_the_gate() -> None:
    run = Run("suv", [(0.5, "open"), (4.0, "stop"), (6.0, "close")], 14.0)
    assert run.texts()[:3] == ["opening", "stopped by the driver", "closing"]
    resting = (run.column("time_s") > 5.0) & (run.column("time_s") < 6.0)
    assert np.ptp(run.column("left_hall_count")[resting]) == 0.0


@pytest.mark.parametrize("period", [0.010, 0.035])
def test_speed_frames_that_come_a_cycle_late_do_not_count_as_load(period: float, tmp_path: Path) -> None:
    late = "".join(
        f'[[fault]]\nkind = "frame_delayed"\nwhere = "{message}"\ndirection = "sent"\ndelay_s = 0.003\n'
        f"period_s = {period}\nshare = 0.5\n"
        for message in ("LeftHall", "RightHall")
    )
    requests = {0.5: "open", 8.0: "close", 11.0: "stop", 12.0: "open", 16.0: "close"}
    asked = "".join(f'[[request]]\ntime = {at}\naction = "{what}"\n' for at, what in requests.items())
    scenario = text_file(
        tmp_path / "late_speeds.toml", f'duration = 27.0\nprecondition = ["open", "close"]\n{late}{asked}'
    )
    told = [each.text.split(" (")[0] for each in lh.run(scenario, clock="free").events]
    closing = ["closing", "stopped by the driver", "opening", "open", "closing", "closed and latched"]
    assert told == ["opening", "open", *closing]
