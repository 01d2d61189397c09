"""Controls of a page: the initial values of its forms are valid."""

from __future__ import annotations

from typing import Any

import pytest
from hil_support import shipped_rig

from liftgate_hil.config.fault_kinds import FAULT_KINDS
from liftgate_hil.config.scenario_tables import fault_of
from liftgate_hil.dashboard.controls import controls_of
from liftgate_hil.operate.attachment.description import commands_of
from liftgate_hil.plan.setup import setup_of
from liftgate_hil.signals import PROFILES

CONTROLS = controls_of(commands_of(setup_of(None), shipped_rig(), True))


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_the_initial_values_of_each_fault_form_make_a_valid_fault(kind: str) -> None:
    spec = CONTROLS["fault"][kind]

    def begins(key: dict[str, Any]) -> Any:
        return key["labels"][0] if key["labels"] else key["typical"]

    values = {name: begins(key) for name, key in spec["keys"].items()}
    assert None not in values.values()
    found = fault_of(kind, spec["where"][0] if spec["where"] else None, values)
    assert found.kind == kind


def test_only_two_valued_inputs_have_a_button_for_each_value() -> None:
    switches = [name for name, signal in PROFILES.items() if signal.values]
    assert switches
    for name, spec in CONTROLS["set"].items():
        assert len(spec["actions"]) == (2 if name in switches else 0)
    handle = CONTROLS["set"]["handle_pulled"]
    assert list(handle["actions"]) == ["Release handle", "Pull handle"]
    assert (handle["label"], handle["labels"][1]) == ("Outer handle", "pulled")


def test_only_can_identifiers_are_shown_in_hexadecimal() -> None:
    keys = {(kind, name): key for kind, spec in CONTROLS["fault"].items() for name, key in spec["keys"].items()}
    assert [which for which, key in keys.items() if key["is_hex"]] == [("babbling", "id")]
    assert keys["babbling", "id"]["label"] == "CAN identifier (hex)"
    assert keys["contact_resistance", "ohm"]["label"] == "Resistance"
    assert keys["frame_lost", "direction"]["label"] == "Direction, seen from the gate"
    assert keys["frame_lost", "probability"]["label"] == "Probability"
