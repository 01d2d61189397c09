"""Shared by the tests of `hil`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import hil_support
import pytest

from hil.config.rig import Rig
from hil.loop.tick import tick
from plant.compiler import compiled


@pytest.fixture(scope="session")
def rig() -> Rig:
    """The default rig."""
    return hil_support.shipped_rig()


@pytest.fixture(scope="session")
def fast_tick() -> Callable[..., Any]:
    """The compiled tick."""
    return compiled(tick)
