"""Link failures while the emulator runs, ten of each kind (`--link-cycles`): they are reported and counted, the
motors coast, and the feedback recovers. Times judged closely are in ticks of the recording.
"""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hil_support import GATE
from recordings import Story, check_coasting, story_of, telling_commands
from vcan_support import (
    PATIENCE,
    Bus,
    emulator,
    link_back,
    run,
    sending,
    sent_by,
    standstills,
    summary_of,
    wait_for,
)

from liftgate_hil.config.rig import Rig

DOWN, UP = "link set vcan0 down", "link set vcan0 up"
GONE, THERE = "link del vcan0", "link add dev vcan0 mtu 72 type vcan"
FAULTS = {"down and up": ("is down", [DOWN], [UP]), "gone and back": ("is gone", [GONE], [THERE, UP])}
FLAPS = {"gone and back twice": [GONE, THERE, GONE, THERE, UP]}
OUTAGE = 0.06  # s, twice the commands' time-out
AFTER = 10  # ticks from a loss's news to a command before it, where the machine stood still
SHOWN = 110  # ticks from the last command before a loss to its news: 100, and a command period
ERROR_FRAME, BUS_OFF, RESTARTED = 0x20000000, 0x40, 0x100  # linux/can.h, linux/can/error.h
FOREIGN = 0x5A5


class Tool:
    """`ip` or `tc` as one process that reads commands: a process for each would take longer than a fault."""

    def __init__(self, name: str) -> None:
        self._child = subprocess.Popen((name, "-batch", "-"), stdin=subprocess.PIPE, text=True)

    def do(self, *steps: str) -> None:
        """Send a command without waiting until it is executed."""
        assert self._child.poll() is None
        print("\n".join(steps), file=self._child.stdin, flush=True)

    def close(self) -> None:
        self._child.communicate(timeout=PATIENCE)
        assert self._child.returncode == 0


@pytest.fixture
def ip() -> Iterator[Tool]:
    with contextlib.closing(Tool("ip")) as tool:
        yield tool


@pytest.fixture
def tc() -> Iterator[Tool]:
    with contextlib.closing(Tool("tc")) as tool:
        yield tool


def raw_socket() -> socket.socket:
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    raw.bind(("vcan0",))
    return raw


def feedback_within(seconds: float) -> bool:
    """Whether a Gate frame arrives in time, on an interface that may have to return first."""
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0.0:
        with contextlib.suppress(OSError), raw_socket() as raw:
            heard = struct.pack("=II", GATE, 0x7FF)
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, heard)
            raw.settimeout(left)
            raw.recv(16)
            return True
        time.sleep(0.002)
    return False


def check_shown(losses: list[int], story: Story) -> None:
    """Assert that each loss was reported soon after the last command before it, unless the machine stood still. A
    tick caught up gets a command at its own time, some ticks after a loss reported with it.
    """
    before = [[tick for tick in story.accepted if tick <= told + AFTER] for told in losses]
    lags = sorted(told - max(ticks, default=-math.inf) for told, ticks in zip(losses, before, strict=True))
    assert lags[len(lags) - 1 - standstills(len(lags))] <= SHOWN, lags


@pytest.mark.parametrize(("told", "breaks", "mends"), FAULTS.values(), ids=FAULTS)
def test_a_lost_link_is_reported_makes_the_motors_coast_and_recovers(
    tmp_path: Path, ip: Tool, bus: Bus, rig: Rig, link_cycles: int,
    told: str, breaks: list[str], mends: list[str],
) -> None:  # fmt: skip
    record = tmp_path / "run.csv"
    with emulator(bus, "--json", "--record", str(record)) as gate:
        with sending(telling_commands(rig), 100.0) as ecu:
            bus.wait_for_more(0x120, 10)
            held = gate.holds()
            for cycle in range(link_cycles):
                ip.do(*breaks)
                gate.wait_for_news(told, cycle + 1)
                time.sleep(OUTAGE)
                ip.do(*mends)
                assert feedback_within(PATIENCE)
                gate.wait_for_news("is back", cycle + 1)
                time.sleep(0.05)
            wait_for(
                lambda: all(now <= then for now, then in zip(gate.holds(), held, strict=True)),
                f"holds {gate.holds()}, at first {held}",
            )
            sent = sent_by(ecu)
        time.sleep(0.1)
        news = gate.news()
        assert "cannot be sent" not in gate.told()  # that the link is down says it
        summary = summary_of(gate)
    assert summary["link"]["losses"] == link_cycles
    assert summary["link"]["bus_offs"] == summary["link"]["dropped"] == 0
    losses = [tick for tick, text in news if text == told]
    # Between gone and back it may be seen while it is down.
    assert {text for _, text in news} <= {told, "is down", "is back"}
    assert len(losses) == sum(text == "is back" for _, text in news) == link_cycles
    assert summary["received"]["accepted"] <= sent
    assert summary["received"]["accepted"] >= 2 * link_cycles
    story = story_of(record)
    check_coasting(story)
    check_shown(losses, story)
    # One for each loss, one at the end. Where the machine stood still there is one more, or, where no command came
    # between two losses, one less.
    assert summary["command_timeouts"] == len(story.stale)
    assert abs(len(story.stale) - (link_cycles + 1)) <= standstills(link_cycles)
    for tick in losses:
        assert any(driven - 200 <= tick <= driven + 1000 for _, driven in story.stale)


@pytest.mark.parametrize("steps", FLAPS.values(), ids=FLAPS)
def test_a_link_that_flaps_is_reported_and_counted_once(
    ip: Tool, bus: Bus, link_cycles: int, steps: list[str]
) -> None:
    with emulator(bus, "--json") as gate:
        held = gate.holds()
        for cycle in range(link_cycles):
            ip.do(*steps)
            gate.wait_for_news("is back", cycle + 1)
            assert feedback_within(PATIENCE)
        gate.wait_until_it_holds(held)
        news = gate.news()
        summary = summary_of(gate)
    assert summary["link"]["losses"] == link_cycles
    assert sum(text.endswith("is back") for _, text in news) == link_cycles


def test_an_interface_down_between_two_checks_does_no_harm(ip: Tool, bus: Bus, link_cycles: int) -> None:
    """Not every interruption is noticed, so the number of reports is not judged."""
    with emulator(bus, "--json") as gate:
        held = gate.holds()
        for _ in range(link_cycles):
            ip.do(DOWN, UP)
            time.sleep(0.05)
            assert feedback_within(PATIENCE)
        gate.wait_until_it_holds(held)
        summary = summary_of(gate)
    assert summary["link"]["losses"] <= link_cycles
    assert summary["link"]["bus_offs"] == summary["link"]["dropped"] == 0


def test_a_burst_of_link_changes_is_survived(ip: Tool, bus: Bus, link_cycles: int) -> None:
    with emulator(bus, "--json") as gate:
        held = gate.holds()
        ip.do(*[DOWN, UP, GONE, THERE, UP] * link_cycles)
        assert feedback_within(PATIENCE)
        gate.wait_for_news("is back", 1)
        gate.wait_until_it_holds(held)
        summary = summary_of(gate)
    assert 1 <= summary["link"]["losses"] <= 2 * link_cycles


RETURNS = {"by its restart": [(ERROR_FRAME | RESTARTED, bytes(8))], "by a frame of another": [(FOREIGN, b"")]}


def send(raw: socket.socket, frames: list[tuple[int, bytes]]) -> None:
    for identifier, payload in frames:
        raw.send(struct.pack("<IBxxx8s", identifier, len(payload), payload))


@pytest.mark.parametrize("returns", RETURNS.values(), ids=RETURNS)
def test_bus_off_and_its_end_are_reported(
    tmp_path: Path, bus: Bus, rig: Rig, link_cycles: int, returns: list[tuple[int, bytes]]
) -> None:
    record = tmp_path / "run.csv"
    commands = telling_commands(rig)
    hint = "is bus-off; to restart it automatically: ip link set vcan0 type can restart-ms 100"
    with emulator(bus, "--json", "--record", str(record)) as gate, raw_socket() as raw:
        for cycle in range(link_cycles):
            off = (ERROR_FRAME | BUS_OFF, bytes(8))
            send(raw, [commands[cycle % 16], off, off])
            gate.wait_for_news(hint, cycle + 1)
            time.sleep(OUTAGE)
            send(raw, returns)
            gate.wait_for_news("is back", cycle + 1)
        time.sleep(0.1)
        news = gate.news()
        summary = summary_of(gate)
    assert [text for _, text in news] == [hint, "is back"] * link_cycles
    assert summary["link"]["losses"] == summary["link"]["bus_offs"] == link_cycles
    restarts = sum(identifier & ERROR_FRAME != 0 for identifier, _ in returns)
    assert summary["received"]["error"] == (2 + restarts) * link_cycles
    assert summary["received"]["accepted"] == summary["command_timeouts"] == link_cycles
    story = story_of(record)
    check_coasting(story)
    check_shown([tick for tick, text in news if text == hint], story)


def test_a_short_bus_off_is_reported_and_counted(bus: Bus, link_cycles: int) -> None:
    with emulator(bus, "--json") as gate, raw_socket() as raw:
        for cycle in range(link_cycles):
            send(raw, [(ERROR_FRAME | BUS_OFF, bytes(8)), (ERROR_FRAME | RESTARTED, bytes(8))])
            gate.wait_for_news("is back", cycle + 1)
        summary = summary_of(gate)
    assert summary["link"]["losses"] == summary["link"]["bus_offs"] == link_cycles


@pytest.fixture
def pair() -> Iterator[None]:
    """vcan0 as one end of a pair; taking the other end down removes its carrier."""
    link_back()
    run("ip", "link", "del", "vcan0")
    kind = ("mtu", "72", "type", "vxcan", "peer", "name", "vcan0peer")
    run("ip", "link", "add", "dev", "vcan0", *kind)
    run("ip", "link", "set", "vcan0peer", "up")
    yield
    run("ip", "link", "del", "vcan0")


@pytest.mark.usefixtures("pair")
def test_a_lost_carrier_is_reported_with_the_remedy_for_bus_off(ip: Tool, bus: Bus, link_cycles: int) -> None:
    hint = "is not running (bus-off?); to restart it automatically: ip link set vcan0 type can restart-ms 100"
    with emulator(bus, "--json") as gate:
        held = gate.holds()
        for cycle in range(link_cycles):
            ip.do("link set vcan0peer down")
            gate.wait_for_news(hint, cycle + 1)
            ip.do("link set vcan0peer up")
            gate.wait_for_news("is back", cycle + 1)
        gate.wait_until_it_holds(held)
        news = gate.news()
        summary = summary_of(gate)
    assert [text for _, text in news] == [hint, "is back"] * link_cycles
    assert summary["link"]["losses"] == link_cycles
    assert summary["link"]["bus_offs"] == 0


FULL, FREE = "pfifo limit 0", "pfifo limit 1000"


def test_a_full_send_queue_is_counted_and_commands_are_still_received(
    tmp_path: Path, tc: Tool, bus: Bus, rig: Rig, link_cycles: int
) -> None:
    """The ECU's frames have another queue than the emulator's: of the first band, for their priority."""
    record = tmp_path / "run.csv"

    def queue(kind: str) -> None:
        tc.do(f"qdisc replace dev vcan0 parent 1:2 {kind}")

    tc.do("qdisc add dev vcan0 root handle 1: prio")
    with emulator(bus, "--json", "--record", str(record)) as gate:
        held = gate.holds()
        with sending(telling_commands(rig), 100.0, "--priority", "6") as ecu:
            bus.wait_for_more(0x120, 10)
            for _ in range(link_cycles):
                queue(FULL)
                time.sleep(0.05)
                queue(FREE)
                assert feedback_within(PATIENCE)
            sent = sent_by(ecu)
        gate.wait_until_it_holds(held)
        time.sleep(0.1)
        queue(FULL)
        time.sleep(0.05)
        seen = bus.count(GATE)
        gate.terminate()
        time.sleep(0.03)
        queue(FREE)
        summary = summary_of(gate, None)
        wait_for(lambda: len(bus.frames()) >= summary["frames_sent"] + sent, "frames are missing")
    link = summary["link"]
    assert link["send_failures"] == link["send_queue_full"] >= 5 * link_cycles
    assert link["losses"] == link["receive_failures"] == link["dropped"] == 0
    assert gate.news() == []
    assert "frames cannot be sent: the queue is full" in gate.told()
    assert len(bus.frames()) == summary["frames_sent"] + sent
    assert bus.count(GATE) > seen
    assert bus.last(rig, "BenchStatus")["EmulatorState"] == 3  # stopped
    assert (summary["received"]["accepted"], summary["received"]["lost"]) == (sent, 0)
    story = story_of(record)
    check_coasting(story)
    assert summary["command_timeouts"] == len(story.stale) <= standstills(link_cycles)
