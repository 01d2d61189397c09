"""Layout of a recording in MCAP, shared by the writer and the reader.

Each group of columns has a topic with one message per row, whose fields are those of the group and `time_s`;
frames are messages on `/can`. All messages are JSON with a schema. A channel's metadata define which columns its
fields are: `prefix` and the field's name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import orjson

from liftgate_hil.signals import COLUMN_ROWS, COLUMNS, FAULT_PREFIX, SENSED_PREFIX
from liftgate_plant.signals import TIME, Signal

RECORD = "liftgate-hil"  # the metadata record that every recording has
START = "start_ns"  # its key: wall clock at the start of the run [ns since 1970]; 0: none applies
TIMES = "of messages: nanoseconds since the run's start"
REMARK = "liftgate-hil remark"  # the metadata record with the remark on the recording
# The attachment with the provenance of the run, also in MF4.
ABOUT = "liftgate-hil-run.json"
ABOUT_PARQUET = "liftgate-hil run"  # the same as a key of Parquet's metadata
START_PARQUET = "liftgate-hil start_ns"  # START as a key of Parquet's metadata
# The same as a column of CSV, which has no other place for it; written if a wall clock applies.
START_COLUMN = "run_start_s"
FRAMES = "/can"
ENCODING = "json"
SCHEMA_ENCODING = "jsonschema"
PREFIX = "prefix"  # key of a channel's metadata
CONTENT = "content"  # key of a channel's metadata: ROWS, BUS or MARKS
BUS_NAME = "bus"  # key of a channel's metadata: name of the frames' bus
ROWS, BUS, MARKS = "rows", "frames", "marks"
MARKS_TOPIC = "/marks"

# Fields of a message on `/can`, with JSON type and meaning.
FRAME_FIELDS: Mapping[str, tuple[str, str]] = {
    "id": ("integer", "identifier without flags"),
    "extended": ("boolean", "an identifier of 29 bits"),
    "fd": ("boolean", "CAN FD"),
    "brs": ("boolean", "with CAN FD: bit rate switch"),
    "esi": ("boolean", "with CAN FD: error state indicator"),
    "remote": ("boolean", "a remote frame"),
    "error": ("boolean", "an error frame"),
    "dlc": ("integer", "data length code, as on the bus"),
    "length": ("integer", "bytes of data; of a remote frame those that it asks for"),
    "direction": ("string", "as the gate sees it: Tx, Rx"),
    "channel": ("string", "the bus"),
    "data": ("string", "hexadecimal"),
}


def topics_of(columns: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return each topic's columns but `time_s`, with the prefix that the field's name omits ("": none)."""
    topics: dict[str, dict[str, str]] = {}
    for name in columns:
        if name != "time_s":
            topic, prefix = _topic_of(name)
            topics.setdefault(topic, {})[name] = prefix
    return topics


def _topic_of(name: str) -> tuple[str, str]:
    """Return the topic of a column other than `time_s`, and the prefix that the field's name omits; "": none."""
    if name in COLUMNS:
        place = list(COLUMNS).index(name)
        part = [part for part, start in COLUMN_ROWS._asdict().items() if start <= place][-1]
        return f"/{part}", SENSED_PREFIX if name.startswith(SENSED_PREFIX) else ""
    if name.startswith(FAULT_PREFIX):
        return "/faults", FAULT_PREFIX
    message, point, _ = name.rpartition(".")
    return (f"/bus/{message}", f"{message}.") if point else ("/table", "")


def rows_schema(title: str, fields: Mapping[str, tuple[Signal, str]]) -> bytes:
    """Return the JSON schema of a topic of rows: type, meaning and unit (own key `unit`) of each field."""
    properties = {}
    for name, (signal, unit) in fields.items():
        words = f"{signal.meaning} [{signal.unit}]" if signal.unit else signal.meaning
        kind = "integer" if signal.is_whole else "number"
        properties[name] = {"type": kind, "description": words.strip(), "unit": unit}
    return _schema(title, properties)


def marks_schema() -> bytes:
    """Return the JSON schema of an operator's marks."""
    time = {"type": "number", "description": TIME.meaning, "unit": "s"}
    return _schema("mark", {"time_s": time, "text": {"type": "string", "description": "what the operator notes"}})


def frames_schema(title: str) -> bytes:
    """Return the JSON schema of the topic of frames."""
    return _schema(
        title, {name: {"type": kind, "description": words} for name, (kind, words) in FRAME_FIELDS.items()}
    )


def _schema(title: str, properties: Mapping[str, Any]) -> bytes:
    return orjson.dumps({"title": title, "type": "object", "properties": properties})
