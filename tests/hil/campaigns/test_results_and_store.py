"""Result rows as tables and back; the store holds tables whole or not at all."""

from __future__ import annotations

import errno
import math
import os
import pickle
import resource
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.evaluation import Row, error_row
from liftgate_hil.campaigns.figures import NO_FIGURES, Figures
from liftgate_hil.campaigns.prepared import prepared
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.results import check_columns, columns_of, description_of, numbers_in, table_of
from liftgate_hil.campaigns.store import Store, StoreError
from liftgate_hil.errors import ConfigError
from liftgate_hil.judging.verdict import VERDICTS

CALM = settings(deadline=None, derandomize=True, database=None, max_examples=60)


@cache
def base() -> Base:
    return prepared(
        CampaignRequest("pack/undisturbed", ("supply.voltage=9,12", "gate.gravity_point[0]=0.4,0.5"))
    ).base


def row_of(verdict: str = "pass", margin: float = 1.0, error: str = "") -> Row:
    count = len(base().expectations)
    figures = Figures(*(float(k) for k in range(len(Figures._fields))))
    return Row(verdict, (margin,) * count, figures, 0.25, error, (verdict,) * count)


def table_with(count: int = 5) -> pa.Table:
    values = np.random.default_rng(4).random((count, 2))
    return table_of(base(), values, [row_of(margin=float(k)) for k in range(count)])


def assert_same(found: list[Row], expected: list[Row]) -> None:
    np.testing.assert_equal([(*each,) for each in found], [(*each,) for each in expected])


def rows_of(table: pa.Table) -> list[Row]:
    """Return the rows of a table as `table_of` got them, with null as NaN."""
    names = [f"margin.{each}" for each in base().expectations]
    numbers = {each: numbers_in(table, each).tolist() for each in (*names, *Figures._fields, "wall_s")}
    return [
        Row(
            each["verdict"],
            tuple(numbers[name][k] for name in names),
            Figures(*(numbers[name][k] for name in Figures._fields)),
            numbers["wall_s"][k],
            each["error"] or "",
            tuple(each[f"verdict.{name}"] for name in base().expectations),
        )
        for k, each in enumerate(table.to_pylist())
    ]


numbers = st.floats(allow_nan=True, allow_infinity=False)
COUNT = len(base().expectations)
rows = st.builds(
    Row,
    st.sampled_from(VERDICTS),
    st.tuples(*[numbers] * COUNT),
    st.tuples(*[numbers] * len(Figures._fields)).map(Figures._make),
    numbers,
    st.text(st.characters(exclude_categories=["Cs"])),
    st.tuples(*[st.sampled_from(VERDICTS)] * COUNT),
)


@CALM
@given(st.lists(rows, min_size=1, max_size=5))
def test_rows_read_back_from_their_table_to_the_last_bit(given_rows: list[Row]) -> None:
    values = np.arange(2.0 * len(given_rows)).reshape(-1, 2)
    assert_same(rows_of(table_of(base(), values, given_rows)), given_rows)


def test_a_table_has_the_result_columns_in_their_documented_order() -> None:
    table = table_with()
    margins = [f"{prefix}.{each}" for prefix in ("verdict", "margin") for each in base().expectations]
    assert len(margins) > 2
    assert table.column_names == [
        "variant",
        "supply.voltage",
        "gate.gravity_point[0]",
        "verdict",
        *margins,
        *Figures._fields,
        "wall_s",
        "error",
    ]
    assert table.column_names == list(columns_of(base())) == list(description_of(base()))


def test_unknown_results_are_null_and_keep_the_column_types() -> None:
    table = table_of(base(), np.ones((2, 2)), [row_of(), error_row(base(), "it broke")])
    second = table.to_pylist()[1]
    assert second["error"] == "it broke"
    assert second["verdict"] == "error"
    unknown = {name for name, each in second.items() if each is None}
    assert unknown == {*(f"margin.{each}" for each in base().expectations), *Figures._fields, "wall_s"}
    assert table["error"].to_pylist()[0] is None
    np.testing.assert_array_equal(numbers_in(table, "peak_pinch_force_n"), [0.0, math.nan])
    assert math.isnan(NO_FIGURES.peak_pinch_force_n)
    errors = table_of(base(), np.zeros((2, 2)), [error_row(base(), "no result")] * 2)
    assert errors.schema == table.schema == table_with().schema


def test_a_table_has_the_name_and_the_varied_values_of_each_variant() -> None:
    values = np.array([[9.5, 0.41], [12.0, 0.42]])
    table = table_of(base(), values, [row_of(), row_of()])
    assert table["variant"].to_pylist() == [base().variant(each) for each in values.tolist()]
    np.testing.assert_array_equal(numbers_in(table, "supply.voltage"), values[:, 0])
    np.testing.assert_array_equal(numbers_in(table, "gate.gravity_point[0]"), values[:, 1])


@pytest.mark.parametrize("name", ["verdict", "error", "wall_s", "peak_current_a", "variant"])
def test_a_varied_name_equal_to_a_result_column_is_refused(name: str) -> None:
    target = base().targets[0]._replace(name=name)
    with pytest.raises(ConfigError, match=f"`vary` {name}: allowed: names that no column of the results has"):
        check_columns(replace(base(), targets=(target,)))


@pytest.fixture(params=["folder", "memory"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Store:
    if request.param == "memory":
        pytest.importorskip("fsspec")
    made = Store(str(tmp_path / "a" / "batches") if request.param == "folder" else f"memory://{tmp_path}/batches")
    made.create()
    return made


def test_a_store_returns_the_last_table_put_under_each_name(store: Store) -> None:
    assert store.get("ab") is None
    assert store.names() == set()
    table = table_with()
    for name, each in (("ab", table_with(2)), ("cd", table_with(2)), ("ab", table)):
        store.put(name, each)
    store.create()  # again, which keeps what is there
    mark = store.mark()
    assert store.names() == pickle.loads(pickle.dumps(store)).names() == {"ab", "cd"}
    store.unmark(mark)
    found = store.get("ab")
    assert found is not None
    assert found.equals(table)


def test_a_store_is_shared_only_with_a_process_that_sees_its_mark(store: Store, tmp_path: Path) -> None:
    mark = store.mark()
    assert store.is_shared(mark)
    assert not Store(str(tmp_path / "another")).is_shared(mark)
    assert not Store(f"memory://{tmp_path}/another").is_shared(mark)
    store.unmark(mark)
    assert not store.is_shared(mark)


def test_marks_are_unique_and_removing_a_missing_mark_is_no_error(store: Store) -> None:
    marks = store.mark(), store.mark()
    assert marks[0] != marks[1]
    for each in (*marks, "never.there"):
        store.unmark(each)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    Store(str(tmp_path / "batches")).create()
    return tmp_path / "batches"


def test_a_truncated_or_damaged_file_counts_as_missing(folder: Path) -> None:
    """A damaged file is still read if no value comes from the damaged byte."""
    store, path = Store(str(folder)), folder / "ab.parquet"
    table = pa.table({"variant": [f"v{k}" for k in range(40)], "x": np.random.default_rng(0).random(40)})
    store.put("ab", table)
    whole = path.read_bytes()
    for length in [0, 1, 4, 8, *range(16, len(whole), 97), len(whole) - 1]:
        path.write_bytes(whole[:length])
        assert store.get("ab") is None
    for place in range(4, len(whole) // 3, 3):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << (place % 8)
        path.write_bytes(damaged)
        found = store.get("ab")
        assert found is None or found.equals(table)


@pytest.mark.parametrize("content", [b"PAR1", b"PAR1" + bytes(100) + b"PAR1", b"no table", bytes(4096)])
def test_a_file_of_another_kind_counts_as_missing(content: bytes, folder: Path) -> None:
    (folder / "ab.parquet").write_bytes(content)
    assert Store(str(folder)).get("ab") is None


def test_files_get_their_final_names_only_when_complete(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[list[str]] = []
    sync = os.fsync

    def looking(descriptor: int) -> None:
        sync(descriptor)
        seen.append([each.name for each in folder.iterdir()])

    monkeypatch.setattr(os, "fsync", looking)
    Store(str(folder)).put("ab", table_with())
    (beside,) = seen
    assert len(beside) == 1
    assert beside[0].startswith(".ab.parquet.")
    assert pq.read_table(folder / "ab.parquet").num_rows == 5


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EIO, 0])  # 0: interrupted
def test_a_failed_or_interrupted_put_keeps_the_previous_table_and_leaves_no_temporary_file(
    number: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(str(folder))
    store.put("ab", table_with(2))

    def failing(descriptor: int) -> None:
        raise OSError(number, os.strerror(number)) if number else KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", failing)
    expected = (StoreError, f"{folder}: .*{os.strerror(number)}") if number else (KeyboardInterrupt, "^$")
    for name in ("ab", "cd"):
        with pytest.raises(expected[0], match=expected[1]):
            store.put(name, table_with(3))
    monkeypatch.undo()
    assert [each.name for each in folder.iterdir()] == ["ab.parquet"]
    found = store.get("ab")
    assert found is not None
    assert found.num_rows == 2


LIMITED = """
import pickle, resource, signal, sys
from liftgate_hil.campaigns.store import StoreError
store, table, limit = pickle.loads(sys.stdin.buffer.read())
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    store.put("ab", table)
except StoreError as error:
    print(error)
"""


def test_a_put_cut_off_by_the_file_size_limit_leaves_no_temporary_file(folder: Path) -> None:
    assert resource.RLIMIT_FSIZE is not None
    content = pickle.dumps((Store(str(folder)), table_with(), 1000))
    done = subprocess.run(
        [sys.executable, "-B", "-c", LIMITED], input=content, capture_output=True, check=True, timeout=60
    )
    assert os.strerror(errno.EFBIG) in done.stdout.decode()
    assert str(folder) in done.stdout.decode()
    assert list(folder.iterdir()) == []


def test_a_store_folder_that_vanished_is_reported(folder: Path) -> None:
    store = Store(str(folder))
    folder.rmdir()
    for call in (lambda: store.put("ab", table_with()), store.names, store.mark):
        with pytest.raises(StoreError, match=f"{folder}: .*{os.strerror(errno.ENOENT)}"):
            call()
    assert not folder.exists()


def test_a_folder_that_cannot_be_made_is_refused_with_what_is_allowed(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for address in (f"{tmp_path}/file/batches", "nowhere://x"):
        with pytest.raises(ConfigError, match=f"`store` {address}: .*allowed: a folder to write to"):
            Store(address).create()
    with pytest.raises(StoreError):
        Store(str(tmp_path / "file")).get("ab")


def test_foreign_files_in_the_folder_do_not_count_as_batches(folder: Path) -> None:
    for name in ("notes.txt", ".ab.parquet.0123", ".hidden.parquet", "sub"):
        (folder / name).write_text("")
    assert Store(str(folder)).names() == set()


OWN, OTHER = "0" * 32, "1" * 32


def test_a_campaign_that_ends_removes_only_its_own_temporary_files_and_marks(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Left behind are a batch and a mark of the campaign, and a mark of another campaign, which stays."""

    def killed(*_: object) -> None:
        raise SystemExit

    own = Store(store.address, OWN)
    own.put("ab", table_with(2))
    with monkeypatch.context() as patch:
        if "://" in store.address:
            patch.setattr("fsspec.implementations.memory.MemoryFileSystem.mv", killed)
        patch.setattr(Path, "replace", killed)
        patch.setattr(Path, "unlink", killed)
        with pytest.raises(SystemExit):
            own.put("cd", table_with())
    marks = own.mark(), Store(store.address, OTHER).mark()
    assert len(own._files()) == 4
    own.tidy([OWN])
    assert sorted(own._files()) == sorted(["ab.parquet", marks[1]])


def test_a_campaign_that_ends_keeps_files_that_another_one_is_writing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sync = os.fsync

    def others_end(descriptor: int) -> None:
        sync(descriptor)
        Store(str(folder), OWN).tidy([OWN])

    monkeypatch.setattr(os, "fsync", others_end)
    Store(str(folder), OTHER).put("ab", table_with())
    assert [each.name for each in folder.iterdir()] == ["ab.parquet"]


def test_foreign_files_are_never_removed(folder: Path) -> None:
    names = {
        "notes.txt",
        ".ab.parquet.0123",
        ".hidden",
        f".{OWN}.txt",
        f"ab.parquet.{OWN}.0",
        f".ab.{OTHER}.0",
        OWN,
    }
    for name in names:
        (folder / name).write_text("")
    Store(str(folder), OWN).tidy([OWN])
    assert {each.name for each in folder.iterdir()} == names
