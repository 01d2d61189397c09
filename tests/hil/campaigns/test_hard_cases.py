"""Damaged files, broken requests and alike results: each has cost a campaign something once."""

from __future__ import annotations

import errno
import json
import math
import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from html_page import Page

from liftgate_hil.campaigns.file import read_campaign_file
from liftgate_hil.campaigns.folder import Folder
from liftgate_hil.campaigns.prepared import pace_before, prepared
from liftgate_hil.campaigns.replay import replayed
from liftgate_hil.campaigns.reporting.combined import PartResult, combined_report
from liftgate_hil.campaigns.reporting.comparison import comparison_of
from liftgate_hil.campaigns.reporting.heat_map import cells_of
from liftgate_hil.campaigns.reporting.summary import first_order, summary_of
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.space import Design, space_of
from liftgate_hil.campaigns.store import Store, StoreError
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.setup import vehicle_from
from liftgate_hil.report.provenance import Provenance


def test_a_damaged_file_is_as_if_not_there(tmp_path: Path) -> None:
    store = Store(str(tmp_path))
    table = pa.table({"variant": [f"v{k}" for k in range(40)], "x": np.random.default_rng(0).random(40)})
    store.put("ab", table)
    whole = (tmp_path / "ab.parquet").read_bytes()
    wrong = 0
    for place in range(4, len(whole) // 3, 3):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << (place % 8)
        (tmp_path / "ab.parquet").write_bytes(damaged)
        found = store.get("ab")
        try:
            wrong += found is not None and not found.equals(table)
        except UnicodeDecodeError:
            wrong += 1
    assert wrong == 0


@pytest.mark.parametrize("value", [0.1, 400.3])
def test_constant_results_have_no_indices(value: float) -> None:
    assert first_order({"x": np.arange(30.0) % 4.0}, np.full(30, value)) == []


@pytest.mark.parametrize("text", ["seed~uniform(0,10)", "draw~triangular(0,5,10)"])
def test_a_distribution_of_seeds_that_is_not_whole_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="whole numbers"):
        prepared(CampaignRequest("demo", (text,), samples=4))


def test_a_margin_that_only_one_ecu_has_is_a_difference(tmp_path: Path) -> None:
    for name, margin in (("one", None), ("two", 4.0)):
        columns = {
            "variant": ["a"],
            "rod": [1.0],
            "verdict": ["fail"],
            "verdict.a": ["fail"],
            "margin.a": pa.array([margin], pa.float64()),
        }
        pq.write_table(pa.table(columns), tmp_path / name)
    found = comparison_of(tmp_path / "one", tmp_path / "two", ["rod"], ["a"], ("one", "two"))
    assert found.differing.num_rows == 1


def test_results_that_cannot_be_read_are_told_in_our_words(tmp_path: Path) -> None:
    whole = tmp_path / "whole.parquet"
    pq.write_table(pa.table({"variant": ["a"], "verdict": ["pass"]}), whole)
    for call in (
        lambda: summary_of(tmp_path / "gone.parquet", [], []),
        lambda: comparison_of(tmp_path / "gone.parquet", whole, [], [], ("one", "two")),
        lambda: comparison_of(whole, tmp_path / "gone.parquet", [], [], ("one", "two")),
    ):
        with pytest.raises(StoreError, match=rf"^{tmp_path}/gone.parquet: {os.strerror(errno.ENOENT)}$"):
            call()


def manifest(folder: Folder, **changed: object) -> None:
    found = prepared(CampaignRequest("demo", ("supply.voltage=9,12",)))
    content = {
        "format": 2,
        "identity": found.base.identity,
        "request": found.request.kept(),
        "seconds_each": 0.01,
        "workers": 4,
        "files": {name: each._asdict() for name, each in found.plan.sources.items()},
        "versions": dict(found.base.versions),
    }
    (folder.path / "campaign.json").write_text(json.dumps({**content, **changed}))


@pytest.mark.parametrize(
    "changed",
    [
        {"files": None},
        {"files": []},
        {"files": {"vehicle": 5}},
        {"versions": None},
        {"request": None},
        {"request": []},
    ],
)
def test_garbage_in_a_manifest_is_one_clear_error_on_resume(changed: dict, tmp_path: Path) -> None:
    manifest(Folder(tmp_path), **changed)
    with pytest.raises(ConfigError):
        pace_before(Folder(tmp_path), prepared(CampaignRequest("demo", ("supply.voltage=9,12",))), True)


@pytest.mark.parametrize("changed", [{"workers": 0}, {"workers": -3}, {"seconds_each": math.nan}])
def test_a_pace_that_is_none_is_refused(changed: dict, tmp_path: Path) -> None:
    manifest(Folder(tmp_path), **changed)
    with pytest.raises(ConfigError):
        pace_before(Folder(tmp_path), prepared(CampaignRequest("demo", ("supply.voltage=9,12",))), True)


@pytest.mark.parametrize(
    "request_", [{"scenario": 5, "vary": []}, {"scenario": None, "vary": []}, {"scenario": "demo", "vary": [5]},
                 {"scenario": "demo", "vary": [], "settings": 5}],
)  # fmt: skip
def test_garbage_in_a_request_is_one_clear_error_on_replay(request_: dict, tmp_path: Path) -> None:
    (tmp_path / "campaign.json").write_text(json.dumps({"format": 2, "request": request_}))
    with pytest.raises(ConfigError):
        replayed(tmp_path, "abc")


def test_a_manifest_nested_deeply_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "campaign.json").write_text("[" * 100_000)
    with pytest.raises(ConfigError):
        Folder(tmp_path).manifest()


def test_draws_of_an_ideal_vehicle_are_refused() -> None:
    with pytest.raises(ConfigError, match="draw"):
        prepared(CampaignRequest("demo", ("draw=1,2",), ideal=True))


@pytest.mark.parametrize(
    "own",
    [
        {"parameters": ["gate.mass"], "values": [math.nan], "covariance": [[1.0]]},
        {"parameters": ["gate.mass", "gate.mass"], "values": [30.0, 31.0], "covariance": [[1.0, 0.0], [0.0, 1.0]]},
    ],
)
def test_a_broken_identification_is_refused(own: dict) -> None:
    with pytest.raises(ConfigError):
        space_of(["vehicle"], {}, vehicle_from("suv"), {"identification": own})


def test_an_unknown_parameter_of_an_identification_is_named() -> None:
    own = {
        "parameters": ["gate.mass", "gate.wheels"],
        "values": [30.0, 1.0],
        "covariance": [[1.0, 0.0], [0.0, 1.0]],
    }
    with pytest.raises(ConfigError, match=r"gate\.wheels"):
        space_of(["vehicle"], {}, vehicle_from("suv"), {"identification": own})


@pytest.mark.parametrize("titles", [("Rods", "Rods"), ("Rods 1", "rods-1"), ("—", "…")])
def test_parts_with_titles_alike_are_a_valid_page(titles: tuple[str, str], tmp_path: Path) -> None:
    force = np.linspace(1.0, 200.0, 60)
    columns = {"variant": [f"{k:032x}" for k in range(60)], "rod": np.arange(60.0), "verdict": ["pass"] * 60,
               "peak_pinch_force_n": force, "error": pa.array([None] * 60, pa.string())}  # fmt: skip
    pq.write_table(pa.table(columns), tmp_path / "r")
    parts = [PartResult(each, summary_of(tmp_path / "r", ["rod"], []), {}, "out", "", True) for each in titles]
    Page(combined_report("All", "", parts, Provenance("c", "d"), True, "reference")).check_alone()


def test_a_uniform_value_from_0_has_classes_of_equal_width() -> None:
    x = np.random.default_rng(1).uniform(0.0, 10.0, 500)
    cells = cells_of(x, np.zeros(500), np.ones(500), False)
    assert np.isfinite(cells.worst).mean() > 0.9


def test_labels_of_columns_differ() -> None:
    cells = cells_of(np.array([1234567.0, 1234568.0]), np.zeros(2), np.ones(2), False)
    assert len(set(cells.columns)) == 2


def both(folder: Path, *vary: str, samples: int) -> CampaignRequest:
    path = folder / "f.toml"
    path.write_text(
        '[[part]]\nname = "a"\nscenario = "demo"\nvary = ["supply.voltage=9,12"]\n'
        '[[part]]\nname = "b"\nscenario = "demo"\nvary = ["gate.mass~uniform(30,31)"]\nsamples = 9\n'
    )
    found = read_campaign_file(str(path), CampaignRequest(str(path), vary, samples=samples))
    for each in found.parts:
        prepared(each.request)
    return found.parts[0].request


def test_samples_reach_a_part_whose_grid_a_distribution_has_replaced(tmp_path: Path) -> None:
    assert both(tmp_path, "supply.voltage~uniform(9,12)", samples=5).samples == 5


def test_a_grid_may_replace_the_only_distribution_of_a_part(tmp_path: Path) -> None:
    both(tmp_path, "gate.mass=30,31", samples=0)


def test_a_batch_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError):
        Store(str(tmp_path / "file")).get("ab")


def test_too_many_variants_are_refused_before_their_samples_are_drawn() -> None:
    drawn = []

    class Watched(Design):
        @staticmethod
        def _sampled(factors: list, samples: int, method: str, seed: int) -> dict:
            drawn.append(samples)
            return {"rod": np.zeros(1)}

    space = space_of(["rod~uniform(0,1)", "angle=1:2:100"], {"rod": "", "angle": ""}, vehicle_from("suv"), {})
    with pytest.raises(ConfigError):
        Watched(space, 10**9, "random", 0)
    assert drawn == []
