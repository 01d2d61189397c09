"""The doctor's checks of machine, limits and software, on simulated machines."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from importlib import metadata
from pathlib import Path

import pytest

from liftgate_hil.doctor import limits, machine, software
from liftgate_hil.doctor.check import Check, ranges
from liftgate_hil.loop.priority import cpus_of

CPU = "sys/devices/system/cpu"
CLOCK = "sys/devices/system/clocksource/clocksource0"
STATUS = "proc/self/status"
LIMITS = "proc/self/limits"
KERNEL = "proc/sys/kernel"

Make = Callable[[Mapping[str, str]], Path]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    def make(files: Mapping[str, str]) -> Path:
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text + "\n")
        return tmp_path

    return make


def says(check: Check, level: str, *words: str) -> None:
    """Check that a result has a level and words, and advice exactly where it isn't ok."""
    assert check.level == level, check
    text = f"{check.found} {check.advice}"
    for word in words:
        assert word in text, check
    assert bool(check.advice) == (level != "ok")
    assert all("\n" not in part for part in check)


def test_only_64_bit_little_endian_linux_supports_real_time():
    says(machine.platform("linux", 64, "little"), "ok")
    for name, bits, order in (("linux", 32, "little"), ("linux", 64, "big"), ("darwin", 64, "little")):
        says(machine.platform(name, bits, order), "problem", "free and lockstep only")


@pytest.mark.parametrize(
    ("version", "files", "level", "words"),
    [
        ("#1 SMP PREEMPT_RT Debian 6.1.76", {}, "ok", "PREEMPT_RT"),
        ("#1 SMP", {"sys/kernel/realtime": "1"}, "ok", "PREEMPT_RT"),
        ("#1 SMP PREEMPT Thu", {}, "ok", "PREEMPT"),
        ("#1 SMP PREEMPT_DYNAMIC Thu", {}, "warning", "mode unknown"),
        ("#1 SMP PREEMPT_DYNAMIC", {"proc/cmdline": "quiet preempt=full"}, "ok", "preempt=full"),
        ("#1 SMP PREEMPT_DYNAMIC", {"proc/cmdline": "preempt=none"}, "warning", "preempt=none"),
        (
            "#1 SMP PREEMPT_DYNAMIC",
            {"sys/kernel/debug/sched/preempt": "none voluntary (full)"},
            "ok",
            "preempt=full",
        ),
        (
            "#1 SMP PREEMPT_DYNAMIC",
            {"sys/kernel/debug/sched/preempt": "none (voluntary) full", "proc/cmdline": "preempt=full"},
            "warning",
            "preempt=voluntary",
        ),
        ("#1 SMP Debian", {}, "warning", "no PREEMPT"),
    ],
)
def test_missing_kernel_preemption_is_a_warning(
    make: Make, version: str, files: dict[str, str], level: str, words: str
):
    root = make({f"{KERNEL}/version": version, f"{KERNEL}/osrelease": "6.1.0", **files})
    says(machine.kernel(root), level, words, "Linux 6.1.0")


def test_a_process_that_may_use_only_one_cpu_gets_a_warning(make: Make):
    root = make({"proc/cpuinfo": "model name\t: Fast One", f"{CPU}/online": "0-3"})
    says(machine.cpus(root, {0, 1, 2, 3}), "ok", "Fast One, 4 CPUs")
    says(machine.cpus(root, {2, 3}), "ok", "may use 2-3")
    says(machine.cpus(root, {2}), "warning", "taskset")


def test_the_loops_cpu_is_an_isolated_or_the_requested_one(make: Make):
    none = make({f"{CPU}/isolated": ""})
    says(machine.isolated(none, {0, 1}, None), "ok", "CPU 1", "isolcpus=1")
    says(machine.isolated(none, {0, 1}, 7), "problem", "CPU 7", "0-1")
    some = make({f"{CPU}/isolated": "2-3"})
    says(machine.isolated(some, {0, 1, 2, 3}, None), "ok", "CPU 3, which is isolated")
    says(machine.isolated(some, {0, 1, 2, 3}, 0), "warning", "2-3", "--cpu 3")
    says(machine.isolated(some, {0, 1}, None), "warning", "takes CPU 1")


@pytest.mark.parametrize(
    ("group", "files", "words"),
    [
        ("0::/box/inner", {"box/cpu.max": "50000 100000"}, "0.5 CPUs"),
        ("0::/box/inner", {"cpu.max": "150000 100000", "box/cpu.max": "max 100000"}, "1.5 CPUs"),
        (
            "3:cpu,cpuacct:/box\n0::/",
            {"cpu/box/cpu.cfs_quota_us": "200000", "cpu/box/cpu.cfs_period_us": "100000"},
            "2 CPUs",
        ),
    ],
)
def test_a_cpu_quota_of_any_control_group_is_reported(make: Make, group: str, files: dict[str, str], words: str):
    root = make({"proc/self/cgroup": group})
    says(machine.quota(root), "ok", "none")
    make({f"sys/fs/cgroup/{name}": text for name, text in files.items()})
    says(machine.quota(root), "warning", words)


def test_an_unlimited_cpu_quota_is_ok(make: Make):
    root = make(
        {
            "proc/self/cgroup": "1:cpu:/\n0::/box",
            "sys/fs/cgroup/box/cpu.max": "max 100000",
            "sys/fs/cgroup/cpu/cpu.cfs_quota_us": "-1",
            "sys/fs/cgroup/cpu/cpu.cfs_period_us": "100000",
        }
    )
    says(machine.quota(root), "ok")


def test_the_frequency_governor_of_every_cpu_must_be_performance(make: Make):
    says(machine.governor(make({})), "ok", "not set")
    name = f"{CPU}/cpu{{}}/cpufreq/scaling_governor"
    root = make({name.format(cpu): "performance" for cpu in range(11)})
    says(machine.governor(root), "ok", "performance on CPU 0-10")
    make({name.format(3): "powersave"})
    says(
        machine.governor(root), "warning", "powersave on CPU 3", "0-2,4-10",
        "sudo cpupower frequency-set -g performance",
    )  # fmt: skip


def test_a_hypervisor_is_reported(make: Make):
    says(machine.virtual(make({"proc/cpuinfo": "flags\t: fpu sse"})), "ok")
    root = make({"proc/cpuinfo": "flags\t: fpu hypervisor", "sys/class/dmi/id/sys_vendor": "QEMU"})
    says(machine.virtual(root), "warning", "QEMU")
    says(machine.virtual(make({"sys/hypervisor/type": "xen"})), "warning", "xen")


def test_a_slow_clock_source_is_reported(make: Make):
    says(machine.clock(make({})), "ok")
    for name in ("tsc", "kvm-clock", "arch_sys_counter"):
        says(machine.clock(make({f"{CLOCK}/current_clocksource": name})), "ok", name)
    root = make({f"{CLOCK}/current_clocksource": "hpet"})
    says(machine.clock(root), "warning", "hpet", "tsc=reliable")
    make({f"{CLOCK}/available_clocksource": "hpet acpi_pm tsc"})
    says(machine.clock(root), "warning", "echo tsc")


@pytest.mark.parametrize(
    ("runtime", "level", "words"),
    [
        ("-1", "ok", "unlimited"),
        ("950000", "ok", "95 %"),
        ("100000", "warning", "sysctl"),
        ("0", "warning", "0 %"),
        ("", "ok", "not reported"),
    ],
)
def test_a_low_share_of_cpu_time_for_fifo_tasks_is_reported(make: Make, runtime: str, level: str, words: str):
    says(machine.throttling(make({f"{KERNEL}/sched_rt_runtime_us": runtime})), level, words)


def limits_of(priority: str, memory: str) -> str:
    return (
        "Limit                     Soft Limit           Hard Limit           Units\n"
        f"Max locked memory         {memory}              8388608              bytes\n"
        f"Max realtime priority     {priority}                    99"
    )


def test_default_limits_of_a_user_are_reported_as_too_low(make: Make):
    root = make({LIMITS: limits_of("0", "8388608"), STATUS: "CapEff:\t0000000000000000"})
    says(limits.priority(root, "eva"), "warning", "eva - rtprio 80", "LimitRTPRIO=80")
    says(limits.memory(root, "eva"), "warning", "8 MiB", "eva - memlock unlimited", "=infinity")
    assert not limits.may_have_fifo(root)
    assert not limits.may_lock_memory(root)


@pytest.mark.parametrize(
    ("given", "status"),
    [
        (limits_of("80", "unlimited"), "CapEff:\t0000000000000000"),
        (limits_of("0", "0"), f"CapEff:\t{1 << 23 | 1 << 14:016x}"),
    ],
)
def test_raised_limits_or_capabilities_are_ok(make: Make, given: str, status: str):
    root = make({LIMITS: given, STATUS: status})
    says(limits.priority(root, "eva"), "ok")
    says(limits.memory(root, "eva"), "ok")


def test_control_of_sleep_states_needs_its_device(make: Make, monkeypatch: pytest.MonkeyPatch):
    says(limits.sleep_states(make({})), "warning", "no /dev/cpu_dma_latency")
    root = make({"dev/cpu_dma_latency": ""})
    says(limits.sleep_states(root), "ok")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    says(limits.sleep_states(root), "warning", "udev")


def test_used_swap_is_reported_unless_memory_is_locked(make: Make):
    head = "Filename\tType\tSize\tUsed\tPriority"
    says(limits.swap(make({"proc/swaps": head}), False), "ok", "none")
    says(limits.swap(make({"proc/swaps": f"{head}\n/s file 9999 0 -2"}), False), "ok", "0 MiB")
    root = make({"proc/swaps": f"{head}\n/s file 9999 4096 -2\n/t file 9999 2048 -3"})
    says(limits.swap(root, False), "warning", "6 MiB", "swapoff")
    says(limits.swap(root, True), "ok")


def stat(name: str, flags: int, priority: int, policy: int) -> str:
    fields = ["0"] * 50
    fields[0], fields[6], fields[37], fields[38] = "S", str(flags), str(priority), str(policy)
    return f"1 ({name}) {' '.join(fields)}"


def test_programs_of_higher_priority_are_reported(make: Make):
    root = make(
        {
            "proc/101/stat": stat("migration/0", 0x00200000, 99, 1),
            "proc/102/stat": stat("audio) server", 0, 50, 1),
            "proc/103/stat": stat("shell", 0, 0, 0),
            "proc/104/stat": "cut off",
        }
    )
    says(limits.rivals(root), "ok")
    make({"proc/105/stat": stat("greedy", 0, 90, 2)})
    says(limits.rivals(root), "warning", "greedy (105) at 90", "chrt")


def test_a_small_receive_buffer_needs_a_capability_or_a_kernel_setting(make: Make):
    name = "proc/sys/net/core/rmem_max"
    root = make({name: "212992", STATUS: "CapEff:\t0000000000000000"})
    says(limits.receive_buffer(root), "warning", "208 KiB", "net.core.rmem_max=8388608")
    make({name: "8388608"})
    says(limits.receive_buffer(root), "ok")
    make({name: "212992", STATUS: f"CapEff:\t{1 << 12:016x}"})
    says(limits.receive_buffer(root), "ok")


def test_checks_survive_a_machine_without_any_system_files(tmp_path: Path):
    for check in (
        machine.kernel(tmp_path), machine.cpus(tmp_path, {0, 1}),
        machine.isolated(tmp_path, {0, 1}, None), machine.quota(tmp_path),
        machine.governor(tmp_path), machine.virtual(tmp_path), machine.clock(tmp_path),
        machine.throttling(tmp_path), limits.priority(tmp_path, "eva"),
        limits.memory(tmp_path, "eva"), limits.sleep_states(tmp_path),
        limits.swap(tmp_path, False), limits.rivals(tmp_path), limits.receive_buffer(tmp_path),
    ):  # fmt: skip
        assert check.level in ("ok", "warning")


def test_missing_packages_make_real_time_impossible():
    says(software.versions(lambda name: "1.2"), "ok", "numba 1.2", "python-can 1.2")

    def without_numba(name: str) -> str:
        if name == "numba":
            raise metadata.PackageNotFoundError(name)
        return "1.2"

    says(software.versions(without_numba), "problem", "missing: numba", "pip install numba")


def test_a_model_without_compiled_code_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = tmp_path / "not" / "there"
    says(software.model(True, True, folder), "ok", str(folder))
    says(software.model(True, False, folder), "warning", "first start", "liftgate-hil compile")
    says(software.model(False, False, folder), "warning", "unset LIFTGATE_COMPILE")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    says(software.model(True, False, folder), "warning", "XDG_CACHE_HOME")


def test_lists_of_cpus_are_written_as_they_are_parsed():
    for text in ("", "0", "0-3", "0-1,3,5-6"):
        assert ranges(cpus_of(text)) == text
