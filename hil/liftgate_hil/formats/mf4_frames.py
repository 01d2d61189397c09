"""Frames as in ASAM MDF bus logging, and back."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import BRS, ERROR, ESI, EXTENDED, FD, LENGTHS, LOGGED, MAX_BYTES, REMOTE
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


def field_of(samples: Any, kind: str, name: str, otherwise: Any = 0) -> Any:
    """Return a field of the frames of one kind, or what stands for one that the file does not have."""
    called = f"{kind}.{name}"
    return samples[called] if called in (samples.dtype.names or ()) else otherwise


def logged(samples: Any, kind: str, times: Any) -> NDArray[np.void]:
    """Return frames of one kind as rows (n,) LOGGED. Raises ValueError where they have no identifiers."""
    field, mark = functools.partial(field_of, samples, kind), KINDS[kind]
    rows = np.zeros(len(times), dtype=LOGGED)
    rows["time_ns"] = np.round(np.asarray(times) * 1e9).astype(np.int64)
    # A logger's error frame may have no identifier.
    identifiers = np.asarray(samples[f"{kind}.ID"] if mark != ERROR else field("ID", np.zeros(len(times))))
    identifiers = identifiers.astype(np.int64)
    extended = (np.asarray(field("IDE")) != 0) | (identifiers & EXTENDED != 0)
    rows["identifier"] = (identifiers & 0x1FFFFFFF) | extended * EXTENDED | mark
    is_fd = np.asarray(field("EDL")) != 0
    rows["identifier"] |= is_fd * FD
    for name, flag in (("BRS", BRS), ("ESI", ESI)):
        rows["identifier"] |= (is_fd & (np.asarray(field(name)) != 0)) * flag
    of_code = np.array(LENGTHS)[np.minimum(np.asarray(field("DLC")).astype(int), 15)]
    rows["length"] = of_code if mark == REMOTE else field("DataLength", of_code)
    rows["is_sent"] = np.asarray(field("Dir")) != 0
    content = field("DataBytes", None)
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
