"""Run the stages of `make test` or of CI, several at a time: `python -m tools.stages test|ci`.

Each stage is a target of the Makefile. The log of the longest is shown as it grows, the others' when they have
ended; all are kept in out/stages. The end says what ran, how long it took and what failed. Exit code 1: something
failed.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
LOGS = ROOT / "out" / "stages"
_PATIENCE = 3600.0  # s, after which a stage counts as hung and is ended

# Lanes run side by side, the stages of a lane one after the other; the log of the first lane is shown as it grows.
# What waits runs beside what computes, but one stage of it at a time: it is judged by what it does in real time.
PLANS: dict[str, tuple[tuple[str, ...], ...]] = {
    "test": (("test-main",), ("compile",), ("lint", "test-vcan", "test-realtime", "test-browser")),
    "ci": (
        ("test-main",),
        ("compile",),
        (
            *("programs", "lint", "test-vcan", "test-realtime", "test-browser"),
            *("test-package", "test-other-pythons"),
        ),
    ),
}
# Stages that another one needs, in whichever lane. Machine code is compiled once; test-main begins with tests that
# do without that of the product.
NEEDS = {
    "test-main": ("programs",),
    "test-vcan": ("compile",),
    "test-realtime": ("compile",),
    "test-browser": ("compile",),
    "test-package": ("compile",),
}
# How pytest ends: a line between signs of equality; and its list of what failed.
_CLOSING = re.compile(r"^=+ (.*\d+ (?:passed|failed|skipped|error).*) in [\d.]+s.*=+$")
_FAILED = re.compile(r"^(?:FAILED|ERROR) \S+")


class Outcome(NamedTuple):
    """Outcome of a stage: its exit code, its duration [s], the closing line of its tests, and what failed."""

    stage: str
    code: int
    seconds: float
    closing: str
    failed: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the stage's lines of the summary."""
        result = "passed" if self.code == 0 else f"FAILED ({self.code})"
        return [f"{self.stage:<18} {result:<12} {self.seconds:7.1f} s  {self.closing}".rstrip(), *self.failed]


def run_stage(stage: str, shown: IO[str] | None) -> Outcome:
    """Run a stage and return its outcome; its log goes to a file, and to `shown` while it grows."""
    log, began = LOGS / f"{stage}.log", time.monotonic()
    with log.open("w", buffering=1, encoding="utf-8", errors="replace") as file:
        process = subprocess.Popen(
            ["make", "--no-print-directory", stage],
            cwd=ROOT,
            env={"VCAN": "optional", **os.environ},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )
        assert process.stdout is not None
        watch = threading.Timer(_PATIENCE, process.kill)
        watch.start()
        # By the letter: a line of pytest's dots takes minutes.
        while part := process.stdout.read(1):
            file.write(part)
            if shown is not None:
                shown.write(part)
                shown.flush()
        code = process.wait()
        watch.cancel()
    return outcome_of(stage, code, time.monotonic() - began, log.read_text(encoding="utf-8"))


def outcome_of(stage: str, code: int, seconds: float, log: str) -> Outcome:
    """Return the outcome of a stage with this log."""
    lines = log.splitlines()
    closings = [found[1] for each in lines if (found := _CLOSING.match(each))]
    failed = tuple(dict.fromkeys(f"    {each}" for each in lines if _FAILED.match(each)))
    return Outcome(stage, code, seconds, ", ".join(closings), failed)


def run_plan(lanes: Sequence[Sequence[str]], shown: IO[str]) -> list[Outcome]:
    """Run lanes side by side and return the outcomes of all stages, in the order of the lanes."""
    outcomes: dict[str, Outcome] = {}
    ended = {stage: threading.Event() for lane in lanes for stage in lane}

    def follow(lane: Sequence[str], shown: IO[str] | None) -> None:
        for stage in lane:
            for needed in NEEDS.get(stage, ()):
                if needed in ended:
                    ended[needed].wait()
            outcomes[stage] = run_stage(stage, shown)
            ended[stage].set()

    threads = [threading.Thread(target=follow, args=(lane, None)) for lane in lanes[1:]]
    for each in threads:
        each.start()
    follow(lanes[0], shown)
    for each in threads:
        each.join()
    for stage in (stage for lane in lanes[1:] for stage in lane):
        log = (LOGS / f"{stage}.log").read_text(encoding="utf-8")
        print(f"----- {stage}", log.rstrip("\n"), sep="\n", file=shown, flush=True)
    return [outcomes[stage] for lane in lanes for stage in lane]


def main() -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plan", choices=PLANS)
    plan = PLANS[parser.parse_args().plan]
    LOGS.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    outcomes = run_plan(plan, sys.stdout)
    print("----- what ran, how long, what failed")
    print("\n".join(line for each in outcomes for line in each.lines()))
    failed = [each.stage for each in outcomes if each.code != 0]
    print(f"{'FAILED: ' + ', '.join(failed) if failed else 'all passed'}, after {time.monotonic() - began:.0f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
