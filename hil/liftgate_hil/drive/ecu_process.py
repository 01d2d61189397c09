"""The gate with its ECU in a second process on the same bus: `liftgate-hil ecu`."""

from __future__ import annotations

import collections
import contextlib
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import IO, TYPE_CHECKING

from liftgate_hil.drive.compilation import reporting_compilation
from liftgate_hil.drive.run import execute
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.names import ON_A_BUS, REFERENCE
from liftgate_hil.ecu.peer import machine_code
from liftgate_hil.errors import ConfigError, EcuError
from liftgate_hil.isolate.children import end, foreign_output
from liftgate_hil.isolate.supervisor import dies_with_parent
from liftgate_hil.judging.verdict import ERROR
from liftgate_hil.loop.listener import Relay
from liftgate_hil.loop.priority import has_fifo

if TYPE_CHECKING:
    from liftgate_hil.drive.result import Result
    from liftgate_hil.ecu.events import Event
    from liftgate_hil.loop.listener import Listener
    from liftgate_hil.plan.plan import Plan

_USAGE = 2  # exit code for wrong usage or configuration
_EVENT = re.compile(r"^ecu\s+(\d+\.\d+) s  (.*)$")
_OWN_ERROR = "liftgate-hil: "  # begin of the line with which our commands report an error
_LEAVE_S = 5.0  # s, time for the process to end


def execute_with_process(plan: Plan, ecu_serial: str | None, stopped: Callable[[], bool]) -> Result:
    """Run a plan with the ECU in a second process on its bus, or at the other end of a serial line.

    The ECU gets its requests by its own clock, so that no precondition is possible. Its machine code is compiled
    before, so that the run does not begin without it. Raises LiftgateError.
    """
    from liftgate_compiler import GivenUpError

    with contextlib.suppress(GivenUpError), reporting_compilation(plan.job.listener, stopped):
        machine_code(Adapter(plan.rig, plan.setup.vehicle.drives))
    relay = Relay(plan.job.listener)  # so that attached clients get the events of the ECU's process, too
    job = plan.job.asking(ecu=ON_A_BUS)
    job = job._replace(ecu_elsewhere=plan.job.request.ecu, is_isolated=False, listener=relay)
    varied = plan.varied(job)
    with _ecu_process(plan, ecu_serial, relay) as child:
        result = execute(varied, lambda: stopped() or child.has_ended())
        try:
            child.end(was_stopped=stopped(), has_taken_part=bool(result.summary.received.accepted))
        except EcuError as error:
            reason = "; ".join(filter(None, (str(error), result.reason if result.verdict == ERROR else "")))
            return replace(result, verdict=ERROR, reason=reason, events=child.events)
    return result if result.verdict == ERROR else replace(result, events=child.events)


@contextlib.contextmanager
def _ecu_process(plan: Plan, ecu_serial: str | None, listener: Listener) -> Iterator[EcuProcess]:
    """Context with `liftgate-hil ecu` on the same bus; the process ends with the context."""
    request, vehicle = plan.job.request, plan.setup.vehicle
    command = [sys.executable, "-P", "-m", "liftgate_hil", "ecu"]
    command += ["--drives", str(vehicle.drives), "--ecu", str(request.ecu)]
    command += ["--coding", ",".join(map(str, vehicle.coding))]
    for flag in ("scenario", "rig", "bus", "interface", "channel", "bitrate"):
        value = getattr(request, flag)
        if value is not None:
            command += [f"--{flag}", str(value)]
    command += [] if ecu_serial is None else ["--serial", ecu_serial]
    # It does not report again what the gate's loop reports to be refused.
    is_asked = request.realtime or (request.realtime is None and request.clock == "realtime" and has_fifo())
    command += ["--fd"] * request.is_fd + ["--realtime" if is_asked else "--no-realtime"]
    child = EcuProcess(command, listener, is_ours=request.ecu == REFERENCE)
    try:
        yield child
    finally:
        child.kill()


def _begin_child() -> None:
    """Make a child process die with its parent and ignore SIGINT, so that Ctrl-C does not interrupt its start."""
    dies_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class EcuProcess:
    """Process of an ECU on the bus; a thread reads its stderr all the time, so that the pipe never fills up.

    The reference ECU (`is_ours`) prints its events there, which are collected and reported to `listener`; all
    other lines are passed on as they are.
    """

    def __init__(self, command: list[str], listener: Listener, is_ours: bool) -> None:
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
        self._listener = listener
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
                self._listener.happened(float(match[1]), match[2])
                continue
            if line.startswith(_OWN_ERROR):
                self._errors.append(line.removeprefix(_OWN_ERROR).strip())
            self._others.append(line.strip())
            self._listener.say(line.rstrip())

    def has_ended(self) -> bool:
        """Whether the process has ended by itself."""
        return self._process.poll() is not None

    def end(self, was_stopped: bool, has_taken_part: bool) -> None:
        """End the ECU's process after a run; `was_stopped`: a signal has stopped the run.

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
        """Terminate the process, kill it after 5 s; its supervisor, if any, ends what the process has started."""
        end(self._process, _LEAVE_S)
