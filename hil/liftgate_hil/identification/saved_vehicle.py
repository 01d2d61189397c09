"""Vehicle file with the estimates of an identification."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence

from liftgate_hil.config.settings import settings_of
from liftgate_hil.config.shipped import find_config
from liftgate_hil.config.toml import read_toml
from liftgate_hil.config.variant import settings_for
from liftgate_hil.config.vehicle import vehicle_of, vehicle_text
from liftgate_hil.errors import ConfigError
from liftgate_hil.identification.measurements import files_of
from liftgate_hil.identification.request import IdentifyRequest
from liftgate_hil.identification.result import Identification
from liftgate_hil.plan.setup import variant_of


def vehicle_text_of(request: IdentifyRequest, result: Identification) -> str:
    """Return the vehicle file with the estimates. Raises ConfigError.

    What is not identifiable keeps its initial value. What a given bound holds has that bound: the others are
    estimated with it.
    """
    identifiable = [k for k, each in enumerate(result.parameters) if each.identifiable]
    origin = {
        "model": result.model,
        "files": list(map(str, files_of(request))),
        "parameters": [result.parameters[k].name for k in identifiable],
        "values": [result.parameters[k].value for k in identifiable],
        "std": [result.parameters[k].std for k in identifiable],
        "covariance": result.covariance[identifiable][:, identifiable].tolist(),
        "not_identifiable": [each.name for each in result.parameters if not each.identifiable],
        "fit_percent": {key: value for key, value in result.fit_percent.items() if math.isfinite(value)},
    }
    values = {each.name: each.value for each in result.parameters if each.identifiable or each.is_held}
    source, variant = find_config("vehicles", str(request.vehicle)), variant_of(request.draw, request.ideal)
    settings = settings_for(read_toml(source), variant, settings_of(request.settings), str(source))
    text = vehicle_text(source, settings, values, origin)
    _check_saved(text, str(request.save_vehicle), [each.name for each in result.parameters], values)
    return text


def _check_saved(text: str, target: str, sought: Sequence[str], identifiable: Mapping[str, float]) -> None:
    """Check that the loader accepts the vehicle to be saved. Raises ConfigError.

    The loader may refuse it where estimates are not consistent with the initial values of parameters that are not
    identifiable.
    """
    not_identifiable = [name for name in sought if name not in identifiable]
    try:
        vehicle_of(tomllib.loads(text), f"`save_vehicle` {target}")
    except ConfigError as error:
        kept = f"; {', '.join(not_identifiable)} kept the initial value" if not_identifiable else ""
        raise ConfigError(
            [f"{line}{kept}; allowed: `estimate` without it, or other `settings`" for line in error.issues]
        ) from error
