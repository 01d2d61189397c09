"""Verdict of the demo: whether gate and ECU behaved as required, and whether a real-time run is valid."""

from __future__ import annotations

import math

from liftgate_hil.drive.result import Result
from liftgate_hil.errors import number_of
from liftgate_hil.judging.verdict import FAIL, INCONCLUSIVE
from liftgate_hil.report.pinch import LIMITS, PinchEvent, pinch_event

_FREE_DEG = 5.0  # a reversal must move back by more than this
_MOVED_DEG = 1.0  # a gate that moves by less only settles


def failures(shown: Result, event: PinchEvent | None, is_ours: bool) -> list[str]:
    """Return in words each requirement of the demo that a complete run of it does not meet.

    An ECU that `is_ours` must also report its reversal as an event. In real time it is late only where its machine
    is, which the scenario's tolerance covers; another one must be in time.
    """
    found = _standstill(shown)
    columns, summary = shown.trace, shown.summary
    if event is None:
        found.append("the gate never met the obstacle")
    elif math.isnan(event.turn_s):
        found.append("the gate did not reverse")
    elif event.back_deg <= _FREE_DEG:
        found.append(
            f"the gate reversed, but moved back by {event.back_deg:.1f} deg only; allowed: more than "
            f"{_FREE_DEG:g} deg"
        )
    for limit in LIMITS:
        if event is not None and limit.is_judged and event.over(limit):
            found.append(event.fault(limit))
    if is_ours and not any("reversing" in event.text for event in shown.events):
        found.append("the ECU did not detect the obstacle")
    if columns["latched"][-1] < 0.5:
        angle = columns["gate_angle_deg"][-1]
        found.append(f"the gate did not close and latch at the end (it stands at {angle:.1f} deg)")
    if summary.command_timeouts and not (is_ours and summary.clock == "realtime"):
        found.append(f"{number_of(summary.command_timeouts, 'command time-out')}: the ECU was too late")
    if not found and shown.verdict == FAIL:
        found.append(shown.reason)
    return found


def busy_with(shown: Result, is_ours: bool) -> str:
    """Return the reason why the demo's real-time run is invalid as the machine was too busy; "": it is valid.

    A reason is a verdict that the machine's lateness may have decided, and, with an ECU that `is_ours` and so is
    late only where its machine is, any failure of a late run. Such a run is repeated on the free clock.
    """
    if shown.summary.clock != "realtime":
        return ""
    verdicts = shown.expectations.values()
    doubtful = [each for each in verdicts if each.verdict == INCONCLUSIVE]
    is_failed = bool(failures(shown, pinch_event(shown.trace), is_ours))
    late = shown.late.removeprefix("the bench was late: ")
    if doubtful:
        return late or f"{doubtful[0].name}: {doubtful[0].reason}"
    return late if is_failed and is_ours else ""


def _standstill(shown: Result) -> list[str]:
    """Return one reason why the gate never moved, as far as the commands show it; else an empty list."""
    accepted, angles = shown.summary.received.accepted, shown.trace["gate_angle_deg"]
    if angles.max() - angles.min() >= _MOVED_DEG:
        return []
    if accepted:
        return [f"{number_of(accepted, 'command')} accepted, and no drive moved"]
    return [shown.summary.silence_reported()]
