"""A found variant as a scenario file of its own, which includes the campaign's scenario."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from liftgate_hil.campaigns.base import Base
from liftgate_hil.campaigns.prepared import Prepared
from liftgate_hil.config.scenario import ScenarioFile
from liftgate_hil.config.settings import settings_of
from liftgate_hil.config.variant import AS_FILED, settings_for
from liftgate_hil.config.vehicle import VehicleFile
from liftgate_hil.plan.setup import variant_of


def scenario_text(prepared: Prepared, values: Sequence[float], comment: str, folder: Path) -> str:
    """Return a scenario file for a folder that runs as the variant with these values does, at the campaign's rate.

    It names other files relative to the folder, so that both can be moved together.
    """
    base, request = prepared.base, prepared.base.job_of(values).request
    file, vehicle = request.scenario, request.vehicle
    assert isinstance(file, ScenarioFile)
    assert isinstance(vehicle, VehicleFile)
    lines = [f"# {line}" for line in comment.splitlines()]
    lines += [f"include = {json.dumps([_relative(file.path, folder)])}"]
    lines += [f"{name} = {_toml(value)}" for name, value in _heads(prepared, base, request.seed, folder).items()]
    parameters = request.parameter_values
    if parameters:
        lines += ["", "[parameters]", *(f"{name} = {value!r}" for name, value in parameters.items())]
    variant = variant_of(request.draw, request.ideal)
    settings = settings_of(request.settings)
    if variant != AS_FILED:
        settings = [*file.scenario(parameters).settings, *settings]
        settings = settings_for(vehicle.raw, variant, settings, str(vehicle.path))
    if settings:
        own = {each.key: each.value for each in settings}
        lines += ["", "[set]", *(f"{json.dumps(key)} = {_toml(value)}" for key, value in own.items())]
    return "\n".join(lines) + "\n"


def _heads(prepared: Prepared, base: Base, seed: int | None, folder: Path) -> dict[str, Any]:
    """Return the keys at the top of the file, where they are not those of the included one."""
    request, vehicle, found = prepared.request, base.job.request.vehicle, dict[str, Any]()
    assert isinstance(vehicle, VehicleFile)
    if request.vehicle is not None:
        found["vehicle"] = _name(vehicle.name, folder)
    if request.rig is not None:
        found["rig"] = _name(str(request.rig), folder)
    if request.duration is not None:
        found["duration"] = request.duration
    if seed is not None:
        found["seed"] = seed
    return found


def _name(name: str, folder: Path) -> str:
    return _relative(Path(name), folder) if Path(name).is_file() else name


def _relative(path: Path, folder: Path) -> str:
    return os.path.relpath(path.resolve(), folder.resolve())


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(value)
