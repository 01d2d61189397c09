"""The demo: its request, picture and text, its verdict, and whether its real-time run is valid."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.drive.result import Result
from liftgate_hil.ecu.names import REFERENCE
from liftgate_hil.errors import ConfigError, number_of
from liftgate_hil.judging.verdict import FAIL, INCONCLUSIVE
from liftgate_hil.plan.request import RunRequest
from liftgate_hil.report.files import check_targets
from liftgate_hil.report.pinch import LIMITS, PinchEvent, pinch_event
from liftgate_hil.testing.request import DemoFiles

if TYPE_CHECKING:
    from liftgate_hil.formats.guarded import Say
    from liftgate_hil.plan.setup import Setup

_FREE_DEG = 5.0  # a reversal must move back by more than this
_MOVED_DEG = 1.0  # a gate that moves by less only settles
_MOST_ROWS = 100_000  # rows of the picture, at most
_USUAL_EVERY = 10  # of a run of unknown length, one row in so many is kept
_JUDGED = "parts/demo_judged"  # the demo with its expectations
_LEARNED = "parts/demo_learned"  # the same, for a reference ECU that has learned the gate
PICTURE = "demo.png"


@dataclass(frozen=True)
class DemoReport(DescribedResult):
    """JSON report on a demo: the result of its run, and its pinch event."""

    result: Annotated[Result, Shown("its result", is_flat=True)]
    pinch: Annotated[
        PinchEvent | None,
        Shown("`demo` only: the contact with the largest pinch force; null: nothing was pinched"),
    ]


def is_whole(request: RunRequest) -> bool:
    """Whether a request asks for the whole demo, which is judged."""
    return request.scenario in (None, "demo") and request.duration is None


def demo_request(request: RunRequest, files: DemoFiles) -> RunRequest:
    """Return the request for the demo's run, with its scenario and recordings; create their folder.

    Raises ConfigError.
    """
    if (request.serial is None) != (files.ecu_serial is None):
        raise ConfigError("`serial` and `ecu_serial`: allowed: both ends of the line, or neither")
    folder, judged = Path(files.output), _LEARNED if request.ecu == REFERENCE else _JUDGED
    made = [] if files.no_record else [folder / "demo.log", folder / "demo.csv"]
    try:
        if made:
            folder.mkdir(parents=True, exist_ok=True)
            check_targets({"output": folder / PICTURE}, [])
    except OSError as error:
        raise ConfigError(
            f"`output` {files.output}: cannot be created: {error.strerror}; allowed: a folder"
        ) from error
    return request.replaced(
        scenario=judged if is_whole(request) else request.scenario or "demo", record=(*request.recordings, *made)
    )


def on_the_free_clock(request: RunRequest) -> RunRequest:
    """Return the request for a repetition of the run on the free clock, without a bus."""
    here = dict.fromkeys(("bus", "interface", "channel", "serial", "cpu"))
    return request.replaced(clock="free", realtime=False, **here)


def rows_per_kept_one(duration: float | None, rate: float) -> int:
    """Return of how many rows of a run [s, Hz] one is kept for the picture; 1 (all rows) for the usual demo."""
    return _USUAL_EVERY if duration is None else int(max(1, math.ceil(duration * rate / _MOST_ROWS)))


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


def last_line(shown: Result, given: RunRequest, is_repeated: bool) -> str:
    """Return the last line of output after a run without failures; "": the expectations' verdicts suffice."""
    if is_whole(given):
        where = " (repeated on the free clock)" if is_repeated else ""
        return f"the demo has passed{where}: the gate met the rod, was reversed, and was latched at the end"
    if given.scenario in (None, "demo"):
        return "not judged: the demo was shortened, and the ECU had learned nothing before"
    return "" if shown.expectations else f"not judged: {given.scenario} states no expectations"


def demo_lines(shown: Result, event: PinchEvent | None, files: DemoFiles) -> Iterator[str]:
    """Yield the ECU's events, unless in real time, the contact with the obstacle, and the picture's path."""
    import numpy as np

    columns = shown.trace
    if len(columns["time_s"]) < 2:
        return
    # In real time the events have been printed as they happened.
    for each in [] if shown.summary.clock == "realtime" else shown.events:
        angle = float(np.interp(each.time, columns["time_s"], columns["gate_angle_deg"]))
        yield f"{each.time:7.3f} s  {angle:6.2f} deg  {each.text}"
    if event is not None:
        yield from event.lines()
    if not files.no_record:
        yield f"picture: {Path(files.output) / PICTURE}"


def draw_demo(shown: Result, setup: Setup, event: PinchEvent | None, mark: str, folder: Path, say: Say) -> None:
    """Write the picture of a demo's run to a folder, with `mark` in its title. Raises ConfigError."""
    from liftgate_hil.report.run_plot import DrawnObstacle, RunPicture, plot_run
    from liftgate_hil.signals import columns_of

    title = f"liftgate-hil demo: {setup.vehicle_name}, clock {shown.summary.clock}"
    picture = RunPicture(
        title=f"{title} ({mark})" if mark else title,
        columns={name: shown.trace[name] for name in columns_of(setup.vehicle.drives)},
        event=event,
        obstacles=[
            DrawnObstacle(math.degrees(each.obstacle.angle), each.start.time, each.end.time)
            for each in setup.scenario.stimuli.obstacles
        ],
        marks=[(each.time, "ECU reverses") for each in shown.events if "reversing" in each.text],
    )
    try:
        plot_run(folder / PICTURE, picture, say)
    except OSError as error:
        raise ConfigError(f"`output` {folder}: {PICTURE}: {error.strerror}") from error
