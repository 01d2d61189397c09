"""Provenance of a recording: what is needed to repeat the run that it is of.

It is the same for the same run on the same machine, and so is the recording; it holds no wall-clock time.
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
from liftgate_hil.config.shipped import find_config
from liftgate_hil.config.sources import sources_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.running.job import identity_of_ecu
from liftgate_hil.running.plan import Subject
from liftgate_hil.running.setup import Setup
from liftgate_hil.version import versions
from liftgate_plant import compiler

_MOST_TEXT = 4_000_000  # bytes of a file that is included; of a larger one only its SHA-256 is


def origin_of(plan: Subject, bus: str = "") -> str:
    """Return the provenance of a run as JSON; empty where nothing is recorded.

    It holds versions and machine, seed, clock, rate, the files with their content and SHA-256, the vehicle as it
    was used, in SI units, the ECU (`ecu.identity`), the interface of a bus, and the recording trigger, where not
    all was recorded.
    """
    setup, rig, options = plan.setup, plan.rig, plan.options
    if not options.record:
        return ""
    files = {"rig": Path(rig.source), "dbc": rig.database}
    more: dict[str, Any] = {"ecu": _plain(identity_of_ecu(plan.job, setup))}
    if bus:
        more["bus"] = bus
    if options.record_when:
        before, after = options.around()
        more["recorded"] = {
            "when": list(options.record_when), "before_s": before, "after_s": after,
        }  # fmt: skip
    return _origin(setup, options.clock, options.rate, plan.duration, files, more)


def origin_offline(setup: Setup, step: float, duration: float, files: Mapping[str, Path]) -> str:
    """Return the provenance of a simulation of the plant alone, in steps [s], from these files, as JSON."""
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
    with contextlib.suppress(ConfigError):  # a vehicle that a program has made
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
        "files": {name: _file(name, path) for name, path in found.items() if path.name and not issue_with(path)},
        "vehicle": _plain(setup.vehicle),
    }
    return json.dumps(told, indent=1, allow_nan=False, ensure_ascii=False)


def _file(name: str, path: Path) -> dict[str, str]:
    source = sources_of({name: path}).get(name)
    told = {"path": str(path), "sha256": source.sha256 if source else ""}
    with contextlib.suppress(OSError):  # the file is gone meanwhile
        if path.stat().st_size <= _MOST_TEXT:
            told["text"] = path.read_bytes().decode(errors="replace")
    return told


def _plain(value: Any) -> Any:
    """Return a value as JSON can hold it; a number that is not finite becomes a text."""
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
