"""Mutation test of equations: change one in a copy of the sources, and check that its test fails.

The checkout itself is never touched.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from tools.equations import ROOT, source_of
from tools.equations.table import Row

NEEDED = ("plant", "hil", "tests", "configs", "dbc")
PASSED, FAILED = 0, 1  # exit codes of pytest; others say nothing about the test
TIMEOUT_S = 120.0


@contextmanager
def copied(root: Path = ROOT) -> Iterator[Path]:
    """Yield a temporary folder with the sources that the tests need."""
    with TemporaryDirectory(prefix="equations-") as place:
        for name in NEEDED:
            without = shutil.ignore_patterns("__pycache__", ".*")
            shutil.copytree(root / name, Path(place, name), ignore=without)
        shutil.copy(root / "pyproject.toml", place)
        yield Path(place)


def outcome(folder: Path, test: str) -> int:
    """Run a test of a copy in plain Python, and return the exit code of pytest."""
    paths = [str(folder / part) for part in ("plant", "hil", ".")]
    surroundings = {
        **os.environ,
        "LIFTGATE_COMPILE": "0",  # compilation of a mutant takes too long
        "PYTHONDONTWRITEBYTECODE": "1",  # mutants of the same second and size would share bytecode
        "PYTHONPATH": os.pathsep.join(paths),
        "PYTEST_ADDOPTS": "",
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
    }
    options = ["-q", "-p", "no:cacheprovider", "--rootdir", str(folder)]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, f"tests/{test}"],
        cwd=folder,
        env=surroundings,
        capture_output=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    return done.returncode


def survived(folder: Path, row: Row) -> str:
    """Return why the row's test does not detect the change of the equation, empty if it does."""
    path = folder / source_of(row)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(row.text, row.mutant), encoding="utf-8")
    try:
        code = outcome(folder, row.test)
    finally:
        path.write_text(text, encoding="utf-8")
    if code == FAILED:
        return ""
    return "its test passes" if code == PASSED else f"its test does not run: pytest says {code}"
