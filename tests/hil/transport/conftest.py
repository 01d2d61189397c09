"""A serial line whose other end the test holds."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from serial_peers import Server, Terminal, opened

from liftgate_hil.transport.serial_port import SerialTransport


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    """Pseudo-terminal at the far end of the line."""
    made = Terminal(tmp_path / "tty")
    yield made
    made.close()


@pytest.fixture
def line(terminal: Terminal) -> Iterator[SerialTransport]:
    """The transport under test, at the near end of the terminal's line."""
    with opened(str(terminal.link)) as transport:
        yield transport


@pytest.fixture
def server() -> Iterator[Server]:
    """Socket server at the far end of the line."""
    made = Server()
    yield made
    made.drop()
