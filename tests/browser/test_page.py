"""The operator's page in a real browser: its values are correct and its controls take effect."""

from __future__ import annotations

import re
from typing import Any

import pytest
from browser_support import clear_all, click, errors_in, found, press, set_value, text_of, until
from dashboard_support import Client

from liftgate_hil.signals import COLUMNS


def test_the_page_shows_current_values_and_updates(page: Any) -> None:
    assert len(page.find_elements("css selector", "#plots canvas")) == 4
    first = float(text_of(page, "#time"))
    until(page, lambda _: float(text_of(page, "#time")) > first)
    assert "suv" in text_of(page, "#title")
    assert text_of(page, "#stimuli") == "request open, 0.5 s"
    whole = "charts.charts[1].plot.data.every((each) => each.length === charts.times.length)"
    until(page, lambda _: page.execute_script(f"return charts.times.length > 3 && {whole}"))
    until(page, lambda _: "left direction" in text_of(page, "#command"))
    assert errors_in(page) == []


def test_tables_are_shown_on_request_and_a_chosen_column_is_charted(page: Any) -> None:
    click(page, "#bus-view summary")
    until(page, lambda _: "LeftDrive" in text_of(page, "#messages"))
    click(page, "#values summary")
    until(page, lambda _: "gate_angle_deg" in text_of(page, "#columns"))
    title = found(page, "button[aria-label='chart true gate_angle_deg']").get_attribute("title")
    assert title == COLUMNS["gate_angle_deg"].meaning
    click(page, "button[aria-label='chart true left_winding_temperature_degc']")
    until(page, lambda _: len(page.find_elements("css selector", "#plots canvas")) == 5)
    assert page.execute_script("return charts.low.left_winding_temperature_degc.length === charts.times.length")
    assert errors_in(page) == []


def test_bus_signals_are_shown_with_their_units(page: Any) -> None:
    click(page, "#bus-view summary")
    until(page, lambda _: "TerminalVoltage = " in text_of(page, "#messages"))
    cells = "document.querySelectorAll('#messages td:last-child')"
    signals = page.execute_script(f"return [...{cells}].map((it) => it.innerText)")
    (gate,) = (each for each in signals if "TerminalVoltage" in each)
    assert re.search(r"Angle = -?[\d.]+ deg,", gate)
    assert re.search(r"LatchState = \w+,", gate)  # a label has no unit
    assert re.search(r"TerminalVoltage = [\d.]+ V$", gate)


def test_the_frame_trace_can_be_filtered_paused_and_resumed(page: Any) -> None:
    names = "return [...document.querySelectorAll('#trace tbody tr')].map((it) => it.cells[2].innerText)"
    newest = "return +document.querySelector('#trace tbody tr').cells[0].innerText"
    assert page.execute_script("return trace.frames.length") == 0  # nobody asks while it is closed
    click(page, "#trace-view summary")
    until(page, lambda _: {"LeftDrive", "Gate", "DriveCommand"} <= set(page.execute_script(names)))
    set_value(page, "#trace-filter", "GateAcceleration")  # a signal
    until(page, lambda _: set(page.execute_script(names)) == {"Sensors"})
    set_value(page, "#trace-filter", "gate SENT")  # a message, which is no part of a signal's name
    until(page, lambda _: set(page.execute_script(names)) == {"Gate"})
    set_value(page, "#trace-filter", "LATCHSTATE sent")
    until(page, lambda _: set(page.execute_script(names)) == {"Gate"})
    click(page, "#trace-hold")
    held = page.execute_script(newest)
    count = page.execute_script("return trace.frames.length")
    set_value(page, "#trace-filter", "TerminalVoltage")  # what is held can be filtered anew
    until(page, lambda _: set(page.execute_script(names)) == {"Gate"})
    time_s = float(text_of(page, "#time"))
    until(page, lambda _: float(text_of(page, "#time")) > time_s + 1.0)
    assert (page.execute_script(newest), page.execute_script("return trace.frames.length")) == (held, count)
    click(page, "#trace-hold")
    until(page, lambda _: page.execute_script(newest) > held)
    last, first = page.execute_script("return [trace.frames.at(-1).time_s, trace.frames[0].time_s]")
    assert first < held < last
    set_value(page, "#trace-filter", "no such frame")
    until(page, lambda _: page.execute_script(names) == [])
    assert text_of(page, "#trace-count").startswith("0 of ")
    assert errors_in(page) == []


def test_a_fault_is_injected_shown_and_cleared(page: Any, address: str) -> None:
    from selenium.webdriver.support.ui import Select

    client = Client(address)
    kinds = Select(found(page, "#fault-kind"))
    groups = page.execute_script(
        "return [...document.querySelectorAll('#fault-kind optgroup')].map((g) => g.label)"
    )
    assert groups[:2] == ["Supply, motors and bridges", "Hall sensors"]
    kinds.select_by_visible_text("Spring weak")
    assert text_of(page, "#fault-meaning") == "The drive's spring has less force."
    Select(found(page, "#fault-keys select")).select_by_visible_text("right")
    set_value(page, "#fault-keys input", "0.5")
    click(page, "#fault button")
    until(page, lambda _: "fault injected: Spring weak, right, factor 0.5" in text_of(page, "#answer"))
    until(page, lambda _: "Spring weak, right, factor 0.5" in text_of(page, "#fault-on"))
    until(page, lambda _: text_of(page, "#health").startswith("1 injected fault"))
    force = client.ask("/api/state")[1]["in_force"]
    assert force["faults"] == [{"kind": "spring_weak", "where": "right", "factor": 0.5}]
    click(page, "#fault-on button")
    until(page, lambda _: not text_of(page, "#fault-on"))
    assert client.ask("/api/state")[1]["in_force"]["faults"] == []
    assert errors_in(page) == []


def test_a_signal_of_the_restbus_is_set_by_value_and_by_label(page: Any) -> None:
    click(page, "#bus-view summary")
    for name, value in (("Body.VehicleSpeed", "12.5"), ("Body.Ignition", "on")):
        set_value(page, "#signal-name", name)
        set_value(page, "#signal-value input", value)
        click(page, "#signal button")
        until(page, lambda _, name=name: f"signal {name}" in text_of(page, "#answer"))
    until(page, lambda _: "VehicleSpeed = 12.5" in text_of(page, "#messages"))
    assert "Ignition = on" in text_of(page, "#messages")
    assert errors_in(page) == []


def test_surroundings_and_driver_controls_have_plain_names_and_take_effect(page: Any, address: str) -> None:
    from selenium.webdriver import Keys

    client = Client(address)
    assert "Supply voltage" in text_of(page, "#set")
    assert "supply_voltage_v" not in found(page, "body").text
    number = found(page, "#set input[inputmode=decimal][aria-label='Road slope']")
    number.clear()
    number.send_keys("8", Keys.ENTER)
    until(page, lambda _: client.ask("/api/state")[1]["in_force"]["set"] == {"road_slope_deg": 8})
    number.send_keys(Keys.CONTROL + "a" + Keys.NULL, "1,5", Keys.ENTER)  # a decimal comma
    until(page, lambda _: client.ask("/api/state")[1]["in_force"]["set"] == {"road_slope_deg": 1.5})
    slider = found(page, "#set input[aria-label='Supply voltage, slider']")
    slider.send_keys(Keys.HOME)
    until(page, lambda _: client.ask("/api/state")[1]["in_force"]["set"].get("supply_voltage_v") == 6.0)
    click(page, "#set button[aria-label='clear Supply voltage']")
    until(page, lambda _: "supply_voltage_v" not in client.ask("/api/state")[1]["in_force"]["set"])
    assert text_of(page, "#switch-handle_pulled") == "Pull handle"
    click(page, "#switch-handle_pulled")
    until(page, lambda _: client.ask("/api/state")[1]["truth"]["handle_pulled"] == 1.0)
    until(page, lambda _: text_of(page, "#switch-handle_pulled") == "Release handle")
    assert text_of(page, "#answer").endswith(" s: outer handle pulled")
    until(page, lambda _: "2 settings" in text_of(page, "#clear"))
    press(page, "stop")
    clear_all(page)
    assert errors_in(page) == []


def test_the_obstacle_form_shows_the_obstacle_in_force(page: Any, address: str) -> None:
    client = Client(address)
    field = "#obstacle input[inputmode=decimal][aria-label='Angle']"
    assert client.command(obstacle={"angle_deg": 41.5})[0] == 200  # by another tab
    until(page, lambda _: found(page, field).get_property("value") == "41.5")
    clear_all(page)
    assert text_of(page, "#gauge-text .limit") == "vehicle's limit 100 N"  # the scenario states none
    assert errors_in(page) == []


def test_states_arriving_faster_than_drawn_are_drawn_once_and_lose_no_log_line(page: Any) -> None:
    drawn, events = page.execute_async_script("""
        const done = arguments[0], ours = show;
        let drawn = 0;
        window.show = (state) => {
          drawn += (state.log ?? []).some(([, , line]) => line.includes("burst"));
          ours(state);
        };
        for (let k = 0; k < 100; k += 1)
          wire.onmessage({ data: JSON.stringify({ ...last, log: [[1e9 + k, 0, `ecu burst ${k}`]] }) });
        const whenShown = () => {  // the gate may stand, and the next drawing be due in STILL_MS
          if (!drawn || unshown) return requestAnimationFrame(whenShown);
          window.show = ours;
          done([drawn, find("events").textContent]);
        };
        requestAnimationFrame(whenShown);
    """)
    assert drawn == 1
    assert all(f"burst {k}" in events for k in range(100))
    assert errors_in(page) == []


def test_an_alarm_is_shown_at_the_top_and_not_again_once_closed(page: Any) -> None:
    alarms = [[1, 0.0, "of before"], [10**9, 1e10, "9.000 s: can0 is bus-off"]]
    page.execute_script("showAlarms(arguments[0])", alarms)
    assert text_of(page, "#answer") == "9.000 s: can0 is bus-off"
    assert found(page, "#answer").get_attribute("class") == "bad"
    page.execute_script("answer('', false); showAlarms(arguments[0])", alarms)
    assert text_of(page, "#answer") == ""


def test_a_refused_command_is_reported_with_the_allowed_values(page: Any) -> None:
    box = found(page, "#signal-name")
    box.clear()
    box.send_keys("Body.VehicleSpeed")
    field = found(page, "#signal-value input")
    field.clear()
    field.send_keys("1e9")
    click(page, "#signal button")
    until(page, lambda _: "Body.VehicleSpeed 1e9: allowed: 0 to" in text_of(page, "#answer"))
    assert "bad" in found(page, "#answer").get_attribute("class")
    box.clear()
    box.send_keys("Gate.Angle")
    click(page, "#signal button")
    offered = page.execute_script("return [...find('signal-names').children].map((it) => it.value)")
    until(page, lambda _: "Gate.Angle: not one that can be set" in text_of(page, "#answer"))
    assert text_of(page, "#answer").endswith(f"allowed: {', '.join(offered)}")
    assert errors_in(page) == []
    set_value(page, "#record-name", "../x.csv")
    click(page, "#record-button")
    until(page, lambda _: "allowed: a file name, without a folder" in text_of(page, "#answer"))
    assert all(" 422 " in each for each in errors_in(page))


def test_a_malformed_or_out_of_range_number_typed_into_a_field_is_refused(page: Any, address: str) -> None:
    from selenium.webdriver import Keys
    from selenium.webdriver.support.ui import Select

    def in_force() -> Any:
        return Client(address).ask("/api/state")[1]["in_force"]

    slope = found(page, "#set input[inputmode=decimal][aria-label='Road slope']")
    for wrong in ("0x10", "8 deg", "1.2.3", "80"):
        slope.send_keys(Keys.CONTROL + "a" + Keys.NULL, wrong, Keys.ENTER)
        until(
            page, lambda _, wrong=wrong: f"Road slope {wrong}: allowed: -45 to 45 deg" in text_of(page, "#answer")
        )
        assert slope.get_attribute("aria-invalid") == "true"
    Select(found(page, "#fault-kind")).select_by_visible_text("Babbling")
    assert "CAN identifier (hex)" in text_of(page, "#fault-keys")
    set_value(page, "#fault-keys input[name=id]", "6G4")
    click(page, "#fault button")
    until(page, lambda _: "6G4: allowed: a hexadecimal number, 0 to 1FFFFFFF" in text_of(page, "#answer"))
    assert (in_force()["set"], in_force()["faults"]) == ({}, [])
    set_value(page, "#fault-keys input[name=id]", "0x6E4")
    click(page, "#fault button")
    until(page, lambda _: "CAN identifier (hex) 6E4" in text_of(page, "#fault-on"))
    assert [each["id"] for each in in_force()["faults"]] == [0x6E4]
    clear_all(page)
    assert errors_in(page) == []


def test_a_message_is_closed_by_its_button_and_by_escape(page: Any) -> None:
    from selenium.webdriver import ActionChains, Keys

    page.execute_script("answer('refused', true)")
    click(page, "#close-answer")
    assert not found(page, "#toast").is_displayed()
    page.execute_script("answer('refused', true)")
    ActionChains(page).send_keys(Keys.ESCAPE).perform()
    until(page, lambda _: not found(page, "#toast").is_displayed())
    page.execute_script("answer('refused', true); answer('done', false)")
    assert text_of(page, "#answer") == "done"


def test_charts_show_the_same_current_values_as_the_header(page: Any) -> None:
    shown = """
        const [angle] = document.querySelectorAll('#plots .panel button > span');
        return [+angle.textContent, +find('angle').textContent, +last.truth.gate_angle_deg.toFixed(2)];
    """
    for _ in range(5):
        legend, header, truth = page.execute_script(shown)
        assert legend == pytest.approx(truth, abs=0.0051)
        assert header == truth


def test_zooming_to_a_peak_before_the_charts_begin_states_its_value_and_time(page: Any) -> None:
    until(page, lambda _: page.execute_script("return charts.times.length > 20"))
    said, when = page.execute_script(
        "const when = charts.times[0] - 2.5; zoomToPeak({ pinch_peak_n: 98.4, pinch_peak_s: when });"
        "return [find('end-peak').textContent, when]"
    )
    told = re.match(r"The largest pinch force, 98 N, was at (-?[\d.]+) s; ", said)
    assert told is not None
    assert float(told[1]) == pytest.approx(when, abs=0.06)
    assert page.execute_script("return find('window').selectedOptions[0].text") == "zoomed"
    assert page.execute_script("return charts.range[0] === charts.times[0]")
    click(page, "#hold")
    assert page.execute_script("return find('window').value") == "20"
    page.execute_script("zoomToPeak({ pinch_peak_n: null, pinch_peak_s: null }); hold(false)")
    assert page.execute_script("return find('end-peak').textContent") == ""


def test_markup_in_log_lines_messages_commands_and_verdicts_is_escaped(page: Any) -> None:
    page.execute_script(
        "showLog([[1e9, 0, 'ecu <img src=x onerror=document.title=1>']]);"
        "showMessages([{id: '1', name: '<b>x</b>', direction: 'sent', count: 1, cycle_ms: 1, data: '', "
        "signals: {'<i>': '<i>'}}]); showCommand({'<u>': {value: '<u>', unit: ''}});"
        "showVerdicts([{name: '<s>', verdict: 'pass', margin_text: '<s>', times_text: '<s>', reason: '<s>'}])"
    )
    assert not page.find_elements("css selector", "#log img, #events img, #messages b, #messages i, u, s")
    assert "liftgate-hil" in page.title


def test_zooming_one_chart_gives_all_charts_the_identical_range(page: Any) -> None:
    until(page, lambda _: page.execute_script("return charts.times.length > 60"))
    from selenium.webdriver import ActionChains

    over = page.find_elements("css selector", "#plots .u-over")[1]
    width = over.size["width"]
    actions = ActionChains(page, duration=20).move_to_element_with_offset(over, -width // 5, 0).click_and_hold()
    actions.move_by_offset(width // 10, 3).release().perform()
    ranges = "return charts.charts.map(({ plot }) => [plot.scales.x.min, plot.scales.x.max])"
    until(page, lambda _: text_of(page, "#hold") == "Resume charts")
    first, *others = page.execute_script(ranges)
    assert others == [first] * 3
    lefts = page.execute_script("return charts.charts.map(({ plot }) => [plot.bbox.left, plot.bbox.width])")
    assert lefts == [lefts[0]] * 4
    ActionChains(page).move_to_element_with_offset(over, 20, 0).perform()
    at = "return charts.charts.map(({ plot }) => [plot.cursor.idx, plot.cursor.left])"
    until(page, lambda _: page.execute_script("return charts.charts[0].plot.cursor.idx !== null"))
    pointed = page.execute_script(at)
    assert [row for row, _ in pointed] == [pointed[0][0]] * 4
    assert [left for _, left in pointed] == pytest.approx([pointed[0][1]] * 4)
    click(page, "#zoom-in")
    narrower = page.execute_script(ranges)
    assert narrower == [narrower[0]] * 4
    assert narrower[0][1] - narrower[0][0] == pytest.approx((first[1] - first[0]) / 2)
    click(page, "#hold")
    until(page, lambda _: page.execute_script(ranges)[0] != narrower[0])
    assert errors_in(page) == []


def test_a_sensor_fault_shows_in_the_chart_of_its_signal_only(page: Any) -> None:
    """An offset of the left current sensor separates only its curve from the truth."""
    from selenium.webdriver.support.ui import Select

    names = "['gate_angle_deg', 'left_current_a', 'right_current_a', 'terminal_voltage_v']"
    apart = f"return {names}.map((n) => Math.abs(last.truth[n] - last.sensed[n]))"
    before = page.execute_script(apart)
    Select(found(page, "#fault-kind")).select_by_visible_text("Current offset")
    Select(found(page, "#fault-keys select")).select_by_visible_text("left")
    set_value(page, "#fault-keys input", "5")
    click(page, "#fault button")
    until(page, lambda _: page.execute_script(apart)[1] > 4.0)
    angle, left, right, voltage = page.execute_script(apart)
    assert left == pytest.approx(5.0, abs=1.0)
    assert max(angle, right, voltage) < 1.0
    assert before[1] < 1.0
    drawn = "return charts.high.sensed_left_current_a.at(-1) - charts.low.left_current_a.at(-1)"
    until(page, lambda _: page.execute_script(drawn) > 4.0)
    panels = page.execute_script("return charts.charts.map(({ names }) => names.join().includes('sensed_left'))")
    assert panels == [False, True, False, False]
    clear_all(page)


def test_a_value_set_in_a_second_tab_is_in_force_and_shown_in_the_first(page: Any, address: str) -> None:
    first = page.current_window_handle
    page.switch_to.new_window("tab")
    try:
        page.get(address)
        until(page, lambda _: found(page, "body").get_attribute("data-ready"))
        number = found(page, "#set input[inputmode=decimal][aria-label='Snow mass']")
        number.clear()
        number.send_keys("7\n")
        until(page, lambda _: page.execute_script("return last.in_force.set.snow_mass_kg === 7"))
        page.switch_to.window(first)
        until(page, lambda _: page.execute_script("return last.in_force.set.snow_mass_kg === 7"))
        box = found(page, "#set input[inputmode=decimal][aria-label='Snow mass']")
        until(page, lambda _: box.get_attribute("value") == "7")
        clear_all(page)
    finally:
        page.switch_to.window(next(each for each in page.window_handles if each != first))
        page.close()
        page.switch_to.window(first)
