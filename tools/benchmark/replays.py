"""Benchmark of replays: the lateness of replayed frames on the bus, for `liftgate-hil replay` and other players.

    python -m tools.benchmark.replays [--bus socketcan:vcan0] [--rounds N] [--seconds S] [--json]

`liftgate-hil replay`, python-can's can.player and can-utils' canplayer play the same log in turns, and the kernel
stamps the frames that arrive. A player's offset is not known: in each run the frame that is earliest against the
log counts as on time.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

GROUP = "239.74.163.77"
SHARES = (0.5, 0.99, 0.999, 1.0)
ROUNDS, SECONDS = 3, 10.0
_PORT = 43113  # port of python-can's udp_multicast
_TIMESTAMPNS = 35  # asm-generic/socket.h
_MEAN_GAP, _LEAST_GAP = 1e-3, 250e-6  # s: 1000 frames/s fill a quarter of 500 kbit/s
_BUFFER = 8 << 20  # bytes
_PATIENCE = 60.0  # s


def write_log(path: Path, channel: str, seconds: float, seed: int = 1) -> Floats:
    """Write a candump log of frames without a period, and return their times (n,) [s]."""
    chance = random.Random(seed)
    times, now = [], 0.0
    while now < seconds:
        times.append(round(now, 6))
        now += _LEAST_GAP + chance.expovariate(1.0 / (_MEAN_GAP - _LEAST_GAP))
    lines = [f"({at:.6f}) {channel} {0x100 + k % 7:03X}#{k:016X}\n" for k, at in enumerate(times)]
    path.write_text("".join(lines), encoding="ascii")
    return np.array(times)


class Ear:
    """Listener that collects the kernel's time stamps of the frames on a bus.

    It polls every 50 ms, so it hardly disturbs a player.
    """

    def __init__(self, interface: str, channel: str) -> None:
        if interface == "socketcan":
            self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            self._socket.bind((channel,))
        else:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind((channel, _PORT))
            member = struct.pack("4sI", socket.inet_aton(channel), socket.INADDR_ANY)
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        for option in (socket.SO_RCVBUF, 33):  # 33: SO_RCVBUFFORCE, needs CAP_NET_ADMIN
            try:
                self._socket.setsockopt(socket.SOL_SOCKET, option, _BUFFER)
            except OSError:
                continue
        self._socket.setsockopt(socket.SOL_SOCKET, _TIMESTAMPNS, 1)
        self._socket.setblocking(False)
        self.stamps: list[float] = []
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self) -> None:
        while not self._is_over.wait(0.05):
            self._take()
        self._take()

    def _take(self) -> None:
        while True:
            try:
                _, ancillary, *_ = self._socket.recvmsg(2048, 64)
            except BlockingIOError:
                return
            for level, kind, data in ancillary:
                if (level, kind) == (socket.SOL_SOCKET, _TIMESTAMPNS):
                    seconds, nanos = struct.unpack("qq", data[:16])
                    self.stamps.append(seconds + 1e-9 * nanos)

    def close(self) -> Floats:
        """Stop listening and return all time stamps (n,) [s]."""
        time.sleep(0.2)
        self._is_over.set()
        self._thread.join()
        self._socket.close()
        return np.array(self.stamps)


def players(interface: str, channel: str, log: Path) -> dict[str, list[str]]:
    """Return the commands that play a log, by player; only players that are available."""
    ours = [sys.executable, "-m", "liftgate_hil", "replay", str(log), "--json"]
    ours += ["--bus", f"{interface}:{channel}"]
    found = {
        "liftgate-hil replay --no-realtime": [*ours, "--no-realtime"],
        "liftgate-hil replay --realtime": [*ours, "--realtime"],
        "can.player": [
            sys.executable, "-m", "can.player", "-i", interface, "-c", channel, str(log),
        ],
    }  # fmt: skip
    if interface == "socketcan" and shutil.which("canplayer"):
        found["canplayer"] = ["canplayer", "-I", str(log)]
    return found


def lateness(arrivals: Floats, due: Floats) -> Floats:
    """Return the lateness (n,) [µs] of each frame against the earliest one; `arrivals` and `due` (n,) are in s."""
    late = (arrivals - arrivals[0]) - (due - due[0])
    return 1e6 * (late - late.min())


def measure(
    bus: str, rounds: int = ROUNDS, seconds: float = SECONDS, is_warmed: bool = True
) -> dict[str, dict[str, list[float]]]:
    """Return the quantiles SHARES of the lateness [µs] by player, as medians of the rounds.

    `arrived` is the lateness on the bus, `reported` the lateness that `liftgate-hil replay` reports of itself.
    """
    interface, _, channel = bus.partition(":")
    runs: dict[str, list[list[float]]] = {}
    own: dict[str, list[list[float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "frames.log"
        due = write_log(log, channel if interface == "socketcan" else "can0", seconds)
        short = Path(folder) / "short.log"
        write_log(short, channel, 0.01)
        for command in players(interface, channel, short).values() if is_warmed else ():  # fills the cache
            subprocess.run(command, check=True, capture_output=True, timeout=_PATIENCE)
        for _ in range(rounds):
            for name, command in players(interface, channel, log).items():
                done, arrivals = _played(command, Ear(interface, channel), seconds)
                if len(arrivals) != len(due):  # a network may lose frames
                    lost = f"{name}: {len(arrivals)} of {len(due)} frames arrived: {done.stderr}"
                    print(lost, file=sys.stderr)
                    continue
                late = lateness(arrivals, due)
                runs.setdefault(name, []).append([float(np.quantile(late, x)) for x in SHARES])
                if "--json" in command:
                    summary = json.loads(done.stdout)
                    figures = [summary[f"lateness_{x}_us"] for x in ("p50", "p99", "p999", "max")]
                    own.setdefault(name, []).append(figures)
    return {
        "arrived": {name: _medians(each) for name, each in runs.items()},
        "reported": {name: _medians(each) for name, each in own.items()},
    }


def _played(command: Sequence[str], ear: Ear, seconds: float) -> tuple[subprocess.CompletedProcess[str], Floats]:
    try:
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=seconds + _PATIENCE)
    finally:
        arrivals = ear.close()
    return done, arrivals


def _medians(runs: Sequence[Sequence[float]]) -> list[float]:
    return [statistics.median(column) for column in zip(*runs, strict=True)]


def table(found: dict[str, dict[str, list[float]]]) -> list[str]:
    """Return the lines of a table of the quantiles."""
    lines = ["| | p50 µs | p99 µs | p99.9 µs | max µs |", "|---|---|---|---|---|"]
    for name, figures in found["arrived"].items():
        lines.append(f"| {name} | " + " | ".join(f"{each:.0f}" for each in figures) + " |")
    for name, figures in found["reported"].items():
        lines.append(f"| {name}, by its own word | " + " | ".join(f"{x:.0f}" for x in figures) + " |")
    return lines


def on_vcan(rounds: int = ROUNDS, seconds: float = SECONDS) -> dict[str, dict[str, list[float]]] | None:
    """Return the result of `measure` on a real vcan0, None if there is no such machine or the run fails."""
    from liftgate_compiler import cache_folder

    command = [sys.executable, "-m", "tools.vcan", "--out", str(cache_folder().parent), "--"]
    command += [sys.executable, "-m", "tools.benchmark.replays", "--bus", "socketcan:vcan0", "--json"]
    command += ["--rounds", str(rounds), "--seconds", str(seconds)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 else None


def main() -> None:
    """Measure on a bus and print the table, or JSON."""
    parser = argparse.ArgumentParser(prog="python -m tools.benchmark.replays", description=__doc__)
    parser.add_argument("--bus", default=f"udp_multicast:{GROUP}", metavar="INTERFACE:CHANNEL")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of the log")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    found = measure(args.bus, args.rounds, args.seconds)
    print(json.dumps(found) if args.json else "\n".join(table(found)))


if __name__ == "__main__":
    main()
