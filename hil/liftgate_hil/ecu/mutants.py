"""Mutants of the reference ECU for mutation testing: each has one plausible defect, given as data.

The identity of the ECU under test, as a recording stores it, names its mutant.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from liftgate_hil.codec import checksum
from liftgate_hil.config.sources import sources_of
from liftgate_hil.ecu.adapter import Adapter, ReferenceEcu
from liftgate_hil.ecu.calibration import CALIBRATED, Calibration, coded
from liftgate_hil.ecu.find import is_library
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.ecu.names import REFERENCE as REFERENCE_NAME
from liftgate_hil.ecu.reference import EcuConfig
from liftgate_hil.errors import ConfigError, allowed_names
from liftgate_hil.version import version
from liftgate_plant.coding import Coding

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig


_NEVER = 1e9  # s, counts, A, °C


@dataclass(frozen=True)
class Mutant:
    """A reference ECU with one defect: other calibration constants, or a function that its program lacks."""

    name: str
    meaning: str
    numbers: Mapping[str, float] = field(default_factory=dict)  # values of Calibration, by name
    factors: Mapping[str, float] = field(default_factory=dict)  # factors on values of Calibration
    defect: str = ""  # name of a field of Defects
    unchecked: str = ""  # counter or checksum: not checked in received frames


_MUTANTS = (
    Mutant("threshold_too_high", "the limits of the load are 2.5 times too high", factors={
        "excess_learned": 2.5, "excess_unlearned": 2.5, "excess_share": 2.5, "excess_per_slope": 2.5}),
    Mutant("blanking_too_long", "no obstacle is detected for 5 s after a start", {"blank_time": 5.0}),
    Mutant("detection_too_slow", "an excess load counts only after 0.15 s", {"detection_time": 0.15}),
    Mutant("filter_too_slow", "the currents are filtered with a time constant of 0.1 s", {"load_filter": 0.1}),
    Mutant("reference_follows", "the expected load follows the measured one within 0.015 s",
           {"reference_time": 0.015}),
    Mutant("inertia_uncompensated", "the current that accelerates the drives counts as load", {"inertia": 0.0}),
    Mutant("reversal_too_short", "it reverses by 2 % of the travel", {"reverse_distance": 0.02}),
    Mutant("closing_too_fast", "the closing speed setpoint is doubled", factors={
        "closing_speed": 2.0, "closing_start": 2.0,
    }),
    Mutant("stall_unseen", "stalled drives are still driven", {"stall_time": _NEVER, "seal_stall_time": _NEVER}),
    Mutant("latch_not_released", "the latch is not released", {"latch_pulse": 0.0}),
    Mutant("end_missed", "the open end is assumed 400 counts too far", {"end_margin": -400.0}),
    Mutant("learning_presses", "the end stop is learned with full force", {"learning_excess": _NEVER}),
    Mutant("closing_unwatched", "no obstacle is detected while closing", defect="closing_unwatched"),
    Mutant("opening_unwatched", "no obstacle is detected while opening", defect="opening_unwatched"),
    Mutant("one_drive_watched", "only the left drive's load is evaluated", defect="one_drive_watched"),
    Mutant("second_run_unwatched", "the run after a reversal is not monitored",
           defect="second_run_unwatched"),
    Mutant("only_stops", "the gate stops instead of reversing", defect="only_stops"),
    Mutant("learns_disturbed", "the load of a trapped obstacle is learned", defect="learns_disturbed"),
    Mutant("stop_ignored", "the driver cannot stop a motion", defect="stop_ignored"),
    Mutant("latch_unseen", "the latch's switch is ignored", defect="latch_unseen"),
    Mutant("latch_believed", "the latch's switch is trusted at any gate angle", defect="latch_believed"),
    Mutant("one_drive_commanded", "the right drive is not driven", defect="one_drive_commanded"),
    Mutant("goes_on_after_reset", "it closes an open gate when it is switched on", defect="goes_on_after_reset"),
    Mutant("end_never_learned_again", "the first open end that was learned is never replaced",
           defect="end_never_learned_again"),
    Mutant("stale_data_used", "the feedback never times out", {"feedback_timeout": _NEVER}),
    Mutant("counter_unchecked", "frames with an unchanged counter are accepted as new", unchecked="counter"),
    Mutant("checksum_unchecked", "frames with a wrong checksum are accepted", unchecked="checksum"),
    Mutant("hall_ignored", "drives whose Hall counts differ keep moving", {"counts_apart": _NEVER}),
    Mutant("frozen_current_unseen", "a frozen current is accepted", {"frozen_time": _NEVER}),
    Mutant("lost_current_unseen", "one drive that carries the whole load keeps moving", {"lone_time": _NEVER}),
    Mutant("over_current_unseen", "over-current is not detected", {"over_current": _NEVER}),
    Mutant("fall_unseen", "a falling gate is not held", {"fall_counts": _NEVER}),
    Mutant("heat_ignored", "motors start at any temperature", {"hot": _NEVER}),
)  # fmt: skip

MUTANTS: Mapping[str, Mutant] = {each.name: each for each in _MUTANTS}

NO_ECU = "no ECU"  # in place of a mutant: nothing commands the gate


def ecu_and_mutant(name: str, called: str = "ecu") -> tuple[str, str]:
    """Return ECU and mutant of an ECU name: `mutant:NAME` is the reference ECU with a mutant, others have "".

    Raises ConfigError for a mutant that does not exist, of the argument that is `called` so.
    """
    kind, _, mutant = name.partition(":")
    if kind != "mutant":
        return name, ""
    if mutant not in MUTANTS:
        raise ConfigError(f"`{called}` {name}: allowed: mutant: and one of {allowed_names(mutant, MUTANTS)}")
    return REFERENCE_NAME, mutant


def calibration_of(mutant: Mutant, coding: Coding) -> Calibration:
    """Return the calibration for a vehicle's coding, with the mutant's defect."""
    sound = coded(CALIBRATED, coding)
    changed: dict[str, Any] = dict(mutant.numbers)
    for name, factor in mutant.factors.items():
        value = getattr(sound, name)
        is_curve = isinstance(value, tuple)
        changed[name] = tuple(factor * each for each in value) if is_curve else factor * value
    if mutant.defect:
        changed["defects"] = sound.defects._replace(**{mutant.defect: 1})
    return sound._replace(**changed)


def mutant_ecu(name: str, rig: Rig, drives: int, coding: Coding) -> Adapter:
    """Return the adapter of a mutant of the reference ECU, or of no ECU at all (NO_ECU)."""
    if name == NO_ECU:
        return Adapter(rig, drives)
    mutant = MUTANTS[name]
    ecu = ReferenceEcu(rig, drives, calibration=calibration_of(mutant, coding))
    if mutant.unchecked:
        ecu.node = ecu.node._replace(reference=_without(mutant.unchecked, ecu.node.reference))
    return ecu


def _without(check: str, config: EcuConfig) -> EcuConfig:
    """Return the constants of an ECU that does not check the counter, or the checksum, of received frames."""
    messages = config.inputs.messages.copy()
    if check == "counter":
        messages.counter[:] = -1
    else:  # the checksum of an E2E profile is checked together with its counter
        is_simple = np.isin(messages.kind, [*checksum.KINDS.values(), checksum.OWN])
        messages.kind[is_simple] = checksum.NONE
    return config._replace(inputs=config.inputs._replace(messages=messages))


def identity_of(ecu: Any, coding: Coding, mutant: str = "") -> Mapping[str, Any]:
    """Return an ECU's `kind` (reference, library, python, bus, none), and the data that identify it.

    For the reference ECU that is its version and its calibration, `coded` for the vehicle, with the mutant if
    there is one; for a library its path and SHA-256; for a class its name with the path and SHA-256 of its file,
    where that is known.
    """
    if mutant == NO_ECU:
        return {"kind": "none"}
    if not isinstance(ecu, str | Path):
        kind = ecu if isinstance(ecu, type) else type(ecu)
        return _of_class(kind.__module__, kind.__qualname__)
    name = str(ecu)
    if name == ON_A_BUS:
        return {"kind": ON_A_BUS}
    if is_library(ecu):
        return {"kind": "library", "path": name, "sha256": _digest(Path(name))}
    module, colon, attribute = name.partition(":")
    if colon:
        return _of_class(module, attribute)
    calibration = calibration_of(MUTANTS[mutant], coding) if mutant else coded(CALIBRATED, coding)
    identity: dict[str, Any] = {"kind": name, "version": version()}
    if mutant:
        identity["mutant"] = mutant
    return {**identity, "calibration": calibration}


def _of_class(module: str, name: str) -> dict[str, Any]:
    """Return the identity of a Python ECU: kind, class, and its file's path and SHA-256 where they are known."""
    identity: dict[str, Any] = {"kind": "python", "class": f"{module}:{name}"}
    path = _file_of(module)
    return identity if path is None else {**identity, "path": str(path), "sha256": _digest(path)}


def _file_of(module: str) -> Path | None:
    """Return the path of a module's file, without executing any code of the module; None: unknown."""
    found = getattr(sys.modules.get(module), "__file__", None)
    if found is None and "." not in module and module not in sys.modules:  # for a submodule, its package would run
        try:
            spec = importlib.util.find_spec(module)
        except (ImportError, ValueError):
            return None
        found = spec.origin if spec is not None and spec.has_location else None
    return None if found is None else Path(found)


def _digest(path: Path) -> str:
    source = sources_of({"ecu": path}).get("ecu")
    return source.sha256 if source else ""
