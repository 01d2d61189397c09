"""HTML of reports: landmarks, and tables that scroll by keyboard."""

from __future__ import annotations

from liftgate_hil.report.page import Markup, page, section, table


def test_all_of_a_report_is_in_its_main_landmark() -> None:
    found = page("A & B", "today", [section("One", "<p>content</p>"), ""])
    body = found.partition("<body>")[2].partition("</body>")[0].strip()
    assert body.startswith("<main>\n<h1>A &amp; B</h1>")
    assert body.endswith("<p>content</p>\n</main>")


def test_tables_are_reachable_by_keyboard_and_have_column_headers() -> None:
    found = table(("force", ""), [("5 N", Markup("<b>x</b>"))], ("r", ""))
    assert found.startswith('<div class="wide" tabindex="0" role="group" aria-label="table: force">')
    assert '<thead><tr><th class="r">force</th><td></td></tr></thead>' in found
    assert '<tr><td class="r">5 N</td><td><b>x</b></td></tr>' in found
