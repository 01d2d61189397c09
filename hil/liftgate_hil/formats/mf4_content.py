"""Content of an MF4 file: channels as numbers, frames of ASAM MDF bus logging, marks and provenance."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import BRS, ERROR, ESI, EXTENDED, FD, LENGTHS, LOGGED, MAX_BYTES, REMOTE
from liftgate_hil.formats.account import Account
from liftgate_hil.formats.mcap_layout import ABOUT
from liftgate_hil.formats.mf4_reader import why_not_read
from liftgate_hil.formats.recording import FRAME

NOT_NUMERIC = "not numeric; allowed: one number per sample"
NO_NUMBERS = "no numbers, only value texts or invalid samples; allowed: one number per sample"


class ChannelValues(NamedTuple):
    """Samples of a channel, with a mask of those that are numbers."""

    values: NDArray[np.float64]  # (n,), in the channel's unit
    there: NDArray[np.bool_]  # (n,), false: invalid by the file's own word, or a text

    @property
    def numbers(self) -> NDArray[np.float64]:
        """Samples (n,) with NaN for those that are no numbers."""
        return self.values if self.there.all() else np.where(self.there, self.values, np.nan)


def values_of(signal: Any, account: Account) -> ChannelValues | None:
    """Return the numbers of a channel that asammdf has read raw, with their mask; None if it is not numeric.

    The account counts integers that no float holds.

    A conversion is applied. A sample converted to text (`Init` of a scaled angle) is no number, except of a state,
    whose raw numbers stand for the texts.
    """
    samples, conversion = np.asarray(signal.samples), signal.conversion
    there = np.ones(len(samples), dtype=bool)
    if samples.ndim != 1 or samples.dtype.names:
        return None
    if conversion is not None and not is_state(conversion, signal.unit):
        converted = np.asarray(conversion.convert(samples, as_object=True))
        if converted.ndim == 1 and converted.dtype.kind in "SUO":
            listed = converted.tolist()
            there = np.array([not isinstance(each, bytes | str) for each in listed], dtype=bool)
            if samples.dtype.kind not in "fiub" and not there.any():
                return None
            converted = np.array([0.0 if isinstance(each, bytes | str) else float(each) for each in listed])
        samples = converted
    if samples.ndim != 1 or samples.dtype.kind not in "fiub":
        return None
    if signal.invalidation_bits is not None:
        there &= ~np.asarray(signal.invalidation_bits, dtype=bool)
    return ChannelValues(account.floats_of(signal.name, samples), there)


def is_state(conversion: Any, unit: str) -> bool:
    """Whether a value-to-text conversion names all states of a channel (lowest raw value <= 1), not single values.

    A state has no unit, and no other number is converted.
    """
    from asammdf.blocks import v4_constants as constants

    kinds = {constants.CONVERSION_TYPE_TABX: "val_{}", constants.CONVERSION_TYPE_RTABX: "lower_{}"}
    if unit or conversion.conversion_type not in kinds:
        return False
    blocks = conversion.referenced_blocks or {}
    default = blocks.get("default_addr")
    if not (default is None or isinstance(default, bytes) or _is_identity(default)):
        return False
    count = sum(name.startswith("text_") for name in blocks)
    texts = [blocks[f"text_{place}"] for place in range(count)]
    raw = [conversion[kinds[conversion.conversion_type].format(place)] for place in range(count)]
    return bool(raw) and min(raw) <= 1 and all(isinstance(text, bytes) for text in texts)


def _is_identity(conversion: Any) -> bool:
    """Whether a conversion leaves numbers unchanged."""
    from asammdf.blocks import v4_constants as constants

    kind = conversion.conversion_type
    is_linear = kind == constants.CONVERSION_TYPE_LIN and (conversion.a, conversion.b) == (1, 0)
    return kind == constants.CONVERSION_TYPE_NON or is_linear


# Fields of a frame in bus logging, and those of a remote frame.
_FIELDS = {
    "BusChannel": "u1", "ID": "<u4", "IDE": "u1", "DLC": "u1", "DataLength": "u1",
    "DataBytes": f"({MAX_BYTES},)u1", "Dir": "u1", "EDL": "u1", "BRS": "u1", "ESI": "u1",
}  # fmt: skip
_OF_REMOTE = ("BusChannel", "ID", "IDE", "DLC", "DataLength", "Dir")
KINDS = {FRAME: 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE}


def samples_of(name: str, frames: Any, channel: int) -> NDArray[Any]:
    """Return frames (n,) LOGGED of the kind `name` as ASAM bus logging's samples; `channel`: bus number."""
    fields = _OF_REMOTE if name == "CAN_RemoteFrame" else tuple(_FIELDS)
    samples = np.zeros(len(frames), dtype=[(f"{name}.{field}", _FIELDS[field]) for field in fields])
    identifiers = frames["identifier"]
    given = {
        "BusChannel": channel,
        "ID": identifiers & 0x1FFFFFFF,
        "IDE": identifiers & EXTENDED != 0,
        "DLC": np.searchsorted(LENGTHS, frames["length"]),
        "DataLength": frames["length"],
        "DataBytes": frames["payload"],
        "Dir": frames["is_sent"],
        "EDL": identifiers & FD != 0,
        "BRS": identifiers & BRS != 0,
        "ESI": identifiers & ESI != 0,
    }
    for field, values in given.items():
        if field in fields:
            samples[f"{name}.{field}"] = values
    if name == "CAN_RemoteFrame":
        samples[f"{name}.DataLength"] = 0
    return samples


class FrameGroup(NamedTuple):
    """Channel group of an MF4 file that holds frames of one kind."""

    kind: str
    number: int  # of the group
    whole: int  # place of the channel that holds whole frames, as the file stores them
    converted: Mapping[str, int]  # places of their fields with a conversion, such as the constants of a group

    @property
    def asked(self) -> list[tuple[None, int, int]]:
        """The channels to read, as (None, group, place), whose signals `fields_of` expects."""
        return [(None, self.number, place) for place in (self.whole, *self.converted.values())]

    def fields_of(self, signals: Sequence[Any]) -> dict[str, Any]:
        """Return the fields of frames by name, with conversions applied, as far as the file has them."""
        samples = signals[0].samples
        fields = {name.removeprefix(f"{self.kind}."): samples[name] for name in samples.dtype.names or ()}
        for name, signal in zip(self.converted, signals[1:], strict=True):
            if (found := values_of(signal, Account())) is not None:
                fields[name] = found.values.astype(np.int64)
        return fields


def frame_groups_in(measured: Any) -> Iterator[FrameGroup]:
    """Yield the channel groups of a file that hold frames."""
    for number, content in enumerate(measured.groups):
        names = [each.name for each in content.channels]
        kind = next((name for name in names if name in KINDS), "")
        if kind and content.channel_group.cycles_nr:
            converted = {
                name: place
                for name in _FIELDS
                if name != "DataBytes"
                for place, channel in enumerate(content.channels)
                if channel.name == f"{kind}.{name}" and channel.conversion is not None
            }
            yield FrameGroup(kind, number, names.index(kind), converted)


def logged(fields: Mapping[str, Any], kind: str, times: Any) -> NDArray[np.void]:
    """Return the fields of frames of one kind as rows (n,) LOGGED."""
    mark = KINDS[kind]
    rows = np.zeros(len(times), dtype=LOGGED)
    rows["time_ns"] = np.round(np.asarray(times) * 1e9).astype(np.int64)
    identifiers = np.asarray(fields.get("ID", np.zeros(len(times)))).astype(np.int64)
    extended = (np.asarray(fields.get("IDE", 0)) != 0) | (identifiers & EXTENDED != 0)
    rows["identifier"] = (identifiers & 0x1FFFFFFF) | extended * EXTENDED | mark
    is_fd = np.asarray(fields.get("EDL", 0)) != 0
    rows["identifier"] |= is_fd * FD
    for name, flag in (("BRS", BRS), ("ESI", ESI)):
        rows["identifier"] |= (is_fd & (np.asarray(fields.get(name, 0)) != 0)) * flag
    of_code = np.array(LENGTHS)[np.minimum(np.asarray(fields.get("DLC", 0)).astype(int), 15)]
    rows["length"] = of_code if mark == REMOTE else fields.get("DataLength", of_code)
    rows["is_sent"] = np.asarray(fields.get("Dir", 0)) != 0
    content = fields.get("DataBytes")
    if content is not None and mark != REMOTE:
        width = min(content.shape[1], MAX_BYTES)
        rows["payload"][:, :width] = content[:, :width]
        rows["payload"][np.arange(MAX_BYTES) >= rows["length"][:, np.newaxis]] = 0
    return rows


def merged(parts: Sequence[Iterator[NDArray[np.void]]]) -> Iterator[NDArray[np.void]]:
    """Merge the frames of several groups into order of time; each group is in order already."""
    heads = {place: next(part, None) for place, part in enumerate(parts)}
    while waiting := {place: head for place, head in heads.items() if head is not None}:
        bound = min(int(head["time_ns"].max()) for head in waiting.values())
        ready = []
        for place, head in waiting.items():
            is_due = head["time_ns"] <= bound
            ready.append(head[is_due])
            heads[place] = head[~is_due] if not is_due.all() else next(parts[place], None)
        block = np.concatenate(ready)
        yield block[np.argsort(block["time_ns"], kind="stable")]


# How the names of other buses' frames begin (ASAM MDF bus logging).
_OTHER_BUSES = ("LIN", "FLX", "MOST", "ETH", "USB", "K_LINE")
_SECONDS = ("", "s", "sec", "S", "seconds")  # unit of times: ASAM MDF has seconds
_TIMES = (0, 1)  # sync_type of a group's master: none stated, or time


def other_buses_in(measured: Any) -> Iterator[str]:
    """Yield a note for each kind of frames of a bus other than CAN."""
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
    """Return group and channel index of each channel over time, by name; append groups left out to `notes`.

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
    """Return a channel group's name for notes: as the file states it, else by number."""
    return str(content.channel_group.acq_name or "").strip() or f"group {group}"


def not_read(measured: Any, group: int, place: int) -> str:
    """Return as text why a channel cannot be read as a column, as far as its first sample tells; "": it can."""
    try:
        first = measured.select([(None, group, place)], record_count=1, raw=True)[0]
        return "" if values_of(first, Account()) is not None else "not numeric"
    except Exception as error:  # asammdf raises what its parsers raise
        return f"cannot be read: {why_not_read(error)}"


def marks_in(measured: Any) -> list[tuple[float, str]]:
    """Return the file's marker events at a point in time: time [s] and text."""
    from asammdf.blocks.v4_constants import EVENT_SYNC_TYPE_S, EVENT_TYPE_MARKER

    return [
        (float(each.value), str(each.name))
        for each in getattr(measured, "events", ())
        if (each.event_type, each.sync_type) == (EVENT_TYPE_MARKER, EVENT_SYNC_TYPE_S)
    ]


def about_in(measured: Any) -> str:
    """Return the provenance attached to a recording, as JSON; "": none."""
    for place, each in enumerate(measured.attachments):
        if each.file_name == ABOUT:
            return bytes(measured.extract_attachment(index=place)[0]).decode(errors="replace")
    return ""
