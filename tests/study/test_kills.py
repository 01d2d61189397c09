"""Kills at many random moments: none of them may cost more than the last second of a recording."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.study.shortened import SHORT
from tests.system.kills import check_kills


@pytest.mark.filterwarnings("ignore")  # asammdf's own
def test_fifty_killed_emulators_recordings_are_whole_to_the_last_second(tmp_path: Path) -> None:
    check_kills(tmp_path, 2 if SHORT else 50)
