"""Judge recordings of a run offline: the same rows and frames through the same judge."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from liftgate_hil.conditions.condition import COLUMN
from liftgate_hil.config.database import database_file, is_database, load_messages
from liftgate_hil.config.kinds import listed
from liftgate_hil.config.rig import DEFAULT_BITRATE, Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.diagnostics.answers import ResetWatch
from liftgate_hil.diagnostics.tester import Diagnostics
from liftgate_hil.drive.result import silence_of, tolerance_of
from liftgate_hil.drive.stepping import StepsAgain, relevant_frames
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.formats.open import holds_nothing, open_file
from liftgate_hil.formats.recording import ReadOptions, read_options
from liftgate_hil.judging.expected import Expected
from liftgate_hil.judging.judge import Gap, Judge
from liftgate_hil.judging.trace_summary import TraceSummarizer, TraceSummary
from liftgate_hil.judging.verdict import INCONCLUSIVE, Verdict
from liftgate_hil.measurement.mapping import ColumnMap, parse_maps
from liftgate_hil.plan.plan import expected_in, loop_start_of
from liftgate_hil.plan.recorded_setup import recorded_setup
from liftgate_hil.plan.setup import Setup, rig_of, setup_of
from liftgate_hil.plan.stimulation import reset_failure
from liftgate_hil.signals import COLUMNS
from liftgate_hil.testing.read_run import Asked, read_run
from liftgate_hil.testing.recorded_run import RecordedRun, rounded_to_us
from liftgate_hil.testing.request import JudgeRequest


def paths_of(request: JudgeRequest) -> list[Path]:
    """Return the paths of the recordings of a request."""
    return list(map(Path, listed(request.recordings)))


class StoppedJudgingError(Exception):
    """Raised where judging was stopped before its end."""


@dataclass(frozen=True)
class RecordingExpectations:
    """Expectations by which recordings are judged, and how the recordings are read."""

    request: JudgeRequest
    setup: Setup
    rig: Rig
    expected: Expected
    mapping: ColumnMap
    how: ReadOptions  # to read the files

    @property
    def asked(self) -> Asked:
        """Request of the columns and signals to read from recordings."""
        columns = {name for each in self.expected.conditions for name in each.names(COLUMN)}
        if self.expected.precondition_end is not None:
            columns.add("gate_angle_deg")  # shows whether the precondition was completed
        signals = self.expected.signals
        found, request = (frozenset(columns), signals, self.rig, self.mapping), self.request
        is_off = any(each.kind == "bus_off" for each in self.setup.scenario.faults)
        own = self.expected.diagnostics
        others = [own.response] if own is not None else []
        if self.resets is not None:
            others += [self.resets.request, self.resets.response]
        return Asked(
            *found, request.rate, request.longest_gap, frozenset(others), is_off, self.how, request.origin
        )

    @property
    def resets(self) -> Diagnostics | None:
        """Diagnostics by which the bench resets the ECU over UDS; None: it does not reset it over UDS."""
        reset = self.rig.driver.reset
        return self.rig.diagnostics if reset is not None and reset.way == "uds" else None


@dataclass(frozen=True)
class JudgedRecording:
    """Verdicts of a recorded run's expectations, with the data for their pictures."""

    verdicts: dict[str, Verdict]
    trace_summaries: Mapping[str, TraceSummary]
    ticks: int
    last: float  # s, of the last row
    notes: Sequence[str]
    fault_notes: tuple[str, ...] = ()


def expectations_of(request: JudgeRequest) -> RecordingExpectations:
    """Return the expectations of a request's scenario, and how recordings are read. Raises ConfigError."""
    mapping = parse_maps(request.maps, COLUMNS)
    how = read_options(request.recording_channel, request.timezone)
    setup = _setup_of(request, request.parameters)
    rig = _rig_of(request.rig, setup.scenario)
    return RecordingExpectations(request, setup, rig, _expected_in(setup, rig), mapping, how)


def _setup_of(request: JudgeRequest, parameters: Mapping[str, float] | Sequence[str] | None) -> Setup:
    return setup_of(request.scenario, parameters=parameters, vehicle=request.vehicle)


def _expected_in(setup: Setup, rig: Rig) -> Expected:
    expected = expected_in(setup, rig)
    if not expected.expectations:
        raise ConfigError(f"{setup.scenario.source}: expect: missing; allowed: [[expect]] tables")
    return expected


def as_recorded(paths: Sequence[Path], about: RecordingExpectations) -> tuple[RecordingExpectations, list[str]]:
    """Return the expectations with vehicle, rig and parameters as recorded, and notes on the differences.

    What was given comes first, then the vehicle, the rig and the parameters that the provenance states, then the
    scenario's. Raises ConfigError.
    """
    found, given, notes = recorded_setup(paths), about.request, list[str]()
    replaced = given.parameter_values

    def noted(what: str, recorded: object, other: object, is_given: bool) -> None:
        used, unused = (other, f"{recorded} as recorded") if is_given else (recorded, other)
        how = "given" if is_given else "recorded"
        notes.append(f"{found.path}: {what} {used} as {how}, not {unused}")

    own = {name: value for name, value in found.parameters.items() if name in about.setup.scenario.parameters}
    for name, value in own.items():
        other = about.setup.scenario.parameters[name]
        if value != other:
            noted(name, value, other, name in replaced)
    setup = about.setup
    if any(setup.scenario.parameters[name] != value for name, value in own.items()):
        setup = _setup_of(given, {**own, **replaced})
    rig = about.rig
    if found.rig is not None and found.rig.source != rig.source:
        noted("rig", Path(found.rig.source).stem, Path(rig.source).stem, given.rig is not None)
        rig = found.rig if given.rig is None else rig
    elif found.states_rig and found.rig is None and given.rig is None:
        notes.append(f"{found.path}: its rig is missing or has changed; judged by {Path(rig.source).stem}")
    if found.vehicle is not None and found.vehicle != setup.vehicle:
        same = " with its changes" if found.vehicle_name == setup.vehicle_name else ""
        noted("vehicle", found.vehicle_name + same, setup.vehicle_name, given.vehicle is not None)
        if given.vehicle is None:
            changed = setup.varied(setup.scenario, found.vehicle)
            setup = replace(changed, vehicle_name=found.vehicle_name, vehicle_file=None)
    elif found.content and found.vehicle is None and given.vehicle is None:
        text = "its vehicle has other parameters than those of this version"
        notes.append(f"{found.path}: {text}; judged as {setup.vehicle_name}")
    if setup is about.setup and rig is about.rig:
        return about, notes
    return replace(about, setup=setup, rig=rig, expected=_expected_in(setup, rig)), notes


def judged(
    paths: Sequence[Path],
    about: RecordingExpectations,
    differences: Sequence[str] = (),
    is_summarized: bool = False,
    stopped: Callable[[], bool] = lambda: False,
) -> JudgedRecording:
    """Judge the recordings of one run by what `as_recorded` returns; `is_summarized`: with trace summaries.

    Raises ConfigError, and StoppedJudgingError where it is stopped on the way.
    """
    if paths and all(_holds_nothing(path) for path in paths):
        count = len(about.expected.expectations) - about.expected.awaited
        names = [each.name for each in about.expected.expectations[:count]]
        reason = "nothing was recorded"
        nothing = {name: Verdict(name, INCONCLUSIVE, reason=reason) for name in names}
        notes = [f"{path}: {note}" for path in paths for note in open_file(path, how=about.how).notes]
        return JudgedRecording(nothing, {}, 0, 0.0, [*differences, *notes])
    run = read_run(paths, about.asked)
    run.notes[:0] = differences
    scenario = about.setup.scenario
    end = scenario.duration if about.request.duration is None else about.request.duration
    last = float(run.times[-1])
    tolerance = silence = math.inf
    if about.rig.inputs:
        tolerance, silence = tolerance_of(scenario, about.rig), silence_of(scenario, about.rig)
    found = Judge(about.expected, run.rate, last if end is None else end, tolerance, silence)
    summarizer = TraceSummarizer(found, run.rate) if is_summarized else None
    watch = None if about.resets is None else ResetWatch(about.resets)
    for rows, frames in run.blocks():
        if stopped():
            raise StoppedJudgingError
        found.take(rows, frames)
        if watch is not None:
            watch.take(frames)
        if summarizer is not None:
            summarizer.take(rows, frames)
    steps_again = functools.cache(lambda: _steps_again(paths, about, found))
    own = found.verdicts(
        late=_not_made(about, run, watch, end),
        gaps=[*run.gaps, *_lacking(about, run, last)],
        again=lambda late: None if (steps := steps_again()) is None else steps(late),
    )
    verdicts = [_explained(each, run, about.expected.names(place)) for place, each in enumerate(own)]
    trace_summaries = {} if summarizer is None else summarizer.trace_summaries()
    by_name = {each.name: each for each in verdicts}
    return JudgedRecording(
        by_name, trace_summaries, len(run.times), last, [*about.rig.notes, *run.notes], tuple(found.notes())
    )


def _steps_again(paths: Sequence[Path], about: RecordingExpectations, judge: Judge) -> StepsAgain | None:
    """Return the function that simulates a recorded run again; None: the recording does not hold enough for it."""
    setup, rig = about.setup, about.rig
    if setup.scenario.precondition or not rig.inputs or about.mapping:
        return None
    commands = frozenset(rig.identifier(each.message) for each in rig.inputs)
    asked = replace(
        about.asked, columns=about.asked.columns | {"gate_angle_deg"}, others=about.asked.others | commands
    )
    run = read_run(paths, asked)
    if not run.has_frames or run.lacks("gate_angle_deg") or run.lacks("ticks_missed"):
        return None
    rate = float(f"{run.rate:.6g}")  # an estimate, from times in microseconds
    start = loop_start_of(setup, rig, rate)
    return StepsAgain(
        begun=start,
        frames=relevant_frames(rig, run.frames, judge.expected, start.stimuli),
        ticks=len(run.times) - 1,
        rig=rig,
        drives=setup.vehicle.drives,
        expected=judge.expected,
        rate=rate,
        end=judge.end,
        angles=run.tracks["gate_angle_deg"].held(rounded_to_us(run.times)),
    )


def _not_made(about: RecordingExpectations, run: RecordedRun, watch: ResetWatch | None, end: float | None) -> str:
    """Return why some of the run's resets and stimuli were not applied, or may not have been; "": all were."""
    found = "" if watch is None else reset_failure(watch.failure, about.rig)
    is_asked = about.asked.may_be_silent or any(each.action == "reset" for each in about.setup.scenario.requests)
    is_ours = not run.lacks("ticks_missed")
    if found or not (is_asked and is_ours):
        return found
    if run.lacks("stimuli_not_made"):
        return "not in the recording: stimuli_not_made"
    if end is not None and float(run.times[-1]) < end - 1.5 / run.rate:
        return f"not in the recording: the stimuli up to the end at {end:g} s"
    return ""


def _lacking(about: RecordingExpectations, run: RecordedRun, last: float) -> Iterator[Gap]:
    """Yield gaps from 0 to `last` [s] for columns and signals that stimuli wait for, but that are not recorded."""
    expected = about.expected
    for place in range(len(expected.expectations) - expected.awaited, len(expected.expectations)):
        lacking = frozenset(name for name in expected.names(place) if run.lacks(name))
        if lacking:
            yield Gap(0.0, last, lacking)


def _holds_nothing(path: Path) -> bool:
    with contextlib.suppress(ConfigError, OSError):  # reported by its reader
        return holds_nothing(path)
    return False


def _explained(verdict: Verdict, run: RecordedRun, names: Sequence[str]) -> Verdict:
    """Return an inconclusive verdict with the missing columns and signals as its reason; others unchanged."""
    lacking = [name for name in names if run.lacks(name)]
    if verdict.verdict != INCONCLUSIVE or not lacking:
        return verdict
    return replace(verdict, reason=f"not in the recording: {', '.join(lacking)}")


def _rig_of(rig: str | Path | Rig | None, scenario: Scenario) -> Rig:
    """Return the rig as `rig_of` does, or one made from a database alone. Raises ConfigError."""
    if not isinstance(rig, str | Path) or not is_database(rig):
        return rig_of(rig, scenario)
    issues = ConfigIssues(f"`rig` {rig}")
    file = database_file(rig)
    messages = load_messages(issues, file)
    issues.raise_if_any()
    return Rig(file.path, DEFAULT_BITRATE, messages, (), (), {}, False, str(rig))
