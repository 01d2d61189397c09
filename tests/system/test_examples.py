"""The examples of the documentation, run as a user runs them; of the pages' blocks see test_manual_blocks.py."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "docs" / "examples").glob("*.py"))


def run_script(script: Path, folder: Path) -> str:
    """What a script prints that is run in a folder of its own."""
    done = subprocess.run(
        [sys.executable, str(script)], cwd=folder, check=False, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert not done.stderr
    return done.stdout


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_where_it_is_started_and_tells_what_it_found(script: Path, tmp_path: Path) -> None:
    if script.stem == "c_ecu" and shutil.which("cc") is None:
        pytest.skip("no C compiler")
    before = sorted(script.parent.iterdir())
    assert run_script(script, tmp_path)
    assert sorted(script.parent.iterdir()) == before
