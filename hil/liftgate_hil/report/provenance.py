"""Provenance of a result (command line, date, versions, files), the same in JSON and HTML."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Annotated

import liftgate_compiler as compiler
from liftgate_hil.config.sources import Source
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.version import versions

# https://reproducible-builds.org/specs/source-date-epoch/: seconds since 1970 that stand for "now".
_EPOCH = "SOURCE_DATE_EPOCH"


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
        default_factory=lambda: " ".join(platform.libc_ver()))
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
