"""The gate in a closed loop with the ECU that `--ecu` names."""

from __future__ import annotations

import argparse
import contextlib
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import IO, TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.cli.teller import Teller
from liftgate_hil.errors import LiftgateError

if TYPE_CHECKING:
    from liftgate_hil.ecu.events import Event
    from liftgate_hil.runs import Job, Result

ON_A_BUS = "bus"  # the ECU is somebody else's
_EVENT = re.compile(r"^ecu\s+([\d.]+) s  (.*)$")


def run_loop(
    args: argparse.Namespace, stopped: Callable[[], bool], has_wire: bool = True, trace: int = 0
) -> Result:
    """Without a wire and on a virtual bus the ECU is in this process, or in a worker of its own; on any other bus
    it is a second process there. Raises LiftgateError, also for what went wrong in the run.
    """
    from liftgate_hil import runs

    job = _job_of(args, has_wire, trace)
    parts = runs.resolve(job)
    is_here = parts.way is None or parts.way.is_interface("virtual")
    if args.ecu == ON_A_BUS or is_here:
        result = runs.execute(job, stopped)
    else:
        with _ecu_process(args, parts.setup.vehicle.drives) as child:
            result = runs.execute(replace(job, ecu=ON_A_BUS), stopped)
            child.terminate()
            if not result.reason:
                result = replace(result, events=_events_of(child, args.ecu))
    if result.reason:
        raise LiftgateError(result.reason)
    return result


def _job_of(args: argparse.Namespace, has_wire: bool, trace: int) -> Job:
    from liftgate_hil.runs import Job

    return Job(
        scenario=args.scenario,
        ecu=options.ecu_of(args),
        vehicle=args.vehicle,
        rig=args.rig,
        settings=tuple(args.settings),
        initial=args.initial,
        seed=args.seed,
        wire=options.wire_choice(args) if has_wire else None,
        options=options.run_options(args),
        trace=trace,
        listener=Teller(args.quiet, args.json, f"{args.rate:g} Hz, clock {args.clock}"),
    )


@contextlib.contextmanager
def _ecu_process(args: argparse.Namespace, drives: int) -> Iterator[subprocess.Popen[str]]:
    """`liftgate-hil ecu` on the same bus; ended with this process."""
    command = [sys.executable, "-P", "-m", "liftgate_hil", "ecu"]
    command += ["--drives", str(drives), "--ecu", args.ecu]
    for flag in ("scenario", "rig", "bus", "interface", "channel", "bitrate"):
        value = getattr(args, flag)
        if value is not None:
            command += [f"--{flag}", str(value)]
    if getattr(args, "ecu_serial", None) is not None:
        command += ["--serial", args.ecu_serial]
    command += [flag for flag in ("--fd", "--realtime") if getattr(args, flag.strip("-"))]
    child = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        yield child
    finally:
        child.kill()
        child.wait()


def _events_of(child: subprocess.Popen[str], ecu: str) -> list[Event]:
    from liftgate_hil.ecu.events import IN_WORDS, Event

    stream: IO[str] | None = child.stderr
    assert stream is not None
    lines = stream.read().splitlines()
    matches = [match for line in lines if (match := _EVENT.match(line))]
    if not matches and ecu == "reference":
        detail = " ".join(lines)[:300] or "it said nothing"
        raise LiftgateError(f"the ECU's process did not take part: {detail}")
    return [Event(float(match[1]), IN_WORDS, match[2]) for match in matches]
