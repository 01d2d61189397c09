"""The page's list of scenarios: its entries, its limits, and that a slow list delays no other answer."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import orjson
import pytest

from liftgate_hil.dashboard import starting
from liftgate_hil.dashboard.server import Page
from liftgate_hil.dashboard.source import NoSource
from liftgate_hil.dashboard.starting import Scenarios


def write(path: Path, text: str = "duration = 1\n") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


@pytest.fixture
def entries(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A list of the names of all folder entries that are read."""
    real, found = os.scandir, list[str]()

    class Watched:
        def __init__(self, path: Any) -> None:
            self._own = real(path)

        def __enter__(self) -> Watched:
            return self

        def __exit__(self, *_: object) -> None:
            self._own.close()

        def __iter__(self) -> Iterator[Any]:
            for each in self._own:
                found.append(each.name)
                yield each

    monkeypatch.setattr(os, "scandir", Watched)
    return found


def test_scenarios_are_listed_by_path_without_hidden_files(tmp_path: Path) -> None:
    those = ("b.toml", "a.toml", "pack/c.toml", "pack/deep/d.toml")
    for name in (*those, ".venv/no.toml", "pack/.no.toml", "no.txt"):
        write(tmp_path / name)
    (tmp_path / "pack" / "again").symlink_to(tmp_path)  # without end
    (tmp_path / "no.toml").mkdir()
    assert Scenarios(tmp_path).names() == (["a.toml", "b.toml", "pack/c.toml", "pack/deep/d.toml"], True)


def test_a_folder_of_many_files_is_searched_only_in_part_and_the_list_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, entries: list[str]
) -> None:
    monkeypatch.setattr(starting, "_MOST_ENTRIES", 50)
    for k in range(200):
        write(tmp_path / "results" / f"{k}.csv")
    write(tmp_path / "a.toml")
    assert Scenarios(tmp_path).names() == (["a.toml"], False)  # the nearest first
    assert len(entries) <= 51


def test_a_list_with_too_many_files_is_cut_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(starting, "_MOST", 2)
    for k in range(3):
        write(tmp_path / f"{k}.toml")
    names, is_all = Scenarios(tmp_path).names()
    assert (len(names), is_all) == (2, False)
    (tmp_path / "0.toml").unlink()
    assert Scenarios(tmp_path).names() == (["1.toml", "2.toml"], True)


def test_a_description_is_taken_from_the_scenario_before_its_included_files(tmp_path: Path) -> None:
    write(tmp_path / "parts/p.toml", 'description = "of the part"\nrequirement = ["LG-1", "LG-2"]\n')
    write(tmp_path / "a.toml", 'include = ["parts/p.toml"]\nduration = 1\n')
    write(tmp_path / "b.toml", 'include = ["parts/p.toml"]\ndescription = "its  own"\nrequirement = "LG-3"\n')
    write(tmp_path / "wrong.toml", "nonsense")
    listed, is_all = Scenarios(tmp_path).listed()
    a, b, part, wrong = listed
    assert is_all
    assert (a["description"], a["requirement"], a["issue"]) == ("of the part", ["LG-1", "LG-2"], "")
    assert (b["description"], b["requirement"]) == ("its own", ["LG-3"])
    assert part["name"] == "parts/p.toml"
    assert "wrong.toml" in wrong["issue"]
    assert wrong["description"] == ""


def test_a_scenario_is_read_again_only_if_its_file_or_an_included_one_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []
    real = starting.read_scenario
    monkeypatch.setattr(starting, "read_scenario", lambda path: (read.append(path.name), real(path))[1])
    write(tmp_path / "parts/p.toml", 'description = "before"\n')
    write(tmp_path / "a.toml", 'include = ["parts/p.toml"]\n')
    found = Scenarios(tmp_path)
    found.listed()
    assert read == ["a.toml", "p.toml"]
    found.listed()
    assert read == ["a.toml", "p.toml"]
    write(tmp_path / "parts/p.toml", 'description = "afterwards"\n')
    assert [each["description"] for each in found.listed()[0]] == ["afterwards", "afterwards"]


class SlowList:
    """A starter whose list of scenarios is delayed until another request was answered."""

    thread_id = 0

    def __init__(self) -> None:
        self.answered = threading.Event()

    def state(self) -> Any:
        return {"was_answered_meanwhile": self.answered.wait(20)}


def test_a_slow_list_of_scenarios_does_not_delay_other_answers() -> None:
    slow = SlowList()
    page = Page(NoSource(), False, slow)  # type: ignore[arg-type]

    async def go() -> Any:
        listing = asyncio.create_task(page._runs(None))  # type: ignore[arg-type]
        await asyncio.sleep(0)
        await page._about(None)  # type: ignore[arg-type]
        slow.answered.set()
        return await listing

    answer = asyncio.run(go())
    assert orjson.loads(answer.body) == {"was_answered_meanwhile": True}
