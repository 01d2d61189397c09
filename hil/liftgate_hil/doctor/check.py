"""Result of a check, and helpers for checks.

Checks are functions from the machine's own files to a `Check` or a list of them; they take the root of these
files, so that the files of any machine can be checked.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from liftgate_hil.described_result import Shown

Level = Literal["ok", "warning", "problem"]

ROOT = Path("/")


class Check(NamedTuple):
    """Result of one check of the machine."""

    check: Annotated[str, Shown("name of what was checked")]
    level: Annotated[Level, Shown("`ok`; `warning`: works, but not at its best; `problem`: no real time")]
    found: Annotated[str, Shown("what was found, in words")]
    advice: Annotated[str, Shown("how to fix it; empty where it is ok")] = ""

    def lines(self) -> list[str]:
        """Return the check's result as lines of text."""
        lines = [f"{self.level:<8} {self.check:<18} {self.found}"]
        if self.advice:
            lines.append(f"{'':<8} {'':<18} -> {self.advice}")
        return lines


def judged(check: str, found: str, mend: str = "") -> Check:
    """Return a check of level `warning` with the remedy `mend`, or of level `ok` where `mend` is empty."""
    return Check(check, "warning" if mend else "ok", found, mend)


def read(root: Path, name: str) -> str:
    """Return the text of a system file, stripped; "" where it cannot be read."""
    try:
        return (root / name).read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def number(text: str, default: int) -> int:
    """Convert a text to a whole number; return `default` where it is not one."""
    try:
        return int(text)
    except ValueError:
        return default


def ranges(cpus: list[int]) -> str:
    """Return CPU numbers as text with ranges, such as 0-3,6."""
    parts: list[str] = []
    first = last = None
    for cpu in [*sorted(cpus), None]:
        if last is not None and cpu == last + 1:
            last = cpu
            continue
        if first is not None:
            parts.append(str(first) if first == last else f"{first}-{last}")
        first = last = cpu
    return ",".join(parts)
