"""Index of the thesis's equations: the place of each in the code, and the test that fails when it is changed.

Exit code 1 if the index is wrong: an equation without its place, its change or its test. With --mutate each
equation is changed once, in a temporary copy, and its test must fail there (and pass before).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from tools.equations import NUMBERS, problems
from tools.equations.mutants import PASSED, copied, outcome, survived
from tools.equations.table import TABLE, Row


def show(rows: Sequence[Row]) -> int:
    """Print the index; return the number of equations for which it is wrong."""
    wrong = 0
    for row in rows:
        found = problems(row)
        wrong += bool(found)
        print(f"({row.number})  {row.says}")
        print(f"    {row.where}{': ' if row.note else ''}{row.note}")
        print(f"    {row.test}")
        for problem in found:
            print(f"    MISSING: {problem}")
    return wrong


def mutate(rows: Sequence[Row]) -> int:
    """Change each equation and run its test; return the number of changes that the tests do not detect."""
    wrong = 0
    sound: dict[str, bool] = {}
    with copied() as folder:
        for row in rows:
            if row.test not in sound:
                sound[row.test] = outcome(folder, row.test) == PASSED
            why = survived(folder, row) if sound[row.test] else "its test fails without a change"
            wrong += bool(why)
            print(f"({row.number})  {row.where}: {row.text}  →  {row.mutant or 'nothing'}")
            print(f"    {'SURVIVED, ' + why if why else 'fails as it must'}: {row.test}", flush=True)
    print(f"{len(rows) - wrong} of {len(rows)} equations: their test fails when they are changed")
    return wrong


def main() -> int:
    """Print the index, or test the changes of equations; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tools.equations", description=__doc__)
    parser.add_argument("--mutate", nargs="*", metavar="NUMBER", help="change these equations, or all of them")
    chosen: list[str] | None = parser.parse_args().mutate
    unknown = sorted(set(chosen or ()) - set(NUMBERS))
    if unknown:
        parser.error(f"no equation {', '.join(unknown)}")
    missing = sorted(set(NUMBERS) - {row.number for row in TABLE})
    for number in missing:
        print(f"({number})  MISSING")
    if chosen is None:
        return 1 if show(TABLE) or missing else 0
    rows = [row for row in TABLE if not chosen or row.number in chosen]
    broken = {row.number: found for row in rows if (found := problems(row))}
    for number, found in broken.items():
        print(f"({number})  MISSING: {'; '.join(found)}")
    wrong = mutate([row for row in rows if row.number not in broken])
    return 1 if wrong or broken or missing else 0


if __name__ == "__main__":
    sys.exit(main())
