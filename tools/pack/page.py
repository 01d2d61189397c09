"""Pages docs/pack.md and docs/pack-realtime.md.

The first shows each scenario with its reason and smallest margins, and each mutant with the scenarios that find
it; the second shows the verdicts and margins in real time beside those of the free clock.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from liftgate_hil.doctor.check import Check
from liftgate_hil.ecu.mutants import MUTANTS
from liftgate_hil.judging.verdict import DIRECT, INCONCLUSIVE, REPLAY, Verdict
from liftgate_hil.testing.mutation import Matrix
from liftgate_hil.testing.outcome import Outcome
from tools.docs.markdown import MADE, code, page, table

_INTRO = """\
Scenarios that any gate ECU should pass: `liftgate-hil test pack --ecu …`. Each is a file of
[`configs/scenarios/pack`](../configs/scenarios/pack) with its reason at the top. They test what the gate does,
not how an ECU does it. Most wait for the gate instead of a time, so that they fit any travel time, and name
messages by the quantities that they carry, so that they fit any rig. An ECU that learns its gate makes a few
motions first (`precondition`). Numbers such as 15V415 are those of NHTSA recalls. Made by `make pack`, with the
reference ECU."""

_MUTANTS = """\
Do the scenarios find defects? Each mutant is the reference ECU with one defect, made by other
data ([`mutants.py`](../hil/liftgate_hil/ecu/mutants.py)). A scenario finds a mutant if an expectation fails
that passes with the reference ECU. `liftgate-hil test MY_SCENARIOS --mutants` does the same for your own."""

_REALTIME = """\
The same scenarios against the reference ECU on a virtual bus in real time, their verdicts on the free clock,
and the differences of the margins. In real time an ECU answers within its own cycle, not within a tick, and the
bench has a delay: the margins differ by the motion in that time.

- `direct`: the bench was never later in the window than the tolerance (half a command cycle, 5 ms).
- `replay`: it was later, and stepping the gate again with the commands as they arrived, earlier and later,
  confirms the verdict with a margin above its uncertainty.
- `inconclusive`: neither holds, or the verdict was decided after the gate had sent nothing for two cycles of its
  fastest message (10 ms), since an ECU may take that for a lost message.

Measured on an idle machine, and with two processes in parallel that use the CPU all the time. Made by `make
pack-realtime`, in about 75 minutes."""

_MOST = 4  # scenarios that are named for a mutant


def pack_page(outcomes: Sequence[Outcome], matrix: Matrix, seconds: float, jobs: int) -> str:
    """Return the page docs/pack.md; the scenarios took `seconds` with `jobs` at a time."""
    rows = [(code(_name(each)), each.verdict, _least(each), _reason(each)) for each in outcomes]
    found = [(code(each.name), each.meaning, _finders(matrix, each.name)) for each in MUTANTS.values()]
    idle = [f"* {code(Path(file).stem)}: {name}" for file, name in matrix.prove_nothing]
    made = page(
        "The pack",
        _INTRO,
        f"{len(outcomes)} scenarios took {seconds:.1f} s, {jobs} at a time; the code had been compiled before.",
        table(("scenario", "verdict", "smallest margin", "reason"), rows),
        "## Mutants",
        _MUTANTS,
        f"{len(matrix.killed)} of {len(MUTANTS)} are found.",
        table(("mutant", "defect", "found by"), found),
        "\n".join(["Expectations that pass with every mutant, and without an ECU:", "", *idle])
        if idle
        else "Each expectation fails with at least one mutant, or without an ECU.",
    )
    return made.replace(MADE, MADE.replace("make docs", "make pack"), 1)


def _name(outcome: Outcome) -> str:
    return Path(outcome.case.file).stem


def _least(outcome: Outcome) -> str:
    """Return the smallest margin of an outcome in each unit, as text; those of states and shares say nothing."""
    least: dict[str, float] = {}
    for each in outcome.expectations:
        if each.margin is not None and each.margin_unit:
            unit = each.margin_unit
            least[unit] = min(each.margin, least.get(unit, math.inf))
    return ", ".join(f"{margin:.3g} {unit}" for unit, margin in least.items()) or "—"


def _reason(outcome: Outcome) -> str:
    """Return the reason of a scenario, the comment at the top of its file."""
    text = Path(outcome.case.file).read_text(encoding="utf-8").split("\n\n")[0]
    return " ".join(line.removeprefix("#").strip() for line in text.splitlines())


def _finders(matrix: Matrix, mutant: str) -> str:
    names = list(dict.fromkeys(code(Path(file).stem) for file, _ in matrix.kills(mutant)))
    more = f" and {len(names) - _MOST} more" if len(names) > _MOST else ""
    return f"{', '.join(names[:_MOST])}{more}" if names else "**nothing**"


class Condition(NamedTuple):
    """Results of the pack in real time under one load of the machine."""

    name: str
    outcomes: Sequence[Outcome]
    stolen: Mapping[str, float]  # %, share of each CPU's time that the machine's host took


def realtime_page(free: Sequence[Outcome], conditions: Sequence[Condition], checks: Sequence[Check]) -> str:
    """Return the page docs/pack-realtime.md, with the checks of `doctor` on the machine."""
    checked = [(each.check, each.level, each.found) for each in checks]
    parts = []
    for each in conditions:
        kept = _kept_time(each.outcomes, each.stolen)
        parts += [f"## {each.name}", kept, differences(free, each.outcomes)]
    made = page(
        "The pack in real time",
        _REALTIME,
        table(("of the machine", "", "`liftgate-hil doctor --realtime`"), checked),
        *parts,
    )
    return made.replace(MADE, MADE.replace("make docs", "make pack-realtime"), 1)


def _kept_time(realtime: Sequence[Outcome], stolen: Mapping[str, float]) -> str:
    """Return a sentence on how well the bench kept time in all scenarios: missed ticks, and time the host took."""
    found = [each.result.summary for each in realtime if each.result is not None]
    missed, ticks = sum(each.overruns for each in found), sum(each.ticks for each in found)
    taken = " and ".join(f"{share:.2f} % of {name.upper()}'s" for name, share in stolen.items())
    return (
        f"While the scenarios ran, {missed} of {ticks} ticks were missed and made up for, and the machine's host "
        f"took {taken} time."
    )


def differences(free: Sequence[Outcome], realtime: Sequence[Outcome]) -> str:
    """Return a summary and a Markdown table of the verdicts and margins of both clocks, side by side."""
    rows, same, conclusive, methods, largest = [], 0, 0, Counter[str](), 0.0
    for ours, theirs in zip(free, realtime, strict=True):
        for one, other in zip(ours.expectations, theirs.expectations, strict=True):
            same += one.verdict == other.verdict
            conclusive += other.verdict != INCONCLUSIVE
            if other.verdict != INCONCLUSIVE:
                methods[other.method] += 1
                if other.margin and other.uncertainty:
                    largest = max(largest, other.uncertainty / abs(other.margin))
            apart = (
                f"{other.margin - one.margin:+.3g} {one.margin_unit}"
                if one.margin is not None and other.margin is not None
                else ""
            )
            rows.append(
                (
                    code(_name(ours)),
                    one.name,
                    one.verdict,
                    other.verdict,
                    other.method or "",
                    apart,
                    _doubt(other),
                    other.reason,
                )
            )
    heads = ("scenario", "expectation", "free", "real time", "by", "margin", "uncertainty", "why")
    share = 100.0 * conclusive / max(1, len(rows))
    text = (
        f"{same} of {len(rows)} match the free clock; {conclusive - same or 'none'} contradict it; "
        f"{len(rows) - conclusive} are inconclusive, so {share:.0f} % are conclusive: {methods[DIRECT]} directly, "
        f"{methods[REPLAY]} by replay. The uncertainty was at most {100.0 * largest:.0f} % of a margin."
    )
    return f"{text}\n\n{table(heads, rows)}"


def _doubt(verdict: Verdict) -> str:
    """Return the uncertainty of a verdict's margin, as text; empty: none."""
    if not verdict.uncertainty:
        return ""
    return f"{verdict.uncertainty:.2g} {verdict.margin_unit}".strip()
