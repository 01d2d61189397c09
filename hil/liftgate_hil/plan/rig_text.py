"""Text of a rig check: tables of the mapped messages, and what else the rig maps."""

from __future__ import annotations

from collections.abc import Sequence

from liftgate_hil.codec.frames import EXTENDED
from liftgate_hil.codec.sending import SendType
from liftgate_hil.config.rig_table import MappedMessage, MappedSignal
from liftgate_hil.diagnostics.tester import Diagnostics
from liftgate_hil.plan.rig_check import RigReport

_MOST_UNMAPPED = 12  # signals of a message without a quantity that are named


def rig_lines(found: RigReport) -> list[str]:
    """Return what a rig maps, and the notes on it, as lines of text."""
    return [
        *_message_lines(found.messages),
        *(f"restbus {name}; protection: {how}" for name, how in found.restbus_protection.items()),
        *_diagnostics_lines(found.diagnostics),
        *(f"request {action} on a bus: {how}" for action, how in found.requests.items()),
        *(f"inject {what} by {how}" for what, how in found.inject.items()),
        *(f"note: {note}" for note in found.notes),
    ]


def _message_lines(messages: Sequence[MappedMessage]) -> list[str]:
    """Return the table of mapped messages: one line per message, and below it one line per quantity."""
    lines = []
    for each in messages:
        cycle = f", every {each.cycle_ms:g} ms" if each.cycle_ms else ""
        cycle += f", {each.send_type}" if each.send_type != SendType.CYCLIC.value else ""
        cycle += f", {each.pages} multiplexer values in turn" if each.pages > 1 else ""
        stale = f", stale after {each.timeout_ms:g} ms" if each.timeout_ms else ""
        digits, form = 8 if each.is_extended else 3, f", {each.format}" if each.format != "classic" else ""
        called = f"{each.direction} {each.message} 0x{each.identifier:0{digits}X}"
        lines.append(f"{called}, {each.length} bytes{form}{cycle}{stale}; protection: {each.protection}")
        rows = [_cells(signal) for signal in each.signals]
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
        lines += ["    " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        if each.unmapped:
            shown = [f"{name} = {value}" if value else name for name, value in each.unmapped.items()]
            how = "not read" if each.direction == "received" else "sent as"
            more = f" and {len(shown) - _MOST_UNMAPPED} more" if len(shown) > _MOST_UNMAPPED else ""
            lines.append(f"    not mapped, {how}: {', '.join(shown[:_MOST_UNMAPPED])}{more}")
    return lines


def _diagnostics_lines(own: Diagnostics | None) -> list[str]:
    """Return a list with the line on how the ECU's trouble codes are read; empty without [diagnostics]."""
    if own is None:
        return []
    request, response = (
        f"{name} 0x{number & ~EXTENDED:0{8 if number & EXTENDED else 3}X}".lstrip()
        for name, number in zip(own.names, (own.request, own.response), strict=True)
    )
    cleared = "cleared at time 0, " if own.clears else ""
    return [
        f"diagnostics: request {request}, response {response}; {cleared}read every {1e3 * own.period:g} ms by the "
        f"status mask 0x{own.status_mask:02X}"
    ]


def _cells(signal: MappedSignal) -> tuple[str, ...]:
    step = f" in steps of {signal.step:.4g}" if signal.step else ""
    is_same = signal.database_unit == signal.unit
    units = f"[{signal.database_unit}]{'' if is_same else f' -> [{signal.unit}]'}"
    return (
        signal.quantity,
        signal.signal,
        units,
        f"{signal.low:.6g} to {signal.high:.6g}{' ' + signal.unit if signal.unit else ''}{step}",
        signal.conversion,
    )
