"""The operator's page in Chromium: its memory over time, and its picture for the manual.

    python -m tools.page memory [--minutes M] [--every S] [--output FILE.csv]
    python -m tools.page picture [--output docs/page.png]

`memory`: regularly, after a collection of garbage, the JavaScript heap of the page and the memory of
the page's server. The page keeps 300 s of history, so its heap grows for five minutes; the slope of the second
half says whether it goes on. `picture`: the demo at the moment of the largest pinch force.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from tools.page.watched import watched

_CYCLES = "duration = 1e6\n" + "".join(
    f'[[request]]\ntime = {20 * k + 1}\naction = "{"open" if k % 2 == 0 else "close"}"\n' for k in range(60)
)
_PICTURE = (1500, 1143)  # px of the window: 1500 x 1000 inside
# Stops the page once the pinch force has begun to fall again.
_FREEZE = """
const draw = show;
let most = 0;
window.isFrozen = false;
show = (state) => {
  draw(state);
  most = Math.max(most, state.truth.pinch_force_n || 0);
  if (most > 20 && state.truth.pinch_force_n < most) { wire.onmessage = null; window.isFrozen = true; }
};
"""


def heap_mb(browser: Any) -> float:
    """Return the JavaScript heap in use after a collection of garbage [MB]."""
    browser.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
    return float(browser.execute_cdp_cmd("Runtime.getHeapUsage", {})["usedSize"]) / 1e6


def resident_mb(pid: int) -> float:
    """Return the resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def memory(minutes: float, every: float) -> list[tuple[float, float, float]]:
    """Return time [s], heap [MB] and the server's memory [MB], regularly."""
    with tempfile.TemporaryDirectory() as folder:
        scenario = Path(folder) / "cycles.toml"
        scenario.write_text(_CYCLES)
        with watched(scenario, 1500, 1400) as (browser, server):
            rows = []
            began = time.monotonic()
            for k in range(round(60.0 * minutes / every) + 1):
                time.sleep(max(0.0, began + every * k - time.monotonic()))
                rows.append((time.monotonic() - began, heap_mb(browser), resident_mb(server)))
            return rows


def print_memory(minutes: float, every: float, output: Path | None) -> None:
    """Measure the memory, write all figures as CSV, and print how they go on."""
    rows = np.array(memory(minutes, every))
    if output is not None:
        with output.open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(["time_s", "heap_mb", "server_mb"])
            writer.writerows(rows.tolist())
    for name, values in (("heap of the page", rows[:, 1]), ("server", rows[:, 2])):
        half = len(rows) // 2
        slope = 60.0 * np.polyfit(rows[half:, 0], values[half:], 1)[0] if len(rows) > 4 else np.nan
        print(f"{name}: {values[0]:.1f} MB at the start, {values[-1]:.1f} MB after {rows[-1, 0]:.0f} s; "
              f"{slope:+.3f} MB a minute in the second half")  # fmt: skip


def write_picture(output: Path) -> None:
    """Write the picture of the demo's page."""
    with watched("parts/demo_judged", *_PICTURE) as (browser, _):
        browser.execute_script(_FREEZE)
        deadline = time.monotonic() + 120.0
        while not browser.execute_script("return window.isFrozen"):
            if time.monotonic() > deadline:
                raise SystemExit("the gate was not pinched")
            time.sleep(0.05)
        browser.save_screenshot(str(output))


def main() -> int:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("memory", "picture"))
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--every", type=float, default=10.0, help="s between two figures of the memory")
    parser.add_argument("--output", type=Path)
    args = parser.parse_args()
    if args.what == "picture":
        write_picture(args.output or Path("docs/page.png"))
    else:
        print_memory(args.minutes, args.every, args.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
