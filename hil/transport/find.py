"""Which wire is meant: `--bus`, `--serial`, python-can's own flags, or its own configuration."""

from __future__ import annotations

import argparse
from typing import Any

from hil.config.rig import Rig
from hil.errors import ConfigError
from hil.transport.base import Transport
from hil.transport.can_bus import CanTransport, parse_bus
from hil.transport.serial_open import parse_serial
from hil.transport.serial_port import SerialTransport

_MISSING = (
    "--bus: missing; allowed: INTERFACE:CHANNEL[@BITRATE], e.g. socketcan:vcan0, or python-can's own "
    "-i and -c, can.conf, or CAN_INTERFACE and CAN_CHANNEL; or --serial PORT"
)


def open_transport(args: argparse.Namespace, rig: Rig) -> Transport:
    """The wire that the flags of `commands.options.add_bus` mean, open.

    Raises ConfigError for flags or a rig that cannot be, TransportError for a wire that cannot be opened.
    """
    if args.serial is None:
        arguments = bus_arguments(args.bus, args.interface, args.channel, args.bitrate, rig)
        return CanTransport(arguments, rig.is_fd or args.fd)
    given = (args.bus, args.interface, args.channel, args.bitrate, args.fd or None)
    if any(value is not None for value in given):
        raise ConfigError("--serial and --bus/-i/-c/-b/--fd: allowed: one or the other")
    port, baudrate = parse_serial(args.serial)
    check_serial(rig)
    return SerialTransport(port, baudrate)


def check_serial(rig: Rig) -> None:
    """Raises ConfigError where a rig has messages that a serial line cannot carry."""
    names = dict.fromkeys(wire.message for wire in (*rig.inputs, *rig.outputs))
    faults = [
        f"{rig.source}: {name} has the 29-bit identifier {rig.messages[name].frame_id:#x}; allowed on a "
        "serial line: 11-bit identifiers"
        for name in names
        if rig.messages[name].is_extended_frame
    ]
    if faults:
        raise ConfigError(faults)


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
