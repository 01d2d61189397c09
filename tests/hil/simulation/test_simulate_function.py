"""`simulate` from Python: the table in the result equals that in a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import liftgate_hil as lh
from liftgate_hil.errors import ConfigError

OPENING = {"voltage": 12.0, "duration": 0.05, "every": 5, "seed": 3, "settings": ["environment.road_slope_deg=8"]}


def test_the_table_of_simulate_in_memory_equals_that_in_a_file(tmp_path: Path) -> None:
    found = lh.simulate(**OPENING)
    target = tmp_path / "opening.csv"
    written = lh.simulate(output=target, **OPENING)
    assert (written.rows, written.time_s, written.columns) == (found.rows, found.time_s, {})
    names = target.read_text("utf-8").partition("\n")[0].split(",")
    table = np.loadtxt(target, delimiter=",", skiprows=1)
    assert list(found.columns) == names
    assert np.array_equal(np.column_stack([*found.columns.values()]), table)
    assert found.to_dict() == {
        "rows": 11, "time_s": 0.05, "duration_s": 0.05, "is_complete": True, "notes": [],
    }  # fmt: skip


def test_a_stopped_simulation_returns_the_rows_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    from liftgate_hil.simulation.request import SimulateRequest
    from liftgate_hil.simulation.simulate import simulated

    monkeypatch.setattr("liftgate_hil.loop.simulation._BLOCK", 10)
    asked = iter([False, False, True])
    found = simulated(SimulateRequest.of(voltage=12.0, duration=0.1), stopped=lambda: next(asked))
    assert not found.is_complete
    assert found.rows == len(found.columns["time_s"]) < 101


@pytest.mark.parametrize(
    ("more", "text"),
    [
        ({"voltage": 12.0, "input": "a.csv"}, "`voltage`: not allowed with `input`"),
        ({"maps": ["a=b"]}, "`maps`: allowed with `input`"),
        ({"voltage": 2000.0}, r"`voltage` 2000.0: allowed: -1000 to 1000 V"),
        ({"voltage": 1.0, "output": "x.txt"}, "`output` x.txt"),
    ],
)
def test_wrong_arguments_of_simulate_are_refused(more: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        lh.simulate(duration=0.01, **more)
