"""Arguments and results of machine code, and its cache."""

from __future__ import annotations

import errno
import fcntl
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from llvmlite.binding import ObjectFileRef
from numpy.typing import NDArray

import liftgate_compiler as compiler
from liftgate_compiler import (
    GivenUpError,
    Watcher,
    building,
    child,
    compilable,
    compiled,
    enabled,
    files,
    obtaining,
    packing,
    storage,
)
from liftgate_compiler.kinds import Array, Kind, Nothing, NumberKind, Tuple, from_plain, kind_of, plain, text_of
from liftgate_compiler.packing import packer, unpacker

pytestmark = pytest.mark.skipif(not enabled(), reason="needs the compiler")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "liftgate-hil"


@pytest.fixture
def apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile each function in a process of its own, as is the default."""
    monkeypatch.setattr(child._Kept, "users", 0)
    monkeypatch.setattr(child._Kept, "compiler", None)


class NotingWatcher(Watcher):
    """Watcher that keeps the messages of the compiler."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def compiles(self, name: str, seconds: float) -> None:
        said = f"compiles {name}"
        if said not in self.said:  # it is told of it all the time
            self.said.append(said)

    def not_kept(self, why: str) -> None:
        self.said.append(f"not kept: {why}")


@pytest.fixture
def told() -> Iterator[NotingWatcher]:
    """A watcher that is told of all compilations."""
    watcher = NotingWatcher()
    compiler.watch(watcher)
    yield watcher
    compiler.unwatch(watcher)


class Point(NamedTuple):
    x: float
    y: float


class Mixed(NamedTuple):
    flag: bool
    count: int
    point: Point
    absent: None
    row: NDArray[np.float64]


def turned(mixed: Mixed, more: tuple[int, float]) -> tuple[Mixed, bool, float, None]:
    mixed.row[0] += 1.0
    point = Point(mixed.point.y, mixed.point.x)
    end = Mixed(not mixed.flag, mixed.count + more[0], point, None, mixed.row)
    return end, mixed.count > 0, more[1] * mixed.row[-1], None


@settings(deadline=None)  # the first compiles
@given(
    flag=st.booleans(),
    count=st.integers(-(2**63), 2**63 - 1),
    x=st.floats(allow_nan=False),
    more=st.integers(0, 0),
)
def test_each_kind_of_value_is_passed_in_and_returned(flag: bool, count: int, x: float, more: int):
    mixed = Mixed(flag, count, Point(x, -0.0), None, np.arange(3.0))
    found, is_positive, product, nothing = compiled(turned)(mixed, (more, 2.0))
    assert found == Mixed(not flag, count, Point(-0.0, x), None, mixed.row)
    assert isinstance(found, Mixed)
    assert isinstance(found.point, Point)
    assert found.row is mixed.row
    assert (is_positive, product, nothing) == (count > 0, 4.0, None)
    assert isinstance(found.flag, bool)
    assert str(found.point.x) == "-0.0"
    assert mixed.row[0] == 1.0


def first_of(row: NDArray[Any]) -> float:
    return row[0] + row[len(row) - 1]


def test_arguments_of_another_kind_get_machine_code_of_their_own():
    row = np.arange(6.0)
    entry = compiled(first_of)
    before = len(entry.kinds)
    assert entry(row) == 5.0
    assert entry(row[::2]) == 4.0  # not contiguous
    assert entry(row.astype(np.float32)) == 5.0
    assert entry(row.astype(np.int64)) == 5.0
    assert entry(np.arange(3, dtype=np.int32)) == 2.0
    assert len(entry.kinds) == before + 5
    assert entry(row) == 5.0
    assert len(entry.kinds) == before + 5
    fixed = np.arange(6.0)
    fixed.flags.writeable = False
    assert entry(fixed) == 5.0


def test_numpy_scalars_are_accepted_as_numbers():
    mixed = Mixed(np.bool_(True), np.int64(3), Point(np.float64(1.0), 2), None, np.arange(3.0))
    found, *_ = compiled(turned)(mixed, (np.int32(1), 1.0))
    assert found[:3] == (False, 4, (2.0, 1.0))


def scaled(value: Any, factor: float) -> Any:
    return value * factor


def test_an_integer_in_place_of_a_float_is_converted():
    assert compiled(scaled)(1.5, 2.0) == 3.0
    assert compiled(scaled)(2, 2.0) == 4.0


@pytest.mark.parametrize("bad", ["text", [1.0], {"a": 1}, object()], ids=lambda each: type(each).__name__)
def test_an_argument_of_an_unsupported_type_is_refused_with_the_name_of_its_type(bad: Any):
    with pytest.raises(TypeError, match=f"was given {type(bad).__name__}; allowed: int, float"):
        compiled(scaled)(bad, 2.0)


def test_too_few_arguments_are_refused():
    assert compiled(scaled)(1.0, 1.0) == 1.0
    with pytest.raises(Exception, match="argument"):
        compiled(scaled)(1.0)


def window(row: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    return row[1:], 1.0


def test_an_array_that_is_no_argument_cannot_be_returned():
    with pytest.raises(RuntimeError, match="window returns an array that is not one of its arguments"):
        compiled(window)(np.arange(3.0))


def test_code_that_allocates_does_not_compile():
    with pytest.raises(Exception, match=r"No implementation of function.*zeros"):
        compiled(lambda count: np.zeros(count).sum())(3)


LARGE, SPACED = np.arange(200_000.0), np.arange(20.0)[::2]


def item_of_large(at: int) -> float:
    return LARGE[at]


def item_of_spaced(at: int) -> float:
    return SPACED[at]


@pytest.mark.parametrize("entry", [item_of_large, item_of_spaced], ids=lambda each: each.__name__)
def test_code_with_the_address_of_a_constant_array_is_refused_and_not_cached(entry: Any, cache: Path):
    with pytest.raises(TypeError, match="constant array by its address"):
        compiled(entry)(3)
    assert not list(cache.rglob("*.code"))


class Rows(np.ndarray):
    """An array subclass that machine code does not support."""


def test_an_array_of_a_subclass_is_refused():
    with pytest.raises(TypeError, match="an array of a type"):
        compiled(first_of)(np.arange(3.0).view(Rows))


def test_a_number_of_more_than_64_bits_is_refused():
    with pytest.raises(TypeError, match="more than 64 bits"):
        compiled(lambda count: count + 1)(2**64)


def test_the_memory_layout_of_arrays_is_as_assumed():
    assert packing.is_as_expected()


KINDS: list[Kind] = [
    NumberKind("f"),
    Nothing(),
    Tuple(None, ()),
    Tuple(Point, (NumberKind("f"), NumberKind("f"))),
    Tuple(None, (Tuple(Point, (NumberKind("f"), NumberKind("i"))), NumberKind("b"), Nothing())),
]


@pytest.mark.parametrize("kind", KINDS, ids=text_of)
def test_a_kind_of_argument_is_serialized_and_read_back(kind: Kind):
    assert from_plain(plain(kind)) == kind
    size, unpack = unpacker(kind)
    assert kind_of(unpack(bytes(size))) == kind


def test_machine_code_depends_on_the_names_of_fields_too():
    before, after = (NamedTuple("Pair", [(name, float) for name in names]) for names in ("ab", "ba"))
    kinds = [kind_of(each(1.0, 2.0)) for each in (before, after)]
    assert text_of(kinds[0]) != text_of(kinds[1])


def test_arguments_of_other_kinds_are_not_packed():
    kinds = [kind_of(each) for each in (Point(1.0, 2.0), np.zeros(1), None)]
    assert isinstance(kinds[1], Array)
    pack = packer(kinds)
    assert pack((Point(1.0, 2.0), np.zeros(1), None)) is not None
    for other in (
        (Point(1.0, 2.0), np.zeros(1)),
        ((1.0, 2.0), np.zeros(1), None),
        (Point(1.0, 2.0), np.zeros(1), 0),
        (Point(1.0, "a"), np.zeros(1), None),
        (Point(1.0, (2.0, 3.0)), np.zeros(1), None),
        (None, np.zeros(1), None),
    ):
        assert pack(other) is None


class Turned(NamedTuple):
    y: float
    x: float


def test_similar_arguments_of_another_type_are_not_packed():
    record = np.dtype([("a", "f8"), ("b", "f8")])
    rows = (np.zeros(2), np.zeros(2))
    given = ((True, Point(1.0, 2.0), rows), np.zeros(1, record))
    pack = packer([kind_of(each) for each in given])
    assert pack(given) is not None
    for inner, table in (
        ((1, Point(1.0, 2.0), rows), np.zeros(1, record)),  # not a bool
        ((None, Point(1.0, 2.0), rows), np.zeros(1, record)),
        ((True, Turned(1.0, 2.0), rows), np.zeros(1, record)),
        ((True, Point(1.0, 2.0), np.zeros((2, 2))), np.zeros(1, record)),  # its rows would be gone
        ((True, Point(1.0, 2.0), list(rows)), np.zeros(1, record)),
        ((True, Point(1.0, 2.0), rows), np.zeros(1, [("b", "f8"), ("a", "f8")])),
    ):
        assert pack((inner, table)) is None


def test_an_array_of_foreign_byte_order_is_refused():
    row = np.arange(6.0)
    assert compiled(first_of)(row) == 5.0
    with pytest.raises(Exception, match=packing.SWAPPED + "f8"):
        compiled(first_of)(row.astype(packing.SWAPPED + "f8"))


def double(x: float) -> float:
    return 2.0 * x


def made(told: NotingWatcher) -> float:
    """Compile `double`, or load it from the cache, and return its result for 4.0; empty `told` before."""
    told.said.clear()
    answer = obtaining.machine_code_of(double, (NumberKind("f"),)).call((4.0,))
    assert answer == (True, 8.0)
    return answer[1]


def test_a_function_is_compiled_once_then_loaded_from_files_private_to_its_user(told: NotingWatcher, cache: Path):
    made(told)
    assert told.said == ["compiles double"]
    made(told)
    assert told.said == []
    (file,) = cache.rglob("*.code")
    assert [each.stat().st_mode & 0o777 for each in (cache, file.parent, file)] == [0o700, 0o700, 0o600]


@pytest.mark.parametrize("which", ["the root", "the folder", "the file"])
def test_machine_code_that_others_may_write_is_not_run(told: NotingWatcher, cache: Path, which: str):
    made(told)
    (file,) = cache.rglob("*.code")
    spoilt = {"the root": cache, "the folder": file.parent, "the file": file}[which]
    spoilt.chmod(0o777)
    made(told)
    assert "compiles double" in told.said
    assert f"not kept: others may write to {spoilt}" in told.said


def test_machine_code_of_another_user_is_not_run(
    told: NotingWatcher, cache: Path, monkeypatch: pytest.MonkeyPatch
):
    made(told)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    made(told)
    assert told.said == [f"not kept: {cache} belongs to another user", "compiles double"]


def test_a_symbolic_link_to_machine_code_is_not_followed(told: NotingWatcher, cache: Path, tmp_path: Path):
    made(told)
    (file,) = cache.rglob("*.code")
    file.rename(tmp_path / "elsewhere.code")
    file.symlink_to(tmp_path / "elsewhere.code")
    made(told)
    assert "compiles double" in told.said


def test_machine_code_cached_for_another_function_is_not_run(told: NotingWatcher, cache: Path):
    made(told)
    (file,) = cache.rglob("*.code")
    stored = storage.read(file)
    assert stored is not None
    other = file.with_name("0" * 16 + ".code")
    storage.keep(other, stored)
    assert storage.read(other) == stored
    other.replace(file)
    made(told)
    assert told.said == ["compiles double"]


def test_a_full_disk_is_reported_and_the_code_still_runs(
    told: NotingWatcher, cache: Path, monkeypatch: pytest.MonkeyPatch
):
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(storage, "keep", full)
    made(told)
    assert told.said == ["compiles double", f"not kept: {cache}: No space left on device"]


class Impatient(Watcher):
    """Watcher that cancels at once."""

    def compiles(self, name: str, seconds: float) -> None:
        raise KeyboardInterrupt

    def waits(self, name: str, seconds: float) -> None:
        raise KeyboardInterrupt


@pytest.fixture
def impatient() -> Iterator[None]:
    watcher = Impatient()
    compiler.watch(watcher)
    yield
    compiler.unwatch(watcher)


def test_a_compilation_can_be_cancelled(apart: None, impatient: None, cache: Path):
    with pytest.raises(KeyboardInterrupt):
        obtaining.machine_code_of(double, (NumberKind("f"),))
    assert not list(cache.rglob("*.code"))
    told = NotingWatcher()
    compiler.watch(told)
    made(told)  # nothing of it is in the way
    compiler.unwatch(told)
    assert told.said == ["compiles double"]


def test_watchers_of_compilations_can_be_removed_in_any_order():
    first, second, before = NotingWatcher(), NotingWatcher(), obtaining.watcher()
    compiler.watch(first)
    compiler.watch(second)
    compiler.unwatch(first)
    assert obtaining.watcher() is second
    compiler.unwatch(second)
    assert obtaining.watcher() is before


def test_waiting_for_another_process_can_be_cancelled(impatient: None, cache: Path):
    folder = building.folder_of(double)
    with storage.turn(folder) as turn:
        assert turn.taken()
        with pytest.raises(KeyboardInterrupt):
            obtaining.machine_code_of(double, (NumberKind("f"),))


def test_machine_code_is_cached_on_a_file_system_without_locks(cache: Path, monkeypatch: pytest.MonkeyPatch):
    """Lustre returns ENOSYS: several processes may then compile the same function."""

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    monkeypatch.setattr(fcntl, "flock", refuse)
    kinds = (NumberKind("f"),)
    obtaining.machine_code_of(double, kinds)
    assert storage.read(building.file_of(double, kinds)) is not None


def test_temporary_files_of_a_killed_process_are_removed_from_the_cache(cache: Path):
    folder = building.folder_of(double)
    with storage.turn(folder):
        left = folder / files.name_beside("code")
        left.touch()
    obtaining.machine_code_of(double, (NumberKind("f"),))
    assert not left.exists()


@pytest.fixture
def started(apart: None, monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[bytes]]:
    """List of the compiler's processes."""
    found: list[subprocess.Popen[bytes]] = []

    class Noted(subprocess.Popen[bytes]):
        def __init__(self, *arguments: Any, **more: Any) -> None:
            super().__init__(*arguments, **more)
            found.append(self)

    monkeypatch.setattr(subprocess, "Popen", Noted)
    return found


def request_of(function: Any) -> child.CompileRequest:
    return child.CompileRequest(function, (NumberKind("f"),), building.key_of(function))


def test_cancelling_ends_the_compiling_process(
    started: list[subprocess.Popen[bytes]], monkeypatch: pytest.MonkeyPatch
):
    def give_up() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(child, "_LOOK_S", 0.001)
    with pytest.raises(KeyboardInterrupt):
        child.compile_apart(request_of(double), give_up)
    assert [each.returncode for each in started] == [-9]


@compilable
def halved(x: float) -> float:
    return 0.5 * x


def one_more(x: float) -> float:
    return halved(x) + 1.0


def one_less(x: float) -> float:
    return halved(x) - 1.0


def text_sections(code: bytes) -> list[bytes]:
    return [each.data() for each in ObjectFileRef.from_data(code).sections() if each.is_text()]


def test_a_shared_compiling_process_makes_the_same_code_as_separate_ones(started: list[subprocess.Popen[bytes]]):
    requests = [request_of(each) for each in (one_more, one_less)]
    alone = [child.compile_apart(each, lambda: None) for each in requests]
    assert [each.returncode for each in started] == [-9, -9]
    started.clear()
    with child.sharing():
        shared = [child.compile_apart(each, lambda: None) for each in requests]
        (process,) = started
        assert process.poll() is None
        os.kill(process.pid, signal.SIGKILL)  # between two requests, as with the thread that had it started
        process.wait()
        assert child.compile_apart(requests[0], lambda: None) == shared[0]
    assert len(started) == 2
    assert [each.returncode for each in started] == [-9, -9]
    assert [text_sections(each.code) for each in alone] == [text_sections(each.code) for each in shared]


def test_a_killed_compiling_process_is_reported(
    started: list[subprocess.Popen[bytes]], monkeypatch: pytest.MonkeyPatch
):
    def kill() -> None:
        started[-1].kill()

    monkeypatch.setattr(child, "_LOOK_S", 0.001)
    with pytest.raises(child.CompileError, match=r"ended from outside \(signal 9\)"):
        child.compile_apart(request_of(double), kill)
    assert [each.returncode for each in started] == [-9]


def test_waiting_for_a_compiling_process_that_does_not_read_can_be_cancelled(
    started: list[subprocess.Popen[bytes]], monkeypatch: pytest.MonkeyPatch
):
    looks = []

    def give_up() -> None:
        looks.append(1)
        if len(looks) > 3:
            raise GivenUpError

    monkeypatch.setattr(child, "_START", "import time; time.sleep(60)")
    request = child.CompileRequest(double, (NumberKind("f"),), "a key that fills a pipe: " + "x" * 1_000_000)
    with pytest.raises(GivenUpError):
        child.compile_apart(request, give_up)
    assert [each.returncode for each in started] == [-9]


def test_a_forked_process_does_not_end_its_parents_compiler(apart: None):
    with child.sharing():
        assert child.compile_apart(request_of(double), lambda: None) is not None
        kept = child._Kept.compiler
        pid = os.fork()
        if pid == 0:
            os._exit(0 if child._Kept.compiler is None else 1)
        assert os.waitpid(pid, 0)[1] == 0
        assert child._Kept.compiler is kept is not None
        assert kept._process.poll() is None


def test_a_compiling_process_with_other_sources_returns_nothing(apart: None):
    request = child.CompileRequest(double, (NumberKind("f"),), "another key")
    assert child.compile_apart(request, lambda: None) is None


def test_an_error_in_the_code_is_reported_by_numba():
    from numba.core.errors import TypingError

    with pytest.raises(TypingError, match="unknown"):
        compiled(lambda x: x.unknown)(1.0)


def test_a_start_with_cached_machine_code_does_not_import_numba():
    code = (
        "import sys; from tests.compiler import test_machine_code as t; "
        "from liftgate_compiler import compiled; "
        "assert compiled(t.double)(3.0) == 6.0; print('numba' in sys.modules)"
    )
    for _ in range(2):
        said = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2]
        ).stdout
    assert said == "False\n"
