"""Record button of the page: each file holds the rows between the two clicks, as logged on the page."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from browser_support import click, errors_in, found, set_value, text_of, until, value_of

from liftgate_hil.formats.open import open_file

TICK_S = 1e-3
BEGINS = r"record {name}: recording from ([\d.]+) s on"
HOLDS = r"recorded: \S*{name}, ([\d.]+) to ([\d.]+) s$"


def told(page: Any, pattern: str, name: str) -> list[float]:
    """Numbers in the line of the page's log that matches a pattern for this file name, once it is there."""

    def line(_: object) -> Any:
        lines = text_of(page, "#log").splitlines()
        return next((match for each in lines if (match := re.search(pattern.format(name=name), each))), None)

    try:
        return [float(each) for each in until(page, line).groups()]
    except AssertionError:
        raise AssertionError(text_of(page, "#log")) from None


@pytest.mark.parametrize("suffix", ["csv", "mf4"])
def test_a_recorded_file_holds_the_rows_and_marks_from_start_to_stop(page: Any, folder: Path, suffix: str) -> None:
    name = f"clicks.{suffix}"
    set_value(page, "#record-name", name)
    before = value_of(page, "time_s")
    click(page, "#record-button")
    begins = told(page, BEGINS, name)[0]
    until(page, lambda _: text_of(page, "#record-button") == f"Stop {name}")
    until(page, lambda _: "recording" in text_of(page, "#health"))
    if suffix == "mf4":  # a CSV holds none
        set_value(page, "#mark-text", "a squeak")
        click(page, "#mark button")
        until(page, lambda _: "mark a squeak" in text_of(page, "#answer"))
    until(page, lambda _: value_of(page, "time_s") > begins + 0.5)
    click(page, "#record-button")
    until(page, lambda _: text_of(page, "#record-button") == "Record")
    after = value_of(page, "time_s")
    first, last = told(page, HOLDS, name)
    assert before <= first == pytest.approx(begins, abs=TICK_S / 2)
    assert begins + 0.5 < last <= after
    table = open_file(folder / name)
    times = [time for block in table.rows(["time_s"]) for (time,) in block.tolist()]
    assert times[0] == pytest.approx(first, abs=TICK_S / 2)
    assert times[-1] == pytest.approx(last, abs=TICK_S / 2)
    assert len(times) == round((times[-1] - times[0]) / TICK_S) + 1  # without a gap
    marks = [(time, text) for time, text in table.marks if text == "a squeak"]
    assert len(marks) == (1 if suffix == "mf4" else 0)
    assert all(first <= time <= last for time, _ in marks)
    assert found(page, "#record-name").is_displayed()
    assert errors_in(page) == []
