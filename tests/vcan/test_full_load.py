"""A fully loaded bus of 500 kbit/s: no command is lost, and frames dropped by the kernel are reported."""

from __future__ import annotations

import signal
import time

import pytest
from hil_support import BENCH_STATUS, GATE
from recordings import telling_commands
from vcan_support import Bus, emulator, received, sending, sent_by, summary_of

from liftgate_hil.config.rig import Rig

# Identifiers that are not the gate's, spread over all of them; those of no payload are as fast as a bus can have.
FOREIGN = [0x001, 0x111, 0x2FF, 0x300, 0x456, 0x5A5, 0x700, 0x7FF]
LOADS = {"of 8 bytes": (4505, bytes(range(8))), "of none": (10_638, b"")}
BEYOND_THE_BUFFER = 60_000  # frames; 16 MiB hold some 20,000


@pytest.mark.parametrize(("rate", "payload"), LOADS.values(), ids=LOADS)
@pytest.mark.parametrize("seen", [(GATE, BENCH_STATUS)], ids=[""], indirect=True)
def test_a_full_bus_loses_no_command(bus: Bus, rig: Rig, load_seconds: float, rate: int, payload: bytes) -> None:
    """The load lasts some seconds, in real time."""
    count = round(rate * load_seconds)
    flood = [(identifier, payload) for identifier in FOREIGN]
    with emulator(bus, "--json") as gate:
        with sending(telling_commands(rig), 100.0) as ecu:
            with sending(flood, rate, "--count", str(count)) as flooder:
                assert sent_by(flooder, None, load_seconds) == count
            sent = sent_by(ecu)
        bus.settle()
        summary = summary_of(gate)
    counts = summary["received"]
    assert (counts["accepted"], counts["lost"], summary["rejected_frames"]) == (sent, 0, 0)
    assert counts["foreign"] == count
    assert received(summary) == sent + count
    assert not any(summary["link"].values())


@pytest.mark.parametrize("seen", [(GATE, BENCH_STATUS)], ids=[""], indirect=True)
def test_frames_dropped_by_the_kernel_while_the_reader_stands_still_are_reported(bus: Bus, rig: Rig) -> None:
    """The flood is longer than the socket's buffer."""
    flood = [(identifier, b"") for identifier in FOREIGN]
    with emulator(bus, "--json") as gate:
        with sending(telling_commands(rig), 100.0) as ecu:
            gate.send_signal(signal.SIGSTOP)
            with sending(flood, 20_000.0, "--count", str(BEYOND_THE_BUFFER)) as flooder:
                assert sent_by(flooder, None) == BEYOND_THE_BUFFER
            gate.send_signal(signal.SIGCONT)
            # The kernel tells its count with the next frame that it takes.
            time.sleep(0.5)
            sent = sent_by(ecu)
        bus.settle()
        summary = summary_of(gate)
    counts, dropped = summary["received"], summary["link"]["dropped"]
    assert 0 < dropped < BEYOND_THE_BUFFER
    assert received(summary) + dropped == BEYOND_THE_BUFFER + sent
    assert 0 < counts["accepted"] < sent
    assert summary["link"] == dict.fromkeys(summary["link"], 0) | {"dropped": dropped}
