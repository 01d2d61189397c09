"""The operator's page in a real browser: what it shows is so, and what is clicked is done."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from dashboard_support import Client, address_in, process

import liftgate_hil as lh

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
pytestmark = pytest.mark.skipif(CHROMIUM is None or DRIVER is None, reason="no Chromium with its driver")
WAIT_S = 30


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    profile = tmp_path_factory.mktemp("profile")
    for each in (
        "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        "--disable-dev-shm-usage", "--window-size=1500,1400", f"--user-data-dir={profile}",
    ):  # fmt: skip
        options.add_argument(each)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = webdriver.ChromeService(executable_path=str(DRIVER))
    driver = webdriver.Chrome(options=options, service=service)
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("page")
    text = 'duration = 1e6\n[[request]]\ntime = 0.5\naction = "open"\n'
    (found / "s.toml").write_text(text, encoding="utf-8")
    return found


@pytest.fixture(scope="module")
def address(folder: Path) -> Iterator[str]:
    bench = ("--bus", "virtual:page", "--ecu", "reference", "--overrun-limit", "3600")
    with process(*bench, "--scenario", "s.toml", folder=folder) as run:
        arguments = ("--attach", str(run.pid), "--patience", "60", "--listen", "127.0.0.1:0")
        with process("dashboard", *arguments, folder=folder) as child:
            yield address_in(child)


def until(browser: Any, is_so: Any) -> Any:
    from selenium.webdriver.support.ui import WebDriverWait

    return WebDriverWait(browser, WAIT_S, poll_frequency=0.05).until(is_so)


def found(browser: Any, selector: str) -> Any:
    return browser.find_element("css selector", selector)


def text_of(browser: Any, selector: str) -> str:
    return str(found(browser, selector).text)


def errors_in(browser: Any) -> list[str]:
    return [each["message"] for each in browser.get_log("browser") if each["level"] != "INFO"]


@pytest.fixture
def page(browser: Any, address: str) -> Any:
    browser.get(address)
    until(browser, lambda _: text_of(browser, "#state") == "running")
    return browser


def test_the_page_shows_current_values_and_updates(page: Any, address: str) -> None:
    assert len(page.find_elements("css selector", "#plots canvas")) == 4
    first = float(text_of(page, "#time"))
    until(page, lambda _: float(text_of(page, "#time")) > first)
    until(page, lambda _: "LeftDrive" in text_of(page, "#messages"))
    assert "gate_angle_deg" in text_of(page, "#columns")
    assert "suv" in text_of(page, "#title")
    assert text_of(page, "#stimuli") == "request open, 0.5 s"
    whole = "panels[1].plot.data.every((each) => each.length === times.length)"
    drawn = f"return panels[0].plot.data[0].length > 3 && {whole}"
    until(page, lambda _: page.execute_script(drawn))
    assert errors_in(page) == []


def test_a_fault_is_injected_shown_and_cleared(page: Any, address: str) -> None:
    from selenium.webdriver.support.ui import Select

    client = Client(address)
    Select(found(page, "#fault-kind")).select_by_visible_text("spring_weak")
    Select(found(page, "#fault-keys select")).select_by_visible_text("right")
    found(page, "#fault-keys input").send_keys("0.5")
    found(page, "#fault button").click()
    until(page, lambda _: "fault kind spring_weak" in text_of(page, "#answer"))
    until(page, lambda _: "spring_weak right factor 0.5" in text_of(page, "#fault-on"))
    force = client.ask("/api/state")[1]["in_force"]
    assert force["faults"] == [{"kind": "spring_weak", "where": "right", "factor": 0.5}]
    found(page, "#fault-on button").click()
    until(page, lambda _: not text_of(page, "#fault-on"))
    assert client.ask("/api/state")[1]["in_force"]["faults"] == []
    assert errors_in(page) == []


def test_a_signal_of_the_restbus_is_set_by_value_and_by_label(page: Any, address: str) -> None:
    for name, value in (("Body.VehicleSpeed", "12.5"), ("Body.Ignition", "on")):
        box = found(page, "#signal-name")
        box.clear()
        box.send_keys(name)
        field = found(page, "#signal-value input")
        field.clear()
        field.send_keys(value)
        found(page, "#signal button").click()
        until(page, lambda _, name=name: f"signal {name}" in text_of(page, "#answer"))
    until(page, lambda _: "VehicleSpeed = 12.5" in text_of(page, "#messages"))
    assert "Ignition = on" in text_of(page, "#messages")
    assert errors_in(page) == []


def test_obstacle_surroundings_and_driver_are_commanded(page: Any, address: str) -> None:
    from selenium.webdriver.support.ui import Select

    client = Client(address)
    found(page, "#obstacle button").click()
    until(page, lambda _: "obstacle angle_deg 35" in text_of(page, "#answer"))
    Select(found(page, "#set-name")).select_by_visible_text("road_slope_deg")
    found(page, "#set-value input").send_keys("8")
    found(page, "#set button").click()
    until(page, lambda _: "road_slope_deg 8" in text_of(page, "#set-on"))
    page.find_element("xpath", "//div[@id='requests']/button[text()='stop']").click()
    until(page, lambda _: "request stop" in text_of(page, "#answer"))
    state = client.ask("/api/state")[1]
    assert state["in_force"]["obstacle"]["angle_deg"] == 35
    found(page, "#clear").click()
    until(page, lambda _: not text_of(page, "#set-on"))
    assert client.ask("/api/state")[1]["in_force"]["obstacle"] is None
    assert errors_in(page) == []


def test_what_is_refused_is_reported_with_what_is_allowed(page: Any, address: str) -> None:
    box = found(page, "#signal-name")
    box.clear()
    box.send_keys("Body.VehicleSpeed")
    field = found(page, "#signal-value input")
    field.clear()
    field.send_keys("1e9")
    page.execute_script("document.getElementById('signal').noValidate = true")
    found(page, "#signal button").click()
    until(page, lambda _: "allowed: 0 to" in text_of(page, "#answer"))
    assert "bad" in found(page, "#answer").get_attribute("class")
    box.clear()
    box.send_keys("Body.Nothing")
    found(page, "#signal button").click()
    until(page, lambda _: "Body.Nothing" in text_of(page, "#answer"))
    assert all(" 422 " in each for each in errors_in(page))


def test_labels_of_a_database_are_shown_as_text(page: Any) -> None:
    page.execute_script(
        "showLog([[1e9, 0, '<img src=x onerror=document.title=1>']]);"
        "showMessages([{id: '1', name: '<b>x</b>', direction: 'sent', count: 1, cycle_ms: 1, data: '', "
        "signals: {'<i>': '<i>'}}])"
    )
    assert not page.find_elements("css selector", "#log img, #messages b, #messages i")
    assert "liftgate-hil" in page.title


def test_a_recording_is_drawn_whole_and_played(browser: Any, tmp_path: Path) -> None:
    lh.run("demo", duration=3.0, record=tmp_path / "run.csv")
    arguments = ("dashboard", "--recording", "run.csv", "--listen", "127.0.0.1:0")
    with process(*arguments, folder=tmp_path) as child:
        browser.get(address_in(child))
        until(browser, lambda _: text_of(browser, "#state") == "recorded")
        assert float(text_of(browser, "#time")) == pytest.approx(3.0, abs=0.01)
        assert not found(browser, "#commands").is_displayed()
        found(browser, "#play").click()
        until(browser, lambda _: float(text_of(browser, "#time")) < 1.0)
        until(browser, lambda _: text_of(browser, "#play") == "Play")
        assert float(text_of(browser, "#time")) == pytest.approx(3.0, abs=0.01)
        assert errors_in(browser) == []


def test_a_run_that_has_ended_is_reported(browser: Any, tmp_path: Path) -> None:
    with process("--bus", "virtual:end", "--overrun-limit", "3600", folder=tmp_path) as run:
        arguments = ("--attach", str(run.pid), "--patience", "60", "--listen", "127.0.0.1:0")
        with process("dashboard", *arguments, folder=tmp_path) as child:
            browser.get(address_in(child))
            until(browser, lambda _: text_of(browser, "#state") == "running")
            run.terminate()
            assert run.wait(30) == 0
            until(browser, lambda _: text_of(browser, "#state") == "ended")
