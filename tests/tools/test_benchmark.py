"""The benchmark's own checks, on a short run: an episode and its replay end in the same state."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tools.benchmark import episodes, inactive, parts, replays


@pytest.mark.parametrize("case", episodes.cases(None), ids=lambda case: case.name)
def test_an_episode_and_its_replay_end_in_the_same_state(case: episodes.Case) -> None:
    bench = episodes.bench_of()._replace(ticks=2000)
    figures = episodes.measure_case(bench, case, 1)
    assert figures.episode > 0.0
    assert figures.plant > 0.0


def test_every_part_is_a_vehicle_that_can_be_had() -> None:
    for settings in parts.PARTS.values():
        assert parts.case_of(parts.session.vehicle_from("suv", settings, ideal=True))


def test_scenarios_with_what_does_nothing_run_and_are_compared() -> None:
    found = inactive.measure(rounds=1, ticks=300)
    assert list(found) == list(inactive.CASES)
    assert all(each.tick > 0.0 for each in found.values())
    assert found[inactive.PLAIN].ratio == found[inactive.PLAIN].least_ratio == 1.0


def test_lateness_is_told_against_the_earliest_frame() -> None:
    due = np.array([5.0, 6.0, 7.0])
    arrivals = np.array([100.001, 101.0, 102.0005])
    assert np.round(replays.lateness(arrivals, due)).tolist() == [1000.0, 0.0, 500.0]


def test_frames_of_a_log_have_no_period_and_keep_a_bus_busy(tmp_path: Path) -> None:
    times = replays.write_log(tmp_path / "x.log", "can0", 2.0)
    gaps = np.diff(times)
    assert gaps.min() >= 249e-6
    assert 1500 < len(times) < 2500
    assert len((tmp_path / "x.log").read_text().splitlines()) == len(times)
