"""Provenance of a result (command line, date, versions, files), and of a recording (to repeat the recorded run).

That of a recording is the same for the same run on the same machine, and so is the recording; it holds no
wall-clock time.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import math
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import liftgate_compiler as compiler
from liftgate_hil.config.sources import Source, sources_of
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.formats.content import Content
from liftgate_hil.plan.fault_columns import fault_columns_of, faults_by_column
from liftgate_hil.plan.setup import Setup
from liftgate_hil.signals import columns_of
from liftgate_hil.version import versions

if TYPE_CHECKING:
    from liftgate_hil.plan.plan import Plan

# https://reproducible-builds.org/specs/source-date-epoch/: seconds since 1970 that stand for "now".
_EPOCH = "SOURCE_DATE_EPOCH"
_MOST_TEXT = 4_000_000  # bytes of a file that is included; of a larger one only its SHA-256 is


# fmt: off
# A field with its description is a row of a table.


@dataclass(frozen=True)
class Provenance(DescribedResult):
    """Provenance of one result: command line, date, versions, files and computer."""

    command_line: Annotated[str, Shown("the command with its arguments, or the request of a program")]
    date: Annotated[str, Shown("when the result was made: ISO 8601, UTC")]
    sources: Annotated[Mapping[str, Source], Shown("files that were read, by purpose: `scenario`, `vehicle`, "
        "`rig`, `dbc`, …; of `test` and `judge` empty here, see `scenarios[].sources`", keys={"PURPOSE": "a "
        "file"})] = field(default_factory=dict)
    versions: Annotated[Mapping[str, str], Shown("versions by package", keys={"PACKAGE": "version; `unknown`: the "
        "package is not installed"})] = field(default_factory=versions)
    platform: Annotated[str, Shown("operating system and processor architecture")] = field(
        default_factory=platform.platform)
    libc: Annotated[str, Shown("C library with its version")] = field(
        default_factory=functools.cache(lambda: " ".join(platform.libc_ver())))  # it reads the whole interpreter
    processor: Annotated[str, Shown("processor type for which code was compiled")] = field(
        default_factory=lambda: compiler.processor()[0])
    processor_features: Annotated[str, Shown("processor features, each with + or -, separated by commas")] = field(
        default_factory=lambda: compiler.processor()[1])

    # fmt: on
    def rows(self) -> list[tuple[str, str]]:
        """Return the provenance as (name, value) rows of a table."""
        return [
            ("command line", self.command_line),
            ("date", self.date),
            *((name, f"{each.path}, SHA-256 {each.sha256}") for name, each in self.sources.items()),
            ("versions", ", ".join(f"{name} {each}" for name, each in self.versions.items())),
            ("platform", f"{self.platform}, {self.libc}, {self.processor}"),
        ]


def provenance_of(
    command_line: str, sources: Mapping[str, Source], environment: Mapping[str, str] = os.environ
) -> Provenance:
    """Return a result's provenance, dated now or by `SOURCE_DATE_EPOCH` of the environment."""
    given = environment.get(_EPOCH, "")
    is_given = given.isascii() and given.isdigit() and len(given) < 12
    now = datetime.fromtimestamp(int(given), UTC) if is_given else datetime.now(UTC)
    return Provenance(command_line, now.isoformat(timespec="seconds"), dict(sources))


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
