"""The checkout that is measured, and another one to measure it against."""

from __future__ import annotations

import os
from pathlib import Path

HERE = Path(__file__).resolve().parents[2]


def environment_of(root: Path) -> dict[str, str]:
    """For a process that is to run a checkout's code; Python keeps what it has compiled, as it does by itself."""
    environment = {**os.environ, "PYTHONPATH": f"{root / 'hil'}:{root / 'plant'}"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    return environment


def name_of(root: Path) -> str:
    """What tables call it."""
    return "now" if root == HERE else "before"
