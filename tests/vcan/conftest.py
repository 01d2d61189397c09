"""Tests on a real vcan0, against can-utils. `make test-vcan` runs them; nothing else collects them."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import hil_support
import pytest
from vcan_support import Bus, link_back

from hil.config.rig import Rig


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--link-cycles", type=int, default=3, help="how often a link fault comes and goes"
    )


@pytest.fixture
def link_cycles(request: pytest.FixtureRequest) -> int:
    return request.config.getoption("--link-cycles")


@pytest.fixture(scope="session")
def rig() -> Rig:
    return hil_support.shipped_rig()


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[Bus]:
    """vcan0, as candump sees it from now on."""
    link_back()
    log = tmp_path / "candump.log"
    with log.open("w") as stream:
        # -D: stays where the interface goes down. A large buffer, so that whatever it misses was not sent.
        listener = subprocess.Popen(
            ["candump", "-D", "-L", "-r", "8000000", "vcan0"], stdout=stream
        )
        try:
            seen = Bus(log)
            seen.wait_for_listener()
            yield seen
        finally:
            listener.kill()
            listener.wait()
            link_back()
