"""Stop by Ctrl-C or SIGTERM without errors, even if the ECU hangs or the signal comes twice."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from c_library import build, needs_compiler, source_of
from hil_support import wait_for

PATIENCE = 90.0  # s until something must have happened; nothing is judged by it
SIGNALS = [signal.SIGINT, signal.SIGTERM]
HANGS = """
import sys, time

def hang(how):
    sys.stderr.write("it hangs\\n")
    sys.stderr.flush()
    while True:
        try:
            time.sleep(1e-9 if how == "computes" else 1e6)
        except Exception:
            pass

class Ecu:
    def step(self, now_s, frames):
        if now_s > 0.02:
            hang(HOW)

if HOW == "imports":
    hang(HOW)
"""


@contextlib.contextmanager
def process(folder: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [sys.executable, "-m", "liftgate_hil", *arguments],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as child:  # fmt: skip
        try:
            yield child
        finally:
            child.kill()


def stopped_when_it_hangs(folder: Path, number: int, *arguments: str) -> tuple[int, str]:
    """Exit code and error output of a run stopped while its ECU hangs."""
    with process(folder, *arguments) as child:
        assert child.stderr is not None
        assert any(line == "it hangs\n" for line in child.stderr), "it did not come so far"
        child.send_signal(number)
        _, error = child.communicate(timeout=PATIENCE)
    return child.returncode, error


DEMO = ["demo", "--no-record", "--clock", "free"]
LOCKSTEP = ["--bus", "virtual:{bus}", "--clock", "lockstep"]
REAL_TIME = ["--bus", "virtual:{bus}", "--duration", "0.1"]
ECU = ["ecu", "--bus", "virtual:{bus}"]


@pytest.mark.parametrize(
    ("arguments", "how", "number"),
    [
        (DEMO, "computes", signal.SIGTERM),
        (DEMO, "imports", signal.SIGINT),
        (LOCKSTEP, "waits", signal.SIGTERM),
        (REAL_TIME, "waits", signal.SIGINT),
        (ECU, "computes", signal.SIGINT),
        (ECU, "imports", signal.SIGTERM),
    ],
    ids=["demo", "demo-imports", "lockstep", "realtime", "ecu", "ecu-imports"],
)
def test_a_run_with_a_hung_ecu_can_be_stopped(tmp_path: Path, arguments: list[str], how: str, number: int) -> None:
    (tmp_path / "theirs.py").write_text(f"HOW = {how!r}\n" + HANGS)
    given = [each.format(bus=uuid.uuid4()) for each in arguments]
    code, error = stopped_when_it_hangs(tmp_path, number, *given, "--ecu", "theirs:Ecu")
    assert code == 128 + number
    (cause,) = (line for line in error.splitlines() if line.startswith("liftgate-hil: "))
    assert "no response" in cause
    assert "Traceback" not in error


@needs_compiler
@pytest.mark.parametrize(("command", "number"), [("demo", signal.SIGINT), ("ecu", signal.SIGTERM)])
def test_a_run_with_a_hung_ecu_library_can_be_stopped(tmp_path: Path, command: str, number: int) -> None:
    step = 'if (now_ns > 20000000) { (void)!write(2, "it hangs\\n", 9); for (;;) pause(); }'
    library = str(build(tmp_path, source_of(step=step)))
    flags = ["--bus", f"virtual:{uuid.uuid4()}"] if command == "ecu" else ["--no-record"]
    code, error = stopped_when_it_hangs(tmp_path, number, command, "--ecu", library, *flags)
    assert code == 128 + number
    assert "no response" in error
    assert "Traceback" not in error


@pytest.mark.parametrize("number", SIGNALS)
def test_a_repeated_stop_signal_has_no_further_effect(tmp_path: Path, number: int) -> None:
    table = tmp_path / "run.csv"
    for _ in range(5):
        table.unlink(missing_ok=True)
        with process(tmp_path, "--bus", f"virtual:{uuid.uuid4()}", "--record", str(table)) as child:
            wait_for(lambda: table.is_file() and table.stat().st_size >= 10_000, "nothing was recorded")
            began = time.monotonic()
            for _ in range(3):
                child.send_signal(number)
                time.sleep(0.005)
            out, error = child.communicate(timeout=PATIENCE)
        if child.returncode == 0 or time.monotonic() - began < 1.0:
            break  # else the machine stood still, and it was told once more after a second
    assert child.returncode == 0
    assert out.startswith("ticks ")
    assert "Traceback" not in error
    names, *_, last = table.read_text().splitlines()
    row = dict(zip(names.split(","), last.split(","), strict=True))
    assert (row["left_coast"], row["right_coast"]) == ("1", "1")


@pytest.mark.parametrize("number", SIGNALS)
def test_a_stop_signal_while_python_ends_has_no_effect(number: int) -> None:
    code = (
        "import signal\n"
        "from liftgate_hil.cli.stopping import StopSignals\n"
        "class Late:\n"
        f"    def __del__(self, send=signal.raise_signal): send({int(number)})\n"
        "late, stop = Late(), StopSignals()\n"
        f"signal.raise_signal({int(number)})\n"
        "assert stop()\n"
    )
    ended = subprocess.run(
        [sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize(
    "command", [["--bus", "virtual:x"], ["identify", "nosuch.csv"], ["doctor"]], ids=lambda each: each[0]
)
def test_an_interrupt_during_start_up_prints_no_traceback(tmp_path: Path, command: list[str]) -> None:
    # What comes before is Python's own start, in which nobody can help it.
    code = (
        "import signal, sys\n"
        "from liftgate_hil.__main__ import main\n"
        "signal.signal(signal.SIGINT, signal.SIG_DFL)\n"
        f"sys.argv[1:] = {command!r}\n"
        "print('begun', flush=True)\n"
        "sys.exit(main())"
    )
    for delay in (0.0, 0.05, 0.1, 0.2, 0.4):
        with subprocess.Popen(
            [sys.executable, "-P", "-c", code], cwd=tmp_path,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        ) as child:  # fmt: skip
            assert child.stdout is not None
            assert child.stdout.readline() == "begun\n"
            time.sleep(delay)
            child.send_signal(signal.SIGINT)
            _, error = child.communicate(timeout=PATIENCE)
        assert "Traceback" not in error
        assert "ignored" not in error


def children_of(number: int) -> list[int]:
    text = Path(f"/proc/{number}/task/{number}/children").read_text()
    return [int(each) for each in text.split()]


def test_the_ecus_process_ends_when_the_emulator_is_killed(tmp_path: Path) -> None:
    bus = f"udp_multicast:239.76.{os.getpid() % 250}.1"
    (tmp_path / "theirs.py").write_text("class Ecu:\n    def step(self, now_s, frames): pass\n")
    with process(tmp_path, "--bus", bus, "--ecu", "theirs:Ecu", "--overrun-limit", "3600") as child:
        assert child.stderr is not None
        assert any("suv on" in line for line in child.stderr), "it did not come so far"
        (ecu,) = children_of(child.pid)
        child.kill()
        wait_for(lambda: not is_alive(ecu), "its ECU drives on")


def is_alive(number: int) -> bool:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False
