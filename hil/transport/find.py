"""Which bus is meant: `--bus`, python-can's own flags, or its own configuration."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from hil.config.rig import Rig
from hil.errors import ConfigError
from hil.transport.can_bus import parse_bus

if TYPE_CHECKING:
    from hil.transport.base import Line
    from hil.transport.can_bus import CanTransport

_MISSING = (
    "--bus: missing; allowed: INTERFACE:CHANNEL[@BITRATE], e.g. socketcan:vcan0, or python-can's own "
    "-i and -c, can.conf, or CAN_INTERFACE and CAN_CHANNEL"
)


def bus_arguments(
    bus: str | None,
    interface: str | None,
    channel: str | None,
    bitrate: int | None,
    rig: Rig,
) -> dict[str, Any]:
    """python-can's arguments, from `--bus`, from its own `-i -c -b`, or from its own configuration.

    Raises ConfigError.
    """
    if bus is not None:
        if interface is not None or channel is not None:
            raise ConfigError("--bus and -i/-c: allowed: one or the other")
        return parse_bus(bus, bitrate or rig.bitrate)
    from hil.python_can import can

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


def open_transport(args: argparse.Namespace, rig: Rig) -> CanTransport:
    """The bus of the flags, for a loop in Python. Raises ConfigError, TransportError."""
    from hil.transport.can_bus import CanTransport

    arguments = bus_arguments(args.bus, args.interface, args.channel, args.bitrate, rig)
    return CanTransport(arguments, rig.is_fd or args.fd)


def open_line(args: argparse.Namespace, rig: Rig) -> Line:
    """The bus of the flags, for the hard loop. Raises ConfigError, TransportError."""
    from hil.transport.pump import Pump

    arguments = bus_arguments(args.bus, args.interface, args.channel, args.bitrate, rig)
    if arguments["interface"] == "socketcan":
        from hil.transport.socketcan import SocketCan

        return SocketCan(str(arguments["channel"]), rig.is_fd or args.fd)
    return Pump(open_transport(args, rig))
