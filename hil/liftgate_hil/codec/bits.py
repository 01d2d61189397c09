"""Reading and writing of raw signal values in a frame's bytes.

A signal is processed from the byte with its least significant bit towards that with its most significant one:
forward for Intel byte order, backward for Motorola, so that one loop serves both. Values are processed in words of
at most 32 bits, which keeps the arithmetic the same for Python's integers and for machine integers.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, outlined

UNSIGNED, SIGNED, FLOAT32, FLOAT64 = 0, 1, 2, 3

_WORD = 4294967296.0


class BitPlace(NamedTuple):
    """Position of a signal in a frame: byte and shift of its lowest bit, and its number of bits (`length`).

    `stride` is the step to the byte with the next higher bits: +1 for Intel byte order, −1 for Motorola. `kind` is
    UNSIGNED, SIGNED, FLOAT32 or FLOAT64.
    """

    byte: int
    shift: int
    length: int
    stride: int
    kind: int


@compilable
def place_at(places: Any, row: int) -> BitPlace:
    """Return the row `row` of a table of dtype tables.PLACE as a BitPlace."""
    place = places[row]
    return BitPlace(place.byte, place.shift, place.length, place.stride, place.kind)


@compilable
def extract(data: NDArray[np.uint8], row: int, byte: int, shift: int, length: int, stride: int) -> int:
    """Return up to 32 bits of a frame (row of `data`) as an unsigned number; other arguments: as in BitPlace."""
    raw = int(np.int64(data[row, byte])) >> shift
    have = 8 - shift
    while have < length:
        byte += stride
        raw |= int(np.int64(data[row, byte])) << have
        have += 8
    return raw & ((1 << length) - 1)


@compilable
def insert(data: NDArray[np.uint8], row: int, byte: int, shift: int, length: int, stride: int, raw: int) -> None:
    """Write the lowest `length` (up to 32) bits of `raw` into a frame (row of `data`); other bits remain."""
    left = length
    while left > 0:
        take = min(8 - shift, left)
        mask = ((1 << take) - 1) << shift
        bits = (raw << shift) & mask
        data[row, byte] = (int(np.int64(data[row, byte])) & ~mask & 0xFF) | bits
        raw >>= take
        left -= take
        shift = 0
        byte += stride


@outlined
def extract_long(data: NDArray[np.uint8], row: int, place: BitPlace) -> int:
    """Return up to 64 bits of a frame (row of `data`), unsigned.

    All 64 bits are returned as two's complement: compiled code has no larger integer.
    """
    length = place.length
    if length <= 32:
        return extract(data, row, place.byte, place.shift, length, place.stride)
    low = extract(data, row, place.byte, place.shift, 32, place.stride)
    high = extract(data, row, place.byte + 4 * place.stride, place.shift, length - 32, place.stride)
    return joined(high, low)


@outlined
def insert_long(data: NDArray[np.uint8], row: int, place: BitPlace, raw: int) -> None:
    """Write up to 64 bits, `raw`, into a frame (row of `data`), leaving other bits as is; see `extract_long`."""
    first = min(place.length, 32)
    insert(data, row, place.byte, place.shift, first, place.stride, raw & 0xFFFFFFFF)
    if place.length > 32:
        high = (raw >> 32) & 0xFFFFFFFF
        byte = place.byte + 4 * place.stride
        insert(data, row, byte, place.shift, place.length - 32, place.stride, high)


@compilable
def joined(high: int, low: int) -> int:
    """Return two 32-bit words joined into one 64-bit number, two's complement."""
    if high >= 0x80000000:
        high -= 0x100000000
    return (high << 32) | low


@outlined
def read_number(data: NDArray[np.uint8], row: int, place: BitPlace) -> float:
    """Return a signal's raw value in a frame (row of `data`) as a float, exact up to 53 bits."""
    length = place.length
    if length <= 32:
        value = extract(data, row, place.byte, place.shift, length, place.stride)
        if place.kind == SIGNED and value >> (length - 1):
            return float(value - (1 << length))
        if place.kind == FLOAT32:
            return float(np.uint32(value).view(np.float32))
        return float(value)
    low = extract(data, row, place.byte, place.shift, 32, place.stride)
    high = extract(data, row, place.byte + 4 * place.stride, place.shift, length - 32, place.stride)
    if place.kind == FLOAT64:
        word = np.uint64(low) | (np.uint64(high) << np.uint64(32))
        return float(np.uint64(word).view(np.float64))
    if place.kind == SIGNED and high >> (length - 33):
        high -= 1 << (length - 32)
    return high * _WORD + low


@compilable
def write_number(data: NDArray[np.uint8], row: int, place: BitPlace, value: float) -> None:
    """Write a signal's raw value into a frame (row of `data`): an integer that fits its bits, or any float."""
    length = place.length
    if place.kind == FLOAT32:
        word = int(np.int64(np.float32(value).view(np.uint32)))
        insert(data, row, place.byte, place.shift, 32, place.stride, word)
        return
    if place.kind == FLOAT64:
        double = np.float64(value).view(np.uint64)
        low = int(np.int64(double & np.uint64(0xFFFFFFFF)))
        high = int(np.int64(double >> np.uint64(32)))
    else:
        top = math.floor(value / _WORD)
        low = int(np.int64(value - top * _WORD))
        high = int(np.int64(top))
    if length <= 32:
        insert(data, row, place.byte, place.shift, length, place.stride, low)
        return
    insert(data, row, place.byte, place.shift, 32, place.stride, low)
    insert(data, row, place.byte + 4 * place.stride, place.shift, length - 32, place.stride, high)
