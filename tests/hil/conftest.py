"""Fixtures shared by the tests of `hil`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import hil_support
import pytest

from liftgate_compiler import compiled
from liftgate_hil.config.rig import Rig
from liftgate_hil.loop.tick import tick


@pytest.fixture(scope="session")
def rig() -> Rig:
    """The shipped default rig, loaded."""
    return hil_support.shipped_rig()


@pytest.fixture(scope="session")
def fast_tick() -> Callable[..., Any]:
    """The loop's tick compiled to machine code, which leaves its arguments unchanged."""
    return hil_support.pure(compiled(tick))
