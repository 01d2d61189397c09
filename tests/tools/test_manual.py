"""The manual builds without a warning, has every page, is also a man page, and has an index."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from liftgate_hil.cli.main import COMMANDS
from liftgate_hil.config.fault_kinds import FAULT_KINDS
from liftgate_hil.formats.suffixes import FORMATS, TABLES, WITH_FRAMES, WITH_MARKS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def sphinx(kind: str, source: Path, folder: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    """Run a build as `make manual` does."""
    flags = ("-W", "--keep-going", *flags, "-q", "-b", kind, "-d", str(folder / "trees"))
    command = [sys.executable, "-m", "sphinx", *flags, str(source), str(folder / kind)]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=300)


@pytest.fixture(scope="module")
def manual(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders of both builds of the checkout's pages, which are read only once."""
    folder = tmp_path_factory.mktemp("manual")
    for kind, flags in {"html": ("-E",), "man": ()}.items():
        result = sphinx(kind, DOCS, folder, *flags)
        assert result.returncode == 0, result.stderr
    return folder


def test_every_page_is_in_the_manual_and_every_link_resolves(manual: Path) -> None:
    """All pages are read and written, which takes more than 5 s."""
    contents = (manual / "html" / "index.html").read_text(encoding="utf-8")
    for page in DOCS.glob("*.md"):
        assert f'href="{page.stem}.html"' in contents or page.stem == "index", page
    for path in (manual / "html").glob("*.html"):
        assert "https://fonts." not in path.read_text(encoding="utf-8"), "the manual is read without a network"


def test_flags_keys_and_columns_are_in_the_index_with_their_pages(manual: Path) -> None:
    """Such as keys.toml in genindex.html: a term, and below it the pages that explain it."""
    text = re.sub(r"<[^>]+>", "", (manual / "html" / "genindex.html").read_text(encoding="utf-8"))
    for term, place in (
        ("--retry-inconclusive", "test, Command line"),
        ("resistance", "[motor], Vehicle files"),
        ("timing_tolerance_s", "The file, Scenario files"),
        ("gate_angle_deg", "Signals"),
        ("inconclusive", "What a verdict means"),
    ):
        assert re.search(rf"^\s*{re.escape(term)}$(?:\n[^\n]*){{1,40}}{re.escape(place)}", text, re.MULTILINE), (
            term
        )


def test_the_man_page_has_every_subcommand(manual: Path) -> None:
    text = (manual / "man" / "liftgate-hil.1").read_text(encoding="utf-8")
    for name in COMMANDS:
        assert f".SH {name}".lower() in text.lower()


def test_a_broken_link_is_an_error_of_the_build(tmp_path: Path) -> None:
    links = ("nowhere.md", "other.md#nothing-of-this-name")
    given = " ".join(f"[elsewhere]({link})" for link in links)
    source = tmp_path / "source"
    source.mkdir()
    for name in ("conf.py", "trap-matrix.html"):
        shutil.copy(DOCS / name, source)
    shutil.copytree(DOCS / "extensions", source / "extensions")
    (source / "index.md").write_text(f"# A page\n\n{given}\n\n```{{toctree}}\nother\n```\n")
    (source / "other.md").write_text("# Another page\n")
    result = sphinx("html", source, tmp_path)
    assert result.returncode != 0
    for link in links:
        assert link.rpartition("#")[2].removesuffix(".md") in result.stderr


# Pages that are written by hand name what is there.


def text_of(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


def test_the_licences_page_lists_exactly_the_dependencies() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [each for extra in project["optional-dependencies"].values() for each in extra]
    needed = {Requirement(each).name for each in [*project["dependencies"], *extras]} - {project["name"]}
    rows = [line.split("|")[1] for line in text_of("licences.md").splitlines() if line.startswith("|")]
    named = {name.strip() for row in rows[2:] for name in row.split(",")} - {"package", "---"}
    assert named == needed


def test_every_test_named_in_the_tool_qualification_exists() -> None:
    named = re.findall(r"`(tests/[^`]+)`", text_of("tool-qualification.md"))
    assert len(named) > 20
    assert [each for each in named if not (ROOT / each).is_file()] == []


def test_every_kind_of_fault_is_in_a_group_of_the_manual() -> None:
    groups = [line for line in text_of("faults.md").splitlines() if line.startswith("| ")]
    named = [name for line in groups for name in re.findall(r"`(\w+)`", line.split("|")[2])]
    assert sorted(named) == sorted(FAULT_KINDS)


def test_suffixes_listed_in_the_manual_are_those_of_the_formats() -> None:
    pages = [path.read_text(encoding="utf-8") for path in DOCS.glob("*.md")]
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


def test_the_main_messages_of_the_troubleshooting_page_occur_in_the_program() -> None:
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
