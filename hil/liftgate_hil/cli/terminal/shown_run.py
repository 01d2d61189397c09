"""A run by `run` or `demo`, shown on the terminal while it lasts, with its result; and the flags of both."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from liftgate_hil.cli.command import Call, add_flags, add_printed, as_flags
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.terminal.panel import PanelView
from liftgate_hil.cli.terminal.progress import AFTER_S
from liftgate_hil.cli.terminal.teller import Teller
from liftgate_hil.config.described import fields_of
from liftgate_hil.dashboard.request import RunPage
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.errors import EcuError, printable
from liftgate_hil.judging.verdict import ERROR
from liftgate_hil.plan.request import RunRequest

if TYPE_CHECKING:
    from liftgate_hil.drive.result import Result


def add_run(parser: argparse.ArgumentParser, ecu: str) -> None:
    """Add the flags of a run (by default in real time, with this `ecu`), of its page, and of the output."""
    names = [each.name for each in fields_of(RunRequest) if each.name != "trace"]
    add_flags(parser, RunRequest, *names, ecu=ecu, clock="realtime")
    add_printed(parser, json="print the summary as JSON")
    add_flags(parser, RunPage)


class ShownRun(NamedTuple):
    """Call, stop signals and exit codes of a run by `run` or `demo`; its methods run it and print the result."""

    call: Call
    stopped: StopSignals
    exit_codes: Mapping[str, int]  # of the command; told on the page, too

    def result(
        self, request: RunRequest, page: RunPage, *, is_wired: bool, ecu_serial: str | None = None, **more: Any
    ) -> Result:
        """Run the gate with its ECU, and return the result; `more` are fields of its `Job`.

        Where it is not `is_wired`, and on a virtual bus, the ECU is in this process, or in a worker of its own; on
        any other bus it is a second process there. Raises LiftgateError; what went wrong in the run is in the
        result.
        """
        from liftgate_hil.config.rig_fit import notes_on_fit
        from liftgate_hil.config.scenario import stimuli_after
        from liftgate_hil.dashboard.page_process import page_process
        from liftgate_hil.drive.ecu_process import execute_with_process
        from liftgate_hil.drive.run import execute
        from liftgate_hil.ecu.find import is_foreign
        from liftgate_hil.plan.plan import plan_of
        from liftgate_hil.plan.request import Job

        teller = Teller(self.call.is_quiet, self.call.is_json, f"{request.rate:g} Hz, clock {request.clock}")
        job = Job(
            request,
            request if is_wired else None,
            is_isolated=is_foreign(request.ecu),
            attachable_as=os.getpid(),
            exit_codes=self.exit_codes,
            listener=teller,
            **more,
        )
        with teller.progress("preparing the run"):
            plan = plan_of(job)
        vehicle = plan.setup.vehicle
        after_s = AFTER_S if request.clock == "free" else 0.0  # in real time the first seconds count, too
        teller.sees(PanelView(math.degrees(vehicle.gate.open_angle), plan.duration, vehicle.drives, after_s))
        is_here = plan.way is None or plan.way.is_interface("virtual")
        try:
            with page_process(page, request.clock, teller):
                if request.ecu == ON_A_BUS or is_here:
                    found = execute(plan, self.stopped)
                else:
                    found = execute_with_process(plan, ecu_serial, self.stopped)
        except EcuError as error:  # the ECU could not be created, or its process failed
            raise self.stopped.failure(str(error)) from error
        finally:
            teller.clear()
        # Who shortens a run with --duration knows that it ends before the rest of its scenario.
        known = [] if request.duration is None else stimuli_after(plan.setup.scenario, request.duration)
        known += notes_on_fit(plan.rig, plan.setup.vehicle, plan.request.rate)  # said before the run
        for note in found.notes:
            if note not in known:
                teller.say(f"note: {note}")
        return found

    def raise_error(self, result: Result) -> None:
        """Raise the error of a run, if there was one, after printing its summary where that is known."""
        if result.verdict != ERROR:
            return
        if math.isfinite(result.maxima["time_s"]):
            self.report(result)
        raise self.stopped.failure(result.reason)

    def exit_code(self, result: Result) -> int:
        """Return the exit code for how a run has ended; print the reason unless it is 0."""
        code = self.exit_codes[result.ending]
        if code and result.reason:
            print(f"liftgate-hil: {as_flags(result.reason)}", file=sys.stderr)
        return code

    def report(self, result: Result) -> None:
        """Print the summary of a run, as text, as JSON or not at all, as the flags ask."""
        if self.call.is_json:
            print(self.ended(result).to_json())
        elif not self.call.is_quiet:
            print_summary(result)

    def ended(self, result: Result) -> Result:
        """Return the result of a run with its provenance, and with the signal that stopped it, if any."""
        from liftgate_hil.plan.provenance import provenance_of

        provenance = provenance_of(self.call.command_line, result.sources)
        return replace(result, stopped_by=self.stopped.name or "", provenance=provenance)


def print_summary(result: Result) -> None:
    """Print the summary of a run, and its verdicts."""
    print("\n".join([*result.summary.lines(), *_verdicts(result)]))


def _verdicts(result: Result) -> list[str]:
    """Return the verdicts on the scenario's expectations as lines of text; empty: there are none."""
    from liftgate_hil.judging.verdict import line_of

    found = [f"  {printable(name)}: {as_flags(line_of(each))}" for name, each in result.expectations.items()]
    return ["expectations:", *found] if found else []
