"""Requests of the commands on recordings; what they share is described once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.kinds import File, Text

# fmt: off
RecordingChannel = Annotated[str | None, Field(Text("the name of a bus"),
    "bus to read if the file contains several: can0", metavar="NAME")]
TimeZone = Annotated[str | None, Field(Text("a zone such as UTC or Europe/Berlin"),
    "zone of local times in files: UTC, Asia/Shanghai", "the computer's", "ZONE")]


class ConvertRequest(Record, kw_only=False):
    """Request to convert a recording."""

    source: Annotated[str | Path, Field(File(), "a recording, or a bus log of another tool", metavar="FILE")]
    target: Annotated[str | Path, Field(File(), "the file to write; what is there is kept, as out.previous.mf4",
        metavar="OUT_FILE")]
    rig: Annotated[str | None, Field(Text("a rig's name, or a file"), "a rig, or its database: decodes the frames "
        "into a table of signals", metavar="NAME|FILE")] = None
    recording_channel: RecordingChannel = None
    timezone: TimeZone = None
