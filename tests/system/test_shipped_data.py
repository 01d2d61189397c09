"""Shipped data of campaigns have the columns written by campaigns of this version."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest

from liftgate_hil.campaigns.results import JUDGED, MARGIN, VARIANT, VERDICT

DATA = Path(__file__).parents[2] / "docs" / "trap-matrix"


@pytest.mark.parametrize("name", ["rods", "undisturbed"])
def test_the_trap_matrix_has_the_columns_of_a_campaign(name: str) -> None:
    names = pq.read_schema(DATA / f"{name}.parquet").names
    margins = [each.removeprefix(MARGIN) for each in names if each.startswith(MARGIN)]
    assert names[0] == VARIANT
    assert VERDICT in names
    assert margins
    assert [each.removeprefix(JUDGED) for each in names if each.startswith(JUDGED)] == margins
    described = (DATA / f"{name}.md").read_text(encoding="utf-8")
    assert [each for each in names if f"`{each}`" not in described] == []
