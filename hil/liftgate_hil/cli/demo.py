"""The gate with an ECU, which opens it, closes it onto an obstacle, detects that by the currents and speeds of its
motors, reverses, then opens and closes it fully. Prints what happened, writes recordings and a picture, and judges
itself.

Without a bus both run in this process: on the free clock as machine code, else on a virtual bus. On any other
bus the ECU is a second process. On a serial line it needs a port of its own, the line's other end: --ecu-serial.
"""

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from liftgate_hil.cli.command import DEMO_EXIT_CODES, Call, add_flags, as_flags
from liftgate_hil.cli.run import ShownRun, add_run, print_summary
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.terminal.teller import Teller
from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.kinds import File, Flag, Text
from liftgate_hil.dashboard.listening import hold_token
from liftgate_hil.dashboard.request import LISTEN, DashboardRequest, RunPage
from liftgate_hil.ecu.names import ON_A_BUS, REFERENCE
from liftgate_hil.errors import ConfigError, printable
from liftgate_hil.judging.verdict import INCONCLUSIVE
from liftgate_hil.plan.request import RunRequest

if TYPE_CHECKING:
    from liftgate_hil.drive.result import Result
    from liftgate_hil.plan.setup import Setup
    from liftgate_hil.report.pinch import PinchEvent

_MOST_ROWS = 100_000  # rows of the picture, at most
_USUAL_EVERY = 10  # of a run of unknown length, one row in so many is kept
_JUDGED = "parts/demo_judged"  # the demo with its expectations
_LEARNED = "parts/demo_learned"  # the same, for a reference ECU that has learned the gate
_NOT_REAL_TIME = "not in real time: the machine was too busy"  # marks a picture
_DOES_NOT_COUNT = "this run does not count"  # the same
_TOO_BUSY = "liftgate-hil demo: this machine was too busy for real time"
_AGAIN = (
    "The run is repeated on the free clock, which needs no real time; liftgate-hil doctor checks whether this "
    "machine is fit for real time"
)


# fmt: off
class DemoFiles(Record):
    """Flags that only `demo` has: the files that it writes, and the serial line of its ECU."""

    ecu_serial: Annotated[str | None, Field(Text("PORT[@BAUD]"), "the other end of --serial, for the ECU",
        metavar="PORT[@BAUD]")] = None
    output: Annotated[str | Path, Field(File(), "folder for demo.log, demo.csv and demo.png, created if missing",
        metavar="FOLDER")] = "."
    no_record: Annotated[bool, Field(Flag(), "write no demo.log, demo.csv and demo.png")] = False


# fmt: on
def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `demo` to its parser."""
    add_run(parser, REFERENCE)
    add_flags(parser, DemoFiles)


def run(call: Call) -> int:
    """Run the subcommand `demo` (the gate meets an obstacle, its ECU reverses it) and return its exit code."""
    stopped = StopSignals()
    request = call.request(RunRequest)
    is_whole = request.scenario in (None, "demo") and request.duration is None
    return _Demo(call, request, is_whole, stopped).exit_code()


class _Demo:
    """The demo: a run, if too slow repeated on the free clock (not with a bus); judged only if `is_whole`."""

    def __init__(self, call: Call, request: RunRequest, is_whole: bool, stopped: StopSignals) -> None:
        self._call, self._is_whole = call, is_whole
        self._run = ShownRun(call, stopped, DEMO_EXIT_CODES)
        self._files, self._page = call.request(DemoFiles), call.request(RunPage)
        self._folder = Path(self._files.output)
        self._is_ours = request.ecu == REFERENCE
        self._given = request.scenario
        judged = _LEARNED if self._is_ours else _JUDGED
        self._request = request.replaced(
            scenario=judged if is_whole else request.scenario or "demo",
            record=(*request.recordings, *self._made_files(request)),
        )

    def _made_files(self, request: RunRequest) -> list[Path]:
        """Return the demo's recordings, [] if `no_record`, and create their folder. Raises ConfigError."""
        files = self._files
        if (request.serial is None) != (files.ecu_serial is None):
            raise ConfigError("`serial` and `ecu_serial`: allowed: both ends of the line, or neither")
        if files.no_record:
            return []
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                f"`output` {files.output}: cannot be created: {error.strerror}; allowed: a folder"
            ) from error
        return [self._folder / "demo.log", self._folder / "demo.csv"]

    def exit_code(self) -> int:
        """Run the demo, show its result, and return the exit code. Raises LiftgateError."""
        from liftgate_hil.report.pinch import pinch_event
        from liftgate_hil.testing.demo_verdict import busy_with, failures

        stopped, is_on_bus = self._run.stopped, self._request.ecu == ON_A_BUS
        if self._page.dashboard:
            hold_token()  # so that the page of a repeated run has that of the first one
        shown = self._shown(self._request, self._page)
        if shown.is_given_up and not shown.summary.ticks:  # the precondition was not reached
            return self._run.exit_code(shown)
        busy = mark = ""
        if self._is_whole and not self._is_stopped(shown):
            busy = as_flags(busy_with(shown, self._is_ours))
        if busy and is_on_bus:
            print(f"{_TOO_BUSY}: {busy}. The run says nothing about the ECU", file=sys.stderr, flush=True)
            mark = _DOES_NOT_COUNT
        elif busy:
            print(f"{_TOO_BUSY}: {busy}. {_AGAIN}", file=sys.stderr, flush=True)
            mark = _NOT_REAL_TIME
            here = dict.fromkeys(("bus", "interface", "channel", "serial", "cpu"))
            self._request = self._request.replaced(clock="free", realtime=False, **here)
            shown = self._shown(self._request, RunPage())
        is_stopped = self._is_stopped(shown)
        event = pinch_event(shown.trace)
        reasons = failures(shown, event, self._is_ours) if self._is_whole and not is_stopped else []
        if reasons and not mark:
            mark = _DOES_NOT_COUNT
        self._present(shown, event, mark)
        if is_stopped:
            time, whole = shown.summary.model_time_s, self._whole()
            print(f"liftgate-hil demo: stopped at {time:.3f} s of {whole:g} s", file=sys.stderr)
            return stopped.exit_code
        if busy and is_on_bus:
            return DEMO_EXIT_CODES[INCONCLUSIVE]
        if busy and self._page.dashboard and not self._files.no_record:
            self._show_on_page()
        for reason in reasons:
            print(f"liftgate-hil demo: failed: {reason}", file=sys.stderr)
        last = "" if reasons or self._call.is_quiet or self._call.is_json else self._last_line(shown, bool(busy))
        if last:
            print(printable(last))
        return 1 if reasons else self._run.exit_code(shown)

    def _shown(self, request: RunRequest, page: RunPage) -> "Result":
        """Run the demo with the given request and return its result. Raises LiftgateError."""
        shown = self._run.result(
            request,
            page,
            is_wired=request.is_given,
            ecu_serial=self._files.ecu_serial,
            trace=self._every(),
            gives_up_late=self._is_whole,
        )
        self._run.raise_error(shown)
        return shown

    def _last_line(self, shown: "Result", is_repeated: bool) -> str:
        """Return the last line of output after a run without failures; "": the expectations' verdicts suffice."""
        if self._is_whole:
            where = " (repeated on the free clock)" if is_repeated else ""
            return f"the demo has passed{where}: the gate met the rod, was reversed, and was latched at the end"
        if self._given in (None, "demo"):
            return "not judged: the demo was shortened, and the ECU had learned nothing before"
        return "" if shown.expectations else f"not judged: {self._given} states no expectations"

    def _show_on_page(self) -> None:
        """Serve the page of the repeated run, at the address of the first one, until it is stopped."""
        from liftgate_hil.cli.dashboard import serve_page

        print("liftgate-hil demo: the page shows the repeated run; Ctrl-C ends it", file=sys.stderr, flush=True)
        serve_page(
            DashboardRequest(
                recording=str(self._folder / "demo.csv"),
                vehicle=self._setup().vehicle_name,
                listen=self._page.listen or LISTEN,
                read_only=self._page.read_only,
            )
        )

    def _present(self, shown: "Result", event: "PinchEvent | None", mark: str) -> None:
        """Write the picture of a result, with `mark` in its title, and print the result, as the flags ask."""
        if not self._files.no_record and len(shown.trace["time_s"]) > 1:  # not stopped before it began
            teller = Teller(self._call.is_quiet, self._call.is_json)
            with teller.progress("picture"):
                self._draw(shown, event, mark, teller)
        if self._call.is_json:
            from liftgate_hil.report.run_report import DemoReport

            print(DemoReport(shown, *self._run.ending(shown), event).to_json())
        elif not self._call.is_quiet:
            self._tell(shown, event)
            print_summary(shown)

    def _is_stopped(self, shown: "Result") -> bool:
        """Whether the run was stopped before its end."""
        whole = self._whole()
        return whole is not None and shown.summary.model_time_s < whole and self._run.stopped()

    def _setup(self) -> "Setup":
        from liftgate_hil.plan.setup import setup_for

        return setup_for(self._request)

    def _whole(self) -> float | None:
        """Return the duration of the whole run [s]; None: until stopped."""
        given = self._request.duration
        return self._setup().scenario.duration if given is None else given

    def _every(self) -> int:
        """Return of how many rows one is kept for the picture; 1 (all rows) for the usual demo."""
        duration = self._whole()
        if duration is None:
            return _USUAL_EVERY
        return int(max(1, math.ceil(duration * self._request.rate / _MOST_ROWS)))

    def _draw(self, shown: "Result", event: "PinchEvent | None", mark: str, teller: Teller) -> None:
        """Write the picture of a demo's run. Raises ConfigError."""
        from liftgate_hil.report.run_plot import DrawnObstacle, RunPicture, plot_run
        from liftgate_hil.signals import columns_of

        setup = self._setup()
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
            plot_run(self._folder / "demo.png", picture, teller.say)
        except OSError as error:
            raise ConfigError(f"`output` {self._folder}: demo.png: {error.strerror}") from error

    def _tell(self, shown: "Result", event: "PinchEvent | None") -> None:
        """Print the ECU's events, unless in real time, the contact with the obstacle, and the picture's path."""
        import numpy as np

        columns = shown.trace
        if len(columns["time_s"]) < 2:
            return
        # In real time the events have been printed as they happened.
        events = [] if self._request.clock == "realtime" else shown.events
        for each in events:
            angle = float(np.interp(each.time, columns["time_s"], columns["gate_angle_deg"]))
            print(f"{each.time:7.3f} s  {angle:6.2f} deg  {each.text}")
        if event is not None:
            print("\n".join(event.lines()))
        if not self._files.no_record:
            print(f"picture: {self._folder / 'demo.png'}")
