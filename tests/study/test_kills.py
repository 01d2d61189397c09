"""Emulators killed at many random moments lose at most the last second of a recording."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.study.shortened import SHORT
from tests.system.kills import check_kills


@pytest.mark.filterwarnings("ignore")  # asammdf's own
def test_recordings_of_fifty_killed_emulators_are_complete_to_the_last_second(tmp_path: Path) -> None:
    check_kills(tmp_path, 2 if SHORT else 50)
