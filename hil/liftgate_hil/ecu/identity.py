"""Identity of the ECU under test, as a recording stores it."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from liftgate_hil.config.sources import sources_of
from liftgate_hil.ecu.calibration import CALIBRATED, coded
from liftgate_hil.ecu.find import is_library
from liftgate_hil.ecu.mutants import MUTANTS, NO_ECU, calibration_of
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.version import version
from liftgate_plant.coding import Coding


def identity_of(ecu: Any, coding: Coding, mutant: str = "") -> Mapping[str, Any]:
    """Return `kind` (reference, library, python, bus, none), and what is needed to obtain the same ECU again.

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
    identity: dict[str, Any] = {"kind": "python", "class": f"{module}:{name}"}
    path = _file_of(module)
    return identity if path is None else {**identity, "path": str(path), "sha256": _digest(path)}


def _file_of(module: str) -> Path | None:
    """Return the path of a module's file, without running any code of the module."""
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
