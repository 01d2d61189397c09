"""Undisturbed and disturbed serial lines, for several tests."""

from __future__ import annotations

import random
from collections.abc import Sequence

from liftgate_hil.transport.cobs import encode

ROWS = [(0x120, b"12345678"), (0x7FF, b""), (0, bytes(8)), (0x210, b"\x00\xff" * 4)]


def line_of(rows: Sequence[tuple[int, bytes]]) -> bytes:
    """Encoded bytes of frames, each (identifier, payload)."""
    return b"".join(encode(*row) for row in rows)


def noisy_line(seed: int) -> tuple[list[tuple[int, bytes]], bytes]:
    """Sent frames, and the bytes received over a bad line: with cuts, insertions, bit flips, noise."""
    dice = random.Random(seed)
    sent = []
    line = bytearray()
    for _ in range(200):
        frame = (dice.randrange(0x800), dice.randbytes(dice.randrange(65)))
        sent.append(frame)
        coded = bytearray(encode(*frame))
        fault = dice.randrange(8)
        place = dice.randrange(len(coded))
        if fault == 0:
            coded = coded[:place]
        elif fault == 1:
            coded = coded[place:]
        elif fault == 2:
            coded[place] ^= 1 << dice.randrange(8)
        elif fault == 3:
            coded[place:place] = dice.randbytes(dice.randrange(150))
        line += coded
    return sent, bytes(line)
