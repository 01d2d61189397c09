"""Requirements of the reference ECU on a rig: feedback of each drive, a value for each command sent."""

from __future__ import annotations

from typing import TYPE_CHECKING

from liftgate_hil.config.rig import COMMANDS
from liftgate_hil.config.signal_mapping import missing_values
from liftgate_hil.errors import ConfigIssues

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig


SIDES = ("left", "right")
FEEDBACK = ("current", "hall_count")  # of each drive


def check_rig(rig: Rig, drives: int) -> None:
    """Raise ConfigError where the reference ECU could not drive a gate of `drives` drives through a rig."""
    issues = ConfigIssues(rig.source)
    for quantity in lacking_feedback(rig, drives):
        issues.add(
            f"outputs.{quantity}",
            f"missing, and the reference ECU does not move without it; allowed: the signal with the "
            f"{quantity.partition('_')[0]} drive's feedback, or another `ecu`",
        )
    commands = {name for name in COMMANDS if name.startswith(SIDES[:drives])} | {"latch_release"}
    for mapping in rig.inputs:
        missing = missing_values(mapping)
        if missing and mapping.quantity in commands:
            issues.add(
                f"inputs.{mapping.quantity}.values",
                f"{', '.join(missing)} missing, and the reference ECU sends it; allowed: a value for each, or "
                "another `ecu`",
            )
    issues.raise_if_any()


def lacking_feedback(rig: Rig, drives: int) -> list[str]:
    """Return the quantities of a gate of `drives` drives that the reference ECU needs and a rig does not send."""
    sent = {mapping.quantity for mapping in rig.outputs}
    needed = (f"{side}_{name}" for side in SIDES[:drives] for name in FEEDBACK)
    return [quantity for quantity in needed if quantity not in sent]
