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
_PIPE_BYTES = 65536  # what a pipe holds (pipe(7))

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
# Stages that are judged by what they do in real time. While one of them runs there is a file, and the other stages
# get its name in their environment: with all CPUs busy the timed ones take longer, and twice the CPU time.
TIMED = ("test-vcan", "test-realtime", "test-browser")
_LEAVE_A_CPU = "LEAVE_A_CPU_WHILE"  # read in tests/conftest.py
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

    It is ended with its process group once `stopping` is set, or when its time is over. Raises OSError.
    """
    log, began = LOGS / f"{stage}.log", time.monotonic()
    with log.open("w", buffering=1, encoding="utf-8") as file:
        process = subprocess.Popen(
            ["make", "--no-print-directory", stage],
            cwd=ROOT,
            env={"VCAN": "optional", **os.environ, **({} if stage in TIMED else {_LEAVE_A_CPU: str(_timed())})},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            process_group=0,
        )
        outputs = [each for each in (file, shown) if each is not None]
        try:
            has_ended = _copy(process, outputs, began + _PATIENCE_S, stopping)
        finally:
            _end(process)
    found = outcome_of(stage, process.wait(), time.monotonic() - began, log.read_text(encoding="utf-8"))
    return found if has_ended else found._replace(closing=f"was ended {found.closing}".rstrip())


def _timed() -> Path:
    """Return the path of the file that exists while a timed stage runs."""
    return LOGS / "timed"


def _copy(
    process: subprocess.Popen[bytes], outputs: Sequence[IO[str]], until: float, stopping: threading.Event
) -> bool:
    """Copy what a process prints until it has ended; return whether it has ended by itself.

    What it has left behind may keep its output open, and go on printing.
    """
    assert process.stdout is not None
    decoder, is_open = codecs.getincrementaldecoder("utf-8")("replace"), True
    while time.monotonic() < until and not stopping.is_set():
        has_ended = process.poll() is not None
        if is_open and select.select([process.stdout], [], [], 0.0 if has_ended else _LOOK_S)[0]:
            part = os.read(process.stdout.fileno(), _PIPE_BYTES)
            is_open, text = part != b"", decoder.decode(part)
            for each in outputs:
                each.write(text)
                each.flush()
        elif not has_ended and not is_open:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_LOOK_S)
        if has_ended:
            return True
    return False


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process that has not ended, with all of its group."""
    if process.poll() is not None:
        return
    os.killpg(process.pid, signal.SIGTERM)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_LEAVE_S)
    with contextlib.suppress(ProcessLookupError):  # else some of its group outlive it
        os.killpg(process.pid, signal.SIGKILL)


def outcome_of(stage: str, code: int, seconds: float, log: str) -> Outcome:
    """Return the outcome of a stage with this log."""
    lines = log.splitlines()
    closings = [found[1] for each in lines if (found := _CLOSING.match(each))]
    failed = tuple(dict.fromkeys(f"    {each}" for each in lines if _FAILED.match(each)))
    return Outcome(stage, code, seconds, ", ".join(closings), failed)


def run_plan(lanes: Sequence[Sequence[str]], shown: IO[str], stopping: threading.Event) -> list[Outcome]:
    """Run lanes side by side, until `stopping` is set; return the outcomes of all stages, in the lanes' order."""
    outcomes = {stage: Outcome(stage, 1, 0.0, "has not begun", ()) for lane in lanes for stage in lane}
    ended = {stage: threading.Event() for stage in outcomes}

    def follow(lane: Sequence[str], shown: IO[str] | None) -> None:
        for stage in lane:
            for needed in NEEDS.get(stage, ()):
                while needed in ended and not ended[needed].wait(_LOOK_S) and not stopping.is_set():
                    pass
            if stopping.is_set():
                return
            try:
                if stage in TIMED:
                    _timed().touch()
                outcomes[stage] = run_stage(stage, shown, stopping)
            except OSError as error:
                outcomes[stage] = outcomes[stage]._replace(closing=str(error))
            finally:
                if stage in TIMED:
                    _timed().unlink(missing_ok=True)
                ended[stage].set()

    threads = [threading.Thread(target=follow, args=(lane, None)) for lane in lanes[1:]]
    for each in threads:
        each.start()
    follow(lanes[0], shown)
    for each in threads:
        each.join()
    for stage in (stage for lane in lanes[1:] for stage in lane):
        if ended[stage].is_set() and (LOGS / f"{stage}.log").is_file():
            log = (LOGS / f"{stage}.log").read_text(encoding="utf-8")
            print(f"----- {stage}", log.rstrip("\n"), sep="\n", file=shown, flush=True)
    return list(outcomes.values())


def main() -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plan", choices=PLANS)
    plan = PLANS[parser.parse_args().plan]
    LOGS.mkdir(parents=True, exist_ok=True)
    _timed().unlink(missing_ok=True)
    stopping = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # none is lost, however often it comes
        signal.signal(number, lambda *_: stopping.set())
    began = time.monotonic()
    outcomes = run_plan(plan, sys.stdout, stopping)
    print("\n----- what ran, how long, what failed")
    print("\n".join(line for each in outcomes for line in each.lines()))
    failed = [each.stage for each in outcomes if each.code != 0]
    print(f"{'FAILED: ' + ', '.join(failed) if failed else 'all passed'}, after {time.monotonic() - began:.0f} s")
    if stopping.is_set():
        print("stopped")
        return 128 + signal.SIGINT
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
