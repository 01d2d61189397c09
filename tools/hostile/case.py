"""A case: files in a folder of its own, a call of the command line there, and what came of it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class Case:
    """One call. The same seed and name make the same one again."""

    name: str  # kind and number
    arguments: list[str]
    what: str  # in words: how it is wrong
    outputs: list[str] = field(default_factory=list)  # files that are whole where the code is 0


@dataclass(frozen=True)
class Outcome:
    """What came of it."""

    code: int  # as a shell says it: 128 + the signal's number
    stdout: str
    stderr: str
    seconds: float
    is_late: bool = False  # it was killed, or took too long to end after a signal


def keep(folder: Path, case: Case, outcome: Outcome, faults: list[str]) -> None:
    """Write down beside a case's files what there is to know of it."""
    text = json.dumps(
        {"case": asdict(case), "outcome": asdict(outcome), "faults": faults}, indent=1
    )
    (folder / "CASE.json").write_text(text, encoding="utf-8")
