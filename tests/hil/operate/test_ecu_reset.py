"""Reset command of an ECU that cannot be ended, as it runs as another user."""

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
    """List of the programs that a kill was attempted on."""
    spared: list[subprocess.Popen[bytes]] = []
    monkeypatch.setattr(ecu_reset, "_kill", spared.append)
    monkeypatch.setattr(ecu_reset, "_KILL_S", 0.05)
    return spared


@pytest.mark.parametrize("timeout", [0.05, 600.0])
def test_a_reset_program_that_cannot_be_killed_does_not_block_the_run(
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
