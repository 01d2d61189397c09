"""Tests on a real vcan0, against can-utils. `make test-vcan` runs them; nothing else collects them."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import hil_support
import pytest
from vcan_support import Bus, link_back

from liftgate_hil.config.rig import Rig


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--link-cycles", type=int, default=10, help="how often a link fault comes and goes")
    parser.addoption("--load-seconds", type=float, default=5.0, help="how long a full bus is borne")


@pytest.fixture
def load_seconds(request: pytest.FixtureRequest) -> float:
    return request.config.getoption("--load-seconds")


@pytest.fixture
def link_cycles(request: pytest.FixtureRequest) -> int:
    return request.config.getoption("--link-cycles")


@pytest.fixture(scope="session")
def rig() -> Rig:
    return hil_support.shipped_rig()


@pytest.fixture
def seen(request: pytest.FixtureRequest) -> tuple[int, ...]:
    """Identifiers for candump to record; () for all."""
    return getattr(request, "param", ())


@pytest.fixture
def bus(tmp_path: Path, seen: tuple[int, ...]) -> Iterator[Bus]:
    """vcan0, as recorded by candump from now on."""
    link_back()
    log = tmp_path / "candump.log"
    with log.open("w") as stream:
        # -D: stays where the interface goes down. A large buffer, so that whatever it misses was not sent.
        filters = "".join(f",{identifier:X}:7FF" for identifier in seen)
        listener = subprocess.Popen(["candump", "-D", "-L", "-r", "8000000", f"vcan0{filters}"], stdout=stream)
        try:
            dumped = Bus(log)
            dumped.wait_for_listener()
            yield dumped
        finally:
            listener.kill()
            listener.wait()
            link_back()
