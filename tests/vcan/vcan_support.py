"""The emulator as a process on vcan0, and what can-utils say of the bus."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hil_support import BENCH_STATUS, GATE

from hil.config.rig import Rig

PATIENCE = 120.0  # s until a process must have done what is waited for; nothing is judged by it
COMMAND_PERIOD = 0.01  # s


class Seen(NamedTuple):
    """A frame in candump's log."""

    time: float
    identifier: int
    payload: bytes
    is_fd: bool


class Bus:
    """What candump has written so far."""

    def __init__(self, log: Path) -> None:
        self.log = log

    def wait_for_listener(self) -> None:
        table = Path("/proc/net/can/rcvlist_all")
        wait_for(lambda: "vcan0" in table.read_text(), "candump does not listen")

    def frames(self, identifier: int | None = None) -> list[Seen]:
        text = self.log.read_text()
        whole = text[: text.rfind("\n") + 1]
        seen = [parsed(line) for line in whole.splitlines()]
        return [each for each in seen if identifier in (None, each.identifier)]

    def count(self, identifier: int) -> int:
        return len(self.frames(identifier))

    def last(self, rig: Rig, name: str) -> dict[str, Any]:
        message = rig.messages[name]
        payload = self.frames(message.frame_id)[-1].payload
        return dict(message.decode(payload, decode_choices=False))

    def wait_for_more(self, identifier: int, more: int = 1) -> None:
        before = self.count(identifier)
        wait_for(lambda: self.count(identifier) >= before + more, f"no more of {identifier:#x}")

    def settle(self) -> None:
        """What was sent before is in what the emulator says after."""
        self.wait_for_more(BENCH_STATUS, 2)


def parsed(line: str) -> Seen:
    stamp, _, frame = line.split()[:3]
    identifier, _, rest = frame.partition("#")
    is_fd = rest.startswith("#")
    payload = b"" if rest.startswith("R") else bytes.fromhex(rest[2:] if is_fd else rest)
    return Seen(float(stamp.strip("()")), int(identifier, 16), payload, is_fd)


def wait_for(condition: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.05)


def run(*command: str) -> str:
    """A foreign program, to its end."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, f"{command}: {done.stderr}"
    return done.stdout


@contextlib.contextmanager
def running(*command: str) -> Iterator[subprocess.Popen[str]]:
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield child
    finally:
        child.kill()
        child.communicate()


@contextlib.contextmanager
def emulator(bus: Bus, *more: str, first: int = GATE) -> Iterator[subprocess.Popen[str]]:
    """The program under test, once its first frame is on the bus. A slow machine does not end it."""
    command = (sys.executable, "-m", "hil", "--bus", "socketcan:vcan0", "--overrun-limit", "60")
    with running(*command, *more) as child:

        def begun() -> bool:
            assert child.poll() is None or bus.count(first), child.stderr.read()
            return bus.count(first) > 0

        wait_for(begun, "the emulator sent nothing")
        yield child


def ended(child: subprocess.Popen[str], number: int | None = None) -> str:
    """What the emulator prints at its end, which is in order; `number` is the signal that ends it."""
    if number is not None:
        child.send_signal(number)
    out, error = child.communicate(timeout=PATIENCE)
    assert child.returncode == 0, error
    assert "Traceback" not in error
    return out


def summary_of(child: subprocess.Popen[str], number: int | None = signal.SIGTERM) -> dict[str, Any]:
    return json.loads(ended(child, number))


def received(summary: dict[str, Any]) -> int:
    """All frames that came in, whatever became of them."""
    counts = summary["received"]
    return sum(number for cause, number in counts.items() if cause != "lost")


def write_log(path: Path, frames: Sequence[str]) -> Path:
    """A log for canplayer: one frame every command period."""
    path.write_text(
        "".join(f"({i * COMMAND_PERIOD:.6f}) vcan0 {frame}\n" for i, frame in enumerate(frames))
    )
    return path


def texts_of(frames: Iterable[tuple[int, bytes]]) -> list[str]:
    """Classic frames with 11-bit identifiers as cansend takes them."""
    return [f"{identifier:03X}#{payload.hex()}" for identifier, payload in frames]


def link_back() -> None:
    """vcan0 is there and up, whatever was done to it."""
    if not Path("/sys/class/net/vcan0").exists():
        run("ip", "link", "add", "dev", "vcan0", "mtu", "72", "type", "vcan")
    run("ip", "link", "set", "vcan0", "up")
