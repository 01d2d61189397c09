"""A working directory with files named like modules: none of them is ever imported."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from c_library import build, source_of

# What the product imports, and what its folders and commands are called.
NAMES = (
    "can", "cantools", "numpy", "numba", "scipy", "serial", "msgpack", "tomlkit", "orjson", "matplotlib", "hil",
    "plant", "tools", "worker", "argparse", "ctypes", "enum", "json", "pathlib", "pickle", "random", "select",
    "signal", "socket", "subprocess", "tempfile", "typing",
)  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in NAMES:
        (tmp_path / f"{name}.py").write_text("import os\nos.write(2, b'RUN: ' + __file__.encode())\n")
    return tmp_path


@pytest.mark.parametrize(
    "arguments",
    [
        ["--version"],
        ["--bus", "virtual:x", "--duration", "0.1", "--record", "a.blf", "--record", "a.csv"],
        ["demo", "--clock", "free", "--duration", "0.1", "--record", "a.asc"],
        ["demo", "--clock", "free", "--duration", "0.1", "--ecu", "{library}", "--no-record"],
        ["ecu", "--bus", "virtual:x", "--duration", "0.1"],
        ["demo", "--bus", "udp_multicast:239.74.163.73", "--duration", "6", "--no-record"],
        ["simulate", "--duration", "0.1", "--output", "a.csv"],
    ],
    ids=lambda arguments: " ".join(arguments[:3]),
)
def test_files_in_the_working_directory_are_not_imported(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, arguments: list[str]
) -> None:
    """Each command is a process; one in real time takes 5 s."""
    library = build(tmp_path_factory.mktemp("ecu"), source_of()) if "{library}" in arguments else ""
    given = [each.format(library=library) for each in arguments]
    done = subprocess.run(
        [sys.executable, "-m", "liftgate_hil", *given],
        cwd=folder, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "RUN: " not in done.stderr
