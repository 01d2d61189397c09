"""The commands with which the manual sets a machine up as root, run by root without `sudo`."""

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
    """The machine has a vcan0 and its own limits again."""
    limit = BUFFER.read_text()
    yield
    BUFFER.write_text(limit)
    run("ip", "link", "del", "vcan0")
    link_back()


def as_root(command: str) -> None:
    """Run a command of the manual."""
    program, _, line = command.partition(" ")
    assert program == "sudo"
    run(*line.split())


def test_a_vcan0_is_made_and_the_buffer_raised_as_the_manual_says(before: None) -> None:
    run("ip", "link", "del", "vcan0")
    as_root(readme.command("sudo ip link add"))
    as_root(readme.command("sudo ip link set"))
    shown = subprocess.run(["ip", "link", "show", "vcan0"], capture_output=True, text=True, check=True).stdout
    assert "UP" in shown
    raised = readme.command("sudo sysctl")
    as_root(raised)
    assert BUFFER.read_text().strip() == raised.partition("=")[2]
