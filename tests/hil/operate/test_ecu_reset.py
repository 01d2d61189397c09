"""The program that starts an ECU anew, and one that nobody here may end: it runs as somebody else."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest

from liftgate_hil.config.driver import Reset
from liftgate_hil.operate import ecu_reset

SLEEPS = (sys.executable, "-ISBc", "import time; time.sleep(600)")


@pytest.fixture
def beyond_reach(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[bytes]]:
    """The programs that were to be ended."""
    spared: list[subprocess.Popen[bytes]] = []
    monkeypatch.setattr(ecu_reset, "_kill", spared.append)
    monkeypatch.setattr(ecu_reset, "_KILL_S", 0.05)
    return spared


@pytest.mark.parametrize("timeout", [0.05, 600.0])
def test_a_program_that_cannot_be_ended_holds_up_nobody(
    beyond_reach: list[subprocess.Popen[bytes]], timeout: float
) -> None:
    program = ecu_reset.Program(Reset(command=SLEEPS, timeout=timeout))
    program.start()
    if timeout < 1.0:
        program._thread.join(60.0)
        assert program.failure == "not finished after 0.05 s"
    else:
        while program._process is None:
            time.sleep(0.01)
    program.stop()
    assert program.is_not_made
    process = program._process
    assert process is not None
    process.kill()
    process.wait(60.0)
    assert beyond_reach
