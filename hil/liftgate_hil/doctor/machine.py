"""Checks of the machine and its kernel: platform, preemption, CPUs, frequencies, virtualisation, clock."""

from __future__ import annotations

import re
import sys
from collections.abc import Set as AbstractSet
from pathlib import Path

from liftgate_hil.doctor.check import Check, judged, number, ranges, read
from liftgate_hil.errors import number_of
from liftgate_hil.loop.priority import cpus_of

_CPU = "sys/devices/system/cpu"
_CLOCK = "sys/devices/system/clocksource/clocksource0"
_SLOW_CLOCKS = ("acpi_pm", "hpet", "jiffies", "pit", "refined-jiffies")


def platform(name: str = sys.platform, bits: int = 0, byte_order: str = sys.byteorder) -> Check:
    """Check whether the real-time loop can run on a platform, this one by default (`bits` 0: of this Python)."""
    bits = bits or (64 if sys.maxsize > 2**32 else 32)
    found = f"{name}, {bits} bit, {byte_order}-endian"
    if name == "linux" and bits == 64 and byte_order == "little":
        return Check("platform", "ok", found)
    mend = "use 64-bit little-endian Linux (x86-64 or arm64)"
    return Check("platform", "problem", f"{found}: clocks free and lockstep only", mend)


def kernel(root: Path) -> Check:
    """Check the version of the kernel and its preemption model."""
    version = read(root, "proc/sys/kernel/version")
    flavour = match[0] if (match := re.search(r"PREEMPT\w*", version)) else "no PREEMPT"
    if read(root, "sys/kernel/realtime") == "1":
        flavour = "PREEMPT_RT"
    found = f"Linux {read(root, 'proc/sys/kernel/osrelease') or 'of unknown version'}, {flavour}"
    if flavour == "PREEMPT_DYNAMIC":
        chosen = re.search(r"\((\w+)\)", read(root, "sys/kernel/debug/sched/preempt"))
        chosen = chosen or re.search(r"(?:^|\s)preempt=(\w+)", read(root, "proc/cmdline"))
        unknown = "mode unknown (sudo cat /sys/kernel/debug/sched/preempt shows it)"
        found += f", preempt={chosen[1]}" if chosen else f", {unknown}"
        if chosen and chosen[1] == "full":
            return Check("kernel", "ok", found)
        mend = "add preempt=full to the kernel's command line"
    elif flavour in ("PREEMPT_RT", "PREEMPT"):
        return Check("kernel", "ok", found)
    else:
        mend = "boot a kernel with preemption"
    best = "apt install linux-image-rt-amd64 (Debian), pro enable realtime-kernel (Ubuntu)"
    return judged("kernel", found, f"{mend}; best is PREEMPT_RT: {best}")


def cpus(root: Path, allowed: AbstractSet[int]) -> Check:
    """Check the model and number of the CPUs, and which are `allowed` to this process: two at least."""
    info = read(root, "proc/cpuinfo")
    names = re.search(r"^(?:model name|Model|Hardware)\s*:\s*(.+)$", info, re.MULTILINE)
    online = set(cpus_of(read(root, f"{_CPU}/online"))) or set(allowed)
    found = f"{names[1].strip() if names else 'unknown model'}, {number_of(len(online), 'CPU')}"
    if len(allowed) < len(online):
        found += f", this process may use {ranges(list(allowed))}"
    mend = ""
    if len(allowed) < 2:
        mend = "give this process two CPUs (taskset, docker --cpuset-cpus): one for the loop alone"
    return judged("CPUs", found, mend)


def isolated(root: Path, allowed: AbstractSet[int], wanted: int | None) -> Check:
    """Check if the CPU of --realtime (`wanted`, or None: of `allowed`) may be used, and is isolated if any is."""
    alone = set(cpus_of(read(root, f"{_CPU}/isolated")))
    if wanted is not None and wanted not in allowed:
        found, mend = f"CPU {wanted} is not one that this process may use", ranges(list(allowed))
        return Check("loop's CPU", "problem", found, f"--cpu with one of {mend}")
    cpu = wanted if wanted is not None else max(alone & allowed or allowed)
    found, mend = f"--realtime takes CPU {cpu}", ""
    if cpu in alone:
        found += ", which is isolated"
    elif alone:
        found += f", but the isolated ones are {ranges(list(alone))}"
        mend = f"--cpu {max(alone)}, and let this process use it (taskset, docker --cpuset-cpus)"
    else:
        found += f"; none is isolated (isolcpus={cpu} on the kernel's command line would keep other tasks off it)"
    return judged("loop's CPU", found, mend)


def quota(root: Path) -> Check:
    """Check a container's CPU quota: once it is used up, the loop halts until the next quota period."""
    limits = [*_quotas(root, r"^0::(.*)$", "sys/fs/cgroup")]
    limits += _quotas(root, r"^\d+:(?:cpu|cpu,cpuacct):(.*)$", "sys/fs/cgroup/cpu")
    if not limits:
        return Check("CPU quota", "ok", "none")
    found = f"the cgroup of this process may use {min(limits):g} CPUs, beyond that it is throttled"
    return judged("CPU quota", found, "start the container without --cpus, the service without CPUQuota=")


def _quotas(root: Path, line: str, mount: str) -> list[float]:
    """Return the CPU quotas [CPUs] of this process's control group and its parents, without unlimited ones."""
    group = re.search(line, read(root, "proc/self/cgroup"), re.MULTILINE)
    folder = group[1].strip("/") if group else ""
    limits = []
    while True:
        here = f"{mount}/{folder}" if folder else mount
        limit = read(root, f"{here}/cpu.max").split()
        if not limit:
            limit = [read(root, f"{here}/cpu.cfs_{name}_us") for name in ("quota", "period")]
        share = number(limit[0], -1) / max(number(limit[1], 1), 1)
        if share > 0.0:
            limits.append(share)
        if not folder:
            return limits
        folder = folder.rpartition("/")[0]


def governor(root: Path) -> Check:
    """Check the frequency governor of each CPU."""
    by_governor: dict[str, list[int]] = {}
    for path in sorted((root / _CPU).glob("cpu[0-9]*/cpufreq/scaling_governor")):
        cpu = number(path.parent.parent.name.removeprefix("cpu"), -1)
        by_governor.setdefault(read(root, str(path.relative_to(root))), []).append(cpu)
    if not by_governor:
        return Check("CPU frequency", "ok", "not set by this kernel (usual in a virtual machine)")
    found = ", ".join(f"{name or '?'} on CPU {ranges(each)}" for name, each in by_governor.items())
    mend = "" if set(by_governor) == {"performance"} else "cpupower frequency-set -g performance"
    return judged("CPU frequency", f"governor {found}", f"sudo {mend}" if mend else "")


def virtual(root: Path) -> Check:
    """Check whether the machine is virtual; its hypervisor may take CPU time away unnoticed."""
    flags = re.search(r"^(?:flags|Features)\s*:(.*)$", read(root, "proc/cpuinfo"), re.MULTILINE)
    kind = read(root, "sys/hypervisor/type") or read(root, "sys/firmware/devicetree/base/hypervisor/compatible")
    if not kind and (flags is None or "hypervisor" not in flags[1].split()):
        return Check("virtual machine", "ok", "no")
    name = kind.strip("\0") or read(root, "sys/class/dmi/id/sys_vendor")
    mend = "use a real machine for results that count, or pin its virtual CPUs to CPUs of the host"
    return judged("virtual machine", f"yes{f' ({name})' if name else ''}: its host can halt it at any time", mend)


def throttling(root: Path) -> Check:
    """Check the share of CPU time that the kernel allows FIFO tasks."""
    runtime = number(read(root, "proc/sys/kernel/sched_rt_runtime_us"), -2)
    period = max(number(read(root, "proc/sys/kernel/sched_rt_period_us"), 1_000_000), 1)
    if runtime == -2:
        return Check("FIFO share", "ok", "not reported by this kernel")
    if runtime == -1:
        return Check("FIFO share", "ok", "unlimited")
    share = runtime / period
    mend = "" if share >= 0.9 else "sudo sysctl -w kernel.sched_rt_runtime_us=950000"
    return judged("FIFO share", f"FIFO tasks may use {100.0 * share:g} % of a CPU", mend)


def clock(root: Path) -> Check:
    """Check the clock source from which the kernel reads the time."""
    current = read(root, f"{_CLOCK}/current_clocksource")
    if not current:
        return Check("clock source", "ok", "not reported by this kernel")
    others = [name for name in read(root, f"{_CLOCK}/available_clocksource").split() if name not in _SLOW_CLOCKS]
    if current not in _SLOW_CLOCKS:
        return Check("clock source", "ok", current)
    mend = "boot with tsc=reliable if the TSC is reliable (see dmesg | grep -i tsc)"
    if others:
        mend = f"echo {others[0]} | sudo tee /{_CLOCK}/current_clocksource"
    return judged("clock source", f"{current}, slow or coarse to read", mend)
