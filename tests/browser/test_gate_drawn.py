"""The drawn gate moves as the simulated one does, and can be moved by hand."""

from __future__ import annotations

from typing import Any

import pytest
from browser_support import (
    clear_all,
    click,
    drag,
    drawn_angle,
    errors_in,
    found,
    opened,
    press_until,
    text_of,
    until,
    value_of,
)

# From where the obstacle is parked to where the gate's edge meets it at an angle [px].
WAY_OF_THE_ROD = """
const [from, to] = [drawing.handles.rodAt, { angle: arguments[0], distance: 0.95 * about.geometry.length_m }].map(
  ({ angle, distance }) => drawing.at(drawing.onGate(distance, -ROD_M, angle)));
const scale = drawing.svg.getScreenCTM().a;
return from.map((each, k) => Math.round(scale * (to[k] - each)));
"""
pytestmark = pytest.mark.realtime  # the ECU takes a late bench for a drive without feedback


@pytest.fixture
def page(browser: Any, address: str) -> Any:
    """The page with the gate open and not moving."""
    opened(browser, address)
    clear_all(browser)
    if value_of(browser, "gate_angle_deg") < 75.0:
        press_until(browser, "open", lambda: value_of(browser, "gate_angle_deg") > 75.0)
    until(browser, lambda _: abs(value_of(browser, "gate_rate_degps")) < 0.05)
    return browser


def test_the_drawn_gate_follows_the_ecus_motion(page: Any) -> None:
    """The gate closes and opens, in real time."""
    assert drawn_angle(page) == pytest.approx(value_of(page, "gate_angle_deg"), abs=1.0)
    press_until(page, "close", lambda: value_of(page, "gate_angle_deg") < 60.0)
    assert drawn_angle(page) < 65.0
    press_until(page, "close", lambda: value_of(page, "latched") == 1.0)
    until(page, lambda _: "latch closed" in text_of(page, "#drawing"))
    assert drawn_angle(page) == pytest.approx(0.0, abs=1.0)
    press_until(page, "open", lambda: drawn_angle(page) > 20.0)
    assert errors_in(page) == []


def test_pulling_the_drawn_gate_applies_a_hand_force_shown_in_data_and_drawing(page: Any) -> None:
    release = drag(page, "#grip", 0, 80, 0.3)
    until(page, lambda _: value_of(page, "hand_force_n") < -20.0)
    until(page, lambda _: float(found(page, "#grip").get_attribute("aria-valuenow")) < -20.0)
    until(page, lambda _: f"hand {round(value_of(page, 'hand_force_n'))} N" in text_of(page, "#drawing"))
    low = "return Math.min(...charts.low.hand_force_n.slice(-30)) < -20"
    until(page, lambda _: page.execute_script(low))
    release.perform()
    until(page, lambda _: value_of(page, "hand_force_n") == 0.0)
    assert page.execute_script("return 'hand_force_n' in last.in_force.set") is False
    assert errors_in(page) == []


@pytest.mark.parametrize(
    "end", ["drawing.handles.grip.releasePointerCapture(1)", "find('hand').querySelector('.clear').click()"]
)
def test_a_held_hand_force_ends_on_loss_of_the_pointer_or_a_click_on_clear(page: Any, end: str) -> None:
    release = drag(page, "#grip", 0, 80, 0.3)
    until(page, lambda _: value_of(page, "hand_force_n") < -20.0)
    page.execute_script(end)
    until(page, lambda _: value_of(page, "hand_force_n") == 0.0)
    time_s = value_of(page, "time_s")
    until(page, lambda _: value_of(page, "time_s") > time_s + 0.5)  # several times as long as between two commands
    assert value_of(page, "hand_force_n") == 0.0
    assert "held" not in found(page, "#grip").get_attribute("class")
    release.perform()
    assert errors_in(page) == []


def test_a_hand_force_by_keyboard_moves_the_gate(page: Any) -> None:
    """The gate is opened first, in real time."""
    from selenium.webdriver import Keys

    before = value_of(page, "gate_angle_deg")
    found(page, "#grip").send_keys(Keys.PAGE_DOWN, Keys.PAGE_DOWN, Keys.PAGE_DOWN)
    until(page, lambda _: value_of(page, "gate_angle_deg") < before - 1.0)
    until(page, lambda _: value_of(page, "hand_force_n") == -150.0)
    found(page, "#grip").send_keys(Keys.ESCAPE)
    until(page, lambda _: value_of(page, "hand_force_n") == 0.0)


def test_lost_springs_are_drawn_without_force(page: Any) -> None:
    shown = "return ['left_spring', 'right_spring'].map((each) => drawing.arrows[each].path.style.display)"
    until(page, lambda _: page.execute_script(shown) == ["", ""])
    page.execute_script("command({fault: {kind: 'spring_lost'}})")  # without `where`: of both drives
    until(page, lambda _: page.execute_script(shown) == ["none", "none"])
    page.execute_script("command({clear: 'faults'})")
    until(page, lambda _: page.execute_script(shown) == ["", ""])
    assert errors_in(page) == []


def test_a_command_that_timed_out_is_shown_as_timed_out_and_reported(page: Any) -> None:
    assert "timed out" not in text_of(page, "#command")
    page.execute_script("command({fault: {kind: 'frame_lost', where: 'left_duty', direction: 'received'}})")
    until(page, lambda _: "timed out," in text_of(page, "#command"))
    assert "old" in found(page, "#command").get_attribute("class")
    assert "no command of the ECU" in text_of(page, "#health")
    clear_all(page)
    until(page, lambda _: "timed out" not in text_of(page, "#command"))


def test_an_obstacle_placed_with_the_mouse_makes_the_ecu_reverse(page: Any) -> None:
    """The gate closes onto the obstacle, in real time."""
    right, down = page.execute_script(WAY_OF_THE_ROD, 35.0)
    drag(page, "#rod", right, down).perform()
    until(page, lambda _: page.execute_script("return last.in_force.obstacle !== null"))
    rod = page.execute_script("return last.in_force.obstacle")
    assert rod["angle_deg"] == pytest.approx(35.0, abs=1.0)
    assert "parked" not in found(page, "#rod").get_attribute("class")
    press_until(page, "close", lambda: value_of(page, "pinch_force_peak_n") > 5.0)
    assert value_of(page, "pinch_contact_deg") == pytest.approx(rod["angle_deg"], abs=1.0)
    until(page, lambda _: "reversing" in text_of(page, "#events"))
    until(page, lambda _: value_of(page, "gate_angle_deg") > rod["angle_deg"] + 3.0)
    assert float(text_of(page, "#peak")) > 5.0
    click(page, "#obstacle-on button")
    until(page, lambda _: page.execute_script("return last.in_force.obstacle === null"))
    assert errors_in(page) == []


def test_the_left_drives_shaft_is_drawn_to_its_joint_on_the_gate(page: Any) -> None:
    """The shaft of the left drive ends at the gate's joint, beside which it is drawn at an offset of 7 units."""
    ends = page.execute_script(
        "const d = document.querySelector('.shaft.left').getAttribute('d').split('L')[1].split(' ');"
        "return [d.map(Number), drawing.at(drawing.turned(about.geometry.drives.left.gate_point[0]))]"
    )
    apart = ((ends[0][0] - ends[1][0]) ** 2 + (ends[0][1] - ends[1][1]) ** 2) ** 0.5
    assert apart == pytest.approx(7.0, abs=1.5)
