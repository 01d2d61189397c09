"""The line that says how far a suite has come: on a terminal, and nowhere else."""

from __future__ import annotations

import io
import pickle
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from liftgate_hil.cli.main import main
from liftgate_hil.cli.suite_line import CompilingOnly, SuiteLine
from liftgate_hil.cli.teller import Teller

PASSES = 'duration = 0.05\n[[expect]]\nname = "rests"\nalways = "gate_angle_deg < 1"\n'
FAILS = PASSES.replace("< 1", "> 1")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Pipe(io.StringIO):
    pass


def told(monkeypatch: pytest.MonkeyPatch, stream: io.StringIO, *flags: str) -> list[str]:
    """What a suite of three writes there, one state of the line after the other."""
    monkeypatch.setattr("liftgate_hil.cli.teller.sys", SimpleNamespace(stderr=stream))
    for name, content in (("a", PASSES), ("b", FAILS), ("c", PASSES)):
        Path(f"{name}.toml").write_text(content)
    assert main(["test", "a.toml", "b.toml", "c.toml", "--jobs", "1", *flags]) == 1
    states = [each.removesuffix("\x1b[K") for each in stream.getvalue().split("\r")[1:]]
    return [each for each in states if "compil" not in each]  # where nothing is on the disk yet


def test_a_terminal_sees_one_line_that_follows_the_suite(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    states = told(monkeypatch, Terminal())
    assert [each for each in states if each] == [
        "0/3 done  1 running: a.toml",
        "1/3 done",
        "1/3 done  1 running: b.toml",
        "2/3 done  1 failed",
        "2/3 done  1 failed  1 running: c.toml",
        "3/3 done  1 failed",
    ]
    assert states[-1] == ""  # nothing is left of it
    assert "\n" not in "".join(states)


@pytest.mark.parametrize("flags", [(), ("--quiet",), ("--json", "-")])
def test_a_pipe_sees_nothing_of_it(
    flags: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert told(monkeypatch, Pipe(), *flags) == []


@pytest.mark.parametrize("flags", [("--quiet",), ("--json", "-")])
def test_who_wants_quiet_or_json_sees_no_line(
    flags: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert told(monkeypatch, Terminal(), *flags) == []


def test_what_begins_while_something_is_printed_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Terminal()
    monkeypatch.setattr("liftgate_hil.cli.teller.sys", SimpleNamespace(stderr=stream))
    line = SuiteLine(Teller(is_quiet=False), 2)
    case: Any = SimpleNamespace(file="a.toml")
    line.began(case)
    with line.aside():
        other = threading.Thread(target=line.began, args=(case,))
        other.start()
        other.join(0.05)
        assert stream.getvalue().endswith("\r\x1b[K")  # the line is away
    other.join()
    assert stream.getvalue().endswith("2 running: a.toml, a.toml\x1b[K")


def test_who_waits_for_machine_code_is_reported() -> None:
    said: list[str] = []

    class Hears(Teller):
        def compiles(self, name: str, seconds: float, expected: float | None = None) -> None:
            said.append(name)

    listener = pickle.loads(pickle.dumps(CompilingOnly(Teller(is_quiet=True))))
    listener.compiles("the loop", 1.0)
    listener = CompilingOnly(Hears(is_quiet=False))
    listener.compiles("compiling the loop", 1.0)
    listener.starts("suv without a bus")
    assert said == ["compiling the loop"]


def test_the_line_counts_what_does_not_pass_and_names_what_runs() -> None:
    line = SuiteLine(Teller(is_quiet=True), 5)

    def case(name: str) -> Any:
        return SimpleNamespace(file=f"suite/{name}.toml")

    for name in ("a", "b", "c"):
        line.began(case(name))
    for name, verdict in (("a", "inconclusive"), ("c", "error")):
        line.ended(SimpleNamespace(case=case(name), verdict=verdict))  # type: ignore[arg-type]
    assert line.line() == "2/5 done  1 with errors  1 inconclusive  1 running: b.toml"
