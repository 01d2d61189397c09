"""The examples of the documentation, run as a user runs them; of the pages' blocks see test_manual_blocks.py."""

from __future__ import annotations

import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import readme

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "docs" / "examples").glob("*.py"))


def run_script(script: Path, folder: Path) -> str:
    """Output of a script run in a folder of its own: one in a process, the others in this process."""
    if script.stem != "run_scenario":
        return run_here(script, folder)
    done = subprocess.run(
        [sys.executable, str(script)], cwd=folder, check=False, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert not done.stderr
    return done.stdout


def run_here(script: Path, folder: Path) -> str:
    def execution() -> int:
        sys.path.insert(0, str(script.parent))
        runpy.run_path(str(script), run_name="__main__")
        return 0

    _, out, complaints = readme.called(execution, folder)
    assert not complaints
    return out


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_prints_and_leaves_its_own_folder_unchanged(script: Path, tmp_path: Path) -> None:
    if script.stem == "c_ecu" and shutil.which("cc") is None:
        pytest.skip("no C compiler")
    before = sorted(script.parent.iterdir())
    assert run_script(script, tmp_path)
    assert sorted(script.parent.iterdir()) == before
