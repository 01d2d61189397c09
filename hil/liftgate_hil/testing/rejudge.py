"""Judging again, from recordings: the same rows and frames through the same judge."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from liftgate_hil import session
from liftgate_hil.conditions.condition import COLUMN
from liftgate_hil.config.database import KINDS, load_messages
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.diagnostics.reset_watch import ResetWatch
from liftgate_hil.diagnostics.tester import Diagnostics
from liftgate_hil.errors import ConfigError
from liftgate_hil.issues import ConfigIssues
from liftgate_hil.judging.judge import Expected, Gap, Judge
from liftgate_hil.judging.sketch import Sketch, Sketcher
from liftgate_hil.judging.stepped_again import SteppedAgain
from liftgate_hil.judging.verdict import INCONCLUSIVE, Verdict
from liftgate_hil.loop.begun import Begun
from liftgate_hil.measurement.mapping import ColumnMap, parse_maps
from liftgate_hil.measurement.recorded import holds_nothing
from liftgate_hil.runs.result import silence_of, tolerance_of
from liftgate_hil.runs.stepping import StepsAgain, heard_by
from liftgate_hil.signals import COLUMNS
from liftgate_hil.staging import expected_in, reset_failure, staged
from liftgate_hil.testing.read_run import Asked, read_run
from liftgate_hil.testing.recorded_run import RecordedRun, rounded_to_us
from liftgate_plant.vehicle import Vehicle

_BITRATE = 500_000.0  # bit/s; of a database alone nobody asks


def judge(
    recordings: Sequence[str | Path],
    scenario: str | Path | Scenario,
    *,
    parameters: Mapping[str, float] | None = None,
    vehicle: str | Path | Vehicle | None = None,
    rig: str | Path | Rig | None = None,
    duration: float | None = None,
    maps: Sequence[str] = (),
    rate: float = 1000.0,
    longest_gap: float | None = None,
) -> dict[str, Verdict]:
    """The verdicts of a scenario's expectations, by their names, from the recordings of one run: tables (CSV,
    Parquet, MF4, MCAP), bus logs, or both. What was not recorded makes inconclusive. `duration` [s] is the run's
    end where it was not the scenario's. Stamps count from the run's start; those of a wall clock from when a
    recording of ours says that the run began, else from the first one.

    Of recordings that are not ours, `rig` (a rig's file, or a database) says what frames mean; its outputs stand
    for the columns that no table has. `maps` are texts as of `--map`: OURS=THEIRS[unit], a column, or a
    Message.Signal. Such recordings are judged in ticks of `rate` [Hz], each column as of its last sample; where
    two are further apart than `longest_gap` [s] (None: three times what is usual), windows are inconclusive.

        judge(["drive.log"], "close.toml", rig="their.dbc", maps=["gate_angle_deg=Tailgate.Position"])

    Raises ConfigError.
    """
    about = expectations_of(scenario, parameters=parameters, vehicle=vehicle, rig=rig)
    about = replace(about, duration=duration, mapping=parse_maps(maps, COLUMNS))
    about = replace(about, rate=rate, longest_gap=longest_gap)
    return judged([Path(each) for each in recordings], about).verdicts


class StoppedJudgingError(Exception):
    """Nobody waits for the verdicts any more."""


@dataclass(frozen=True)
class Expectations:
    """What recordings are judged by."""

    setup: session.Setup
    rig: Rig
    expected: Expected
    duration: float | None = None  # s; None: the scenario's
    mapping: ColumnMap = field(default_factory=dict)
    rate: float = 1000.0
    longest_gap: float | None = None

    @property
    def asked(self) -> Asked:
        """What is to be read of recordings."""
        columns = {name for each in self.expected.conditions for name in each.names(COLUMN)}
        signals = self.expected.signals
        found = frozenset(columns), signals, self.rig, self.mapping
        is_off = any(each.kind == "bus_off" for each in self.setup.scenario.faults)
        own = self.expected.diagnostics
        others = [own.response] if own is not None else []
        if self.resets is not None:
            others += [self.resets.request, self.resets.response]
        return Asked(*found, self.rate, self.longest_gap, frozenset(others), is_off)

    @property
    def resets(self) -> Diagnostics | None:
        """By which the bench resets the ECU over UDS; None: not so."""
        reset = self.rig.driver.reset
        return self.rig.diagnostics if reset is not None and reset.way == "uds" else None


@dataclass(frozen=True)
class Judged:
    """What came of the expectations, and what pictures of them are made of."""

    verdicts: dict[str, Verdict]
    sketches: Mapping[str, Sketch]
    ticks: int
    last: float  # s, of the last row
    notes: Sequence[str]
    fault_notes: tuple[str, ...] = ()


def expectations_of(
    scenario: str | Path | Scenario,
    *,
    parameters: Mapping[str, float] | None = None,
    vehicle: str | Path | Vehicle | None = None,
    rig: str | Path | Rig | None = None,
) -> Expectations:
    """What a scenario expects, see `judge`. Raises ConfigError."""
    setup = session.setup_of(scenario, parameters=parameters, vehicle=vehicle)
    chosen = _rig_of(rig, setup.scenario)
    expected = expected_in(setup, chosen)
    if not expected.expectations:
        raise ConfigError(f"{setup.scenario.source}: expect: missing; allowed: [[expect]] tables")
    return Expectations(setup, chosen, expected)


def judged(
    paths: Sequence[Path],
    about: Expectations,
    is_sketched: bool = False,
    stopped: Callable[[], bool] = lambda: False,
) -> Judged:
    """Judge the recordings of one run; `is_sketched`: for pictures, too. Raises ConfigError, and
    StoppedJudgingError where it is stopped on the way.
    """
    if paths and all(_holds_nothing(path) for path in paths):
        count = len(about.expected.expectations) - about.expected.awaited
        names = [each.name for each in about.expected.expectations[:count]]
        reason = "nothing was recorded"
        nothing = {name: Verdict(name, INCONCLUSIVE, reason=reason) for name in names}
        return Judged(nothing, {}, 0, 0.0, ())
    run = read_run(paths, about.asked)
    scenario = about.setup.scenario
    end = scenario.duration if about.duration is None else about.duration
    last = float(run.times[-1])
    tolerance = silence = math.inf
    if about.rig.inputs:
        tolerance, silence = tolerance_of(scenario, about.rig), silence_of(scenario, about.rig)
    found = Judge(about.expected, run.rate, last if end is None else end, tolerance, silence)
    sketcher = Sketcher(found, run.rate) if is_sketched else None
    watch = None if about.resets is None else ResetWatch(about.resets)
    for rows, frames in run.blocks():
        if stopped():
            raise StoppedJudgingError
        found.take(rows, frames)
        if watch is not None:
            watch.take(frames)
        if sketcher is not None:
            sketcher.take(rows, frames)
    gaps = [*run.gaps, *_lacking(about, run, last)]
    verdicts = [
        _explained(each, run, about.expected.names(place))
        for place, each in enumerate(
            found.verdicts(
                late=_not_made(about, run, watch, end),
                gaps=gaps,
                again=functools.partial(_stepped_again, paths, about, found, []),
            )
        )
    ]
    sketches = {} if sketcher is None else sketcher.sketches()
    by_name = {each.name: each for each in verdicts}
    return Judged(by_name, sketches, len(run.times), last, run.notes, tuple(found.notes()))


def _stepped_again(
    paths: Sequence[Path],
    about: Expectations,
    judge: Judge,
    made: list[StepsAgain | None],
    late: float,
) -> SteppedAgain | None:
    """The gate of a recorded run stepped again, see `judging.stepped_again`; `made` keeps what steps it. None
    where the recording does not tell enough: no commands or not the gate's angle, a start that a precondition has
    left, or another gate.
    """
    if not made:
        made.append(_steps_again(paths, about, judge))
    return None if made[0] is None else made[0](late)


def _steps_again(paths: Sequence[Path], about: Expectations, judge: Judge) -> StepsAgain | None:
    setup, rig = about.setup, about.rig
    if setup.scenario.precondition or not rig.inputs or about.mapping:
        return None
    commands = frozenset(rig.identifier(each.message) for each in rig.inputs)
    asked = replace(
        about.asked,
        columns=about.asked.columns | {"gate_angle_deg"},
        others=about.asked.others | commands,
    )
    run = read_run(paths, asked)
    if not run.has_frames or run.lacks("gate_angle_deg") or run.lacks("ticks_missed"):
        return None
    rate = float(f"{run.rate:.6g}")  # an estimate, from times in microseconds
    config = session.loop_config_of(setup.vehicle, rig, rate, setup.seed)
    scene = staged(setup, rig, is_on_bus=False)
    start = session.start_of(config, setup.start_angle)
    return StepsAgain(
        begun=Begun(config, start, scene),
        frames=heard_by(rig, run.frames, judge.expected, scene),
        ticks=len(run.times) - 1,
        rig=rig,
        drives=setup.vehicle.drives,
        expected=judge.expected,
        rate=rate,
        end=judge.end,
        angles=run.tracks["gate_angle_deg"].held(rounded_to_us(run.times)),
    )


def _not_made(
    about: Expectations, run: RecordedRun, watch: ResetWatch | None, end: float | None
) -> str:
    """What the run, to its `end` [s], could not make of what was asked for, as far as its frames show it; its rows
    tell the rest.
    """
    found = "" if watch is None else reset_failure(watch.failure, about.rig)
    is_asked = about.asked.may_be_silent or any(
        each.action == "reset" for each in about.setup.scenario.requests
    )
    is_ours = not run.lacks("ticks_missed")
    if found or not (is_asked and is_ours):
        return found
    if run.lacks("stimuli_not_made"):
        return "not in the recording: stimuli_not_made"
    if end is not None and float(run.times[-1]) < end - 1.5 / run.rate:
        return f"not in the recording: what the bench has made, to the end at {end:g} s"
    return ""


def _lacking(about: Expectations, run: RecordedRun, last: float) -> Iterator[Gap]:
    """What stimuli wait for, and the run, to `last` [s], has nothing of."""
    expected = about.expected
    for place in range(len(expected.expectations) - expected.awaited, len(expected.expectations)):
        lacking = frozenset(name for name in expected.names(place) if run.lacks(name))
        if lacking:
            yield Gap(0.0, last, lacking)


def _holds_nothing(path: Path) -> bool:
    with contextlib.suppress(ConfigError, OSError):  # told by who reads it
        return holds_nothing(path)
    return False


def _explained(verdict: Verdict, run: RecordedRun, names: Sequence[str]) -> Verdict:
    """A verdict that says what the recording lacks."""
    lacking = [name for name in names if run.lacks(name)]
    if verdict.verdict != INCONCLUSIVE or not lacking:
        return verdict
    return replace(verdict, reason=f"not in the recording: {', '.join(lacking)}")


def _rig_of(rig: str | Path | Rig | None, scenario: Scenario) -> Rig:
    """As `session.rig_of`, or of a database alone. Raises ConfigError."""
    if not isinstance(rig, str | Path) or Path(rig).suffix.lower() not in KINDS:
        return session.rig_of(rig, scenario)
    issues = ConfigIssues(f"`rig` {rig}")
    messages = load_messages(issues, Path(rig))
    issues.raise_if_any()
    return Rig(Path(rig), _BITRATE, messages, (), (), {}, False, str(rig))
