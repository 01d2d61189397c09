"""Examination of this machine for real-time runs: all checks, one after the other."""

from __future__ import annotations

import contextlib
import os
import pwd
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated

import liftgate_compiler as compiler
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.doctor import buses, limits, machine, software, timing
from liftgate_hil.doctor.check import ROOT, Check
from liftgate_hil.doctor.request import DoctorRequest
from liftgate_hil.loop.histogram import Quantiles
from liftgate_hil.loop.priority import Realtime


@dataclass
class Examination:
    """Examination of this machine, with request and results; `tell` is called with each check once it is done."""

    request: DoctorRequest
    tell: Callable[[Check], None]
    say: Callable[[str, float], None]  # called with what takes a while, and how long [s]
    checks: list[Check] = field(default_factory=list)
    figures: timing.DoctorFigures | None = None  # None: not measured yet
    _modes: dict[str, timing.Wakeups] = field(default_factory=dict)
    _tick: Quantiles | None = None

    def run(self) -> None:
        """Run checks, then measurements, as far as platform and software permit, and always add the verdict."""
        self._add(machine.platform())
        if not self.problems():
            with contextlib.closing(buses.Detection()) as detection:
                self._look_at_machine()
                folder = compiler.cache_folder()
                self._add(software.versions(), software.model(compiler.enabled(), _is_compiled(), folder))
                self._add(buses.socketcan(), *buses.interfaces(ROOT, buses.ask_ip))
                self._add(buses.serial_ports(buses.list_ports(), user_name()))
                self._add(detection.wait())
            if all(check.check != "software" or check.level == "ok" for check in self.checks):
                self._measure()
        self._add(timing.verdict(self.request.rate, self._modes, self._tick, self.problems()))

    def problems(self) -> int:
        """Return the number of problems found so far."""
        return sum(check.level == "problem" for check in self.checks)

    def _add(self, *checks: Check) -> None:
        for check in checks:
            self.checks.append(check)
            self.tell(check)

    def _look_at_machine(self) -> None:
        allowed, user = os.sched_getaffinity(0), user_name()
        self._add(
            machine.kernel(ROOT),
            machine.cpus(ROOT, allowed),
            machine.isolated(ROOT, allowed, self.request.cpu),
            machine.quota(ROOT),
            machine.governor(ROOT),
            machine.virtual(ROOT),
            machine.clock(ROOT),
            machine.throttling(ROOT),
            limits.priority(ROOT, user),
            limits.memory(ROOT, user),
            limits.sleep_states(ROOT),
            limits.swap(ROOT, limits.may_lock_memory(ROOT)),
            limits.rivals(ROOT),
            limits.receive_buffer(ROOT),
        )

    def _measure(self) -> None:
        """Measure lateness (also with FIFO, if possible), stolen time, a tick's time; add checks and `figures`."""
        may = limits.may_have_fifo(ROOT)
        times = 2 if may or self.request.realtime else 1
        often = ("once", "twice")[times - 1]
        rate, duration = self.request.rate, self.request.duration
        self.say(f"measuring timer lateness, {often} {duration:g} s …", times * duration)
        before = timing.steal(ROOT)
        plain = timing.measure(rate, duration)
        self._modes[timing.WITHOUT] = plain
        fifo = self._measure_fifo() if may or self.request.realtime else None
        if fifo is None:
            self._add(timing.lateness("lateness", plain, rate, "allow the FIFO priority as advised above"))
        else:  # as runs are not unless --no-realtime is given
            found = timing.lateness("without FIFO", plain, rate)
            self._add(found._replace(level="ok", found=f"{found.found}; concerns runs with --no-realtime only"))
        self._add(timing.stolen(shares := timing.stolen_percent(before, timing.steal(ROOT))))
        if compiler.enabled() and _is_compiled():
            self._tick = timing.measure_tick(rate, Realtime(self.request.cpu) if fifo else None)
        self._add(timing.tick_cost(self._tick, rate))
        self.figures = timing.figures(rate, duration, plain, fifo, self._tick, shares)

    def _measure_fifo(self) -> timing.Wakeups | None:
        """Measure wake-up lateness with all that a real-time run requests; add checks; None: FIFO was refused."""
        realtime = Realtime(self.request.cpu, bool(self.request.realtime))
        wakeups = timing.measure(self.request.rate, self.request.duration, realtime)
        self._add(timing.given(realtime.refused, asked=bool(self.request.realtime)))
        if any(text.startswith("FIFO") for text in realtime.refused):
            return None
        self._modes[timing.WITH] = wakeups
        mend = "end other programs, isolate a CPU (isolcpus=), or boot a PREEMPT_RT kernel"
        self._add(timing.lateness("lateness", wakeups, self.request.rate, mend))
        return wakeups


def _is_compiled() -> bool:
    """Whether the compiled code of the real-time loop is in the cache."""
    from liftgate_hil.loop.realtime_loop import run_realtime

    return compiler.is_cached(run_realtime)


def user_name() -> str:
    """Return the name of the user who runs this program; "*", in limits.d for everybody, if there is no name."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # in a container a user may have no name
        return "*"


# fmt: off
@dataclass(frozen=True)
class DoctorReport(DescribedResult):
    """Report on a machine: its checks, and the measurements behind them."""

    is_fit: Annotated[bool, Shown("whether real time is possible: no check is a `problem`", key="fit")]
    checks: Annotated[tuple[Check, ...], Shown("all checks")]
    figures: Annotated[timing.DoctorFigures | None, Shown("the measurements")]
