"""Checks of the resources that the machine grants this user: priority, memory, sleep states, swap, buffers."""

from __future__ import annotations

import os
import re
from pathlib import Path

from liftgate_hil.doctor.check import Check, judged, number, read
from liftgate_hil.loop.locked_memory import CAP_IPC_LOCK, has_capability, short_of_memory
from liftgate_hil.loop.priority import PRIORITY
from liftgate_hil.transport.receive_buffer import RECEIVE_BUFFER

_CAP_NET_ADMIN, _CAP_SYS_NICE = 12, 23  # linux/capability.h
_KERNEL_THREAD = 0x00200000  # PF_KTHREAD
_FIFO, _ROUND_ROBIN = 1, 2
_UNLIMITED = 2**63
RUN_MAPS = 4 << 30  # bytes; mlockall counts all mapped memory, 2 to 3 GB in a run
_FILE = "/etc/security/limits.d/90-liftgate.conf"


def _limit(root: Path, name: str) -> int:
    """Return a soft resource limit of this process by its name in /proc; _UNLIMITED: none, 0: unknown."""
    line = re.search(rf"^{name}\s+(\S+)", read(root, "proc/self/limits"), re.MULTILINE)
    if line is None:
        return 0
    return _UNLIMITED if line[1] == "unlimited" else number(line[1], 0)


def _advice_to_allow(user: str, name: str, value: str, unit: str) -> str:
    """Return advice to set a user's limit: a command for limits.d, and the setting `unit` of a systemd service."""
    return (
        f"echo '{user} - {name} {value}' | sudo tee -a {_FILE}, then log in again "
        f"(a systemd service: {unit}={value})"
    )


def may_have_fifo(root: Path) -> bool:
    """Whether a real-time run will probably be granted FIFO scheduling at its priority."""
    limit = _limit(root, "Max realtime priority")
    return limit >= PRIORITY or has_capability(root, _CAP_SYS_NICE)


def may_lock_memory(root: Path) -> bool:
    """Whether a real-time run will probably be allowed to lock its memory."""
    return _limit(root, "Max locked memory") >= RUN_MAPS or has_capability(root, CAP_IPC_LOCK)


def priority(root: Path, user: str) -> Check:
    """Check whether this user may use FIFO scheduling at the loop's priority."""
    if may_have_fifo(root):
        return Check("FIFO priority", "ok", f"runs in real time may use priority {PRIORITY}")
    limit = _limit(root, "Max realtime priority")
    found = f"this user may have at most {limit}, a run in real time requests {PRIORITY}"
    mend = _advice_to_allow(user, "rtprio", str(PRIORITY), "LimitRTPRIO")
    return judged("FIFO priority", f"{found}: other programs can hold up the loop", mend)


def memory(root: Path, user: str) -> Check:
    """Check whether a real-time run may lock its memory, and whether a container has enough of it."""
    if short := short_of_memory(root):
        return judged("locked memory", short.partition("; ")[0], "give the container more memory")
    if may_lock_memory(root):
        return Check("locked memory", "ok", "runs in real time may lock their memory")
    limit = _limit(root, "Max locked memory") / 2**20
    found = f"this user may lock {limit:.0f} MiB, a run has more: a page fault can hold up the loop"
    mend = _advice_to_allow(user, "memlock", "unlimited", "LimitMEMLOCK").replace("=unlimited", "=infinity")
    return judged("locked memory", found, mend)


def sleep_states(root: Path) -> Check:
    """Check whether --realtime may keep CPUs out of sleep states from which they wake slowly."""
    path, found, mend = root / "dev/cpu_dma_latency", "--realtime may disable deep states", ""
    if not path.exists():
        found = "no /dev/cpu_dma_latency: --realtime cannot keep the CPUs out of deep sleep states"
        mend = (
            "give the container the device (docker --device /dev/cpu_dma_latency), or boot with "
            "processor.max_cstate=1 idle=poll"
        )
    elif not os.access(path, os.W_OK):
        found = "this user may not write /dev/cpu_dma_latency: waking from a deep state takes up to 200 µs"
        mend = (
            'sudo chmod o+w /dev/cpu_dma_latency; permanently: echo \'KERNEL=="cpu_dma_latency", '
            'MODE="0666"\' | sudo tee /etc/udev/rules.d/90-liftgate.rules'
        )
    return judged("CPU sleep states", found, mend)


def swap(root: Path, locked: bool) -> Check:
    """Check whether swap is in use although runs cannot lock their memory (`locked`: they can)."""
    rows = [line.split() for line in read(root, "proc/swaps").splitlines()[1:]]
    used = sum(number(row[3], 0) for row in rows if len(row) > 3) / 1024.0
    if not rows:
        return Check("swap", "ok", "none")
    found = f"{used:.0f} MiB in use"
    if used == 0.0 or locked:
        return Check("swap", "ok", f"{found}{', but memory is locked' if used else ''}")
    mend = "allow that as advised above, or sudo swapoff -a"
    return judged("swap", f"{found}, and memory cannot be locked", mend)


def rivals(root: Path) -> Check:
    """Check for other programs' FIFO tasks for which the loop may have to wait."""
    found = []
    for path in (root / "proc").glob("[0-9]*/stat"):
        if path.parent.name == str(os.getpid()):
            continue
        text = read(root, str(path.relative_to(root)))
        name, _, rest = text.partition("(")[2].rpartition(")")
        fields = rest.split()  # fields of proc(5), from field 3
        if len(fields) < 39 or number(fields[6], 0) & _KERNEL_THREAD:
            continue
        if number(fields[38], 0) in (_FIFO, _ROUND_ROBIN) and number(fields[37], 0) >= PRIORITY:
            found.append(f"{name} ({path.parent.name}) at {fields[37]}")
    if not found:
        return Check("other FIFO tasks", "ok", f"none at the loop's priority {PRIORITY} or above")
    mend = f"lower their priority (sudo chrt -f -p {PRIORITY - 10} PID), or stop them"
    return judged("other FIFO tasks", f"{', '.join(found)}: can delay the loop at priority {PRIORITY}", mend)


def receive_buffer(root: Path) -> Check:
    """Check whether CAN sockets get the receive buffer that this program requests."""
    allowed = number(read(root, "proc/sys/net/core/rmem_max"), 0)
    if has_capability(root, _CAP_NET_ADMIN) or allowed >= RECEIVE_BUFFER:
        return Check("receive buffer", "ok", f"CAN sockets get {RECEIVE_BUFFER >> 20} MiB")
    found = f"CAN sockets get {allowed >> 10} KiB, not {RECEIVE_BUFFER >> 20} MiB"
    setting = f"net.core.rmem_max={RECEIVE_BUFFER}"
    mend = f"sudo sysctl -w {setting}; permanently: a line {setting} in /etc/sysctl.d/90-liftgate.conf"
    return judged("receive buffer", f"{found}: frames are lost if the loop stalls", mend)
