"""Study of campaigns: python -m tools.campaign_study [--output FOLDER] [--short] [--keep FOLDER]

It writes campaign-study.md to the output folder. With --keep, each part's results are kept in a folder, and those
that are there already are not measured again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path

from tools.campaign_study import page, study


def main(arguments: Sequence[str] | None = None) -> int:
    """Write docs/campaign-study.md."""
    parser = argparse.ArgumentParser(prog="python -m tools.campaign_study", description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs"))
    parser.add_argument("--short", action="store_true", help="a little of everything, for tests of this tool")
    parser.add_argument("--keep", type=Path, help="folder of results that are kept")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), metavar="N")
    parser.add_argument("--part", choices=study.PARTS, action="append", help="measure this only, write no page")
    args = parser.parse_args(arguments)
    size = study.SHORT if args.short else study.FULL
    parts: dict[str, study.Data] = {}
    # Threads of BLAS wait for each other in a loop: on busy CPUs they made the search ten times as slow.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Spawned: what this process has loaded is of no use to the workers, and forks of threads may hang.
    with ProcessPoolExecutor(args.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        for name in args.part or study.PARTS:
            parts[name] = _part(name, pool, size, args.keep)
            print(f"{name}: {parts[name]['seconds']:.0f} s", flush=True)
    if not args.part:
        text = page.page_of(parts, size, args.jobs, args.short)
        (args.output / "campaign-study.md").write_text(text, encoding="utf-8")
    return 0


def _part(name: str, pool: Executor, size: study.Size, keep: Path | None) -> study.Data:
    """Return a part's results and the seconds it took: those that were kept, or measured now."""
    path = keep / f"{name}.json" if keep else None
    known = {"size": asdict(size)}
    if path and path.is_file():
        kept: study.Data = json.loads(path.read_text(encoding="utf-8"))
        if kept.items() >= known.items():
            return kept
    began = time.monotonic()
    found = study.PARTS[name](pool, size)
    part = {**known, "found": found, "seconds": time.monotonic() - began}
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(part), encoding="utf-8")
    return part


if __name__ == "__main__":
    sys.exit(main())
