"""Fixtures of the campaign tests: a base, its expected result rows, and a cluster of two workers per module."""

from __future__ import annotations

from collections.abc import Iterator

import pyarrow as pa
import pytest
from campaign_support import base_in, evaluated
from dask_processes import DaskProcesses

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.executors.local import Serial


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Base:
    return base_in(tmp_path_factory.mktemp("base"))


@pytest.fixture(scope="module")
def expected(base: Base, tmp_path_factory: pytest.TempPathFactory) -> pa.Table:
    """Result rows of all variants, evaluated one after the other in this process."""
    return evaluated(tmp_path_factory.mktemp("expected") / "store", base, Serial(base))


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskProcesses]:
    found = DaskProcesses(tmp_path_factory.mktemp("cluster"), 2)
    found.wait_for(2)
    yield found
    found.close()
