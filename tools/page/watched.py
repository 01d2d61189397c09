"""A run with the reference ECU, and its page open in Chromium."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

_FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
    "--hide-scrollbars",
)  # fmt: skip
_PATIENCE_S = 300.0  # for the run to begin, which may have to be compiled


class Watched(NamedTuple):
    """A browser with the page, and the process id of the page's server."""

    browser: Any
    server: int


@contextlib.contextmanager
def watched(scenario: str | Path, width: int, height: int) -> Iterator[Watched]:
    """Context with a run of a scenario whose page is open in a browser of that size [px]."""
    from selenium import webdriver

    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        # The browser first, and not on the loop's CPU: it would keep the loop waiting.
        options = webdriver.ChromeOptions()
        options.binary_location = str(shutil.which("chromium"))
        for each in (*_FLAGS, f"--window-size={width},{height}", f"--user-data-dir={folder}/profile"):
            options.add_argument(each)
        others = sorted(os.sched_getaffinity(0))[:-1] or [0]
        aside = {"preexec_fn": lambda: os.sched_setaffinity(0, others)}
        service = webdriver.ChromeService(executable_path=shutil.which("chromedriver"), popen_kw=aside)
        browser = webdriver.Chrome(options=options, service=service)
        stack.callback(browser.quit)
        command = [sys.executable, "-m", "liftgate_hil", "--bus", f"virtual:page-{os.getpid()}"]
        command += ["--overrun-limit", "600", "--ecu", "reference", "--scenario", str(scenario)]
        command += ["--realtime", "--dashboard", "--listen", "127.0.0.1:0"]
        said = stack.enter_context((folder / "said").open("w+"))
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=said)
        stack.callback(run.wait, 60)
        stack.callback(run.terminate)
        browser.get(_address_in(folder / "said", run))
        _until(lambda: browser.execute_script("return typeof last === 'object' && last && last.time_s > 0"))
        server = int(Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()[0])
        yield Watched(browser, server)


def _address_in(path: Path, run: subprocess.Popen[bytes]) -> str:
    def found() -> str:
        if run.poll() is not None:
            raise SystemExit(f"the run ended: {path.read_text()}")
        return next((line for line in path.read_text().splitlines() if line.startswith("http://")), "")

    return str(_until(found))


def _until(is_so: Any) -> Any:
    deadline = time.monotonic() + _PATIENCE_S
    while not (found := is_so()):
        if time.monotonic() > deadline:
            raise SystemExit(f"not so within {_PATIENCE_S:g} s")
        time.sleep(0.1)
    return found
