"""Cases with signals: a command receives SIGINT or SIGTERM at a random moment, from its start-up to its end."""

from __future__ import annotations

import random
import re
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from tools.hostile.bases import Bases
from tools.hostile.case import Case, Outcome
from tools.hostile.judging import common_faults, rows_in, whole_outputs
from tools.hostile.running import Child

SIGNALS = {"SIGINT": signal.SIGINT, "SIGTERM": signal.SIGTERM}
_BUSY = 10.0  # time allowed to end, relative to the allowed CPU time, since the machine may be busy
_COLD = 0.15  # share of the cases that must compile first
_RECORDS = ["--record", "out.csv", "--record", "out.log"]


@dataclass(frozen=True)
class Command:
    """Command that is to be stopped by a signal.

    `seconds` is its duration without a signal, `is_endless` whether it only ends when it is stopped, and `outputs`
    are the files that it writes.
    """

    arguments: list[str]
    seconds: float
    is_endless: bool = False
    outputs: tuple[str, ...] = ()


def commands(bases: Bases) -> dict[str, Command]:
    """Return the commands that run long enough to be stopped, by name."""
    kept = str(bases.folder / "m.csv")
    both = ("out.csv", "out.log")
    return {
        "run": Command(["run", "--bus", "virtual:signals", *_RECORDS], 4.0, True, both),
        "demo": Command(["demo", "--no-record", *_RECORDS], 4.0, False, both),
        "demo-free": Command(
            ["demo", "--clock", "free", "--no-record", *_RECORDS], 3.0, False, both
        ),
        "simulate": Command(
            ["simulate", "--voltage", "12", "--duration", "1000", "--every", "10", "--output", "out.csv"],
            4.0, False, ("out.csv",),
        ),
        "identify": Command(
            ["identify", kept, "--estimate", "motor.resistance,motor.torque_constant,gear.friction_torque",
             "--result", "r.json", "--json"], 5.0,
        ),
        "validate": Command(["validate", kept, "--result", "r.json", "--json"], 2.0),
        "replay": Command(["replay", str(bases.folder / "demo.log"), "--bus", "virtual:signals"], 2.5),
        "convert": Command(["convert", kept, "out.mf4"], 1.5),
        "ecu": Command(["ecu", "--bus", "virtual:signals"], 3.0, True),
    }  # fmt: skip


def signal_case(
    bases: Bases, seed: int, number: int, folder: Path, patience: float
) -> tuple[Case, Outcome, list[str]]:
    """Run the case of this number; return it with its outcome and its faults.

    `patience` [s] is the CPU time that the command may use to end after the signal.
    """
    chance = random.Random(f"{seed}/signal/{number}")
    named = commands(bases)
    name = list(named)[number % len(named)]
    command = named[name]
    which = chance.choice(list(SIGNALS))
    delay = chance.uniform(0.0, 1.1 * command.seconds)
    is_cold = chance.random() < _COLD
    what = f"{name}: {which} after {delay:.3f} s{', compiling' * is_cold}"
    case = Case(f"signal-{number}", command.arguments, what)
    # With an empty cache the command compiles first, which takes longer than any delay.
    environment = {"XDG_CACHE_HOME": str(folder / "cache")} if is_cold else {}
    child = Child(case, folder, delay + 60.0, is_forked=False, environment=environment)
    began = time.monotonic()
    while time.monotonic() - began < delay and not child.poll():
        time.sleep(0.002)
    is_over = child.poll()
    sent = time.monotonic()
    child.signal(SIGNALS[which])
    while not child.poll():
        time.sleep(0.002)
    took = time.monotonic() - sent
    outcome = child.outcome()
    if is_pythons_own(outcome):
        return case, outcome, []
    faults = common_faults(outcome)
    used = 0.0 if is_cold else child.used_since_signal()  # a compiler's earlier CPU time would count
    if not is_over and (used > patience or took > _BUSY * patience):
        faults.append(f"it took {took:.2f} s to end, {used:.2f} s of CPU")
    if outcome.code not in _codes(command, SIGNALS[which], is_over):
        faults.append(f"exit code {outcome.code}")
    faults += whole_outputs(folder, list(command.outputs), is_finished=is_over)
    faults += _lost_rows(folder, outcome)
    return case, outcome, faults


def is_pythons_own(outcome: Outcome) -> bool:
    """Return whether the signal arrived while Python itself started, before any code of the program.

    The program cannot prevent that.
    """
    text = outcome.stderr
    return "KeyboardInterrupt" in text and "liftgate" not in text.replace("python -m liftgate_hil", "")


def _codes(command: Command, number: int, is_over: bool) -> set[int]:
    """Return the allowed exit codes: 0, and after a signal also 128 + its number.

    After a signal, 0 is for a command that runs until it is stopped, or that had just ended by itself.
    """
    return {0} if is_over else {0, 128 + number}


def _lost_rows(folder: Path, outcome: Outcome) -> list[str]:
    """Return a fault if the recording does not have one row for each tick of the printed summary; else nothing."""
    ticks = re.search(r"^ticks (\d+),", outcome.stdout, re.MULTILINE)
    if ticks is None or not (folder / "out.csv").exists():
        return []
    rows = rows_in(folder / "out.csv")
    return [] if rows == int(ticks[1]) else [f"{ticks[1]} ticks, {rows} rows recorded"]
