"""pytest plugin: the fixture `liftgate`, and scenario files `test_*.toml` as tests.

    def test_reverses(liftgate):
        result = liftgate.run("scenario.toml", ecu="my_ecu:Ecu")
        assert result.expectations["reverses"].verdict == "pass"

An expectation that is inconclusive, or an error, is an error of pytest's, not a failure.
"""

from __future__ import annotations

import itertools
import re
import shutil
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import pytest

from liftgate_hil.ecu.names import ON_A_BUS, REFERENCE

if TYPE_CHECKING:
    from liftgate_hil.drive.gate import Gate
    from liftgate_hil.drive.result import Result
    from liftgate_hil.judging.verdict import Verdict
    from liftgate_hil.plan.request import Job
    from liftgate_hil.testing.outcome import Case, Outcome

_PACKAGE = Path(__file__).parents[1]
_GROUP = "liftgate-bus"
_NOT_IN_A_NODE = re.compile(r"::+|[\[\]\x00-\x1f\x7f]")
_INSTEAD = {"[": "(", "]": ")", ":": "."}  # replacements, by the first character
_FAILED = pytest.StashKey[bool]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the plugin's command-line options."""
    group = parser.getgroup("liftgate", "lift gate emulator")
    purpose = "for scenario files and the fixture"
    group.addoption("--liftgate-ecu", metavar="reference|LIBRARY|MODULE:CLASS|bus", help=f"the ECU {purpose}")
    group.addoption("--liftgate-bus", metavar="INTERFACE:CHANNEL", help="the bus with the ECU")
    group.addoption("--liftgate-vehicle", metavar="NAME|FILE", help=f"the vehicle {purpose}")
    group.addoption("--liftgate-rig", metavar="NAME|FILE", help=f"the rig {purpose}")


def pytest_configure(config: pytest.Config) -> None:
    """Set xdist's --dist to loadgroup if tests are distributed and --liftgate-bus is given.

    All tests on the bus then run in one worker, as only one may use it at a time.
    """
    if config.getoption("liftgate_bus") and getattr(config.option, "dist", "no") != "no":
        config.option.dist = "loadgroup"


def pytest_report_header(config: pytest.Config) -> str | None:
    """Return the header line on what this machine denies to real-time runs; None: nothing, or no bus is given."""
    if not config.getoption("liftgate_bus"):
        return None
    from liftgate_hil.loop.priority import in_one_line, refused_here

    refused = refused_here()
    return f"liftgate: {in_one_line(refused)}" if refused else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put all tests on the bus into one xdist group, see `pytest_configure`."""
    if not config.getoption("liftgate_bus") or not config.pluginmanager.hasplugin("xdist"):
        return
    for item in items:
        if isinstance(item, ExpectationItem) or "liftgate" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.xdist_group(_GROUP))


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """Collect a scenario file whose name begins with test_; other tools' TOML files are left out."""
    if file_path.suffix != ".toml" or not file_path.name.startswith("test_"):
        return None
    from liftgate_hil.testing.scenario_files import may_be_scenario

    return (
        ScenarioCollector.from_parent(parent, path=file_path) if may_be_scenario(file_path, is_test=True) else None
    )


class ScenarioCollector(pytest.File):
    """A scenario file as a collector; it is run once, for the first of its expectations that is run."""

    _case: Case
    _outcome: Outcome | None = None

    def collect(self) -> Iterator[pytest.Item]:
        """Yield a test item for each expectation of the scenario. Raises CollectError for an invalid file."""
        from liftgate_hil.errors import ConfigError
        from liftgate_hil.testing.suite import cases_of

        try:
            _allow_imports_from_root(self.config)
            (self._case,) = cases_of([self.path], _template(self.config))
        except ConfigError as error:
            raise self.CollectError("\n".join(error.issues)) from None
        names = [each.name for each in self._case.plan.setup.scenario.expectations]
        for name, own in zip(names, node_names(names), strict=True):
            yield ExpectationItem.from_parent(self, name=own, expectation=name)

    def outcome(self) -> Outcome:
        """Return the outcome of the scenario; the first call runs it."""
        from liftgate_hil.testing.suite import run_case

        if self._outcome is None:
            self._outcome = run_case(self._case)
        return self._outcome


def node_names(names: Sequence[str]) -> list[str]:
    """Return the names of expectations as unique parts of pytest's node ids.

    They are without `::`, which ends a part, and without brackets, which begin a parameter's; `--lf`, JUnit and
    the command line split an id by them.
    """
    plain = [_NOT_IN_A_NODE.sub(lambda found: _INSTEAD.get(found[0][0], " "), each) for each in names]
    taken = {name for name, own in zip(names, plain, strict=True) if name == own}
    found = []
    for name, own in zip(names, plain, strict=True):
        free = own
        for number in itertools.count(2):
            if name == own or free not in taken:
                break
            free = f"{own} ({number})"
        taken.add(free)
        found.append(free)
    return found


class ExpectationItem(pytest.Item):
    """An expectation of a scenario file, as a test.

    In JUnit it has the properties of its run and, as another one, a name that no node id can have.
    """

    _verdict: Verdict

    def __init__(self, *, expectation: str, **more: Any) -> None:
        super().__init__(**more)
        self._expectation = expectation
        if expectation != self.name:
            self.user_properties.append(("expectation", expectation))

    def setup(self) -> None:
        """Run the scenario; a verdict that is missing or inconclusive is an error of the set-up."""
        assert isinstance(self.parent, ScenarioCollector)
        from liftgate_hil.judging.verdict import line_of
        from liftgate_hil.testing.junit import properties_of

        outcome = self.parent.outcome()
        self._verdict = next(each for each in outcome.expectations if each.name == self._expectation)
        self.user_properties += [*properties_of(outcome), ("verdict", line_of(self._verdict))]
        if outcome.notes:
            self.user_properties.append(("notes", "; ".join(outcome.notes)))
            self.add_report_section("setup", "liftgate notes", "\n".join(outcome.notes))
        if self._verdict.verdict in ("inconclusive", "error"):
            raise NoVerdictError(self._verdict)

    def runtest(self) -> None:
        """Fail the test if the expectation has failed."""
        if self._verdict.verdict != "pass":
            raise NotAsExpectedError(self._verdict)

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> str | Any:
        """Return the reason of a failed or missing verdict in words, without a traceback."""
        if isinstance(excinfo.value, NoVerdictError | NotAsExpectedError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, int | None, str]:
        """Return the file in which the expectation is defined, and its name."""
        return self.path, None, f"{self.path.name}: {self._expectation}"


class _VerdictError(Exception):
    def __init__(self, verdict: Verdict) -> None:
        from liftgate_hil.errors import printable
        from liftgate_hil.judging.verdict import line_of

        super().__init__(printable(f"{verdict.name}: {line_of(verdict)}"))


class NotAsExpectedError(_VerdictError):
    """Raised where an expectation has failed."""


class NoVerdictError(_VerdictError):
    """Raised where an expectation is inconclusive, or its scenario has not reached its end."""


def _allow_imports_from_root(config: pytest.Config) -> None:
    """Make an ECU's module importable from pytest's root folder, which comes last and so hides nothing."""
    folder = str(config.rootpath)
    if folder not in sys.path:
        sys.path.append(folder)


def _template(config: pytest.Config) -> Job:
    """Return the job for scenarios that pytest's options define. Raises ConfigError."""
    from liftgate_hil.plan.request import Job, RunRequest

    bus = config.getoption("liftgate_bus")
    ecu = config.getoption("liftgate_ecu") or (ON_A_BUS if bus else REFERENCE)
    request = RunRequest(
        ecu=ecu,
        clock="realtime" if bus else "free",
        vehicle=config.getoption("liftgate_vehicle"),
        rig=config.getoption("liftgate_rig"),
        bus=bus,
        realtime=None,
    )
    return Job(request, request if bus else None)


class Liftgate:
    """Value of the fixture `liftgate`: makes gates and runs; keeps the recordings of a failed test."""

    def __init__(self, config: pytest.Config, folder: Path) -> None:
        self._config = config
        self._folder = folder
        self._gates: list[Gate] = []
        self._runs = 0
        self._results: list[Result] = []

    def gate(self, **arguments: Any) -> Gate:
        """Return a `liftgate_hil.Gate`, closed at the test's end; vehicle and rig default to pytest's options."""
        from liftgate_hil.drive.gate import Gate

        made = Gate(**self._with_options(arguments, "vehicle", "rig"))
        self._gates.append(made)
        return made

    def _with_options(self, arguments: dict[str, Any], *names: str) -> dict[str, Any]:
        options = {name: self._config.getoption(f"liftgate_{name}") for name in names}
        return {name: value for name, value in options.items() if value is not None} | arguments

    def run(self, scenario: Any = None, **arguments: Any) -> Result:
        """Return the result of `liftgate_hil.run`, recorded; ECU, bus, vehicle and rig default to pytest's."""
        from liftgate_hil.drive.run import run

        arguments = self._with_options(arguments, "ecu", "bus", "vehicle", "rig")
        if arguments.get("bus") is not None:
            arguments.setdefault("ecu", ON_A_BUS)
            arguments.setdefault("clock", "realtime")
        if arguments.get("clock") == "realtime":
            arguments.setdefault("realtime", None)
        self._runs += 1
        stem = self._folder / f"run-{self._runs}"
        arguments.setdefault("record", [f"{stem}.log", f"{stem}.csv"])
        self._folder.mkdir(parents=True, exist_ok=True)
        _allow_imports_from_root(self._config)
        result = run(scenario, **arguments)
        self._results.append(result)
        return result

    def report_sections(self) -> dict[str, str]:
        """Return a failed test's report sections by title: verdicts other than pass, the recordings' folder."""
        from liftgate_hil.errors import printable
        from liftgate_hil.judging.verdict import line_of

        lines = []
        for number, result in enumerate(self._results, 1):
            run = f"run {number}: " if len(self._results) > 1 else ""
            found = [each for each in result.expectations.values() if each.verdict != "pass"]
            lines += [f"{run}{each.name}: {line_of(each)}" for each in found]
            lines += [f"{run}{result.reason}"] if result.verdict == "error" else []
        has_files = self._folder.is_dir() and any(self._folder.iterdir())
        recordings = str(self._folder) if has_files else ""
        return {"verdicts": "\n".join(map(printable, lines)), "recordings": recordings}

    def close(self, is_kept: bool) -> None:
        """Close the gates, and delete the recordings unless they are kept."""
        for each in self._gates:
            each.close()
        if not is_kept:
            shutil.rmtree(self._folder, ignore_errors=True)


def _end_before_our_frames(error: BaseException) -> None:
    """Cut the traceback of a LiftgateError, or a wrong call's TypeError, after the test's line, before our frames.

    What it was raised from is shown only where the test's or the ECU's own code was part of that.
    """
    from liftgate_hil.config import described
    from liftgate_hil.errors import LiftgateError

    frames = _frames_of(error)
    is_of_our_call = bool(frames) and frames[-1].tb_frame.f_code.co_filename in (__file__, described.__file__)
    if not isinstance(error, LiftgateError) and not (isinstance(error, TypeError) and is_of_our_call):
        return
    cause = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    if cause is not None and not any(map(_is_of_the_user, _frames_of(cause))):
        error.__cause__, error.__suppress_context__ = None, True
    last = next((each for each in reversed(frames) if _is_of_the_user(each)), None)
    if last is not None:
        last.tb_next = None


def _frames_of(error: BaseException) -> list[TracebackType]:
    frames, entry = [], error.__traceback__
    while entry is not None:
        frames.append(entry)
        entry = entry.tb_next
    return frames


def _is_of_the_user(entry: TracebackType) -> bool:
    """Whether a frame is of the user's code: not of this package, an installed one, or Python itself."""
    from liftgate_hil.errors import is_of_a_library

    path = Path(entry.tb_frame.f_code.co_filename)
    return path.exists() and not is_of_a_library(path) and _PACKAGE not in path.parents


@pytest.fixture
def liftgate(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Liftgate]:
    """Provide `liftgate.gate(...)` and `liftgate.run(...)`; a failed test's recordings are kept and reported."""
    made = Liftgate(request.config, tmp_path_factory.mktemp("liftgate", numbered=True) / "recordings")
    yield made
    has_failed = request.node.stash.get(_FAILED, False)
    made.close(is_kept=has_failed)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
    """Record on the item that its test has failed; report its recordings, and a missing verdict in words."""
    has_fixture = "liftgate" in getattr(item, "fixturenames", ())
    sections: list[tuple[str, str]] = []
    if call.excinfo is not None and has_fixture:
        _end_before_our_frames(call.excinfo.value)
        used = getattr(item, "funcargs", {}).get("liftgate")
        if isinstance(used, Liftgate):
            sections = [(f"liftgate {what}", text) for what, text in used.report_sections().items() if text]
            item.user_properties += sections  # for JUnit, which shows no sections
    report = yield
    if call.excinfo is not None and isinstance(call.excinfo.value, NoVerdictError):
        report.longrepr = str(call.excinfo.value)
    if report.failed and has_fixture:
        item.stash[_FAILED] = True
        report.sections += sections
    return report
