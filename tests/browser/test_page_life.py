"""The page as runs end and begin, with recordings, without a mouse, and over a minute."""

from __future__ import annotations

import re
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from browser_support import GOING, OPENS, click, errors_in, found, opened, text_of, until
from dashboard_support import bench, bench_with_page, page_beside, page_of, process

import liftgate_hil as lh

ECU = ("--ecu", "reference")
FAILED = ("ended: fail", "ended: inconclusive")  # a busy machine cannot tell
PASSED = ("ended: pass", "ended: inconclusive")
# Numbers all that takes the focus and is shown, and returns how many there are.
NUMBERED = """
const all = [...document.querySelectorAll('button, input, select, summary, [tabindex="0"]')];
const shown = all.filter((each) => each.checkVisibility({ visibilityProperty: true }) && !each.disabled);
shown.forEach((each, k) => { each.dataset.place = k; });
document.activeElement.blur();
return shown.length;
"""
# An ECU that takes seconds for each step after the first ones.
SLOW = """
import time

class Ecu:
    def step(self, now_s, frames):
        time.sleep(3.0 if now_s > 0.2 else 0.0)
        return []
"""
# A hand pulls the open gate onto a rod and lifts it, whatever the ECU does; the expectation fails.
TRAP = """duration = 5.0
initial = "open"
description = "pulled onto a rod"
[[profile]]
quantity = "hand_force_n"
points = [[0.5, 0], [1.0, -250], [1.5, -250], [1.6, 250], [2.5, 250], [2.6, 0]]
[[obstacle]]
angle_deg = 78
[[expect]]
name = "presses little"
always = "pinch_force_n < $limit"
[parameters]
limit = 5
"""
AXE = Path(__file__).parent / "vendor" / "axe.min.js"


def test_a_separate_page_shows_the_end_of_a_run_and_the_next_runs_verdict(browser: Any, tmp_path: Path) -> None:
    passes = 'duration = 2.0\n[[expect]]\nname = "stays shut"\nalways = "gate_angle_deg < 5"\n'
    (tmp_path / "s.toml").write_text(passes, encoding="utf-8")
    with bench(tmp_path, "next", *ECU) as first, page_beside(first, tmp_path) as client:
        opened(browser, client.address)
        first.terminate()
        assert first.wait(30) == 0
        until(browser, lambda _: text_of(browser, "#phase") == "ended")
        assert re.fullmatch(r"Stopped at [\d.]+ s\.", text_of(browser, "#end-reason"))
        assert not found(browser, "#clear").is_enabled()
        with bench(tmp_path, "next", *ECU, "--scenario", "s.toml") as second:
            until(browser, lambda _: "· s · next" in browser.title)
            until(browser, lambda _: text_of(browser, "#phase") in PASSED)
            assert "stays shut" in text_of(browser, "#verdicts")
            assert second.wait(30) == 0
        assert errors_in(browser) == []
        client.child.kill()
        until(browser, lambda _: text_of(browser, "#end-next").startswith("No connection"))
    assert errors_in(browser) == []


def test_the_page_served_by_a_run_keeps_its_verdict_until_the_next_run_serves_it(
    browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run of 8 s, in real time: the server ends with it, and the page waits, without errors in the console."""
    monkeypatch.setenv("LIFTGATE_HIL_TOKEN", "a-token-that-stays-the-same")
    fails = 'duration = 8.0\n[[expect]]\nname = "opens"\neventually = "gate_angle_deg > 70"\n'
    (tmp_path / "fails.toml").write_text(fails, encoding="utf-8")
    with bench_with_page(tmp_path, "own", *ECU, "--scenario", "fails.toml") as client:
        browser.get(client.address)
        until(browser, lambda _: text_of(browser, "#phase") in FAILED)
        assert "opens: " in text_of(browser, "#end-reason")
        assert client.child.wait(30) == 0
    time.sleep(2.5)
    assert text_of(browser, "#phase") in FAILED
    with bench_with_page(tmp_path, "own", *ECU, listen=client.host):
        until(browser, lambda _: text_of(browser, "#phase") in GOING)
    assert errors_in(browser) == []


def test_a_run_without_ticks_is_shown_stalled_and_not_late(browser: Any, tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW, encoding="utf-8")
    still = ("--bus", "virtual:still", "--clock", "lockstep", "--ecu", "slow:Ecu")
    with process(*still, folder=tmp_path) as run, page_beside(run, tmp_path) as client:
        opened(browser, client.address, ("stalled",))
        assert "Run not advancing" in text_of(browser, "#health")
        browser.execute_script("command({ set: { road_slope_deg: 1 } })")
        until(browser, lambda _: "takes effect when it goes on" in text_of(browser, "#answer"))
        assert errors_in(browser) == []


def test_a_stalled_server_is_reported_and_so_is_its_return(browser: Any, tmp_path: Path) -> None:
    with bench(tmp_path, "frozen", *ECU) as run, page_beside(run, tmp_path) as client:
        opened(browser, client.address)
        client.child.send_signal(signal.SIGSTOP)
        try:
            until(browser, lambda _: text_of(browser, "#phase").startswith("no data"))
            assert found(browser, "#commands").get_property("disabled")
        finally:
            client.child.send_signal(signal.SIGCONT)
        until(browser, lambda _: text_of(browser, "#phase") in GOING)
        assert not found(browser, "#commands").get_property("disabled")
        assert errors_in(browser) == []


def test_a_recordings_page_shows_the_pinch_and_plays_the_motion(browser: Any, tmp_path: Path) -> None:
    result = lh.run("demo", record=tmp_path / "run.mf4")
    with page_of(tmp_path, "--recording", "run.mf4") as client:
        opened(browser, client.address, ("recording",))
        peak = result.maxima["pinch_force_n"]
        assert float(text_of(browser, "#pinch")) == pytest.approx(peak, abs=0.1)
        assert float(text_of(browser, "#time")) == pytest.approx(result.pinch_time_s, abs=0.01)
        drawn = "return Math.max(...charts.high.pinch_force_n)"
        assert browser.execute_script(drawn) == pytest.approx(peak, rel=1e-9)
        assert f"pinch {peak:.0f} N" in text_of(browser, "#drawing")  # the vehicle is in the file
        assert browser.execute_script("return last.acting.obstacle.angle_deg") == pytest.approx(35.0, abs=0.5)
        assert browser.execute_script("return document.querySelectorAll('circle.given').length") == 1
        click(browser, "#contacts button")
        until(browser, lambda _: browser.execute_script("return charts.range[1] - charts.range[0] < 3"))
        until(browser, lambda _: browser.execute_script(f"{drawn} && charts.times.length > 200"))
        steps = "return charts.times[10] - charts.times[9] < 0.0025"
        until(browser, lambda _: browser.execute_script(steps))  # every row, or every other
        assert browser.execute_script(drawn) == pytest.approx(peak, rel=1e-9)
        assert not found(browser, "#commands").is_displayed()
        click(browser, "#whole")
        browser.execute_script("return seek(about.end_s - 0.5)")
        click(browser, "#play")
        until(browser, lambda _: text_of(browser, "#play") == "Play")
        assert float(text_of(browser, "#time")) == pytest.approx(42.0, abs=0.01)
        assert errors_in(browser) == []
        client.child.kill()
        client.child.wait()
        browser.execute_script("seek(about.begin_s)")
        until(browser, lambda _: text_of(browser, "#phase") == "no connection")
        assert all("CONNECTION_REFUSED" in each for each in errors_in(browser))


def test_a_recordings_page_states_a_peak_before_it_and_marks_unknown_values(browser: Any, tmp_path: Path) -> None:
    """The rows hold missed ticks, a pinch peak before they begin, and `fault.injected`, which names no fault."""
    columns = "time_s,gate_angle_deg,pinch_force_n,pinch_force_peak_n,ticks_missed,fault.injected"
    rows = "".join(f"{5 + 0.01 * k!r},30,0,90,{870 + k // 50},1\n" for k in range(150))
    (tmp_path / "run.csv").write_text(f"{columns}\n{rows}", encoding="utf-8")
    with page_of(tmp_path, "--recording", "run.csv", "--vehicle", "suv") as client:
        opened(browser, client.address, ("recording",))
        assert text_of(browser, "#contacts") == "No contact in this recording."
        assert "last peak 90 N, before the recording" in text_of(browser, "header")
        assert "last peak 90 N, before the recording" in text_of(browser, "#gauge")
        assert text_of(browser, "#health") == ""
        browser.execute_script("return seek(about.end_s)")
        until(browser, lambda _: text_of(browser, "#health") == "2 ticks missed")
        drawn = text_of(browser, "#drawing")
        assert all(f"{each} –" in drawn for each in ("left spring", "right spring", "left drive", "hand"))
        assert all(each in drawn for each in ("pinch 0 N", "latch –"))
        assert errors_in(browser) == []


def test_the_page_of_a_bus_log_shows_its_signals_and_names_missing_ones(browser: Any, tmp_path: Path) -> None:
    lh.run("demo", duration=1.0, record=tmp_path / "run.blf")
    bus_log = ("--recording", "run.blf", "--vehicle", "suv", "--rig")
    buttons = "return [...document.querySelectorAll('#plots .panel button')]"
    with page_of(tmp_path, *bus_log, "liftgate") as client:
        opened(browser, client.address, ("recording",))
        assert text_of(browser, "#contacts") == "The recording holds no pinch force."
        said = browser.execute_script(f"{buttons}.map((each) => each.innerText)")
        assert any(each.startswith("Gate.Angle") for each in said), said
        assert not any("true" in each for each in said)
        browser.execute_script("return seek(0.5)")
        until(browser, lambda _: found(browser, "#drawing").is_displayed())
        assert not found(browser, "#not-drawn").is_displayed()
        assert errors_in(browser) == []
    database = str(lh.load_rig("liftgate").database)
    with page_of(tmp_path, *bus_log, database) as client:
        opened(browser, client.address, ("recording",))
        assert not found(browser, "#drawing").is_displayed()
        assert "the recording holds no gate_angle_deg" in text_of(browser, "#not-drawn")
        assert not found(browser, "#scene-help").is_displayed()
        assert errors_in(browser) == []


def test_a_recording_without_a_vehicle_has_full_width_charts(browser: Any, tmp_path: Path) -> None:
    rows = "".join(f"{0.01 * k!r},{k % 7}\n" for k in range(200))
    (tmp_path / "run.csv").write_text(f"time_s,left_current_a\n{rows}", encoding="utf-8")
    widths = "return ['#charts', 'main'].map((each) => document.querySelector(each).clientWidth)"
    with page_of(tmp_path, "--recording", "run.csv") as client:
        opened(browser, client.address, ("recording",))
        assert not found(browser, "#scene").is_displayed()
        assert "The gate is drawn if --vehicle names its vehicle." in text_of(browser, "#contacts")
        charts, whole = browser.execute_script(widths)
        assert charts > 0.9 * whole
        assert errors_in(browser) == []


def test_scenarios_are_selected_started_and_stopped_on_the_page(browser: Any, tmp_path: Path) -> None:
    about = 'description = "the gate opens"\nrequirement = ["LG-1"]\n'
    (tmp_path / "opens.toml").write_text(about + OPENS, encoding="utf-8")
    with page_of(tmp_path, "--scenarios", ".") as client:
        opened(browser, client.address, ("no run",))
        until(browser, lambda _: text_of(browser, ".scenario").split("\n") == ["opens", "LG-1", "the gate opens"])
        browser.execute_script("find('scenario-filter').value = 'none'; filterScenarios()")
        assert text_of(browser, "#scenario-none") == "No scenario matches."
        assert not found(browser, "#start-run").is_enabled()
        browser.execute_script("find('scenario-filter').value = 'lg-1 gate'; filterScenarios()")
        assert not found(browser, "#scenario-none").is_displayed()
        click(browser, "#start button")
        until(browser, lambda _: text_of(browser, "#phase") in GOING)
        until(browser, lambda _: found(browser, "#stop-run").is_enabled())
        click(browser, "#stop-run")
        until(browser, lambda _: text_of(browser, "#phase") == "ended")
        assert errors_in(browser) == []


def test_the_end_of_a_run_zooms_to_the_pinch_peak_and_states_its_reason_once(browser: Any, tmp_path: Path) -> None:
    """A run of 5 s, in real time."""
    (tmp_path / "traps").mkdir()
    (tmp_path / "traps" / "rod.toml").write_text(TRAP, encoding="utf-8")
    (tmp_path / "opens.toml").write_text(OPENS, encoding="utf-8")
    groups = "return [...document.querySelectorAll('#scenario-list legend')].map((it) => it.innerText)"
    with page_of(tmp_path, "--scenarios", ".") as client:
        opened(browser, client.address, ("no run",))
        until(browser, lambda _: browser.execute_script(groups) == ["this folder", "traps/"])
        click(browser, ".scenario input[value='traps/rod.toml']")
        click(browser, "#start button")
        until(browser, lambda _: text_of(browser, "#phase") in GOING)
        assert text_of(browser, "#gauge-text .limit") == "limit 5 N"
        assert "always pinch_force_n < 5" in text_of(browser, "#verdicts")
        until(browser, lambda _: text_of(browser, "#phase") in FAILED)
        low, high = browser.execute_script("return charts.range")
        force = browser.execute_script("return charts.high.pinch_force_n")
        times = browser.execute_script("return charts.times")
        peak = times[force.index(max(force))]
        assert times[0] <= low < peak < high <= times[-1]
        shown = "around(charts.largestContact()).map((time) => within(time, charts.times[0], charts.times.at(-1)))"
        assert browser.execute_script(f"return {shown}") == [low, high]
        assert browser.execute_script("return charts.now") == peak
        (reason,) = text_of(browser, "#end-reason").splitlines()
        assert browser.execute_script("return document.body.innerText").count(reason) == 1
        verdict = text_of(browser, "#phase").removeprefix("ended: ")
        until(browser, lambda _: text_of(browser, "label[title='traps/rod.toml'] .badge") == verdict)
        assert errors_in(browser) == []


def test_the_page_of_an_ended_run_shows_a_recording_served_next_at_its_address(
    browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For example a demo repeated on the free clock: same address, same token."""
    monkeypatch.setenv("LIFTGATE_HIL_TOKEN", "a-token-that-stays-the-same")
    with bench_with_page(tmp_path, "own", *ECU) as client:
        opened(browser, client.address)
        client.child.terminate()
        assert client.child.wait(30) == 0
    until(browser, lambda _: "With LIFTGATE_HIL_TOKEN set" in text_of(browser, "#end-next"))
    lh.run("demo", duration=1.0, record=tmp_path / "run.mf4")
    with page_of(tmp_path, "--recording", "run.mf4", listen=client.host):
        until(browser, lambda _: text_of(browser, "#phase") == "recording")
        assert "run.mf4" in browser.title
        assert errors_in(browser) == []


def test_every_control_is_reachable_by_tab_and_shows_that_it_has_the_focus(page: Any) -> None:
    """Tab goes through every control that is shown, and each shows that it has the focus."""
    from selenium.webdriver import ActionChains, Keys

    wanted = page.execute_script(NUMBERED)
    assert wanted > 60
    reached = set()
    for _ in range(wanted + 20):
        ActionChains(page, duration=0).send_keys(Keys.TAB).perform()
        place, outline = page.execute_script(
            "const it = document.activeElement; return [it.dataset.place, getComputedStyle(it).outlineStyle]"
        )
        if place is not None:
            reached.add(int(place))
            assert outline != "none"
    assert reached == set(range(wanted))


@pytest.mark.parametrize("width", [1500, 420])
def test_axe_finds_no_accessibility_violation_in_a_wide_or_narrow_window(page: Any, width: int) -> None:
    for each in ("#bus-view", "#trace-view", "#values"):
        click(page, f"{each} summary")
    page.set_window_size(width, 1400)
    try:
        axe = AXE.read_text(encoding="utf-8") + "; axe.run(document).then((found) => arguments[0]([found]))"
        (said,) = until(page, lambda _: page.execute_async_script(axe))
    finally:
        page.set_window_size(1500, 1400)
    assert [(each["id"], [node["target"] for node in each["nodes"]]) for each in said["violations"]] == []


def test_a_page_open_for_20_s_logs_no_error_in_the_console(page: Any) -> None:
    begin = float(text_of(page, "#time"))
    page.set_window_size(600, 500)  # without a graphics card, drawing costs by the pixel
    try:
        time.sleep(20)
    finally:
        page.set_window_size(1500, 1400)
    assert float(text_of(page, "#time")) > begin + 10
    assert errors_in(page) == []
