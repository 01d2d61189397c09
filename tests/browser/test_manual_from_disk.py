"""The manual opened as files: its search, index and sidebar."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from browser_support import errors_in, until

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("verdicts", "scenario", "tests")


@pytest.fixture(scope="module")
def manual(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three pages of the manual, one of which covers all three topics; links to other pages are broken."""
    folder = tmp_path_factory.mktemp("manual")
    source = folder / "source"
    source.mkdir()
    for name in ("conf.py", "trap-matrix.html", *(f"{each}.md" for each in PAGES)):
        shutil.copy(DOCS / name, source)
    shutil.copytree(DOCS / "extensions", source / "extensions")
    pages = "\n".join(PAGES)
    (source / "group.md").write_text(f"# A group\n\n```{{toctree}}\n{pages}\n```\n")
    (source / "index.md").write_text("# A manual\n\n```{toctree}\ngroup\nIndex <genindex>\n```\n")
    command = [sys.executable, "-m", "sphinx", "-q", "-b", "html", str(source), str(folder / "html")]
    subprocess.run(command, check=True, capture_output=True, timeout=300)
    return folder / "html"


def searched(browser: Any, manual: Path, query: str) -> list[dict[str, str]]:
    """Search results from the top: kind, title, target and excerpt."""
    browser.get(f"{(manual / 'search.html').as_uri()}?q={query}")
    until(browser, lambda _: browser.execute_script("return Search.title.innerText === 'Search Results'"))
    until(browser, lambda _: browser.execute_script(
        "return [...document.querySelectorAll('ul.search li')].every(each => each.querySelector('p.context'))"
    ))  # fmt: skip
    found: list[dict[str, str]] = browser.execute_script(
        "return [...document.querySelectorAll('ul.search li')].map(each => ({kind: each.className, "
        "title: each.querySelector('a').innerText, target: each.querySelector('a').getAttribute('href'), "
        "excerpt: each.querySelector('p.context').innerText}))"
    )
    assert not errors_in(browser)
    return found


def test_searching_the_manual_for_a_verdict_finds_its_explanation(browser: Any, manual: Path) -> None:
    first, *others = searched(browser, manual, "inconclusive")
    assert first["title"] == "What a verdict means"
    assert "Nothing may be concluded about the ECU" in first["excerpt"]
    assert any("inconclusive" in each["excerpt"].lower() for each in others)


def test_search_results_list_titles_first_and_keys_before_text(browser: Any, manual: Path) -> None:
    kinds = [each["kind"] for each in searched(browser, manual, "obstacle")]
    ranks = [("kind-title", "kind-index", "kind-object", "kind-text").index(each) for each in kinds]
    assert ranks == sorted(ranks)
    assert len(set(ranks)) > 1
    page, *others = searched(browser, manual, "verdicts")  # one of several words of a page's title
    assert (page["title"], page["target"]) == ("Tests: scenarios, faults, verdicts", "tests.html")
    assert others
    (key,) = [each for each in searched(browser, manual, "stiffness") if each["kind"] == "kind-index"]
    assert key["target"].startswith("scenario.html#")
    assert "N/m" in key["excerpt"]
    browser.get((manual / key["target"].partition("#")[0]).as_uri())
    row = browser.find_element("id", key["target"].partition("#")[2])
    assert row.text.startswith("stiffness")


def test_keys_and_verdicts_are_in_the_index(browser: Any, manual: Path) -> None:
    browser.get((manual / "genindex.html").as_uri())
    text = browser.find_element("tag name", "body").text.splitlines()
    for term, place in (("stiffness", "[[obstacle]], Scenario files"), ("inconclusive", "What a verdict means")):
        assert place in text[text.index(term) + 1]


def test_groups_of_the_sidebar_unfold_by_a_click_and_the_one_in_use_is_open(browser: Any, manual: Path) -> None:
    browser.get((manual / "index.html").as_uri())
    inside = browser.find_element("css selector", ".sidebar-tree li.has-children > ul")
    assert not inside.is_displayed()
    browser.find_element("css selector", ".sidebar-tree li.has-children > label").click()
    until(browser, lambda _: inside.is_displayed())
    browser.get((manual / "verdicts.html").as_uri())  # the group of the page that is read is open
    assert browser.find_element("css selector", ".sidebar-tree li.has-children > ul").is_displayed()
