"""What a recording says of the run that it is of: enough to run it again.

It is the same for the same run on the same machine, and so is the recording; of the wall clock it says nothing.
"""

from __future__ import annotations

import contextlib
import json
import math
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from liftgate_hil.config.files import issue_with
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.shipped import find_config
from liftgate_hil.config.sources import sources_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.session import RunOptions, Setup
from liftgate_hil.version import versions
from liftgate_plant import compiler

ON_THE_BUS = {"kind": "bus"}  # an ECU of which no more is known
_MOST_TEXT = 4_000_000  # bytes of a file that goes in; of a larger one its SHA-256


def origin_of(
    setup: Setup,
    rig: Rig,
    options: RunOptions,
    ecu: Mapping[str, Any] = ON_THE_BUS,
    bus: str = "",
) -> str:
    """JSON: versions and machine, seed, clock, rate, the files with their content and SHA-256, the vehicle as it
    was in the end, in SI units, the ECU (`ecu.identity`), the interface of a bus, and around what it was recorded,
    where not all was. Empty where nothing is recorded.
    """
    if not options.records:
        return ""
    duration = setup.scenario.duration if options.duration is None else options.duration
    files = {"rig": Path(rig.source), "dbc": rig.database}
    more: dict[str, Any] = {"ecu": _plain(ecu)}
    if bus:
        more["bus"] = bus
    if options.record_when:
        before, after = options.around()
        more["recorded"] = {
            "when": list(options.record_when), "before_s": before, "after_s": after,
        }  # fmt: skip
    return _origin(setup, options.clock, options.rate, duration, files, more)


def origin_offline(setup: Setup, step: float, duration: float, files: Mapping[str, Path]) -> str:
    """The same of a simulation of the plant alone, in steps [s], from these files."""
    return _origin(setup, "offline", 1.0 / step, duration, files, {})


def _origin(
    setup: Setup,
    clock: str,
    rate: float,
    duration: float | None,
    files: Mapping[str, Path],
    more: Mapping[str, Any],
) -> str:
    scenario = setup.scenario
    processor, features = compiler.processor()
    found = {**files, "scenario": Path(scenario.source)}
    found |= {f"included {k}": Path(name) for k, name in enumerate(scenario.included, 1)}
    with contextlib.suppress(ConfigError):  # one that a program has made
        found["vehicle"] = find_config("vehicles", setup.vehicle_name)
    told = {
        "versions": versions(),
        "platform": platform.platform(),
        "libc": " ".join(platform.libc_ver()),
        "processor": processor,
        "processor_features": features,
        "seed": setup.seed,
        "clock": clock,
        "rate_hz": rate,
        "duration_s": duration,
        "initial_deg": math.degrees(setup.start_angle),
        "parameters": dict(scenario.parameters),
        **more,
        "files": {
            name: _file(name, path)
            for name, path in found.items()
            if path.name and not issue_with(path)
        },
        "vehicle": _plain(setup.vehicle),
    }
    return json.dumps(told, indent=1, allow_nan=False, ensure_ascii=False)


def _file(name: str, path: Path) -> dict[str, str]:
    source = sources_of({name: path}).get(name)
    told = {"path": str(path), "sha256": source.sha256 if source else ""}
    with contextlib.suppress(OSError):  # gone meanwhile
        if path.stat().st_size <= _MOST_TEXT:
            told["text"] = path.read_bytes().decode(errors="replace")
    return told


def _plain(value: Any) -> Any:
    """Tables as JSON has them; a number that is none as a text."""
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if isinstance(value, str | int | float | bool | None) else str(value)
