"""Start and stop runs from a dashboard page: scenarios of one folder, each as a process of `liftgate-hil`.

The page lists the folder's scenario files: name, description and requirements of each.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from liftgate_hil.config.scenario import ScenarioFile, read_scenario
from liftgate_hil.config.toml import show
from liftgate_hil.dashboard.page_state import EndState, JsonObject, ListedScenario, Startable
from liftgate_hil.errors import ConfigError, RunGoneError
from liftgate_hil.isolate.children import end
from liftgate_hil.isolate.supervisor import dies_with_parent
from liftgate_hil.judging.verdict import PASS
from liftgate_hil.operate.attachment.client import Client

_MOST = 1000  # files that are listed
_MOST_ENTRIES = 20_000  # of folders that are looked at: some 0.1 s; a folder of 100,000 files had taken 13 s
_MOST_BYTES = 1_000_000  # of a file that is read: shipped scenarios have 3 kB
_LONGEST = 1000  # characters of a description or an issue

_Stamp = tuple[tuple[int, int], ...]  # of each file: time of the last change [ns], and size


@dataclass(frozen=True)
class _Known:
    """Cached description of a scenario file, with the files that it includes."""

    paths: tuple[Path, ...]
    stamp: _Stamp
    about: JsonObject


class Scenarios:
    """Scenario files of a folder and its subfolders, without hidden ones; of too many, those in nearest folders.

    Listing reads folders and files: it is for a thread of its own, not for the server's event loop.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[str, _Known] = {}

    def names(self) -> tuple[list[str], bool]:
        """Return the sorted names of the files, and whether the list is complete: large folders are cut short."""
        found: list[str] = []
        looked, waiting = 0, deque([""])
        while waiting:
            place = waiting.popleft()
            with contextlib.suppress(OSError), os.scandir(self.folder / place) as entries:
                for each in entries:
                    looked += 1
                    if looked > _MOST_ENTRIES or len(found) == _MOST:
                        return sorted(found), False
                    name = f"{place}{each.name}"
                    if each.name.startswith(".") or not name.isprintable():
                        continue
                    if each.is_dir(follow_symlinks=False):
                        waiting.append(f"{name}/")
                    elif each.name.endswith(".toml") and each.is_file():
                        found.append(name)
        return sorted(found), True

    def listed(self) -> tuple[list[JsonObject], bool]:
        """Return `name`, `description`, `requirement`, `issue` of each file, and whether the list is complete."""
        names, is_all = self.names()
        self._known = {name: self._read(name) for name in names}
        return [{"name": name, **each.about} for name, each in self._known.items()], is_all

    def _read(self, name: str) -> _Known:
        """Return a file's cached description; it is read anew if the file or one that it includes has changed."""
        known = self._known.get(name)
        if known is not None and _stamp_of(known.paths) == known.stamp:
            return known
        path = self.folder / name
        try:
            if path.stat().st_size > _MOST_BYTES:
                raise ConfigError(f"{path}: longer than {_MOST_BYTES} bytes; allowed: a scenario")
            file = read_scenario(path)
        except (ConfigError, OSError) as error:
            issue = error.issues[0] if isinstance(error, ConfigError) else f"{path}: {error.strerror}"
            return _Known((path,), _stamp_of([path]), _about(issue=issue))
        paths = tuple(part.path for part in file.parts)
        return _Known(paths, _stamp_of(paths), _about(file))


def _about(file: ScenarioFile | None = None, issue: str = "") -> JsonObject:
    description = "" if file is None else " ".join(str(file.stated("description", "")).split())
    given = [] if file is None else file.stated("requirement", [])
    requirement = [str(each) for each in (given if isinstance(given, list) else [given])]
    return {"description": description[:_LONGEST], "requirement": requirement, "issue": issue[:_LONGEST]}


def _stamp_of(paths: Iterable[Path]) -> _Stamp:
    """Return the time of change [ns] and size [bytes] of each file; (): one of them is gone."""
    found = []
    for path in paths:
        try:
            state = path.stat()
        except OSError:  # it is gone
            return ()
        found.append((state.st_mtime_ns, state.st_size))
    return tuple(found)


_BEGIN_S = 600.0  # s until a run can be attached to: it may have to be compiled before
_LEAVE_S = 5.0  # s for the process of a run that has ended
_STOP_S = 30.0  # s to end in order, after which it is killed
_RETRY_S = 0.1
_SHOWN = 12  # scenarios that a refusal lists
_LINES = 50  # of what the process prints that are kept


class Starter:
    """Starts scenarios of a folder, one at a time; `flags` are added to each command line.

    A run inherits the priority of the thread that starts it, and ends with it: it is a thread of its own, with the
    priority that this process had when the starter was made.
    """

    def __init__(self, folder: Path, flags: Sequence[str]) -> None:
        self._folder, self._flags = folder, list(flags)
        self._scenarios, self._verdicts = Scenarios(folder), dict[str, str]()
        self._process: subprocess.Popen[str] | None = None
        self._printed: deque[str] = deque(maxlen=_LINES)
        self._name, self._is_stopped, self._is_closed = "", False, False
        self._starting = threading.Lock()
        self._thread = ThreadPoolExecutor(1)
        self.thread_id = self._thread.submit(threading.get_native_id).result()
        if not folder.is_dir():
            what = "no folder" if folder.exists() else "no such folder"
            raise ConfigError(f"`scenarios` {folder}: {what}; allowed: a folder with scenario files")

    @property
    def running(self) -> str | None:
        """Name of the running scenario; None: none runs."""
        return self._name if self._process is not None and self._process.poll() is None else None

    def state(self) -> Startable:
        """Return the scenarios, the running one, and the exit code of the last one (None: none yet).

        It reads folders and files, see `Scenarios`.
        """
        scenarios, is_all = self._scenarios.listed()
        listed = [{**each, "verdict": self._verdicts.get(each["name"], "")} for each in scenarios]
        return {
            "scenarios": cast(list[ListedScenario], listed),
            "is_all": is_all,
            "running": self.running,
            "exit_code": None if self._process is None else self._process.poll(),
        }

    def note_end(self, pid: int, end: EndState) -> None:
        """Store the verdict of the run in process `pid` if this page has started it; "": nothing was expected."""
        if self._process is not None and self._process.pid == pid:
            is_judged = end["expectations"] or end["verdict"] != PASS
            self._verdicts[self._name] = end["ending"] if is_judged else ""

    def start(self, name: object, has_ended: bool = False) -> Client:
        """Start a scenario; return its run's client; `has_ended`: the last run has ended; its process is awaited.

        Raises ConfigError, also while another one runs or starts, and RunGoneError where it did not begin.
        """
        if not self._starting.acquire(blocking=False):
            raise ConfigError(f"scenario {show(name)[:80]}: another one is starting; allowed: after that")
        try:
            if has_ended and self._process is not None:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._process.wait(_LEAVE_S)
            self._check(name)
            return self._started(str(name))
        finally:
            self._starting.release()

    def _check(self, name: object) -> None:
        """Raise ConfigError unless the scenario with that name can be started now."""
        if self._is_closed:
            raise ConfigError(f"scenario {show(name)[:80]}: the page ends; allowed: on another one")
        if self.running is not None:
            raise ConfigError(f"scenario {show(name)[:80]}: {self._name} is running; allowed: stop that first")
        names, _ = self._scenarios.names()
        if name not in names:
            shown = [*names[:_SHOWN], *(["…"] if len(names) > _SHOWN else [])]
            allowed = ", ".join(shown) or "a file in the folder, which has none"
            raise ConfigError(f"scenario {show(name)[:80]}: no such file in {self._folder}; allowed: {allowed}")

    def _started(self, name: str) -> Client:
        """Start the process of a scenario, and return a client of its run. Raises RunGoneError."""
        self._name, self._is_stopped = name, False
        self._printed.clear()
        path = str(self._folder / name)
        command = [sys.executable, "-P", "-m", "liftgate_hil", *self._flags, "--scenario", path]
        self._process = self._thread.submit(self._spawn, command).result()
        reader = threading.Thread(target=self._read, args=(self._process,), daemon=True)
        reader.start()
        return self._client(self._process, reader)

    def _spawn(self, command: Sequence[str]) -> subprocess.Popen[str]:
        return subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,  # Ctrl-C is for the page, which ends the run itself
            preexec_fn=dies_with_parent,  # noqa: PLW1509
        )

    def _read(self, process: subprocess.Popen[str]) -> None:
        for line in process.stderr or ():
            self._printed.append(line.strip())

    def _client(self, process: subprocess.Popen[str], reader: threading.Thread) -> Client:
        """Wait until the run of a process has begun, and return a client of it. Raises RunGoneError."""
        deadline = time.monotonic() + _BEGIN_S
        while process.poll() is None and time.monotonic() < deadline:
            try:
                return Client(process.pid)
            except ConfigError:  # it has not begun
                time.sleep(_RETRY_S)
        if self._is_stopped:
            raise RunGoneError(f"{self._name} was stopped before it began")
        self.stop()
        reader.join(1.0)
        said = "; ".join(list(self._printed)[-5:]) or "it printed nothing"
        raise RunGoneError(f"{self._name} did not begin (exit code {process.poll()}): {said}")

    def close(self) -> None:
        """Stop the run, and refuse to start further ones."""
        self._is_closed = True
        self.stop()

    def stop(self) -> None:
        """Stop the run in order; kill its process if it does not end in time."""
        if self._process is None or self._process.poll() is not None:
            return
        self._is_stopped = True
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            end(self._process, 1.0)
