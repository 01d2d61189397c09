"""How a message is protected: what a rig says of it, and the columns of its row in the tables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from liftgate_hil.codec import checksum
from liftgate_hil.codec.bits import FLOAT32, FLOAT64, SIGNED, UNSIGNED, Place
from liftgate_hil.codec.e2e import profile_1
from liftgate_hil.issues import ConfigIssues

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal


@dataclass(frozen=True)
class EndToEnd:
    """An AUTOSAR E2E profile; the defaults of its state machine let no frame with an error through."""

    profile: str  # of checksum.PROFILES
    data_ids: tuple[int, ...]  # one, or in profile 2 sixteen
    data_id_mode: str = "both"  # of profile_1.DATA_ID_MODES
    nibble: str | None = None  # signal that carries the data ID's nibble
    max_delta: int = 1  # largest step of the counter that is tolerated; 1: none may be lost
    sync: int = 0  # frames after a wrong sequence that are not used yet
    window: int = 1
    min_ok: tuple[int, int, int] = (1, 1, 1)  # in INIT, VALID, INVALID
    max_error: tuple[int, int, int] = (0, 0, 0)


@dataclass(frozen=True)
class MessageOptions:
    """What a rig says about a message besides its signals; None: as the database says."""

    cycle_ms: float | None = None
    timeout_cycles: float = 3.0
    counter: str | None = None
    checksum: str | None = None
    checksum_kind: str = "crc8-sae-j1850"
    e2e: EndToEnd | None = None


def place_of(signal: Signal) -> Place:
    """Where a signal's bits lie."""
    kind = SIGNED if signal.is_signed else UNSIGNED
    if signal.is_float:
        kind = FLOAT32 if signal.length == 32 else FLOAT64
    if signal.byte_order == "little_endian":
        return Place(signal.start // 8, signal.start % 8, signal.length, 1, kind)
    # DBC names a Motorola signal's highest bit; count bits from the frame's first to its last.
    lowest = 8 * (signal.start // 8) + 7 - signal.start % 8 + signal.length - 1
    return Place(lowest // 8, 7 - lowest % 8, signal.length, -1, kind)


def protection_row(
    message: Message,
    options: MessageOptions,
    add_place: Callable[[Place], int],
    issues: ConfigIssues,
) -> dict[str, Any]:
    """Counter and checksum of a message, simple or of an E2E profile."""
    key = f"messages.{message.name}"
    e2e = options.e2e
    for name in (options.counter, options.checksum, e2e.nibble if e2e else None):
        if name and message.get_signal_by_name(name).multiplexer_signal is not None:
            issues.add(
                key, f"{name} is in some frames only; allowed: a signal that is in every frame"
            )
    counter, modulus, nibble = -1, 1, -1
    kind, checksum_byte = checksum.NONE, -1
    if options.counter is not None:
        place = place_of(message.get_signal_by_name(options.counter))
        counter, modulus = add_place(place), 1 << place.length
        bits = {"e2e-p05": 8}.get(e2e.profile, 4) if e2e else 0
        if place.length > 32 or (e2e and place.length != bits):
            allowed = f"{bits} bits" if e2e else "up to 32 bits"
            issues.add(f"{key}.counter", f"{options.counter}: allowed: a signal of {allowed}")
    if options.checksum is not None:
        place = place_of(message.get_signal_by_name(options.checksum))
        kind = checksum.PROFILES[e2e.profile] if e2e else checksum.KINDS[options.checksum_kind]
        checksum_byte = place.byte
        size = 2 if kind == checksum.E2E_P05 else 1
        if place.length != 8 * size or place.shift != 0 or (size == 2 and place.stride < 0):
            issues.add(
                f"{key}.checksum",
                f"{options.checksum}: allowed: a signal that fills "
                + ("two bytes, Intel byte order" if size == 2 else "one byte"),
            )
    if e2e is None:
        return _protection(counter, modulus, kind, checksum_byte, nibble, EndToEnd("", (0,)), 0)
    for name in ("counter", "checksum"):
        if getattr(options, name) is None:
            issues.add(f"{key}.{name}", f"missing; allowed: the signal of {e2e.profile}")
    if e2e.nibble is not None:
        place = place_of(message.get_signal_by_name(e2e.nibble))
        nibble = add_place(place)
        if place.length != 4:
            issues.add(f"{key}.data_id_nibble", f"{e2e.nibble}: allowed: a signal of 4 bits")
    if kind == checksum.E2E_P01:
        modulus = 15
    return _protection(counter, modulus, kind, checksum_byte, nibble, e2e, e2e.window)


def _protection(
    counter: int, modulus: int, kind: int, byte: int, nibble: int, e2e: EndToEnd, window: int
) -> dict[str, Any]:
    """The columns of a message that say how it is protected."""
    return {
        "counter": counter,
        "modulus": modulus,
        "kind": kind,
        "checksum_byte": byte,
        "data_ids": (e2e.data_ids * 16)[:16],
        "data_id_mode": profile_1.DATA_ID_MODES[e2e.data_id_mode],
        "nibble": nibble,
        "max_delta": e2e.max_delta,
        "sync": e2e.sync,
        "window": window,
        "min_ok": e2e.min_ok,
        "max_error": e2e.max_error,
    }
