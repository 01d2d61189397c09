"""Thread of a loop: its requests to the machine, refusals, what remains after it, its CPU."""

from __future__ import annotations

import errno
import json
import math
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

import liftgate_hil as lh
from liftgate_hil.loop import priority
from liftgate_hil.loop.loop_thread import LOOP
from liftgate_hil.loop.priority import PRIORITY, PRIORITY_BESIDE, Realtime, best_cpu, cpus_of
from liftgate_hil.loop.wakeups import in_own_thread

DROP = """
import json, os, resource, subprocess, sys, threading
from liftgate_hil.cli.main import main
from liftgate_hil.loop import priority
from liftgate_hil.loop.priority import Realtime

def drop():
    for limit in (resource.RLIMIT_RTPRIO, resource.RLIMIT_MEMLOCK):
        resource.setrlimit(limit, (0, 0))
    if os.getuid() == 0:
        os.setuid(65534)
"""


def child(code: str) -> subprocess.CompletedProcess[str]:
    """Run DROP and this code in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", DROP + textwrap.dedent(code)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_objects_frozen_by_the_program_itself_stay_frozen_after_a_run():
    done = child("""
        import gc
        gc.freeze()
        before = gc.get_freeze_count()
        asked = Realtime()
        asked.prepare()
        asked.release()
        assert gc.get_freeze_count() == before
    """)
    assert done.stderr == ""


def test_every_refused_request_is_reported_with_its_remedy():
    done = child("""
        asked = Realtime()
        drop()
        asked.prepare()
        thread = threading.Thread(target=asked.enter)
        thread.start()
        thread.join()
        asked.release()
        print("\\n".join(asked.refused))
    """)
    assert done.stderr == ""
    told = {line.partition(": ")[0]: line for line in done.stdout.splitlines()}
    assert set(told) == {"locked memory", "FIFO scheduling", "no deep sleep of the CPU"}
    assert "ulimit -l" in told["locked memory"]
    assert f"ulimit -r {PRIORITY}" in told["FIFO scheduling"]
    assert "/dev/cpu_dma_latency" in told["no deep sleep of the CPU"]
    for line in told.values():
        assert "to get it: " in line


def test_a_run_goes_on_if_every_request_is_refused():
    done = child("""
        prepare = Realtime.prepare

        def prepare_without_rights(asked):
            drop()
            prepare(asked)

        Realtime.prepare = prepare_without_rights
        arguments = ["--bus", "virtual:x", "--duration", "0.1", "--realtime"]
        sys.exit(main([*arguments, "--overrun-limit", "3600"]))
    """)
    assert done.returncode == 0, done.stderr
    refused = [line for line in done.stderr.splitlines() if line.startswith("refused: ")]
    assert len(refused) == 3
    assert done.stdout.startswith("ticks 101, ")


def test_real_time_settings_hold_for_the_thread_alone_and_not_for_children():
    done = child("""
        import gc
        CODE = "import os; print(os.sched_getscheduler(0))"
        before = os.sched_getaffinity(0)
        asked = Realtime()
        asked.prepare()
        assert gc.get_freeze_count() > 0
        found = {}

        def inside():
            asked.enter()
            found["policy"] = os.sched_getscheduler(0)
            found["cpus"] = len(os.sched_getaffinity(0))
            found["child"] = int(subprocess.check_output([sys.executable, "-c", CODE]))

        thread = threading.Thread(target=inside)
        thread.start()
        thread.join()
        asked.release()
        asked.release()
        assert gc.get_freeze_count() == 0
        assert asked._latency is None
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
        assert os.sched_getaffinity(0) == before
        assert found["cpus"] == 1
        assert found["child"] == os.SCHED_OTHER
        given = not any(text.startswith("FIFO") for text in asked.refused)
        wanted = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK if given else os.SCHED_OTHER
        assert found["policy"] == wanted, found
    """)
    assert (done.returncode, done.stderr) == (0, "")


def test_fifo_is_requested_with_reset_on_fork(monkeypatch: pytest.MonkeyPatch):
    asked: list[Any] = []
    monkeypatch.setattr(os, "sched_setaffinity", lambda *given: asked.append(given))
    monkeypatch.setattr(os, "sched_setscheduler", lambda *given: asked.append(given))
    realtime = Realtime(3)
    realtime.enter()
    assert asked[0][:2] == (0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK)
    assert asked[0][2].sched_priority == PRIORITY
    assert asked[1] == (0, {3})
    assert realtime.refused == []


@pytest.mark.parametrize("has_asked", [True, False])
def test_without_fifo_only_an_explicit_real_time_request_moves_a_loop_to_the_best_cpu(
    monkeypatch: pytest.MonkeyPatch, has_asked: bool
):
    taken: list[set[int]] = []
    monkeypatch.setattr(os, "sched_setaffinity", lambda thread, cpus: taken.append(cpus))
    monkeypatch.setattr(priority, "ask_for_fifo", lambda _: "FIFO scheduling: refused")
    monkeypatch.setattr(priority, "best_cpu", lambda: 77)
    Realtime(has_asked=has_asked).enter()
    assert (taken == [{77}]) == has_asked
    assert len(taken[0]) == 1


def test_deep_cpu_sleep_is_disabled_only_on_an_explicit_real_time_request(monkeypatch: pytest.MonkeyPatch):
    woken: list[bool] = []
    monkeypatch.setattr(Realtime, "_wake_fast", lambda asked: woken.append(asked.has_asked))
    monkeypatch.setattr(priority, "lock_memory", lambda: "")
    monkeypatch.setattr(priority, "unlock_memory", lambda: None)
    for has_asked in (False, True):
        realtime = Realtime(has_asked=has_asked)
        realtime.prepare()
        realtime.release()
        assert woken == [True] * has_asked


@pytest.mark.parametrize("realtime", ["", "--no-realtime", "--realtime"])
def test_the_realtime_flags_choose_full_reports_of_refused_requests_or_one_line_or_none(realtime: str):
    done = child(f"""
        priority.ask_for_fifo = lambda *_: "FIFO scheduling: no; to get it: a limit"
        priority.lock_memory = lambda: "locked memory: no; to get it: a limit"
        arguments = ["--ecu", "reference", "--duration", "0.1", "--overrun-limit", "3600", *{realtime.split()!r}]
        sys.exit(main(arguments))
    """)
    assert done.returncode == 0, done.stderr
    refused = [line for line in done.stderr.splitlines() if line.startswith("refused: ")]
    if realtime == "--realtime":
        assert [each for each in refused if each.startswith("refused: no deep sleep") is False] == [
            "refused: locked memory: no; to get it: a limit", "refused: FIFO scheduling: no; to get it: a limit",
        ]  # fmt: skip
    else:
        line = "refused: locked memory and FIFO scheduling: other programs can delay this one; liftgate-hil doctor"
        assert refused == ([] if realtime else [f"{line} says how to get it"])


class FakeThread:
    """Scheduling of a thread as the kernel keeps it."""

    def __init__(self, policy: int, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = (policy, number)
        self.limit: float = math.inf  # RLIMIT_RTPRIO; infinite: it has CAP_SYS_NICE
        monkeypatch.setattr(os, "sched_getscheduler", lambda thread: self.now[0])
        monkeypatch.setattr(os, "sched_getparam", lambda thread: os.sched_param(self.now[1]))
        monkeypatch.setattr(os, "sched_setscheduler", self.change)

    def change(self, thread: int, policy: int, parameters: os.sched_param) -> None:
        assert thread == 0
        loses_flag = bool(self.now[0] & ~policy & os.SCHED_RESET_ON_FORK)
        rises = parameters.sched_priority > max(self.limit, self.now[1])
        if rises or (loses_flag and math.isfinite(self.limit)):
            raise PermissionError(1, "Operation not permitted")
        self.now = (policy, parameters.sched_priority)


BESIDE = (os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, PRIORITY_BESIDE)
FORMER = [(os.SCHED_OTHER, 0), (os.SCHED_BATCH, 0), (os.SCHED_RR, 7), (os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 42)]


@pytest.mark.parametrize("former", FORMER)
def test_a_helper_thread_gets_its_former_policy_and_priority_back(
    former: tuple[int, int], monkeypatch: pytest.MonkeyPatch
):
    thread = FakeThread(*former, monkeypatch)
    with Realtime().beside():
        assert thread.now == BESIDE
    assert thread.now == former
    with pytest.raises(KeyError), Realtime().beside():
        raise KeyError
    assert thread.now == former


def test_without_permission_to_clear_the_reset_on_fork_flag_only_the_flag_remains(monkeypatch: pytest.MonkeyPatch):
    thread = FakeThread(os.SCHED_OTHER, 0, monkeypatch)
    thread.limit = PRIORITY_BESIDE
    with Realtime().beside():
        assert thread.now == BESIDE
    assert thread.now == (os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, 0)


def test_a_run_goes_on_if_a_former_priority_above_the_limit_is_not_restored(monkeypatch: pytest.MonkeyPatch):
    thread = FakeThread(os.SCHED_FIFO, 50, monkeypatch)
    thread.limit = 0
    with Realtime().beside():
        assert thread.now == BESIDE
    assert thread.now == BESIDE


def test_a_thread_that_is_refused_fifo_is_left_unchanged(monkeypatch: pytest.MonkeyPatch):
    thread = FakeThread(os.SCHED_BATCH, 0, monkeypatch)
    thread.limit = 0
    with Realtime().beside():
        assert thread.now == (os.SCHED_BATCH, 0)
    assert thread.now == (os.SCHED_BATCH, 0)


def test_a_cpu_that_went_offline_is_reported_by_its_number(monkeypatch: pytest.MonkeyPatch):
    def refuse(*given: object) -> None:
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(os, "sched_setaffinity", refuse)
    monkeypatch.setattr(os, "sched_setscheduler", lambda *given: None)
    monkeypatch.setattr(priority, "best_cpu", lambda: 7)
    for cpu, number in ((None, 7), (5, 5)):
        realtime = Realtime(cpu)
        realtime.enter()
        realtime.enter()  # another thread, of what goes before time 0
        (line,) = realtime.refused
        assert line.startswith(f"CPU {number}: Invalid argument; allowed: ")


@pytest.mark.parametrize(
    ("text", "cpus"),
    [("", []), ("0", [0]), ("2-3,6", [2, 3, 6]), ("1-1", [1]), ("0-2,4,8-11", [0, 1, 2, 4, 8, 9, 10, 11])],
)
def test_a_list_of_cpus_is_parsed(text: str, cpus: list[int]):
    assert cpus_of(text) == cpus


@pytest.mark.parametrize(
    ("isolated", "allowed", "best"),
    [
        ("", {0, 1}, 1),
        ("\n", {0, 1}, 1),
        ("2-3\n", {0, 1, 2, 3, 4}, 3),
        ("2-3,6\n", {0, 2, 7}, 2),
        ("5\n", {0, 1}, 1),
        (None, {4}, 4),
    ],
)
def test_the_best_cpu_is_an_allowed_isolated_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, isolated: str | None, allowed: set[int], best: int
):
    file = tmp_path / "isolated"
    if isolated is not None:
        file.write_text(isolated)
    monkeypatch.setattr(priority, "Path", lambda name: file)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: allowed)
    monkeypatch.setattr(priority, "cpus_of_earlier_loops", set)  # a bench may run beside the tests
    assert best_cpu() == best


@pytest.mark.skipif(os.uname().machine not in ("x86_64", "aarch64"), reason="other system calls")
def test_precise_waking_sets_the_least_timer_slack_and_time_slice_only():
    done = child("""
        import ctypes, struct
        library = ctypes.CDLL(None)

        def scheduling():
            got = ctypes.create_string_buffer(48)
            assert library.syscall({"x86_64": 315, "aarch64": 275}[os.uname().machine], 0, got, 48, 0) == 0
            return struct.unpack("IIQiIQQQ", got.raw)

        def slack():
            return library.prctl(30, 0, 0, 0, 0)  # PR_GET_TIMERSLACK

        def look():
            before = scheduling()
            os.nice(3)
            priority.wake_sharply()
            told.update(before=before, after=scheduling(), slack=slack())

        told = {}
        thread = threading.Thread(target=look)
        thread.start()
        thread.join()
        print(json.dumps([told, scheduling(), slack()]))
    """)
    assert done.stderr == ""
    told, others, slack = json.loads(done.stdout)
    _, policy, flags, nice, _, runtime, *_ = told["after"]
    assert (policy, flags, nice) == (os.SCHED_OTHER, 0, told["before"][3] + 3)
    assert told["slack"] == 1
    if tuple(map(int, os.uname().release.split(".")[:2])) >= (6, 12):
        assert runtime == 100_000
    assert others == told["before"]
    assert slack > 1


def test_a_loop_without_fifo_keeps_the_cpu_on_which_it_begins(tmp_path: Path):
    cpus: list[set[int]] = []

    class Looking:
        """ECU that looks at the threads of its process, the loop's thread among them."""

        def step(self, now_s: float, frames: object) -> list[object]:
            for thread in Path("/proc/self/task").iterdir():
                if (thread / "comm").read_text().strip() == LOOP:
                    cpus.append(os.sched_getaffinity(int(thread.name)))
            return []

    scenario = tmp_path / "short.toml"
    scenario.write_text("duration = 0.05\n", encoding="utf-8")
    before = os.sched_getaffinity(0)
    lh.run(scenario, ecu=Looking(), clock="realtime")
    assert cpus
    assert {len(each) for each in cpus} == {1}
    assert len(set.union(*cpus)) == 1
    assert os.sched_getaffinity(0) == before


def test_a_loop_whose_cpu_affinity_is_refused_still_runs(monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setaffinity", refuse)
    assert in_own_thread(lambda: "done", lambda: None, None) == "done"
