"""Trouble codes as text (SAE J2012, ISO 15031-6) and as numbers of three bytes (ISO 14229-1)."""

from __future__ import annotations

import re

ALLOWED = (
    "five characters such as B1A01 (P, C, B or U, a digit of 0 to 3, three hexadecimal ones), or with the failure "
    "type, B1A01-62"
)
_TEXT = re.compile(r"([PCBU])([0-3])([0-9A-F]{3})(?:-([0-9A-F]{2}))?")
_AREAS = "PCBU"


def number_of(text: str) -> tuple[int, int]:
    """Return the number of a trouble code given as text, and the mask of the bits that count.

    Without a failure type, any failure type matches. The letter is in bits 23 and 22, the digit in 21 and 20, then
    come three hexadecimal digits, and the failure type in the low byte. Raises ValueError.
    """
    found = _TEXT.fullmatch(text)
    if found is None:
        raise ValueError(f"{text!r}; allowed: {ALLOWED}")
    letter, digit, rest, failure = found.groups()
    number = _AREAS.index(letter) << 22 | int(digit) << 20 | int(rest, 16) << 8
    if failure is None:
        return number, 0xFFFF00
    return number | int(failure, 16), 0xFFFFFF


def text_of(number: int) -> str:
    """Return the text of a trouble code's number (three bytes) with failure type: 0x9A0162 is B1A01-62."""
    return f"{_AREAS[number >> 22 & 3]}{number >> 20 & 3}{number >> 8 & 0xFFF:03X}-{number & 0xFF:02X}"
