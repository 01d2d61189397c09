"""Find and open the wire of `bus`, `serial`, python-can's own flags, or its own configuration."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from liftgate_hil.config.rig import Rig
from liftgate_hil.config.wire_choice import WireChoice
from liftgate_hil.errors import ConfigError
from liftgate_hil.transport.base import Line, Transport
from liftgate_hil.transport.can_arguments import bus_arguments
from liftgate_hil.transport.serial_open import parse_serial


class Way(NamedTuple):
    """The address of a wire: python-can's arguments, or a serial port and its rate."""

    can: dict[str, Any] | None
    serial: tuple[str, int] | None
    is_fd: bool

    def is_interface(self, name: str) -> bool:
        """Whether the wire is a bus of the python-can interface `name`, such as socketcan."""
        return self.can is not None and self.can["interface"] == name

    @property
    def interface(self) -> str:
        """The name of python-can's interface, or serial."""
        return "serial" if self.can is None else str(self.can["interface"])

    @property
    def reach(self) -> str:
        """In words, who can reach the wire; "" if that is obvious."""
        return self._about_multicast("reach")

    @property
    def within(self) -> str:
        """In words, why no other process can reach the wire; "" if others can."""
        if not self.is_interface("virtual"):
            return ""
        return "a virtual bus is within one process, another one cannot reach it; allowed: another `bus`"

    @property
    def apart(self) -> str:
        """In words, how to separate the wire from that of another bench; "" if they cannot meet by accident."""
        return self._about_multicast("apart")

    @property
    def why_full(self) -> str:
        """In words, why frames may find no room on the wire."""
        if self.serial is not None:
            return "the line has no room, as its other end does not read, or its rate is too low"
        if self.is_interface("udp_multicast") or self.is_interface("virtual"):
            return "this machine is too busy to carry them"
        return "the queue is full, as no other node acknowledges them or the bus is overloaded"

    def _about_multicast(self, what: str) -> str:
        if self.can is None or not self.is_interface("udp_multicast"):
            return ""
        from liftgate_hil.transport import multicast

        return str(getattr(multicast, what)(self.can))

    def bitrate(self, rig: Rig) -> float:
        """Return the bit rate of the CAN bus [bit/s]; NaN for a serial line, where frames have other sizes."""
        return math.nan if self.serial is not None else rig.bitrate


def find_way(choice: WireChoice, rig: Rig) -> Way:
    """Return the wire that the user chose. Raises ConfigError."""
    if choice.serial is None:
        return Way(bus_arguments(choice, rig), None, rig.is_fd or choice.is_fd)
    if any((choice.bus, choice.interface, choice.channel, choice.bitrate, choice.is_fd)):
        raise ConfigError("`serial` and `bus`/`interface`/`channel`/`bitrate`/`is_fd`: allowed: one or the other")
    check_serial(rig)
    return Way(None, parse_serial(choice.serial), rig.is_fd)


def open_transport(way: Way) -> Transport:
    """Open the wire for the Python loop. Raises ConfigError, TransportError."""
    if way.serial is not None:
        from liftgate_hil.transport.serial_port import SerialTransport

        return SerialTransport(*way.serial)
    from liftgate_hil.transport.can_bus import CanTransport

    assert way.can is not None
    return CanTransport(way.can, way.is_fd)


def _itself(transport: Transport) -> Transport:
    return transport


def open_line(way: Way, seen_by: Callable[[Transport], Transport] = _itself) -> Line:
    """Open the wire for the real-time loop; `seen_by` may wrap a transport in Python.

    Raises ConfigError, TransportError.
    """
    if way.can is not None and way.is_interface("socketcan"):
        from liftgate_hil.transport.socketcan import SocketCan

        return SocketCan(str(way.can["channel"]), way.is_fd)
    from liftgate_hil.transport.pump import Pump

    return Pump(seen_by(open_transport(way)))


def check_serial(rig: Rig) -> None:
    """Raise ConfigError if a rig has messages that a serial line cannot carry."""
    names = dict.fromkeys(wire.message for wire in (*rig.inputs, *rig.outputs))
    issues = [
        f"{rig.source}: {name} has the 29-bit identifier {rig.messages[name].frame_id:#x}; allowed on a "
        "serial line: 11-bit identifiers"
        for name in names
        if rig.messages[name].is_extended_frame
    ]
    if issues:
        raise ConfigError(issues)
