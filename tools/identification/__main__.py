"""Study of identification, its estimates and their uncertainty: writes docs/identification.md and its picture.

The study takes some ten minutes: 600 estimations for the coverage, and scipy's side of the comparison with
measured voltage.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
import scipy

import liftgate_hil as lh
from liftgate_hil.identification.reporting.figures import trace_figure
from liftgate_hil.report.drawing import png
from tools.benchmark.machine import machine_lines
from tools.identification import coverage, dc_motor, thesis, versus
from tools.identification.measurements import write_thesis_data

WHY = """
The inductance cannot be identified: its time constant L/R is 20 µs (62 µs with the data sheet's resistance),
and nothing in a measurement at 1 kHz, less so one thinned out to 100 Hz, depends on it; its standard deviation
is of the order of its value or many times that. Resistance, inertia and the motor constants set levels and
slopes that last for seconds, and are sharp. `motor.load_torque` acts only through (1 - η_M) M_0, a few percent
of all friction, so it takes up what the rigid model lacks of the plant that made the data (the play, the
mechanism's give): these estimates are sharper than they are right, as the thesis's may be. The full plant below
has no such fault. In run 2 inertia and load stay at their data-sheet values, which are not the truth here; what
is estimated makes up for it.
""".strip()


def main() -> int:
    """Run all parts of the study and write the page, or with --data only write the generated measurements."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", default="docs", metavar="FOLDER")
    parser.add_argument("--seeds", type=int, default=200, metavar="N")
    parser.add_argument("--dc-motor", metavar="FOLDER", help="the public data; see dc_motor.py")
    parser.add_argument("--short", action="store_true", help="leave out scipy with measured voltage")
    parser.add_argument("--data", metavar="FOLDER", help="only write the generated measurements there")
    parser.add_argument("--picture", action="store_true", help="only draw the picture, which takes some seconds")
    args = parser.parse_args()
    Path(args.output).mkdir(parents=True, exist_ok=True)
    if args.data:
        write_thesis_data(Path(args.data))
        return 0
    if args.picture:
        with tempfile.TemporaryDirectory() as name:
            write_thesis_data(Path(name))
            _picture(Path(name), Path(args.output) / "identification.png")
        return 0
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        lines = [
            "# Identification: what it finds, and how sure it is",
            "",
            "Made by `make study` on",
            "",
            *machine_lines(),
            f"- numpy {np.__version__}, scipy {scipy.__version__}",
            "",
            *_thesis(work, Path(args.output)),
            *_coverage(args.seeds),
            *_versus(work, args.short),
            *_dc_motor(work, args.dc_motor),
        ]
    text = "\n".join(lines) + "\n"
    (Path(args.output) / "identification.md").write_text(text, encoding="utf-8")
    print(text)
    return 0


def _say(what: str) -> None:
    print(f"  {what}", file=sys.stderr, flush=True)


def _thesis(work: Path, output: Path) -> list[str]:
    _say("the thesis's runs")
    write_thesis_data(work)
    lines = [
        "## The three runs of the thesis",
        "",
        "The thesis's raw data are not public. `python -m tools.identification --data FOLDER` writes an "
        "opening and a closing of the full plant with true values near what the thesis found, through "
        "sensors like its own "
        "(`tools/identification/measurements.py`). As in the thesis the seal's phase is cut and the data are "
        "thinned out: `liftgate-hil identify opening.csv --preset thesis-1 --cut-angle 1:78 --decimate 10`.",
    ]
    for number, (preset, found) in enumerate(thesis.RUNS.items(), 1):
        title = {1: "Table 4.1", 2: "Table 4.2", 3: "no table in the thesis"}[number]
        result = thesis.run(work, preset, **thesis.CUT)
        lines += ["", f"### Run {number}, `--preset {preset}` ({title})", "", *thesis.table(result, found)]
    full = thesis.run(work, "thesis-1", model="full")
    lines += [
        "",
        "### Run 1 by the full plant, nothing cut or thinned out: `--preset thesis-1 --model full`",
        "",
        *thesis.table(full, {}),
        "",
        WHY,
        "",
        "![Measured and simulated, run 1](identification.png)",
        "",
    ]
    _picture(work, output / "identification.png")
    return lines


def _picture(work: Path, target: Path) -> None:
    """Write the counterpart of the thesis's figure 4.7: run 1, measured and simulated."""
    result = lh.identify(work / "opening.csv", preset="thesis-1", **thesis.CUT)
    target.write_bytes(png(trace_figure(result.experiments[0])))


def _coverage(seeds: int) -> list[str]:
    found = []
    for case in coverage.CASES:
        _say(case.name)
        found.append((case, coverage.scores(case, seeds)))
    return [
        f"## Do the intervals cover? {seeds} seeds each",
        "",
        "Of what was estimated from data of known truth, starting at the shipped SUV's values: how often the 95 % "
        "interval (± 1.96 std) covers the truth, and how far estimates are from it in standard deviations.",
        "",
        *coverage.table(found),
        "",
    ]


def _versus(work: Path, short: bool) -> list[str]:
    lines = [
        "## Speed: run 1 at 1 kHz",
        "",
        "The whole command, start-up included, medians of five; scipy's side without its imports, once. Same "
        "equations, same data, same unknowns (`tools/identification/versus.py`).",
        "",
    ]
    cases = (("Four steps of voltage, 10 s", 0.0, 10.0), ("A measured voltage (50 mV of noise), 2 s", 0.05, 2.0))
    for title, ripple, duration in cases:
        if short and ripple:
            continue
        _say(title)
        columns = versus.make_data(work / "run1.csv", ripple, duration)
        mine = versus.ours(work / "run1.csv", work / "run1.json")
        lines += [f"### {title}", "", *versus.table(mine, versus.theirs(columns)), ""]
    return lines


def _dc_motor(work: Path, folder: str | None) -> list[str]:
    if folder is None:
        return []
    _say("the public DC motor")
    return [
        "## A motor measured by others",
        "",
        "Public data of a geared DC motor (nebisman/DCMotor.jl, MIT licence; "
        "`tools/identification/dc_motor.py` says where and how): commanded voltage, a PRBS of two levels, "
        "and encoder counts of 20 ms for 82 s. The vehicle is a motor that is joined to no gate. Of voltage "
        "and speed alone gain, time constant and dead voltage can be identified.",
        "",
        *dc_motor.table(dc_motor.measure(Path(folder), work)),
        "",
        "The source's own dynamic model (67 ms) has a gain of 0.508 rev/s per V, which its own static curve "
        "contradicts; it takes the counted speed as if it were instantaneous. That the speed is a mean over 20 ms "
        "(`--speed-window`) and the delay are what makes the difference.",
    ]


if __name__ == "__main__":
    sys.exit(main())
