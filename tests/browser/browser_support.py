"""Helpers of the tests of pages in a browser."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any

OPENS = 'duration = 1e6\n[[request]]\ntime = 0.5\naction = "open"\n'  # a scenario
WAIT_S = 180  # on a busy machine a browser gets a tenth of a CPU
GOING = ("running", "late")  # a busy machine is late now and then


def until(browser: Any, is_so: Any) -> Any:
    """Wait until `is_so(browser)` is true and return its value; the page may reload meanwhile."""
    from selenium.common import exceptions
    from selenium.webdriver.support.ui import WebDriverWait

    passing = (
        exceptions.JavascriptException,
        exceptions.StaleElementReferenceException,
        exceptions.ElementNotInteractableException,
        exceptions.ElementClickInterceptedException,  # what it stands above has just grown
    )
    try:
        return WebDriverWait(browser, WAIT_S, poll_frequency=0.05, ignored_exceptions=passing).until(is_so)
    except exceptions.TimeoutException:
        shown = (text_of(browser, each) for each in ("#phase", "#end-reason", "#answer"))
        raise AssertionError(f"{browser.title}: {', '.join(shown)}; {errors_in(browser)}") from None


def found(browser: Any, selector: str) -> Any:
    return browser.find_element("css selector", selector)


def text_of(browser: Any, selector: str) -> str:
    return str(found(browser, selector).text)


def click(browser: Any, selector: str) -> None:
    """Click an element once the page shows it."""
    until(browser, lambda _: found(browser, selector).click() is None)


def set_value(browser: Any, selector: str, value: str) -> None:
    """Replace the value of a field."""
    field = found(browser, selector)
    field.clear()
    field.send_keys(value)


def errors_in(browser: Any) -> list[str]:
    return [each["message"] for each in browser.get_log("browser") if each["level"] != "INFO"]


def opened(browser: Any, address: str, phases: tuple[str, ...] = GOING) -> Any:
    """Open the page and return it once it shows one of these phases."""
    browser.get(address)
    until(browser, lambda _: text_of(browser, "#phase").split(":")[0] in phases)
    until(browser, lambda _: found(browser, "body").get_attribute("data-ready"))
    return browser


def value_of(browser: Any, name: str) -> float:
    """True value of this column in the page's last state."""
    return float(browser.execute_script("return last.truth[arguments[0]]", name))


def press(browser: Any, action: str) -> None:
    """Click a driver's button until the page is seen to confirm the request, which it shows for four seconds."""
    clicked = 0.0

    def is_confirmed(_: object) -> bool:
        nonlocal clicked
        if time.monotonic() > clicked + 10.0:
            found(browser, f"#request-{action}").click()
            clicked = time.monotonic()
        return f"request {action}" in text_of(browser, "#answer")

    until(browser, is_confirmed)


def press_until(browser: Any, action: str, is_so: Callable[[], bool]) -> None:
    """Click a driver's button until a condition holds: on a busy machine the ECU may stop on its way."""
    pressed = time.monotonic()
    press(browser, action)

    def holds(_: object) -> bool:
        nonlocal pressed
        if is_so():
            return True
        if time.monotonic() > pressed + 3.0 and abs(value_of(browser, "gate_rate_degps")) < 0.05:
            pressed = time.monotonic()
            press(browser, action)
        return False

    until(browser, holds)


@contextlib.contextmanager
def window(browser: Any, width: int, height: int) -> Iterator[None]:
    """Set the inner size of the browser's window [px], also smaller than a window may be."""
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
    )
    try:
        yield
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def clear_all(browser: Any) -> None:
    click(browser, "#clear")
    nothing = "return Object.keys(last.in_force.set).length + last.in_force.faults.length === 0"
    until(browser, lambda _: browser.execute_script(nothing + " && !last.in_force.obstacle"))


def drawn_angle(browser: Any) -> float:
    """Angle at which the gate is drawn, from the corners of its plate relative to the closed gate."""
    d = found(browser, "#gate").get_attribute("d")
    first, second = ([float(each) for each in part.split()] for part in d[1:].split("L")[:2])
    return float(
        browser.execute_script(
            "return Math.atan2(-(arguments[1][1] - arguments[0][1]), arguments[1][0] - arguments[0][0])"
            " * 180 / Math.PI - about.geometry.closed_deg",
            first,
            second,
        )
    )


def drag(browser: Any, selector: str, right: int, down: int, hold_s: float = 0.0) -> Any:
    """Drag with the mouse; return the actions that release the button."""
    from selenium.webdriver import ActionChains

    actions = ActionChains(browser, duration=50)
    actions.click_and_hold(found(browser, selector)).move_by_offset(right, down).pause(hold_s).perform()
    return ActionChains(browser).release()
