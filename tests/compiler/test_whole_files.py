"""Atomic files: complete or unchanged; files left by killed processes are removed, and no others."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import io
import itertools
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from liftgate_compiler import files
from liftgate_compiler.files import lock, name_beside, remove_leftovers, rename_new, whole_file, write_whole


def refusing(number: int) -> Callable[..., Any]:
    def refuse(*_: object, **more: object) -> None:
        raise OSError(number, os.strerror(number))

    return refuse


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """An existing file."""
    found = tmp_path / "report.html"
    found.write_bytes(b"before")
    return found


def test_a_file_is_replaced_with_its_permissions(tmp_path: Path, path: Path) -> None:
    path.chmod(0o600)
    write_whole(path, b"after")
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (b"after", 0o600)
    assert list(tmp_path.iterdir()) == [path]


def test_a_symbolic_link_is_kept_and_its_target_written(tmp_path: Path) -> None:
    path, link = tmp_path / "report.html", tmp_path / "latest.html"
    link.symlink_to(path.name)
    write_whole(link, b"content")
    assert link.is_symlink()
    assert path.read_bytes() == b"content"


@pytest.mark.parametrize("name", ["ä" * 127, "x" * 255])
def test_a_name_may_be_as_long_as_the_file_system_allows(tmp_path: Path, name: str) -> None:
    write_whole(tmp_path / name, b"content")
    assert [each.name for each in tmp_path.iterdir()] == [name]


def test_a_pipe_is_written_to(tmp_path: Path) -> None:
    path, read = tmp_path / "pipe", []
    os.mkfifo(path)
    reader = threading.Thread(target=lambda: read.append(path.read_bytes()))
    reader.start()
    write_whole(path, b"content")
    reader.join(60.0)
    assert read == [b"content"]
    assert path.is_fifo()


def test_a_pipe_by_the_name_of_its_descriptor_is_written_to() -> None:
    read, write = os.pipe()
    write_whole(Path(f"/dev/fd/{write}"), b"content")
    os.close(write)
    with os.fdopen(read, "rb") as stream:
        assert stream.read() == b"content"


def test_an_unlinked_file_is_written_by_its_descriptor(tmp_path: Path) -> None:
    with (tmp_path / "gone").open("w+b") as stream:
        (tmp_path / "gone").unlink()
        write_whole(Path(f"/dev/fd/{stream.fileno()}"), b"content")
        assert stream.read() == b"content"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [errno.EBUSY, errno.EPERM, errno.EACCES, errno.EROFS, errno.EINVAL])
def test_a_file_that_cannot_be_replaced_is_written_in_place(
    tmp_path: Path, path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    path.write_bytes(b"before, and longer")
    monkeypatch.setattr(Path, "replace", refusing(number))
    write_whole(path, b"after")
    assert path.read_bytes() == b"after"
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(OSError, match=os.strerror(number)):
        write_whole(tmp_path / "new.xml", b"content")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("place", ["beside", "spooled"])
def test_a_file_that_cannot_be_replaced_stays_if_the_disk_is_full(
    tmp_path: Path, path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    """The new content goes beside the file or, if the folder takes no file, to a temporary one."""
    monkeypatch.setattr(Path, "replace", refusing(errno.EBUSY))
    if place == "spooled":
        monkeypatch.setattr(files, "_created", refusing(errno.EACCES))
    monkeypatch.setattr(os, "posix_fallocate", refusing(errno.ENOSPC))
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, b"after, and longer")
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]
    monkeypatch.setattr(os, "posix_fallocate", refusing(errno.EOPNOTSUPP))  # nobody can tell
    write_whole(path, b"after, and longer")
    assert path.read_bytes() == b"after, and longer"
    write_whole(path, b"less")
    assert path.read_bytes() == b"less"


def test_a_failed_copy_leaves_the_complete_content_beside_the_file(
    tmp_path: Path, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "replace", refusing(errno.EBUSY))
    monkeypatch.setattr("shutil.copyfileobj", refusing(errno.EIO))
    with pytest.raises(OSError, match="the whole content is in ") as error:
        write_whole(path, b"after")
    (beside,) = set(tmp_path.iterdir()) - {path}
    assert str(beside) in str(error.value)
    assert beside.read_bytes() == b"after"


@pytest.mark.parametrize("is_replaceable", [True, False])
def test_an_exception_of_the_writer_leaves_the_file_unchanged_and_closes_it(
    tmp_path: Path, path: Path, monkeypatch: pytest.MonkeyPatch, is_replaceable: bool
) -> None:
    streams = []
    if not is_replaceable:
        monkeypatch.setattr(files, "_created", refusing(errno.EACCES))

    def stopped() -> None:
        with whole_file(path) as stream:
            streams.append(stream)
            stream.write(b"half of it")
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        stopped()
    assert streams[0].closed
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")
def test_a_file_keeps_its_owner(path: Path) -> None:
    os.chown(path, 65534, 65534)
    path.chmod(0o600)
    write_whole(path, b"after")
    assert (path.stat().st_uid, path.stat().st_gid, path.stat().st_mode & 0o777) == (65534, 65534, 0o600)


# The n-th operation on the file system fails.


class Faults:
    """Counts file operations, the `at`-th of which fails with this error number."""

    def __init__(self, at: int, number: int) -> None:
        self._at, self._number, self._count = at, number, 0
        self.failed = ""

    def pass_by(self, name: str) -> None:
        self._count += 1
        if self._count == self._at:
            self.failed = name
            raise OSError(self._number, os.strerror(self._number))

    def around(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def called(*arguments: Any, **more: Any) -> Any:
            self.pass_by(name)
            return function(*arguments, **more)

        return called

    def stream(self, descriptor: int, path: Path) -> io.BufferedWriter:
        faults = self

        class Stream(io.FileIO):
            def write(self, content: Any) -> int:
                faults.pass_by("write")
                return super().write(content)

        return io.BufferedWriter(Stream(descriptor, "wb"))


@pytest.fixture
def faulty(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int, int], Faults]]:
    """Function that lets the n-th file operation fail with an error number and returns the counter."""

    def begin(at: int, number: int) -> Faults:
        monkeypatch.undo()
        faults = Faults(at, number)
        for name in ("open", "fstat", "fchmod", "dup", "fsync", "replace", "link", "rename"):
            monkeypatch.setattr(os, name, faults.around(name, getattr(os, name)))
        monkeypatch.setattr(files, "_stream_of", faults.stream)
        return faults

    yield begin
    monkeypatch.undo()


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC, errno.EDQUOT])
@pytest.mark.parametrize("before", [b"before", None])
def test_any_failing_operation_leaves_the_file_unchanged_and_no_temporary_files(
    tmp_path: Path, faulty: Callable[[int, int], Faults], before: bytes | None, number: int
) -> None:
    path, seen = tmp_path / "report.json", set[str]()
    for at in itertools.count(1):
        path.unlink(missing_ok=True)
        if before is not None:
            path.write_bytes(before)
        faults = faulty(at, number)
        if not faults.failed:
            with contextlib.suppress(OSError):
                write_whole(path, b"after")
        seen.add(faults.failed)
        faulty(0, 0)
        assert (path.read_bytes() if path.exists() else None) == (before if faults.failed else b"after")
        assert [each.name for each in tmp_path.iterdir()] == [path.name] * path.exists()
        if not faults.failed:
            break
    assert {"open", "dup", "write", "fsync", "replace"} <= seen


@pytest.mark.parametrize("fails", ["fsync", "fchmod", None])
def test_a_failing_close_hides_no_earlier_error_and_is_ignored_once_the_data_are_on_disk(
    tmp_path: Path, path: Path, monkeypatch: pytest.MonkeyPatch, fails: str | None
) -> None:
    """Once the data are on disk, an error on closing the descriptor does no harm."""
    close = os.close

    def failing(descriptor: int) -> None:
        close(descriptor)
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "close", failing)
    if fails is not None:
        monkeypatch.setattr(os, fails, refusing(errno.ENOSPC))
        with pytest.raises(OSError, match=os.strerror(errno.ENOSPC)) as caught:
            write_whole(path, b"content")
        assert caught.value.filename == str(path)
        assert path.read_bytes() == b"before"
    else:
        write_whole(path, b"content")
        assert path.read_bytes() == b"content"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_that_cannot_be_read_is_not_replaced(
    tmp_path: Path, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = tmp_path / "latest.html"
    link.symlink_to(path.name)
    with monkeypatch.context() as patch:
        patch.setattr(os, "lstat", refusing(errno.EIO))
        with pytest.raises(OSError, match=os.strerror(errno.EIO)) as caught:
            write_whole(link, b"content")
    assert caught.value.filename == str(link)
    assert link.is_symlink()
    assert path.read_bytes() == b"before"


def test_a_writer_can_close_the_stream_itself(tmp_path: Path) -> None:
    with whole_file(tmp_path / "results.parquet") as stream:
        stream.write(b"all")
        stream.close()
    assert (tmp_path / "results.parquet").read_bytes() == b"all"


def test_a_new_file_never_replaces_an_existing_one(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    write_whole(path, b"first", is_new=True)
    with pytest.raises(FileExistsError):
        write_whole(path, b"second", is_new=True)

    def overtaken() -> None:
        with whole_file(tmp_path / "other.toml", is_new=True) as stream:
            (tmp_path / "other.toml").write_bytes(b"somebody's")  # that comes meanwhile
            stream.write(b"ours")

    with pytest.raises(FileExistsError):
        overtaken()
    assert path.read_bytes() == b"first"
    assert (tmp_path / "other.toml").read_bytes() == b"somebody's"
    assert len(list(tmp_path.iterdir())) == 2


def test_without_hard_links_a_renamed_file_replaces_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "link", refusing(errno.EPERM))
    (tmp_path / "one").write_bytes(b"one")
    (tmp_path / "two").write_bytes(b"two")
    rename_new(tmp_path / "one", tmp_path / "three")
    with pytest.raises(FileExistsError):
        rename_new(tmp_path / "two", tmp_path / "three")
    assert (tmp_path / "three").read_bytes() == b"one"
    assert (tmp_path / "two").read_bytes() == b"two"
    monkeypatch.setattr(Path, "rename", refusing(errno.EIO))
    with pytest.raises(OSError, match=os.strerror(errno.EIO)):
        rename_new(tmp_path / "two", tmp_path / "four")
    assert not (tmp_path / "four").exists()


def test_requested_permissions_apply_to_a_replaced_file(path: Path) -> None:
    path.chmod(0o666)
    write_whole(path, b"after", mode=0o600)
    assert path.stat().st_mode & 0o777 == 0o600


# What killed processes leave.


def leave(folder: Path, name: str) -> Path:
    """Kill a process while it writes a file, and return the temporary file that it leaves."""
    code = f"""
import os, signal
from pathlib import Path
from liftgate_compiler.files import whole_file
with whole_file(Path({str(folder / name)!r})) as stream:
    stream.write(b"half of it")
    os.kill(os.getpid(), signal.SIGKILL)
"""
    subprocess.run([sys.executable, "-c", code], check=False)
    (left,) = [each for each in folder.iterdir() if each.name.startswith(f".{name}.liftgate-")]
    return left


def test_files_left_by_a_killed_process_are_removed_and_no_others(tmp_path: Path) -> None:
    left, other = leave(tmp_path, "report.html"), leave(tmp_path, "verdicts.json")
    theirs = [tmp_path / name for name in (".report.html.swp", "report.html", ".report.html.liftgate-1")]
    for each in theirs:
        each.write_bytes(b"somebody's")
    with whole_file(tmp_path / "report.html") as stream:  # of a process that goes on
        remove_leftovers(tmp_path, "report.html")
        assert not left.exists()
        assert other.exists()
        remove_leftovers(tmp_path)
        assert not other.exists()
        stream.write(b"whole")
    assert (tmp_path / "report.html").read_bytes() == b"whole"
    assert {each.name for each in tmp_path.iterdir()} == {each.name for each in theirs}


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_without_file_locks_files_are_written_and_leftovers_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    left = tmp_path / name_beside("report.html")
    left.write_bytes(b"whose")
    monkeypatch.setattr(fcntl, "flock", refusing(number))
    with left.open("rb") as stream:
        assert not lock(stream.fileno())
    remove_leftovers(tmp_path)
    write_whole(tmp_path / "report.html", b"whole")
    assert left.exists()
    assert (tmp_path / "report.html").read_bytes() == b"whole"


def test_a_writer_whose_temporary_file_was_removed_uses_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    removed: list[int] = []

    def late(descriptor: int) -> bool:
        if not removed:  # another process comes between open and lock
            (left,) = tmp_path.iterdir()
            left.unlink()
            removed.append(descriptor)
        return True

    monkeypatch.setattr(files, "lock", late)
    write_whole(tmp_path / "report.html", b"whole")
    assert removed
    assert [each.name for each in tmp_path.iterdir()] == ["report.html"]
