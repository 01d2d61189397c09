"""python-can's UDP multicast bus: its reach, and which datagrams are accepted.

A socket receives what is sent to the group from anywhere, even if its own frames do not leave the machine. So
senders on other machines are refused, unless python-can's own `hop_limit` says that the network is meant.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import socket
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from liftgate_hil.config.can_libraries import can as _can
from liftgate_hil.errors import ConfigError, TransportError
from liftgate_hil.transport.messages import NotAFrameError
from liftgate_hil.transport.receive_buffer import tells_drops

if TYPE_CHECKING:
    import can

INTERFACE = "udp_multicast"
_ALLOWED = "allowed: a group of 224.0.0.0/4 or ff00::/8, e.g. 239.74.163.2"
_MAX_HOPS = 255
# linux/in.h, linux/in6.h; Python has no names for them.
_IP_MULTICAST_ALL, _IPV6_MULTICAST_ALL = 49, 29
_ECHOES = 256
_UNNOTICED = "this kernel does not count dropped frames: losses go unnoticed (Linux 4.12 and later count them)"
_KNOWN_S = 1.0  # s for which it is remembered whether an address is this machine's
_KNOWN = 64  # addresses that are remembered at most


class RefusedError(Exception):
    """Raised for a datagram of another machine, which is refused."""


def checked(arguments: Mapping[str, object]) -> Mapping[str, object]:
    """Check python-can's multicast arguments; return them with a hop limit, by default 0. Raises ConfigError.

    With 0 the bus stays on this machine; with python-can's own default it leaves it.
    """
    group = str(arguments["channel"])
    try:
        address = ipaddress.ip_address(group)
        is_group = address.is_multicast and getattr(address, "scope_id", None) is None
    except ValueError:
        is_group = False
    if not is_group:
        raise ConfigError(f"`bus` {INTERFACE}:{group}: not a multicast address; {_ALLOWED}")
    hops = arguments.get("hop_limit", 0)
    if not isinstance(hops, int) or not 0 <= hops <= _MAX_HOPS:
        raise ConfigError(
            f"`bus` {INTERFACE}:{group}: hop_limit {hops!r} of can.conf or CAN_CONFIG; allowed: 0 (this machine "
            f"only) to {_MAX_HOPS}"
        )
    return {**arguments, "hop_limit": hops}


def reach(arguments: Mapping[str, object]) -> str:
    """Return in words how far a multicast bus reaches, and whether it may lose frames unnoticed."""
    found = (
        "reaches this machine only, others are refused; allowed for a network: hop_limit above 0 in can.conf, or "
        "CAN_CONFIG='{\"hop_limit\": 1}'"
    )
    if arguments["hop_limit"]:
        found = "reaches the network: any machine there can command the gate"
    return found if tells_drops() else f"{found}; {_UNNOTICED}"


def apart(arguments: Mapping[str, object]) -> str:
    """Return in words how to keep a multicast bus separate from another bench's on this machine."""
    group = ipaddress.ip_address(str(arguments["channel"]))
    other = group + 1 if (group + 1).is_multicast else group - 1
    return (
        "two benches on one machine need one group each, the same for gate and ECU: "
        f"--bus {INTERFACE}:{other} for one of them"
    )


def check_route(group: str) -> None:
    """Raise TransportError if there is no route to a multicast group, an error python-can does not explain."""
    is_ipv4 = ipaddress.ip_address(group).version == 4
    try:
        with socket.socket(socket.AF_INET if is_ipv4 else socket.AF_INET6, socket.SOCK_DGRAM) as probe:
            probe.connect((group, 1))  # sends nothing
    except OSError as error:
        if error.errno not in (errno.ENETUNREACH, errno.EADDRNOTAVAIL, errno.ENODEV):
            raise
        how = "a group of IPv4"
        if is_ipv4:
            how = "after: sudo ip route add 224.0.0.0/4 dev lo src 127.0.0.1"
        raise TransportError(
            f"this machine has no route to it (is it offline?); allowed: with a network, or {how}"
        ) from error


class Receiver:
    """Receiver of a bus's messages. Raises TransportError if python-can's internals are not as expected."""

    def __init__(self, bus: Any, arguments: Mapping[str, object]) -> None:
        wire = getattr(getattr(bus, "_multicast", None), "_socket", None)
        if not isinstance(wire, socket.socket):
            raise TransportError(f"{INTERFACE}: not known in python-can {_can.__version__}")
        self._bus = bus
        self._reaches_network = arguments.get("hop_limit", 1) != 0  # python-can's default
        self._group = ipaddress.ip_address(bus._multicast.group)
        self._known: dict[str, tuple[bool, float]] = {}
        _hear_one_group(wire)

    def recv(self, timeout: float) -> can.Message | None:
        """Return the next message; None: none in `timeout` [s]. Raises RefusedError, NotAFrameError, CanError."""
        result = self._bus._multicast.recv(timeout)
        if result is None:
            return None
        data, sender, timestamp = result
        if not self._reaches_network and not self._is_here(sender):
            raise RefusedError(sender[0])
        message = unpacked(data, timestamp)
        if message.is_fd and self._bus.protocol is not _can.CanProtocol.CAN_FD:
            raise NotAFrameError("CAN FD; allowed: classic CAN")
        return message

    def _is_here(self, sender: tuple[Any, ...]) -> bool:
        """Whether a sender's address belongs to this machine; cached."""
        now = time.monotonic()
        is_here, until = self._known.get(sender[0], (False, 0.0))
        if now >= until:
            is_here = _is_of_this_machine(sender, self._group)
            if len(self._known) >= _KNOWN:
                self._known.clear()
            self._known[sender[0]] = (is_here, now + _KNOWN_S)
        return is_here


def unpacked(data: bytes, timestamp: float) -> can.Message:
    """Return the python-can message in a datagram, whose content is validated. Raises NotAFrameError."""
    import msgpack

    try:
        fields = msgpack.unpackb(data, raw=False)
        # For a number as data python-can would allocate that many bytes.
        if not isinstance(fields, dict) or not isinstance(fields.get("data"), bytes | None):
            raise NotAFrameError("no map with data")
        return _can.Message(check=True, **{**fields, "timestamp": timestamp})
    except Exception as error:  # whatever it is, the sender has caused it
        raise NotAFrameError(f"{type(error).__name__}: {error}") from error


def _is_of_this_machine(sender: tuple[Any, ...], group: ipaddress.IPv4Address | ipaddress.IPv6Address) -> bool:
    """Whether an address is this machine's: the kernel accepts no packet from outside with its own address."""
    address = ipaddress.ip_address(sender[0])
    if address.is_loopback:
        return True
    if address.is_unspecified:  # sent over `lo`; from outside only to 224.0.0.0/24 (RFC 4541)
        return address.version == 4 and group not in ipaddress.ip_network("224.0.0.0/24")
    family = socket.AF_INET if address.version == 4 else socket.AF_INET6
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect(sender)
            return bool(probe.getsockname()[0] == sender[0])
    except OSError:
        return False


def _hear_one_group(wire: socket.socket) -> None:
    """Restrict a socket to its own group; Linux delivers datagrams of any group joined on this machine."""
    with contextlib.suppress(OSError):  # another system, which has no such option
        if wire.family == socket.AF_INET6:
            wire.setsockopt(socket.IPPROTO_IPV6, _IPV6_MULTICAST_ALL, 0)
        else:
            wire.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)


class Echoes:
    """Filter that recognizes a node's own frames when a bus returns them to it.

    Frames return in the order of sending; those sent before one that has returned are lost. One thread
    may send while another receives.
    """

    def __init__(self) -> None:
        self._pending: deque[tuple[int, bytes]] = deque(maxlen=_ECHOES)
        self._lock = threading.Lock()

    def sending(self, identifier: int, data: bytes) -> None:
        """Register a frame as expected to return; call it before sending the frame."""
        with self._lock:
            self._pending.append((identifier, data))

    def is_echo(self, identifier: int, data: bytes) -> bool:
        """Whether a frame is this node's own; if so, it and those sent before it are no longer expected back."""
        key = (identifier, data)
        with self._lock:
            if key not in self._pending:
                return False
            while self._pending.popleft() != key:
                pass
        return True
