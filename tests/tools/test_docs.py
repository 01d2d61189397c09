"""Generated pages equal the committed ones, and describe what the loaders accept."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from cantools.database.can import Message, Signal

import liftgate_hil as lh
from liftgate_hil.codec.messages import Messages
from liftgate_hil.conditions.parser import parsed
from liftgate_hil.config import scenario_schema
from liftgate_hil.config.described import fields_of
from liftgate_hil.config.fault_kinds import FAULT_KINDS
from liftgate_hil.config.messages import MessageTable, StateMachineTable, message_options
from liftgate_hil.config.rig import load_rig
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.config.toml import read_toml
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.plan.setup import rig_of, setup_of
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS
from tools.docs import DOCS, PAGES


@pytest.mark.parametrize("name", PAGES)
def test_a_committed_page_equals_the_generated_one(name: str) -> None:
    assert (DOCS / name).read_text(encoding="utf-8") == PAGES[name](), "run `make docs`"


def lines(record: type, *names: str) -> str:
    """TOML lines of a table, of all its keys or some, with the defaults stated on a page."""
    told = {key.name: key.default_text for key in fields_of(record) if key.name in names or not names}
    number = {key: value for key, value in told.items() if value.isdigit()}
    word = {key: told[key] for key in ("meets", "interpolation", "checksum_kind") if key in told}
    return "".join(
        [f"{key} = {value}\n" for key, value in number.items()]
        + [f'{key} = "{value}"\n' for key, value in word.items()]
    )


@pytest.mark.parametrize(
    ("record", "table", "names"),
    [
        (
            scenario_schema.ObstacleTable,
            "[[obstacle]]\nangle_deg = 30",
            ("start", "delay_s", "distance", "stiffness", "damping", "gap", "lateral", "meets"),
        ),
        (
            scenario_schema.FaultTable,
            '[[fault]]\nkind = "motor_open"\nperiod_s = 1',
            ("start", "delay_s", "share", "seed"),
        ),
    ],
)
def test_the_defaults_of_obstacles_and_faults_in_a_scenario_are_as_documented(
    tmp_path: Path, record: type, table: str, names: tuple[str, ...]
) -> None:
    path, told, found = tmp_path / "scenario.toml", lines(record), []
    for name in names:
        assert f"{name} = " in told, name
    for more in ("", told):
        path.write_text(f"{table}\n{more}")
        scenario = load_scenario(path)
        found.append((scenario.stimuli.obstacles, scenario.faults))
    assert found[0] == found[1]


def test_the_default_files_of_a_scenario_are_as_documented() -> None:
    words = {key.name: key.default_text for key in fields_of(scenario_schema.ScenarioTable)}
    assert setup_of(None).vehicle_name == words["vehicle"]
    assert Path(rig_of(None).source).stem == words["rig"]
    assert setup_of(None).start_angle == 0.0
    assert words["initial"] == "closed"


def rows_in(page: str, heading: str) -> list[list[str]]:
    """Cells of all tables between a heading and the next one."""
    text = (DOCS / page).read_text(encoding="utf-8").split(f"\n## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line[1:-1].split(" | ")] for line in lines]


@pytest.mark.parametrize(
    ("heading", "record"),
    [
        ("The file", scenario_schema.ScenarioTable),
        ("`[[profile]]`", scenario_schema.ProfileTable),
        ("`[[obstacle]]`", scenario_schema.ObstacleTable),
        ("`[[request]]`", scenario_schema.RequestTable),
        ("`[[fault]]`", scenario_schema.FaultTable),
        ("`[[expect]]`", scenario_schema.ExpectTable),
    ],
)
def test_exactly_the_keys_of_a_scenario_are_on_its_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, heading: str, record: type
) -> None:
    """Compared with the keys that the checker allows in each table."""
    monkeypatch.setattr("liftgate_hil.errors._FEW", 100)  # so that the message has all of them
    path, name = tmp_path / "scenario.toml", heading.strip("`")
    before = {"The file": "", "[[fault]]": f"{name}\nkind = 'motor_open'"}.get(name, name)
    path.write_text(f"{before}\nno_such_key = 1")
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    (answer,) = [line for line in caught.value.issues if "no_such_key: " in line]
    known = answer.split("allowed: ")[1].split(", ")
    rows = rows_in("scenario.md", heading)
    shown = [row[0] for row in rows[: 2 + len(fields_of(record))]]
    assert shown == ["key", "---", *(f"`{each}`" for each in known)]


def test_every_kind_of_fault_is_on_its_page_with_its_keys_and_its_component() -> None:
    rows = {row[0]: row for row in rows_in("scenario.md", "`[[fault]]`")}
    for kind in FAULT_KINDS.values():
        _, keys, place, _ = rows[f"`{kind.name}`"]
        assert re.findall(r"`(\w+)`: ", keys) == [key.name for key in kind.keys], kind.name
        assert place == f"of {kind.of}", kind.name


def test_conditions_as_described_on_the_page_are_accepted() -> None:
    names = [row[0] for row in rows_in("scenario.md", "`[[expect]]`") if row[1].startswith("a column")]
    assert names == ["`gate_angle_deg`"]
    for text in (
        "gate_angle_deg > 20 and (sensed.left_current_a <= 2 * $idle or Gate.LatchState == 1)",
        "not abs(gate_angle_deg - sensed.gate_angle_deg) >= 1e-3",
        "left_duty + 0.5 < 1 or left_duty / 2 != 0",
    ):
        assert parsed(text, {"idle": 1.0}).text == text


def test_the_defaults_of_a_message_in_a_rig_are_as_documented(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    head = (
        'dbc = "liftgate.dbc"\n[inputs]\nleft_duty = "DriveCommand.LeftDuty"\n'
        'left_direction = "DriveCommand.LeftDirection"\n[messages.DriveCommand]\n'
    )
    simple = lines(MessageTable, "timeout_cycles", "checksum_kind")
    protected = 'protection = "e2e-p05"\ndata_id = 1\ncounter = "AliveCounter"\n'
    e2e = lines(MessageTable, "max_delta_counter", "sync_counter")
    e2e += f"[messages.DriveCommand.state_machine]\n{lines(StateMachineTable)}"
    for given, more in (("", simple), (protected, e2e)):
        options = []
        for text in (given, given + more):
            path.write_text(head + text)
            options.append(_options(path))
        assert options[0] == options[1]


def _options(path: Path) -> object:
    """Options of a rig's messages, whether or not the rig is complete."""
    messages = load_rig(DOCS.parent / "configs/rigs/liftgate.toml").messages
    issues = ConfigIssues(str(path))
    found = message_options(issues, read_toml(path)["messages"], messages)
    issues.raise_if_any()
    return found


def test_the_example_of_a_checksum_is_valid_in_a_rig() -> None:
    text = (DOCS / "rig.md").read_text(encoding="utf-8")
    example = text.partition("`checksum = {…}` of a message")[2].partition("    [messages")[2]
    content = tomllib.loads("[messages" + example.partition("\n\n`covers`")[0])
    signals = [Signal("CRC", 0, 8), Signal("BZ", 8, 4)]
    messages = Messages([Message(0x86, "TheirCommand", 8, signals)])
    issues = ConfigIssues("rig.md")
    options = message_options(issues, content["messages"], messages)["TheirCommand"]
    assert not issues.lines
    assert options.own is not None
    assert options.counter == "BZ"


def test_every_quantity_that_a_rig_can_wire_is_on_its_page() -> None:
    text = (DOCS / "rig.md").read_text(encoding="utf-8")
    for name in (*BUS_INPUTS, *BUS_OUTPUTS):
        assert f"| `{name}` |" in text


def test_the_api_page_has_every_public_name() -> None:
    page = (DOCS / "python-api.md").read_text(encoding="utf-8")
    missing = [name for name in lh.__all__ if f":: liftgate_hil.{name}\n" not in page]
    assert (missing, {*dir(lh)}) == ([], {*lh.__all__, "__version__"})
