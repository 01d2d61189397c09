"""Checksums given by parameters, against the catalogue of published CRCs, bit-by-bit division, and
frames of cars and of open projects that talk to them.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cantools.database.can import Message, Signal
from hil_support import CALM, FREE, frames_of, taken, transmitted
from hypothesis import given
from hypothesis import strategies as st

from liftgate_compiler import compiled
from liftgate_hil.codec.bus_config import SignalMapping, build_bus_config
from liftgate_hil.codec.checksum import checksum_in, put_checksum
from liftgate_hil.codec.frames import EXTENDED, FD
from liftgate_hil.codec.messages import Messages
from liftgate_hil.codec.receive import NO_COUNTS, nothing_received, receive
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.codec.transmit import transmit
from liftgate_hil.config.messages import message_options
from liftgate_hil.errors import ConfigIssues

CATALOGUE = Path(__file__).with_name("crc_catalogue.csv")
DIGITS = b"123456789"


def catalogue() -> list[dict[str, Any]]:
    lines = [line for line in CATALOGUE.read_text().splitlines() if not line.startswith("#")]
    return [
        {key: value if key == "name" else int(value, 0) for key, value in row.items()}
        for row in csv.DictReader(lines)
    ]


def divided(data: Iterable[int], width: int, polynomial: int, start: int = 0, reflect_in: bool = False,
            reflect_out: bool = False, final_xor: int = 0) -> int:  # fmt: skip
    """Return the CRC of bytes bit by bit, by the Rocksoft model."""
    register, top = start, 1 << (width - 1)
    for byte in data:
        bits = [byte >> (k if reflect_in else 7 - k) & 1 for k in range(8)]
        for bit in bits:
            out = bool(register & top) ^ bool(bit)
            register = (register << 1) & (2 * top - 1)
            if out:
                register ^= polynomial
    if reflect_out:
        register = sum((register >> k & 1) << (width - 1 - k) for k in range(width))
    return register ^ final_xor


def bus_of(message: Message, table: Mapping[str, Any], sending: bool = False, value: str = "Value") -> BusConfig:
    """Return the bus tables of a message with these options, as in [messages.M] of a rig."""
    issues = ConfigIssues("rig.toml")
    messages = Messages([message])
    options = message_options(issues, {message.name: dict(table)}, messages)
    bus = build_bus_config(
        messages, [SignalMapping("v", message.name, value)], options, {"v": FREE}, issues, sending
    )
    issues.raise_if_any()
    return bus


def message_of(
    length: int,
    checksum: tuple[int, int, str],
    counter: tuple[int, int, str] | None = None,
    value: tuple[int, int, str] | None = None,
    identifier: int = 0x123,
) -> Message:
    """Return a message M; each signal is given by start as in a DBC, number of bits and byte order."""
    given = {"Crc": checksum, "Counter": counter, "Value": value or (8, 1, "little_endian")}
    signals = [
        Signal(name, start, bits, order)
        for name, each in given.items()
        if each is not None
        for start, bits, order in [each]
    ]
    return Message(identifier, "M", length, signals, is_extended_frame=identifier > 0x7FF, strict=False)


def frame_of(payload: bytes) -> np.ndarray:
    return np.frombuffer(payload.ljust(64, b"\xa5"), dtype=np.uint8).reshape(1, 64).copy()


def checked(bus: BusConfig, payload: bytes, call: Any = put_checksum) -> tuple[int, bytes]:
    """Return the checksum computed for a payload, and the payload with the checksum in it."""
    frame = frame_of(payload)
    call(bus, 0, 0, frame, 0)
    found = int(checksum_in(bus, 0, frame, 0)) & 0xFFFFFFFFFFFFFFFF
    return found, frame[0, : len(payload)].tobytes()


PARAMETERS = ("width", "polynomial", "start", "final_xor")
FLAGS = ("reflect_in", "reflect_out")


def checksum_table(row: Mapping[str, Any], **more: Any) -> dict[str, Any]:
    """Return a rig's `checksum` table for an entry of the catalogue."""
    numbers = {key: row[key] for key in PARAMETERS}
    return {"signal": "Crc", **numbers, **{key: bool(row[key]) for key in FLAGS}, **more}


@pytest.mark.parametrize("mode", ["plain", "compiled"])
@pytest.mark.parametrize(
    "place", [(80, "little_endian"), (85, "little_endian"), (87, "big_endian"), (82, "big_endian")]
)
def test_each_published_crc_gives_its_published_check_value(mode: str, place: tuple[int, str]):
    call = put_checksum if mode == "plain" else compiled(put_checksum)
    rows = catalogue()
    assert len(rows) == 112
    for row in rows:
        message = message_of(24, (place[0], row["width"], place[1]))
        table = checksum_table(row, covers=["payload 0 to 8"])
        found, payload = checked(bus_of(message, {"checksum": table}), DIGITS + bytes(15), call)
        assert found == row["check"], row["name"]
        said = message.decode(payload, scaling=False)["Crc"]
        assert said == row["check"], row["name"]


@st.composite
def schemes(draw: st.DrawFn) -> tuple[Message, dict[str, Any], list[tuple[str, int]]]:
    """Draw a message, its checksum, and the bytes that it covers: (part, number)."""
    width = draw(st.integers(1, 64))
    length = draw(st.integers(10, 24))
    spare = 8 * length - width - 8
    start = draw(st.integers(0, spare))
    counter = (8 * length - 8, 8, "little_endian")
    identifier = draw(st.sampled_from((0x1, 0x5A7, 0x18FF1234)))
    message = message_of(length, (start, width, "little_endian"), counter, identifier=identifier)
    parts = {"payload": length, "identifier": 4, "counter": 8, "data_id": 4}
    covers, covered = [], []
    for part in draw(st.lists(st.sampled_from([*parts]), min_size=1, max_size=6)):
        first = draw(st.integers(0, parts[part] - 1))
        last = draw(st.integers(0, parts[part] - 1))
        covers.append(f"{part} {first} to {last}" if draw(st.booleans()) else f"{part} {first}")
        numbers = [first]
        if " to " in covers[-1]:
            numbers = [*range(first, last + 1)] if last >= first else [*range(first, last - 1, -1)]
        covered += [(part, each) for each in numbers]
    bits = st.integers(0, (1 << width) - 1)
    table = {
        "signal": "Crc",
        "width": width,
        "polynomial": draw(st.integers(1, (1 << width) - 1)),
        "start": draw(bits),
        "final_xor": draw(bits),
        "reflect_in": draw(st.booleans()),
        "reflect_out": draw(st.booleans()),
        "covers": covers,
    }
    if any(part == "data_id" for part, _ in covered):
        ids = st.integers(0, 0xFFFFFFFF)
        table["data_id"] = draw(st.one_of(ids, st.lists(ids, min_size=2, max_size=16)))
    return message, table, covered


@CALM
@given(schemes(), st.binary(min_size=24, max_size=24))
def test_any_checksum_equals_bitwise_division(
    scheme: tuple[Message, dict[str, Any], list[tuple[str, int]]], payload: bytes
):
    message, table, covered = scheme
    payload = payload[: message.length]
    bus = bus_of(message, {"counter": "Counter", "checksum": table})
    found, _ = checked(bus, payload)
    signal = message.get_signal_by_name("Crc")
    own = ((1 << signal.length) - 1) << signal.start
    zeroed = (int.from_bytes(payload, "little") & ~own).to_bytes(message.length, "little")
    counter = payload[-1]
    ids = table.get("data_id", 0)
    data_id = ids[counter % len(ids)] if isinstance(ids, list) else ids
    numbers = {"identifier": message.frame_id, "counter": counter, "data_id": data_id}
    data = [zeroed[byte] if part == "payload" else numbers[part] >> 8 * byte & 0xFF for part, byte in covered]
    keys = (*PARAMETERS, *FLAGS)
    assert found == divided(data, **{key: table[key] for key in keys})


def test_the_covered_payload_is_all_bytes_except_those_filled_by_the_checksum():
    row = next(each for each in catalogue() if each["name"] == "CRC-16/IBM-3740")
    payload = bytes(range(1, 9))
    for start, order, left in (
        (24, "little_endian", payload[:3] + payload[5:]),
        (31, "big_endian", payload[:3] + payload[5:]),
        # Bytes that it fills in part go in, its own bits as 0.
        (28, "little_endian", bytes([1, 2, 3, 4 & 0xF, 6 & 0xF0, 7, 8])),
    ):
        message = message_of(8, (start, 16, order))
        found, _ = checked(bus_of(message, {"checksum": checksum_table(row)}), payload)
        assert found == divided(left, 16, 0x1021, 0xFFFF), (start, order)


@pytest.mark.parametrize(
    ("identifier", "covers", "data"),
    [
        (0x5A7, ["identifier"], [0xA7, 0x05]),
        (0x5A7, ["identifier 1 to 0"], [0x05, 0xA7]),
        (0x18FF1234, ["identifier"], [0x34, 0x12, 0xFF, 0x18]),
        (0x123, ["counter", "payload 0"], [9, 0x11]),
        (0x123, ["data_id", "payload 0"], [0x34, 0x12, 0x11]),
        (0x123, ["data_id 1 to 0", "payload 0"], [0x12, 0x34, 0x11]),
    ],
)
def test_numbers_are_covered_lowest_byte_first_unless_the_rig_says_otherwise(
    identifier: int, covers: list[str], data: list[int]
):
    message = message_of(8, (56, 8, "little_endian"), (48, 4, "little_endian"), identifier=identifier)
    table = {"signal": "Crc", "width": 8, "polynomial": 0x2F, "covers": covers}
    if any(each.startswith("data_id") for each in covers):
        table["data_id"] = 0x1234
    bus = bus_of(message, {"counter": "Counter", "checksum": table})
    found, _ = checked(bus, bytes([0x11, 0, 0, 0, 0, 0, 9, 0]))
    assert found == divided(data, 8, 0x2F)


# Frames of makers. The parameters are those of opendbc 0.3.1 (MIT); of the frames those of Volkswagen and FCA are
# of cars, from its tests, the others its own code has completed. Volkswagen's data IDs are lists by the counter.
VW = {"width": 8, "polynomial": 0x2F, "start": 0xFF, "final_xor": 0xFF, "covers": ["payload", "data_id"]}
VW_GETRIEBE_11 = list(bytes.fromhex("3f6939dc94f91464d86a34cea255b52c"))
HYUNDAI_FD = {"width": 16, "polynomial": 0x1021, "covers": ["payload", "identifier"]}
J1850 = {"width": 8, "polynomial": 0x1D}
FIRST_BYTE, LAST_BYTE, TWO_BYTES = (0, 8), (-8, 8), (0, 16)
MAKERS = {
    "Volkswagen MQB Getriebe_11": (0xAD, FIRST_BYTE, VW | {"data_id": VW_GETRIEBE_11}, (8, 4), [
        "f8e0bfff5f202020", "b0e1bfffc6982180", "d2e2bfff5f202020", "00e3bfffaa202010", "f1e4bfff5f202020",
        "c4e5bfff5f202020", "dae6bfff5f202020", "85e7bfff5f202020", "12e8bfff5f202020", "45e9bfffaa202010",
        "03eabfffcc202010", "fcebbfff5f202120", "feecbfffad202010", "bdedbfffaa202010", "67eebfffaa202010",
        "36efbfffaa202010",
    ]),
    "Volkswagen MQB LWI_01": (0x86, FIRST_BYTE, VW | {"data_id": 0x86}, (8, 4), [
        "6b00bd0000000000", "ee010a0000000000", "d802a90000000000", "0303bea212000000", "7b04312003000000",
    ]),
    "FCA Giorgio EPS_1": (0xDE, LAST_BYTE, J1850 | {"final_xor": 0x10}, (32, 4), [
        "175197cc00df", "175197c901a3", "175197cc02e5",
    ]),
    "FCA Giorgio ABS_2": (0xFE, LAST_BYTE, J1850 | {"final_xor": 0x0A}, (48, 4), [
        "7e38007d10318032", "7e38007d1031812f", "7e38007d20318220",
    ]),
    "Chrysler": (0x292, LAST_BYTE, J1850 | {"start": 0xFF, "final_xor": 0xFF}, None, [
        "b2b3f4d58d82ca13", "86d2c96e8199",
    ]),
    "Hyundai LKAS11": (0x340, (48, 8), J1850 | {"start": 0x22, "final_xor": 0xDF}, None, ["a6058a00581a80b2"]),
    "Nissan": (0x169, LAST_BYTE, J1850 | {"start": 0xFF, "final_xor": 0xFF}, None, ["2de50472433d2e46"]),
    "Hyundai CAN FD, 8 bytes": (0x1CF, TWO_BYTES, HYUNDAI_FD | {"final_xor": 0x5F29}, None, ["899665224a58b791"]),
    "Hyundai CAN FD, 16 bytes": (0x1CF, TWO_BYTES, HYUNDAI_FD | {"final_xor": 0x041D}, None, [
        "3927f1d8303e61cdc4bb86c3d1c42710",
    ]),
    "Hyundai CAN FD, 24 bytes": (0x1CF, TWO_BYTES, HYUNDAI_FD | {"final_xor": 0x819D}, None, [
        "f0f34c4189eb2f1e7bd5d47e446fcec2a3d811736110e578",
    ]),
    "Hyundai CAN FD, 32 bytes": (0x1CF, TWO_BYTES, HYUNDAI_FD | {"final_xor": 0x9F5B}, None, [
        "0f49cea696762e6116c6e9c92d99bf358c2e0718822ce47ca8c74107e66cb0e4",
    ]),
}  # fmt: skip


@pytest.mark.parametrize("maker", MAKERS)
def test_frames_of_car_makers_are_accepted_and_reproduced(maker: str):
    identifier, place, scheme, counter, frames = MAKERS[maker]
    for payload in map(bytes.fromhex, frames):
        start, bits = place[0] % (8 * len(payload)), place[1]
        at = (*counter, "little_endian") if counter else None
        value = (8 * (len(payload) - 2), 1, "little_endian")
        message = message_of(len(payload), (start, bits, "little_endian"), at, value, identifier)
        table: dict[str, Any] = {"checksum": {"signal": "Crc", **scheme}}
        if counter:
            table["counter"] = "Counter"
        bus = bus_of(message, table)
        _, made = checked(bus, payload)
        assert made == payload
        fd = FD if len(payload) > 8 else 0
        for flipped in (0, 1):
            sent = bytes([payload[0] ^ flipped]) + payload[1:]
            frame = frames_of([(identifier | fd, sent)])
            _, counts = taken(bus, nothing_received(bus, 1), NO_COUNTS, frame, 0)
            assert (counts.accepted, counts.checksum) == (1 - flipped, flipped)


def test_the_checksum_sum8_covers_the_identifier_and_may_stand_in_the_first_byte():
    """Subaru and Tesla use such checksums; the frame is from opendbc's code for Subaru."""
    message = message_of(8, (0, 8, "little_endian"), identifier=0x122)
    bus = bus_of(message, {"checksum": "Crc", "checksum_kind": "sum8"})
    payload = bytes.fromhex("c5c924c3597164c4")
    assert checked(bus, payload) == (0xC5, payload)


@pytest.fixture(scope="module", params=["plain", "compiled"])
def codec(request: pytest.FixtureRequest) -> tuple[Any, Any]:
    if request.param == "plain":
        return receive, transmit
    return compiled(receive), compiled(transmit)


@pytest.mark.parametrize("identifier", [0x123, 0x18FF1234])
def test_a_receiver_accepts_what_a_sender_with_the_same_rig_makes(codec: tuple[Any, Any], identifier: int):
    message = message_of(
        12, (3, 37, "little_endian"), (47, 5, "big_endian"), (64, 16, "little_endian"), identifier
    )
    table = {
        "cycle_ms": 10.0,
        "counter": {"signal": "Counter", "lowest": 2, "highest": 29, "start": 11, "step": -5},
        "checksum": {
            "signal": "Crc", "width": 37, "polynomial": 0x1234567891, "start": 0x1F0F0F0F0F, "reflect_in": True,
            "final_xor": 1, "covers": ["identifier", "counter", "data_id 1 to 0", "payload"],
            "data_id": [5, 600, 7],
        },
    }  # fmt: skip
    there, here = bus_of(message, table, sending=True), bus_of(message, table)
    reception, counts, sent = nothing_received(here, 1), NO_COUNTS, None
    for number in range(70):
        sent, frames = transmitted(there, [float(number)], sent, call=codec[1])
        values = message.decode(frames.data[0, :12].tobytes(), scaling=False)
        assert values["Counter"] == 2 + (9 - 5 * number) % 28
        reception, counts = taken(here, reception, counts, frames, number * 10_000_000, codec[0])
    assert counts == NO_COUNTS._replace(accepted=70)
    assert reception.values[0] == 69.0
    extended = EXTENDED if identifier > 0x7FF else 0
    wrong = frames.data[0, :12].tobytes()
    for bit in range(8 * 12):
        flipped = bytearray(wrong)
        flipped[bit // 8] ^= 1 << bit % 8
        frame = frames_of([(identifier | extended | FD, bytes(flipped))])
        _, after = taken(here, reception, counts, frame, 700_000_000, codec[0])
        assert after == counts._replace(checksum=1), bit
