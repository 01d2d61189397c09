"""What holds for all tests: as many processes as CPUs run them, so that no process needs threads of its own."""

from __future__ import annotations

import functools
import gc
import itertools
import os
import re
import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import last_bits

# Searches for cycles, each of which goes through all that was imported and collected, come more rarely.
gc.set_threshold(50_000, 20, 50)

# Before numpy is loaded. Matrices are small here, so that threads of the BLAS only wait for each other:
# identification takes 47 s of CPU with two of them, and 29 s with one.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

if last_bits.seed():
    last_bits.choose_routines()

# The file that exists while something is judged in real time (tools/stages.py): all workers but the first wait, so
# that it has a CPU. What the tests start does not wait.
_WORKER = os.environ.get("PYTEST_XDIST_WORKER", "")
_TIMED = os.environ.pop("LEAVE_A_CPU_WHILE", "") if _WORKER else ""

# python-can with all of its formats, before anything of ours loads it without asammdf.
import can  # noqa: E402, F401

# A shell starts what is to run in the background without Ctrl-C, and so would the programs under test be.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

pytest.register_assert_rewrite(
    "kills", "tests.hil.identification.many_seeds", "tests.hil.identification.pauses", "tests.system.kills"
)

if last_bits.seed():
    last_bits.install()


def pytest_report_header() -> str | None:
    """The line that tells of the switch, where it is on."""
    return f"{last_bits.VARIABLE}={last_bits.seed()}" if last_bits.seed() else None


def pytest_collection_finish() -> None:
    """Leave what was imported and collected out of all searches for cycles, which take half a second with it."""
    gc.collect()
    gc.freeze()


def pytest_sessionfinish() -> None:
    """Have it in them again: plugins ask the collector who refers to an object."""
    gc.unfreeze()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """With `--durations`: the time by folder, set-up and teardown included, and the number of tests."""
    if terminalreporter.config.option.durations is None:
        return
    seconds: dict[str, float] = {}
    tests: dict[str, set[str]] = {}
    for report in itertools.chain.from_iterable(terminalreporter.stats.values()):
        if isinstance(report, pytest.TestReport):
            folder = report.nodeid.partition("::")[0].rpartition("/")[0]
            seconds[folder] = seconds.get(folder, 0.0) + report.duration
            tests.setdefault(folder, set()).add(report.nodeid)
    terminalreporter.write_sep("=", "time by folder")
    for folder in sorted(seconds, key=seconds.__getitem__, reverse=True):
        terminalreporter.write_line(f"{seconds[folder]:8.1f} s  {len(tests[folder]):5}  {folder}")


# Their tests start programs, compile or wait, so that one may take minutes.
LONG = ("tools", "system", "hil/campaigns", "hil/dashboard")
# Without machine code of the product's entry points, which `make compile` makes meanwhile.
EARLY = ("plant", "reference", "hil/codec", "hil/config", "hil/transport")
_NEEDS_IT = re.compile(r"\bGate\(|\blh\.|\bmain\(|\bEpisode\(")  # what files there use that do need it


@pytest.hookimpl(trylast=True)  # after those that are not asked for are left out
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Order the tests: after the early ones those that take longest, so that no process is left alone with them at
    the end; their files are dealt to the processes in turn, each of which begins with a stretch of the list.

    Those in real time with foreign programs, or on a bus of multicast datagrams, are of one group, for one
    process: python-can's own bus of that kind hears all groups of a port. Those in a browser share one.
    """
    root = Path(__file__).parent
    early = [item for each in EARLY for item in items if item.path.is_relative_to(root / each)]
    long = [item for each in LONG for item in items if item.path.is_relative_to(root / each)]
    first = [*(item for item in early if not needs_machine_code(item.path)), *long]
    chosen = set(first)
    others = [item for item in items if item not in chosen]
    items[:] = dealt(first, others, int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")))
    for item in items:
        if item.path.is_relative_to(root / "browser"):
            item.add_marker(pytest.mark.xdist_group("browser"))
        elif item.get_closest_marker("realtime") and is_on_its_own(item.path, root):
            item.add_marker(pytest.mark.xdist_group("system"))


def dealt(first: list[pytest.Item], others: list[pytest.Item], processes: int) -> list[pytest.Item]:
    """A stretch of equal length for each process: files of `first` in turn, and of the others what is lacking."""
    files = {path: number for number, path in enumerate(dict.fromkeys(item.path for item in first))}
    total, rest, found = len(first) + len(others), iter(others), []
    for process in range(processes):
        found += [item for item in first if files[item.path] % processes == process]
        found += itertools.islice(rest, max(0, total * (process + 1) // processes - len(found)))
    return [*found, *rest]


@functools.cache
def needs_machine_code(path: Path) -> bool:
    """Whether tests of a file run the product's entry points."""
    return _NEEDS_IT.search(path.read_text("utf-8")) is not None


@functools.cache
def is_on_its_own(path: Path, root: Path) -> bool:
    """Whether the tests of a file disturb, or are disturbed by, others on a bus of multicast datagrams."""
    return path.is_relative_to(root / "system") or "udp_multicast" in path.read_text("utf-8")


@pytest.fixture(scope="session", autouse=True)
def runs_of_their_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Folders of this process for the sockets of its tests' runs: else they would find those of other tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))
        patch.setenv("TMPDIR", str(tmp_path_factory.mktemp("temporary")))
        patch.setattr(tempfile, "tempdir", None)  # which keeps the folder that was found first
        yield


@pytest.fixture(scope="session", autouse=True)
def one_compiler() -> Iterator[None]:
    """Compiler process that the tests of this process share: it compiles each helper once."""
    import liftgate_compiler as compiler  # which loads numpy

    with compiler.sharing():
        yield


@pytest.fixture(autouse=True)
def signals_restored() -> Iterator[None]:
    """Handlers of signals, after each test as before: a command that is called in the test's process sets its own,
    and processes that are forked later would not end when they are told to. It may leave a timer, too.
    """
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    before = [signal.getsignal(number) for number in numbers]
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


@pytest.fixture(autouse=True)
def process_restored() -> Iterator[None]:
    """This process after each test as before: what it lowers or locks would hold for all tests that follow."""
    before = _state_of_process()
    yield
    assert _state_of_process() == before


def _state_of_process() -> tuple[object, ...]:
    """Nice value, scheduling policy, CPUs and locked memory of the thread that runs the tests."""
    locked = re.search(r"^VmLck:.*$", Path("/proc/self/status").read_text(), re.MULTILINE)
    nice, policy = os.getpriority(os.PRIO_PROCESS, 0), os.sched_getscheduler(0)
    return nice, policy, os.sched_getaffinity(0), locked and locked[0]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Wait while something is judged in real time; other last bits within the tests that are for them, fixtures
    included.
    """
    while _TIMED and _WORKER != "gw0" and Path(_TIMED).exists():
        time.sleep(0.5)
    if not last_bits.seed() or not last_bits.is_part(item.path):
        return (yield)
    last_bits.activate(True)
    try:
        return (yield)
    finally:
        last_bits.activate(False)
