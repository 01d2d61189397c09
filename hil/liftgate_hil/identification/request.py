"""Requests of `identify`, of its planning of experiments, and of `validate`."""

import contextlib
import math
from collections.abc import Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from liftgate_hil.config.choices import RecordingChannel, TimeZone, VehicleChoice
from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.kinds import Choice, File, Flag, Names, Number, Paths, Texts, Whole
from liftgate_hil.config.shipped import DEFAULT_RIG
from liftgate_hil.config.toml import show
from liftgate_hil.described_result import DescribedResult
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.formats.suffixes import WITH_FRAMES, WITH_ROWS
from liftgate_hil.measurement.request import MapRequest

MODEL_NAMES = ("full", "third-order", "second-order")
# Kinds of outputs, and their columns.
OUTPUT_KINDS = {
    "current": ("left_current_a", "right_current_a"),
    "speed": ("left_speed_rps", "right_speed_rps"),
    "position": ("left_position_rev", "right_position_rev"),
    "angle": ("gate_angle_deg",),
}
_TIME = Number(-1e9, 1e10, "s")


class Preset(NamedTuple):
    """A predefined choice of free parameters, model and outputs."""

    estimate: tuple[str, ...]
    model: str
    outputs: tuple[str, ...]


_THESIS = ("current", "speed", "position")


def _of_motor(*names: str) -> tuple[str, ...]:
    return tuple(f"motor.{name}" for name in names)


PRESETS = {
    # §4.6.1, Table 4.1
    "thesis-1": Preset(
        _of_motor("resistance", "inductance", "rotor_inertia", "load_torque"), "third-order", _THESIS
    ),
    # §4.6.2, Table 4.2
    "thesis-2": Preset(
        _of_motor("resistance", "inductance", "torque_constant", "speed_constant", "efficiency"),
        "third-order",
        _THESIS,
    ),
    # §4.6.3: the first run without the inductance
    "thesis-3": Preset(_of_motor("resistance", "rotor_inertia", "load_torque"), "second-order", _THESIS),
}
NO_PRESET = Preset((), "full", ())


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


class ByName(NamedTuple):
    """Kind of value: numbers by names, as texts of the form `allowed`, or as a mapping."""

    allowed: str
    invalid: tuple[str, ...] = ()

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[str, ...]:
        """Return the numbers as texts NAME=NUMBER or NAME=NUMBER:NUMBER; add an issue if they are invalid."""
        if not isinstance(value, Mapping):
            return Texts(self.allowed).read(issues, key, value)
        plain = {name: each.tolist() if hasattr(each, "tolist") else each for name, each in value.items()}
        numbers = {name: each if isinstance(each, list | tuple) else [each] for name, each in plain.items()}
        if not all(_is_number(one) for each in numbers.values() for one in each):
            issues.add(key, f"{show(dict(value))}; allowed: {self.allowed}")
            return self.invalid
        return tuple(f"{name}={':'.join(repr(float(one)) for one in each)}" for name, each in numbers.items())


class Words(NamedTuple):
    """Kind of value: a text, a number, or a list of both, as a text with commas."""

    allowed: str
    invalid: str = ""

    def read(self, issues: ConfigIssues, key: str, value: Any) -> str:
        """Return the value as one text with commas; add an issue if it is invalid."""
        parts = value if isinstance(value, list) else [value]
        if not parts or not all(isinstance(each, str) or _is_number(each) for each in parts):
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return self.invalid
        return ",".join(map(str, parts))


class Angles:
    """Kind of value: a range of gate angles [deg], as a text LOW:HIGH or a pair."""

    allowed, invalid = "LOW:HIGH, -360 to 360 degrees", (math.nan, math.nan)

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[float, float]:
        """Return lower and upper angle [deg], NaN unless these are two numbers; if invalid, add an issue."""
        parts = value.split(":") if isinstance(value, str) else value
        low, high = self.invalid
        if isinstance(value, str) or (isinstance(value, list | tuple) and all(map(_is_number, value))):
            with contextlib.suppress(ValueError):
                low, high = map(float, parts)
        if not -360.0 <= low < high <= 360.0:
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
        return low, high


class IdentifiedFile:
    """Kind of value: the result of an identification, or the file that holds it."""

    allowed, invalid = "the result of identify, or its file", None

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Any:
        """Return the result, or the path of its file; add an issue if it is neither."""
        return value if isinstance(value, DescribedResult) else File().read(issues, key, value)


# fmt: off
# A field with its description is a row of a table.


class ModelChoice(VehicleChoice):
    """Base class of the requests that choose a vehicle, its model and the outputs to compare."""

    model: Annotated[str | None, Field(Choice(MODEL_NAMES), "full: the whole plant; third-order: the thesis's "
        "model (4.1-4.13); second-order: that without inductance", "full")] = None
    outputs: Annotated[Sequence[str], Field(Names(), f"outputs to compare: {', '.join(OUTPUT_KINDS)} "
        "(repeatable)", "all that were measured", "LIST")] = ()


class MeasuredFiles(Record, kw_only=False):
    """Base class of the requests that read measurements: the files, as a positional argument."""

    files: Annotated[str | Path | Sequence[str | Path], Field(Paths(), f"measurements: "
        f"{', '.join(WITH_ROWS)}, or a bus log {' '.join(WITH_FRAMES)}", metavar="FILE")]


class MeasuredRequest(MeasuredFiles, MapRequest, ModelChoice):
    """Base class of the requests that compare a model with measurements."""

    rig: Annotated[str | Path, Field(File(), "the rig that decodes bus logs", metavar="NAME|FILE")] = DEFAULT_RIG
    recording_channel: RecordingChannel = None
    timezone: TimeZone = None
    from_s: Annotated[float | None, Field(_TIME, "omit samples before this time", metavar="S", flag="from")] = None
    to_s: Annotated[float | None, Field(_TIME, "omit samples after this time", metavar="S", flag="to")] = None
    cut_angle: Annotated[tuple[float, float] | str | None, Field(Angles(), "use only the longest stretch with "
        "the gate angle between these degrees", metavar="LOW:HIGH")] = None
    resample: Annotated[float | None, Field(Number(1e-3, 1e6, "Hz"), "resample the outputs at this rate by linear "
        "interpolation, never across gaps", metavar="HZ")] = None
    decimate: Annotated[int, Field(Whole(1, 100_000), "keep every N-th sample of the outputs, after a low-pass "
        "filter",
        metavar="N")] = 1
    drop_outliers: Annotated[bool, Field(Flag(), "omit samples that are reported as outliers")] = False
    initial: Annotated[str | float | Sequence[str | float], Field(Words("auto, pause, closed, open, or degrees; "
        "one, or one for each file"), "closed, open, ANGLE: at rest there with cold windings; pause: at rest "
        "after a motion; auto: from the first samples; or one for each FILE: closed,open",
        metavar="auto|pause|closed|open|ANGLE_deg")] = "auto"
    input_delay: Annotated[str | float, Field(Words("-0.5 to 0.5 s, or estimate"), "delay from a change in an "
        "input column to its effect", "estimated for bus logs, whose timestamps are not those of the effect, else "
        "0",
        "S|estimate")] = "auto"
    speed_window: Annotated[float, Field(Number(0.0, 1.0, "s"), "averaging window of measured speeds, before each "
        "sample (e.g. the counting period)", metavar="S")] = 0.0
    step: Annotated[float, Field(Number(1e-5, 5e-3, "s"), "longest step of the simulation", metavar="S")] = 1e-3
    result: Annotated[str | Path | None, Field(File(), "write the result", metavar="FILE.json")] = None
    html: Annotated[str | Path | None, Field(File(), "write a report with plots", metavar="FILE")] = None


class SoughtChoice(ModelChoice):
    """Base class of the requests that choose parameters to be estimated."""

    estimate: Annotated[Sequence[str], Field(Names(), "parameters to estimate: keys of the vehicle file, e.g. "
        "motor.resistance,gear.backlash (repeatable)", metavar="LIST")] = ()
    preset: Annotated[str | None, Field(Choice(tuple(PRESETS)), "parameters, model and outputs of the thesis "
        "(4.6.1 to 4.6.3)")] = None
    bounds: Annotated[Sequence[str] | Mapping[str, Sequence[float]], Field(ByName("KEY=LOW:HIGH, e.g. "
        "motor.resistance=0.1:5"), "search a parameter only in this range "
        "(repeatable)", metavar="KEY=LOW:HIGH")] = ()
    prior: Annotated[Sequence[str] | Mapping[str, Sequence[float]], Field(ByName("KEY=MEAN:STD, e.g. "
        "motor.resistance=0.7:0.1"), "prior mean and standard deviation of a parameter (repeatable)",
        metavar="KEY=MEAN:STD")] = ()


class IdentifyRequest(SoughtChoice, MeasuredRequest):
    """Request to identify parameters of a vehicle from measurements."""

    noise: Annotated[Sequence[str] | Mapping[str, float], Field(ByName("OUTPUT=STD"), "standard deviation of "
        "the noise of current, speed, position or angle, in the column's unit (repeatable)", "estimated",
        "OUTPUT=STD")] = ()
    profile: Annotated[Sequence[str], Field(Names(), "show the profile likelihood of these keys (repeatable)",
        metavar="LIST")] = ()
    save_vehicle: Annotated[str | Path | None, Field(File(), "write the vehicle file with the estimates",
        metavar="FILE.toml")] = None


class PlanRequest(SoughtChoice):
    """Request to rank experiments by the information that they would give."""

    duration: Annotated[float, Field(Number(0.1, 60.0, "s"), "duration of a planned "
        "experiment", metavar="S")] = 4.0
    save_inputs: Annotated[str | Path | None, Field(File(), "with --plan: write the motor voltages of the best "
        "sequence, a CSV for each experiment, for --input of `simulate`", metavar="FOLDER")] = None
    result: Annotated[str | Path | None, Field(File(), "write the result", metavar="FILE.json")] = None


class ValidateRequest(MeasuredRequest):
    """Request to compare a model with measurements."""

    parameters: Annotated[str | Path | DescribedResult | None, Field(IdentifiedFile(), "use the parameter values "
        "of this identify result", metavar="FILE.json")] = None


# fmt: on
def pairs(given: Sequence[str], name: str, form: str) -> dict[str, tuple[float, float]]:
    """Parse `NAME=A:B` texts into pairs of numbers by name. Raises ConfigError."""
    found: dict[str, tuple[float, float]] = {}
    for text in given:
        key, equals, numbers = (part.strip() for part in text.partition("="))
        try:
            low, high = map(float, numbers.split(":"))
        except ValueError:
            equals = ""
        if not key or not equals:
            raise ConfigError(f"`{name}` {text}: allowed: {form}")
        if key in found:
            raise ConfigError(f"`{name}` {key}: given twice; allowed: once")
        found[key] = low, high
    return found
