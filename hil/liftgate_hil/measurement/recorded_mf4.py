"""MF4 files as recordings: a group of columns, and the frames of ASAM bus logging, a block at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import ERROR, EXTENDED, FD, LOGGED, MAX_BYTES, REMOTE
from liftgate_hil.errors import ConfigError
from liftgate_hil.mcap_layout import ABOUT
from liftgate_hil.measurement.measurement import Floats
from liftgate_hil.measurement.mf4_file import opened_mf4
from liftgate_hil.measurement.recorded import column_signal
from liftgate_plant.signals import TIME, Signal

_BLOCK = 20_000  # rows, frames
_KINDS = {"CAN_DataFrame": 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": REMOTE}
_LENGTHS = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64])  # by DLC


@dataclass(frozen=True)
class Mf4Recording:
    """See Recorded."""

    path: Path
    signals: Mapping[str, Signal]
    columns: Mapping[str, tuple[int, int]]  # of each its group and place in there
    buses: Mapping[
        int, tuple[str, int]
    ]  # groups of frames: their kind, and the channel with all of a frame
    bus_number: int
    start_ns: int
    about: str = ""
    notes: Sequence[str] = ()

    @property
    def channel(self) -> str | None:
        """See Recorded."""
        return f"can{self.bus_number}" if self.buses else None

    def rows(self, wanted: Sequence[str]) -> Iterator[Floats]:
        """See Recorded."""
        names = [name for name in wanted if name != "time_s"]
        asked = [(None, *self.columns[name]) for name in names or list(self.columns)[:1]]
        with opened_mf4(self.path, in_blocks=True) as measured:
            for signals in _blocks(measured, asked):
                times = np.asarray(signals[0].timestamps, dtype=np.float64)
                found = {"time_s": times}
                for name, signal in zip(names, signals, strict=False):
                    found[name] = self._numbers(name, signal.samples)
                yield np.column_stack([found[name] for name in wanted])

    def _numbers(self, name: str, samples: NDArray[Any]) -> Floats:
        if samples.ndim != 1 or samples.dtype.kind not in "fiub":
            raise ConfigError(f"{self.path}: {name}: no numbers; allowed: one number a sample")
        return samples.astype(np.float64)

    def frames(self) -> Iterator[NDArray[np.void]]:
        """See Recorded. Frames of unlike kinds are in the order of time."""
        with opened_mf4(self.path, in_blocks=True) as measured:
            parts = [
                self._frames(measured, kind, (None, group, place))
                for group, (kind, place) in self.buses.items()
            ]
            yield from parts[0] if len(parts) == 1 else merged(parts)

    def _frames(
        self, measured: Any, kind: str, place: tuple[None, int, int]
    ) -> Iterator[NDArray[np.void]]:
        for (signal,) in _blocks(measured, [place]):
            samples = signal.samples

            def field(name: str, otherwise: Any = 0, samples: Any = samples) -> Any:
                called = f"{kind}.{name}"
                return samples[called] if called in (samples.dtype.names or ()) else otherwise

            for flag in ("BRS", "ESI"):
                if np.any(field(flag)):
                    raise ConfigError(
                        f"{self.path}: a frame has {flag} set; allowed: recordings, in which none has"
                    )
            if np.any(field("BusChannel") != self.bus_number):
                raise ConfigError(f"{self.path}: frames of several buses; allowed: of one")
            yield _logged(_KINDS[kind], signal.timestamps, field)


def _logged(kind: int, times: Any, field: Any) -> NDArray[np.void]:
    """Frames (n,) LOGGED of one kind."""
    rows = np.zeros(len(times), dtype=LOGGED)
    rows["time_ns"] = np.round(np.asarray(times) * 1e9).astype(np.int64)
    identifiers = np.asarray(field("ID")).astype(np.int64)
    extended = (np.asarray(field("IDE")) != 0) | (identifiers & EXTENDED != 0)
    rows["identifier"] = (identifiers & 0x1FFFFFFF) | extended * EXTENDED | kind
    rows["identifier"] |= (np.asarray(field("EDL")) != 0) * FD
    of_code = _LENGTHS[np.minimum(np.asarray(field("DLC")).astype(int), 15)]
    rows["length"] = of_code if kind == REMOTE else field("DataLength", of_code)
    rows["is_sent"] = np.asarray(field("Dir")) != 0
    content = field("DataBytes", None)
    if content is not None and kind != REMOTE:
        width = min(content.shape[1], MAX_BYTES)
        rows["payload"][:, :width] = content[:, :width]
        rows["payload"][np.arange(MAX_BYTES) >= rows["length"][:, np.newaxis]] = 0
    return rows


def merged(parts: Sequence[Iterator[NDArray[np.void]]]) -> Iterator[NDArray[np.void]]:
    """The frames of all parts, each in the order of time, in the order of time."""
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


def _blocks(measured: Any, asked: Sequence[tuple[None, int, int]]) -> Iterator[list[Any]]:
    """These channels of one group, some rows at a time."""
    count = measured.groups[asked[0][1]].channel_group.cycles_nr
    for first in range(0, count, _BLOCK):
        yield measured.select(
            list(asked),
            record_offset=first,
            record_count=min(_BLOCK, count - first),
            raw=True,
            copy_master=False,
        )


def open_mf4_recording(path: Path) -> Mf4Recording:
    """What an MF4 file holds. Raises ConfigError where that is more than a recording."""
    columns: dict[str, tuple[int, int]] = {}
    signals: dict[str, Signal] = {}
    buses: dict[int, tuple[str, int]] = {}
    number = 0
    with opened_mf4(path, in_blocks=True) as measured:
        start = measured.header.start_time
        about = next(
            (
                bytes(measured.extract_attachment(index=k)[0]).decode(errors="replace")
                for k, each in enumerate(measured.attachments)
                if each.file_name == ABOUT
            ),
            "",
        )
        for group, content in enumerate(measured.groups):
            master = measured.masters_db.get(group)
            kind = next((each.name for each in content.channels if each.name in _KINDS), "")
            if not content.channel_group.cycles_nr:
                continue
            if kind:
                place = next(k for k, each in enumerate(content.channels) if each.name == kind)
                buses[group] = kind, place
                first = measured.select([(None, group, place)], record_count=1, raw=True)[0].samples
                name = f"{kind}.BusChannel"
                number = int(first[name][0]) if name in (first.dtype.names or ()) else 0
                continue
            for place, channel in enumerate(content.channels):
                if place == master:
                    continue
                if channel.conversion is not None:
                    raise ConfigError(
                        f"{path}: {channel.name}: has a conversion; allowed: plain numbers"
                    )
                if channel.name in columns:
                    raise ConfigError(f"{path}: {channel.name}: in several groups; allowed: in one")
                columns[channel.name] = group, place
                signals[channel.name] = column_signal(channel.name, channel.unit or "")
    if len({group for group, _ in columns.values()}) > 1:
        raise ConfigError(f"{path}: columns in several groups; allowed: a recording, which has one")
    if columns:
        signals = {"time_s": TIME, **signals}
    start_ns = max(0, round(start.timestamp() * 1e6)) * 1000
    return Mf4Recording(path, signals, columns, buses, number, start_ns, about)
