"""Study of the anti-trap: python -m tools.anti_trap [--cars N] [--trade-cars N] [--output FOLDER]

It writes anti-trap.md, its picture, and the figures that both are made of, anti-trap.json, to FOLDER. With
--drawn-again FILE page and picture are made of the figures in that file, and nothing is run.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from liftgate_hil.ecu.calibration import Calibration
from tools.anti_trap import figures, page, study
from tools.anti_trap.figures import Figures


def main(arguments: Sequence[str] | None = None) -> int:
    """Write docs/anti-trap.md, its picture and its figures."""
    parser = argparse.ArgumentParser(prog="python -m tools.anti_trap", description=__doc__)
    parser.add_argument("--cars", type=int, default=1000, help="that are drawn")
    parser.add_argument("--trade-cars", type=int, default=300, help="for each tolerance scale")
    parser.add_argument("--drawn-again", type=Path, metavar="FILE", help="figures of an earlier study")
    parser.add_argument("--output", type=Path, default=Path("docs"))
    args = parser.parse_args(arguments)
    args.output.mkdir(parents=True, exist_ok=True)
    if args.drawn_again:
        found = figures.read(args.drawn_again)
    else:
        found = studied(args.cars, args.trade_cars)
        found.write(args.output / figures.FILE)
    page.written(args.output, found)
    return 0


def studied(cars: int, trade_cars: int) -> Figures:
    """Return the figures of the study, with so many drawn cars, and so many for each tolerance scale."""
    own = Calibration()
    travel = study.over_the_travel(own)
    many = study.of_many(cars, lambda each: each)
    trade = {
        factor: study.of_many(trade_cars, lambda each, factor=factor: study.widened(each, factor))
        for factor in study.FACTORS
    }
    plain = next(iter(study.CONDITIONS))
    energies = {vehicle: study.energy_of(vehicle, travel[vehicle][plain].ratio) for vehicle in study.VEHICLES}
    return Figures(travel, many, trade, study.by_rod(own), energies)


if __name__ == "__main__":
    sys.exit(main())
