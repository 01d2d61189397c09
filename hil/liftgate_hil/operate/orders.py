"""Orders (commands) of a test bench: read beside the loop from the frames in its ring, decoded and executed.

They are validated as a scenario's lines are; an invalid one is reported and counted, and changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np

from liftgate_hil.codec.frames import FD_FLAGS
from liftgate_hil.codec.sending import padded_length
from liftgate_hil.config.fault_kinds import DRIVE, FAULT_KINDS, MESSAGE
from liftgate_hil.config.inject import BABBLING, FAULT, NOTHING, REQUEST, OrderMessage
from liftgate_hil.config.kinds import Level, Number
from liftgate_hil.config.restbus import value_in
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario_tables import Fault, fault_of
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.operate.buttons import ButtonPresser
from liftgate_hil.operate.loop_target import Target
from liftgate_hil.signals import DIRECTIONS
from liftgate_hil.stimuli.moments import Instant

_MOST_LISTED = 1000  # orders of a run that are reported; more are executed, or refused and counted


class Orders:
    """Observer that reads the orders of a rig's test bench from frames, and has a target execute them."""

    def __init__(self, rig: Rig, target: Target, say: Callable[[str], None] = lambda text: None) -> None:
        self._rig, self._target, self._say = rig, target, say
        self._known: dict[int, list[OrderMessage]] = {}
        for each in rig.orders:
            self._known.setdefault(each.identifier, []).append(each)
        self._faults: dict[Which, Fault] = {}
        self._buttons = ButtonPresser(rig, target)
        self.count = 0  # orders executed
        self.done: list[str] = []  # the first of these, in words, with their times
        self.kinds: set[str] = set()  # of faults that were injected
        self.refused = 0

    @property
    def next_release(self) -> float:
        """Time [s] of the next release of a button; inf: no button is pressed."""
        return self._buttons.next_release

    def is_one(self, identifier: int) -> bool:
        """Whether a frame with this identifier may be an order."""
        return identifier & ~FD_FLAGS in self._known

    def look(self, frames: Any, now: float) -> None:
        """Execute the orders in frames, and release the buttons that are due at a time [s]."""
        if len(frames):
            identifiers, is_one = frames["identifier"] & ~FD_FLAGS, np.zeros(len(frames), dtype=bool)
            for identifier in self._known:
                is_one |= identifiers == identifier
            for row in frames[is_one & (frames["is_sent"] == 0)] if is_one.any() else ():
                self._read(row, now)
        self._buttons.release(now)

    def _read(self, row: Any, now: float) -> None:
        """Execute the orders of one frame, and report each, executed or refused."""
        own = self._known[int(row["identifier"]) & ~FD_FLAGS]
        name, time = own[0].message, row["time_ns"] * 1e-9
        try:
            values = decoded(self._rig, name, row["payload"][: row["length"]].tobytes())
            orders = [each for each in own if set(each.signals.values()) <= set(values)]
            if not orders:
                allowed = " | ".join(each.what for each in own)
                raise ConfigError(f"{', '.join(values)}: not all signals of an order; allowed: {allowed}")
        except ConfigError as error:
            self._refuse(name, time, error)
            return
        for each in orders:
            content = {key: values[signal] for key, signal in each.signals.items()}
            try:
                done = self._order(each, content, now)
            except ConfigError as error:
                self._refuse(name, time, error)
                continue
            if done:
                self.count += 1
                if self.count <= _MOST_LISTED:
                    self.done.append(f"{time:.3f} s: {done}")
                self._tell(self.count, f"{time:.3f} s: {name}: {done}")

    def _refuse(self, name: str, time: float, error: ConfigError) -> None:
        """Count an order from the message `name` as refused, and report why."""
        self.refused += 1
        why = "; ".join(
            each.removeprefix(": ").removeprefix("`fault`.").removeprefix("`fault`: ") for each in error.issues
        )
        self._tell(self.refused, f"{time:.3f} s: {name} refused: {why}")

    def _tell(self, number: int, content: str) -> None:
        """Report one of the first executed or refused orders; `number` is its ordinal among these."""
        if number <= _MOST_LISTED:
            last = "; further ones are only counted" if number == _MOST_LISTED else ""
            self._say(content + last)

    def _order(self, order: OrderMessage, content: Mapping[str, Decoded], now: float) -> str:
        """Execute an order, and return it as text; "": it is in force already. Raises ConfigError."""
        what = order.what
        if what == REQUEST:
            action = content["action"].label
            if action == NOTHING:
                return ""
            self._buttons.request(action, now)
            return f"request {action}"
        if what in (FAULT, BABBLING):
            return self._order_fault(what, content, now)
        name, value = content["name"].label, content["value"].number
        if name not in order.labels:
            raise ConfigError(f"signal {name}; allowed: {', '.join(order.labels)}")
        issues = ConfigIssues("")
        number = value_in("", name, value, self._rig.tables, self._rig.mapped, issues)
        issues.raise_if_any()
        assert number is not None
        self._target.set_signals({name: number})
        self._buttons.forget(name)
        return f"{name} = {_short(value)}"

    def _order_fault(self, what: str, content: Mapping[str, Decoded], now: float) -> str:
        """Begin, change or end faults; return that as text; "": all is as ordered already. Raises ConfigError."""
        is_on = content["on"].number != 0.0
        if what == FAULT and content["kind"].label == NOTHING:
            if is_on:
                return ""
            self._target.inject(())
            self._faults.clear()
            return "all faults end"
        which = which_ordered(self._rig, what, content)
        label = " ".join([each for each in which[:2] if each != NOTHING])
        others = {key: each for key, each in self._faults.items() if key != which}
        if not is_on:
            if which not in self._faults:
                raise ConfigError(f"{label} is not active; allowed: to end an injected fault")
            self._target.inject(tuple(others.values()))
            self._faults = others
            return f"{label} ends"
        fault = replace(fault_ordered(which, what, content), start=Instant(now))
        before = self._faults.get(which)
        if before is not None and before.values == fault.values:
            return ""
        self._target.inject((*others.values(), fault))
        self._faults = {**others, which: fault}
        self.kinds.add(fault.kind)
        own = [key for key in ("state", "rate") if key in fault.values]
        with_value = [f"{key} {_short(fault.values[key])}" for key in own]
        taken = value_key(fault.kind)
        if taken is not None and what == FAULT:
            with_value = [f"{taken} {_short(content['value'].number)}"]
        return ", ".join([f"{label} begins", *with_value, *([which[2]] if which[2] else [])])


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


_WAYS = ("sent", "received")


class Decoded(NamedTuple):
    """Decoded value of a signal, with its label."""

    number: float
    label: str  # of the database, else the number as a text


_NOT_GIVEN = Decoded(math.nan, NOTHING)

# Which fault: its kind, place and direction. An order for the same one again gives it another value.
Which = tuple[str, str, str]


def decoded(rig: Rig, name: str, payload: bytes) -> dict[str, Decoded]:
    """Decode a message's payload; return its signals by name. Raises ConfigError where it does not fit."""
    import cantools

    message = rig.messages[name]
    if len(payload) not in (message.length, padded_length(message)):
        raise ConfigError(f"{len(payload)} bytes; allowed: {message.length}")
    try:
        own = payload[: message.length]
        numbers = cast("dict[str, float]", message.decode(own, decode_choices=False))
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
    """Return the identity of the fault in a test bench's frame: kind, place and direction. Raises ConfigError.

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
    """Return the key of a fault kind that the signal `value` of a frame sets; None: the kind has no such key."""
    own = FAULT_KINDS[kind].keys
    return next((key.name for key in own if isinstance(key.kind, Number | Level)), None)


def _way_of(rig: Rig, place: str) -> str:
    """Return "sent" or "received", a message's direction for the gate. Raises ConfigError if none is named."""
    if place == NOTHING:
        raise ConfigError("direction none; allowed: sent or received, where no message is named")
    return "received" if place in {each.message for each in rig.inputs} else "sent"
