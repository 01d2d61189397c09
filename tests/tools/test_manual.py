"""The manual is built without a warning, holds every page, and is also a man page."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from liftgate_hil.cli.main import COMMANDS

DOCS = Path(__file__).parents[2] / "docs"


def sphinx(kind: str, source: Path, folder: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    """Build as `make manual` does."""
    flags = ("-W", "--keep-going", *flags, "-q", "-b", kind, "-d", str(folder / "trees"))
    command = [sys.executable, "-m", "sphinx", *flags, str(source), str(folder / kind)]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=300)


@pytest.fixture(scope="module")
def manual(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folders of both builds of the checkout's pages, which are read once."""
    folder = tmp_path_factory.mktemp("manual")
    for kind, flags in {"html": ("-E",), "man": ()}.items():
        result = sphinx(kind, DOCS, folder, *flags)
        assert result.returncode == 0, result.stderr
    return folder


def test_every_page_is_in_the_manual_and_no_link_leads_nowhere(manual: Path) -> None:
    """All pages are read and written, which takes more than 5 s."""
    contents = (manual / "html" / "index.html").read_text(encoding="utf-8")
    for page in DOCS.glob("*.md"):
        assert f'href="{page.stem}.html"' in contents or page.stem == "index", page
    for path in (manual / "html").glob("*.html"):
        assert "https://fonts." not in path.read_text(encoding="utf-8"), "the manual is read without a network"


def test_flags_keys_and_columns_are_in_the_index_with_their_place(manual: Path) -> None:
    """As keys.toml in genindex.html: a term, and below it the places where it is explained."""
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


def test_a_link_that_leads_nowhere_is_an_error(tmp_path: Path) -> None:
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
