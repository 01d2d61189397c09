"""The emulator as a process on vcan0, and frames of the bus seen by can-utils."""

from __future__ import annotations

import contextlib
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from c_ecu import running
from hil_support import BENCH_STATUS, GATE

from liftgate_hil.config.rig import Rig

PATIENCE = 120.0  # s until a process must have done what is waited for; nothing is judged by it
COMMAND_PERIOD = 0.01  # s


class Seen(NamedTuple):
    """A frame in candump's log."""

    time: float
    identifier: int
    payload: bytes
    is_fd: bool


class Bus:
    """candump's log so far."""

    def __init__(self, log: Path) -> None:
        self.log = log

    def wait_for_listener(self) -> None:
        tables = list(Path("/proc/net/can").glob("rcvlist_*"))

        def is_there() -> bool:
            return any(re.search("^ +vcan0 ", each.read_text(), re.MULTILINE) for each in tables)

        wait_for(is_there, "candump does not listen")

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
        """Wait until earlier frames are in the emulator's messages."""
        self.wait_for_more(BENCH_STATUS, 2)


def parsed(line: str) -> Seen:
    stamp, _, frame = line.split()[:3]
    identifier, _, rest = frame.partition("#")
    is_fd = rest.startswith("#")
    payload = b"" if rest.startswith("R") else bytes.fromhex(rest[2:] if is_fd else rest)
    return Seen(float(stamp.strip("()")), int(identifier, 16), payload, is_fd)


def wait_for(condition: Callable[[], object], what: str, pause: float = 0.05) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(pause)


def run(*command: str) -> str:
    """Run a foreign program until it ends."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, f"{command}: {done.stderr}"
    return done.stdout


class Emulator(subprocess.Popen[str]):
    """The tested program; its messages go to a file that can be read while it runs."""

    def __init__(self, arguments: Sequence[str], told: Path) -> None:
        self._told = told
        command = (sys.executable, "-m", "liftgate_hil", "--bus", "socketcan:vcan0", *arguments)
        with told.open("w") as stream:
            super().__init__(command, stdout=subprocess.PIPE, stderr=stream, text=True)

    def told(self) -> str:
        return self._told.read_text()

    def news(self) -> list[tuple[int, str]]:
        """(tick, text) of each reported change of the link."""
        lines = re.findall(r"^([0-9.]+) s: vcan0 (.*)\n", self.told(), re.MULTILINE)
        return [(round(1000.0 * float(seconds)), text) for seconds, text in lines]

    def wait_for_news(self, ending: str, number: int) -> None:
        wait_for(
            lambda: sum(text.endswith(ending) for _, text in self.news()) >= number,
            f"not told {number} times: {ending}; but: {self.told()}",
            0.01,
        )

    def holds(self) -> tuple[int, int]:
        """Numbers of open file descriptors and of threads."""
        place = Path("/proc", str(self.pid))
        return len(list((place / "fd").iterdir())), len(list((place / "task").iterdir()))

    def wait_until_it_holds(self, held: tuple[int, int]) -> None:
        """Wait for these numbers of descriptors and threads; a check of link or machine opens one for a moment."""
        wait_for(lambda: self.holds() == held, f"holds {self.holds()}, at first {held}")


@contextlib.contextmanager
def emulator(bus: Bus, *more: str, first: int = GATE) -> Iterator[Emulator]:
    """Start the tested program and wait for its first frame on the bus, also on a slow machine."""
    child = Emulator(("--overrun-limit", "60", *more), bus.log.with_name("told.txt"))

    def begun() -> bool:
        assert child.poll() is None or bus.count(first), child.told()
        return bus.count(first) > 0

    try:
        wait_for(begun, "the emulator sent nothing")
        yield child
    finally:
        child.kill()
        child.communicate()


def ended(child: Emulator, number: int | None = None) -> str:
    """Output of the emulator at its end without error; `number` is the signal that ends it."""
    if number is not None:
        child.send_signal(number)
    out, _ = child.communicate(timeout=PATIENCE)
    assert child.returncode == 0, child.told()
    assert "Traceback" not in child.told()
    return out


def summary_of(child: Emulator, number: int | None = signal.SIGTERM) -> dict[str, Any]:
    return json.loads(ended(child, number))


def received(summary: dict[str, Any]) -> int:
    """Number of all frames received, valid or not."""
    counts = summary["received"]
    return sum(number for cause, number in counts.items() if cause != "lost")


def standstills(cycles: int) -> int:
    """Number of these repetitions in which a shared machine may have stalled for longer than the judged time.

    Four of a hundred were seen. A fault of the emulator shows in each cycle or in each second one.
    """
    return cycles // 4


def write_log(path: Path, frames: Sequence[str]) -> Path:
    """Write a log for canplayer: one frame every command period."""
    path.write_text("".join(f"({i * COMMAND_PERIOD:.6f}) vcan0 {frame}\n" for i, frame in enumerate(frames)))
    return path


def texts_of(frames: Iterable[tuple[int, bytes]]) -> list[str]:
    """Classic frames with 11-bit identifiers in the notation of cansend."""
    return [f"{identifier:03X}#{payload.hex()}" for identifier, payload in frames]


SENDER = Path(__file__).with_name("sender.py")


@contextlib.contextmanager
def sending(frames: Sequence[tuple[int, bytes]], rate: float, *more: str) -> Iterator[subprocess.Popen[str]]:
    """Process that sends these frames repeatedly."""
    texts = [f"{identifier:X}#{payload.hex()}" for identifier, payload in frames]
    with running(sys.executable, "-ISB", str(SENDER), f"{rate}", *more, "--", *texts) as child:
        yield child


def sent_by(child: subprocess.Popen[str], number: int | None = signal.SIGTERM, seconds: float = 0.0) -> int:
    """Number of frames that a sender has sent at its end; `number` is the signal that ends it."""
    if number is not None:
        child.send_signal(number)
    out, error = child.communicate(timeout=PATIENCE + seconds)
    assert child.returncode == 0, error
    return int(out)


def link_back() -> None:
    """Restore vcan0 and set it up, after any change."""
    if not Path("/sys/class/net/vcan0").exists():
        run("ip", "link", "add", "dev", "vcan0", "mtu", "72", "type", "vcan")
    run("ip", "link", "set", "vcan0", "up")
    subprocess.run(("tc", "qdisc", "del", "dev", "vcan0", "root"), capture_output=True, check=False)
