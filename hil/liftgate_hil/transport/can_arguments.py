"""Arguments for python-can: from `bus`, from its own options, or from its own configuration."""

from __future__ import annotations

import json
import os
from typing import Any

from liftgate_hil.config.rig import Rig
from liftgate_hil.config.wire_choice import WireChoice
from liftgate_hil.errors import ConfigError, words_of

# Interfaces whose bit rate is set elsewhere, or that have none.
_NO_BITRATE = ("socketcan", "virtual", "udp_multicast")
_MISSING = (
    "`bus`: missing; allowed: INTERFACE:CHANNEL[@BITRATE], e.g. socketcan:vcan0, or python-can's own "
    "-i and -c, can.conf, or CAN_INTERFACE and CAN_CHANNEL; or `serial` PORT; "
    "none is needed with `ecu` reference, a library or a Python class"
)


def parse_bus(text: str, default_bitrate: float) -> dict[str, Any]:
    """Return python-can's arguments for INTERFACE:CHANNEL[@BITRATE]; the channel may contain colons.

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
    arguments: dict[str, Any] = {"interface": interface, "channel": channel}
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
    where = "it is set with `ip link`" if interface == "socketcan" else "frames take no time"
    return f"a bit rate on {interface}, where {where}"


def bus_arguments(choice: WireChoice, rig: Rig) -> dict[str, Any]:
    """Return python-can's arguments, from `bus`, from its own options, or from its own configuration.

    Raises ConfigError.
    """
    bus, bitrate = choice.bus, choice.bitrate
    given: dict[str, Any]
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
        raise ConfigError(f"`bitrate` {bitrate}: {_no_bitrate(found['interface'])}; allowed: none")
    if found["interface"] == "udp_multicast":
        from liftgate_hil.transport import multicast

        return multicast.checked(found)
    return found


def _with_configuration(given: dict[str, Any]) -> dict[str, Any]:
    """Return these arguments as python-can completes them from can.conf and CAN_*. Raises ConfigError."""
    from liftgate_hil.config.can_libraries import can

    text = os.environ.get("CAN_CONFIG")
    if text is not None and not _is_object(text):
        raise ConfigError(
            f'CAN_CONFIG {text!r} in the environment: allowed: a JSON object, e.g. {{"hop_limit": 1}}'
        )
    try:
        return dict(can.util.load_config(config=given))
    except Exception as error:  # its files and its environment may hold anything
        named = f" (python-can says: {words_of(error)})" if _is_configured(given) else ""
        raise ConfigError(_MISSING + named) from error


def _is_configured(given: dict[str, Any]) -> bool:
    """Whether anything about a bus is given, in the arguments or in the environment variables CAN_*."""
    return bool(given) or any(name.startswith("CAN_") for name in os.environ)


def _is_object(text: str) -> bool:
    try:
        return isinstance(json.loads(text), dict)
    except (ValueError, RecursionError):
        return False
