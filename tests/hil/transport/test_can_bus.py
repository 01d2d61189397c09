"""`CanTransport` over python-can: frames arrive complete, faults of the bus are counted."""

from __future__ import annotations

import errno
import logging
import math
import socket
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hil_support import CALM, EXTENDED, frames_of, loop_config, rig_of, rows_of, start_of, stimulus_plan, text_file
from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.codec.frames import ERROR, FD, REMOTE, empty_frames
from liftgate_hil.config.choices import WireChoice
from liftgate_hil.config.rig import Rig
from liftgate_hil.errors import ConfigError, TransportError
from liftgate_hil.loop.python_loop import Loop, run_free
from liftgate_hil.transport.base import LinkCounts
from liftgate_hil.transport.can_bus import CAPACITY, CanTransport
from liftgate_hil.transport.find import bus_arguments, parse_bus
from liftgate_hil.transport.messages import message_of
from liftgate_hil.transport.socketcan import SocketCan

# --bus.


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("socketcan:vcan0", {"interface": "socketcan", "channel": "vcan0"}),
        ("virtual:a:b", {"interface": "virtual", "channel": "a:b"}),
        ("udp_multicast:239.0.0.1", {"interface": "udp_multicast", "channel": "239.0.0.1"}),
        ("udp_multicast:ff15::1", {"interface": "udp_multicast", "channel": "ff15::1"}),
        ("slcan:/dev/x@115200", {"interface": "slcan", "channel": "/dev/x@115200", "bitrate": 250_000}),
        ("pcan:PCAN_USBBUS1@125000", {"interface": "pcan", "channel": "PCAN_USBBUS1", "bitrate": 125_000}),
        ("pcan:PCAN_USBBUS1", {"interface": "pcan", "channel": "PCAN_USBBUS1", "bitrate": 250_000}),
        ("vector:0", {"interface": "vector", "channel": "0", "bitrate": 250_000}),
    ],
)
def test_a_bus_is_specified_by_interface_channel_and_bit_rate(text: str, expected: dict[str, Any]):
    assert parse_bus(text, 250_000.0) == expected


@pytest.mark.parametrize(
    "text",
    ["", ":", "vcan0", "socketcan:", ":vcan0", "pcan:x@", "pcan:x@fast", "pcan:x@0", "pcan:x@-5", "pcan:@500000",
     "socketcan:@500000"],
)  # fmt: skip
def test_an_invalid_bus_name_is_reported(text: str):
    with pytest.raises(ConfigError, match="`bus`"):
        parse_bus(text, 500_000.0)


def test_two_ways_of_naming_the_bus_at_once_are_refused(rig: Rig):
    with pytest.raises(ConfigError, match=r"`bus` and -i/-c"):
        bus_arguments(WireChoice(bus="virtual:x", interface="virtual"), rig)


def test_a_bus_is_chosen_by_python_cans_flags_or_environment_variables(rig: Rig, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(can.util, "CONFIG_FILES", [])
    found = bus_arguments(WireChoice(interface="virtual", channel="x"), rig)
    assert (found["interface"], found["channel"]) == ("virtual", "x")
    monkeypatch.setenv("CAN_INTERFACE", "udp_multicast")
    monkeypatch.setenv("CAN_CHANNEL", "239.0.0.7")
    found = bus_arguments(WireChoice(), rig)
    assert (found["interface"], found["channel"]) == ("udp_multicast", "239.0.0.7")


def test_a_missing_bus_name_is_reported(rig: Rig, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(can.util, "CONFIG_FILES", [])
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ConfigError, match=r"`bus`: missing.*none is needed with `ecu` reference"):
        bus_arguments(WireChoice(), rig)


def test_an_interface_that_does_not_exist_is_reported(rig: Rig):
    with pytest.raises((ConfigError, TransportError), match="nosuch"):
        CanTransport(bus_arguments(WireChoice(bus="nosuch:0"), rig))


def test_a_kernel_without_socketcan_is_reported_as_the_cause(monkeypatch: pytest.MonkeyPatch):
    def refused(*family: Any) -> None:
        raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")

    monkeypatch.setattr(socket, "socket", refused)
    told = r"^socketcan:vcan0: cannot be opened: this kernel has no SocketCAN; try: .*liftgate-hil doctor"
    with pytest.raises(TransportError, match=told):
        CanTransport({"interface": "socketcan", "channel": "vcan0"})
    with pytest.raises(TransportError, match=told):
        SocketCan("vcan0")


def test_log_messages_of_a_driver_are_part_of_the_error_and_not_on_stderr(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def broken(**arguments: Any) -> None:
        for _ in range(2):
            logging.getLogger("can.interfaces.kvaser").warning("canlib is\nunavailable")
        raise NameError("name 'canOpen' is not defined")

    monkeypatch.setattr(can, "Bus", broken)
    told = r"^kvaser:0: cannot be opened: name 'canOpen' is not defined; canlib is unavailable$"
    with pytest.raises(TransportError, match=told):
        CanTransport({"interface": "kvaser", "channel": "0"})
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (can.CanInitializationError("no\ndevice"), "no device"),
        (KeyError(), "KeyError"),  # one without a word is told by its kind
        (Exception(), "Exception"),
        (can.CanError(""), "CanError"),
    ],
)
def test_a_bus_that_cannot_be_opened_is_reported_on_one_line(
    monkeypatch: pytest.MonkeyPatch, error: Exception, said: str
):
    def broken(**arguments: Any) -> None:
        raise error

    monkeypatch.setattr(can, "Bus", broken)
    with pytest.raises(TransportError, match=rf"^pcan:x: cannot be opened: {said}$"):
        CanTransport({"interface": "pcan", "channel": "x"})


@pytest.mark.parametrize("text", ["", "{", "[1]", "5", "null", "[" * 100_000])
@pytest.mark.parametrize("choice", [WireChoice(bus="virtual:x"), WireChoice(interface="virtual")])
def test_an_invalid_can_config_environment_variable_is_reported(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, choice: WireChoice, text: str
):
    monkeypatch.setenv("CAN_CONFIG", text)
    with pytest.raises(ConfigError, match=r"CAN_CONFIG .*allowed: a JSON object"):
        bus_arguments(choice, rig)


def test_an_unreadable_python_can_configuration_file_is_reported(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    broken = text_file(tmp_path / "can.conf", "interface = virtual\n")
    monkeypatch.setattr(can.util, "CONFIG_FILES", [str(broken)])
    with pytest.raises(ConfigError, match="python-can says: File contains no section headers"):
        bus_arguments(WireChoice(bus="virtual:x"), rig)


# Frames.


@pytest.fixture
def pair() -> Iterator[tuple[CanTransport, can.BusABC]]:
    channel = str(uuid.uuid4())
    transport = CanTransport({"interface": "virtual", "channel": channel}, is_fd=True)
    with can.Bus(interface="virtual", channel=channel) as other:
        yield transport, other
        transport.close()


ROWS = [
    (0x000, b""),
    (0x7FF, b"12345678"),
    (0x123 | EXTENDED, b"abc"),
    (0x1FFFFFFF | EXTENDED, bytes(range(8))),
    (0x321 | FD, bytes(range(64))),
    (0x123 | ERROR, b""),
]


def test_frames_of_every_kind_are_received_complete(pair: tuple[CanTransport, can.BusABC]):
    transport, other = pair
    for row in range(len(ROWS)):
        other.send(message_of(frames_of(ROWS), row))
    other.send(can.Message(arbitration_id=0x55, is_extended_id=False, is_remote_frame=True, dlc=5))
    frames = transport.receive()
    assert rows_of(frames)[: len(ROWS)] == ROWS
    assert int(frames.identifiers[len(ROWS)]) == 0x55 | REMOTE
    assert int(frames.lengths[len(ROWS)]) == 5
    assert transport.receive().count == 0


def test_frames_are_sent_unchanged(pair: tuple[CanTransport, can.BusABC]):
    transport, other = pair
    rows = [row for row in ROWS if not row[0] & ERROR]
    transport.send(frames_of(rows))
    for identifier, payload in rows:
        message = other.recv(0)
        assert message is not None
        assert message.arbitration_id == identifier & 0x1FFFFFFF
        assert message.is_extended_id == bool(identifier & EXTENDED)
        assert bytes(message.data) == payload
    assert other.recv(0) is None
    assert transport.receive().count == 0  # nobody hears himself


@CALM
@given(st.integers(0, 0x1FFFFFFF), st.booleans(), st.binary(max_size=8))
def test_a_message_has_the_content_of_its_frame(number: int, extended: bool, payload: bytes):
    identifier = number | EXTENDED if extended else number & 0x7FF
    message = message_of(frames_of([(identifier, payload)]), 0)
    assert message.arbitration_id == identifier & 0x1FFFFFFF
    assert message.is_extended_id is extended
    assert bytes(message.data) == payload
    assert not any((message.is_fd, message.is_remote_frame, message.is_error_frame))
    message._check()


def test_a_read_returns_at_most_its_capacity_and_the_next_continues(pair: tuple[CanTransport, can.BusABC]):
    transport, other = pair
    for number in range(CAPACITY + 7):
        other.send(can.Message(arbitration_id=number, is_extended_id=False))
    first, second = transport.receive(), transport.receive()
    assert (first.count, second.count) == (CAPACITY, 7)
    assert int(second.identifiers[0]) == CAPACITY


NO_FRAMES = [
    {"arbitration_id": 288.5},
    {"arbitration_id": math.nan},
    {"arbitration_id": math.inf},
    {"arbitration_id": "288"},
    {"arbitration_id": None},
    {"arbitration_id": []},
    {"arbitration_id": True},
    {"arbitration_id": -1},
    {"arbitration_id": 0x800},
    {"arbitration_id": 0x20000000, "is_extended_id": True},
    {"arbitration_id": 1 << 80, "is_extended_id": True},
    {"is_remote_frame": True, "dlc": math.nan},
    {"is_remote_frame": True, "dlc": -1},
    {"is_remote_frame": True, "dlc": 9},
    {"is_remote_frame": True, "dlc": 1 << 80},
    {"is_remote_frame": True, "dlc": "8"},
    {"is_remote_frame": True, "dlc": 2.5},
    {"is_remote_frame": True, "dlc": 8, "is_fd": True},
    {"data": bytes(9)},
    {"data": bytes(65), "is_fd": True},
]


@pytest.mark.parametrize("fields", NO_FRAMES, ids=str)
def test_an_invalid_message_is_counted_and_the_next_is_received(
    monkeypatch: pytest.MonkeyPatch, fields: dict[str, Any]
):
    odd = can.Message(**{"is_extended_id": False, **fields})
    good = can.Message(arbitration_id=5, is_extended_id=False, data=b"ok")
    transport = faulty(monkeypatch, [odd, good])
    assert rows_of(transport.receive()) == [(5, b"ok")]
    assert transport.counts() == LinkCounts(unreadable_frames=1)


@pytest.mark.parametrize("data", [None, "text", 8, [1.5]])
def test_a_payload_of_a_wrong_type_is_counted(monkeypatch: pytest.MonkeyPatch, data: Any):
    odd = can.Message(arbitration_id=5, is_extended_id=False)
    odd.data = data
    transport = faulty(monkeypatch, [odd])
    assert transport.receive().count == 0
    assert transport.counts() == LinkCounts(unreadable_frames=1)


def test_numpy_integers_are_accepted_as_identifiers(monkeypatch: pytest.MonkeyPatch):
    number: Any = np.int64(5)
    message = can.Message(arbitration_id=number, is_extended_id=False, is_remote_frame=True)
    message.dlc = number
    frames = faulty(monkeypatch, [message]).receive()
    assert (int(frames.identifiers[0]), int(frames.lengths[0])) == (5 | REMOTE, 5)


def test_invalid_messages_in_any_number_do_not_count_as_a_lost_link(monkeypatch: pytest.MonkeyPatch):
    odd: list[Any] = [can.Message(arbitration_id=-1), ValueError("a line cut short"), IndexError()]
    transport = faulty(monkeypatch, [*odd * 100, can.Message(arbitration_id=5)])
    assert transport.receive().count == 1
    assert transport.is_up
    assert transport.counts() == LinkCounts(unreadable_frames=300)


def test_a_flood_of_invalid_messages_does_not_block_a_read(monkeypatch: pytest.MonkeyPatch):
    results: list[Any] = [can.Message(arbitration_id=-1)] * 10 * CAPACITY
    transport = faulty(monkeypatch, results)
    assert transport.receive().count == 0
    assert len(results) > CAPACITY


class Faulty:
    """A bus whose reads give messages or raise errors as drivers do."""

    def __init__(self, results: list[Any]) -> None:
        self.results = results

    def recv(self, timeout: float) -> Any:
        result = self.results.pop(0) if self.results else None
        if isinstance(result, Exception):
            raise result
        return result

    def send(self, message: can.Message) -> None:
        self.recv(0.0)

    def shutdown(self) -> None:
        pass


def faulty(monkeypatch: pytest.MonkeyPatch, results: list[Any]) -> CanTransport:
    """Return a transport whose bus is a Faulty with these results."""
    monkeypatch.setattr(can, "Bus", lambda **arguments: Faulty(results))
    return CanTransport({"interface": "virtual", "channel": "x"})


def test_arrival_times_never_decrease_even_if_a_clock_is_read_late(monkeypatch: pytest.MonkeyPatch):
    """A thread that pauses between reading two clocks would take a frame for an older one."""
    clock = iter([time.time_ns() + pause for pause in (0, 0, 400_000_000, 0)])
    messages = [can.Message(arbitration_id=1, timestamp=time.time()) for _ in range(4)]
    transport = faulty(monkeypatch, list(messages))
    monkeypatch.setattr("liftgate_hil.transport.base.time.time_ns", lambda: next(clock))
    assert transport.receive().count == 4
    came = transport.came_ns[:4].tolist()
    assert came == sorted(came)


FAULTS = [can.CanOperationError("down"), OSError(100, "Network is down"), OSError(19, "No device")]


@pytest.mark.parametrize("error", FAULTS)
def test_a_receive_error_is_counted_and_keeps_frames_received_before(
    monkeypatch: pytest.MonkeyPatch, error: Exception
):
    message = can.Message(arbitration_id=5, is_extended_id=False)
    transport = faulty(monkeypatch, [message, error, message])
    assert transport.receive().count == 1
    lost = isinstance(error, OSError)
    assert transport.is_up is not lost
    # What a bus held back that was just opened again is of no use.
    assert transport.receive().count == (0 if lost else 1)
    assert transport.is_up
    assert transport.counts() == LinkCounts(receive_failures=1, losses=int(lost), before_start=int(lost))


def test_a_driver_that_keeps_failing_is_reopened(monkeypatch: pytest.MonkeyPatch):
    transport = faulty(monkeypatch, [can.CanOperationError("?")] * 10 + [can.Message()])
    for _ in range(10):
        assert transport.is_up
        assert transport.receive().count == 0
    assert not transport.is_up
    assert transport.receive().count == 0
    assert transport.is_up
    assert transport.counts() == LinkCounts(receive_failures=10, losses=1, before_start=1)


@pytest.mark.parametrize("error", [*FAULTS, OSError(105, "No buffer space available")])
def test_a_frame_that_cannot_be_sent_is_counted(monkeypatch: pytest.MonkeyPatch, error: Exception):
    transport = faulty(monkeypatch, [None, error, None])
    transport.send(frames_of([(1, b""), (2, b""), (3, b"")]))
    assert transport.counts().send_failures == 1


def test_sending_an_empty_batch_sends_nothing(pair: tuple[CanTransport, can.BusABC]):
    transport, other = pair
    transport.send(empty_frames(5))
    assert other.recv(0) is None


# CAN FD.

MIXED = """VERSION ""
BS_:
BU_: ECU Gate
BO_ 256 Cmd: 8 ECU
 SG_ Duty : 0|16@1- (0.01,0) [-100|100] "%" Gate
BO_ 2566844672 Long: 64 Gate
 SG_ Current : 7|16@0- (0.01,0) [0|0] "A" ECU
BO_ 768 Short: 8 Gate
 SG_ Pinch : 0|16@1+ (1,0) [0|0] "N" ECU
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG","4","5","6","7","8","9","10","11","12","13","StandardCAN_FD","ExtendedCAN_FD";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_DEF_DEF_ "GenMsgCycleTime" 10;
BA_ "VFrameFormat" BO_ 2566844672 15;
"""  # noqa: E501


def test_each_message_is_sent_in_the_frame_format_of_its_database(tmp_path: Path):
    rig = rig_of(
        tmp_path,
        MIXED,
        'dbc = "their.dbc"\n[inputs]\nleft_duty = "Cmd.Duty"\n'
        '[outputs]\nleft_current = "Long.Current"\ntrue_pinch_force = "Short.Pinch"\n',
    )
    assert rig.is_fd
    channel = str(uuid.uuid4())
    transport = CanTransport({"interface": "virtual", "channel": channel}, rig.is_fd)
    config = loop_config(rig=rig)
    formats = {}
    with can.Bus(interface="virtual", channel=channel) as other:
        run_free(Loop(config, start_of(config), stimulus_plan(config), transport), 10, lambda: False)
        while (message := other.recv(0)) is not None:
            formats[message.arbitration_id] = (message.is_fd, len(message.data))
    transport.close()
    assert formats == {0x300: (False, 8), 2566844672 & 0x1FFFFFFF: (True, 64)}
