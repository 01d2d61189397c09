"""Frames as in ASAM MDF bus logging, and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import BRS, ERROR, ESI, EXTENDED, FD, LENGTHS, LOGGED, MAX_BYTES, REMOTE
from liftgate_hil.formats.account import Account
from liftgate_hil.formats.mf4_values import values_of
from liftgate_hil.formats.recording import FRAME

# Fields of a frame in bus logging, and those of a remote frame.
_FIELDS = {
    "BusChannel": "u1", "ID": "<u4", "IDE": "u1", "DLC": "u1", "DataLength": "u1",
    "DataBytes": f"({MAX_BYTES},)u1", "Dir": "u1", "EDL": "u1", "BRS": "u1", "ESI": "u1",
}  # fmt: skip
_OF_REMOTE = ("BusChannel", "ID", "IDE", "DLC", "DataLength", "Dir")
KINDS = {FRAME: 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE}


def samples_of(name: str, frames: Any, channel: int) -> NDArray[Any]:
    """Return frames (n,) LOGGED as samples with the fields of bus logging."""
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
    """Group of an MF4 file with frames of one kind."""

    kind: str
    number: int  # of the group
    whole: int  # place of the channel that holds whole frames, as the file stores them
    converted: Mapping[str, int]  # places of their fields with a conversion, such as the constants of a group

    @property
    def asked(self) -> list[tuple[None, int, int]]:
        """The channels of which `fields_of` takes the signals."""
        return [(None, self.number, place) for place in (self.whole, *self.converted.values())]

    def fields_of(self, signals: Sequence[Any]) -> dict[str, Any]:
        """Return the fields of frames by their names, conversions applied, as far as the file has them."""
        samples = signals[0].samples
        fields = {name.removeprefix(f"{self.kind}."): samples[name] for name in samples.dtype.names or ()}
        for name, signal in zip(self.converted, signals[1:], strict=True):
            if (found := values_of(signal, Account())) is not None:
                fields[name] = found.values.astype(np.int64)
        return fields


def frame_groups_in(measured: Any) -> Iterator[FrameGroup]:
    """Yield the groups with frames."""
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
    """Return frames of one kind as rows (n,) LOGGED."""
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
    """Merge the frames of all parts in order of time; each part is in order of time."""
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
