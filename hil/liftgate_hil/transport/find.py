"""Find and open the bus or serial port that `bus`, `serial` or python-can's options or configuration name."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping
from typing import NamedTuple

from liftgate_hil.config.choices import WireChoice
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import ConfigError, words_of
from liftgate_hil.transport.base import Line, Transport
from liftgate_hil.transport.serial_open import parse_serial

# Interfaces whose bit rate is set elsewhere, or that have none.
_NO_BITRATE = ("socketcan", "virtual", "udp_multicast")
_MISSING = (
    "`bus`: missing; allowed: INTERFACE:CHANNEL[@BITRATE], e.g. socketcan:vcan0, or python-can's own "
    "-i and -c, can.conf, or CAN_INTERFACE and CAN_CHANNEL; or `serial` PORT; "
    "none is needed with `ecu` reference, a library or a Python class"
)


def parse_bus(text: str, default_bitrate: float) -> Mapping[str, object]:
    """Return python-can's arguments for a text INTERFACE:CHANNEL[@BITRATE]; the channel may contain colons.

    Raises ConfigError.
    """
    interface, colon, channel = text.partition(":")
    if not colon or not interface or not channel:
        raise ConfigError(
            f"`bus` {text}: allowed: INTERFACE:CHANNEL[@BITRATE], e.g. socketcan:vcan0, "
            "virtual:bench, udp_multicast:239.74.163.2, pcan:PCAN_USBBUS1@500000"
        )
    from liftgate_hil.config.can_libraries import can

    if interface not in can.VALID_INTERFACES:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise ConfigError(f"`bus` {text}: no interface {interface!r}; allowed: {known}")
    arguments: dict[str, object] = {"interface": interface, "channel": channel}
    if interface == "slcan":  # in its channels an @ precedes the serial port's baud rate
        arguments["bitrate"] = int(default_bitrate)
        return arguments
    name, at, rate = channel.rpartition("@")
    if at:
        if not name:
            raise ConfigError(f"`bus` {text}: no channel; allowed: INTERFACE:CHANNEL@BITRATE")
        if not rate.isdigit() or int(rate) == 0:
            raise ConfigError(f"`bus` {text}: bit rate {rate!r}; allowed: a whole number of bit/s")
        if interface in _NO_BITRATE:
            raise ConfigError(f"`bus` {text}: {_no_bitrate(interface)}; allowed: no @{rate}")
        arguments |= {"channel": name, "bitrate": int(rate)}
    elif interface not in _NO_BITRATE:
        arguments["bitrate"] = int(default_bitrate)
    return arguments


def _no_bitrate(interface: str) -> str:
    """Return in words why an interface of _NO_BITRATE takes no bit rate."""
    where = "it is set with `ip link`" if interface == "socketcan" else "frames take no time"
    return f"a bit rate on {interface}, where {where}"


def bus_arguments(choice: WireChoice, rig: Rig) -> Mapping[str, object]:
    """Return python-can's arguments from the option `bus`, from python-can's options or its configuration.

    Raises ConfigError.
    """
    bus, bitrate = choice.bus, choice.bitrate
    given: Mapping[str, object]
    if bus is None:
        given = {"interface": choice.interface, "channel": choice.channel, "bitrate": bitrate}
    elif choice.interface is not None or choice.channel is not None:
        raise ConfigError("`bus` and -i/-c: allowed: one or the other")
    else:
        given = parse_bus(bus, bitrate or rig.bitrate)
    found = _with_configuration({key: each for key, each in given.items() if each is not None})
    if not found.get("interface") or found.get("channel") is None:
        raise ConfigError(_MISSING)
    if bitrate is not None and found["interface"] in _NO_BITRATE:
        raise ConfigError(f"`bitrate` {bitrate}: {_no_bitrate(str(found['interface']))}; allowed: none")
    if found["interface"] == "udp_multicast":
        from liftgate_hil.transport import multicast

        return multicast.checked(found)
    return found


def _with_configuration(given: Mapping[str, object]) -> Mapping[str, object]:
    """Return python-can's arguments, completed from can.conf and CAN_*. Raises ConfigError."""
    from liftgate_hil.config.can_libraries import can

    text = os.environ.get("CAN_CONFIG")
    if text is not None and not _is_object(text):
        raise ConfigError(
            f'CAN_CONFIG {text!r} in the environment: allowed: a JSON object, e.g. {{"hop_limit": 1}}'
        )
    try:
        return dict(can.util.load_config(config=dict(given)))
    except Exception as error:  # its files and its environment may hold anything
        is_configured = bool(given) or any(name.startswith("CAN_") for name in os.environ)
        named = f" (python-can says: {words_of(error)})" if is_configured else ""
        raise ConfigError(_MISSING + named) from error


def _is_object(text: str) -> bool:
    """Whether a text is a JSON object."""
    try:
        return isinstance(json.loads(text), dict)
    except (ValueError, RecursionError):
        return False


class Way(NamedTuple):
    """Address of a connection: python-can's arguments, or a serial port and its baud rate."""

    can: Mapping[str, object] | None
    serial: tuple[str, int] | None
    is_fd: bool

    def is_interface(self, name: str) -> bool:
        """Whether the connection is a bus of the python-can interface `name`, such as socketcan."""
        return self.can is not None and self.can["interface"] == name

    @property
    def interface(self) -> str:
        """Name of python-can's interface, or "serial"."""
        return "serial" if self.can is None else str(self.can["interface"])

    @property
    def reach(self) -> str:
        """In words, which nodes a multicast bus reaches, and if frames may be lost unnoticed; "": no multicast."""
        return self._about_multicast("reach")

    @property
    def within(self) -> str:
        """In words, why no other process can reach the connection; "" if others can."""
        if not self.is_interface("virtual"):
            return ""
        return "a virtual bus is within one process, another one cannot reach it; allowed: another `bus`"

    @property
    def apart(self) -> str:
        """In words, how to separate the bus from another bench's; "" if they cannot meet by accident."""
        return self._about_multicast("apart")

    @property
    def why_full(self) -> str:
        """In words, why frames may be refused for lack of room in buffers."""
        if self.serial is not None:
            return "the line has no room, as its other end does not read, or its rate is too low"
        if self.is_interface("udp_multicast") or self.is_interface("virtual"):
            return "this machine is too busy to carry them"
        return "the queue is full, as no other node acknowledges them or the bus is overloaded"

    def _about_multicast(self, what: str) -> str:
        """Return the text of `multicast.reach` or `multicast.apart` on the bus; "" for other connections."""
        if self.can is None or not self.is_interface("udp_multicast"):
            return ""
        from liftgate_hil.transport import multicast

        return str(getattr(multicast, what)(self.can))

    def bitrate(self, rig: Rig) -> float:
        """Return the CAN bus's bit rate [bit/s]; NaN for a serial line, where frames have other sizes."""
        return math.nan if self.serial is not None else rig.bitrate


def find_way(choice: WireChoice, rig: Rig) -> Way:
    """Return the address of the connection that the user chose. Raises ConfigError."""
    if choice.serial is None:
        return Way(bus_arguments(choice, rig), None, rig.is_fd or choice.is_fd)
    if any((choice.bus, choice.interface, choice.channel, choice.bitrate, choice.is_fd)):
        raise ConfigError("`serial` and `bus`/`interface`/`channel`/`bitrate`/`is_fd`: allowed: one or the other")
    check_serial(rig)
    return Way(None, parse_serial(choice.serial), rig.is_fd)


def open_transport(way: Way) -> Transport:
    """Open the connection for the Python loop. Raises ConfigError, TransportError."""
    if way.serial is not None:
        from liftgate_hil.transport.serial_port import SerialTransport

        return SerialTransport(*way.serial)
    from liftgate_hil.transport.can_bus import CanTransport

    assert way.can is not None
    return CanTransport(way.can, way.is_fd)


def open_line(way: Way, seen_by: Callable[[Transport], Transport] = lambda transport: transport) -> Line:
    """Open the connection for the real-time loop: a SocketCan, or a Pump of the Transport that `seen_by` returns.

    Raises ConfigError, TransportError.
    """
    if way.can is not None and way.is_interface("socketcan"):
        from liftgate_hil.transport.socketcan import SocketCan

        return SocketCan(str(way.can["channel"]), way.is_fd)
    from liftgate_hil.transport.pump import Pump

    return Pump(seen_by(open_transport(way)))


def check_serial(rig: Rig) -> None:
    """Raise ConfigError if a rig uses messages with 29-bit identifiers, which a serial line does not carry."""
    names = dict.fromkeys(wire.message for wire in (*rig.inputs, *rig.outputs))
    issues = [
        f"{rig.source}: {name} has the 29-bit identifier {rig.messages[name].frame_id:#x}; allowed on a "
        "serial line: 11-bit identifiers"
        for name in names
        if rig.messages[name].is_extended_frame
    ]
    if issues:
        raise ConfigError(issues)
