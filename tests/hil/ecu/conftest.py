"""Fixtures shared by the tests of ECUs."""

from __future__ import annotations

from pathlib import Path

import pytest
from c_ecu import build_library


@pytest.fixture(scope="session")
def example_library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example ECU in C, built as a shared library."""
    return build_library(tmp_path_factory.mktemp("example"))
