"""Many variants of a scenario: all combinations, samples, a search for the worst, a probability.

Exit code 0: it is complete, whatever its verdicts.
"""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.config.described import value_of
from liftgate_hil.config.kinds import SEED, NumbersByName
from liftgate_hil.ecu.names import REFERENCE
from liftgate_hil.errors import ConfigError, LiftgateError, number_of, printable, with_unit
from liftgate_hil.judging.verdict import ERROR
from liftgate_hil.running.request import RunRequest

if TYPE_CHECKING:
    from liftgate_hil.campaign.campaign import Progress as State
    from liftgate_hil.campaign.request import Request
    from liftgate_hil.campaign.run import Outcome, Places
    from liftgate_hil.cli.progress import Progress
    from liftgate_hil.cli.teller import Teller

_TEXTS = ("worst", "probability", "against", "output", "store", "scheduler", "replay")
_METHODS = ("sobol", "lhs", "random")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    parser.add_argument(
        "scenario",
        metavar="SCENARIO|FOLDER",
        help="a scenario or campaign file, or a shipped name (pack:trap-matrix); with --replay the folder of a "
        "campaign",
    )
    parser.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="NAME=VALUES|NAME~DISTRIBUTION|vehicle",
        help="vary a parameter of the scenario, seed, draw, or a key of the vehicle file: rod=10000,20000, "
        "angle=10:70:13, 'rod~loguniform(5e3,1e5)'; vehicle: draws from the covariance of its [identification] "
        "(repeatable; all combinations)",
    )
    parser.add_argument(
        "--samples", type=options.whole(1, 10**9), default=0, metavar="N", help="samples of the distributions"
    )
    parser.add_argument("--method", choices=_METHODS, default="", help="how samples are drawn; default: sobol")
    parser.add_argument(
        "--sampling-seed", type=options.of_kind(SEED), default=0, help="seed of samples and searches; default: 0"
    )
    parser.add_argument("--worst", metavar="NAME", help="search for the smallest margin of this expectation")
    parser.add_argument(
        "--evaluations",
        type=options.whole(10, 10**7),
        default=0,
        metavar="N",
        help="evaluations at most; default: 500 for --worst, which draws as many at random to compare with, and "
        "5000 for --probability, at least 1200",
    )
    parser.add_argument(
        "--probability", metavar="NAME", help="estimate the probability that this expectation fails"
    )
    options.add_ecu(parser, REFERENCE, has_bus=False, has_mutants=True)
    parser.add_argument(
        "--against", metavar="ECU", help="another ECU, or a mutant of the reference ECU, for the same variants"
    )
    options.add_vehicle(parser, None, "default: the scenario's, else suv")
    parser.add_argument("--rig", metavar="NAME|FILE", help="the rig; default: the scenario's, else liftgate")
    parser.add_argument(
        "--seed", type=options.of_kind(SEED), help="seed of random values; default: the scenario's"
    )
    options.add_flags(parser, RunRequest, "parameters", "rate", "duration")
    parser.add_argument(
        "--jobs", type=options.whole(1, 1024), metavar="N", help="processes on this machine; default: one per CPU"
    )
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="a Dask scheduler whose workers evaluate")
    parser.add_argument(
        "--store",
        metavar="FOLDER",
        help="where batches are kept, a folder or an address of fsspec; default: in --output",
    )
    parser.add_argument(
        "--output",
        metavar="FOLDER",
        default="campaign",
        help="results.parquet, campaign.json, report.html; default: campaign",
    )
    parser.add_argument("--resume", action="store_true", help="go on with the campaign in --output")
    parser.add_argument("--replay", metavar="VARIANT", help="run a variant again and compare it bit by bit")
    options.add_flags(parser, RunRequest, "record")
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    # Before numpy is loaded: on busy CPUs, threads of the BLAS make a search of small matrices 15 times slower.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from liftgate_hil.campaign.file import is_campaign_file
    from liftgate_hil.campaign.results import arrow
    from liftgate_hil.campaign.run import Watcher, run_campaign
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.report.provenance import provenance_of

    arrow()  # before hours of evaluations whose results could not be written
    if args.replay is not None:
        return _replay(args)
    teller = Teller(args.quiet)
    request = _request(args)
    if is_campaign_file(request.scenario):
        return _run_file(args, request, teller)
    stop = StopSignals()
    with _ended_in_order(stop), teller.progress("campaign") as progress:
        watcher = Watcher(stop, _shown_by(progress), teller.say)
        outcome = run_campaign(request, _places(args), provenance_of(args.command_line, {}), watcher)
    _summarise(outcome, args)
    return 0 if outcome.is_complete else stop.exit_code


def _run_file(args: argparse.Namespace, request: Request, teller: Teller) -> int:
    """Run the parts of a campaign file and return the exit code."""
    from liftgate_hil.campaign.file import read_campaign_file
    from liftgate_hil.campaign.parts import is_complete, run_parts
    from liftgate_hil.campaign.run import Watcher
    from liftgate_hil.report.provenance import provenance_of

    stop = StopSignals()
    with _ended_in_order(stop), teller.progress("campaign") as progress:
        file = read_campaign_file(request.scenario, request)
        watcher = Watcher(stop, _shown_by(progress), teller.say)
        found = run_parts(file, _places(args), provenance_of(args.command_line, {}), watcher)
    for each in found:
        _summarise(each.outcome, args)
    if not args.quiet:
        print(f"{printable(args.output)}: report.html", flush=True)
    return 0 if is_complete(found, file) else stop.exit_code


@contextlib.contextmanager
def _ended_in_order(stop: StopSignals) -> Iterator[None]:
    """Context that gives a failure after a stop the exit code of the stop."""
    from liftgate_hil.campaign.store import KEPT, StoreError

    try:
        yield
    except ConfigError as error:  # SCENARIO is no flag here
        raise ConfigError([line.replace("`scenario` ", "SCENARIO ") for line in error.issues]) from None
    except StoreError as error:
        raise stop.failure(f"{error}; {KEPT}") from error
    except LiftgateError as error:
        raise stop.failure(str(error)) from error


def _places(args: argparse.Namespace) -> Places:
    from liftgate_hil.campaign.run import Places

    return Places(Path(args.output), args.store or "", args.scheduler or "", args.jobs or 0, args.resume)


def _request(args: argparse.Namespace) -> Request:
    """Return the request of the flags. Raises ConfigError."""
    from liftgate_hil.campaign.request import DESIGN, PROBABILITY, WORST, Request

    issues = [f"`{name}`: empty; allowed: a text" for name in _TEXTS if getattr(args, name) == ""]
    if args.worst and args.probability:
        issues.append("`worst`: allowed without --probability")
    if args.record:
        issues.append("`record`: allowed together with --replay")
    kind = WORST if args.worst else PROBABILITY if args.probability else DESIGN
    if kind == DESIGN and args.evaluations:
        issues.append(f"`evaluations` {args.evaluations}: allowed with --worst or --probability")
    if kind != DESIGN and args.samples:
        issues.append(f"`samples` {args.samples}: allowed without --{kind}")
    if issues:
        raise ConfigError(issues)
    return Request(
        scenario=args.scenario,
        vary=tuple(args.vary),
        ecu=options.ecu_of(args),
        against=args.against or "",
        vehicle=args.vehicle,
        rig=args.rig,
        settings=tuple(args.settings),
        parameters=value_of("parameters", args.parameters, NumbersByName()),
        seed=args.seed,
        draw=args.draw,
        ideal=args.ideal,
        rate=args.rate,
        duration=args.duration,
        kind=kind,
        expectation=args.worst or args.probability or "",
        samples=args.samples,
        method=args.method,
        sampling_seed=args.sampling_seed,
        evaluations=args.evaluations,
    )


def _shown_by(shown: Progress) -> Callable[[State], None]:
    """Return what is called with the state of a campaign, and shows it."""
    return lambda state: shown.update(state.done, state.count, line_of(state), before=state.found)


def line_of(state: State) -> str:
    """Return the state of a campaign as a line."""
    parts = [f"{state.done}/{state.count or '?'} variants", f"{state.per_second:.1f} a second"]
    if state.retried:
        parts.append(f"{state.retried} tried again")
    return "  ".join(parts)


def _found(outcome: Outcome) -> Iterator[str]:
    """Yield what a search for the worst, or for a probability, has found, as lines."""
    from liftgate_hil.campaign.folder import WORST_FILE, replay_line
    from liftgate_hil.campaign.request import units_of

    found = outcome.analysis.content
    if outcome.is_complete and "against" in found:
        yield _compared(**found["against"])
    if not outcome.is_complete or "expectation" not in found:
        return
    name = found["expectation"]
    if found.get("margin", found.get("probability")) is None:
        yield f"no variant has a margin of “{name}”: it is inconclusive in all of them"
    elif "margin" in found:
        units = units_of(outcome.prepared)
        values = ", ".join(
            f"{each} = {with_unit(f'{value:.6g}', units[each])}" for each, value in found["values"].items()
        )
        margin = with_unit(f"{found['margin']:.6g}", found["margin_unit"])
        yield f"smallest margin of “{name}”: {margin} with {values}"
        yield f"to run it again: {replay_line(outcome.folder.path, found['variant'])}"
        yield f"as a scenario for other ECUs: {outcome.folder.path / WORST_FILE}"
    else:
        chance, low, high = (found[each] for each in ("probability", "low", "high"))
        share = f"{chance:.3g} (95 %: {low:.3g} to {high:.3g})"
        yield f"probability that “{name}” fails: {share}; the variants above were chosen near failures"


def _compared(ecus: Sequence[str], variants: int, differing: int, verdicts: Mapping[str, int]) -> str:
    """Return how two ECUs differ, as a line."""
    pairs = ", ".join(f"{number} {pair}" for pair, number in verdicts.items())
    return f"{' / '.join(ecus)}: {differing} of {number_of(variants, 'variant')} differ; verdicts: {pairs}"


def _summarise(outcome: Outcome, args: argparse.Namespace) -> None:
    """Print how many variants have which verdict, and where the results are."""
    if args.quiet:
        return
    progress, known = outcome.progress, dict(outcome.counts)
    number = number_of(sum(known.values()), "variant")
    if not outcome.is_complete and outcome.prepared.against is None:  # what was not evaluated is an error there
        known[ERROR] = max(0, known.get(ERROR, 0) - (progress.count - progress.done))
        number = f"{progress.done} of {number_of(progress.count, 'variant')}"
    counts = ", ".join(f"{count} {name}" for name, count in sorted(known.items()) if count)
    print(f"{number}: {counts or 'none'}; {outcome.seconds:.1f} s", flush=True)
    for line in _found(outcome):
        print(printable(line), flush=True)
    state = "" if outcome.is_complete else "; incomplete: go on with --resume"
    from liftgate_hil.campaign.folder import AGAINST, DIFFERENCES, MANIFEST, REPORT, RESULTS

    files = [REPORT, f"{RESULTS} with DATA.md", MANIFEST]
    if outcome.is_complete and outcome.prepared.against is not None:
        files += [AGAINST, DIFFERENCES]
    print(f"{printable(str(outcome.folder.path))}: {', '.join(files)}{state}", flush=True)


def _replay(args: argparse.Namespace) -> int:
    """Run a variant of a campaign again; exit code 0: it is as the campaign saw it, to the bit."""
    from liftgate_hil.campaign.replay import replayed
    from liftgate_hil.cli.suite_teller import QuietListener
    from liftgate_hil.cli.teller import Teller

    record, teller = options.run_request(args).recordings, Teller(args.quiet)
    with teller.progress("replay"):
        found = replayed(Path(args.scenario), args.replay, record, QuietListener(teller))
    for line in found.lines:
        print(printable(line), flush=True)
    return 0 if found.is_equal else 1
