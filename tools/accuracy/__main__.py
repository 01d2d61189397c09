"""Accuracy study of the fixed step: `python -m tools.accuracy --output FOLDER` writes accuracy.md.

`--case N` prints the errors of one case, `--point N` a point of the bridges and its errors; neither writes a file.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tools.accuracy.bridges import Apart, apart, point
from tools.accuracy.page import bridges_of, page_of
from tools.accuracy.study import Errors, errors_of

CASES = 300


def main() -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tools.accuracy", description=__doc__)
    parser.add_argument("--output", metavar="FOLDER", default="docs")
    parser.add_argument("--cases", type=int, default=CASES, metavar="N")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first")
    parser.add_argument("--case", type=int, metavar="N", help="print one, write nothing")
    parser.add_argument("--jobs", type=int, default=2, metavar="N")
    parser.add_argument("--point", type=int, metavar="N", help="the same of one of the bridges")
    args = parser.parse_args()
    Path(args.output).mkdir(parents=True, exist_ok=True)
    if args.case is not None:
        print(errors_of(args.case))
        return 0
    if args.point is not None:
        print(point(args.point), apart(args.point), sep="\n")
        return 0
    numbers = range(args.first, args.first + args.cases)
    found: list[Errors] = []
    switched: list[Apart] = []
    with ProcessPoolExecutor(args.jobs) as pool:
        for each in pool.map(errors_of, numbers):
            found.append(each)
            if not each.is_met:
                print(each, flush=True)
        for other in pool.map(apart, numbers):
            switched.append(other)
            if not other.is_met:
                print(other, flush=True)
    Path(args.output, "accuracy.md").write_text(page_of(found) + bridges_of(switched), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
