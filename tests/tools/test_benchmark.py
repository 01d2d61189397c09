"""The benchmark's own checks, on a short run: an episode and its replay end in the same state."""

from __future__ import annotations

import pytest

from tools.benchmark import episodes, parts


@pytest.mark.parametrize("case", episodes.cases(None), ids=lambda case: case.name)
def test_an_episode_and_its_replay_end_in_the_same_state(case: episodes.Case) -> None:
    bench = episodes.bench_of()._replace(ticks=2000)
    figures = episodes.measure_case(bench, case, 1)
    assert figures.episode > 0.0
    assert figures.plant > 0.0


def test_every_part_is_a_vehicle_that_can_be_had() -> None:
    for settings in parts.PARTS.values():
        assert parts.case_of(parts.session.vehicle_from("suv", settings, ideal=True))
