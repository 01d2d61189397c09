"""The manual's commands that set up a machine as root, run by root without `sudo`."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import readme
from vcan_support import link_back, run

BUFFER = Path("/proc/sys/net/core/rmem_max")


@pytest.fixture
def before() -> Iterator[None]:
    """Restore the machine's vcan0 and its limits after the test."""
    limit = BUFFER.read_text()
    yield
    BUFFER.write_text(limit)
    run("ip", "link", "del", "vcan0")
    link_back()


def as_root(command: str) -> None:
    """Run a command of the manual as root."""
    program, _, line = command.partition(" ")
    assert program == "sudo"
    run(*line.split())


def test_the_manuals_commands_create_vcan0_and_raise_the_receive_buffer(before: None) -> None:
    run("ip", "link", "del", "vcan0")
    as_root(readme.command("sudo ip link add"))
    as_root(readme.command("sudo ip link set"))
    shown = subprocess.run(["ip", "link", "show", "vcan0"], capture_output=True, text=True, check=True).stdout
    assert "UP" in shown
    raised = readme.command("sudo sysctl")
    as_root(raised)
    assert BUFFER.read_text().strip() == raised.partition("=")[2]
