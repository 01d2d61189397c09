"""Frames of the serial line: known vectors, and which frames survive corrupted bytes."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import pytest
from crccheck.crc import Crc16CcittFalse
from hil_support import CALM
from hypothesis import given
from hypothesis import strategies as st
from serial_lines import line_of, noisy_line

from liftgate_hil.transport.cobs import BadFrames, CobsDecoder, crc16, encode, stuff, unstuff

PAGE = Path(__file__).parents[3] / "docs" / "serial-line.md"
identifiers = st.integers(0, 0x7FF)
payloads = st.binary(max_size=64)
frames = st.tuples(identifiers, payloads)


# Known vectors.


@pytest.mark.parametrize(
    ("plain", "stuffed"),
    [
        # Cheshire and Baker 1999, section 2.2: the beginning of an IP packet.
        ("4500002C4C79000040064F37", "02450104" + "2C4C79" + "0105" + "40064F37"),
        ("", "01"),
        ("00", "0101"),
        ("0000", "010101"),
        ("001100", "01021101"),
        ("11220033", "0311220233"),
        ("11223344", "0511223344"),
        ("11000000", "0211010101"),
    ],
)
def test_cobs_encoding_matches_known_examples(plain: str, stuffed: str):
    assert stuff(bytes.fromhex(plain)).hex().upper() == stuffed
    assert unstuff(bytes.fromhex(stuffed)) == bytes.fromhex(plain)


def test_the_crc_has_its_published_check_value():
    assert crc16(b"123456789") == 0x29B1


@CALM
@given(st.binary(max_size=80))
def test_the_crc_agrees_with_an_independent_implementation(data: bytes):
    assert crc16(data) == Crc16CcittFalse.calc(data)


def test_an_encoded_frame_has_the_documented_bytes():
    # id 0x120 → 20 01, payload 00 AA, CRC over 20 01 00 AA, each with its low byte first.
    crc = Crc16CcittFalse.calc(bytes.fromhex("200100AA"))
    assert crc == 0x901E
    assert encode(0x120, b"\x00\xaa") == bytes.fromhex("032001" + "04AA1E90" + "00")


def test_the_encoded_example_frame_in_the_manual_is_correct():
    (example,) = re.findall(r"eight zeros is `([0-9A-F ]+)`", PAGE.read_text(encoding="utf-8"))
    assert encode(0x120, bytes(8)) == bytes.fromhex(example)


@pytest.mark.parametrize(("identifier", "size"), [(-1, 0), (0x800, 0), (0x1FFFFFFF, 8), (0, 65)])
def test_too_large_identifiers_and_payloads_are_refused_on_a_serial_line(identifier: int, size: int):
    with pytest.raises(ValueError, match="allowed"):
        encode(identifier, bytes(size))


# Whole lines.


@CALM
@given(st.lists(frames), st.lists(st.integers(0, 2000)))
def test_frames_are_decoded_whatever_the_read_boundaries(rows: list[tuple[int, bytes]], cuts: list[int]):
    line = line_of(rows)
    assert line.count(0) == len(rows)
    decoder = CobsDecoder()
    places = sorted({0, len(line), *(cut for cut in cuts if cut < len(line))})
    got = [row for start, end in pairwise(places) for row in decoder.feed(line[start:end])]
    assert got == rows
    assert decoder.counts == BadFrames()


@CALM
@given(st.lists(frames, min_size=1), st.integers(1, 5))
def test_zero_bytes_between_frames_are_ignored(rows: list[tuple[int, bytes]], zeros: int):
    decoder = CobsDecoder()
    line = bytes(zeros) + b"".join(encode(*row) + bytes(zeros) for row in rows)
    assert decoder.feed(line) == rows
    assert decoder.counts == BadFrames()


# Garbage.


@CALM
@given(st.binary(max_size=300), frames)
def test_the_next_complete_frame_after_garbage_is_decoded(garbage: bytes, frame: tuple[int, bytes]):
    decoder = CobsDecoder()
    decoder.feed(garbage + b"\0")
    assert decoder.feed(encode(*frame)) == [frame]


@CALM
@given(frame=frames, following=frames, data=st.data())
def test_a_truncated_frame_does_not_spoil_the_next(
    frame: tuple[int, bytes], following: tuple[int, bytes], data: st.DataObject
):
    whole = encode(*frame)
    at = data.draw(st.integers(1, len(whole) - 2))
    decoder = CobsDecoder()
    got = decoder.feed(whole[:at] + b"\0" + encode(*following))
    assert got == [following]
    assert sum(decoder.counts) == 1


@CALM
@given(frame=frames, following=frames, data=st.data())
def test_a_frame_with_one_flipped_bit_is_never_accepted(
    frame: tuple[int, bytes], following: tuple[int, bytes], data: st.DataObject
):
    line = bytearray(encode(*frame) + b"\0" + encode(*following))
    bit = data.draw(st.integers(0, 8 * len(encode(*frame)) - 1))
    line[bit // 8] ^= 1 << bit % 8
    decoder = CobsDecoder()
    got = decoder.feed(bytes(line))
    # A flip in the first delimiter joins the frame with the empty one after it: still not accepted.
    assert got == [following]
    assert sum(decoder.counts) >= 1


@pytest.mark.parametrize(
    ("line", "cause"),
    [
        (b"\x09abc\0", BadFrames(cut=1)),
        (b"\xff" * 70 + b"\0", BadFrames(long=1)),
        (stuff(b"abc") + b"\0", BadFrames(short=1)),
        (b"\x01\0", BadFrames(short=1)),
        (stuff(b"\x20\x01ab\x00\x00") + b"\0", BadFrames(crc=1)),
        (stuff(b"\x00\x08" + crc16(b"\x00\x08").to_bytes(2, "little")) + b"\0",
         BadFrames(identifier=1)),
        (stuff(bytes(69)) + b"\0", BadFrames(long=1)),
        (b"\0\0\0", BadFrames()),
    ],
)  # fmt: skip
def test_each_bad_frame_is_counted_under_its_cause(line: bytes, cause: BadFrames):
    decoder = CobsDecoder()
    assert decoder.feed(line) == []
    assert decoder.counts == cause
    one_by_one = CobsDecoder()
    assert [one_by_one.feed(line[i : i + 1]) for i in range(len(line))] == [[]] * len(line)
    assert one_by_one.counts == cause


def test_garbage_without_zero_bytes_is_not_buffered_and_counts_once():
    decoder = CobsDecoder()
    for _ in range(1000):
        assert decoder.feed(b"\xaa" * 1000) == []
        assert len(decoder._pending) < 70
    assert decoder.counts == BadFrames(long=1)
    assert decoder.feed(b"\0" + encode(5, b"ok")) == [(5, b"ok")]


@pytest.mark.parametrize("seed", range(20))
def test_a_disturbed_line_delivers_only_frames_that_were_sent(seed: int):
    sent, line = noisy_line(seed)
    decoder = CobsDecoder()
    got = decoder.feed(line)
    remaining = iter(sent)
    assert all(frame in remaining for frame in got)  # in order, none made up
    assert len(got) > 50
    assert sum(decoder.counts) > 20
