"""ISO-TP against can-isotp: the same messages in both directions, and robustness against wrong frames."""

from __future__ import annotations

import itertools
import time

import can
import isotp
import numpy as np
import pytest
from hil_support import frames_of
from isotp_ends import REQUEST, RESPONSE, TICK_NS, Clock, Ours, Theirs, random_bytes

from liftgate_compiler import compiled
from liftgate_hil.codec.frames import EXTENDED, FD, Frames, empty_frames
from liftgate_hil.diagnostics import isotp as own
from liftgate_hil.diagnostics.isotp import LONGEST, Link, hear, new_link, speak

GAPS = (0, 1, 5, 0xF1, 0xF9)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(isotp.tools, "time", made)
    return made


def exchange(clock: Clock, ours: Ours, theirs: Theirs, ticks: int, lost: int = -1) -> int:
    """Exchange frames until both nodes are silent, dropping frame number `lost`; return the number of frames."""
    count, quiet = 0, 0
    for _ in range(ticks):
        now_ns = clock.now_ns
        sent = ours.poll(now_ns)
        for payload in sent:
            if count != lost:
                theirs.take(payload)
            count += 1
        answers = theirs.poll()
        for payload in answers:
            if count != lost:
                ours.take(payload, now_ns)
            count += 1
        clock.now_ns += TICK_NS
        quiet = 0 if sent or answers else quiet + 1
        if quiet > 200 and ours.is_idle and not theirs.layer.transmitting():
            break
    return count


LENGTHS = (1, 6, 7, 8, 9, 13, 14, 62, 300, 4094, LONGEST)


@pytest.mark.parametrize("case", range(30))
def test_messages_of_any_length_are_exchanged_in_both_directions_at_once(clock: Clock, case: int) -> None:
    rng = np.random.default_rng(case)
    padding = [None, 0x00, 0xCC][case % 3]
    filled = -1 if padding is None else padding
    ours = Ours(padding=filled, block_size=int(rng.integers(0, 20)), st_min=int(rng.choice(GAPS)))
    theirs = Theirs(tx_padding=padding, blocksize=int(rng.integers(0, 20)), stmin=int(rng.choice(GAPS)))
    lengths = [LENGTHS[(case + k) % len(LENGTHS)] if k else int(rng.integers(1, 700)) for k in (0, 1)]
    there, back = (random_bytes(rng, length) for length in lengths)
    ours.send(there)
    theirs.send(back)
    exchange(clock, ours, theirs, 8000)
    assert theirs.errors == []
    assert (theirs.got, ours.got) == ([there], [back])


def test_a_first_frame_equals_that_of_can_isotp_and_flow_control_precedes_further_frames(clock: Clock) -> None:
    message = bytes(range(20))
    ours, theirs = Ours(padding=0xAA), Theirs(tx_padding=0xAA)
    ours.send(message)
    theirs.send(message)
    first, other = ours.poll(0), theirs.poll()
    assert first == other == [bytes.fromhex("1014000102030405")]
    ours.take(other[0], 0)
    theirs.take(first[0])
    # Flow control first, then nothing before the other end's.
    assert ours.poll(0) == [bytes.fromhex("300000aaaaaaaaaa")]
    assert theirs.poll() == [bytes.fromhex("300800aaaaaaaaaa")]


def test_the_separation_time_between_frames_is_kept(clock: Clock) -> None:
    ours = Ours()
    ours.send(bytes(40))
    ours.poll(0)
    ours.take(bytes([0x30, 2, 0xF3]), 0)  # two frames, 300 us apart
    sent = [now_ns for now_ns in range(0, 3_000_000, 100_000) if ours.poll(now_ns)]
    assert sent == [0, 300_000]
    ours.take(bytes([0x30, 0, 127]), 3_000_000)
    sent = [now_ns for now_ns in range(3_000_000, 400_000_000, 1_000_000) if ours.poll(now_ns)]
    assert sent == [3_000_000, 130_000_000, 257_000_000]
    assert [own.gap_of(byte) for byte in (0, 0x7F, 0x80, 0xF0, 0xF1, 0xF9, 0xFA, 0xFF)] == [
        0, 127_000_000, 127_000_000, 127_000_000, 100_000, 900_000, 127_000_000, 127_000_000,
    ]  # fmt: skip


@pytest.mark.parametrize("lost", range(12))
def test_after_a_lost_frame_neither_node_waits_forever(clock: Clock, lost: int) -> None:
    ours, theirs = Ours(block_size=3), Theirs(blocksize=2)
    there, back = bytes(range(60)), bytes(range(100, 150))
    ours.send(there)
    theirs.send(back)
    assert exchange(clock, ours, theirs, 3000, lost) > lost
    assert theirs.got in ([], [there])
    assert ours.got in ([], [back])
    assert len(theirs.got) + len(ours.got) < 2
    clock.now_ns += 2 * own.N_CR_NS
    ours.send(b"again")
    theirs.send(b"and again")
    exchange(clock, ours, theirs, 1000)
    assert (theirs.got[-1], ours.got[-1]) == (b"again", b"and again")


@pytest.mark.parametrize("seed", range(40))
def test_disordered_frames_give_the_same_messages_as_in_can_isotp(clock: Clock, seed: int) -> None:
    """Frames of several messages, some lost, doubled or reordered, are sent to either receiver."""
    rng = np.random.default_rng(seed)
    frames = []
    for length in rng.integers(1, 60, 4):
        message = random_bytes(rng, int(length))
        if length <= 7:
            frames.append(bytes([length]) + message)
            continue
        frames.append(bytes([0x10, length]) + message[:6])
        rest = [message[k : k + 7] for k in range(6, length, 7)]
        frames += [bytes([0x20 | (k + 1) % 16]) + part for k, part in enumerate(rest)]
    for _ in range(int(rng.integers(0, 3))):
        place = int(rng.integers(len(frames)))
        change = rng.integers(3)
        if change == 0:
            del frames[place]
        elif change == 1:
            frames.insert(place, frames[place])
        elif place:
            frames[place - 1 : place + 1] = frames[place], frames[place - 1]
    ours, theirs = Ours(), Theirs()
    for payload in frames:
        ours.take(payload, 0)
        theirs.take(payload)
        theirs.poll()
        ours.poll(0)
    assert ours.got == theirs.got


def test_the_flow_control_timeout_is_that_of_can_isotp(clock: Clock) -> None:
    ours, theirs = Ours(), Theirs()
    for end in (ours, theirs):
        end.send(bytes(20))
    ours.poll(0)
    theirs.poll()
    clock.now_ns = own.N_BS_NS
    ours.poll(clock.now_ns)
    theirs.poll()
    assert own.is_sending(ours.link)
    assert theirs.errors == []
    clock.now_ns += 1
    ours.poll(clock.now_ns)
    theirs.poll()
    assert ours.link.head.send_result[0] == own.TIMEOUT_BS
    assert [type(each) for each in theirs.errors] == [isotp.FlowControlTimeoutError]


def after(*payloads: str, sending: int = 0, now_ns: int = 0) -> Ours:
    """Return our node after frames, while it sends a message of a number of bytes."""
    ours = Ours(block_size=2)
    if sending:
        ours.send(bytes(sending))
        ours.poll(0)
    for payload in payloads:
        ours.take(bytes.fromhex(payload), now_ns)
    return ours


def test_protocol_errors_end_a_transfer_as_in_the_standard() -> None:
    def sending(*payloads: str) -> int:
        return int(after(*payloads, sending=30).link.head.send_result[0])

    def receiving(*payloads: str) -> int:
        return int(after(*payloads).link.head.receive_result[0])

    assert sending("320000") == own.BUFFER_OVERFLOW
    assert sending("330000") == sending("3F0000") == own.INVALID_FS
    assert sending(*["310000"] * own.MOST_WAITS) == own.OK
    assert sending(*["310000"] * (own.MOST_WAITS + 1)) == own.WAIT_OVERRUN
    first = "100a000102030405"
    assert receiving(first, "22060708") == own.WRONG_SN
    assert receiving(first, first) == receiving(first, "0101") == own.UNEXPECTED
    late = after(first)
    late.poll(own.N_CR_NS)
    assert late.link.head.is_receiving[0]
    late.take(bytes.fromhex("2106070809"), own.N_CR_NS + 1)
    assert late.got == []
    assert late.link.head.receive_result[0] == own.TIMEOUT_CR


@pytest.mark.parametrize(
    "payload",
    ["", "00", "01", "08" + "11" * 7, "0301", "1007" + "00" * 6, "100800", "21" + "00" * 7, "3000", "300000",
     "F0" * 8, "40"],
)  # fmt: skip
def test_invalid_frames_are_ignored(payload: str) -> None:
    ours = after(payload)
    assert ours.is_idle
    assert ours.poll(0) == []
    # Nor does it disturb a message that is on its way.
    ours = after("100a000102030405", "" if payload.startswith("21") else payload, "2106070809")
    assert ours.got == [bytes(range(10))]


def test_a_too_long_message_is_refused_with_overflow() -> None:
    ours = after("1000000010000001")
    assert [payload[:3].hex() for payload in ours.poll(0)] == ["320200"]
    assert ours.is_idle


def test_frames_with_another_identifier_are_ignored() -> None:
    ours = Ours()
    for identifier in (REQUEST, RESPONSE | EXTENDED, RESPONSE | FD, RESPONSE + 1):
        ours.take(b"\x01\x42", 0, identifier)
    assert ours.got == []
    extended = new_link(0x18DA10F1 | EXTENDED, 0x18DAF110 | EXTENDED)
    assert hear(extended, frames_of([(0x18DAF110 | EXTENDED, b"\x01\x42")]), 0, 0) == 1


def fed(link: Link, frames: Frames, room: Frames, now_ns: int, step_ns: int) -> int:
    """Return the total length of messages received from frames, one per `step_ns`, while our node sends too."""
    total = 0
    for i in range(frames.count):
        total += hear(link, frames, i, now_ns)
        speak(link, room, 0, now_ns)
        now_ns += step_ns
    return total


def test_random_frames_neither_crash_nor_block_the_node() -> None:
    """In machine code, which could write anywhere, as in Python, which would raise."""
    rng = np.random.default_rng(1)
    count = 4000
    frames = empty_frames(count)._replace(count=count)
    frames.identifiers[:] = RESPONSE
    frames.lengths[:] = rng.integers(0, 9, count)
    frames.data[:] = rng.integers(0, 256, frames.data.shape)
    # Half of them begin as frames of ISO-TP do.
    frames.data[::2, 0] = rng.choice([0x03, 0x10, 0x11, *range(0x20, 0x30), 0x30], count // 2)
    links = [new_link(REQUEST, RESPONSE, 0xCC, 3, 0) for _ in range(2)]
    totals = []
    for link, call in zip(links, (compiled(fed), fed), strict=True):
        own.put_message(link, b"\x55" * LONGEST)
        totals.append(call(link, frames, empty_frames(own.MOST_SPOKEN), 0, 7_000_000))
    assert totals[0] == totals[1] > 150
    assert links[0].head.tobytes() == links[1].head.tobytes()
    # It takes a sound message all the same.
    ours = Ours()
    ours.link.head[:], now_ns = links[0].head, count * 7_000_000 + 2 * own.N_CR_NS
    ours.take(b"\x02ok", now_ns)
    ours.poll(now_ns)
    assert (ours.got, ours.is_idle) == ([b"ok"], True)


def test_sequence_numbers_wrap_around() -> None:
    ours = Ours()
    ours.send(bytes(7 * 40))
    ours.poll(0)
    ours.take(bytes([0x30, 0, 0]), 0)
    numbers = [payload[0] & 0xF for _ in range(60) for payload in ours.poll(0)]
    assert numbers == list(itertools.islice(itertools.cycle([*range(1, 16), 0]), 40))


@pytest.mark.realtime
def test_messages_are_exchanged_with_can_isotp_on_a_virtual_bus() -> None:
    """On python-can's virtual bus in real time, with can-isotp in its own thread."""
    rng = np.random.default_rng(4)
    there, back = random_bytes(rng, 300), random_bytes(rng, 500)
    ours, channel = Ours(block_size=4, st_min=1), "isotp"
    with can.Bus(channel, interface="virtual") as here, can.Bus(channel, interface="virtual") as other:
        address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=RESPONSE, rxid=REQUEST)
        theirs = isotp.CanStack(other, address=address, params={"blocksize": 8, "stmin": 1})
        theirs.start()
        try:
            ours.send(there)
            theirs.send(back)
            got, until = None, time.monotonic() + 10.0
            while (got is None or not ours.got) and time.monotonic() < until:
                while (message := here.recv(0.0)) is not None:
                    ours.take(bytes(message.data), time.monotonic_ns())
                for payload in ours.poll(time.monotonic_ns()):
                    here.send(can.Message(arbitration_id=REQUEST, data=payload, is_extended_id=False))
                got = theirs.recv() if got is None else got
                time.sleep(0.0005)
        finally:
            theirs.stop()
    assert (bytes(got or b""), ours.got) == (there, [back])
