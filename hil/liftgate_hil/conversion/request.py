"""Requests (arguments) of the commands convert, compare and plot; shared arguments are described once."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from liftgate_hil.config.choices import RecordingChannel, TimeZone, VehicleSettings
from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.kinds import Choice, File, Names, Number, Text
from liftgate_hil.config.toml import show
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.formats.suffixes import BUS_LOGS, PICTURES, ROWS_AND_FRAMES, ROWS_ONLY, either


class FigureKind(NamedTuple):
    """Kind of figure: its meaning, and whether it needs a recording or a vehicle."""

    meaning: str
    of_recording: bool = False
    of_vehicle: bool = False


FIGURES: Mapping[str, FigureKind] = {
    "columns": FigureKind("columns over time", of_recording=True),
    "thesis": FigureKind(
        "voltage, current, speed, position, angle and force, arranged as in the thesis", of_recording=True
    ),
    "phase": FigureKind("gate rate over gate angle", of_recording=True),
    "pinch": FigureKind(
        "the contact with the largest pinch force, and its limit", of_recording=True, of_vehicle=True
    ),
    "forces": FigureKind("torques on the gate at rest over its angle", of_vehicle=True),
    "static": FigureKind(
        "where the gate stays, and where the drives start it, over slope and supply", of_vehicle=True
    ),
}
_LONGEST_S = 3600.0  # s; all rows within it are kept in memory


class Tolerances:
    """Kind of value: tolerances as texts, each of a named column or for all columns."""

    allowed, invalid = "X or NAME=X, X at least 0", ()

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[str, ...]:
        """Return the tolerances as texts; an empty tuple and an issue if one is invalid."""
        if isinstance(value, Mapping):
            given = [f"{name}={each}" for name, each in value.items()]
        else:
            given = [str(each) for each in (value if isinstance(value, list) else [value])]
        for each in given:
            if not 0.0 <= tolerance_in(each)[1] < math.inf:
                issues.add(key, f"{show(each)}; allowed: {self.allowed}")
                return ()
        return tuple(given)


def tolerance_in(text: str) -> tuple[str, float]:
    """Return column ("": all) and number of a tolerance [NAME=]X; NaN if the number is invalid."""
    name, _, number = text.rpartition("=")
    try:
        return name, float(number)
    except ValueError:
        return name, math.nan


# fmt: off
Rig = Annotated[str | Path | None, Field(Text("a rig's name, or a file"),
    "a rig, or its database: decodes the frames into signals", metavar="NAME|FILE")]
From = Annotated[float | None, Field(Number(-1e9, 1e9, "s"), "start at this time", "the recording's start", "S",
    flag="from")]
To = Annotated[float | None, Field(Number(-1e9, 1e9, "s"), "end at this time", "the recording's end", "S",
    flag="to")]


class ConvertRequest(Record, kw_only=False):
    """Arguments of the command convert."""

    source: Annotated[str | Path, Field(File(), "a recording, or a bus log of another tool", metavar="FILE")]
    target: Annotated[str | Path, Field(File(), f"the file to write: {' '.join(ROWS_ONLY)} hold rows, "
        f"{' '.join(BUS_LOGS)} frames, {' '.join(ROWS_AND_FRAMES)} both; what is there is kept, as "
        "out.previous.mf4", metavar="OUT_FILE")]
    rig: Annotated[str | Path | None, Field(Text("a rig's name, or a file"), "a rig, or its database: decodes the "
        "frames into a table of signals", metavar="NAME|FILE")] = None
    recording_channel: RecordingChannel = None
    timezone: TimeZone = None


class CompareRequest(Record, kw_only=False):
    """Arguments of the command compare."""

    first: Annotated[str | Path, Field(File(), "a recording", metavar="FILE")]
    second: Annotated[str | Path, Field(File(), "the recording to compare it with", metavar="OTHER_FILE")]
    columns: Annotated[Sequence[str], Field(Names(), "only these columns (repeatable)", "all, and the frames",
        "A,B,…")] = ()
    from_s: From = None
    to_s: To = None
    rig: Rig = None
    recording_channel: RecordingChannel = None
    timezone: TimeZone = None
    tolerance: Annotated[float | Mapping[str, float] | Sequence[str], Field(Tolerances(), "largest difference "
        "that counts as equal, in the unit of the column, for all columns or for one (repeatable)", "0",
        "[NAME=]X")] = ()
    time_tolerance: Annotated[float | None, Field(Number(0.0, _LONGEST_S, "s"), "how much earlier or later a "
        "change of a value, or a frame, may be in the other recording", "a microsecond, to which formats keep "
        "times", "S")] = None
    output: Annotated[str | Path | None, Field(File(), f"the picture, {either(PICTURES)}", "none",
        "FILE")] = None


COLUMNS = "columns"  # the figure of columns over time
_OF_VEHICLE = ", ".join(name for name, each in FIGURES.items() if each.of_vehicle)
# What only figures of one kind of subject take.
OF_RECORDING = ("recording", "from_s", "to_s", "rig", "recording_channel", "timezone")
OF_VEHICLE = ("vehicle", "settings", "draw", "ideal")


class PlotRequest(VehicleSettings, kw_only=False):
    """Arguments of the command plot, of a recording or a vehicle."""

    recording: Annotated[str | Path | None, Field(File(), "a recording, or a bus log of another tool",
        metavar="FILE")] = None
    figure: Annotated[str, Field(Choice(tuple(FIGURES)), "; ".join(
        f"{name}: {each.meaning}" for name, each in FIGURES.items()))] = COLUMNS
    columns: Annotated[Sequence[str], Field(Names(), "only these columns (repeatable)", "angle, currents, "
        "speeds, pinch force and voltage as far as they change, or the first few", "A,B,…")] = ()
    from_s: From = None
    to_s: To = None
    rig: Rig = None
    recording_channel: RecordingChannel = None
    timezone: TimeZone = None
    vehicle: Annotated[str | Path | None, Field(File(), f"for the figures {_OF_VEHICLE}",
        "the recording's, else suv", "NAME|FILE")] = None
    output: Annotated[str | Path | None, Field(File(), f"the picture, {either(PICTURES)}", "FILE.png, "
        "FILE.FIGURE.png, VEHICLE.FIGURE.png", "FILE")] = None


# fmt: on
