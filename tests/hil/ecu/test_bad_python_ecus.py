"""Python ECUs that violate the interface: the run ends with the cause, and its caller continues."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest
from hil_support import COMMAND, OPEN, both, command_payload, shipped_rig
from run_support import ScriptedEcu, message, run_kept

import liftgate_hil as lh
from liftgate_hil.config.scenario import Scenario
from liftgate_hil.ecu import wire
from liftgate_hil.errors import ConfigError
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.requests import Request
from liftgate_hil.stimuli.stimulus_plan import NO_STIMULI

SCENARIO = Scenario(NO_STIMULI, (), 0.2)
GOOD = [message(COMMAND, command_payload(shipped_rig(), n, **both(20.0, OPEN, 1))) for n in range(16)]


class Unusual(BaseException):
    """An exception that derives from BaseException, but not from Exception."""


class Speechless(Exception):
    """An exception whose `str` and `repr` raise ZeroDivisionError."""

    def __str__(self) -> str:
        return str(1 // 0)

    __repr__ = __str__


def raising(error: BaseException) -> Callable[[], Any]:
    """Return a function that raises this error."""

    def raise_it() -> Any:
        raise error

    return raise_it


HERE = r" \(test_bad_python_ecus\.py, line \d+\)"
BAD: dict[str, tuple[Callable[[], Any], str]] = {
    "ValueError": (raising(ValueError("no such thing")), f"ValueError: no such thing{HERE}"),
    "without a text": (raising(KeyError()), f"KeyError: {HERE}"),
    "SystemExit": (raising(SystemExit(3)), f"SystemExit: 3{HERE}"),
    "GeneratorExit": (raising(GeneratorExit()), f"GeneratorExit: {HERE}"),
    "BaseException": (raising(Unusual("odd")), f"Unusual: odd{HERE}"),
    "no words": (raising(Speechless()), rf"Speechless: \(its str raised ZeroDivisionError\){HERE}"),
    "no repr": (Speechless, r"its step gave a Speechless \(its repr raised ZeroDivisionError\); allowed: .*"),
    "number": (lambda: 5, r"its step gave 5; allowed: a list of can\.Message, or None"),
    "text": (lambda: "ab", r"its step gave 'ab'; allowed: a list of can\.Message, or None"),
    "False": (lambda: False, r"its step gave False; allowed: a list of can\.Message, or None"),
    "generator": (
        lambda: (each for each in GOOD),
        r"its step gave <generator .*; allowed: a list of can\.Message, or None",
    ),
    "one message": (lambda: GOOD[0], r"its step gave .*; allowed: a list of can\.Message, or None"),
    "list of numbers": (lambda: [5], r"its step gave 5; allowed: a list of can\.Message"),
    "list of None": (lambda: [GOOD[0], None], r"its step gave None; allowed: a list of can\.Message"),
    "too many": (lambda: [message(0x400)] * (wire.CAPACITY + 1), "its step gave 1025 frames; allowed: up to 1024"),
    "too long": (
        lambda: [can.Message(arbitration_id=0x400, data=bytes(9), dlc=9, check=False)],
        r"its step gave can\.Message\(.*allowed: up to 8 bytes, with CAN FD 64",
    ),
    "too long for CAN FD": (
        lambda: [can.Message(arbitration_id=0x400, data=bytes(65), dlc=65, is_fd=True, check=False)],
        r"its step gave can\.Message\(.*allowed: up to 8 bytes, with CAN FD 64",
    ),
    "no identifier": (
        lambda: [can.Message(arbitration_id=-1, check=False)],
        r"its step gave .*allowed: identifiers of 11 bits, extended ones of 29",
    ),
}


@pytest.mark.parametrize("clock", ["free", "lockstep"])
@pytest.mark.parametrize("kind", BAD)
def test_an_exception_or_wrong_answer_is_reported_and_the_caller_continues(kind: str, clock: str) -> None:
    answer, reason = BAD[kind]
    ecu = ScriptedEcu(lambda turn: answer() if turn == 5 else [GOOD[turn]])
    result = lh.run(SCENARIO, ecu, clock)
    assert result.verdict == "error"
    assert re.fullmatch(rf"the ECU at 0\.050 s: {reason}", result.reason), result.reason
    assert len(ecu.heard) == 6  # it is not asked again
    assert lh.run(SCENARIO, ScriptedEcu(lambda turn: [GOOD[turn % 16]]), clock).verdict == "pass"


@pytest.mark.parametrize("clock", ["free", "lockstep"])
@pytest.mark.parametrize("turn", [0, 19])
def test_an_exception_in_the_first_or_last_step_is_reported(turn: int, clock: str) -> None:
    ecu = ScriptedEcu(lambda now: raising(ValueError("odd"))() if now == turn else [GOOD[now % 16]])
    result = lh.run(SCENARIO, ecu, clock)
    assert result.verdict == "error"
    assert result.reason.startswith(f"the ECU at {0.01 * turn:.3f} s: ValueError: odd")


def test_rows_up_to_an_exception_are_kept() -> None:
    ecu = ScriptedEcu(lambda turn: raising(ValueError("odd"))() if turn == 5 else [])
    result, keeper = run_kept(SCENARIO, ecu)
    assert result.verdict == "error"
    assert result.summary.ticks == len(keeper.rows) == 50
    assert result.maxima["time_s"] == pytest.approx(0.05)


def test_recordings_up_to_an_exception_are_kept(tmp_path: Path) -> None:
    paths = [tmp_path / "plant.csv", tmp_path / "bus.log"]
    ecu = ScriptedEcu(lambda turn: raising(ValueError("odd"))() if turn == 5 else [])
    result = lh.run(SCENARIO, ecu, record=paths)
    assert (result.verdict, result.recording) == ("error", tuple(paths))
    assert len(paths[0].read_text().splitlines()) == 51
    assert len(paths[1].read_text().splitlines()) == 6 * 10 + 2 * 5


@pytest.mark.parametrize("clock", ["free", "lockstep"])
def test_an_exception_in_a_request_ends_the_run(clock: str) -> None:
    class Deaf(ScriptedEcu):
        def request(self, action: str) -> None:
            raise ValueError(f"cannot {action}")

    scenario = Scenario(NO_STIMULI, (Request(Instant(0.035), "open"), Request(Instant(0.1), "close")), 0.2)
    ecu = Deaf(lambda turn: [GOOD[turn % 16]])
    result = lh.run(scenario, ecu, clock)
    assert result.verdict == "error"
    # Noticed at its next step.
    assert re.fullmatch(rf"the ECU at 0\.040 s: ValueError: cannot open{HERE}", result.reason)
    assert len(ecu.heard) == 4


@pytest.mark.parametrize("clock", ["free", "lockstep"])
def test_a_step_method_with_a_wrong_signature_is_reported(clock: str) -> None:
    class Odd:
        def step(self) -> list[can.Message]:
            return []

    result = lh.run(SCENARIO, Odd(), clock)
    assert result.verdict == "error"
    assert re.match(r"the ECU at 0\.000 s: TypeError: .*step\(\) takes 1 positional", result.reason)


@pytest.mark.parametrize("clock", ["free", "lockstep"])
def test_ctrl_c_during_a_step_reaches_the_caller(clock: str) -> None:
    ecu = ScriptedEcu(lambda turn: raising(KeyboardInterrupt())() if turn == 5 else [GOOD[turn]])
    with pytest.raises(KeyboardInterrupt):
        lh.run(SCENARIO, ecu, clock)
    assert lh.run(SCENARIO, ScriptedEcu(lambda turn: [GOOD[turn % 16]]), clock).verdict == "pass"


# What cannot be an ECU is told before anything runs.


class Rude:
    """A class whose construction raises."""

    def __init__(self) -> None:
        raise RuntimeError("not today")


class Waits:
    """An ECU whose step is a coroutine, which nobody awaits."""

    async def step(self, now_s: float, frames: list[can.Message]) -> None:
        """Do nothing."""


@pytest.mark.parametrize(
    ("ecu", "told"),
    [
        (None, "step"),
        (object(), "step"),
        (5, "step"),
        (ScriptedEcu, "step"),  # a class, not an object of it
        ("nonsense", "reference, the path of a shared library, MODULE:CLASS"),
        ("", "reference"),
        ("no_such_module:Class", "no_such_module"),
        ("json:NoSuchClass", "NoSuchClass"),
        ("json:dumps", "MODULE:CLASS"),
        ("echo_ecu:Picky", "needed"),
        ("echo_ecu:ECHO_STEPS", "callable"),
        ("builtins:object", "step"),
        ("test_bad_python_ecus:Rude", "RuntimeError: not today"),
        ("broken_ecu:Ecu", "SyntaxError"),
        ("raising_ecu:Ecu", "ZeroDivisionError"),
        ("nowhere/ecu.so", "no such file"),
        (f"{__name__}:Waits", r"its step is async; allowed: def step\(now_s, frames\)"),
    ],
)
@pytest.mark.parametrize("clock", ["free", "lockstep"])
def test_an_object_or_name_that_is_no_ecu_is_refused(
    ecu: Any, told: str, clock: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_ecu.py").write_text("class Ecu\n")
    (tmp_path / "raising_ecu.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ConfigError, match=f"ecu.*{told}"):
        lh.run(SCENARIO, ecu, clock)
    for name in ("broken_ecu", "raising_ecu"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize("period", [0, 0.0, -0.01, float("nan"), float("inf"), 61.0, "10", [0.01]])
def test_an_invalid_period_is_refused(period: Any) -> None:
    with pytest.raises(ConfigError, match=r"period_s.*allowed: 1e-6 to 60 s"):
        lh.run(SCENARIO, ScriptedEcu(lambda turn: [], period_s=period))


def test_an_exception_in_a_python_library_is_reported_with_the_ecus_own_line(tmp_path: Path) -> None:
    from liftgate_hil.errors import place_of

    library = tmp_path / "site-packages" / "theirs.py"
    library.parent.mkdir()
    library.write_text("\n\ndef fail():\n    raise ValueError\n")
    names: dict[str, Any] = {}
    exec(compile(library.read_text(), str(library), "exec"), names)
    exec(compile("\ndef step():\n    fail()\n", str(tmp_path / "mine.py"), "exec"), names)
    with pytest.raises(ValueError) as caught:
        names["step"]()
    assert place_of(caught.value) == " (mine.py, line 3)"
