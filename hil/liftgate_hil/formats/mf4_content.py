"""Content of an MF4 file: groups of frames, channels over time, marks and provenance."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

from liftgate_hil.formats.account import Account
from liftgate_hil.formats.mcap_layout import ABOUT
from liftgate_hil.formats.mf4_frames import KINDS
from liftgate_hil.formats.mf4_reader import why_not_read
from liftgate_hil.formats.mf4_values import values_of

# How the names of other buses' frames begin (ASAM MDF bus logging).
_OTHER_BUSES = ("LIN", "FLX", "MOST", "ETH", "USB", "K_LINE")
_SECONDS = ("", "s", "sec", "S", "seconds")  # unit of times: ASAM MDF has seconds
_TIMES = (0, 1)  # sync_type of a group's master: none stated, or time


def other_buses_in(measured: Any) -> Iterator[str]:
    """Yield a note for each kind of frames of another bus."""
    for content in measured.groups:
        kind = next((each.name for each in content.channels if _is_of_other_bus(each.name)), "")
        if kind and content.channel_group.cycles_nr:
            yield f"{content.channel_group.cycles_nr} records left out ({kind}: another bus)"


def _is_of_other_bus(name: str) -> bool:
    return (
        "." not in name
        and name.startswith(tuple(f"{bus}_" for bus in _OTHER_BUSES))
        and (name.endswith(("_Frame", "Error", "_DataFrame")) or name.startswith("ETH_Frame"))
    )


def columns_in(measured: Any, notes: list[str]) -> dict[str, tuple[int, int]]:
    """Return the channels over time, by name: group, and place in it.

    Channels of the same name in several groups with samples are called GROUP.NAME.
    """
    found: dict[str, list[tuple[int, int]]] = {}
    for group, content in enumerate(measured.groups):
        master = measured.masters_db.get(group)
        if any(each.name in KINDS or _is_of_other_bus(each.name) for each in content.channels):
            continue
        if master is not None and content.channels[master].sync_type not in _TIMES:
            notes.append(f"{_called(content, group)} left out: its channels are not over time")
            continue
        if master is not None and (unit := content.channels[master].unit or "") not in _SECONDS:
            notes.append(f"{_called(content, group)} left out: its times are in {unit!r}; allowed: s")
            continue
        for place, channel in enumerate(content.channels):
            if place != master:
                found.setdefault(channel.name, []).append((group, place))
    columns: dict[str, tuple[int, int]] = {}
    shared: list[tuple[str, tuple[int, int]]] = []
    for name, everywhere in found.items():
        sampled = [each for each in everywhere if measured.groups[each[0]].channel_group.cycles_nr]
        places = sampled or everywhere[:1]
        if len(places) == 1:
            columns[name] = places[0]
            continue
        called = [_called(measured.groups[group], group) for group, _ in places]
        is_unique = len({*called}) == len({group for group, _ in places})
        for group_name, (group, place) in zip(called, places, strict=True):
            shared.append((f"{group_name if is_unique else f'group {group}'}.{name}", (group, place)))
    for name, where in shared:  # of one group, or beside a channel that is called like that
        names = (name if number == 1 else f"{name} #{number}" for number in itertools.count(1))
        columns[next(each for each in names if each not in columns)] = where
    return columns


def _called(content: Any, group: int) -> str:
    """Return what a group is called: as the file says, else by its number."""
    return str(content.channel_group.acq_name or "").strip() or f"group {group}"


def not_read(measured: Any, group: int, place: int) -> str:
    """Return why a channel of another program is no column, as far as its first sample tells; "": it is one."""
    try:
        first = measured.select([(None, group, place)], record_count=1, raw=True)[0]
        return "" if values_of(first, Account()) is not None else "not numeric"
    except Exception as error:  # asammdf raises what its parsers raise
        return f"cannot be read: {why_not_read(error)}"


def marks_in(measured: Any) -> list[tuple[float, str]]:
    """Return the marker events at a point in time."""
    from asammdf.blocks.v4_constants import EVENT_SYNC_TYPE_S, EVENT_TYPE_MARKER

    return [
        (float(each.value), str(each.name))
        for each in getattr(measured, "events", ())
        if (each.event_type, each.sync_type) == (EVENT_TYPE_MARKER, EVENT_SYNC_TYPE_S)
    ]


def about_in(measured: Any) -> str:
    """Return the provenance that is attached to a recording; "": none."""
    for place, each in enumerate(measured.attachments):
        if each.file_name == ABOUT:
            return bytes(measured.extract_attachment(index=place)[0]).decode(errors="replace")
    return ""
