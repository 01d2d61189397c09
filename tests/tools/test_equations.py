"""The index of equations is complete, and the tests it names detect changes of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tools.equations import NUMBERS, ROOT, numbers, problems, source_of
from tools.equations.mutants import copied, survived
from tools.equations.table import TABLE, Row

ROWS = {row.number: row for row in TABLE}
# A term of the solver; `test_every_tool_runs.py` takes one of the geometry, `--mutate` without a number all.
ONE = ROWS["4.11"]


def test_every_equation_is_in_the_table_once_and_in_order() -> None:
    assert tuple(row.number for row in TABLE) == NUMBERS
    assert len(NUMBERS) == 44 + 13


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.number)
def test_the_code_text_and_test_named_for_an_equation_exist(row: Row) -> None:
    assert problems(row) == []
    assert row.mutant != row.text


def test_every_equation_has_its_own_mutation() -> None:
    changes = {(source_of(row), row.text, row.mutant) for row in TABLE}
    assert len(changes) == len(TABLE)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"where": "nowhere.linkage"}, "no file"),
        ({"where": "gate.nothing"}, "no gate.nothing"),
        ({"where": "gate.lever"}, "the docstring of gate.lever does not name it"),
        ({"where": "gate.length"}, "not in gate.length"),
        ({"text": "hx"}, "times in"),
        ({"text": "no such text"}, "0 times in"),
        ({"test": "plant/test_bodies.py::test_nothing"}, "no test"),
        ({"test": "plant/test_none.py::test_nothing"}, "no test"),
    ],
)
def test_missing_code_text_or_tests_of_an_equation_are_reported(changes: dict[str, str], said: str) -> None:
    assert said in "; ".join(problems(ROWS["3.23"]._replace(**changes)))


def test_ranges_of_equation_numbers_are_expanded() -> None:
    assert numbers("(3.5–3.11, 4.12)") == {
        "3.5", "3.6", "3.7", "3.8", "3.9", "3.10", "3.11", "4.12",
    }  # fmt: skip
    assert numbers("(4.11) to (4.13)") == {"4.11", "4.12", "4.13"}
    assert numbers("1.3.4, 13.2, (5.1), 293.15") == set()


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("*.py")}


def test_a_mutated_equation_fails_its_test_and_the_original_passes() -> None:
    """Three runs of a test in plain Python, each a process of its own."""
    before = bytes_of(ROOT / "plant/liftgate_plant")
    with copied() as folder:
        assert survived(folder, ONE) == ""
        assert bytes_of(folder / "plant/liftgate_plant") == before
        same = ONE._replace(mutant=ONE.text)
        assert survived(folder, same) == "its test passes"
        spoilt = same._replace(mutant="!")
        assert "does not run" in survived(folder, spoilt)
    assert bytes_of(ROOT / "plant/liftgate_plant") == before


def test_the_index_of_equations_is_printed() -> None:
    command = [sys.executable, "-m", "tools.equations"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert all(f"({number})  " in done.stdout for number in NUMBERS)
    wrong = subprocess.run([*command, "--mutate", "3.99"], cwd=ROOT, capture_output=True, check=False)
    assert wrong.returncode == 2
