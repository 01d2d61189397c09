"""The machine with a vcan0: its exit status, and its message if there is none."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tools.vcan import __main__ as vcan
from tools.vcan import install, native, places, process, uml

# A process that runs tests beside others has a thread; the program itself has none.
pytestmark = pytest.mark.filterwarnings("ignore:.*is multi-threaded:DeprecationWarning")


def unavailable(*_: object) -> None:
    raise process.UnavailableError("this is a test")


def test_the_reasons_why_no_machine_has_a_vcan_are_on_one_line(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(vcan, "native_prefix", unavailable)
    monkeypatch.setattr(vcan, "run_uml", unavailable)
    assert vcan.main(["--", "true"]) == process.OWN_FAILURE
    out, error = capfd.readouterr()
    assert out == ""
    assert error.splitlines() == [
        "vcan: no machine with a vcan: native: this is a test; User-Mode Linux: this is a test"
    ]


def test_without_apt_the_required_packages_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(install, "find_program", lambda name: None)
    monkeypatch.setattr(install, "native_prefix", unavailable)
    assert vcan.main(["--install"]) == process.OWN_FAILURE
    assert "user-mode-linux iproute2 can-utils; there is no apt-get" in capfd.readouterr().err
    monkeypatch.setattr(install, "native_prefix", lambda interfaces: [])
    assert install.missing_packages(["vcan0"], "auto") == ["can-utils"]


def test_without_user_mode_linux_the_error_states_the_installation_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(uml, "find_program", lambda name: None)
    with pytest.raises(process.UnavailableError, match=r"python -m tools\.vcan --install"):
        uml.find_uml()


@pytest.mark.parametrize(
    ("code", "status"), [("raise SystemExit(3)", 3), ("import os; os.kill(os.getpid(), 9)", 137)]
)
def test_the_exit_status_is_that_of_the_command(code: str, status: int) -> None:
    assert native.run_native([], [sys.executable, "-c", code], None) == status


def test_a_timeout_ends_the_command_and_its_children(tmp_path: Path) -> None:
    child = tmp_path / "child"
    command = ["sh", "-c", f"sleep 60 & echo $! >{child}; wait"]
    assert native.run_native([], command, 0.5) == process.TIMED_OUT
    deadline = time.monotonic() + 10.0
    status = Path("/proc", child.read_text().strip(), "status")
    while status.exists() and "zombie" not in status.read_text():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_unpacked_programs_are_last_on_the_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    root = tmp_path / "liftgate-hil" / "machines"
    for folder in ("usr/bin", "usr/lib/x86_64-linux-gnu"):
        (root / folder).mkdir(parents=True)
    program = root / "usr/bin/nobody-else-has-this"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    assert places.find_program(program.name) == str(program)
    found = places.environment({**os.environ, "PATH": "/mine", "LD_LIBRARY_PATH": "/theirs"})
    assert found["PATH"] == f"/mine:/usr/sbin:/sbin:{root}/usr/bin"
    assert found["LD_LIBRARY_PATH"] == f"/theirs:{root}/usr/lib/x86_64-linux-gnu"


_TRACER = """
import ctypes, os, signal
libc = ctypes.CDLL(None, use_errno=True)
GET, SET, ATTACH, XSTATE = 0x4204, 0x4205, 16, 0x202
class Vector(ctypes.Structure):
    _fields_ = [("base", ctypes.c_void_p), ("length", ctypes.c_size_t)]
child = os.fork()
if child == 0:
    signal.pause()
try:
    assert libc.ptrace(ATTACH, child, None, None) == 0, os.strerror(ctypes.get_errno())
    os.waitpid(child, 0)
    known = ctypes.create_string_buffer(576)  # legacy area and header: less than any processor with AVX has
    vector = Vector(ctypes.cast(known, ctypes.c_void_p), len(known))
    for request in (GET, SET):
        result = libc.ptrace(request, child, ctypes.c_void_p(XSTATE), ctypes.byref(vector))
        print(result, os.strerror(ctypes.get_errno()) if result else "")
finally:
    os.kill(child, signal.SIGKILL)
"""


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.skipif(platform.machine() != "x86_64", reason="not x86-64")
def test_user_mode_linux_can_set_registers_with_fewer_bytes_than_the_processor_has(tmp_path: Path) -> None:
    whole = uml.with_whole_registers(tmp_path)
    command = [sys.executable, "-c", _TRACER]
    environment = {**os.environ, **whole}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.split() == ["0", "0"], done.stdout + done.stderr
