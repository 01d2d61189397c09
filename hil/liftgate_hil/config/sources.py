"""The files that a result was made from, each with the hash of its content."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple


class Source(NamedTuple):
    """A file as it was read."""

    path: str
    sha256: str


def sources_of(paths: Mapping[str, Path]) -> dict[str, Source]:
    """The files by what they are for (vehicle, rig, dbc). What cannot be read is left out: its reader says so."""
    found = {}
    for name, path in paths.items():
        try:
            if path.is_file():  # no pipe, which can be read once only
                with path.open("rb") as stream:
                    digest = hashlib.file_digest(stream, "sha256").hexdigest()
                found[name] = Source(str(path), digest)
        except (OSError, ValueError):  # a NUL in the name
            continue
    return found
