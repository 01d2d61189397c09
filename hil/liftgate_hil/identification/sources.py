"""Files that a request names."""

from __future__ import annotations

import contextlib
from pathlib import Path

from liftgate_hil.config.shipped import find_config
from liftgate_hil.errors import ConfigError
from liftgate_hil.identification.measurements import files_of
from liftgate_hil.identification.request import MeasuredRequest, ModelChoice, ValidateRequest
from liftgate_hil.measurement.read import needs_rig
from liftgate_hil.plan.setup import rig_from


def inputs_of(request: ModelChoice) -> dict[str, Path]:
    """Return the files that a request names, none of which is written, by purpose."""
    files: dict[str, Path] = {}
    measured = files_of(request) if isinstance(request, MeasuredRequest) else ()
    if isinstance(request, MeasuredRequest):
        files |= {f"measurement {k}": path for k, path in enumerate(measured, 1)}
        files |= {f"map {k}": Path(name) for k, name in enumerate(request.maps, 1)}
    if isinstance(request, ValidateRequest) and isinstance(request.parameters, Path):
        files["parameters"] = request.parameters
    with contextlib.suppress(ConfigError):  # reported where it is needed
        files["vehicle"] = find_config("vehicles", str(request.vehicle))
        if isinstance(request, MeasuredRequest) and any(needs_rig(path, {}) for path in measured):
            rig = rig_from(request.rig)
            files |= {"rig": Path(rig.source), "dbc": rig.database}
    return files
