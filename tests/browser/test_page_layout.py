"""Layout of the page: on a bench's screen the gate is beside its charts, on a phone before them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from browser_support import click, errors_in, found, opened, until, window
from dashboard_support import page_of

import liftgate_hil as lh

BENCH, PHONE = (1500, 1000), (390, 844)
BOX = "const box = (it) => it.getBoundingClientRect();"
# What leaves the window on a side, or is cut by what it is in.
CUT = """
const cut = [];
for (const it of document.querySelectorAll('header *, main *')) {
  if (it.closest('svg, .wide, .lines, .hidden, #scenario-list') || !it.checkVisibility()) continue;
  const { left, right } = it.getBoundingClientRect();
  if (left < -1 || right > innerWidth + 1) cut.push(it.outerHTML.slice(0, 120));
}
return cut;
"""


def test_on_a_bench_screen_the_gate_is_beside_its_charts_and_all_are_visible(page: Any) -> None:
    with window(page, *BENCH):
        ends = f"{BOX} return [...document.querySelectorAll('#plots > div')].map((it) => box(it).bottom)"
        until(page, lambda _: max(page.execute_script(ends)) < BENCH[1])
        charts, scene, controls = (found(page, each).rect for each in ("#charts", "#scene", "#controls"))
        assert charts["y"] == scene["y"] == controls["y"]
        assert charts["x"] + charts["width"] <= scene["x"]
        assert scene["x"] + scene["width"] <= controls["x"]
        drawing = found(page, "#drawing").rect
        assert drawing["width"] > 400
        assert drawing["y"] + drawing["height"] < BENCH[1]
        heights = page.execute_script("return charts.charts.map(({ plot }) => plot.height)")
        assert min(heights) > 100
        assert page.execute_script(CUT) == []
    assert errors_in(page) == []


def test_an_added_column_keeps_all_charts_visible(page: Any) -> None:
    with window(page, *BENCH):
        click(page, "#values summary")
        click(page, "button[aria-label='chart true left_winding_temperature_degc']")
        until(page, lambda _: page.execute_script("return charts.charts.length") == 5)
        end = f"{BOX} return box(document.querySelector('#plots')).bottom + scrollY"
        until(page, lambda _: page.execute_script(end) < BENCH[1])


def test_on_a_phone_gate_and_controls_precede_the_charts_and_nothing_is_cut_off(page: Any) -> None:
    with window(page, *PHONE):
        scene, controls, charts = (found(page, each).location["y"] for each in ("#scene", "#controls", "#charts"))
        assert scene < controls < charts
        assert page.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        assert page.execute_script(CUT) == []


@pytest.mark.parametrize("handle", ["rod", "grip"])
def test_on_a_phone_each_handle_has_a_touch_area_of_40_pixels(page: Any, handle: str) -> None:
    """At any gate angle, at the handle's centre and 20 pixels beside it, where another handle may be nearer."""
    touched = f"""{BOX}
        const handle = document.getElementById(arguments[0]), found = [];
        for (const angle of about.geometry.angles_deg) {{
          drawing.angle = angle;
          drawing.handles.show(null, 0, null);
          handle.scrollIntoView({{ block: 'center' }});
          const {{ left, top, width, height }} = box(handle), x = left + width / 2, y = top + height / 2;
          found.push([[0, 0], [20, 0], [-20, 0], [0, 20], [0, -20]].map(
            ([right, down]) => document.elementFromPoint(x + right, y + down)?.closest('[role=slider]')?.id));
        }}
        return found;
    """
    with window(page, *PHONE):

        def is_taken(_: Any) -> bool:
            found = page.execute_script(touched, handle)
            return all(centre == handle and {*beside} <= {"rod", "grip"} for centre, *beside in found)

        until(page, is_taken)


def test_expectations_with_margins_and_reasons_fit_their_card_on_a_phone(page: Any) -> None:
    with window(page, *PHONE):
        page.execute_script("""
            about.expectations = { reverses: 'eventually DriveCommand.LeftDirection == 1' };
            showVerdicts([
              { name: 'reverses', verdict: 'inconclusive', margin_text: '43.64 ± 14 deg/s',
                times_text: 'at 14.218 s, fulfilled at 14.183 s', reason: 'the bench was late: it stalled' }]);
        """)
        assert "fulfilled at 14.183 s" in found(page, "#verdicts").text
        ends = f"{BOX} return ['#verdicts table', '#verdicts'].map((it) => box(document.querySelector(it)).right)"
        table, card = page.execute_script(ends)
        assert table <= card + 1
        assert page.execute_script(CUT) == []


def test_the_obstacles_label_is_not_hidden_by_the_hand(page: Any) -> None:
    """Holds at any gate angle."""
    apart = f"""{BOX}
        return about.geometry.angles_deg.map((angle) => {{
          drawing.angle = angle;
          drawing.handles.show(null, 0, null);
          const [words, hand] = [drawing.handles.rodText, drawing.handles.grip.lastChild].map(box);
          return words.bottom <= hand.top || words.top >= hand.bottom || words.right <= hand.left
            || words.left >= hand.right;
        }});
    """
    with window(page, *PHONE):
        assert all(page.execute_script(apart))


def test_a_control_scrolled_to_on_a_phone_is_not_hidden_by_the_header(page: Any) -> None:
    with window(page, *PHONE):
        tops = f"""{BOX}
            document.getElementById('fault-kind').scrollIntoView();
            return [box(document.querySelector('header')).bottom, box(document.getElementById('fault-kind')).top];
        """
        until(page, lambda _: sorted(ends := page.execute_script(tops)) == ends)


def test_a_recordings_page_shows_all_charts_beside_the_gate(browser: Any, tmp_path: Path) -> None:
    lh.run("demo", duration=2.0, record=tmp_path / "run.mf4")
    with page_of(tmp_path, "--recording", "run.mf4") as client:
        opened(browser, client.address, ("recording",))
        with window(browser, *BENCH):
            end = f"{BOX} return box(document.querySelector('#plots')).bottom"
            until(browser, lambda _: browser.execute_script(end) < BENCH[1])
            charts, scene = found(browser, "#charts").rect, found(browser, "#scene").rect
            assert charts["x"] + charts["width"] <= scene["x"]
            assert charts["y"] == scene["y"]
            assert browser.execute_script(CUT) == []
        assert errors_in(browser) == []
