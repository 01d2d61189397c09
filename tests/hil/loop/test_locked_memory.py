"""Locked memory: how much is locked, and when none is."""

from __future__ import annotations

import ctypes
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from liftgate_hil.loop import locked_memory
from liftgate_hil.loop.locked_memory import lock_memory, short_of_memory

MIB = 2**20
PAGES = 100 * MIB // resource.getpagesize()  # that the process has touched
CURRENT, FUTURE, ONFAULT = 1, 2, 4  # mlockall(2)


def machine(folder: Path, groups: str, **files: str) -> Path:
    """Fake file system of a machine whose process has touched 100 MiB; names are paths with __ for /."""
    files |= {"proc__self__statm": f"{10 * PAGES} {PAGES} 0 0 0 0 0", "proc__self__cgroup": groups}
    for name, content in files.items():
        path = folder / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{content}\n")
    return folder


def group(folder: str, allowed: object, used: int, given_up: int = 0) -> dict[str, str]:
    """Files of a version 2 control group: `used` MiB, of which the kernel can free `given_up` MiB (file cache)."""
    return {
        f"{folder}__memory.max": str(allowed),
        f"{folder}__memory.current": str(used * MIB),
        f"{folder}__memory.stat": f"anon 1\ninactive_file {given_up * MIB}\nactive_file 2",
    }


@pytest.mark.parametrize(
    ("allowed", "used", "given_up", "left"),
    [
        ("max", 5000, 0, None),
        (300 * MIB, 200, 0, None),  # as much as it has touched
        (300 * MIB, 250, 0, 50),
        (300 * MIB, 250, 50, None),
        (300 * MIB, 400, 0, 0),
    ],
)
def test_a_control_group_without_room_for_the_touched_memory_is_reported(
    tmp_path: Path, allowed: object, used: int, given_up: int, left: int | None
) -> None:
    root = machine(tmp_path, "0::/a/b", **group("sys__fs__cgroup__a__b", allowed, used, given_up))
    said = short_of_memory(root)
    assert (f"has 100 MiB, its control group (container) has {left} MiB left" in said) == (left is not None)
    assert bool(said) == (left is not None)


def test_limits_of_parent_control_groups_count_too(tmp_path: Path) -> None:
    inner = group("sys__fs__cgroup__a__b", "max", 50)
    for number, outer in enumerate(("sys__fs__cgroup__a", "sys__fs__cgroup")):
        root = machine(tmp_path / str(number), "0::/a/b", **inner, **group(outer, 100 * MIB, 70))
        assert "30 MiB left" in short_of_memory(root)


def test_limits_of_version_1_control_groups_are_read_too(tmp_path: Path) -> None:
    top = "sys__fs__cgroup__memory__x"
    files = {
        f"{top}__memory.limit_in_bytes": str(120 * MIB),
        f"{top}__memory.usage_in_bytes": str(110 * MIB),
        f"{top}__memory.stat": f"inactive_file 0\ntotal_inactive_file {30 * MIB}",
    }
    root = machine(tmp_path, "5:devices:/\n4:memory,cpu:/x\n0::/", **files)
    assert "40 MiB left" in short_of_memory(root)


@pytest.mark.parametrize("groups", ["0::/", "4:memory:/not/in/this/container", ""])
def test_without_a_memory_limit_there_is_room(tmp_path: Path, groups: str) -> None:
    assert short_of_memory(machine(tmp_path, groups)) == ""
    assert short_of_memory(tmp_path / "nowhere") == ""


@pytest.mark.parametrize(("is_limited", "flags"), [(False, CURRENT | ONFAULT | FUTURE), (True, CURRENT | ONFAULT)])
def test_under_a_memory_limit_later_mappings_are_not_locked(
    monkeypatch: pytest.MonkeyPatch, is_limited: bool, flags: int
) -> None:
    """Else the next allocation would fail at the limit, and with it the run."""
    asked = []

    class Library:
        def mlockall(self, given: int) -> int:
            asked.append(given)
            return 0

    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: Library())
    monkeypatch.setattr(locked_memory, "_is_limited", lambda: is_limited)
    monkeypatch.setattr(locked_memory, "short_of_memory", lambda: "")
    assert lock_memory() == ""
    assert asked == [flags]


def test_touched_memory_is_locked_and_no_other() -> None:
    """Runs in a process of its own, whose whole memory is locked; a refusal by the machine is reported."""
    code = (
        "import mmap\n"
        "from pathlib import Path\n"
        "from liftgate_hil.loop.locked_memory import lock_memory\n"
        "print(lock_memory())\n"
        "untouched = mmap.mmap(-1, 2**30)\n"  # more than a container may have
        "print(Path('/proc/self/status').read_text())\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    refused, _, status = done.stdout.partition("\n")
    resident = re.search(r"^VmRSS:\s*(\d+) kB$", status, re.MULTILINE)
    assert resident is not None
    assert int(resident[1]) < 500_000
    if refused:
        assert refused.startswith("locked memory: ")
    else:
        assert re.search(r"^VmLck:\s*[1-9]\d* kB$", status, re.MULTILINE)
