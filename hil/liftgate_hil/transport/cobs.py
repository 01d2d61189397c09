"""Frame format of the serial line: COBS( id:u16le, payload, crc:u16le ) 0x00.

Identifier: 11 bits, 0 to 0x7FF, in two bytes, low byte first. Payload: 0 to 64 bytes; more than 8 only where the
database has a CAN FD message. CRC: CRC-16/IBM-3740, also known as CRC-16/CCITT-FALSE, over identifier and payload
(polynomial 0x1021, initial value 0xFFFF, not reflected, no final XOR, 0x29B1 over "123456789"), low byte first.

COBS (Cheshire and Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on Networking 7(2), 1999)
replaces every zero by the distance to the next one, so that 0x00 only ever ends a frame: whatever was lost or
garbled before, the frame after the next zero is whole again. Two zeros in a row are no frame.

A frame has at most 68 bytes, so COBS's special code for 254 bytes without a zero never occurs, and each direction
is a few lines on `bytes.split` and `bytes.join`. `liftgate_serial.h` is the counterpart in C for the ECU.
"""

from __future__ import annotations

from binascii import crc_hqx
from typing import NamedTuple

MAX_IDENTIFIER = 0x7FF
MAX_PAYLOAD = 64  # bytes, CAN FD
_OVERHEAD = 4  # bytes of identifier and CRC
_MAX_STUFFED = MAX_PAYLOAD + _OVERHEAD + 1  # bytes without the delimiter
DELIMITER = b"\0"


class BadFrames(NamedTuple):
    """Counts of bad frames received, by cause; each frame counts under exactly one."""

    cut: int = 0  # ends before its COBS code says
    long: int = 0  # more bytes without a zero than the longest frame has
    short: int = 0  # no room for identifier and CRC
    crc: int = 0
    identifier: int = 0  # above 0x7FF, with a sound CRC


def crc16(data: bytes) -> int:
    """Return the CRC-16/IBM-3740 (CCITT-FALSE) of data."""
    return crc_hqx(data, 0xFFFF)


def stuff(data: bytes) -> bytes:
    """Return the COBS encoding of up to 253 bytes, without the delimiter."""
    return b"".join(bytes((len(run) + 1,)) + run for run in data.split(b"\0"))


def unstuff(stuffed: bytes) -> bytes | None:
    """Return the COBS-decoded data; None if the last code points beyond the end. `stuffed` has no zero."""
    runs = []
    at = 0
    while at < len(stuffed):
        end = at + stuffed[at]
        runs.append(stuffed[at + 1 : end])
        at = end
    return b"\0".join(runs) if at == len(stuffed) else None


def encode(identifier: int, payload: bytes) -> bytes:
    """Return a serial frame with its delimiter. Raises ValueError if identifier or payload is out of range."""
    if not 0 <= identifier <= MAX_IDENTIFIER:
        raise ValueError(f"identifier {identifier:#x}; allowed: 0 to {MAX_IDENTIFIER:#x}")
    if len(payload) > MAX_PAYLOAD:
        raise ValueError(f"payload of {len(payload)} bytes; allowed: at most {MAX_PAYLOAD}")
    covered = identifier.to_bytes(2, "little") + payload
    return stuff(covered + crc16(covered).to_bytes(2, "little")) + DELIMITER


class CobsDecoder:
    """Decoder of a byte stream into serial frames; keeps at most one incomplete frame between calls."""

    def __init__(self) -> None:
        self._pending = b""
        self._skipping = False  # whether bytes are skipped until the next zero
        self._cut = self._long = self._short = self._crc = self._identifier = 0

    @property
    def counts(self) -> BadFrames:
        """Counts of bad frames so far."""
        return BadFrames(self._cut, self._long, self._short, self._crc, self._identifier)

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        """Return (identifier, payload) of each frame that these bytes complete."""
        *whole, rest = data.split(DELIMITER)
        frames = []
        for piece in whole:
            frame = self._end(piece)
            if frame is not None:
                frames.append(frame)
        self._gather(rest)
        return frames

    def reset(self) -> None:
        """Discard the incomplete frame, as its rest will not arrive."""
        self._pending, self._skipping = b"", False

    def _gather(self, piece: bytes) -> None:
        """Append bytes to the incomplete frame; if that gets too long, count it and skip the rest of it."""
        if self._skipping:
            return
        self._pending += piece[: _MAX_STUFFED + 1]
        if len(self._pending) > _MAX_STUFFED:
            self._long += 1
            self._pending, self._skipping = b"", True

    def _end(self, piece: bytes) -> tuple[int, bytes] | None:
        """Complete a frame by its last bytes; return identifier and payload, or None for a bad or empty frame."""
        self._gather(piece)
        stuffed, skipped = self._pending, self._skipping
        self.reset()
        if skipped or not stuffed:
            return None
        raw = unstuff(stuffed)
        if raw is None:
            self._cut += 1
            return None
        if len(raw) < _OVERHEAD:
            self._short += 1
            return None
        if crc16(raw[:-2]) != int.from_bytes(raw[-2:], "little"):
            self._crc += 1
            return None
        identifier = int.from_bytes(raw[:2], "little")
        if identifier > MAX_IDENTIFIER:
            self._identifier += 1
            return None
        return identifier, raw[2:-2]
