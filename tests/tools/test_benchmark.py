"""The benchmark on a short run: each section, and an episode and its replay end in the same state."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tools.benchmark import episodes, inactive, lateness, parts, processes, replays
from tools.benchmark.checkouts import HERE
from tools.benchmark.effort import SHORT, WHOLE
from tools.c_translator.build import BUILDS

# What the report of cyclictest (rt-tests 2.5, `--json`) has of what is read here.
CYCLICTEST = """#!/bin/sh
for each in "$@"; do
    case "$each" in --json=*) report="${each#--json=}";; esac
done
echo '{"thread": {"0": {"histogram": {"3": 90, "7": 9}, "cycles": 100, "max": 60000}}}' > "$report"
"""
SECTIONS = (
    "The closed loop in machine code",
    "Faults and expectations that do nothing",
    "Campaigns",
    "The step against C",
    "Cost",
    "What each part costs",
    "Start",
    "An hour of `simulate`",
    "`identify` by rows",
    "Lateness of a replay",
    "Lateness with clients of the page",
    "Lateness, paired with cyclictest",
    "Command to feedback",
)


def test_the_whole_benchmark_runs_to_its_end(tmp_path: Path) -> None:
    """With all of its sections and a stand-in for cyclictest; its own loops are compiled, which takes 30 s."""
    program = tmp_path / "cyclictest"
    program.write_text(CYCLICTEST)
    program.chmod(0o755)
    command = [sys.executable, "-m", "tools.benchmark", "--short", "--output", str(tmp_path)]
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(
        command, cwd=HERE, env=environment, capture_output=True, text=True, check=False, timeout=1200
    )
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "benchmark.md").read_text(encoding="utf-8")
    assert [line[3:] for line in page.splitlines() if line.startswith("## ")] == [*SECTIONS]
    assert "nan" not in page
    assert (tmp_path / "benchmark.png").stat().st_size > 10_000


def test_the_short_benchmark_shortens_every_setting() -> None:
    """Each setting of the benchmark needs a smaller value for the short run."""
    same = [name for name in WHOLE._fields if getattr(WHOLE, name) == getattr(SHORT, name)]
    assert same == []
    assert len(lateness.CONDITIONS) > (SHORT.conditions or 0)
    assert len(BUILDS) > (SHORT.builds or 0)


def test_an_error_in_the_benchmarks_loop_thread_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    from tools.benchmark import costs

    def broken(*_: object) -> int:
        raise TypeError("missing a required argument")

    monkeypatch.setattr(costs, "compiled", lambda _: broken)
    with pytest.raises(TypeError, match="missing a required"):
        costs.hot_tick(None, SHORT)


def test_start_up_times_without_a_cold_round_have_no_cold_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "times_of", lambda *_, **__: processes.Times(1.0, 2.0))
    (found,) = processes.compile_times(["--help"], [HERE], SHORT).values()
    assert found == processes.Compile(None, processes.Times(1.0, 2.0))
    (found,) = processes.compile_times(["--help"], [HERE], WHOLE).values()
    assert found.cold == found.warm


def test_a_lost_frame_invalidates_only_its_own_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A bus in a network may lose some: the first of two rounds is reported and left out."""
    arrivals = [np.zeros(1)]

    def played(command: list[str], *_: object) -> tuple[subprocess.CompletedProcess[str], np.ndarray]:
        told = '{"lateness_p50_us": 1, "lateness_p99_us": 2, "lateness_p999_us": 3, "lateness_max_us": 4}'
        done = subprocess.CompletedProcess(command, 0, told, "")
        return done, arrivals.pop() if arrivals else due[0]

    due = [np.zeros(1)]
    monkeypatch.setattr(replays, "players", lambda *_: {"ours": [sys.executable, "-c", "", "--json"]})
    monkeypatch.setattr(replays, "Ear", lambda *_: None)
    monkeypatch.setattr(replays, "_played", played)
    monkeypatch.setattr(replays, "write_log", lambda *_: due.__setitem__(0, np.array([0.0, 1.0])) or due[0])
    found = replays.measure("udp_multicast:x", 2, 1.0)
    assert "1 of 2 frames arrived" in capsys.readouterr().err
    assert found["reported"] == {"ours": [1, 2, 3, 4]}


@pytest.mark.parametrize("case", episodes.cases(None), ids=lambda case: case.name)
def test_an_episode_and_its_replay_end_in_the_same_state(case: episodes.Case) -> None:
    bench = episodes.bench_of()._replace(ticks=2000)
    figures = episodes.measure_case(bench, case, 1)
    assert figures.episode > 0.0
    assert figures.plant > 0.0


def test_every_benchmarked_part_of_the_plant_is_a_valid_vehicle() -> None:
    for settings in parts.PARTS.values():
        assert parts.case_of(parts.vehicle_from("suv", settings, ideal=True))


def test_scenarios_with_inactive_stimuli_run_and_are_compared() -> None:
    found = inactive.measure(rounds=1, ticks=300)
    assert list(found) == list(inactive.CASES)
    assert all(each.tick > 0.0 for each in found.values())
    assert found[inactive.PLAIN].ratio == found[inactive.PLAIN].least_ratio == 1.0


def test_lateness_is_reported_relative_to_the_earliest_frame() -> None:
    due = np.array([5.0, 6.0, 7.0])
    arrivals = np.array([100.001, 101.0, 102.0005])
    assert np.round(replays.lateness(arrivals, due)).tolist() == [1000.0, 0.0, 500.0]


def test_the_benchmarks_log_has_about_1000_frames_a_second_and_a_least_gap(tmp_path: Path) -> None:
    times = replays.write_log(tmp_path / "x.log", "can0", 2.0)
    gaps = np.diff(times)
    assert gaps.min() >= 249e-6
    assert 1500 < len(times) < 2500
    assert len((tmp_path / "x.log").read_text().splitlines()) == len(times)
