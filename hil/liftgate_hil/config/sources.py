"""The source files that a result was made from, each with the hash of its content."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

from liftgate_hil.described_result import Shown


class Source(NamedTuple):
    """Path of a source file and the hash of its content as it was read."""

    path: Annotated[str, Shown("path of the file")]
    sha256: Annotated[str, Shown("SHA-256 of its content, in hexadecimal digits")]


def sources_of(paths: Mapping[str, Path]) -> dict[str, Source]:
    """Return the source files by purpose (vehicle, rig, dbc), without unreadable ones, which others report."""
    found = {}
    for name, path in paths.items():
        try:
            if path.is_file():  # no pipe, which can be read only once
                with path.open("rb") as stream:
                    digest = hashlib.file_digest(stream, "sha256").hexdigest()
                found[name] = Source(str(path), digest)
        except (OSError, ValueError):  # ValueError: a NUL in the name
            continue
    return found
