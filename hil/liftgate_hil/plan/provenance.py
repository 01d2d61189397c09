"""Provenance of a recording: the information that is needed to repeat the recorded run.

It is the same for the same run on the same machine, and so is the recording; it holds no wall-clock time.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import platform
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import liftgate_compiler as compiler
from liftgate_hil.config.sources import Source, sources_of
from liftgate_hil.formats.content import Content
from liftgate_hil.plan.fault_columns import fault_columns_of, faults_by_column
from liftgate_hil.plan.setup import Setup
from liftgate_hil.signals import columns_of
from liftgate_hil.version import versions

if TYPE_CHECKING:
    from liftgate_hil.plan.plan import Plan

_MOST_TEXT = 4_000_000  # bytes of a file that is included; of a larger one only its SHA-256 is


def content_of(plan: Plan, channel: str, bus: str = "", is_recorded: bool = False) -> Content:
    """Return the description of a run for its recordings; `channel` names the bus in them, `bus` is its interface.

    It has a provenance only where the run, by its request, or something beside it `is_recorded`.
    """
    content = Content(columns_of(plan.setup.vehicle.drives), channel, inputs=plan.inputs)
    if plan.request.recordings or is_recorded:
        content = replace(content, about=origin_of(plan, bus))
    # On the clocks free and lockstep it has the same columns on a bus, where faults may be injected, as without.
    is_open = plan.opening.slots > 0 and plan.request.clock == "realtime"
    return content.with_faults(fault_columns_of(plan.setup.scenario.faults, is_open))


def origin_of(plan: Plan, bus: str = "") -> str:
    """Return the provenance of a run as JSON.

    It holds versions and machine, seed, clock, rate, parameters and faults of the scenario, the files with their
    content and SHA-256, the vehicle as it was used, in SI units, the ECU (see `identity_of`), the interface of a
    bus, and the recording trigger, where not all was recorded.
    """
    request = plan.request
    more: dict[str, object] = {"ecu": _plain(plan.ecu_identity)}
    if bus:
        more["bus"] = bus
    if request.record_when:
        before, after = request.around()
        more["recorded"] = {"when": list(request.conditions), "before_s": before, "after_s": after}
    files = {name: each for name, each in plan.sources.items() if name != "ecu"}
    return _origin(plan.setup, request.clock, request.rate, plan.duration, files, more)


def origin_offline(setup: Setup, step: float, duration: float, files: Mapping[str, Path]) -> str:
    """Return the provenance of a simulation of the plant alone, at a `step` [s], as JSON; `files` are inputs."""
    return _origin(setup, "offline", 1.0 / step, duration, sources_of({**files, **setup.files}), {})


def _origin(
    setup: Setup,
    clock: str,
    rate: float,
    duration: float | None,
    files: Mapping[str, Source],
    more: Mapping[str, object],
) -> str:
    processor, features = compiler.processor()
    origin = {
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
        "parameters": dict(setup.scenario.parameters),
        "faults": _plain(faults_by_column(setup.scenario.faults)),
        **more,
        "files": {name: _file(each) for name, each in files.items()},
        "vehicle": _plain(setup.vehicle),
    }
    return json.dumps(origin, indent=1, allow_nan=False, ensure_ascii=False)


def _file(source: Source) -> dict[str, str]:
    """Return a file as an entry of the provenance, with its text unless this is too long or has changed since."""
    path, entry = Path(source.path), source._asdict()
    with contextlib.suppress(OSError):
        if path.stat().st_size <= _MOST_TEXT:
            content = path.read_bytes()
            if hashlib.sha256(content).hexdigest() == source.sha256:
                entry["text"] = content.decode(errors="replace")
    return entry


def _plain(value: Any) -> Any:
    """Return a value in a form that JSON can hold; a number that is not finite becomes a text."""
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
