"""Description of the machine that runs the benchmark."""

from __future__ import annotations

import os
import platform
from pathlib import Path


def machine_lines() -> list[str]:
    """Return the description of the machine as a Markdown list."""
    return [f"- {line}" for line in machine()]


def machine() -> list[str]:
    """Return the lines that describe the machine: processor, system, Python and numba."""
    model, flags = platform.processor(), ""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        lines = info.read_text().splitlines()
        model = next((x.partition(":")[2].strip() for x in lines if x.startswith("model name")), model)
        flags = next((x for x in lines if x.startswith("flags")), "")
    where = "virtual machine" if " hypervisor" in flags else "no hypervisor"
    return [
        f"{model}, {os.cpu_count()} CPUs, {where}",
        f"{platform.system()} {platform.release()} {platform.version()}",
        f"Python {platform.python_version()}, numba {__import__('numba').__version__}",
    ]


def load_line() -> str:
    """Return a line of a Markdown list: the machine's load average before the benchmark."""
    minute, five, _ = os.getloadavg()
    return f"- load average before: {minute:.1f} over a minute, {five:.1f} over five"
