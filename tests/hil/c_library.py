"""ECU libraries in C, compiled for a test."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

import liftgate_hil.ecu

HEADERS = Path(liftgate_hil.ecu.__file__).parent
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


def build(folder: Path, source: str, name: str = "ecu.so") -> Path:
    """The library of a source text."""
    path = folder / f"{name}.c"
    path.write_text(source)
    command = ["cc", "-std=gnu99", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    command += ["-fvisibility=hidden", f"-I{HEADERS}", "-o", str(folder / name), str(path)]
    result = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    return folder / name
