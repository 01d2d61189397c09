"""Restbus signals set by files and programs: `Message.Signal` with a value or a label."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from liftgate_hil.codec.bus_config import MAX_PAGES, pages_of, physical_range
from liftgate_hil.codec.frames import MAX_BYTES
from liftgate_hil.codec.protection import MessageOptions, signals_made
from liftgate_hil.codec.sending import LONGEST_MS, cycle_of, needs_fd
from liftgate_hil.config.signal_name import find_signal, listed, listed_signals
from liftgate_hil.config.toml import is_number, show
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.stimuli.moments import Instant, moved
from liftgate_hil.stimuli.restbus import BusTables, SignalChange

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can import Signal as DatabaseSignal


@dataclass(frozen=True)
class SignalValue:
    """A signal's value that applies from an instant on, in the database's unit or as a label."""

    when: Instant
    signal: str
    value: float | str
    source: str = ""  # the file
    key: str = ""  # in the file, e.g. signal[0]
    # How issues name the value if it does not come from the file; "": by `key`.
    value_key: str = field(default="", compare=False)


@dataclass(frozen=True)
class Press:
    """Signal of a button: `value` for `hold` [s] while it is pressed, else `rest` [the database's unit]."""

    signal: str
    value: float
    rest: float
    hold: float


def changes_in(
    values: Sequence[SignalValue], tables: BusTables, taken: Sequence[str], issues: ConfigIssues
) -> list[SignalChange]:
    """Return the changes of restbus signals; issues are noted. `taken`: messages that gate or ECU send."""
    found = []
    for each in values:
        value_key = f"{each.key}.value"
        own = ConfigIssues(each.source, {value_key: each.value_key} if each.value_key else {})
        number = value_in(f"{each.key}.", each.signal, each.value, tables, taken, own)
        issues.take(own.lines)
        if number is not None:
            found.append(SignalChange(each.when, each.signal, number))
    return found


def pressed(press: Press, when: Instant) -> list[SignalChange]:
    """Return the two signal changes, press and release, of a button that is pressed at an instant."""
    if when.condition:
        end = moved(when, when.delay + press.hold)
    else:
        end = Instant(when.time + press.hold)
    return [
        SignalChange(when, press.signal, press.value),
        SignalChange(end, press.signal, press.rest, pressed=press.value),
    ]


def value_in(
    key: str, name: str, value: object, tables: BusTables, taken: Sequence[str], issues: ConfigIssues
) -> float | None:
    """Return a signal's value, given as number or label, in the database's unit; None and an issue if invalid.

    `key` is the prefix of the keys signal and value in issues.
    """
    signal = check_signal(f"{key}signal", name, tables, taken, issues)
    if signal is None:
        return None
    labels = {str(label): float(raw) for raw, label in (signal.choices or {}).items()}
    low, high = physical_range(signal)
    if isinstance(value, str) and value in labels:
        return float(signal.scale) * labels[value] + float(signal.offset)
    if not is_number(value) or not low <= float(str(value)) <= high:
        words = f", or one of {listed(list(labels))}" if labels else ""
        unit = f" {signal.unit}" if signal.unit else ""
        issues.add(f"{key}value", f"{show(value)}; allowed: {low:g} to {high:g}{unit}{words}")
        return None
    return float(str(value))


def sendable(tables: BusTables, taken: Sequence[str], is_fd: bool) -> tuple[str, ...]:
    """Return all signals (`Message.Signal`) that the bench may send on a bus; `is_fd`: also in CAN FD frames.

    `taken` are the messages that gate or ECU send. Messages with more than MAX_PAGES pages are left out.
    """
    found = []
    for message in tables.messages.values():
        options = tables.options.get(message.name, MessageOptions())
        made = signals_made(message, options)
        own = [
            signal.name
            for signal in message.signals
            if signal.name not in made and not _why_not(message, message.name in taken, options, signal)
        ]
        fits = len(pages_of(message, own)) <= MAX_PAGES and (is_fd or not needs_fd(message))
        found += [f"{message.name}.{name}" for name in own if fits]
    return tuple(found)


def check_signal(
    key: str, name: str, tables: BusTables, taken: Sequence[str], issues: ConfigIssues
) -> DatabaseSignal | None:
    """Return the database's signal with this name if the bench may send it; else None and an issue."""
    message = tables.messages.get(name.partition(".")[0])
    made = set() if message is None else signals_made(message, tables.options.get(message.name))
    free = [each for each in tables.messages if each not in taken]
    signal = find_signal(issues, key, name, tables.messages, free, made)
    if signal is None or message is None:
        return None
    if signal.name in made:
        wrong = f"its protection or multiplexer sets it; allowed: {listed_signals(message, made)}"
    else:
        options = tables.options.get(message.name, MessageOptions())
        wrong = _why_not(message, message.name in taken, options, signal)
    if wrong:
        issues.add(key, f"{show(name)}: {wrong}")
        return None
    return signal


def _why_not(message: Message, is_taken: bool, options: MessageOptions, signal: DatabaseSignal) -> str:
    """Return as text why the restbus cannot send this signal or its message; "" if it can."""
    if is_taken:
        return "the gate or the ECU sends it; allowed: a message of another control unit"
    if message.length > MAX_BYTES:
        return f"{message.length} bytes; allowed: a message of one frame, up to {MAX_BYTES}"
    if (signal.is_float and signal.length not in (32, 64)) or signal.length > 64 or float(signal.scale) == 0.0:
        return "cannot carry a number; allowed: a factor other than 0, up to 64 bits, floats of 32 or 64"
    if not 0.0 < cycle_of(message, options) <= LONGEST_MS:
        return (
            f"has no cycle of up to {LONGEST_MS:g} ms; allowed: a cyclic message with GenMsgCycleTime in the "
            f"database, or messages.{message.name}.cycle_ms in the rig"
        )
    return ""
