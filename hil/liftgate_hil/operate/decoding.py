"""Decoding of a test bench's frames: their signals by the database, and the fault that they inject or end."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import numpy as np

from liftgate_hil.config.fault_kinds import DRIVE, FAULT_KINDS, MESSAGE
from liftgate_hil.config.inject import BABBLING, NOTHING
from liftgate_hil.config.kinds import Level, Number
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario_tables import Fault, fault_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.signals import DIRECTIONS

_WAYS = ("sent", "received")


class Decoded(NamedTuple):
    """Decoded value of a signal."""

    number: float
    label: str  # of the database, else the number as a text


_NOT_GIVEN = Decoded(math.nan, NOTHING)

# Which fault: its kind, place and direction. An order for the same one again gives it another value.
Which = tuple[str, str, str]


def decoded(rig: Rig, name: str, payload: bytes) -> dict[str, Decoded]:
    """Return a message's signals, decoded from a payload, by name. Raises ConfigError where it does not fit."""
    import cantools

    message = rig.messages[name]
    if len(payload) != message.length:
        raise ConfigError(f"{len(payload)} bytes; allowed: {message.length}")
    try:
        numbers = cast("dict[str, float]", message.decode(payload, decode_choices=False))
        return {key: _value_of(message, key, float(value)) for key, value in numbers.items()}
    except (cantools.database.DecodeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{error}; allowed: what the database defines for {name}") from error


def _value_of(message: Any, key: str, value: float) -> Decoded:
    """Return the decoded value of a signal. Raises ValueError where it is not finite."""
    signal = message.get_signal_by_name(key)
    if not math.isfinite(value):
        raise ValueError(f"{key} is {value}")
    if signal.is_float and signal.length == 32 and float(signal.scale) == 1.0:
        # The shortest decimal that is this float: what its sender has typed.
        value = float(str(np.float32(value - float(signal.offset)))) + float(signal.offset)
    labels = {number: str(label) for number, label in (signal.choices or {}).items()}
    raw = round(signal.conversion.numeric_scaled_to_raw(value)) if labels else 0
    return Decoded(value, labels.get(raw, f"{value:g}"))


def which_ordered(rig: Rig, what: str, content: Mapping[str, Decoded]) -> Which:
    """Return which fault a test bench's frame refers to: its kind, place and direction. Raises ConfigError.

    `what` is FAULT or BABBLING, `content` the decoded signals by their keys in inject.ORDERS.
    """
    content = {"place": _NOT_GIVEN, "direction": _NOT_GIVEN, **content}
    direction = content["direction"].label
    if what == BABBLING:
        return BABBLING, f"{round(content['identifier'].number):X}", direction
    name, place = content["kind"].label, content["place"].label
    if name not in FAULT_KINDS:
        raise ConfigError(f"kind {name}; allowed: a label that is a kind of fault")
    kind = FAULT_KINDS[name]
    if kind.of == DRIVE and place == NOTHING:
        place = "both"
    if kind.of != MESSAGE:
        return name, place, ""
    return name, place, direction if direction in _WAYS else _way_of(rig, place)


def fault_ordered(which: Which, what: str, content: Mapping[str, Decoded]) -> Fault:
    """Return the fault that a test bench's frame begins, see `which_ordered`. Raises ConfigError."""
    name, place, direction = which
    if what == BABBLING:
        babbling = {"id": round(content["identifier"].number), "rate": content["rate"].number}
        return fault_of(BABBLING, None, {**babbling, "direction": direction})
    number = content.get("value", _NOT_GIVEN).number
    values: dict[str, Any] = {"direction": direction} if direction else {}
    own = value_key(name)
    if own is not None:
        values[own] = number
    if name == "bridge_stuck":
        is_one = number in range(len(DIRECTIONS))
        values["state"] = DIRECTIONS[int(number)] if is_one else number
    if name == "parameter":
        values["key"], place = place, NOTHING
    return fault_of(name, None if place == NOTHING else place, values)


def value_key(kind: str) -> str | None:
    """Return the name of a fault kind's key that the signal `value` of a frame sets; None: it has none."""
    own = FAULT_KINDS[kind].keys
    return next((key.name for key in own if isinstance(key.kind, Number | Level)), None)


def _way_of(rig: Rig, place: str) -> str:
    """Return "sent" or "received", a message's direction as the gate sees it. Raises ConfigError for none."""
    if place == NOTHING:
        raise ConfigError("direction none; allowed: sent or received, where no message is named")
    return "received" if place in {each.message for each in rig.inputs} else "sent"
