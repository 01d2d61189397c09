"""Pages of the manual that are written by hand name what is there."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from packaging.requirements import Requirement

from liftgate_hil.config.fault_kinds import FAULT_KINDS
from liftgate_hil.formats.suffixes import FORMATS, TABLES, WITH_FRAMES, WITH_MARKS

ROOT = Path(__file__).parents[2]


def text_of(name: str) -> str:
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def test_every_dependency_has_its_licence_in_the_manual() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [each for extra in project["optional-dependencies"].values() for each in extra]
    needed = {Requirement(each).name for each in [*project["dependencies"], *extras]} - {project["name"]}
    rows = [line.split("|")[1] for line in text_of("licences.md").splitlines() if line.startswith("|")]
    named = {name.strip() for row in rows[2:] for name in row.split(",")} - {"package", "---"}
    assert named == needed


def test_every_test_of_the_tool_qualification_is_there() -> None:
    named = re.findall(r"`(tests/[^`]+)`", text_of("tool-qualification.md"))
    assert len(named) > 20
    assert [each for each in named if not (ROOT / each).is_file()] == []


def test_every_kind_of_fault_is_in_a_group() -> None:
    groups = [line for line in text_of("faults.md").splitlines() if line.startswith("| ")]
    named = [name for line in groups for name in re.findall(r"`(\w+)`", line.split("|")[2])]
    assert sorted(named) == sorted(FAULT_KINDS)


def test_suffixes_that_are_listed_by_hand_are_those_of_the_formats() -> None:
    pages = [path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md")]
    named = [each for text in pages for each in re.findall(r"`((?:\.\w+ )+\.\w+)`", text)]
    assert named
    assert {*named} == {" ".join(WITH_FRAMES)}
    whole = [suffix for suffix, each in FORMATS.items() if each.holds_about]
    for page, words, suffixes in (
        ("plant.md", "`--output` takes", TABLES),
        ("operators-page.md", "recordings that can hold one (", WITH_MARKS),
        ("operators-page.md", "the file names the vehicle (", whole),
        ("reproducibility.md", "(full in", whole),
        ("tests.md", "says of which run it is:", whole),
    ):
        found = re.search(rf"{re.escape(words)}\s*((?:`\.\w+`(?:,| or| and|\s)*)+)", text_of(page))
        assert found, (page, words)
        assert sorted(re.findall(r"`(\.\w+)`", found[1])) == sorted(suffixes), (page, words)


def test_every_message_of_the_troubleshooting_is_one_of_the_program() -> None:
    source = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "hil").rglob("*.py"))
    for message in (
        ", motors off", "is on the bus, but not received by this rig", "; expected ", "timed out: motors off",
        "not in the recording", "another recording is being written to it", "another campaign is running there",
        "an address needs liftgate-hil[cluster]", "the bench was late", "no scenario with [[expect]]",
        "requests without effect", "the gate came to rest at", "the command timed out", "frames cannot be sent",
        "does not follow", "begins in motion at an unknown position",
    ):  # fmt: skip
        assert message in text_of("troubleshooting.md"), message
        assert message in source, message
