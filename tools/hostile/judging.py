"""Checks of a call's outcome against its contract: exit code, messages, and the files that it leaves."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from tools.hostile.case import Case, Outcome
from tools.hostile.running import CRASHED

# Messages of Python and its libraries, where the program should have printed its own.
_FOREIGN = re.compile(
    r"Traceback|Exception ignored|\w*Warning\b|Fatal Python|Segmentation|core dumped|LLVM ERROR|"
    r"leaked|Error in sys\.|object has no attribute"
)
# Messages that justify exit code 1; the last is due to this tool's own limit on what a case may write.
_FAILURES = ("diverged", "error", "File too large")
# Exit codes that are answers, not failures: files that differ, a verdict, frames that a bus did not accept.
_ANSWERS = {"compare": (1,), "judge": (1, 3), "replay": (1,)}
_LONGEST = 4000  # characters of a message; a list of allowed values needs many
_MOST_LINES = 150  # messages of one call


def _command(case: Case) -> str:
    return case.arguments[0] if case.arguments else ""


def faults_of_file(case: Case, folder: Path, outcome: Outcome) -> list[str]:
    """Return the faults in the outcome of a call with a mangled file; empty: none."""
    faults = common_faults(outcome)
    lines = [line for line in outcome.stderr.splitlines() if line.startswith("liftgate-hil")]
    if outcome.code and outcome.code in _ANSWERS.get(_command(case), ()) and outcome.stdout:
        return faults + (["it took too long"] if outcome.is_late else [])
    if outcome.is_late:
        faults.append("it took too long")
    elif outcome.code not in (0, 1, 2):
        faults.append(f"exit code {outcome.code}")
    elif outcome.code and not lines:
        faults.append("an exit code and no message")
    elif outcome.code == 1 and not any(reason in line for line in lines for reason in _FAILURES):
        faults.append("exit code 1 for what is in a file")
    if len(set(lines)) < len(lines):
        faults.append("a message twice")
    if any(len(line) > _LONGEST for line in lines) or len(lines) > _MOST_LINES:
        faults.append("messages that nobody can read")
    if outcome.code == 0 and not outcome.is_late:
        faults += whole_outputs(folder, case.outputs)
    if _command(case) == "convert" and not outcome.is_late:
        there = [each.name for each in folder.iterdir() if each.name.startswith("out.")]
        if len(there) != (outcome.code == 0):
            faults.append(f"exit code {outcome.code}, and written: {', '.join(there) or 'nothing'}")
    return faults


def common_faults(outcome: Outcome) -> list[str]:
    """Return the faults that no call may have: foreign messages on stderr, or a crash."""
    match = _FOREIGN.search(outcome.stderr)
    faults = [f"on stderr: {match[0]}"] if match else []
    if outcome.code == CRASHED or outcome.code in (134, 136, 139):
        faults.append("it crashed")
    return faults


def whole_outputs(folder: Path, names: list[str], is_finished: bool = True) -> list[str]:
    """Return the faults of the files that a call was to write.

    A file may be missing if the call was stopped early (`is_finished` is False).
    """
    faults = []
    for name in names:
        path = folder / name
        if not path.exists():
            if is_finished:
                faults.append(f"{name}: not written")
        elif path.suffix == ".csv":
            faults += [f"{name}: {fault}" for fault in _table_faults(path)]
        elif path.suffix in (".log", ".asc", ".blf", ".trc"):
            faults += [f"{name}: {fault}" for fault in _log_faults(path)]
    return faults


def _table_faults(path: Path) -> list[str]:
    content = path.read_bytes()
    if not content:
        return []
    if not content.endswith(b"\n"):
        return ["its last row is cut off"]
    lines = content.splitlines()
    if len({line.count(b",") for line in lines}) != 1:
        return ["rows of different lengths"]
    if len(lines) < 2:
        return []
    try:
        rows = np.loadtxt(lines[1:], delimiter=",", ndmin=2)
    except ValueError as error:
        return [f"no numbers: {error}"]
    return [] if np.all(np.isfinite(rows)) else ["a row that is not finite"]


def _log_faults(path: Path) -> list[str]:
    from liftgate_hil.config.can_libraries import can

    try:
        with can.LogReader(path) as reader:
            times = [message.timestamp for message in reader]
    except Exception as error:  # from a reader's parser, of any type
        return [f"cannot be read: {type(error).__name__}: {error}"]
    late = np.diff(times)
    return ["times that fall"] if len(late) and late.min() < -0.01 else []


def rows_in(path: Path) -> int:
    """Return the number of rows of a table below its header; 0 if the file does not exist."""
    return max(path.read_bytes().count(b"\n") - 1, 0) if path.exists() else 0
