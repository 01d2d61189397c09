"""Diagnostics of the reference ECU, tested by udsoncan's client: services, refusals, and status of codes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hil_support import Wire, frames_of, rows_of, shipped_rig
from udsoncan.client import Client
from udsoncan.connections import BaseConnection
from udsoncan.exceptions import NegativeResponseException

from liftgate_hil.codec.frames import empty_frames
from liftgate_hil.config.rig import Rig
from liftgate_hil.diagnostics.isotp import MOST_SPOKEN, hear, message_in, new_link, put_message, speak
from liftgate_hil.diagnostics.trouble_code import number_of, text_of
from liftgate_hil.ecu import events, status
from liftgate_hil.ecu.adapter import ReferenceEcu
from liftgate_hil.ecu.diagnostics import has_work, new_server, serve, server_of
from liftgate_hil.ecu.events import NO_VERDICT, TEXTS, TROUBLE_CODES, note_event, note_statuses
from liftgate_hil.ecu.memory import CODES, new_memory
from liftgate_hil.ecu.peer import Peer

MS = 1_000_000


class Ecu(BaseConnection):
    """A connection of udsoncan to the server without a bus, a millisecond per turn."""

    def __init__(self) -> None:
        super().__init__("reference")
        own = shipped_rig().diagnostics
        assert own is not None
        self.server = server_of(own)
        self.state = new_server(self.server)
        self.memory = new_memory(2)
        self.link = new_link(own.request, own.response)
        self.now_ns = 0
        self.frames = 0  # of the last answer
        self.answers: list[bytes] = []

    def open(self) -> Any:
        return self

    def close(self) -> None: ...

    def is_open(self) -> bool:
        return True

    def empty_rxqueue(self) -> None:
        self.answers.clear()

    def specific_send(self, payload: bytes, timeout: float | None = None) -> None:
        put_message(self.link, payload)

    def specific_wait_frame(self, timeout: float | None = None) -> bytes | None:
        self.frames = 0
        for _ in range(200):
            self.turn()
            if self.answers:
                return self.answers.pop()
        return None

    def turn(self) -> None:
        """Let 1 ms pass: frames of the client reach the server, and its answers the client."""
        room = empty_frames(MOST_SPOKEN)
        said = frames_of(rows_of(room._replace(count=speak(self.link, room, 0, self.now_ns))))
        statuses = self.memory.statuses
        answer = empty_frames(MOST_SPOKEN)
        if has_work(self.state, said):
            count = serve(self.server, self.state, statuses, said, answer, 0, self.now_ns)
            answer = answer._replace(count=count)
        self.now_ns += MS
        self.frames += answer.count
        for i in range(answer.count):
            length = hear(self.link, answer, i, self.now_ns)
            if length:
                self.answers.append(message_in(self.link, length))

    def said(self, request: str) -> str:
        """Return the answer to a request, both in hexadecimal; an empty text for no answer."""
        self.answers.clear()
        self.specific_send(bytes.fromhex(request))
        return (self.specific_wait_frame() or b"").hex()

    def happens(self, *codes: int) -> None:
        """Let the ECU's events of these codes occur, and update the statuses of the trouble codes."""
        for code in codes:
            note_event(self.memory, code, NO_VERDICT)
        note_statuses(self.memory)


@pytest.fixture
def ecu() -> Ecu:
    return Ecu()


@pytest.fixture
def client(ecu: Ecu) -> Iterator[Client]:
    with Client(ecu, config={"use_server_timing": False}) as made:
        yield made


def codes_of(client: Client, mask: int = 0xFF) -> dict[str, int]:
    """Return the status byte by trouble code, of codes whose status has a bit of the mask."""
    found = client.get_dtc_by_status_mask(mask)
    assert found.service_data.status_availability.get_byte_as_int() == status.AVAILABLE
    return {text_of(each.id): each.status.get_byte_as_int() for each in found.service_data.dtcs}


def test_trouble_codes_are_read_by_status_mask(ecu: Ecu, client: Client) -> None:
    assert set(codes_of(client)) == {each.code for each in TROUBLE_CODES.values()}
    assert ecu.frames > 6  # more than a frame holds
    assert set(codes_of(client).values()) == {status.CLEARED}
    assert codes_of(client, 0x09) == {}
    ecu.happens(events.DRIVES_APART, events.FEEDBACK_LOST)
    assert codes_of(client, 0x09) == {"B1A01-62": 0x2F, "U1A01-87": 0x2F}
    assert client.get_number_of_dtc_by_status_mask(0x08).service_data.dtc_count == 2
    assert client.get_number_of_dtc_by_status_mask(0x50).service_data.dtc_count == len(TROUBLE_CODES) - 2
    assert codes_of(client, 0x80) == {}


def test_trouble_codes_are_cleared_all_or_one(ecu: Ecu, client: Client) -> None:
    ecu.happens(events.DRIVES_APART, events.FEEDBACK_LOST, events.FALLS)
    client.clear_dtc(number_of("U1A01-87")[0])
    assert set(codes_of(client, 0x09)) == {"B1A01-62", "B1A08-94"}
    with pytest.raises(NegativeResponseException) as caught:
        client.clear_dtc(0x123456)
    assert caught.value.response.code == 0x31
    assert len(codes_of(client, 0x09)) == 2
    client.clear_dtc()
    assert codes_of(client, 0x09) == {}
    assert set(codes_of(client).values()) == {status.CLEARED}


def test_the_status_of_a_code_follows_the_result_of_its_test(ecu: Ecu) -> None:
    statuses = ecu.memory.statuses

    def of(event: int) -> int:
        return int(statuses[event]) & status.AVAILABLE

    ecu.happens(events.STARTS_OPENING, events.OVER_CURRENT)
    assert of(events.OVER_CURRENT) == 0x2F
    ecu.happens(events.STARTS_OPENING, events.IS_OPEN)
    assert of(events.OVER_CURRENT) == 0x2E  # no longer failed; confirmed and pending
    assert of(events.DRIVES_APART) == 0x00
    # A motion back after a failure is no proof that it has gone; nor is one in which it fails again.
    ecu.happens(events.STARTS_CLOSING, events.BLOCKED_CLOSING, events.IS_OPEN)
    assert of(events.OVER_CURRENT) == 0x2E
    assert of(events.BLOCKED_CLOSING) == 0x2F
    ecu.happens(events.STARTS_CLOSING, events.LATCH_IMPLAUSIBLE, events.IS_CLOSED)
    assert of(events.LATCH_IMPLAUSIBLE) == 0x2F
    # The next cycle: what failed in the last one is pending still, and no longer after one without.
    status.begin_cycle(statuses)
    assert of(events.OVER_CURRENT) == 0x6C
    ecu.happens(events.STARTS_OPENING, events.IS_OPEN)
    status.begin_cycle(statuses)
    assert of(events.OVER_CURRENT) == 0x68
    assert (statuses >> 9 == 0).all()


def test_a_diagnostic_session_ends_by_time_out(ecu: Ecu) -> None:
    assert ecu.said("1003") == "5003003201f4"
    assert ecu.state.head.session[0] == 3
    for _ in range(3):
        ecu.now_ns += 4_900 * MS
        assert ecu.said("3e00") == "7e00"
        assert ecu.state.head.session[0] == 3
    ecu.now_ns += 5_001 * MS
    ecu.said("3e00")
    assert ecu.state.head.session[0] == 1
    assert ecu.said("1001") == "5001003201f4"


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("22f190", "7f2211"), ("2701", "7f2711"), ("00", "7f0011"), ("ff", "7fff11"),  # no such service
        ("1002", "7f1012"), ("1102", "7f1112"), ("3e01", "7f3e12"), ("1906", "7f1912"), ("190a", "7f1912"),
        ("10", "7f1013"), ("19", "7f1913"), ("3e", "7f3e13"),  # nor that short
        ("100300", "7f1013"), ("3e0000", "7f3e13"), ("1902", "7f1913"), ("19020900", "7f1913"),
        ("14", "7f1413"), ("14ffff", "7f1413"), ("14ffffff00", "7f1413"), ("14000000", "7f1431"),
        ("190200", "59027f"), ("1901ff", "59017f00" + f"{len(TROUBLE_CODES):04x}"),
    ],
)  # fmt: skip
def test_unsupported_services_and_parameters_are_refused(ecu: Ecu, request_: str, answer: str) -> None:
    assert ecu.said(request_) == answer


def test_a_positive_response_may_be_suppressed(ecu: Ecu) -> None:
    assert ecu.said("3e80") == ""
    assert ecu.said("1083") == ""
    assert ecu.state.head.session[0] == 3
    assert ecu.said("198209") == ""
    assert ecu.said("3e81") == "7f3e12"


def test_a_hard_reset_is_answered_and_keeps_the_trouble_codes() -> None:
    adapter = ReferenceEcu(shipped_rig(), 2)
    adapter.state.reference.memory.control.travel = 900.0
    note_event(adapter.state.reference.memory, events.FALLS, NO_VERDICT)
    note_statuses(adapter.state.reference.memory)
    adapter.reset()
    memory = adapter.state.reference.memory
    assert np.isnan(memory.control.travel[0])
    assert memory.statuses[events.FALLS] == 0x6D  # of an earlier cycle
    asked = Ecu()
    assert asked.said("1101") == "5101"
    assert asked.state.head.is_resetting[0] == 1


def test_a_reset_by_the_tester_restarts_the_ecu(rig: Rig) -> None:
    with ReferenceEcu(rig, 2) as adapter:
        wire = Wire()
        peer = Peer(adapter, wire)
        for now in range(10):
            if now == 3:
                adapter.state.reference.memory.control.travel = 900.0
                wire.inbox = [(0x7A0, bytes.fromhex("021101CCCCCCCCCC"))]
            peer.poll(now * MS)
            if now == 3:
                answer = wire.sent[-1]
        assert answer == (0x7A8, bytes.fromhex("025101CCCCCCCCCC"))
        assert np.isnan(adapter.state.reference.memory.control.travel[0])
        assert adapter.state.reference.server.head.is_resetting[0] == 0


def test_each_failure_has_its_own_trouble_code() -> None:
    codes = [each.code for each in TROUBLE_CODES.values()]
    assert len(set(codes)) == len(codes)
    assert all(text_of(number_of(code)[0]) == code for code in codes)
    assert len(TEXTS) <= CODES
    told = {
        events.STOPPED_BY_DRIVER, events.STARTS_OPENING, events.STARTS_CLOSING, events.IS_CLOSED, events.IS_OPEN,
        events.REVERSAL_DONE, events.TRAVEL_LEARNED, events.TRAPPED_CLOSING, events.TRAPPED_OPENING,
    }  # fmt: skip
    assert told | set(TROUBLE_CODES) == set(range(len(TEXTS)))
    assert not told & set(TROUBLE_CODES)


def test_random_requests_get_a_valid_response_or_none(ecu: Ecu) -> None:
    rng = np.random.default_rng(3)
    for _ in range(300):
        request = rng.integers(0, 256, rng.integers(1, 12), dtype=np.uint8)
        if rng.random() < 0.7:
            request[0] = rng.choice([0x10, 0x11, 0x14, 0x19, 0x3E])
        answer = bytes.fromhex(ecu.said(request.tobytes().hex()))
        if answer:
            assert answer[0] in (int(request[0]) + 0x40, 0x7F)
    assert ecu.said("3e00") == "7e00"
