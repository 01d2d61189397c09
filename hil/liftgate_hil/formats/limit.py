"""Limit of a recording: the largest size of a file, and how many files are kept."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limit:
    """Limit of a recording's files."""

    size: int  # bytes
    keep: int | None = None  # number of files that are kept, the latest ones; None: all
