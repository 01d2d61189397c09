"""Recording files: an unusable one is reported in one line, and no foreign data is lost."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from recording_support import BOTH, messages_in, read_csv, rows_from, sent, started, table_in

from liftgate_hil.errors import ConfigError
from liftgate_hil.formats.open import check_file, open_writer
from liftgate_hil.formats.suffixes import FORMATS, RECORDED, TABLES

SPOILT = [suffix for suffix in RECORDED if not FORMATS[suffix].is_text]
FULL = pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")


@pytest.mark.parametrize(
    "name",
    ["x", "x.", "x.pcap", ".csv.gz", "nosuch/folder/x.csv", "x.csv/y.log", "x.txt", "x" * 300 + ".csv", "x\0.csv"],
)
def test_an_unusable_file_name_is_reported_before_the_run(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"^`record` "):
        check_file("record", name)


def link_to_itself(path: Path) -> None:
    path.symlink_to(path)


@pytest.mark.parametrize(
    ("make", "suffix", "said"),
    [
        *((Path.mkdir, suffix, "is a folder") for suffix in RECORDED),
        *((link_to_itself, suffix, "symbolic links") for suffix in RECORDED),
        *((os.mkfifo, suffix, "a pipe or a device") for suffix in SPOILT),  # formats that are completed at the end
    ],
)
def test_an_unusable_target_is_reported_before_the_run(
    tmp_path: Path, make: Callable[[Path], None], suffix: str, said: str
) -> None:
    path = tmp_path / f"run{suffix}"
    make(path)
    with pytest.raises(ConfigError, match=said):
        check_file("record", str(path))


@pytest.mark.parametrize(
    ("suffix", "module", "extra"),
    [(".mf4", "asammdf", "mf4"), (".mcap", "mcap", "mcap"), (".parquet", "pyarrow", "parquet")],
)
def test_a_missing_package_is_reported_with_the_command_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, module: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigError, match=rf"pip install 'liftgate-hil\[{extra}\]'"):
        check_file("record", str(tmp_path / f"x{suffix}"))


def test_checking_a_csv_file_name_imports_no_heavy_modules() -> None:
    code = (
        "import sys; from liftgate_hil.formats.open import check_file; check_file('record', 'x.csv');"
        "assert not {'can', 'asammdf', 'mcap', 'pyarrow', 'numba', 'matplotlib'} & set(sys.modules), sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("suffix", [".csv", ".log"])
def test_a_pipe_without_a_reader_is_refused_without_blocking(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"pipe{suffix}"
    os.mkfifo(path)
    with pytest.raises(ConfigError, match="a pipe without a reader"):
        open_writer(check_file("record", str(path)), BOTH)


@pytest.fixture
def pipe(tmp_path: Path) -> Iterator[tuple[Path, int]]:
    """A named pipe, and the descriptor of its reader."""
    path = tmp_path / "pipe.csv"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    yield path, reader
    os.close(reader)


def test_a_pipe_that_is_not_read_ends_the_recording_with_one_message(pipe: tuple[Path, int]) -> None:
    told: list[str] = []
    recorder = open_writer(pipe[0], BOTH, say=told.append, patience=0.01)
    for first in range(0, 3000, 100):  # more than a pipe holds
        recorder.write_rows(rows_from(first, 100))
        recorder.flush()
    recorder.close()
    said = "its reader stalled for 0.01 s: unread and later rows or frames are lost"
    assert told == [recorder.failure]
    assert recorder.failure.endswith(said)
    assert "recording ended at 0." in recorder.failure


def test_a_pipe_with_a_slow_reader_gets_all_rows(pipe: tuple[Path, int]) -> None:
    (path, reader), got = pipe, list[bytes]()

    def read() -> None:
        os.set_blocking(reader, True)
        while come := os.read(reader, 4096):
            got.append(come)

    recorder = open_writer(path, BOTH, patience=60.0)
    thread = threading.Thread(target=read)
    thread.start()
    recorder.write_rows(rows_from(0, 3000))
    recorder.close()
    thread.join()
    assert recorder.failure == ""
    assert b"".join(got).count(b"\n") == 3001


def test_a_pipe_with_a_reader_gets_the_csv_text(pipe: tuple[Path, int]) -> None:
    recorder = open_writer(pipe[0], BOTH)
    recorder.write_rows(rows_from(0, 3))
    recorder.close()
    assert os.read(pipe[1], 1 << 16).count(b"\n") == 4


# Somebody else's.


@pytest.mark.parametrize("suffix", RECORDED)
@pytest.mark.filterwarnings("ignore")
def test_recording_to_a_file_that_is_being_recorded_is_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    first = started(path)
    with pytest.raises(ConfigError, match=r"^`record` .*another recording is being written to it"):
        open_writer(path, BOTH)
    first.close()
    assert first.failure == ""
    assert path.stat().st_size > 30
    open_writer(path, BOTH).close()  # it is free again, and what is there is set aside


@pytest.mark.parametrize("suffix", SPOILT)
def test_a_text_file_left_by_a_crash_is_never_overwritten(tmp_path: Path, suffix: str) -> None:
    path, left = tmp_path / f"run{suffix}", ".log" if FORMATS[suffix].has_frames else ".csv"
    salvage = path.with_name(path.name + left)
    path.write_bytes(b"before")
    salvage.write_text("all that there is")
    with pytest.raises(ConfigError, match=f"run{suffix}{left}: already exists, left by"):
        open_writer(path, BOTH)
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == {
        path.name: b"before",
        salvage.name: b"all that there is",
    }


# Until it is complete.


@pytest.mark.parametrize("suffix", SPOILT)
@pytest.mark.filterwarnings("ignore")
def test_until_a_recording_is_complete_there_is_a_text_file_beside_it(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    recorder = started(path)
    recorder.flush()
    if FORMATS[suffix].has_frames:
        assert len(messages_in(tmp_path / f"run{suffix}.log")) == 1
    if FORMATS[suffix].has_rows:
        assert len(read_csv(tmp_path / f"run{suffix}.csv")) == 3
    recorder.close()
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", SPOILT)
@pytest.mark.filterwarnings("ignore")
def test_a_recording_that_cannot_be_completed_leaves_its_text_file(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"run{suffix}"
    recorder = started(path)
    inner = recorder._parts._part._recorder  # type: ignore[attr-defined]

    def fail() -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(inner, "close", fail)
    recorder.close()
    left = sorted(each.name for each in tmp_path.iterdir() if each.suffix != suffix)
    left = [name for name in left if name.startswith("run")]
    assert "No space left on device; the data recorded so far is in" in recorder.failure
    assert left
    assert all(str(tmp_path / name) in recorder.failure for name in left)


@FULL
@pytest.mark.parametrize("suffix", [".csv", ".log"])
def test_a_full_disk_is_reported_at_once_and_ends_only_the_recording(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"full{suffix}"
    path.symlink_to("/dev/full")
    said: list[str] = []
    recorder = open_writer(path, BOTH, say=said.append)
    recorder.begin(0)
    for k in range(3):
        recorder.write_rows(rows_from(k, 1))
        recorder.write_frames(sent([(0x120, b"a")]))
        recorder.flush()
        assert said == [f"`record` {path}: recording ended at 0.000 s: No space left on device"]
    recorder.close()
    assert said == [recorder.failure]


@pytest.fixture(scope="module")
def on_a_full_disk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, list[str]]]:
    """Record to a folder with files of 100 kB at most; return it, and by suffix the messages and the files."""
    base = tmp_path_factory.mktemp("full")
    code = f"""
import json, resource, sys, warnings
warnings.simplefilter("ignore")
from recording_support import BOTH, rows_from, sent
from pathlib import Path
from liftgate_hil.formats.open import open_writer
said, recorders = {{}}, {{}}
for suffix in {SPOILT!r}:
    folder = Path({str(base)!r}, suffix)
    folder.mkdir()
    said[suffix] = []
    recorder = recorders[suffix] = open_writer(folder / ("run" + suffix), BOTH, say=said[suffix].append)
    recorder.begin(0)
    recorder.write_rows(rows_from(0, 1))  # what is compiled is compiled before
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
for suffix, recorder in recorders.items():
    for k in range(1, 1000):
        recorder.write_rows(rows_from(20 * k, 20))
        recorder.write_frames(sent([(0x120, bytes(8))] * 20))
        recorder.flush()
        if recorder.failure:
            break
    recorder.close()
    said[suffix] += [recorder.failure, " ".join(map(str, recorder.files))]
print(json.dumps(said))
"""
    folder = Path(__file__).parent
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(folder.parent), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-B", "-c", code], capture_output=True, text=True, check=True, env=environment
    )
    return base, json.loads(done.stdout)


@pytest.mark.parametrize("suffix", SPOILT)
def test_a_full_disk_leaves_the_text_file_of_a_recording_completed_at_its_end(
    on_a_full_disk: tuple[Path, dict[str, list[str]]], suffix: str
) -> None:
    folder, lines = on_a_full_disk[0] / suffix, on_a_full_disk[1][suffix]
    (said,) = {*lines[:-1]}
    when, texts = said.partition("recording ended at ")[2].split(
        " s: File too large; the data recorded so far is in "
    )
    assert float(when) > 0.1
    left = [each for each in folder.iterdir() if each.name.startswith(f"run{suffix}.")]
    assert {str(each) for each in left} == {*texts.split(" and ")} != set()
    assert {*lines[-1].split(" ")} == {str(each) for each in left}  # instead of the file itself
    for each in left:
        whole, _, _cut = each.read_bytes().rpartition(b"\n")
        assert whole.count(b"\n") > 100


@pytest.mark.parametrize("suffix", TABLES)
@pytest.mark.filterwarnings("ignore")
def test_rows_are_copied_before_the_call_returns(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    recorder = open_writer(path, BOTH)
    recorder.begin(0)
    block = rows_from(1, 3)
    recorder.write_rows(block)
    block[:] = 0.0
    recorder.close()
    assert recorder.failure == ""
    assert table_in(path)["time_s"].tolist() == [0.001, 0.002, 0.003]
