"""Recording from the page, begun and stopped at random moments on a busy machine."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from asammdf import MDF
from dashboard_support import Client, bench, is_going, page_of, until

from liftgate_hil.formats.open import open_recording
from tools.busy import busy_processes

MOMENTS, NEAR_S = 6, 0.05


@pytest.fixture
def client(tmp_path: Path) -> Iterator[Client]:
    text = 'duration = 1e6\n[[request]]\ntime = 0.5\naction = "open"\n'
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    with bench(tmp_path, "moments", "--ecu", "reference", "--scenario", "s.toml") as run:
        assert any("suv on " in line for line in run.stderr)
        with page_of(tmp_path, "--attach", str(run.pid)) as found:
            until(found, is_going)
            yield found


def let_pass(client: Client, begin: float, seconds: float) -> None:
    """Wait until the run has advanced by its own time [s]; on a busy machine a run pauses now and then."""
    until(client, lambda state: state["time_s"] >= begin + seconds)


def completed(client: Client, name: str) -> str:
    """Return the line of the run's log that reports this file, once another recording can begin."""

    def lines(state: dict[str, Any]) -> list[str]:
        return [line for _, _, line in state["log"] if "recorded: " in line and f"/{name}, " in line]

    return lines(until(client, lambda state: lines(state) and not state["in_force"]["record"]))[0]


@pytest.mark.realtime
def test_a_recording_has_all_rows_and_marks_between_start_and_stop_request(client: Client, tmp_path: Path) -> None:
    """The times of the requests are those in the answers: the ticks at which the run received them."""
    moments = random.Random(57)
    lost: list[str] = []
    with busy_processes(3):
        for number in range(MOMENTS):
            name = f"{number}.{'mf4' if number % 2 else 'csv'}"
            begin = client.command(record={"file": name})[1]["time_s"]
            let_pass(client, begin, moments.uniform(0.0, 0.5))
            mark = client.command(mark=name)[1]["time_s"] if number % 2 else None
            let_pass(client, begin, moments.uniform(0.5, 1.0))
            end = client.command(record=None)[1]["time_s"]
            said = completed(client, name)
            if "rows and frames lost" in said:  # a loop that stood still has caught up by more than the rings hold
                lost.append(said)
                continue
            recording = open_recording(tmp_path / name)
            times = [time for rows in recording.rows(["time_s"]) for time in rows[:, 0].tolist()]
            assert times, said
            assert times[0] == pytest.approx(begin, abs=NEAR_S)
            assert times[-1] == pytest.approx(end, abs=NEAR_S)
            assert len(times) == round(1000.0 * (times[-1] - times[0])) + 1
            if mark is not None:
                with MDF(tmp_path / name) as measured:
                    assert [(each.name, each.value) for each in measured.events] == [(name, pytest.approx(mark))]
    assert len(lost) < MOMENTS, lost
