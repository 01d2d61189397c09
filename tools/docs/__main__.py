"""Write the generated documentation: `python -m tools.docs`, or `make docs`.

docs/vehicle.md, rig.md, scenario.md, campaign-file.md and map-file.md contain every key of those files, signals.md
every column of recordings, command-line.md every flag, http-api.md every route, json.md every key of JSON results,
equations.md every equation; docs/demo.png is the picture of the demo on the free clock. A test compares the pages
with what is generated; the bytes of the picture depend on matplotlib.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

from liftgate_hil.cli.main import main as liftgate_hil
from tools.docs import DOCS, PAGES


def write_picture(folder: Path) -> int:
    """Write the picture of the demo into a folder, and return the demo's exit code."""
    with tempfile.TemporaryDirectory() as place:
        code = liftgate_hil(["demo", "--clock", "free", "--quiet", "--output", place])
        shutil.copyfile(Path(place, "demo.png"), folder / "demo.png")
    return code


def main() -> int:
    """Write all pages and the picture, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=DOCS, help="default: docs")
    args = parser.parse_args()
    for name, make in PAGES.items():
        (args.output / name).write_text(make(), encoding="utf-8", newline="\n")
    return write_picture(args.output)


if __name__ == "__main__":
    sys.exit(main())
