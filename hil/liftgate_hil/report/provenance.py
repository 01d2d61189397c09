"""Provenance of a result: command line, date, versions, files; the same in JSON and HTML."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any

from liftgate_hil.config.sources import Source
from liftgate_hil.version import versions
from liftgate_plant import compiler

# https://reproducible-builds.org/specs/source-date-epoch/: seconds since 1970 that stand for "now".
_EPOCH = "SOURCE_DATE_EPOCH"


@dataclass(frozen=True)
class Provenance:
    """Provenance of one result: command line, date, versions, files and computer."""

    command_line: str
    date: str  # ISO 8601, UTC
    sources: Mapping[str, Source] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=versions)
    platform: str = field(default_factory=platform.platform)
    libc: str = field(default_factory=lambda: " ".join(platform.libc_ver()))
    processor: str = field(default_factory=lambda: compiler.processor()[0])
    processor_features: str = field(default_factory=lambda: compiler.processor()[1])

    def as_dict(self) -> dict[str, Any]:
        """Return the provenance as a dictionary for JSON."""
        sources = {name: each._asdict() for name, each in self.sources.items()}
        return {**asdict(self), "sources": sources}

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
    """Return the provenance of a result of now, or of the time in `SOURCE_DATE_EPOCH` of the environment."""
    given = environment.get(_EPOCH, "")
    is_given = given.isascii() and given.isdigit() and len(given) < 12
    now = datetime.fromtimestamp(int(given), UTC) if is_given else datetime.now(UTC)
    return Provenance(command_line, now.isoformat(timespec="seconds"), dict(sources))
