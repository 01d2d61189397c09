"""Content of a database's text: its messages, those that are left out for a fault, and notes on both."""

from __future__ import annotations

import contextlib
import functools
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from liftgate_hil.codec.messages import Messages
from liftgate_hil.config.database_parts import Remains, load_text, reason_of, too_large
from liftgate_hil.config.database_remains import as_sym_6, kcd_remains, sym_remains
from liftgate_hil.config.dbc_remains import dbc_remains
from liftgate_hil.config.signal_name import listed
from liftgate_hil.config.toml import show
from liftgate_hil.errors import MOST, ConfigError

if TYPE_CHECKING:
    from cantools.database.can import Message

_REMAINS: Mapping[str, Callable[[str], Remains]] = {
    ".dbc": dbc_remains, ".kcd": kcd_remains, ".sym": sym_remains,
}  # fmt: skip


@functools.lru_cache(maxsize=4)
def content_of(written: str, kind: str) -> Mapping[str, Messages]:
    """Return the messages in a database's text by the names of its buses; "": it has no name.

    `kind` is the file's suffix. Kept, as cantools takes 10 ms and more each time, and one process runs many
    scenarios with the same database: messages are read, and never changed. Raises ConfigError if nothing can be
    read.
    """
    if kind == ".sym":
        written = as_sym_6(written)
    wrong = too_large(written, kind)
    if wrong and kind not in _REMAINS:
        raise ConfigError(wrong)
    try:
        remains = _remains(written, kind, is_plain=not wrong)
    except ConfigError:
        raise
    except Exception as error:  # cantools passes on exceptions of any kind from its parsers
        raise ConfigError(_why_nothing(error, written)) from error
    buses = {each.bus_name or "" for each in remains.messages} or {""}
    return {
        bus: _sorted_out([each for each in remains.messages if (each.bus_name or "") == bus], remains)
        for bus in sorted(buses)
    }


def _remains(written: str, kind: str, is_plain: bool) -> Remains:
    """Return the messages whose signals neither overlap nor go beyond it; `is_plain`: the whole may be tried."""
    if is_plain:
        with contextlib.suppress(Exception):
            return Remains(load_text(written, kind, is_strict=True))
    remains = _loose_remains(written, kind, is_plain)
    for each in remains.messages:
        try:
            each.refresh(strict=True)
        except Exception as error:
            remains.leave_out(each.name, reason_of(error))
    return remains


def _loose_remains(written: str, kind: str, is_plain: bool) -> Remains:
    if is_plain:
        try:
            return Remains(load_text(written, kind))
        except Exception:
            if kind not in _REMAINS:
                raise
    return _REMAINS[kind](written)


def _why_nothing(error: Exception, written: str) -> str:
    """Return why a file cannot be read at all."""
    if isinstance(error, ElementTree.ParseError):
        line, column = error.position
        return f"no XML from line {line}, column {column + 1} on"
    offset = getattr(error, "offset", None)  # in the text, of a grammar's error
    if isinstance(offset, int):
        return f"not understood from line {written.count(chr(10), 0, offset) + 1} on"
    return reason_of(error)


def _sorted_out(messages: Sequence[Message], remains: Remains) -> Messages:
    """Return the messages without faults, and reasons and notes on the others."""
    left_out = {**remains.left_out, **_named_twice(messages)}
    for each in messages:
        if each.name not in left_out and (why := _fault_of(each)):
            left_out[each.name] = why
    kept = [each for each in messages if each.name not in left_out]
    notes = [f"{name} is left out: {why}" for name, why in left_out.items()]
    notes += [f"{each}: left out" for each in remains.notes]
    if taken := [each.name for each in kept if each.name in remains.unmarked]:
        notes.append(f"identifiers of more than 11 bits, not marked as of 29, are taken as such: {listed(taken)}")
    more = [f"and {len(notes) - MOST} more faults"] if len(notes) > MOST else []
    return Messages(kept, left_out, [*notes[:MOST], *more])


def _fault_of(message: Message) -> str:
    """Return what is wrong with a message that cantools reads; "": nothing."""
    names = [each.name for each in message.signals]
    if len(set(names)) < len(names):
        return f"it has several signals {next(name for name in names if names.count(name) > 1)}"
    before = next((each for each in message.signals if each.start < 0), None)
    if before is not None:
        return f"{before.name} begins at bit {before.start}"
    return next(_too_large_numbers(message), "")


def _too_large_numbers(message: Message) -> Iterator[str]:
    """Yield the factors, offsets, limits and label values that are too large for a float.

    In a database they may have any number of digits; a float holds 308.
    """
    for signal in message.signals:
        for what, value in (
            ("factor", signal.scale),
            ("offset", signal.offset),
            ("minimum", signal.minimum),
            ("maximum", signal.maximum),
            *(("a label of", raw) for raw in signal.choices or ()),
        ):
            # An infinite minimum or maximum means no limit.
            is_limit = what.endswith("imum") and isinstance(value, float) and not math.isnan(value)
            if value is not None and not is_limit and not abs(value) <= sys.float_info.max:
                yield f"{signal.name}: {what} {show(value)}; allowed: up to 1.8e+308"


def _named_twice(messages: Sequence[Message]) -> dict[str, str]:
    """Return the messages that are not told apart, by their names or their identifiers, and why."""
    named: dict[str, list[str]] = {}
    identified: dict[str, list[str]] = {}
    for each in messages:
        identifier = f"0x{each.frame_id:0{8 if each.is_extended_frame else 3}X}"
        named.setdefault(each.name, []).append(identifier)
        identified.setdefault(identifier, []).append(each.name)
    found = {}
    for name, identifiers in named.items():
        others = {each for identifier in identifiers for each in identified[identifier]} - {name}
        if len(identifiers) > 1:
            found[name] = f"it is defined several times, as {', '.join(identifiers)}"
        elif others:
            found[name] = f"{', '.join(sorted(others))} has its identifier {identifiers[0]}, too"
    return found
