"""Requirements of the reference ECU on a rig: feedback of each drive, a value for each command sent."""

from __future__ import annotations

from typing import TYPE_CHECKING

from liftgate_hil.config.enumerations import missing_values
from liftgate_hil.config.rig import COMMANDS
from liftgate_hil.errors import ConfigIssues

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig


FEEDBACK = ("current", "hall_count")  # of each drive


def check_rig(rig: Rig, drives: int) -> None:
    """Raise ConfigError where the reference ECU could not drive a gate of `drives` drives through a rig."""
    issues = ConfigIssues(rig.source)
    heard = {mapping.quantity for mapping in rig.outputs}
    sides = ("left", "right")[:drives]
    for side in sides:
        for quantity in (f"{side}_{name}" for name in FEEDBACK):
            if quantity not in heard:
                issues.add(
                    f"outputs.{quantity}",
                    f"missing, and the reference ECU does not move without it; allowed: the signal with the "
                    f"{side} drive's feedback, or another `ecu`",
                )
    commands = {name for name in COMMANDS if name.startswith(sides)} | {"latch_release"}
    for mapping in rig.inputs:
        missing = missing_values(mapping)
        if missing and mapping.quantity in commands:
            issues.add(
                f"inputs.{mapping.quantity}.values",
                f"{', '.join(missing)} missing, and the reference ECU sends it; allowed: a value for each, or "
                "another `ecu`",
            )
    issues.raise_if_any()
