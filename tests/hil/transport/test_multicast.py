"""UDP multicast buses: which datagrams are accepted, and how far they reach."""

from __future__ import annotations

import errno
import json
import math
import os
import socket
from collections.abc import Iterator
from typing import Any

import can
import msgpack
import numpy as np
import pytest
from hil_support import EXTENDED, frames_of, rows_of

from liftgate_hil.codec.frames import empty_frames
from liftgate_hil.config.choices import WireChoice
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import ConfigError, TransportError
from liftgate_hil.loop.datagrams import CAPACITY, SocketReading, make_buffers, read_frames
from liftgate_hil.transport import multicast
from liftgate_hil.transport.base import LinkCounts
from liftgate_hil.transport.can_bus import CanTransport
from liftgate_hil.transport.find import bus_arguments, find_way
from liftgate_hil.transport.pump import Pump

GOOD = can.Message(arbitration_id=0x77, is_extended_id=False, data=b"ok")


@pytest.fixture(autouse=True)
def _no_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can.util, "CONFIG_FILES", [])


def group(number: int) -> str:
    """Multicast group used by this process only, as other tests may run beside it."""
    return f"udp_multicast:239.78.{os.getpid() % 250 + 1}.{number}"


def transport_of(rig: Rig, name: str) -> CanTransport:
    return CanTransport(bus_arguments(WireChoice(bus=name), rig))


@pytest.fixture
def pair(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[CanTransport, Any]]:
    """A transport and a bus of python-can in the same multicast group."""
    monkeypatch.setenv("CAN_CONFIG", json.dumps({"port": 43211}))
    arguments = bus_arguments(WireChoice(bus=group(2)), rig)
    transport = CanTransport(arguments)
    with can.Bus(**arguments) as other:
        yield transport, other
        transport.close()


def fields_of(**changed: Any) -> bytes:
    """Return a datagram of python-can's multicast bus with changed fields."""
    fields = {"arbitration_id": 0x120, "is_extended_id": False, "dlc": 2, "data": b"ab"}
    return bytes(msgpack.packb({**fields, **changed}))


JUNK = [
    b"",
    b"\x05",
    b"\xff\xff",
    b"junk" * 100,
    b"\x91" * 4000,
    fields_of(arbitration_id=288.5),
    fields_of(arbitration_id=math.nan),
    fields_of(arbitration_id="288"),
    fields_of(arbitration_id={}),
    fields_of(is_remote_frame=True, dlc=math.nan, data=None),
    fields_of(is_remote_frame=True, dlc=-1, data=None),
    fields_of(is_remote_frame=True, dlc=1 << 62, data=None),
    fields_of(dlc=8),
    fields_of(data="ab"),
    fields_of(data=[1, 2]),
    fields_of(unheard_of=1),
]


def test_datagrams_that_are_no_frames_are_counted_and_skipped(pair: tuple[CanTransport, Any]):
    transport, other = pair
    got = []
    for junk in JUNK:
        other._multicast.send(junk)
        other.send(GOOD)
        got += rows_of(transport.receive(timeout=2.0))
    assert got == [(0x77, b"ok")] * len(JUNK)
    assert transport.is_up
    assert transport.counts() == LinkCounts(unreadable_frames=len(JUNK))


BURST = 3000  # more than the socket of `shrink_receive_buffer` has room for


def shrink_receive_buffer(transport: CanTransport) -> None:
    """Shrink the transport's receive buffer so that a burst overflows it."""
    transport._bus._multicast._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65_536)


def flood(other: Any) -> None:
    for number in range(BURST):
        other.send(can.Message(arbitration_id=number, is_extended_id=True))


def test_frames_that_the_kernel_drops_are_counted(pair: tuple[CanTransport, Any]):
    transport, other = pair
    shrink_receive_buffer(transport)
    flood(other)
    read = 0
    while come := transport.receive().count:
        read += come
    assert 0 < read < BURST
    assert transport.counts() == LinkCounts(dropped=BURST - read)


def test_drops_are_passed_with_the_next_frame_except_those_before_the_start(pair: tuple[CanTransport, Any]):
    transport, other = pair
    shrink_receive_buffer(transport)
    pump = Pump(transport)
    flood(other)
    pump.drain()
    before = transport.counts().dropped
    assert pump.dropped() == 0
    transport._receiving = transport._receiving._replace(dropped=before + 123)  # the kernel's count goes on
    other.send(GOOD)
    frames, stamps, reading = empty_frames(CAPACITY), np.zeros(CAPACITY, dtype=np.int64), SocketReading(0, 0, -1)
    while reading.count == 0:
        reading = read_frames(pump.descriptor, make_buffers(), frames, stamps)
    assert (reading.count, reading.dropped) == (1, 123)
    assert pump.dropped() == 123
    assert pump.counts().dropped == 0  # the loop has counted them
    pump.close()


def test_a_multicast_bus_has_a_large_receive_buffer(pair: tuple[CanTransport, Any]):
    transport, other = pair
    ours, usual = (
        each._multicast._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) for each in (transport._bus, other)
    )
    assert ours > usual


@pytest.mark.parametrize("is_told", [True, False])
def test_a_kernel_that_does_not_report_dropped_frames_is_reported(monkeypatch: pytest.MonkeyPatch, is_told: bool):
    monkeypatch.setattr(multicast, "tells_drops", lambda: is_told)
    assert ("losses go unnoticed" in multicast.reach({"hop_limit": 0})) is not is_told


def test_a_number_in_place_of_data_allocates_no_memory(pair: tuple[CanTransport, Any]):
    # python-can would make a bytearray of so many zeros.
    with pytest.raises(multicast.NotAFrameError):
        multicast.unpacked(fields_of(data=1 << 34, dlc=1 << 34), 0.0)


def test_benches_in_one_group_do_not_receive_their_own_frames(rig: Rig, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("CAN_CONFIG", json.dumps({"port": 43210}))
    first, second = transport_of(rig, group(1)), transport_of(rig, group(1))
    try:
        rows = [(0x210, b"12345678"), (0x5 | EXTENDED, b"a")]
        first.send(frames_of(rows))
        assert rows_of(second.receive(timeout=2.0))[:1] == rows[:1]
        # What one sends is no traffic of somebody else: not in its counts, load or log.
        assert first.receive(timeout=0.1).count == 0
        assert first.counts() == LinkCounts()
    finally:
        first.close()
        second.close()


@pytest.mark.parametrize("address", ["239.78.{}.{}", "ff15::{}:{}"])
def test_benches_in_two_groups_do_not_receive_each_others_frames(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, address: str
):
    monkeypatch.setenv("CAN_CONFIG", json.dumps({"port": 43212}))
    here = os.getpid() % 250 + 1
    groups = [f"udp_multicast:{address.format(here, number)}" for number in (3, 4, 3)]
    try:
        one, other, listener = (transport_of(rig, name) for name in groups)
    except TransportError as error:
        pytest.skip(str(error))  # a machine without IPv6
    try:
        other.send(frames_of([(0x210, b"other")]))
        one.send(frames_of([(0x211, b"one")]))
        assert rows_of(listener.receive(timeout=2.0)) == [(0x211, b"one")]
        assert listener.receive(timeout=0.1).count == 0
        assert one.receive(timeout=0.1).count == 0
    finally:
        for each in (one, other, listener):
            each.close()


# How far it reaches.


@pytest.mark.parametrize(("config", "hops"), [({}, 0), ({"hop_limit": 0}, 0), ({"hop_limit": 2}, 2)])
@pytest.mark.parametrize(
    "choice",
    [WireChoice(bus="udp_multicast:239.0.0.7"), WireChoice(interface="udp_multicast", channel="239.0.0.7")],
    ids=["bus", "interface"],
)
def test_a_multicast_bus_stays_on_this_machine_unless_configured_otherwise(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, choice: WireChoice, config: dict[str, int], hops: int
):
    monkeypatch.setenv("CAN_CONFIG", json.dumps(config))
    found = bus_arguments(choice, rig)
    assert found["hop_limit"] == hops
    assert ("any machine there" in multicast.reach(found)) is (hops > 0)


@pytest.mark.parametrize("hops", [-1, 256, "a", 1.5, None])
def test_an_invalid_hop_limit_is_reported(rig: Rig, monkeypatch: pytest.MonkeyPatch, hops: Any):
    monkeypatch.setenv("CAN_CONFIG", json.dumps({"hop_limit": hops}))
    with pytest.raises(ConfigError, match=r"hop_limit .*; allowed: 0"):
        bus_arguments(WireChoice(bus="udp_multicast:239.0.0.7"), rig)


@pytest.mark.parametrize("name", ["1.2.3.4", "240.0.0.1", "localhost", "fe80::1", "ff02::1%lo", "239.1"])
def test_an_invalid_multicast_group_is_reported_with_the_allowed_ones(rig: Rig, name: str):
    with pytest.raises(ConfigError, match=r"not a multicast address; allowed: a group of 224\.0\.0\.0/4"):
        bus_arguments(WireChoice(bus=f"udp_multicast:{name}"), rig)


class Foreign:
    """A bus that receives one datagram from each of these addresses."""

    protocol = can.CanProtocol.CAN_FD

    def __init__(self, senders: list[tuple[Any, ...]], name: str = "239.0.0.7") -> None:
        self.group = name
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._multicast = self
        self._senders = senders

    def recv(self, timeout: float) -> tuple[bytes, tuple[Any, ...], float] | None:
        return (fields_of(), self._senders.pop(0), 0.0) if self._senders else None

    def shutdown(self) -> None:
        self._socket.close()


def counted(
    monkeypatch: pytest.MonkeyPatch, senders: list[tuple[Any, ...]], hops: int, name: str = "239.0.0.7"
) -> tuple[int, int]:
    """Numbers of accepted and of refused frames, with one from each sender and a hop limit of `hops`."""
    monkeypatch.setattr(can, "Bus", lambda **arguments: Foreign(senders, name))
    transport = CanTransport({"interface": "udp_multicast", "channel": name, "hop_limit": hops})
    try:
        return transport.receive().count, transport.counts().refused_frames
    finally:
        transport.close()


# Of networks for documentation (RFC 5737, RFC 3849): nobody's, so not this machine's.
AWAY = [("203.0.113.9", 43113), ("2001:db8::9", 43113, 0, 0)]


HERE = [("127.0.0.1", 1), ("127.9.9.9", 1), ("::1", 1, 0, 0)]


@pytest.mark.parametrize(
    ("sender", "hops", "taken", "refused"),
    [
        *((sender, 0, 0, 3) for sender in AWAY),
        *((sender, 1, 3, 0) for sender in AWAY),  # the network is meant
        *((sender, 0, 3, 0) for sender in HERE),
    ],
)
def test_another_machine_can_command_the_gate_only_with_a_hop_limit(
    monkeypatch: pytest.MonkeyPatch, sender: tuple[Any, ...], hops: int, taken: int, refused: int
):
    assert counted(monkeypatch, [sender] * 3, hops) == (taken, refused)


def test_a_sender_without_an_address_counts_as_local_except_in_224_0_0_0(monkeypatch: pytest.MonkeyPatch):
    # What is sent over `lo` by a route without a source address; routers and hosts use it in 224.0.0.0/24.
    assert counted(monkeypatch, [("0.0.0.0", 1)], hops=0) == (1, 0)
    assert counted(monkeypatch, [("0.0.0.0", 1)], hops=0, name="224.0.0.9") == (0, 1)


def test_the_memory_for_known_senders_is_limited():
    bus = Foreign([(f"203.0.113.{number}", 1) for number in range(200)])
    receiver = multicast.Receiver(bus, {"hop_limit": 0})
    for _ in range(200):
        with pytest.raises(multicast.RefusedError):
            receiver.recv(0.0)
    assert len(receiver._known) <= 64
    bus.shutdown()


class Offline(socket.socket):
    """Socket errors of a machine without a network."""

    def connect(self, address: Any) -> None:
        raise OSError(errno.ENETUNREACH, "Network is unreachable")


@pytest.mark.parametrize(
    ("name", "how"), [("239.0.0.7", "ip route add 224.0.0.0/4 dev lo"), ("ff15::1", "a group of IPv4")]
)
def test_a_machine_without_a_network_gets_a_remedy(monkeypatch: pytest.MonkeyPatch, name: str, how: str):
    monkeypatch.setattr(socket, "socket", Offline)
    with pytest.raises(TransportError, match=f"offline.*allowed: with a network, or .*{how}"):
        CanTransport({"interface": "udp_multicast", "channel": name, "hop_limit": 0})


def test_an_unknown_version_of_python_can_is_reported(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(can, "Bus", lambda **arguments: object())
    with pytest.raises(TransportError, match=r"not known in python-can [0-9]"):
        CanTransport({"interface": "udp_multicast", "channel": "239.0.0.7", "hop_limit": 0})


@pytest.mark.parametrize(
    ("own", "other"),
    [
        ("239.74.163.2", "239.74.163.3"),
        ("239.255.255.255", "239.255.255.254"),
        ("ff15:7079:7468:6f6e:6465:6d6f:6d63:6173", "ff15:7079:7468:6f6e:6465:6d6f:6d63:6174"),
    ],
)
def test_another_multicast_group_is_suggested_to_separate_two_benches(rig: Rig, own: str, other: str):
    way = find_way(WireChoice(bus=f"udp_multicast:{own}"), rig)
    assert f"--bus udp_multicast:{other} for one of them" in way.apart
    find_way(WireChoice(bus=f"udp_multicast:{other}"), rig)
    assert find_way(WireChoice(bus="virtual:here"), rig).apart == ""


def test_each_kind_of_wire_explains_why_its_send_queue_may_be_full(rig: Rig):
    def why(**choice: Any) -> str:
        return find_way(WireChoice(**choice), rig).why_full

    assert "acknowledges" in why(bus="socketcan:vcan0")
    assert why(serial="socket://127.0.0.1:1") == why(serial="/dev/null") != why(bus="virtual:a")
    assert "acknowledges" not in why(serial="loop://") + why(bus="udp_multicast:239.0.0.7")
