"""The gate in a closed loop with the ECU that `--ecu` names."""

from __future__ import annotations

import argparse
import collections
import contextlib
import math
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import IO, TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.cli.panel import PanelView
from liftgate_hil.cli.progress import AFTER_S
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.cli.teller import Teller
from liftgate_hil.ecu.names import ON_A_BUS, REFERENCE
from liftgate_hil.errors import ConfigError, EcuError
from liftgate_hil.isolate.children import end, foreign_output
from liftgate_hil.isolate.supervisor import dies_with_parent
from liftgate_hil.judging.verdict import ERROR
from liftgate_hil.loop.priority import has_fifo

if TYPE_CHECKING:
    from liftgate_hil.config.vehicle_choice import WireChoice
    from liftgate_hil.drive.result import Result
    from liftgate_hil.ecu.events import Event
    from liftgate_hil.loop.listener import Listener
    from liftgate_hil.plan.job import Job
    from liftgate_hil.plan.plan import Plan
    from liftgate_plant.vehicle import Vehicle

_USAGE = 2  # exit code for wrong usage or configuration
_EVENT = re.compile(r"^ecu\s+(\d+\.\d+) s  (.*)$")
_OWN_ERROR = "liftgate-hil: "  # begin of the line with which our commands report an error
_LEAVE_S = 5.0  # s, time for the ECU's process to end
_PAGE_LEAVES_S = 2.0  # s, time for the page's, from which nothing can be lost
_BEGIN_S = 600.0  # s until a run begins, which may have to be compiled before


def run_loop(
    args: argparse.Namespace,
    stopped: StopSignals,
    exit_codes: Mapping[str, int],
    wire: WireChoice | None,
    trace: int = 0,
    gives_up_late: bool = False,
) -> Result:
    """Run the gate with its ECU and return the result; `exit_codes` of the command are told on the page.

    Without a `wire` and on a virtual bus the ECU is in this process, or in a worker of its own; on any other bus
    it is a second process there. With `gives_up_late` a run ends at the first lateness after which its verdicts
    are not all known. Raises LiftgateError; what went wrong in the run is in the result.
    """
    from liftgate_hil.config.rig_fit import notes_on_fit
    from liftgate_hil.config.scenario import stimuli_after
    from liftgate_hil.drive.run import execute
    from liftgate_hil.plan.plan import plan_of

    teller = Teller(args.quiet, args.json, f"{args.rate:g} Hz, clock {args.clock}")
    job = _job_of(args, exit_codes, wire, trace, gives_up_late, teller)
    with teller.progress("preparing the run"):
        plan = plan_of(job)
    vehicle = plan.setup.vehicle
    after_s = AFTER_S if args.clock == "free" else 0.0  # in real time the first seconds count, too
    teller.sees(PanelView(math.degrees(vehicle.gate.open_angle), plan.duration, vehicle.drives, after_s))
    page = _page_process(args, teller)
    is_here = plan.way is None or plan.way.is_interface("virtual")
    try:
        with page:
            if args.ecu == ON_A_BUS or is_here:
                result = execute(plan, stopped)
            else:
                result = _with_process(args, plan, stopped)
    except EcuError as error:  # the ECU could not be created, or its process failed
        raise stopped.failure(str(error)) from error
    finally:
        teller.clear()
    # Who shortens a run with --duration knows that it ends before the rest of its scenario.
    known = [] if args.duration is None else stimuli_after(plan.setup.scenario, args.duration)
    known += notes_on_fit(plan.rig, plan.setup.vehicle, plan.request.rate)  # said before the run
    for note in result.notes:
        if note not in known:
            teller.say(f"note: {note}")
    return result


def _with_process(args: argparse.Namespace, plan: Plan, stopped: StopSignals) -> Result:
    """Run the gate with the ECU in a second process on the same bus. Raises LiftgateError.

    The ECU gets its requests by its own clock, so that no precondition is possible. Its machine code is compiled
    before, so that the run does not begin without it.
    """
    from liftgate_compiler import GivenUpError
    from liftgate_hil.drive.compilation import reporting_compilation
    from liftgate_hil.drive.run import execute
    from liftgate_hil.ecu.adapter import Adapter
    from liftgate_hil.ecu.peer import machine_code
    from liftgate_hil.loop.listener import Relay

    with contextlib.suppress(GivenUpError), reporting_compilation(plan.job.listener, stopped):
        machine_code(Adapter(plan.rig, plan.setup.vehicle.drives))

    relay = Relay(plan.job.listener)  # so that attached clients get the events of the ECU's process, too
    job = plan.job.asking(ecu=ON_A_BUS)
    job = replace(job, ecu_elsewhere=plan.job.request.ecu, is_isolated=False, listener=relay)
    plan = plan.varied(job)
    with _ecu_process(args, plan.setup.vehicle, job.listener) as child:
        result = execute(plan, lambda: stopped() or child.has_ended())
        try:
            child.end(was_stopped=stopped(), has_taken_part=bool(result.summary.received.accepted))
        except EcuError as error:
            reason = "; ".join(filter(None, (str(error), result.reason if result.verdict == ERROR else "")))
            return replace(result, verdict=ERROR, reason=reason, events=child.events)
    return result if result.verdict == ERROR else replace(result, events=child.events)


def _job_of(
    args: argparse.Namespace,
    exit_codes: Mapping[str, int],
    wire: WireChoice | None,
    trace: int,
    gives_up_late: bool,
    teller: Teller,
) -> Job:
    from liftgate_hil.ecu.find import is_foreign
    from liftgate_hil.plan.job import Job

    return Job(
        options.run_request(args),
        wire,
        trace=trace,
        gives_up_late=gives_up_late,
        is_isolated=is_foreign(args.ecu),
        attachable_as=os.getpid(),
        exit_codes=exit_codes,
        listener=teller,
    )


@contextlib.contextmanager
def _page_process(args: argparse.Namespace, teller: Listener) -> Iterator[None]:
    """Context in which a process of `liftgate-hil dashboard` shows this run, if requested. Raises ConfigError."""
    if not args.dashboard:
        for name, given in (("listen", args.listen), ("read_only", args.read_only)):
            if given:
                raise ConfigError(f"`{name}`: allowed together with `dashboard`")
        yield
        return
    from liftgate_hil.cli import dashboard
    from liftgate_hil.dashboard.listening import bound, new_token

    if args.clock == "free":
        text = "a run on the free clock ends at once; allowed: clock realtime or lockstep"
        raise ConfigError(f"`dashboard`: {text}")
    dashboard.check_installed()
    new_token()  # checks the token of the environment
    listen = args.listen or options.LISTEN
    wire = bound(options.address_of(listen))
    command = [sys.executable, "-P", "-m", "liftgate_hil", "dashboard", "--listen", listen]
    command += ["--attach", str(os.getpid()), "--patience", str(_BEGIN_S)]
    command += ["--descriptor", str(wire.fileno())]
    command += ["--read-only"] if args.read_only else []
    child = subprocess.Popen(
        command,
        stdout=foreign_output(),
        start_new_session=True,  # Ctrl-C shall reach only the run
        pass_fds=[wire.fileno()],
        preexec_fn=dies_with_parent,  # noqa: PLW1509
    )
    host, port = wire.getsockname()[:2]
    wire.close()
    again = f"liftgate-hil dashboard --attach {os.getpid()} --listen {f'[{host}]' if ':' in host else host}:{port}"
    again += " --read-only" if args.read_only else ""
    has_ended = threading.Event()  # the run

    def watch() -> None:
        code = child.wait()
        if not has_ended.is_set():
            teller.say(f"the page has ended (exit code {code}), the run goes on; to have one again: {again}")

    watcher = threading.Thread(target=watch, name="page", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        has_ended.set()
        end(child, _PAGE_LEAVES_S)
        watcher.join(_PAGE_LEAVES_S)


@contextlib.contextmanager
def _ecu_process(args: argparse.Namespace, vehicle: Vehicle, teller: Listener) -> Iterator[EcuProcess]:
    """Context with `liftgate-hil ecu` on the same bus; the process ends with the context."""
    command = [sys.executable, "-P", "-m", "liftgate_hil", "ecu"]
    command += ["--drives", str(vehicle.drives), "--ecu", args.ecu]
    command += ["--coding", ",".join(map(str, vehicle.coding))]
    for flag in ("scenario", "rig", "bus", "interface", "channel", "bitrate"):
        value = getattr(args, flag)
        if value is not None:
            command += [f"--{flag}", str(value)]
    if getattr(args, "ecu_serial", None) is not None:
        command += ["--serial", args.ecu_serial]
    # It does not report again what the gate's loop reports to be refused.
    is_asked = args.realtime or (args.realtime is None and args.clock == "realtime" and has_fifo())
    command += ["--fd"] * args.is_fd + ["--realtime" if is_asked else "--no-realtime"]
    child = EcuProcess(command, teller, is_ours=args.ecu == REFERENCE)
    try:
        yield child
    finally:
        child.kill()


def _begin_child() -> None:
    """Prepare a child, which a Ctrl-C to all processes of a terminal must not end while Python starts in it."""
    dies_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class EcuProcess:
    """Process of an ECU on the bus; a thread reads its stderr all the time, so that the pipe never fills up.

    The reference ECU (`is_ours`) prints its events there, which are collected and reported to `teller`; all other
    lines are passed on to `teller` as they are.
    """

    def __init__(self, command: list[str], teller: Listener, is_ours: bool) -> None:
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=foreign_output(),
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            # The ECU must end if this process is killed; a thread that runs here already, of the page, only waits.
            preexec_fn=_begin_child,  # noqa: PLW1509
        )
        self._teller = teller
        self._is_ours = is_ours
        self.events: list[Event] = []  # that it has printed
        self._errors: list[str] = []
        self._others: collections.deque[str] = collections.deque(maxlen=20)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        from liftgate_hil.ecu.events import IN_WORDS, Event

        stream: IO[str] | None = self._process.stderr
        assert stream is not None
        for line in stream:
            match = _EVENT.match(line) if self._is_ours else None
            if match:
                self.events.append(Event(float(match[1]), IN_WORDS, match[2]))
                self._teller.happened(float(match[1]), match[2])
                continue
            if line.startswith(_OWN_ERROR):
                self._errors.append(line.removeprefix(_OWN_ERROR).strip())
            self._others.append(line.strip())
            self._teller.say(line.rstrip())

    def has_ended(self) -> bool:
        """Whether the process has ended by itself."""
        return self._process.poll() is not None

    def end(self, was_stopped: bool, has_taken_part: bool) -> None:
        """End the process of a run, which a signal may have stopped.

        Raises ConfigError or EcuError where it had failed or fails now, had ended too early, or is ours and has
        not taken part in a run that was not stopped.
        """
        has_ended = self.has_ended()
        self.kill()
        code = self._process.returncode
        self._reader.join(_LEAVE_S)  # a process that it has started may hold the pipe
        usual = {-signal.SIGTERM, -signal.SIGKILL}
        if was_stopped:
            usual |= {-signal.SIGINT, 128 + signal.SIGINT}
        if code and (code not in usual or (has_ended and not was_stopped)):
            text = "; ".join(self._errors or self._others)[-300:] or f"exit code {code}"
            kind = ConfigError if code == _USAGE else EcuError
            raise kind(f"the ECU's process: {text}")
        if has_ended and not was_stopped:
            raise EcuError("the ECU's process ended before the run")
        if not (self.events or has_taken_part) and self._is_ours and not was_stopped:
            text = "; ".join(self._others)[-300:] or "it printed nothing"
            raise EcuError(f"the ECU's process did not take part: {text}")

    def kill(self) -> None:
        """End the process at once; its supervisor, if any, ends the processes that it has started."""
        end(self._process, _LEAVE_S)
