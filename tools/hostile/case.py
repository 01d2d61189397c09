"""Case of the campaign: a call of the command line in a folder with files of its own, and its outcome."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Case:
    """Call of the command line in one case; the same seed and name make the same call again."""

    name: str  # kind and number
    arguments: list[str]
    what: str  # description of how the file is mangled, or of the signal
    outputs: list[str] = field(default_factory=list)  # files that must be complete if the exit code is 0


@dataclass(frozen=True)
class Outcome:
    """Outcome of the call of a case."""

    code: int  # exit code, as a shell reports it: 128 + number for a signal
    stdout: str
    stderr: str
    seconds: float
    is_late: bool = False  # it was killed after its time limit


def keep(folder: Path, case: Case, outcome: Outcome, faults: list[str]) -> None:
    """Write a case, its outcome and its faults to CASE.json, beside the case's files."""
    text = json.dumps({"case": asdict(case), "outcome": asdict(outcome), "faults": faults}, indent=1)
    (folder / "CASE.json").write_text(text, encoding="utf-8")
