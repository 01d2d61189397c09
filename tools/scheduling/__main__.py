"""Scheduling of campaigns, simulated: `python -m tools.scheduling --output FOLDER` writes campaigns-at-scale.md.

It measures for some minutes what the simulation is fed with; `--short` does so with few files, batches and runs.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from tools.scheduling import check, measure, page


def main(arguments: Sequence[str] | None = None) -> int:
    """Write docs/campaigns-at-scale.md."""
    parser = argparse.ArgumentParser(prog="python -m tools.scheduling", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs"), metavar="FOLDER")
    parser.add_argument("--short", action="store_true", help="measure little, simulate the same")
    args = parser.parse_args(arguments)
    extent = measure.SHORT if args.short else measure.FULL
    load = os.getloadavg()[0]
    found = measure.request(4096)
    few, runs = check.runs(found, extent, 0.0115)
    through = check.passages(found.base, extent)
    files, end = measure.stored(found.base, extent), measure.ending(extent)
    figures = check.figures_of(few, runs, through, files, end)
    checked = check.checked_runs(runs, figures), check.checked_passages(through, figures)
    text = page.page_of(figures, files, checked, load)
    args.output.mkdir(parents=True, exist_ok=True)
    (args.output / "campaigns-at-scale.md").write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
