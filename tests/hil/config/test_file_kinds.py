"""A file of another kind than expected: one message that names both kinds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hil_support import issues_of, text_file

from liftgate_hil.campaigns.file import read_campaign_file
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.config.rig import read_rig
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.config.shipped import data_root
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
    "campaign": lambda path: read_campaign_file(str(path), CampaignRequest("demo", ("seed=0",))),
}
PAIRS = [(given, wanted) for given in FILES for wanted in READERS if given != wanted]


@pytest.mark.parametrize(("given", "wanted"), PAIRS)
def test_a_file_of_another_kind_is_refused_in_one_message(given: str, wanted: str):
    (issue,) = issues_of(READERS[wanted], FILES[given])
    assert issue.startswith(f"{FILES[given]}: a {given} file, not a {wanted}; allowed: a {wanted} with ")


def test_a_file_with_a_known_key_gets_its_unknown_keys_reported(tmp_path: Path):
    path = text_file(tmp_path / "mixed.toml", "duration = 5\ndbc = 'x.dbc'\n")
    with pytest.raises(ConfigError, match=r"dbc: 'x\.dbc': unknown key"):
        load_scenario(path)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("car.dbc", "a CAN database; allowed: a TOML file; a rig file names the database"),
        ("run.MF4", "a recording; allowed: a TOML file; judge, plot, convert and replay take recordings"),
        ("test_gate.py", "Python code; allowed: a TOML file; pytest runs tests in Python"),
    ],
)
def test_a_file_with_a_suffix_other_than_toml_is_reported_by_its_kind(tmp_path: Path, name: str, said: str):
    (tmp_path / name).write_bytes(bytes(3_000_000))
    assert issues_of(load_scenario, tmp_path / name) == [f"{tmp_path / name}: {said}"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            '[[request]]\ntime = "500 ms"\n',
            "request[0].time: '500 ms'; allowed: a number of seconds without quotes, such as 0.5",
        ),
        (
            '[[request]]\ntime = "2"\n',
            "request[0].time: '2'; allowed: a number of seconds without quotes, such as 2",
        ),
        (
            '[parameters]\nprecondition = ["open"]\n',
            "parameters.precondition: ['open'] is not a number; allowed: a number, or precondition above the "
            "first [table]",
        ),
        ("[parameters]\nname = 'x'\n", "parameters.name: 'x' is not a number; allowed: -1e+15 to 1e+15"),
    ],
)
def test_typical_mistakes_in_a_scenario_are_reported_with_the_correct_form(tmp_path: Path, text: str, said: str):
    path = text_file(tmp_path / "s.toml", "duration = 1\n" + text)
    assert f"{path}: {said}" in issues_of(load_scenario, path)
