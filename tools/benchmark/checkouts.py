"""Checkouts of the project in a benchmark: this one, and another one to compare it with."""

from __future__ import annotations

import os
from pathlib import Path

HERE = Path(__file__).resolve().parents[2]


def environment_of(root: Path) -> dict[str, str]:
    """Return the environment of a process that runs a checkout's code; Python caches bytecode, as by default."""
    environment = {**os.environ, "PYTHONPATH": f"{root / 'hil'}:{root / 'plant'}"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    return environment


def name_of(root: Path) -> str:
    """Return the name of a checkout in tables."""
    return "now" if root == HERE else "before"
