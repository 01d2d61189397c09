"""Commands run with a fault: a file operation fails, or the process is killed at one.

They run in children forked from one process that has loaded everything, as a start takes longer than a campaign.
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from c_library import build

SOURCE = Path(__file__).with_name("file_faults.c")
READING, WRITING = 1, 2  # kinds of operations, as in SOURCE


class Fault(NamedTuple):
    """A fault at file operation number `at` (from 1; 0: none) below a folder."""

    below: str
    at: int = 0
    number: int = 0  # errno; 0: the process is killed
    is_lasting: bool = False  # all operations from then on
    kinds: int = READING | WRITING  # of operations that count


class Ended(NamedTuple):
    """The end of a command: its exit code or signal, and its output."""

    code: int  # negative: the signal
    said: list[str]  # lines on stderr
    operations: int  # on files below the fault's folder


class FaultyCommands:
    """The process that forks a child for each command; `folder` is for its own files."""

    def __init__(self, folder: Path) -> None:
        library = build(folder, SOURCE.read_text(), "file_faults.so")
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__)), str(library), str(folder)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env={**os.environ, "LD_PRELOAD": str(library), "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip

    def run(self, *commands: tuple[Sequence[str], Fault | None]) -> list[Ended]:
        """Run commands at the same time; only one of several may have a fault."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(commands) + "\n")
        self._process.stdin.flush()
        return [Ended(*each) for each in json.loads(self._process.stdout.readline())]

    def close(self) -> None:
        """End the process that forks the commands."""
        self._process.communicate("")


def _begin(library: ctypes.CDLL, arguments: Sequence[str], fault: Fault | None, said: Path) -> int:
    """Fork a child that runs a command with its stderr in `said`; return its process id."""
    from liftgate_hil.cli.main import main

    child = os.fork()
    if child:
        return child
    code = 70  # EX_SOFTWARE of sysexits.h
    try:
        os.dup2(os.open(os.devnull, os.O_RDWR), 1)
        os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), 2)
        sys.argv = ["liftgate-hil", *arguments]
        if fault is not None:
            below, *rest = fault
            library.file_faults_begin(below.encode(), *rest)
        code = main()
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def _serve(library: ctypes.CDLL, folder: Path) -> None:
    """Run the commands that are received, one per line."""
    library.file_faults_begin.argtypes = [ctypes.c_char_p, ctypes.c_long, *(ctypes.c_int,) * 3]
    library.file_faults_begin(b"", 0, 0, 0, 0)
    library.file_faults_count.restype = ctypes.c_long
    for line in sys.stdin:
        commands = json.loads(line)
        files = [folder / f"said-{place}.txt" for place in range(len(commands))]
        children = [
            _begin(library, arguments, fault and Fault(*fault), said)
            for (arguments, fault), said in zip(commands, files, strict=True)
        ]
        codes = [os.waitstatus_to_exitcode(os.waitpid(each, 0)[1]) for each in children]
        count = library.file_faults_count()
        said = [[text for text in each.read_text().splitlines() if text] for each in files]
        print(json.dumps([(code, text, count) for code, text in zip(codes, said, strict=True)]), flush=True)


def _load(folder: Path) -> None:
    """Import what a campaign needs, machine code included."""
    from liftgate_hil.campaigns import campaign
    from liftgate_hil.campaigns.request import CampaignRequest
    from liftgate_hil.campaigns.run import CampaignPlaces, run_campaign
    from liftgate_hil.plan.provenance import provenance_of

    campaign.PASSING_S = 0.0  # a batch for each variant, however long they take
    path = folder / "loaded.toml"
    path.write_text("duration = 0.1")
    request = CampaignRequest(str(path), ("supply.voltage=12,13",))
    run_campaign(request, CampaignPlaces(folder / "loaded", jobs=1), provenance_of("", {}))


if __name__ == "__main__":
    _load(Path(sys.argv[2]))
    _serve(ctypes.CDLL(sys.argv[1]), Path(sys.argv[2]))
