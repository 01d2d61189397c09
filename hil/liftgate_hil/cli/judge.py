"""The verdicts and margins of a scenario again, from a run's recordings: a table (CSV, Parquet, MF4, MCAP), a bus
log, or both. Exit codes as of `liftgate-hil test`.
"""

from __future__ import annotations

import argparse
import json

from liftgate_hil.cli import options
from liftgate_hil.cli.test import EXIT_CODES, add_set_parameter, naming_the_flag, parameters_of
from liftgate_hil.errors import printable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags."""
    parser.add_argument("recordings", nargs="+", metavar="RECORDING", help="of one run")
    parser.add_argument("--scenario", required=True, metavar="NAME|FILE", help="what is expected")
    parser.add_argument("--vehicle", metavar="NAME|FILE", help="default: the scenario's, else suv")
    parser.add_argument("--rig", metavar="NAME|FILE", help="default: the scenario's, else liftgate")
    add_set_parameter(parser)
    parser.add_argument(
        "--duration",
        type=options.bounded(1e-3, 1e9, "s"),
        metavar="S",
        help="the run's end; default: the scenario's",
    )
    parser.add_argument("--json", action="store_true", help="print the verdicts as JSON")


def run(args: argparse.Namespace) -> int:
    """The command."""
    from liftgate_hil.judging.verdict import worst
    from liftgate_hil.testing.rejudge import judge
    from liftgate_hil.testing.reports import expectation_json, line_of

    with naming_the_flag():
        verdicts = judge(
            args.recordings,
            args.scenario,
            parameters=parameters_of(args.set_parameter),
            vehicle=args.vehicle,
            rig=args.rig,
            duration=args.duration,
        )
    verdict = worst(each.verdict for each in verdicts.values())
    if args.json:
        told = [expectation_json(each) for each in verdicts.values()]
        print(json.dumps({"verdict": verdict, "expectations": told}, indent=2, allow_nan=False))
    else:
        for each in verdicts.values():
            print(f"{printable(each.name)}: {line_of(each)}")
        count = sum(each.verdict == "inconclusive" for each in verdicts.values())
        print(f"{verdict}; {100.0 * count / len(verdicts):.0f} % inconclusive")
    return EXIT_CODES[verdict]
