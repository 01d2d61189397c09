"""Locking of this process's memory, so that no page that a loop has touched must be read again from a disk.

Only what is touched is locked (MCL_ONFAULT): what is mapped is ten times as much. Nothing is locked beyond the
limits of the process (RLIMIT_MEMLOCK) or of its control groups, where locked pages cannot be given up for others.
"""

from __future__ import annotations

import ctypes
import os
import re
import resource
from collections.abc import Iterator
from pathlib import Path

ROOT = Path("/")
_CURRENT, _FUTURE, _ONFAULT = 1, 2, 4  # MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT (mlockall(2))
CAP_IPC_LOCK = 14  # linux/capability.h
_HOW = "ulimit -l unlimited (memlock in /etc/security/limits.conf), or CAP_IPC_LOCK"


def lock_memory() -> str:
    """Lock the memory that this process has touched or will touch, within its limits; return why not, or "".

    Below a limit of the process what it maps later is not locked: there its next allocation would fail at the
    limit.
    """
    if short := short_of_memory():
        return f"locked memory: {short}"
    future = 0 if _is_limited() else _FUTURE
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_CURRENT | _ONFAULT | future) != 0:
        return f"locked memory: {os.strerror(ctypes.get_errno())}; to get it: {_HOW}"
    return ""


def unlock_memory() -> None:
    """Unlock all memory of this process."""
    ctypes.CDLL(None).munlockall()


def short_of_memory(root: Path = ROOT) -> str:
    """Return why a control group of this process is too full for locked memory; "": it is not.

    It must have room for as much as this process has touched: other runs beside this one lock theirs, too.
    """
    fields = _read(root / "proc/self/statm").split()  # pages: mapped, touched, ... (proc(5))
    touched = int(fields[1]) * resource.getpagesize() if len(fields) > 1 else 0
    left = min(_left_in_groups(root), default=None)
    if left is None or touched <= left:
        return ""
    return (
        f"this process has {touched / 2**20:.0f} MiB, its control group (container) has {left / 2**20:.0f} MiB "
        "left; to get it: a higher memory limit"
    )


def _is_limited() -> bool:
    """Whether the amount of memory that this process may lock is limited."""
    if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY:
        return False
    return not has_capability(ROOT, CAP_IPC_LOCK)


def has_capability(root: Path, bit: int) -> bool:
    """Whether this process has the Linux capability with the number `bit`."""
    held = re.search(r"^CapEff:\s*([0-9a-f]+)$", _read(root / "proc/self/status"), re.MULTILINE)
    return held is not None and bool(int(held[1], 16) >> bit & 1)


def _left_in_groups(root: Path) -> Iterator[int]:
    """Yield the memory [bytes] left in each limiting control group, where unused file pages count as free."""
    groups = re.findall(r"^(\d+):(.*?):(.*)$", _read(root / "proc/self/cgroup"), re.MULTILINE)
    for number, controllers, path in groups:
        if number == "0":  # version 2
            mount, limit, usage, given_up = "sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"
        elif "memory" in controllers.split(","):
            mount, limit, usage = "sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes"
            given_up = "total_inactive_file"
        else:
            continue
        top = root / mount
        group = top / path.lstrip("/")
        for folder in (group, *group.parents[: len(group.parts) - len(top.parts)]):
            allowed, used = _read(folder / limit).strip(), _read(folder / usage).strip()
            if not (allowed.isdecimal() and used.isdecimal()):  # "max", or no such group in this namespace
                continue
            spare = re.search(rf"^{given_up} (\d+)$", _read(folder / "memory.stat"), re.MULTILINE)
            yield max(0, int(allowed) - int(used) + (int(spare[1]) if spare else 0))


def _read(path: Path) -> str:
    """Return a file's text; "": it cannot be read."""
    try:
        return path.read_text()
    except OSError:
        return ""
