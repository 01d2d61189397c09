"""The pages that the program writes are the committed ones, and say what the loaders do."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from liftgate_hil.config.rig import load_rig
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS
from tools.docs import DOCS, PAGES, rig, scenario


@pytest.mark.parametrize("name", PAGES)
def test_a_committed_page_is_what_is_written_now(name: str) -> None:
    assert (DOCS / name).read_text(encoding="utf-8") == PAGES[name](), "run `make docs`"


def test_every_link_of_the_pages_leads_somewhere() -> None:
    for name in PAGES:
        parts = (DOCS / name).read_text(encoding="utf-8").split("](")[1:]
        assert parts
        for part in parts:
            assert (DOCS / part.split(")")[0]).is_file(), part


def lines(values: Mapping[str, tuple[str, ...]]) -> str:
    """A table's keys with the defaults that a page tells."""
    told = {key: each[0] for key, each in values.items()}
    number = {key: value for key, value in told.items() if value.isdigit()}
    word = {key: told[key] for key in ("meets", "interpolation", "checksum_kind") if key in told}
    return "".join(
        [f"{key} = {value}\n" for key, value in number.items()]
        + [f'{key} = "{value}"\n' for key, value in word.items()]
    )


def test_the_defaults_of_an_obstacle_are_those_told(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    tables = []
    for more in ("", lines(scenario.OBSTACLE)):
        path.write_text(f"[[obstacle]]\nangle_deg = 30\n{more}")
        tables.append(load_scenario(path).timeline.obstacles)
    assert "stiffness" in lines(scenario.OBSTACLE)
    assert np.array_equal(*tables)


def test_the_defaults_of_a_message_are_those_told(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    head = (
        'dbc = "liftgate.dbc"\n[inputs]\nleft_duty = "DriveCommand.LeftDuty"\n'
        'left_direction = "DriveCommand.LeftDirection"\n[messages.DriveCommand]\n'
    )
    simple = lines({key: rig.MESSAGE[key] for key in ("timeout_cycles", "checksum_kind")})
    protected = 'protection = "e2e-p05"\ndata_id = 1\ncounter = "AliveCounter"\n'
    e2e = lines({key: rig.MESSAGE[key] for key in ("max_delta_counter", "sync_counter")})
    e2e += f"[messages.DriveCommand.state_machine]\n{lines(rig.STATES)}"
    for given, more in (("", simple), (protected, e2e)):
        options = []
        for text in (given, given + more):
            path.write_text(head + text)
            options.append(_options(path))
        assert options[0] == options[1]


def _options(path: Path) -> object:
    """Of its messages, whether or not the rig is whole."""
    from liftgate_hil.config.messages import message_options
    from liftgate_hil.config.toml import read_toml
    from liftgate_hil.issues import ConfigIssues

    messages = load_rig(DOCS.parent / "configs/rigs/liftgate.toml").messages
    issues = ConfigIssues(str(path))
    found = message_options(issues, read_toml(path), messages)
    issues.raise_if_any()
    return found


def test_every_quantity_that_a_rig_can_wire_is_on_its_page() -> None:
    text = (DOCS / "rig.md").read_text(encoding="utf-8")
    for name in (*BUS_INPUTS, *BUS_OUTPUTS):
        assert f"| `{name}` |" in text
