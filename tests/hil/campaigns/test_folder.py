"""The folder of a campaign: its files are whole or unchanged, and a variant is found by its first digits."""

from __future__ import annotations

import errno
import fcntl
import json
import math
import os
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from liftgate_hil.campaigns.campaign import CampaignStoppedError
from liftgate_hil.campaigns.folder import BATCHES, LOCK, MANIFEST, OWN, REPORT, RESULTS, Folder
from liftgate_hil.campaigns.replay import replayed
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.store import StoreError
from liftgate_hil.errors import ConfigError
from liftgate_hil.report.page import page


def table_of(*names: str) -> pa.Table:
    return pa.table({"variant": list(names), "rod": [float(k) for k in range(len(names))]})


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    made = Folder(tmp_path / "a" / "out")
    made.create()
    return made


def names_in(folder: Folder) -> list[str]:
    return sorted(each.name for each in folder.path.iterdir())


def test_an_existing_folder_is_used_and_its_files_are_kept(folder: Folder) -> None:
    (folder.path / "kept").write_text("")
    folder.create()
    assert names_in(folder) == ["kept"]


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=rf"`output` {tmp_path}/file/out: .*; allowed: a folder to write to"):
        Folder(tmp_path / "file" / "out").create()


def test_a_written_manifest_reads_back_the_same(folder: Folder) -> None:
    assert not folder.has_campaign
    folder.write_manifest({"identity": "äöü", "numbers": [1, 2.5, None]})
    assert folder.has_campaign
    assert folder.manifest() == {"format": 2, "identity": "äöü", "numbers": [1, 2.5, None]}


def test_a_written_request_reads_back_the_same(folder: Folder) -> None:
    request = CampaignRequest(
        "demo", ("rod=1,2",), settings=("gate.mass=31",), parameters={"a": 1.0}, draw=3, samples=4
    )
    folder.write_manifest({"request": request.kept()})
    assert folder.request() == request


def test_nan_is_never_written_into_a_manifest(folder: Folder) -> None:
    folder.write_manifest({"one": 1})
    with pytest.raises(ValueError, match="JSON"):
        folder.write_manifest({"one": math.nan})
    assert folder.manifest() == {"format": 2, "one": 1}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not JSON: .*; allowed: as a campaign has written it"),
        (b'{"format": 2,', "not JSON: .*; allowed: as a campaign has written it"),
        (b"\xff\xfe\x00", "not JSON: .*; allowed: as a campaign has written it"),
        (b"[" * 100_000, "not JSON: .*; allowed: as a campaign has written it"),
        (b"[]", "format: not of this version; allowed: 2; run the campaign again"),
        (b"5", "format: not of this version; allowed: 2; run the campaign again"),
        (b"{}", "format: not of this version; allowed: 2; run the campaign again"),
        (b'{"format": 3}', "format: not of this version; allowed: 2; run the campaign again"),
    ],
)
def test_an_invalid_manifest_is_reported_in_one_message(content: bytes, message: str, folder: Folder) -> None:
    (folder.path / MANIFEST).write_bytes(content)
    with pytest.raises(ConfigError, match=f"{folder.path / MANIFEST}: {message}") as caught:
        folder.manifest()
    assert len(caught.value.issues) == 1


def test_a_folder_without_a_campaign_is_refused(folder: Folder) -> None:
    with pytest.raises(ConfigError, match=rf"{folder.path / MANIFEST}: .*; allowed: the folder of a campaign"):
        folder.manifest()


@pytest.mark.parametrize(
    "content",
    [{}, {"request": None}, {"request": 5}, {"request": []}, {"request": {}}, {"request": {"scenario": "demo"}},
     {"request": {"scenario": "demo", "vary": [], "colour": 5}}],
)  # fmt: skip
def test_a_manifest_without_a_request_of_this_version_is_refused(content: object, folder: Folder) -> None:
    (folder.path / MANIFEST).write_text(json.dumps({"format": 2, **content}))  # type: ignore[dict-item]
    with pytest.raises(ConfigError, match=r"campaign.json: request: .*; allowed: ") as caught:
        folder.request()
    assert len(caught.value.issues) == 1


def test_result_tables_are_joined_in_order_into_one_file(folder: Folder) -> None:
    assert folder.write_results([]) == 0
    assert names_in(folder) == []
    assert folder.write_results([table_of("a", "b"), table_of("c"), table_of("d", "e")]) == 5
    assert pq.read_table(folder.path / RESULTS)["variant"].to_pylist() == ["a", "b", "c", "d", "e"]
    assert names_in(folder) == [RESULTS]


def test_many_small_tables_are_written_as_few_row_groups(folder: Folder) -> None:
    part = table_of(*(str(k) for k in range(1000)))
    assert folder.write_results([part] * 40) == 40_000
    file = pq.ParquetFile(folder.path / RESULTS)
    assert file.num_row_groups == 3
    assert file.metadata.num_rows == 40_000


@pytest.mark.parametrize(
    "error", [CampaignStoppedError(), StoreError("full"), KeyboardInterrupt(), OSError(28, "No space")]
)
@pytest.mark.parametrize("count", [1, 20_000])
def test_results_that_cannot_be_completed_leave_the_previous_file(
    error: BaseException, count: int, folder: Folder
) -> None:
    folder.write_results([table_of("old")])

    def broken() -> Iterator[pa.Table]:
        yield table_of(*["new"] * count)
        raise error

    expected = StoreError if isinstance(error, OSError) else type(error)
    with pytest.raises(expected):
        folder.write_results(broken())
    assert pq.read_table(folder.path / RESULTS)["variant"].to_pylist() == ["old"]
    assert names_in(folder) == [RESULTS]


def test_a_folder_that_vanished_is_reported(folder: Folder) -> None:
    folder.path.rmdir()
    for call in (
        lambda: folder.write_results([table_of("a")]),
        lambda: folder.write("report.html", b""),
        lambda: folder.write_manifest({}),
    ):
        with pytest.raises(StoreError, match=rf"{folder.path}/.*: .*No such file"):
            call()


def test_a_failed_write_leaves_the_previous_file_and_no_temporary_one(folder: Folder) -> None:
    (folder.path / "report.html").mkdir()
    (folder.path / "report.html" / "inside").write_text("")
    with pytest.raises(StoreError, match=rf"{folder.path}/report.html: "):
        folder.write("report.html", b"new")
    assert names_in(folder) == ["report.html"]


def test_a_file_is_replaced_as_a_whole_by_a_shorter_one(folder: Folder) -> None:
    folder.write("report.html", b"a longer one")
    folder.write("report.html", b"short")
    assert (folder.path / "report.html").read_bytes() == b"short"
    assert names_in(folder) == ["report.html"]


VARIANTS = ("abc1", "abd2", "x3", "abd2")


@pytest.mark.parametrize(("given", "place"), [("abc1", 0), ("abc", 0), ("x", 2), ("abd", 1)])
def test_a_variant_is_found_by_the_first_digits_of_its_name(given: str, place: int, folder: Folder) -> None:
    folder.write_results([table_of(*VARIANTS)])
    assert folder.find(given) == {"variant": VARIANTS[place], "rod": float(place)}


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ("ab", "3 variants begin like that"), ("", "4 variants begin like that"), ("abc12", "no such variant"),
        ("ABC1", "no such variant"), ("bc1", "no such variant"),
    ],
)  # fmt: skip
def test_an_ambiguous_or_unknown_variant_is_refused(given: str, what: str, folder: Folder) -> None:
    folder.write_results([table_of(*VARIANTS)])
    with pytest.raises(ConfigError) as caught:
        folder.find(given)
    assert caught.value.issues == [f"`replay` {given}: {what}; allowed: one of the results, or its first digits"]


@pytest.mark.parametrize("content", [None, b"", b"no table", pa.table({"x": [1]})])
def test_an_unreadable_result_file_is_refused(content: bytes | pa.Table | None, folder: Folder) -> None:
    if isinstance(content, bytes):
        (folder.path / RESULTS).write_bytes(content)
    elif content is not None:
        pq.write_table(content, folder.path / RESULTS)
    with pytest.raises(ConfigError, match=rf"{folder.path / RESULTS}: .*; allowed: results of a campaign"):
        folder.find("a")


def killed_in(path: Path, monkeypatch: pytest.MonkeyPatch) -> Folder:
    """Leave a folder as a campaign that was killed while it wrote a file, and return its folder object."""

    def killed(path: Path, *_: Path) -> None:
        raise SystemExit

    found = Folder(path)
    with found.claimed(), monkeypatch.context() as patch:
        patch.setattr(Path, "replace", killed)
        patch.setattr(Path, "unlink", killed)
        with pytest.raises(SystemExit):
            found.write(MANIFEST, b"half")
    return found


def test_temporary_files_of_killed_campaigns_are_removed_by_the_next_one(
    folder: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = [killed_in(folder.path, monkeypatch) for _ in range(2)]
    assert len(names_in(folder)) == 3
    with folder.claimed():
        assert folder.ended == [*(each.token for each in before), folder.token]
        folder.tidy()
    assert names_in(folder) == [LOCK]


def test_temporary_files_stay_where_locks_are_unsupported(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_locks(*_: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    killed_in(folder.path, monkeypatch)
    before = names_in(folder)
    monkeypatch.setattr(fcntl, "flock", no_locks)
    with folder.claimed():
        assert folder.ended == [folder.token]
        folder.tidy()
    assert names_in(folder) == before


def test_a_campaigns_token_partly_written_to_the_lock_file_is_ignored(folder: Folder) -> None:
    whole = "0" * 32
    (folder.path / LOCK).write_text(f"\n{whole}\n01")
    with folder.claimed():
        assert folder.ended == [whole, folder.token]
    with Folder(folder.path).claimed():
        pass
    later = Folder(folder.path)
    with later.claimed():
        assert later.ended[:2] == [whole, folder.token]


@pytest.mark.parametrize("content", ["pid 12", "4711\n", "0" * 32, "\n" + "0" * 33])
def test_a_lock_file_of_another_program_is_not_written_to(folder: Folder, content: str) -> None:
    (folder.path / LOCK).write_text(content)
    with folder.claimed():
        assert folder.ended == [folder.token]
    assert (folder.path / LOCK).read_text() == content


def test_a_failure_to_close_the_lock_hides_no_other_error(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    close = os.close

    def failing(descriptor: int) -> None:
        close(descriptor)
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "close", failing)
    with pytest.raises(StoreError, match="full"), folder.claimed():
        raise StoreError("full")
    with folder.claimed():
        pass


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("vehicle", True), ("vehicle", 5), ("rig", False), ("seed", True), ("seed", 2.5), ("draw", "3"),
        ("rate", True), ("duration", "1"), ("samples", True), ("samples", -1), ("ideal", 1), ("vary", [True]),
        ("parameters", {"rod": True}), ("scenario", None), ("scenario", 5), ("settings", 5), ("kind", True),
    ],
)  # fmt: skip
def test_a_request_value_of_a_wrong_type_is_reported_by_its_key(folder: Folder, name: str, value: object) -> None:
    folder.write_manifest({"request": {**CampaignRequest("demo", ("rod=1,2",)).kept(), name: value, "method": 3}})
    with pytest.raises(ConfigError) as caught:
        folder.request()
    issues = [
        f"campaign.json: request.{key}: {each!r}; allowed: as it was written"
        for key, each in ((name, value), ("method", 3))
    ]
    assert caught.value.issues == issues


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_folder_without_file_locks_is_used_without_a_lock(
    folder: Folder, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    with folder.claimed() as is_claimed:
        assert is_claimed
        with pytest.raises(ConfigError, match="another campaign is running there"), folder.claimed():
            pass

    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refuse)
    with folder.claimed() as is_claimed:
        assert not is_claimed


def test_foreign_files_in_the_place_of_a_campaigns_files_are_set_aside(folder: Folder) -> None:
    (folder.path / RESULTS).write_bytes(b"somebody's")
    (folder.path / REPORT).write_text(page("ours", "", []))
    (folder.path / BATCHES).mkdir()
    said: list[str] = []
    folder.make_way(OWN, [], said.append)
    aside = folder.path / "results.previous.parquet"
    assert aside.read_bytes() == b"somebody's"
    assert said == [f"{folder.path / RESULTS}: the file that was there is now {aside}"]
    assert names_in(folder) == [BATCHES, REPORT, "results.previous.parquet"]


@pytest.mark.parametrize(
    "request_", [{"scenario": 5, "vary": []}, {"scenario": None, "vary": []}, {"scenario": "demo", "vary": [5]},
                 {"scenario": "demo", "vary": [], "settings": 5}],
)  # fmt: skip
def test_an_invalid_value_in_a_stored_request_is_refused_on_replay(request_: object, folder: Folder) -> None:
    (folder.path / MANIFEST).write_text(json.dumps({"format": 2, "request": request_}))
    with pytest.raises(ConfigError):
        replayed(folder.path, "abc")
