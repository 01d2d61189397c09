"""Requests of `judge` and of `test`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.kinds import Number, Paths
from liftgate_hil.config.vehicle_choice import RIG, SCENARIO, AnyRig, AnyScenario, OwnVehicle, Parameters
from liftgate_hil.conversion.request import RecordingChannel, TimeZone
from liftgate_hil.formats.suffixes import WITH_FRAMES, WITH_ROWS
from liftgate_hil.measurement.request import MapRequest


# fmt: off
class JudgedFiles(Record, kw_only=False):
    """Base of the request to judge: recordings, and what they are judged by."""

    recordings: Annotated[str | Path | Sequence[str | Path], Field(Paths(), "recordings of one run, or of "
        f"several: tables {' '.join(WITH_ROWS)}, bus logs {' '.join(WITH_FRAMES)}", metavar="RECORDING")]
    scenario: Annotated[AnyScenario, Field(SCENARIO, "the scenario with the expectations",
        metavar="NAME|FILE", flag="scenario")]


class JudgeRequest(JudgedFiles, MapRequest):
    """Request to judge recordings by a scenario's expectations."""

    parameters: Parameters = ()
    vehicle: OwnVehicle = None
    rig: Annotated[AnyRig | None, Field(RIG, "a rig, or a database: decodes the frames", "the "
        "scenario's, else liftgate", "NAME|FILE")] = None
    recording_channel: RecordingChannel = None
    timezone: TimeZone = None
    duration: Annotated[float | None, Field(Number(1e-3, 1e9, "s"), "end of the run", "the scenario's, else the "
        "recording's", "S")] = None
    rate: Annotated[float, Field(Number(1.0, 10_000.0, "Hz"), "ticks per second in which recordings of other "
        "tools are judged", metavar="HZ")] = 1000.0
    longest_gap: Annotated[float | None, Field(Number(1e-6, 1e9, "s"), "longest gap between two samples of a "
        "column in recordings of other tools; a longer one makes windows inconclusive", "three times the column's "
        "usual interval", "S")] = None
    origin: Annotated[float | None, Field(Number(-1e10, 1e10, "s"), "where the run begins in recordings of other "
        "tools, by their times", "with their first sample", "S")] = None
