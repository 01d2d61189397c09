"""The gate with an ECU, which opens it, closes it onto an obstacle, detects that by the currents and speeds of its
motors, reverses, then opens and closes it fully. Prints what happened, writes recordings and a picture, and judges
itself.

Without a bus both run in this process: on the free clock as machine code, else on a virtual bus. On any other
bus the ECU is a second process. On a serial line it needs a port of its own, the line's other end: --ecu-serial.
"""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli.command import DEMO_EXIT_CODES, Call, add_flags, as_flags
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.terminal.shown_run import ShownRun, add_run, print_summary
from liftgate_hil.cli.terminal.teller import Teller
from liftgate_hil.dashboard.listening import hold_token
from liftgate_hil.dashboard.request import LISTEN, DashboardRequest, RunPage
from liftgate_hil.ecu.names import ON_A_BUS, REFERENCE
from liftgate_hil.errors import printable
from liftgate_hil.judging.verdict import INCONCLUSIVE
from liftgate_hil.plan.request import RunRequest
from liftgate_hil.testing.request import DemoFiles

if TYPE_CHECKING:
    from liftgate_hil.drive.result import Result
    from liftgate_hil.report.pinch import PinchEvent

_NOT_REAL_TIME = "not in real time: the machine was too busy"  # marks a picture
_DOES_NOT_COUNT = "this run does not count"  # the same
_TOO_BUSY = "liftgate-hil demo: this machine was too busy for real time"
_AGAIN = (
    "The run is repeated on the free clock, which needs no real time; liftgate-hil doctor checks whether this "
    "machine is fit for real time"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `demo` to its parser."""
    add_run(parser, REFERENCE)
    add_flags(parser, DemoFiles)


def run(call: Call) -> int:
    """Run the subcommand `demo` (the gate meets an obstacle, its ECU reverses it) and return its exit code."""
    return _Demo(call, StopSignals()).exit_code()


class _Demo:
    """The demo: a run, judged if it is whole, and repeated on the free clock if it was late (no ECU on a bus)."""

    def __init__(self, call: Call, stopped: StopSignals) -> None:
        from liftgate_hil.plan.setup import setup_for
        from liftgate_hil.testing.demo import demo_request, is_whole

        self._call, self._run = call, ShownRun(call, stopped, DEMO_EXIT_CODES)
        self._given, self._files = call.request(RunRequest), call.request(DemoFiles)
        self._page = call.request(RunPage)
        self._is_whole = is_whole(self._given)
        self._request = demo_request(self._given, self._files)
        self._setup = setup_for(self._request)
        # Duration of the whole run [s]; None: until stopped.
        self._whole = self._setup.scenario.duration if self._given.duration is None else self._given.duration

    def exit_code(self) -> int:
        """Run the demo, show its result, and return the exit code. Raises LiftgateError."""
        from liftgate_hil.report.pinch import pinch_event
        from liftgate_hil.testing.demo import busy_with, failures, last_line, on_the_free_clock

        is_ours, is_on_bus = self._given.ecu == REFERENCE, self._given.ecu == ON_A_BUS
        if self._page.dashboard:
            hold_token()  # so that the page of a repeated run has that of the first one
        shown = self._shown(self._request, self._page)
        if shown.is_given_up and not shown.summary.ticks:  # the precondition was not reached
            return self._run.exit_code(shown)
        busy = mark = ""
        if self._is_whole and not self._is_stopped(shown):
            busy = as_flags(busy_with(shown, is_ours))
        if busy and is_on_bus:
            print(f"{_TOO_BUSY}: {busy}. The run says nothing about the ECU", file=sys.stderr, flush=True)
            mark = _DOES_NOT_COUNT
        elif busy:
            print(f"{_TOO_BUSY}: {busy}. {_AGAIN}", file=sys.stderr, flush=True)
            mark = _NOT_REAL_TIME
            self._request = on_the_free_clock(self._request)
            shown = self._shown(self._request, RunPage())
        is_stopped = self._is_stopped(shown)
        event = pinch_event(shown.trace)
        reasons = failures(shown, event, is_ours) if self._is_whole and not is_stopped else []
        self._present(shown, event, mark or (_DOES_NOT_COUNT if reasons else ""))
        if is_stopped:
            text = f"stopped at {shown.summary.model_time_s:.3f} s of {self._whole:g} s"
            print(f"liftgate-hil demo: {text}", file=sys.stderr)
            return self._run.stopped.exit_code
        if busy and is_on_bus:
            return DEMO_EXIT_CODES[INCONCLUSIVE]
        if busy and self._page.dashboard and not self._files.no_record:
            self._show_on_page()
        for reason in reasons:
            print(f"liftgate-hil demo: failed: {reason}", file=sys.stderr)
        is_told = not (reasons or self._call.is_quiet or self._call.is_json)
        if is_told and (line := last_line(shown, self._given, bool(busy))):
            print(printable(line))
        return 1 if reasons else self._run.exit_code(shown)

    def _shown(self, request: RunRequest, page: RunPage) -> "Result":
        """Run the demo with the given request and return its result. Raises LiftgateError."""
        from liftgate_hil.testing.demo import rows_per_kept_one

        shown = self._run.result(
            request,
            page,
            is_wired=request.is_given,
            ecu_serial=self._files.ecu_serial,
            trace=rows_per_kept_one(self._whole, request.rate),
            gives_up_late=self._is_whole,
        )
        self._run.raise_error(shown)
        return shown

    def _show_on_page(self) -> None:
        """Serve the page of the repeated run, at the address of the first one, until it is stopped."""
        from liftgate_hil.cli.dashboard import serve_page

        print("liftgate-hil demo: the page shows the repeated run; Ctrl-C ends it", file=sys.stderr, flush=True)
        serve_page(
            DashboardRequest(
                recording=str(Path(self._files.output) / "demo.csv"),
                vehicle=self._setup.vehicle_name,
                listen=self._page.listen or LISTEN,
                read_only=self._page.read_only,
            )
        )

    def _present(self, shown: "Result", event: "PinchEvent | None", mark: str) -> None:
        """Write the picture of a result, with `mark` in its title, and print the result, as the flags ask."""
        from liftgate_hil.testing.demo import DemoReport, demo_lines, draw_demo

        if not self._files.no_record and len(shown.trace["time_s"]) > 1:  # not stopped before it began
            teller = Teller(self._call.is_quiet, self._call.is_json)
            with teller.progress("picture"):
                draw_demo(shown, self._setup, event, mark, Path(self._files.output), teller.say)
        if self._call.is_json:
            print(DemoReport(self._run.ended(shown), event).to_json())
        elif not self._call.is_quiet:
            for line in demo_lines(shown, event, self._files):
                print(line)
            print_summary(shown)

    def _is_stopped(self, shown: "Result") -> bool:
        """Whether the run was stopped before its end."""
        whole = self._whole
        return whole is not None and shown.summary.model_time_s < whole and self._run.stopped()
