"""Robustness campaign, python -m tools.hostile: mangled files and signals against every command.

Each case has a folder of its own under --work. The folders of cases with a fault stay, with CASE.json, to be
inspected and run again (--replay NAME). Completed cases are noted in done.jsonl: the same call continues where it
was stopped.
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import random
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from tools.hostile.case import Case, Outcome, keep

_MAKERS = {
    "config": "config_case", "measurement": "measurement_case", "recording": "recording_case",
}  # fmt: skip
_EVERY = 40  # one case in this number runs as a process of its own, the others are forked


def main() -> int:
    """Run the campaign, or replay one case; return 1 if a fault was found, else 0."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.hostile", description=__doc__, allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--files", type=int, default=5000, metavar="N", help="mangled configurations")
    parser.add_argument("--measurements", type=int, default=3000, metavar="N", help="mangled measurements")
    parser.add_argument("--recordings", type=int, default=3000, metavar="N", help="mangled recordings")
    parser.add_argument("--signals", type=int, default=300, metavar="N", help="signals at random moments")
    parser.add_argument("--seed", type=int, default=1, metavar="S")
    parser.add_argument("--work", type=Path, default=Path("out/hostile"), metavar="FOLDER")
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="at a time; not signals"
    )
    parser.add_argument("--limit", type=float, default=60.0, metavar="S", help="that a case may take")
    parser.add_argument("--patience", type=float, default=2.0, metavar="S", help="of CPU, to end after a signal")
    parser.add_argument("--replay", metavar="NAME", help="one case again, e.g. config-17; says what comes of it")
    args = parser.parse_args()
    # A forked child of a process with threads may hang, and nothing here needs the threads of OpenBLAS for speed.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    args.work.mkdir(parents=True, exist_ok=True)
    args.work = args.work.resolve()
    from tools.hostile.bases import Bases

    bases = Bases(args.work / "bases")
    bases.make_measurements()
    campaign = Campaign(args.work, args.seed)
    if args.replay:
        return _replay(args, bases)
    _files(args, bases, campaign)
    _signals(args, bases, campaign)
    return campaign.tell()


class Campaign:
    """Record of the completed cases of a seed and of their faults, kept in done.jsonl."""

    def __init__(self, work: Path, seed: int) -> None:
        self._began = time.monotonic()
        self._path = work / "done.jsonl"
        self._seed = seed
        self._done: dict[str, list[str]] = {}
        if self._path.exists():
            for line in self._path.read_text(encoding="utf-8").splitlines():
                entry = json.loads(line)
                if entry["seed"] == seed:
                    self._done[entry["name"]] = entry["faults"]
        self._codes: collections.Counter[str] = collections.Counter()

    def is_done(self, name: str) -> bool:
        """Return whether a case is completed, for example by an earlier call."""
        return name in self._done

    def note(self, case: Case, folder: Path, outcome: Outcome, faults: list[str]) -> None:
        """Note a completed case; its folder is kept, and a line printed, only if it has faults."""
        self._done[case.name] = faults
        self._codes[f"{case.name.partition('-')[0]} exit {outcome.code}"] += 1
        with self._path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps({"seed": self._seed, "name": case.name, "faults": faults}) + "\n")
        if faults:
            keep(folder, case, outcome, faults)
            print(f"{case.name}: {case.what}: {'; '.join(faults)}: liftgate-hil {' '.join(case.arguments)[:200]}",
                  flush=True)  # fmt: skip
        else:
            shutil.rmtree(folder)

    def tell(self) -> int:
        """Print the totals; return 1 if any case has a fault, else 0."""
        found = {name: faults for name, faults in self._done.items() if faults}
        print(f"{len(self._done)} cases, {len(found)} with a fault, {time.monotonic() - self._began:.0f} s")
        print(", ".join(f"{kind}: {count}" for kind, count in sorted(self._codes.items())))
        return int(bool(found))


def _files(args: argparse.Namespace, bases: object, campaign: Campaign) -> None:
    from tools.hostile.judging import faults_of_file
    from tools.hostile.running import run_all

    def cases() -> Iterator[tuple[Case, Path]]:
        counts = (args.files, args.measurements, args.recordings)
        for kind, count in zip(_MAKERS, counts, strict=True):
            for number in range(count):
                if not campaign.is_done(f"{kind}-{number}"):
                    yield _file_case(args, bases, kind, number)

    def is_process(case: Case) -> bool:
        return random.Random(case.name).randrange(_EVERY) == 0

    for case, folder, outcome in run_all(cases(), args.jobs, args.limit, is_process):
        campaign.note(case, folder, outcome, faults_of_file(case, folder, outcome))


def _file_case(args: argparse.Namespace, bases: object, kind: str, number: int) -> tuple[Case, Path]:
    from tools.hostile import files

    folder = args.work / f"{kind}-{number}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    make = getattr(files, _MAKERS[kind])
    return make(bases, args.seed, number, folder), folder


def _signals(args: argparse.Namespace, bases: object, campaign: Campaign) -> None:
    from tools.hostile.signals import signal_case

    for number in range(args.signals):
        folder = args.work / f"signal-{number}"
        if campaign.is_done(folder.name):
            continue
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        case, outcome, faults = signal_case(bases, args.seed, number, folder, args.patience)  # type: ignore[arg-type]
        campaign.note(case, folder, outcome, faults)


def _replay(args: argparse.Namespace, bases: object) -> int:
    """Run one case as a process of its own and print what it did; return 1 if it has a fault, else 0."""
    from tools.hostile.judging import faults_of_file
    from tools.hostile.running import run_all
    from tools.hostile.signals import signal_case

    kind, _, number = args.replay.partition("-")
    if kind == "signal":
        folder = args.work / args.replay
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        case, outcome, faults = signal_case(bases, args.seed, int(number), folder, args.patience)  # type: ignore[arg-type]
    else:
        case, folder = _file_case(args, bases, kind, int(number))
        ((_, _, outcome),) = run_all(iter([(case, folder)]), 1, args.limit, lambda _: True)
        faults = faults_of_file(case, folder, outcome)
    print(f"in {folder}: liftgate-hil {' '.join(case.arguments)}")
    print(
        f"{case.what}: exit code {outcome.code} after {outcome.seconds:.2f} s; {'; '.join(faults) or 'no fault'}"
    )
    sys.stdout.write(outcome.stdout)
    sys.stderr.write(outcome.stderr)
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
