"""Evaluation of the pack: python -m tools.pack [--output FOLDER] [--realtime NAME …]

It writes pack.md. With --realtime it compares scenarios of the pack on a virtual bus in real time with the free
clock, once with nothing else on the machine and once beside two busy processes: the named scenarios, or all. Only
with all it writes pack-realtime.md.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from liftgate_hil.doctor.check import ROOT, Check
from liftgate_hil.doctor.examination import Examination
from liftgate_hil.doctor.request import DoctorRequest
from liftgate_hil.doctor.timing import steal, stolen_percent
from liftgate_hil.plan.request import Job, RunRequest
from liftgate_hil.testing import scenario_files, suite
from liftgate_hil.testing.mutation import mutate
from liftgate_hil.testing.outcome import Outcome
from tools.busy import busy_processes
from tools.pack import page

_LOADS = {"With nothing else": 0, "Beside two busy processes": 2}  # number of processes that never wait

_LOOK_S = 60.0  # about as long as scenarios take, to see rare delays
# Checks of `doctor` on how well the machine keeps time; the page itself explains what that means for tests.
_TIMING = ("kernel", "CPUs", "virtual machine", "lateness", "without FIFO", "stolen time", "real time", "tick")


def main(arguments: Sequence[str] | None = None) -> int:
    """Write pack.md, or with --realtime print the differences of real time.

    With --realtime and no name, pack-realtime.md is written too.
    """
    parser = argparse.ArgumentParser(prog="python -m tools.pack", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs"))
    parser.add_argument("--realtime", nargs="*", metavar="NAME", help="default: all")
    args = parser.parse_args(arguments)
    args.output.mkdir(parents=True, exist_ok=True)
    files = scenario_files.scenario_files(["pack"])
    if args.realtime is not None:
        chosen = [each for each in files if not args.realtime or each.stem in args.realtime]
        checks = [] if args.realtime else _examined()
        free, conditions = _on(chosen, "free"), []
        for name, count in _LOADS.items():
            before = steal(ROOT)
            with busy_processes(count):
                outcomes = _on(chosen, "realtime")
            stolen = stolen_percent(before, steal(ROOT))
            conditions.append(page.Condition(name, outcomes, stolen))
            print(f"{name}: {page.differences(free, outcomes)}", flush=True)
        if not args.realtime:
            text = page.realtime_page(free, conditions, checks)
            (args.output / "pack-realtime.md").write_text(text, encoding="utf-8")
        return 0
    jobs = len(os.sched_getaffinity(0))
    cases = suite.cases_of(files, _job("free"))
    suite.run_case(cases[0])  # compiles the machine code, before the time is measured
    began = time.monotonic()
    done = {each.case.file: each for each in suite.run_suite(cases, jobs)}
    seconds = time.monotonic() - began
    outcomes = [done[case.file] for case in cases]
    matrix = mutate(outcomes, jobs)
    text = page.pack_page(outcomes, matrix, seconds, jobs)
    (args.output / "pack.md").write_text(text, encoding="utf-8")
    return 0


def _examined() -> list[Check]:
    """Return the checks of `doctor` on how well this machine keeps time."""
    found = Examination(
        DoctorRequest(rate=1000.0, duration=_LOOK_S, realtime=True),
        lambda check: None,
        lambda text, seconds: print(text),
    )
    found.run()
    return [each for each in found.checks if each.check in _TIMING]


def _job(clock: str) -> Job:
    return Job(RunRequest(clock=clock, realtime=clock == "realtime"))


def _on(files: Sequence[Path], clock: str) -> list[Outcome]:
    found = []
    for case in suite.cases_of(files, _job(clock)):
        found.append(suite.run_case(case))
        print(f"{clock}: {case.file}: {found[-1].verdict}", flush=True)
    return found


if __name__ == "__main__":
    sys.exit(main())
