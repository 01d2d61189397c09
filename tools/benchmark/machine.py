"""What this machine is."""

from __future__ import annotations

import os
import platform
from pathlib import Path


def machine_lines() -> list[str]:
    """A list for a page."""
    return [f"- {line}" for line in machine()]


def machine() -> list[str]:
    """What this was measured on."""
    model, flags = platform.processor(), ""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        lines = info.read_text().splitlines()
        model = next(
            (x.partition(":")[2].strip() for x in lines if x.startswith("model name")), model
        )
        flags = next((x for x in lines if x.startswith("flags")), "")
    where = "virtual machine" if " hypervisor" in flags else "no hypervisor"
    return [
        f"{model}, {os.cpu_count()} CPUs, {where}",
        f"{platform.system()} {platform.release()} {platform.version()}",
        f"Python {platform.python_version()}, numba {__import__('numba').__version__}",
    ]


def load_line() -> str:
    """How busy the machine was with other things when it began."""
    minute, five, _ = os.getloadavg()
    return f"- load average before: {minute:.1f} over a minute, {five:.1f} over five"
