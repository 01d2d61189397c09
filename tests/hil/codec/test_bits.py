"""Raw values in payload bytes, and checksums, against independent implementations."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from crccheck.crc import Crc8SaeJ1850
from hil_support import CALM, j1850
from hypothesis import given
from hypothesis import strategies as st

from liftgate_hil.codec.bits import (
    FLOAT32,
    FLOAT64,
    SIGNED,
    UNSIGNED,
    BitPlace,
    extract,
    insert,
    read_number,
    write_number,
)
from liftgate_hil.codec.checksum import CRC8_SAE_J1850, SUM8, XOR8, checksum, crc8_byte
from liftgate_hil.codec.tables import MESSAGE

MAX = 64


def sum_of(kind: int, identifier: int, frame: np.ndarray, length: int, skip: int) -> int:
    """Return the checksum of a frame of a message without further protection."""
    table = np.zeros(1, dtype=MESSAGE).view(np.recarray)
    table.kind, table.identifier = kind, identifier
    table.length, table.checksum_byte = length, skip
    return checksum(table[0], frame, 0)


def bits_of(place: BitPlace) -> list[int]:
    """Return the bit numbers (8 · byte + bit) of a signal's place, lowest first, counted one by one."""
    byte, bit = place.byte, place.shift
    numbers = []
    for _ in range(place.length):
        numbers.append(8 * byte + bit)
        bit += 1
        if bit == 8:
            bit, byte = 0, byte + place.stride
    return numbers


@st.composite
def places(draw: st.DrawFn, longest: int = 64) -> BitPlace:
    length = draw(st.integers(1, longest))
    shift = draw(st.integers(0, 7))
    stride = draw(st.sampled_from((1, -1)))
    spanned = (shift + length + 7) // 8
    byte = draw(st.integers(0, MAX - spanned))
    if stride < 0:
        byte += spanned - 1
    return BitPlace(byte, shift, length, stride, draw(st.sampled_from((UNSIGNED, SIGNED))))


payloads = st.binary(min_size=MAX, max_size=MAX)


def array_of(payload: bytes) -> np.ndarray:
    return np.frombuffer(payload, dtype=np.uint8).reshape(1, MAX).copy()


@CALM
@given(payloads, places(32))
def test_a_raw_value_equals_one_that_is_assembled_bit_by_bit(payload: bytes, place: BitPlace):
    expected = sum(
        (payload[number // 8] >> (number % 8) & 1) << index for index, number in enumerate(bits_of(place))
    )
    assert extract(array_of(payload), 0, *place[:4]) == expected


@CALM
@given(payloads, places(32), st.data())
def test_writing_changes_no_bit_outside_the_signal(payload: bytes, place: BitPlace, data: st.DataObject):
    raw = data.draw(st.integers(0, (1 << place.length) - 1))
    after = array_of(payload)
    insert(after, 0, *place[:4], np.int64(raw))
    expected = bytearray(payload)
    for index, number in enumerate(bits_of(place)):
        bit = 1 << (number % 8)
        expected[number // 8] = expected[number // 8] & ~bit | (bit if raw >> index & 1 else 0)
    assert after.tobytes() == bytes(expected)


@CALM
@given(places(), st.data())
def test_an_integer_reads_back_as_written(place: BitPlace, data: st.DataObject):
    if place.kind == SIGNED:
        low, high = -(1 << (place.length - 1)), (1 << (place.length - 1)) - 1
    else:
        low, high = 0, (1 << place.length) - 1
    raw = data.draw(st.one_of(st.integers(low, high), st.sampled_from((low, high))))
    value = float(raw)
    if not low <= int(value) <= high:  # rounded up to a power of two that does not fit
        value = float(np.nextafter(value, 0.0))
    frame = np.zeros((1, MAX), dtype=np.uint8)
    write_number(frame, 0, place, value)
    assert read_number(frame, 0, place) == value


@CALM
@given(places(), st.floats(width=32), st.booleans())
def test_floats_read_back_bit_by_bit(place: BitPlace, value: float, double: bool):
    length, kind, code = (64, FLOAT64, "<d") if double else (32, FLOAT32, "<f")
    place = place._replace(length=length, kind=kind)
    spanned = (place.shift + length + 7) // 8
    byte = min(place.byte, MAX - spanned) if place.stride > 0 else max(place.byte, spanned - 1)
    place = place._replace(byte=byte)
    frame = np.zeros((1, MAX), dtype=np.uint8)
    write_number(frame, 0, place, value)
    raw = sum(
        (int(frame[0, number // 8]) >> (number % 8) & 1) << index for index, number in enumerate(bits_of(place))
    )
    written = raw.to_bytes(length // 8, "little")
    back = read_number(frame, 0, place)
    if value != value:
        assert back != back
    else:
        assert written == struct.pack(code, value)
        assert back == value


def test_crc8_has_the_check_value_of_sae_j1850():
    crc = 0xFF
    for byte in b"123456789":
        crc = crc8_byte(crc, byte)
    assert crc ^ 0xFF == 0x4B == Crc8SaeJ1850.calc(b"123456789")


@CALM
@given(st.integers(0, 0x1FFFFFFF), st.binary(min_size=1, max_size=64), st.data())
def test_the_frame_crc_covers_identifier_and_payload_except_its_own_byte(
    identifier: int, payload: bytes, data: st.DataObject
):
    skip = data.draw(st.integers(0, len(payload) - 1))
    frame = array_of(payload.ljust(MAX, b"\xa5"))
    got = sum_of(CRC8_SAE_J1850, identifier, frame, len(payload), skip)
    assert got == j1850(identifier, payload, skip)


@pytest.mark.parametrize(("kind", "expected"), [(XOR8, 0x23 ^ 0x01 ^ 1 ^ 4), (SUM8, 0x23 + 1 + 1 + 4)])
def test_xor_and_sum_checksums_cover_identifier_and_payload_except_their_own_byte(kind: int, expected: int):
    frame = array_of(bytes([1, 0xEE, 4]).ljust(MAX, b"\xa5"))
    assert sum_of(kind, 0x123, frame, 3, 1) == expected & 0xFF


def test_a_sum_checksum_wraps_at_one_byte():
    frame = array_of(bytes([0xFF] * 8).ljust(MAX, b"\0"))
    assert sum_of(SUM8, 0x7FF, frame, 8, 7) == (0xFF + 0x07 + 7 * 0xFF) & 0xFF


@pytest.mark.parametrize("position", range(64))
def test_the_crc_detects_every_single_flipped_bit(position: int):
    payload = bytes([0x10, 0x32, 0x54, 0x76, 0x98, 0xBA, 0xDC, 0x00])
    good = sum_of(CRC8_SAE_J1850, 0x120, array_of(payload.ljust(MAX, b"\0")), 8, 7)
    flipped = bytearray(payload)
    flipped[position // 8] ^= 1 << (position % 8)
    frame = array_of(bytes(flipped).ljust(MAX, b"\0"))
    covered = position // 8 != 7
    assert (sum_of(CRC8_SAE_J1850, 0x120, frame, 8, 7) != good) == covered
