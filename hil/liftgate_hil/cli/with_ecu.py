"""The emulator on a bus together with the ECU that `--ecu` names."""

from __future__ import annotations

import argparse
import contextlib
import re
import subprocess
import sys
from collections.abc import Iterator
from typing import IO, TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.errors import ConfigError, LiftgateError

if TYPE_CHECKING:
    from liftgate_hil.emulator import Emulator
    from liftgate_hil.loop.statistics import Summary

ON_A_BUS = "bus"  # the ECU is somebody else's
_EVENT = re.compile(r"^ecu\s+([\d.]+) s  (.*)$")

Events = list[tuple[float, str]]


def on_a_bus(args: argparse.Namespace, emulator: Emulator) -> tuple[Summary, Events]:
    """On a virtual bus with the ECU in this process, on any other one with the ECU as a second process."""
    if args.ecu == ON_A_BUS:
        return emulator.run(), []
    from liftgate_hil.ecu.find import adapter_for
    from liftgate_hil.ecu.peer import Peer
    from liftgate_hil.transport.find import open_transport

    setup = emulator.setup
    drives = setup.vehicle.drives
    if emulator.way.is_interface("virtual"):
        with contextlib.ExitStack() as stack:
            wire = open_transport(emulator.way)
            stack.callback(wire.close)
            adapter = stack.enter_context(adapter_for(options.ecu_of(args), emulator.rig, drives))
            emulator.peers = [Peer(adapter, wire, setup.scenario.requests)]
            summary = emulator.run()
            return summary, [(event.time, event.text) for event in adapter.events()]
    if args.clock == "free":
        raise ConfigError("`clock` free: allowed without a bus, or on a virtual one")
    with _ecu_process(args, drives) as child:
        summary = emulator.run()
        child.terminate()
        return summary, _events_of(child, args.ecu)


@contextlib.contextmanager
def _ecu_process(args: argparse.Namespace, drives: int) -> Iterator[subprocess.Popen[str]]:
    """`liftgate-hil ecu` on the same bus; ended with this process."""
    command = [sys.executable, "-P", "-m", "liftgate_hil", "ecu"]
    command += ["--drives", str(drives), "--ecu", args.ecu]
    for flag in ("scenario", "rig", "bus", "interface", "channel", "bitrate"):
        value = getattr(args, flag)
        if value is not None:
            command += [f"--{flag}", str(value)]
    if getattr(args, "ecu_serial", None) is not None:
        command += ["--serial", args.ecu_serial]
    command += [flag for flag in ("--fd", "--realtime") if getattr(args, flag.strip("-"))]
    child = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        yield child
    finally:
        child.kill()
        child.wait()


def _events_of(child: subprocess.Popen[str], ecu: str) -> Events:
    stream: IO[str] | None = child.stderr
    assert stream is not None
    lines = stream.read().splitlines()
    matches = [match for line in lines if (match := _EVENT.match(line))]
    if not matches and ecu == "reference":
        detail = " ".join(lines)[:300] or "it said nothing"
        raise LiftgateError(f"the ECU's process did not take part: {detail}")
    return [(float(match[1]), match[2]) for match in matches]
