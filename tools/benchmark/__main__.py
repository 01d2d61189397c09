"""Benchmark report of this machine: python -m tools.benchmark [--output FOLDER] [--against CHECKOUT] …

Writes benchmark.md and benchmark.png. Ratios are measured side by side in one run, so they are valid beyond this
machine. Absolute times are those of this machine at this moment.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import liftgate_compiler as compiler
from tools.benchmark import lateness
from tools.benchmark.checkouts import HERE
from tools.benchmark.effort import SHORT, WHOLE, Effort
from tools.benchmark.lateness_section import lateness_section
from tools.benchmark.machine import load_line, machine_lines
from tools.benchmark.sections import (
    campaign_section,
    cost_section,
    episode_section,
    identification_section,
    inactive_section,
    page_section,
    parts_section,
    replay_section,
    start_section,
    step_section,
    table_section,
)


def main() -> None:
    """Run the benchmarks that the command line selects."""
    parser = argparse.ArgumentParser(prog="python -m tools.benchmark", description=__doc__)
    parser.add_argument("--output", type=Path, metavar="FOLDER", help="default: docs; with --short: out")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=3.0, help="of each run of the lateness")
    parser.add_argument(
        "--against", type=Path, metavar="CHECKOUT", help="another one, for starts, files and identify"
    )
    parser.add_argument("--only-replays", action="store_true", help="print these two sections, and no more")
    parser.add_argument("--only-campaigns", action="store_true", help="print this section, and no more")
    parser.add_argument("--only-files", action="store_true", help="print these three, and no more")
    parser.add_argument(
        "--short",
        action="store_true",
        help="a little of everything, in a minute: to see that it runs; its figures are worth nothing",
    )
    args = parser.parse_args()
    effort = SHORT if args.short else WHOLE
    against = args.against and args.against.resolve()
    roots = [HERE] if against is None else [against, HERE]
    if args.only_replays:
        print("\n".join(inactive_section(effort) + replay_section(effort)))
        return
    if args.only_campaigns:
        print("\n".join(campaign_section(effort)))
        return
    if args.only_files:
        print("\n".join(_files(roots, against, effort)))
        return
    args.output = args.output or Path("out" if args.short else "docs")
    args.output.mkdir(parents=True, exist_ok=True)
    with compiler.sharing():
        _write(args, effort, roots, against)


def _write(args: argparse.Namespace, effort: Effort, roots: Sequence[Path], against: Path | None) -> None:
    """Run all benchmarks and write their page."""
    text = ["# Benchmark", "", "Made by `make bench` on", "", *machine_lines(), load_line(), ""]
    text += episode_section(effort) + inactive_section(effort) + campaign_section(effort)
    text += step_section(effort)
    text += cost_section(effort) + parts_section(effort) + _files(roots, against, effort)
    text += replay_section(effort)
    text += page_section(effort)
    if lateness.available():
        text += lateness_section(
            args.output, effort.of(args.rounds), effort.lateness_seconds or args.seconds, effort
        )
    else:
        print("no cyclictest: apt-get install rt-tests", file=sys.stderr)
    (args.output / "benchmark.md").write_text("\n".join(text), encoding="utf-8")
    print("\n".join(text))


def _files(roots: Sequence[Path], against: Path | None, effort: Effort) -> list[str]:
    """Return the sections in which another checkout can be compared with this one."""
    return start_section(roots, effort) + table_section(roots, effort) + identification_section(against, effort)


if __name__ == "__main__":
    main()
