"""Run the stages of `make test` or of CI, several at a time: `python -m tools.stages test|ci`.

Each stage is a target of the Makefile. The log of the longest is shown as it grows, the others' when they have
ended; all are kept in out/stages. The end says what ran, how long it took and what failed. Exit code 1: something
failed.
"""

from __future__ import annotations

import argparse
import codecs
import contextlib
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
LOGS = ROOT / "out" / "stages"
_PATIENCE_S = 3600.0  # after which a stage counts as hung and is ended
_LEAVE_S = 10.0  # for what is told to end
_LOOK_S = 0.5

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


def run_stage(stage: str, shown: IO[str] | None, stopping: threading.Event) -> Outcome:
    """Run a stage and return its outcome; its log goes to a file, and to `shown` while it grows.

    It is ended with all that it has started once `stopping` is set, or when its time is over. Raises OSError.
    """
    log, began = LOGS / f"{stage}.log", time.monotonic()
    with log.open("w", buffering=1, encoding="utf-8") as file:
        process = subprocess.Popen(
            ["make", "--no-print-directory", stage],
            cwd=ROOT,
            env={"VCAN": "optional", **os.environ},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            process_group=0,
        )
        is_whole = False
        try:
            outputs = [each for each in (file, shown) if each is not None]
            is_whole = _is_copied(process, outputs, began + _PATIENCE_S, stopping)
        finally:
            code = _end(process, is_whole)
    found = outcome_of(stage, code, time.monotonic() - began, log.read_text(encoding="utf-8"))
    return found if is_whole else found._replace(closing=f"was ended {found.closing}".rstrip())


def _is_copied(
    process: subprocess.Popen[bytes], outputs: Sequence[IO[str]], until: float, stopping: threading.Event
) -> bool:
    """Copy what a process prints, and return whether it has come to its end."""
    assert process.stdout is not None
    decoder = codecs.getincrementaldecoder("utf-8")("replace")
    while time.monotonic() < until and not stopping.is_set():
        if not select.select([process.stdout], [], [], _LOOK_S)[0]:
            if process.poll() is not None:  # what it has left behind may keep its output open
                return True
            continue
        part = os.read(process.stdout.fileno(), 65536)
        for each in outputs:
            each.write(decoder.decode(part))
            each.flush()
        if not part:
            return True
    return False


def _end(process: subprocess.Popen[bytes], is_whole: bool) -> int:
    """Return a stage's exit code; one that has not come to its end is ended before, with all of its group."""
    if not is_whole:
        _tell(process, signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_LEAVE_S)
        _tell(process, signal.SIGKILL)
    return process.wait()


def _tell(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):  # all have ended
        os.killpg(process.pid, number)


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
    stopping = threading.Event()

    def follow(lane: Sequence[str], shown: IO[str] | None) -> None:
        for stage in lane:
            for needed in NEEDS.get(stage, ()):
                if needed in ended:
                    ended[needed].wait()
            try:
                if not stopping.is_set():
                    outcomes[stage] = run_stage(stage, shown, stopping)
            except OSError as error:
                outcomes[stage] = Outcome(stage, 1, 0.0, str(error), ())
            finally:
                ended[stage].set()

    threads = [threading.Thread(target=follow, args=(lane, None)) for lane in lanes[1:]]
    for each in threads:
        each.start()
    try:
        follow(lanes[0], shown)
        for each in threads:
            each.join()
    except BaseException:  # Ctrl-C
        stopping.set()
        for event in ended.values():  # no stage begins any more, whatever it waits for
            event.set()
        raise
    for stage in (stage for lane in lanes[1:] for stage in lane):
        if (LOGS / f"{stage}.log").is_file():
            log = (LOGS / f"{stage}.log").read_text(encoding="utf-8")
            print(f"----- {stage}", log.rstrip("\n"), sep="\n", file=shown, flush=True)
    return [outcomes[stage] for lane in lanes for stage in lane]


def main() -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plan", choices=PLANS)
    plan = PLANS[parser.parse_args().plan]
    shutil.rmtree(LOGS, ignore_errors=True)
    LOGS.mkdir(parents=True)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    began = time.monotonic()
    try:
        outcomes = run_plan(plan, sys.stdout)
    except KeyboardInterrupt:
        print("stages: stopped", file=sys.stderr)
        return 128 + signal.SIGINT
    print("----- what ran, how long, what failed")
    print("\n".join(line for each in outcomes for line in each.lines()))
    failed = [each.stage for each in outcomes if each.code != 0]
    print(f"{'FAILED: ' + ', '.join(failed) if failed else 'all passed'}, after {time.monotonic() - began:.0f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
