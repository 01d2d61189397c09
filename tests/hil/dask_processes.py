"""A Dask cluster of local processes, which tests kill and replace."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

PATIENCE = 120.0  # s until something must have happened; nothing is judged by it


class DaskProcesses:
    """A real scheduler and its workers, each in a process of its own."""

    def __init__(self, folder: Path, workers: int, *flags: str) -> None:
        self._folder, self._flags, self._number = folder, flags, 0
        file = folder / "scheduler.json"
        self._scheduler = self._start("scheduler", "--scheduler-file", str(file), "--port", "0", "--no-dashboard")
        self.address = self._address_in(file)
        self.workers = [self.worker() for _ in range(workers)]

    def _start(self, kind: str, *flags: str) -> subprocess.Popen[bytes]:
        with (self._folder / f"{kind}.log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.dask_{kind}", *flags, "--host", "127.0.0.1"],
                cwd=self._folder, stdout=log, stderr=log, stdin=subprocess.DEVNULL, start_new_session=True,
            )  # fmt: skip

    def _address_in(self, file: Path) -> str:
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                return str(json.loads(file.read_text())["address"])
            except (OSError, ValueError, KeyError):
                assert time.monotonic() < deadline, "no scheduler"
                time.sleep(0.05)

    def worker(self) -> subprocess.Popen[bytes]:
        """Start another worker."""
        self._number += 1
        return self._start(
            "worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard",
            "--name", f"w{self._number}", "--local-directory", str(self._folder), *self._flags,
        )  # fmt: skip

    def wait_for(self, workers: int) -> None:
        """Wait until the cluster has a number of workers."""
        from distributed import Client

        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=PATIENCE)

    def replace(self, worker: subprocess.Popen[bytes]) -> None:
        """Kill a worker process and start another."""
        os.killpg(worker.pid, signal.SIGKILL)
        worker.wait()
        self.workers.remove(worker)
        self.workers.append(self.worker())

    def kill_scheduler(self) -> None:
        """Kill the scheduler's process."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._scheduler.pid, signal.SIGKILL)
        self._scheduler.wait()

    def close(self) -> None:
        """Kill all processes of the cluster."""
        for each in (*self.workers, self._scheduler):
            try:
                os.killpg(each.pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
            each.wait()
