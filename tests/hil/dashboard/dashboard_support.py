"""A page's server as a process, and who asks it."""

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
    """Asks as a script does."""

    def __init__(self, address: str) -> None:
        parts = urlsplit(address)
        self.host, self.token = parts.netloc, parse_qs(parts.query)["token"][0]

    def ask(
        self, path: str, body: bytes | None = None, headers: dict[str, str] | None = None, token: str | None = None
    ) -> tuple[int, Any]:
        """The status, and what it said."""
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
    """The first state in which it is so."""
    for _ in range(15_000):
        state = client.ask("/api/state")[1]
        if is_so(state):
            return state
        time.sleep(0.02)
    raise AssertionError(state)


def is_going(state: Any) -> bool:
    """Whether the run runs; a busy machine is late now and then."""
    return state["phase"] in ("running", "late")


def _read(answer: Any) -> Any:
    text = answer.read().decode()
    is_json = answer.headers.get_content_type() == "application/json"
    return json.loads(text) if is_json else text


@contextlib.contextmanager
def process(*arguments: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A command of ours; ended with the test."""
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
    """The address that it prints."""
    stream = child.stderr if is_error else child.stdout
    assert stream is not None
    said = []
    for line in stream:
        said.append(line)
        if line.startswith("http://"):
            return line.strip()
    raise AssertionError("".join(said) + (child.stderr.read() if child.stderr else ""))
