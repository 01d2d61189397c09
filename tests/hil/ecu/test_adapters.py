"""The contract of every adapter (reference ECU, C library, Python object), in an episode and as a bus peer."""

from __future__ import annotations

import re
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import c_ecu
import pytest
from c_library import build, needs_compiler
from echo_ecu import ECHO_REQUEST, ECHO_STEPS, Echo, Opener
from hil_support import LEFT_DRIVE, RIGHT_DRIVE, loop_config, start_of, stimulus_plan
from run_support import Keeper, ScriptedEcu, episode_of, run_kept

import liftgate_hil as lh
from liftgate_hil.codec.receive import NO_COUNTS
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.config.shipped import find_config
from liftgate_hil.ecu.adapter import Adapter, ReferenceEcu
from liftgate_hil.ecu.find import adapter_for
from liftgate_hil.ecu.peer import Peer
from liftgate_hil.formats.content import Content
from liftgate_hil.formats.open import open_writer
from liftgate_hil.isolate.recorders import RecordingSink
from liftgate_hil.loop.python_loop import Loop, run_free
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.requests import Request, by_the_clock
from liftgate_hil.stimuli.stimulus_plan import NO_STIMULI
from liftgate_hil.transport.can_bus import CanTransport

HERE = Path(__file__).parent


class Line(NamedTuple):
    """A line of a bus log; `tick` is its time [ms]."""

    tick: int
    identifier: int
    is_extended: bool
    payload: bytes


def lines_of(path: Path) -> list[Line]:
    """Return the lines of a candump log, each with its time as a tick of 1 ms."""
    found = []
    for line in path.read_text().splitlines():
        match = re.fullmatch(r"\(([\d.]+)\) \S+ ([0-9A-F]+)#([0-9A-F]*) [RT]", line)
        assert match, line
        found.append(
            Line(round(float(match[1]) * 1e3), int(match[2], 16), len(match[2]) == 8, bytes.fromhex(match[3]))
        )
    return found


def in_an_episode(ecu: Any, scenario: Scenario, log: Path) -> list[Line]:
    """Run an ECU in an episode, which must pass; return the lines of the bus log."""
    result = lh.run(scenario, ecu, record=[log])
    assert result.verdict == "pass", result.reason
    return lines_of(log)


def as_a_peer(ecu: Any, scenario: Scenario, log: Path) -> list[Line]:
    """Run an ECU as a peer on a virtual bus, ticked from Python; return the lines of the bus log."""
    channel = str(uuid.uuid4())
    ours, theirs = (CanTransport({"interface": "virtual", "channel": channel}) for _ in range(2))
    config = loop_config()
    content = Content((), "bus")
    recorder = open_writer(log, content)
    recording = RecordingSink([recorder], content)
    with adapter_for(ecu, lh.load_rig(shipped()), 2) as adapter:
        peer = Peer(adapter, theirs, by_the_clock(scenario.requests))
        around = stimulus_plan(config, scenario.stimuli)
        loop = Loop(config, start_of(config), around, ours, sinks=[recording], peers=[peer])
        loop.begin()
        run_free(loop, round(1e3 * (scenario.duration or 0.0)), lambda: False)
        loop.finish()
        peer.finish()
    recording.flush()
    for each in (recorder, ours, theirs):
        each.close()
    return lines_of(log)


def shipped() -> Path:
    return find_config("rigs", "liftgate")


@pytest.fixture(scope="module")
def echo_library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("echo"), (HERE / "echo.c").read_text())


WAYS = [in_an_episode, as_a_peer]
KINDS = [pytest.param("library", marks=needs_compiler), "object", "echo_ecu:Echo"]


@pytest.fixture
def make(request: pytest.FixtureRequest) -> Callable[[str], Any]:
    """Return a function that makes the argument `ecu` of a run for a kind of ECU out of KINDS."""

    def made(kind: str) -> Any:
        if kind == "library":
            return str(request.getfixturevalue("echo_library"))
        return Echo() if kind == "object" else kind

    return made


# The contract.


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", KINDS)
def test_an_ecu_gets_each_frame_once_in_order_and_its_frames_are_received_a_tick_later(
    make: Callable[[str], Any], way: Callable[..., list[Line]], kind: str, tmp_path: Path
) -> None:
    lines = way(make(kind), Scenario(NO_STIMULI, (), 0.3), tmp_path / "bus.log")
    gates = [line for line in lines if not line.is_extended and line.identifier != ECHO_STEPS]
    echoes = [line for line in lines if line.is_extended]
    assert len(gates) > 150
    # What the gate said at the end has no answer any more.
    assert echoes == [line._replace(tick=line.tick + 1, is_extended=True) for line in gates if line.tick < 300]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", KINDS)
def test_an_ecu_gets_requests_at_their_time_before_its_step(
    make: Callable[[str], Any], way: Callable[..., list[Line]], kind: str, tmp_path: Path
) -> None:
    asked = [
        (0.0, "open"), (0.05, "close"), (0.05, "stop"), (0.05, "open"), (0.0704, "stop"), (0.2, "open")
    ]  # fmt: skip
    scenario = Scenario(NO_STIMULI, tuple(Request(Instant(time), action) for time, action in asked), 0.1)
    lines = way(make(kind), scenario, tmp_path / "bus.log")
    heard = [
        (line.tick, line.identifier - ECHO_REQUEST, int.from_bytes(line.payload, "little"))
        for line in lines
        if ECHO_REQUEST <= line.identifier < ECHO_REQUEST + 3
    ]
    # Obeyed in the step at that time or the first after it, and read one tick later; those at one time in order.
    assert heard == [
        (1, 1, 0), (51, 2, 50_000_000), (51, 0, 50_000_000), (51, 1, 50_000_000), (72, 0, 71_000_000)
    ]  # fmt: skip


@pytest.mark.parametrize("kind", [each for each in KINDS if each != "object"])
def test_a_named_ecu_is_made_anew_for_each_run(make: Callable[[str], Any], kind: str, tmp_path: Path) -> None:
    scenario, logs = Scenario(NO_STIMULI, (), 0.05), []
    for number in range(2):
        path = tmp_path / f"{number}.log"
        lines = in_an_episode(make(kind), scenario, path)
        told = [line for line in lines if line.identifier == ECHO_STEPS]
        assert [(line.tick, line.payload) for line in told] == [(1, bytes(4))]
        logs.append(path.read_bytes())
    assert logs[0] == logs[1]


def test_a_python_object_keeps_its_state_between_runs(tmp_path: Path) -> None:
    ecu, scenario = Echo(), Scenario(NO_STIMULI, (), 0.05)
    for steps in (0, 51):
        lines = in_an_episode(ecu, scenario, tmp_path / "bus.log")
        told = [line.payload for line in lines if line.identifier == ECHO_STEPS]
        assert told == [steps.to_bytes(4, "little")]


@needs_compiler
@pytest.mark.parametrize("way", WAYS)
def test_a_library_creates_its_ecu_once_and_destroys_it_at_the_end(
    way: Callable[..., list[Line]], echo_library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    notes = tmp_path / "notes"
    monkeypatch.setenv("LIFTGATE_TEST_NOTES", str(notes))
    way(str(echo_library), Scenario(NO_STIMULI, (), 0.02), tmp_path / "bus.log")
    assert notes.read_text().split() == ["created", "destroyed"]


@needs_compiler
def test_equivalent_ecus_in_c_and_python_give_the_same_run(echo_library: Path, tmp_path: Path) -> None:
    scenario = Scenario(NO_STIMULI, (Request(Instant(0.02), "open"),), 0.1)
    for name, ecu in (("c", echo_library), ("python", Echo())):
        in_an_episode(ecu, scenario, tmp_path / f"{name}.log")
    assert (tmp_path / "c.log").read_bytes() == (tmp_path / "python.log").read_bytes()


# The reference ECU.


@pytest.mark.parametrize("drives", [1, 2])
def test_the_reference_ecu_receives_each_frame_of_the_gate(rig: Rig, drives: int) -> None:
    keeper = Keeper()
    with ReferenceEcu(rig, drives) as adapter:
        episode = episode_of([keeper], adapter)
        episode.run(500)
        sent = len(keeper.wires(is_sent=True))
        # The counters of LeftDrive and RightDrive have told of every gap.
        assert adapter.state.reference.counts == NO_COUNTS._replace(accepted=sent)
        assert adapter.events() != []
        assert adapter.events(since=1) == adapter.events()[1:]
        episode.close()


def test_the_reference_ecu_is_made_anew_for_each_run() -> None:
    runs = [lh.run("demo", duration=3.0) for _ in range(2)]
    assert runs[0].events == runs[1].events
    assert runs[0].summary == runs[1].summary


def test_without_an_ecu_only_the_gate_sends_frames(rig: Rig) -> None:
    keeper = Keeper()
    with Adapter(rig, 2) as adapter:
        episode = episode_of([keeper], adapter)
        episode.run(100)
        assert adapter.events() == []
        assert adapter.last_frames() is None
        episode.close()
    assert keeper.wires(is_sent=False) == []
    assert len(keeper.wires(is_sent=True)) == 6 * 20 + 2 * 10 + 1 + 1


# When a Python object is visited.


@pytest.mark.parametrize(
    ("period_s", "rate", "expected_ms"),
    [
        (None, 1000.0, [0, 10, 20, 30, 40]),  # the rig's cycle
        (0.001, 1000.0, list(range(50))),
        (0.004, 1000.0, list(range(0, 50, 4))),
        (0.0015, 1000.0, [0, 2, 3, 5, 6, 8, 9, 11, 12, 14, 15]),
        (0.0001, 1000.0, list(range(50))),
        (0.005, 500.0, [0, 6, 10, 16, 20, 26, 30, 36, 40, 46]),
        (1.0, 1000.0, [0]),
    ],
)
def test_a_python_ecu_is_called_every_period_with_all_frames_since_the_last_call(
    period_s: float | None, rate: float, expected_ms: list[int]
) -> None:
    ecu = ScriptedEcu(lambda turn: [], period_s=period_s)
    result = lh.run(Scenario(NO_STIMULI, (), 0.05), ecu, rate=rate)
    assert result.verdict == "pass"
    times = [round(1e3 * now, 6) for now, _ in ecu.heard if now < 0.05]
    assert times[: len(expected_ms)] == expected_ms
    # A message of cycle T comes at each multiple of T; nothing is lost between two visits.
    last = ecu.heard[-1][0]
    for identifier in (LEFT_DRIVE, RIGHT_DRIVE):
        frames = [each for _, heard in ecu.heard for each in heard if each.arbitration_id == identifier]
        assert len(frames) == int(last / 0.005 + 1e-6)
        assert [each.data[6] & 15 for each in frames] == list(range(len(frames)))
    for now, heard in ecu.heard:
        assert {each.timestamp for each in heard} <= {now}


def test_a_python_ecu_that_returns_nothing_sends_no_frames() -> None:
    for answer in (None, [], ()):
        result, _ = run_kept(Scenario(NO_STIMULI, (), 0.05), ScriptedEcu(lambda turn, a=answer: a))
        assert result.verdict == "pass"
        assert result.summary.received == NO_COUNTS


# ECUs that drive.


@pytest.mark.parametrize("clock", ["free", "lockstep"])
@pytest.mark.parametrize("kind", ["object", "echo_ecu:Opener"])
def test_a_simple_python_ecu_opens_the_gate(kind: str, clock: str) -> None:
    ecu = Opener() if kind == "object" else kind
    scenario = Scenario(NO_STIMULI, (Request(Instant(0.2), "open"),), 2.0)
    result = lh.run(scenario, ecu, clock, trace=True)
    assert result.verdict == "pass", result.reason
    assert result.summary.received == NO_COUNTS._replace(accepted=200)
    assert result.summary.command_timeouts == 0
    angle = result.trace["gate_angle_deg"]
    assert angle[199] == 0.0
    assert angle[200] > 0.0
    assert angle[-1] > 8.0
    if isinstance(ecu, Opener):
        assert ecu.angles[-1] == pytest.approx(angle[-2], abs=0.1)


@c_ecu.needs_compiler
def test_the_example_library_opens_the_gate_identically_on_free_and_lockstep_clocks(example_library: Path) -> None:
    """Needs a build of the whole example."""
    scenario = Scenario(NO_STIMULI, (Request(Instant(0.2), "open"),), 2.0)
    runs = [lh.run(scenario, example_library, clock, trace=True) for clock in ("free", "lockstep")]
    for run in runs:
        assert run.verdict == "pass", run.reason
        assert run.summary.received == NO_COUNTS._replace(accepted=200)
        assert run.maxima["gate_angle_deg"] > 5.0
    for name, column in runs[0].trace.items():
        assert column.tobytes() == runs[1].trace[name].tobytes()
