"""Provenance of a result: source files by their content, and a date that can be set."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import pytest

from liftgate_hil.config.sources import sources_of
from liftgate_hil.plan.provenance import provenance_of


def test_a_source_file_is_identified_by_its_content(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.toml"
    path.write_bytes(b"drives = 2\n")
    (source,) = sources_of({"vehicle": path}).values()
    assert source.path == str(path)
    assert source.sha256 == hashlib.sha256(b"drives = 2\n").hexdigest()
    path.write_bytes(b"drives = 1\n")
    assert sources_of({"vehicle": path})["vehicle"].sha256 != source.sha256


def test_sources_that_are_no_files_are_left_out_and_pipes_are_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    names = {"a": "pipe", "b": "missing", "c": ".", "d": "\0", "e": "x" * 300}
    assert sources_of({key: tmp_path / name for key, name in names.items()}) == {}


def test_the_date_of_a_provenance_is_now_or_taken_from_the_environment() -> None:
    given = provenance_of("liftgate-hil demo", {}, {"SOURCE_DATE_EPOCH": "1700000000"})
    assert given.date == "2023-11-14T22:13:20+00:00"
    for nonsense in ("", "soon", "-1", "1e9", "9" * 30):
        date = provenance_of("", {}, {"SOURCE_DATE_EPOCH": nonsense}).date
        assert date > "2026"
        assert date.endswith("+00:00")


def test_provenance_has_the_same_content_as_json_and_as_a_table(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text("")
    record = provenance_of("liftgate-hil demo", sources_of({"rig": tmp_path / "rig.toml"}))
    content = json.loads(json.dumps(record.to_dict()))
    assert set(content) == {
        "command_line", "date", "sources", "versions", "platform", "libc", "processor", "processor_features",
    }  # fmt: skip
    assert {"liftgate-hil", "python", "numba", "numpy", "python-can", "cantools"} <= set(content["versions"])
    rows = dict(record.rows())
    assert content["sources"]["rig"]["sha256"] in rows["rig"]
    assert f"python {content['versions']['python']}" in rows["versions"]
    with pytest.raises(AttributeError):
        record.date = "later"  # type: ignore[misc]
