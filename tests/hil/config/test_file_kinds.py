"""A file of another kind than expected: one message that names both kinds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from liftgate_hil.campaign.file import read_campaign_file
from liftgate_hil.campaign.request import Request
from liftgate_hil.config.file_kinds import MARKS
from liftgate_hil.config.rig import read_rig
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.config.shipped import data_root
from liftgate_hil.config.toml import read_toml
from liftgate_hil.config.vehicle import load_vehicle
from liftgate_hil.errors import ConfigError

CONFIGS = data_root() / "configs"
FILES = {
    "rig": CONFIGS / "rigs" / "liftgate.toml",
    "vehicle": CONFIGS / "vehicles" / "suv.toml",
    "scenario": CONFIGS / "scenarios" / "demo.toml",
    "campaign": CONFIGS / "campaigns" / "trap-matrix.toml",
}
READERS: dict[str, Callable[[Path], Any]] = {
    "rig": read_rig,
    "vehicle": load_vehicle,
    "scenario": load_scenario,
    "campaign": lambda path: read_campaign_file(str(path), Request("demo", ("seed=0",))),
}
PAIRS = [(given, wanted) for given in FILES for wanted in READERS if given != wanted]


@pytest.mark.parametrize(("given", "wanted"), PAIRS)
def test_a_file_of_another_kind_gets_one_message(given: str, wanted: str):
    with pytest.raises(ConfigError) as failure:
        READERS[wanted](FILES[given])
    (issue,) = failure.value.issues
    assert issue.startswith(f"{FILES[given]}: a {given} file, not a {wanted}; allowed: a {wanted} with ")


@pytest.mark.parametrize("kind", FILES)
def test_a_file_of_the_kind_has_its_keys(kind: str):
    assert read_toml(FILES[kind]).keys() & {*MARKS[kind]}


def test_one_known_key_is_enough_to_report_the_others(tmp_path: Path):
    path = tmp_path / "mixed.toml"
    path.write_text("duration = 5\ndbc = 'x.dbc'\n")
    with pytest.raises(ConfigError, match=r"dbc: 'x\.dbc': unknown key"):
        load_scenario(path)
