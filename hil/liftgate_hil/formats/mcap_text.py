"""Rows as MCAP messages in JSON, one for each topic and row, and frames as theirs.

Numbers have the shortest form that reads back as the same value; a value that is not finite is null. As for CSV,
values that do not change within a block of rows are formatted once, and so are columns with equal values; compiled
code assembles the text.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from liftgate_hil.codec.frames import BRS, ERROR, ESI, EXTENDED, FD, LENGTHS, MAX_BYTES, REMOTE
from liftgate_hil.formats.csv_text import alike_columns, digits_of, put_number, put_whole
from liftgate_hil.formats.mcap_chunks import HEAD, LENGTH_BEFORE, MESSAGE, Block
from liftgate_plant.compiler import compilable, compiled, put_text
from liftgate_plant.compiler.texts import ROOM

_HEX = 2 * MAX_BYTES  # digits of a payload
_LONGEST = 24  # characters of the longest number: -2.2250738585072014e-308
_HEAD = HEAD.size
_BEFORE = LENGTH_BEFORE
_MESSAGE = MESSAGE


class Topic(NamedTuple):
    """Topic of rows: its channel, its fields, and their places in a row."""

    channel: int
    fields: Sequence[str]
    places: Sequence[int]
    whole: Sequence[bool]  # whether each field is an integer


class Layout(NamedTuple):
    """Texts of a row's messages: for each topic pieces that do not change, and between them the cells that do."""

    glue: NDArray[np.uint8]  # all constant pieces, one after the other
    begins: NDArray[np.int64]  # (topics + 1,) where each topic's pieces begin in `glue`
    first: NDArray[np.int64]  # (topics + 1,) index of each topic's first cell
    ends: NDArray[np.int64]  # (n,) where the piece before each cell ends in `glue`
    whole: NDArray[np.int64]  # (n,) 1: an integer, without a decimal point
    alike: NDArray[np.int64]  # (n,) first cell with the same text: this one or an earlier one
    spans: NDArray[np.int64]  # (n, 2) where the current row's cells begin and end in the text
    channels: NDArray[np.int64]  # (topics,) channel of each topic


@compilable
def put_bytes(out: NDArray[np.uint8], at: int, value: int, count: int) -> int:
    """Write an integer as `count` bytes, the least significant first; return where it ends."""
    for _ in range(count):
        out[at] = value & 0xFF
        value >>= 8
        at += 1
    return at


@compilable
def put_head(out: NDArray[np.uint8], at: int, length: int, channel: int, number: int, time_ns: int) -> None:
    """Write the head of a message record."""
    at = put_bytes(out, at, _MESSAGE, 1)
    at = put_bytes(out, at, length, 8)
    at = put_bytes(out, at, channel, 2)
    at = put_bytes(out, at, number, 4)
    at = put_bytes(out, at, time_ns, 8)
    put_bytes(out, at, time_ns, 8)


@compilable
def put_messages(
    layout: Layout,
    cells: NDArray[np.float64],
    digits: NDArray[np.uint8],
    times: NDArray[np.int64],
    number: int,
    out: NDArray[np.uint8],
    offsets: NDArray[np.uint64],
) -> int:
    """Write the messages of these rows (m, n) of changing cells into `out`; return their length.

    `times` (m,) are those of the rows [ns]. Where each message begins goes into `offsets` (m · topics,). `number`
    is that of the first row; `digits` is the JSON text, an array, of the cells that are neither integers nor equal
    to an earlier one.
    """
    glue, begins, starts, ends, whole, alike, spans, channels = layout
    at = read = message = 0
    for row in range(cells.shape[0]):
        for topic in range(len(channels)):
            head = at
            at += _HEAD
            begin = begins[topic]
            for k in range(starts[topic], starts[topic + 1]):
                put_text(out, at, glue, begin, ends[k] - begin)
                at += ends[k] - begin
                begin = ends[k]
                if alike[k] != k:
                    first, end = spans[alike[k], 0], spans[alike[k], 1]
                    put_text(out, at, out, first, end - first)
                    spans[k, 0] = at
                    at += end - first
                else:
                    spans[k, 0] = at
                    if whole[k] != 0:
                        at = put_whole(out, at, int(cells[row, k]))
                    else:
                        at, read = put_number(out, at, digits, read)
                spans[k, 1] = at
            put_text(out, at, glue, begin, begins[topic + 1] - begin)
            at += begins[topic + 1] - begin
            put_head(out, head, at - head - _BEFORE, channels[topic], number + row, times[row])
            offsets[message] = head
            message += 1
    return at


class RowMessages:
    """Formatter of rows (n, m) as messages of some topics."""

    def __init__(self, topics: Sequence[Topic]) -> None:
        self._topics = topics
        self._places = np.array([place for topic in topics for place in topic.places])
        self._is_whole = np.array([each for topic in topics for each in topic.whole])
        self._whole = np.flatnonzero(self._is_whole)
        self._names = [
            [(b"," if k else b"{") + orjson.dumps(name) + b":" for k, name in enumerate(topic.fields)]
            for topic in topics
        ]
        self._channels = np.array([topic.channel for topic in topics], dtype=np.int64)
        self._out = np.empty(0, dtype=np.uint8)
        self._put: Any = compiled(put_messages)

    def block(self, rows: NDArray[np.float64], times: NDArray[np.int64], number: int) -> Block:
        """Return the messages of these rows at `times` (n,) [ns]; `number` is that of the first row."""
        values = rows.take(self._places, axis=1)
        bits = values.view(np.int64)
        changes = (bits != bits[0]).any(axis=0)
        # Integers that do not fit into 64 bits are written as other numbers; so is NaN, for which `<` is false.
        whole = self._is_whole.copy()
        whole[self._whole] = (np.abs(values[:, self._whole]) < 2.0**63).all(axis=0)
        cells = np.ascontiguousarray(values[:, changes])
        alike = alike_columns(cells, whole[changes])
        layout = self._layout(values[0], changes, whole, alike)
        count = len(rows) * len(self._topics)
        room = len(rows) * (len(layout.glue) + cells.shape[1] * _LONGEST) + count * _HEAD + ROOM
        if len(self._out) < room:
            self._out = np.empty(room, dtype=np.uint8)
        offsets = np.empty(count, dtype=np.uint64)
        digits = digits_of(cells, whole[changes], alike)
        length = self._put(layout, cells, digits, times, number, self._out, offsets)
        return Block(
            self._out[:length].tobytes(),
            np.tile(self._channels.astype(np.uint16), len(rows)),
            np.repeat(times.astype(np.uint64), len(self._topics)),
            offsets,
        )

    def _layout(
        self,
        values: NDArray[np.float64],
        changes: NDArray[np.bool_],
        whole: NDArray[np.bool_],
        alike: NDArray[np.int64],
    ) -> Layout:
        """Return the layout of the messages: the first row's texts without the cells that change."""
        glue, begins, first, ends = bytearray(), [0], [0], []
        column = 0
        for names in self._names:
            for name in names:
                glue += name
                if changes[column]:
                    ends.append(len(glue))
                else:
                    value = float(values[column])
                    glue += orjson.dumps(int(value) if whole[column] else value)
                column += 1
            glue += b"}"
            begins.append(len(glue))
            first.append(len(ends))
        return Layout(
            glue=np.frombuffer(bytes(glue), dtype=np.uint8),
            begins=np.array(begins, dtype=np.int64),
            first=np.array(first, dtype=np.int64),
            ends=np.array(ends, dtype=np.int64),
            whole=whole[changes].astype(np.int64),
            alike=alike,
            spans=np.zeros((len(ends), 2), dtype=np.int64),
            channels=self._channels,
        )


def plain_name(text: str) -> str:
    """Return a name with what UTF-8 cannot hold replaced."""
    return text.encode(errors="replace").decode()


def frame_texts(frames: Any, channel: str) -> list[bytes]:
    """Return frames (n,) LOGGED as JSON objects with the fields of `mcap_layout.FRAME_FIELDS`."""
    text = frames["payload"].tobytes().hex().upper()
    name = orjson.dumps(plain_name(channel)).decode()
    fields = zip(
        frames["identifier"].tolist(),
        frames["length"].tolist(),
        np.searchsorted(LENGTHS, frames["length"]).tolist(),
        frames["is_sent"].tolist(),
        strict=True,
    )
    words = ("false", "true")
    result = []
    for row, (identifier, length, code, is_sent) in enumerate(fields):
        first = row * _HEX
        end = first if identifier & REMOTE else first + 2 * length
        result.append(
            (
                f'{{"id":{identifier & 0x1FFFFFFF},'
                f'"extended":{words[identifier & EXTENDED != 0]},"fd":{words[identifier & FD != 0]},'
                f'"brs":{words[identifier & BRS != 0]},"esi":{words[identifier & ESI != 0]},'
                f'"remote":{words[identifier & REMOTE != 0]},"error":{words[identifier & ERROR != 0]},'
                f'"dlc":{code},"length":{length},"direction":"{"Tx" if is_sent else "Rx"}",'
                f'"channel":{name},"data":"{text[first:end]}"}}'
            ).encode()
        )
    return result
