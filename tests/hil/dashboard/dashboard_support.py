"""Processes that serve a dashboard page, and a client for them."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit


class Client:
    """A client that sends requests as a script does."""

    def __init__(self, address: str, child: subprocess.Popen[str] | None = None) -> None:
        """`child` is the process that serves the page."""
        self.address, self.child = address, child
        parts = urlsplit(address)
        self.host, self.token = parts.netloc, parse_qs(parts.query)["token"][0]

    @property
    def endpoint(self) -> tuple[str, int]:
        """The host and port to which a socket connects."""
        host, port = self.host.split(":")
        return host, int(port)

    def ask(
        self, path: str, body: bytes | None = None, headers: dict[str, str] | None = None, token: str | None = None
    ) -> tuple[int, Any]:
        """Send a request; return the status and the answer."""
        token = self.token if token is None else token
        mark = "&" if "?" in path else "?"
        address = f"http://{self.host}{path}{mark}token={token}" if token else f"http://{self.host}{path}"
        request = urllib.request.Request(address, body, headers or {})
        try:
            with urllib.request.urlopen(request, timeout=120) as answer:
                return answer.status, _read(answer)
        except urllib.error.HTTPError as error:
            return error.code, _read(error)

    def command(self, **command: Any) -> tuple[int, Any]:
        return self.ask("/api/command", json.dumps(command).encode())


def until(client: Client, is_so: Callable[[Any], bool]) -> Any:
    """Wait for the first state that fulfils a condition, and return that state."""
    for _ in range(15_000):
        state = client.ask("/api/state")[1]
        if is_so(state):
            return state
        time.sleep(0.02)
    raise AssertionError(state)


def is_going(state: Any) -> bool:
    """Tell whether the run is running; a busy machine is late now and then."""
    return state["phase"] in ("running", "late")


def _read(answer: Any) -> Any:
    text = answer.read().decode()
    is_json = answer.headers.get_content_type() == "application/json"
    return json.loads(text) if is_json else text


@contextlib.contextmanager
def process(*arguments: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a command of ours, which is ended with the test."""
    child = subprocess.Popen(
        [sys.executable, "-P", "-m", "liftgate_hil", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env={**os.environ, "XDG_RUNTIME_DIR": str(folder)},
    )
    try:
        yield child
    finally:
        child.terminate()
        try:
            child.communicate(timeout=30)
        except subprocess.TimeoutExpired:
            child.kill()
            child.communicate()


def address_in(child: subprocess.Popen[str], is_error: bool = False) -> str:
    """Return the page's address that a process prints."""
    stream = child.stderr if is_error else child.stdout
    assert stream is not None
    said = []
    for line in stream:
        said.append(line)
        if line.startswith("http://"):
            return line.strip()
    raise AssertionError("".join(said) + (child.stderr.read() if child.stderr else ""))


@contextlib.contextmanager
def page_of(folder: Path, *arguments: str, listen: str = "127.0.0.1:0") -> Iterator[Any]:
    """Start `liftgate-hil dashboard`, and return a client of its page."""
    with process("dashboard", *arguments, "--listen", listen, folder=folder) as child:
        yield Client(address_in(child), child)


def page_beside(run: subprocess.Popen[str], folder: Path, *arguments: str) -> Any:
    """Start a dashboard attached to a run, and return a client of its page."""
    return page_of(folder, "--attach", str(run.pid), "--patience", "60", *arguments)


def bench(folder: Path, name: str, *arguments: str) -> Any:
    """Start a run on a virtual bus of this name; lateness of a busy machine does not end it."""
    return process("--bus", f"virtual:{name}", "--overrun-limit", "3600", *arguments, folder=folder)


@contextlib.contextmanager
def bench_with_page(folder: Path, name: str, *arguments: str, listen: str = "127.0.0.1:0") -> Iterator[Any]:
    """Start a run that serves its own page, and return a client of that page."""
    with bench(folder, name, "--dashboard", "--listen", listen, *arguments) as run:
        yield Client(address_in(run, is_error=True), run)
