"""Which wire is meant: `bus`, `serial`, python-can's own flags, or its own configuration."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import ConfigError
from liftgate_hil.transport.base import Line, Transport
from liftgate_hil.transport.can_bus import CanTransport, parse_bus
from liftgate_hil.transport.serial_open import parse_serial

_MISSING = (
    "`bus`: missing; allowed: INTERFACE:CHANNEL[@BITRATE], e.g. socketcan:vcan0, or python-can's own "
    "-i and -c, can.conf, or CAN_INTERFACE and CAN_CHANNEL; or `serial` PORT"
)


class WireChoice(NamedTuple):
    """What the user said of the wire: a bus by one text or by python-can's own words, or a serial port."""

    bus: str | None = None  # INTERFACE:CHANNEL[@BITRATE]
    serial: str | None = None  # PORT[@BAUD]
    interface: str | None = None
    channel: str | None = None
    bitrate: int | None = None  # bit/s
    is_fd: bool = False


class Way(NamedTuple):
    """Where a wire is: python-can's arguments, or a serial port and its rate."""

    can: dict[str, Any] | None
    serial: tuple[str, int] | None
    is_fd: bool

    def is_interface(self, name: str) -> bool:
        """Whether it is that interface of python-can's."""
        return self.can is not None and self.can["interface"] == name

    def bitrate(self, rig: Rig) -> float:
        """Of the CAN bus [bit/s]; NaN on a serial line, where frames have other sizes."""
        return math.nan if self.serial is not None else rig.bitrate


def find_way(choice: WireChoice, rig: Rig) -> Way:
    """The wire that is meant. Raises ConfigError."""
    if choice.serial is None:
        return Way(bus_arguments(choice, rig), None, rig.is_fd or choice.is_fd)
    if choice._replace(serial=None) != WireChoice():
        raise ConfigError("`serial` and `bus`/-i/-c/-b/`fd`: allowed: one or the other")
    check_serial(rig)
    return Way(None, parse_serial(choice.serial), rig.is_fd)


def open_transport(way: Way) -> Transport:
    """The wire for a loop in Python. Raises ConfigError, TransportError."""
    if way.serial is not None:
        from liftgate_hil.transport.serial_port import SerialTransport

        return SerialTransport(*way.serial)
    assert way.can is not None
    return CanTransport(way.can, way.is_fd)


def open_line(way: Way) -> Line:
    """The wire for the real-time loop. Raises ConfigError, TransportError."""
    if way.can is not None and way.is_interface("socketcan"):
        from liftgate_hil.transport.socketcan import SocketCan

        return SocketCan(str(way.can["channel"]), way.is_fd)
    from liftgate_hil.transport.pump import Pump

    return Pump(open_transport(way))


def check_serial(rig: Rig) -> None:
    """Raises ConfigError where a rig has messages that a serial line cannot carry."""
    names = dict.fromkeys(wire.message for wire in (*rig.inputs, *rig.outputs))
    issues = [
        f"{rig.source}: {name} has the 29-bit identifier {rig.messages[name].frame_id:#x}; allowed on a "
        "serial line: 11-bit identifiers"
        for name in names
        if rig.messages[name].is_extended_frame
    ]
    if issues:
        raise ConfigError(issues)


def bus_arguments(choice: WireChoice, rig: Rig) -> dict[str, Any]:
    """python-can's arguments, from `bus`, from its own words, or from its own configuration.

    Raises ConfigError.
    """
    bus, interface, channel, bitrate = (
        choice.bus, choice.interface, choice.channel, choice.bitrate,
    )  # fmt: skip
    if bus is not None:
        if interface is not None or channel is not None:
            raise ConfigError("`bus` and -i/-c: allowed: one or the other")
        return parse_bus(bus, bitrate or rig.bitrate)
    from liftgate_hil.python_can import can

    given: dict[str, Any] = {"interface": interface, "channel": channel, "bitrate": bitrate}
    try:
        found = can.util.load_config(
            config={key: value for key, value in given.items() if value is not None}
        )
    except (can.CanError, ValueError, OSError) as error:
        named = f" (python-can says: {error})" if interface is not None else ""
        raise ConfigError(_MISSING + named) from error
    if not found.get("interface") or found.get("channel") is None:
        raise ConfigError(_MISSING)
    if found["interface"] == "udp_multicast":
        found.setdefault("hop_limit", 0)
    return dict(found)
