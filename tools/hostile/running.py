"""Execution of command-line calls: in a forked child, which costs milliseconds, or as a process of its own."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from tools.hostile.case import Case, Outcome

CRASHED = 70  # exit code of a forked child with an uncaught exception
_MOST_BYTES = 400_000_000  # bytes, largest file that a forked case may write
COMMAND = [sys.executable, "-m", "liftgate_hil"]


def shell_code(status: int) -> int:
    """Return an exit code as a shell reports it: −n, a death by signal n, becomes 128 + n."""
    return status if status >= 0 else 128 - status


def _used_by(pid: int) -> float:
    """Return the CPU time [s] that a process has used so far, without its children's."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Child:
    """Running call of the command line."""

    def __init__(
        self, case: Case, folder: Path, limit: float, is_forked: bool, environment: Mapping[str, str] | None = None
    ) -> None:
        self.case, self.folder = case, folder
        self._began = time.monotonic()
        self._limit = limit
        self._status: int | None = None
        self._is_late = False
        self._used = self._used_before = 0.0
        # Files of the output, beside the folder: a case may have files of any name in it.
        self._outputs = [folder.with_suffix(suffix) for suffix in (".out", ".err")]
        if is_forked:
            self.pid = os.fork()
            if self.pid == 0:
                _be_the_child(case, folder, self._outputs)
        else:
            with self._outputs[0].open("wb") as out, self._outputs[1].open("wb") as err:
                process = subprocess.Popen(
                    [*COMMAND, *case.arguments], cwd=folder, stdout=out, stderr=err,
                    stdin=subprocess.DEVNULL,
                    env={**os.environ, **(environment or {})},
                )  # fmt: skip
            self.pid = process.pid
            process.returncode = 0  # poll() below waits for the process, not Popen

    def poll(self) -> bool:
        """Return whether the call has ended; it is killed when its time limit has passed."""
        if self._status is None:
            pid, status, used = os.wait4(self.pid, os.WNOHANG)
            if pid:
                self._status = os.waitstatus_to_exitcode(status)
                self._used = used.ru_utime + used.ru_stime
            elif time.monotonic() - self._began > self._limit:
                self._is_late = True
                os.kill(self.pid, signal.SIGKILL)
                self._status = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self._status is not None

    def signal(self, number: int) -> None:
        """Send the process a signal, unless it has ended."""
        if not self.poll():
            self._used_before = _used_by(self.pid)
            os.kill(self.pid, number)

    def used_since_signal(self) -> float:
        """Return the CPU time [s] since the signal, which a busy machine does not lengthen.

        It includes all CPU time of children that the process has waited for, even before the signal.
        """
        return self._used - self._used_before

    def outcome(self) -> Outcome:
        """Return the outcome of the ended call, and remove the files of its output."""
        assert self._status is not None
        out, err = (path.read_text(encoding="utf-8", errors="backslashreplace") for path in self._outputs)
        for path in self._outputs:
            path.unlink()
        seconds = time.monotonic() - self._began
        return Outcome(shell_code(self._status), out[:100_000], err[:100_000], seconds, self._is_late)


def _be_the_child(case: Case, folder: Path, outputs: list[Path]) -> None:
    """Run a case in this process, a forked child, and end it."""
    code = CRASHED
    try:
        os.chdir(folder)
        for number, path in enumerate(outputs, start=1):
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(descriptor, number)
            os.close(descriptor)
        null = os.open(os.devnull, os.O_RDONLY)
        os.dup2(null, 0)
        resource.setrlimit(resource.RLIMIT_FSIZE, (_MOST_BYTES, _MOST_BYTES))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        from liftgate_hil.cli.main import main

        try:
            code = main(case.arguments)
        except SystemExit as leaving:
            code = int(leaving.code or 0)
    except BaseException:
        traceback.print_exc()
    finally:
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code)


def run_all(
    cases: Iterator[tuple[Case, Path]], jobs: int, limit: float, is_process: Callable[[Case], bool]
) -> Iterator[tuple[Case, Path, Outcome]]:
    """Run cases in their folders, `jobs` at a time, each for at most `limit` [s].

    Yields (case, folder, outcome) in the order in which they end.
    """
    running: list[Child] = []
    waiting = True
    while waiting or running:
        while waiting and len(running) < jobs:
            following = next(cases, None)
            if following is None:
                waiting = False
            else:
                case, folder = following
                running.append(Child(case, folder, limit, not is_process(case)))
        for child in [each for each in running if each.poll()]:
            running.remove(child)
            yield child.case, child.folder, child.outcome()
        time.sleep(0.002)
