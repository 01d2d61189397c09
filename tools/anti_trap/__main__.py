"""Study of the anti-trap: python -m tools.anti_trap [--cars N] [--trade-cars N] [--output FOLDER]

It writes anti-trap.md and its figure to FOLDER.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from liftgate_hil.ecu.calibration import Calibration
from tools.anti_trap import page, study


def main(arguments: Sequence[str] | None = None) -> int:
    """Write docs/anti-trap.md and its figure."""
    parser = argparse.ArgumentParser(prog="python -m tools.anti_trap", description=__doc__)
    parser.add_argument("--cars", type=int, default=1000, help="that are drawn")
    parser.add_argument("--trade-cars", type=int, default=300, help="for each width of the limits")
    parser.add_argument("--output", type=Path, default=Path("docs"))
    args = parser.parse_args(arguments)
    own = Calibration()
    travel = study.over_the_travel(own)
    many = study.of_many(args.cars, lambda each: each)
    trade = {
        factor: study.of_many(args.trade_cars, lambda each, factor=factor: study.widened(each, factor))
        for factor in study.FACTORS
    }
    plain = next(iter(study.CONDITIONS))
    energies = {vehicle: study.energy_of(vehicle, travel[vehicle][plain].ratio) for vehicle in study.VEHICLES}
    page.written(args.output, travel, many, trade, study.by_rod(own), energies)
    return 0


if __name__ == "__main__":
    sys.exit(main())
