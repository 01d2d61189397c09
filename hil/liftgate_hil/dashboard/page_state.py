"""JSON responses of the page's server: their keys with meanings and units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypedDict

from liftgate_hil.described_result import Shown, keys_of
from liftgate_hil.judging.verdict import Verdict
from liftgate_hil.loop.histogram import Quantiles
from liftgate_hil.signals import COLUMNS

JsonObject = dict[str, Any]  # a JSON object
Numbers = dict[str, float]
SignalValues = dict[str, float | str]

_QUANTILES = keys_of(Quantiles)
_IN_WORDS = {
    "margin_text": "margin as it is printed, with its uncertainty and unit; —: there is none to show",
    "times_text": "when it was decided, and where that is another time, when the margin was reached, as it is "
    "printed; empty: never",
}
_VERDICT = {
    **keys_of(Verdict),
    "method": "`direct`: from the run as it was; `replay`: the gate was stepped again; empty: undecided",
    **_IN_WORDS,
}
_SO_FAR = {
    **{name: _VERDICT[name] for name in ("name", "verdict", "margin", "margin_unit", "time_s")},
    "verdict": "`pending`, `pass`, `inconclusive`, `fail` or `error`",
    **_IN_WORDS,
}


def _column(name: str) -> Shown:
    """Return the description of a column in the catalogue of columns."""
    column = COLUMNS[name]
    return Shown(f"{column.meaning} [{column.unit}]" if column.unit else column.meaning)


# fmt: off
class AboutSource(TypedDict, total=False):
    """Description of the page's data source: a run, a recording, or nothing yet."""

    kind: Annotated[str, Shown("`run`, `recording` or `none`")]
    columns: Annotated[list[str], Shown("list of the columns")]
    units: Annotated[dict[str, str], Shown("their units", keys={"COLUMN": "unit; empty: none"})]
    meanings: Annotated[dict[str, str], Shown("what the columns of the [catalogue](signals.md) mean", keys={
        "COLUMN": "meaning"})]
    number: Annotated[int, Shown("counts the runs that the page has shown")]
    read_only: Annotated[bool, Shown("whether commands are refused")]
    starts: Annotated[bool, Shown("whether scenarios can be started, see `GET /api/run`")]
    ends_with_run: Annotated[bool, Shown("whether the server ends with its run")]


_Expectations = Annotated[dict[str, str], Shown("what the scenario expects; of a recording as far as its files "
    "are there as they were", keys={"NAME": "formula of the expectation, with numbers for parameters"})]
_ForceLimits = Annotated[list[JsonObject], Shown("upper limits of the pinch force in these expectations", parts={
    "force_n": "the limit [N]",
    "longest_s": "how long the force may be above it without interruption [s]; 0: never; null: no number says it",
    "expectation": "the expectation"})]


class Control(TypedDict):
    """Quantity that can be commanded, with its range and label."""

    label: Annotated[str, Shown("name in words")]
    meaning: Annotated[str, Shown("what it is")]
    unit: Annotated[str, Shown("unit; empty: none")]
    low: Annotated[float, Shown("lowest value")]
    high: Annotated[float, Shown("highest value")]
    labels: Annotated[list[str], Shown("list of the labels of its values; empty: a number")]
    slide_low: Annotated[float, Shown("where a slider begins, in `unit`")]
    slide_high: Annotated[float, Shown("where a slider ends, in `unit`")]
    actions: Annotated[list[str], Shown("of a switch what a button says that sets 0, and 1; else empty")]


class ObstacleControl(Control):
    """Key of an obstacle command, with its range and label."""

    default: Annotated[float | None, Shown("value where the command does not state it; null: it must")]


class FaultKey(TypedDict):
    """Key of a fault command, with its range or words."""

    label: Annotated[str, Shown("name in words")]
    meaning: Annotated[str, Shown("what it is")]
    allowed: Annotated[str, Shown("what is allowed, in words")]
    labels: Annotated[list[str], Shown("list of the words to choose from; empty: none")]
    unit: Annotated[str, Shown("unit; empty: none")]
    low: Annotated[float, Shown("lowest value; of numbers only")]
    high: Annotated[float, Shown("highest value; of numbers only")]
    is_hex: Annotated[bool, Shown("whether the page shows it in hexadecimal digits")]
    default: Annotated[float | str | None, Shown("value where the command does not state it; null: none")]
    typical: Annotated[float | str | None, Shown("value with which the page's form begins; null: none")]


class FaultControl(TypedDict):
    """Kind of faults that can be commanded."""

    label: Annotated[str, Shown("name in words")]
    meaning: Annotated[str, Shown("what it does")]
    group: Annotated[str, Shown("part that fails")]
    of: Annotated[str, Shown("what `where` names: a drive, a message; else neither")]
    where: Annotated[list[str], Shown("list of the values that `where` can have; empty: it has none")]
    keys: Annotated[dict[str, FaultKey], Shown("keys of the fault", keys={"KEY": "a key"})]


class SignalControl(TypedDict):
    """Restbus signal that can be commanded."""

    unit: Annotated[str, Shown("unit in the database")]
    low: Annotated[float, Shown("lowest value")]
    high: Annotated[float, Shown("highest value")]
    labels: Annotated[list[str], Shown("list of the labels of its values")]
    start: Annotated[str, Shown("value or label at the start")]
    meaning: Annotated[str, Shown("comment in the database")]


class Controls(TypedDict):
    """Commands that a run accepts, with their ranges and labels."""

    obstacle: Annotated[dict[str, ObstacleControl], Shown("keys of the obstacle", keys={"KEY": "a key"})]
    set: Annotated[dict[str, Control], Shown("surroundings", keys={"QUANTITY": "a quantity of [scenario "
        "files](scenario.md)"})]
    fault: Annotated[dict[str, FaultControl], Shown("kinds of faults", keys={"KIND": "a kind of [scenario "
        "files](scenario.md)"})]
    signal: Annotated[dict[str, SignalControl], Shown("signals of the restbus", keys={"SIGNAL": "a signal, as "
        "`Message.Signal`"})]
    request: Annotated[list[str], Shown("list of the requests that reach the ECU")]
    record: Annotated[list[str], Shown("list of the formats of recordings")]


class AboutRun(AboutSource, total=False):
    """Description of a run: its vehicle, rig and columns, and the commands that it accepts."""

    version: Annotated[str, Shown("version of the program")]
    pid: Annotated[int, Shown("process of the run")]
    vehicle: Annotated[str, Shown("name or file of the vehicle")]
    scenario: Annotated[str, Shown("file of the scenario; empty: none")]
    stimuli: Annotated[list[str], Shown("list of the scenario's requests and stimuli, in words")]
    expectations: _Expectations
    force_limits: _ForceLimits
    duration_s: Annotated[float | None, Shown("duration [s]; null: until stopped")]
    rig: Annotated[str, Shown("file of the rig")]
    database: Annotated[str, Shown("file of the database")]
    clock: Annotated[str, Shown("clock of the run")]
    rate_hz: Annotated[float, Shown("ticks per second [Hz]")]
    channel: Annotated[str, Shown("name of the bus")]
    bitrate: Annotated[float | None, Shown("bit rate [bit/s]; null: none")]
    commands: Annotated[Controls, Shown("what can be commanded")]
    signal_units: Annotated[dict[str, str], Shown("units of the database's signals that have one", keys={
        "SIGNAL": "unit of a signal, as `Message.Signal`"})]


class AboutRecording(AboutSource, total=False):
    """Description of a recording: its file, time range, contacts, marks and expectations."""

    file: Annotated[str, Shown("the recording")]
    every: Annotated[int, Shown("of how many rows one is kept, with the lowest and highest values of all")]
    begin_s: Annotated[float, Shown("time of the first row [s]")]
    end_s: Annotated[float, Shown("time of the last row [s]")]
    ours: Annotated[dict[str, str], Shown("of a bus log: column or signal that stands for a column of this "
        "program")]
    contacts: Annotated[list[JsonObject] | None, Shown("contacts with an obstacle; null: the recording holds no "
        "pinch force", parts={"begin_s": "begin [s]", "end_s": "end [s]", "peak_n": "largest pinch force [N]",
        "peak_s": "its time [s]"})]
    marks: Annotated[list[JsonObject], Shown("marks, among them an operator's commands", parts={
        "time_s": "time [s]", "text": "text"})]
    expectations: _Expectations
    force_limits: _ForceLimits


class DriveGeometry(TypedDict):
    """Points and lengths of a drive, for drawings."""

    body_point: Annotated[list[float], Shown("its point on the body [x, y] [m]")]
    gate_point: Annotated[list[list[float]], Shown("its point on the gate at each angle")]
    length_m: Annotated[list[float], Shown("list of its lengths at each angle [m]")]
    spring_n: Annotated[list[float], Shown("list of its spring's forces at each angle [N]")]


class GateGeometry(TypedDict, total=False):
    """Geometry of a vehicle for drawings; empty where it is not known."""

    hinge: Annotated[list[float], Shown("the hinge [x, y] [m]")]
    closed_deg: Annotated[float, Shown("direction from the hinge to the edge of the closed gate [deg]")]
    open_angle_deg: Annotated[float, Shown("angle of the open gate [deg]")]
    stops_deg: Annotated[list[float], Shown("list of the angles of the stops [deg]")]
    length_m: Annotated[float, Shown("distance from the hinge to the edge [m]")]
    thickness_m: Annotated[float, Shown("thickness of the gate [m]")]
    weight_n: Annotated[float, Shown("weight of the gate [N]")]
    half_width_m: Annotated[float, Shown("half the width of the gate [m]")]
    angles_deg: Annotated[list[float], Shown("list of angles of the gate, for the lists below [deg]")]
    edge: Annotated[list[list[float]], Shown("the edge at each angle: list of [x, y] [m]")]
    gravity_point: Annotated[list[list[float]], Shown("the centre of gravity at each angle: list of [x, y] [m]")]
    drives: Annotated[dict[str, DriveGeometry], Shown("the drives, `left` and `right`", keys={"DRIVE": "a drive"})]
    stroke_m: Annotated[float, Shown("stroke of the drives [m]")]
    hand_distance_m: Annotated[float, Shown("distance of the hand's force from the hinge [m]")]
    snow_distance_m: Annotated[float, Shown("distance of the snow's centre from the hinge [m]")]
    latch_distance_m: Annotated[float, Shown("distance of the latch from the hinge [m]")]
    latch_has_positions: Annotated[bool, Shown("whether the latch has a half and a full position")]
    seal_distance_m: Annotated[float, Shown("lever arm of the seal [m]")]
    pinch_limit_n: Annotated[float, Shown("limit of the pinch force that the vehicle file states [N]")]


class Curves(TypedDict):
    """Curves of columns: lowest and highest values of intervals of time."""

    time_s: Annotated[list[float], Shown("list of the ends of the stretches [s]")]
    low: Annotated[dict[str, list[float]], Shown("lowest values", keys={"COLUMN": "list of the lowest value in "
        "each stretch"})]
    high: Annotated[dict[str, list[float]], Shown("highest values", keys={"COLUMN": "list of the highest value in "
        "each stretch"})]


class TracedFrame(TypedDict):
    """Decoded frame on the bus."""

    id: Annotated[str, Shown("identifier in hexadecimal digits, followed by x if it has 29 bits")]
    name: Annotated[str, Shown("name in the database; empty: unknown")]
    direction: Annotated[str, Shown("`sent` or `received` by the gate")]
    time_s: Annotated[float, Shown("model time of the frame [s]")]
    data: Annotated[str, Shown("payload: bytes in hexadecimal digits")]
    signals: Annotated[SignalValues, Shown("decoded signals; empty: unknown message", keys={"SIGNAL": "value in "
        "the database's unit, or its label"})]


class BusTrace(TypedDict):
    """Frames on the bus after a requested number, and the number of the first of them."""

    first: Annotated[int, Shown("number of the first of these frames, counted from 1; higher than asked for: "
        "those before are gone")]
    frames: Annotated[list[TracedFrame], Shown("the frames, in their order")]


class ListedScenario(TypedDict):
    """Scenario file in the folder of scenarios."""

    name: Annotated[str, Shown("file, below the folder")]
    description: Annotated[str, Shown("what it is about; empty: it does not say")]
    requirement: Annotated[list[str], Shown("list of the requirements that it is for")]
    issue: Annotated[str, Shown("why it cannot be read; empty: it can")]
    verdict: Annotated[str, Shown("`ending` of its last run from this page; empty: none yet, or it has no "
        "expectations")]


class Startable(TypedDict):
    """Scenarios that can be started, and which of them runs."""

    scenarios: Annotated[list[ListedScenario], Shown("the files that can be started")]
    is_all: Annotated[bool, Shown("false: the folder has more files than are listed")]
    running: Annotated[str | None, Shown("the one that runs; null: none")]
    exit_code: Annotated[int | None, Shown("exit code of the last one; null: none yet")]


class EndState(TypedDict):
    """End of a run: its verdict, the reason, and the verdicts of its expectations."""

    verdict: Annotated[str, Shown("`pass`, `inconclusive`, `fail` or `error`")]
    ending: Annotated[str, Shown("the verdict, or what stands in its place: `stopped` before the end, with "
        "nothing failed; `given up`: the bench has ended the run early")]
    reason: Annotated[str, Shown("why, in words; may be empty")]
    expectations: Annotated[list[JsonObject], Shown("the verdicts on the expectations", parts=_VERDICT)]
    exit_code: Annotated[int | None, Shown("exit code of the run's process; null: unknown")]
    pinch_peak_n: Annotated[float | None, Shown("largest pinch force of the run [N]; null: nothing was pinched")]
    pinch_peak_s: Annotated[float | None, Shown("its time [s]")]


class CommandValue(TypedDict):
    """Quantity in the ECU's last command."""

    value: Annotated[float | str, Shown("value in `unit`, or its label in the database")]
    unit: Annotated[str, Shown("unit in the database")]
    signal: Annotated[str, Shown("message and signal that carry it")]


class ShownLoop(TypedDict, total=False):
    """State of the loop; for a recording only the recorded quantities."""

    clock: Annotated[str, Shown("clock of the run")]
    rate_hz: Annotated[float, Shown("ticks per second [Hz]")]
    tick: Annotated[int, Shown("ticks that were done")]
    ticks_missed: Annotated[float, _column("ticks_missed")]
    frames_dropped: Annotated[float, _column("frames_dropped")]
    command_delay_s: Annotated[float, _column("command_delay_s")]
    stimuli_not_made: Annotated[float, _column("stimuli_not_made")]
    lateness_us: Annotated[Numbers | None, Shown("how late ticks began, over the run; null: not measured",
        parts=_QUANTILES)]
    execution_us: Annotated[Numbers | None, Shown("execution time of a tick; null: not measured",
        parts=_QUANTILES)]
    command_delay_us: Annotated[Numbers | None, Shown("command delay; null: not measured", parts=_QUANTILES)]


class BusState(TypedDict, total=False):
    """State of the bus."""

    channel: Annotated[str, Shown("name of the bus")]
    bitrate: Annotated[float | None, Shown("bit rate [bit/s]")]
    load_percent: Annotated[float | None, Shown("bus load over the last second [%]; null: unknown")]
    sent: Annotated[int, Shown("frames sent")]
    received: Annotated[int, Shown("frames received")]
    unsent: Annotated[int, Shown("frames that were not sent")]
    dropped: Annotated[int, Shown("frames that were dropped before the gate read them")]
    bus_offs: Annotated[int, Shown("times that the controller went bus-off")]
    not_shown: Annotated[int, Shown("frames of messages beyond the first 500, which `messages` leaves out")]
    overwritten: Annotated[int, Shown("rows and frames that the server was too slow to read, since it attached")]
    command_age_s: Annotated[float | None, Shown("age of the last valid command [s]; null: there is none")]
    accepted: Annotated[int | None, Shown("valid frames of mapped messages; null: unknown")]
    rejected: Annotated[int | None, Shown("rejected frames; null: unknown")]
    foreign: Annotated[int | None, Shown("frames with identifiers that the rig does not receive; null: unknown")]


class CommandsInForce(TypedDict, total=False):
    """Commands in force, which were sent and have not been cleared."""

    obstacle: Annotated[JsonObject | None, Shown("the obstacle, with the keys of the command; null: none")]
    set: Annotated[JsonObject, Shown("values that were set, by quantity, in its unit")]
    faults: Annotated[list[JsonObject], Shown("faults: a list, each with the keys of the command")]
    signals: Annotated[JsonObject, Shown("signals that were set: `Message.Signal` and its value")]
    record: Annotated[JsonObject | None, Shown("the recording that was begun: `file` and `phase`; null: none")]


class ActingState(TypedDict, total=False):
    """Obstacle and spring faults that act on the gate."""

    obstacle: Annotated[JsonObject | None, Shown("the obstacle in the gate's way; null: none", parts={
        "angle_deg": "gate angle at which the gate meets it [deg]", "distance": "distance from the hinge [m]",
        "meets": "`closing` or `opening`: direction of motion in which the gate meets it"})]
    spring_health: Annotated[Mapping[str, float | None], Shown("share of the springs' force that is left, by "
        "drive: 1 without a fault",
        parts={"left": "of the left drive", "right": "of the right drive, where there is one"})]


class HeardMessage(TracedFrame):
    """Message on the bus, with its last frame."""

    count: Annotated[int, Shown("frames so far")]
    cycle_ms: Annotated[float, Shown("time between the last two frames [ms]; null: there was one")]


class PageState(TypedDict, total=False):
    """State of the run or recording that a page shows; in the stream only frequently changing keys."""

    phase: Annotated[str, Shown("`compiling`, `ready` (before time 0), `running`, `late` (ticks were missed in "
        "the last two seconds, or the run stands still), `ended`; of a recording `recorded`, without a run "
        "`idle`")]
    end: Annotated[EndState | None, Shown("how the run has ended: `verdict`, `ending`, `reason`, `expectations`, "
        "`exit_code`, its largest pinch force; null: it has not")]
    time_s: Annotated[float | None, Shown("model time [s]")]
    truth: Annotated[Numbers, Shown("true values of the columns", keys={"COLUMN": "in the unit of the "
        "[signal](signals.md)"})]
    sensed: Annotated[Numbers, Shown("what the ECU's sensors report, by the same names", keys={"COLUMN": "in the "
        "unit of the [signal](signals.md)"})]
    command: Annotated[dict[str, CommandValue], Shown("the ECU's last command: `value` or its label, `unit` and "
        "`signal` of each quantity in the rig", keys={"QUANTITY": "a quantity of the [rig file](rig.md)"})]
    loop: Annotated[ShownLoop, Shown("clock, rate, ticks done and missed; lateness, execution time and command "
        "delay [µs] as quantiles")]
    bus: Annotated[BusState, Shown("channel, load, frames sent, received, accepted, rejected, foreign, dropped; "
        "age of the last command")]
    in_force: Annotated[CommandsInForce, Shown("what was commanded and has not been cleared, in the form of "
        "commands")]
    acting: Annotated[ActingState, Shown("what acts on the gate, from the scenario, a panel or commands; of a "
        "recording the obstacle that the gate presses against, at its edge, without `meets`; empty: not known")]
    verdicts: Annotated[list[JsonObject], Shown("of each expectation the verdict so far (`pending`: undecided), "
        "margin and times; the bench's lateness may still change it", parts=_SO_FAR)]
    messages: Annotated[list[HeardMessage], Shown("the last frame of each message on the bus, decoded; in the "
        "stream five times a second")]
    histograms: Annotated[JsonObject, Shown("lateness, execution time and command delay as bars: from, to [µs], "
        "count; in the stream alike", parts={
        "lateness_us": "how late ticks began, over the run: list of [from µs, to µs, count]",
        "execution_us": "execution time of a tick: list of [from µs, to µs, count]",
        "command_delay_us": "command delay: list of [from µs, to µs, count]"})]
    log: Annotated[list[list[Any]], Shown("lines: number, Unix time, text; in the stream those that are new")]
    alarms: Annotated[list[list[Any]], Shown("of these lines the latest that nobody may miss: the link is lost, "
        "or back; a recording has ended before its run")]
    number: Annotated[int, Shown("counts the runs that the page has shown: another one begins with another "
        "number")]
    span: JsonObject  # in the stream: `low` and `high` of each column since the last state
    started: str | None  # with `--scenarios`
    is_over: bool  # in the stream of a recording
