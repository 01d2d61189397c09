"""Many variants of a scenario: all combinations, samples, a search for the worst, a probability.

Exit code 0: it is complete, whatever its verdicts.
"""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.cli.command import Call, add_flags, add_printed
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.errors import ConfigError, LiftgateError, number_of, printable, with_unit
from liftgate_hil.judging.verdict import ERROR
from liftgate_hil.plan.request import RunRequest

if TYPE_CHECKING:
    from liftgate_hil.campaigns.campaign import CampaignProgress as State
    from liftgate_hil.campaigns.run import CampaignOutcome


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `campaign` to its parser."""
    add_flags(parser, CampaignRequest)
    parser.add_argument("--replay", metavar="VARIANT", help="run a variant again and compare it bit by bit")
    add_flags(parser, RunRequest, "record")
    add_printed(parser)


def run(call: Call) -> int:
    """Run the subcommand `campaign` (many variants of a scenario, or one again) and return its exit code."""
    # Before numpy is loaded: on busy CPUs, threads of the BLAS make a search of small matrices 15 times slower.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from liftgate_hil.campaigns.command import campaigned
    from liftgate_hil.campaigns.results import arrow
    from liftgate_hil.campaigns.run import CampaignWatcher
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.report.provenance import provenance_of

    if call.values["replay"] is not None:
        arrow()
        return _replay(call)
    if call.values["record"]:
        raise ConfigError("`record`: allowed together with `replay`")
    request, teller = call.request(CampaignRequest), Teller(call.is_quiet)
    stop = StopSignals()
    with _ended_in_order(stop), teller.progress("campaign") as progress:

        def show(state: State) -> None:
            progress.update(state.done, state.count, line_of(state), before=state.found)

        watcher = CampaignWatcher(stop, show, teller.say)
        found = campaigned(request, provenance_of(call.command_line, {}), watcher)
    for each in found.outcomes:
        _summarise(each, call.is_quiet)
    if found.is_of_parts and not call.is_quiet:
        print(f"{printable(str(request.output))}: report.html", flush=True)
    return 0 if found.is_complete else stop.exit_code


@contextlib.contextmanager
def _ended_in_order(stop: StopSignals) -> Iterator[None]:
    """Context that raises a LiftgateError (no ConfigError) again with the exit code of a preceding stop signal."""
    from liftgate_hil.campaigns.store import KEPT, StoreError

    try:
        yield
    except ConfigError:
        raise
    except StoreError as error:
        raise stop.failure(f"{error}; {KEPT}") from error
    except LiftgateError as error:
        raise stop.failure(str(error)) from error


def line_of(state: State) -> str:
    """Return the state of a campaign as one line of text."""
    parts = [f"{state.done}/{state.count or '?'} variants", f"{state.per_second:.1f} a second"]
    if state.retried:
        parts.append(f"{state.retried} tried again")
    return "  ".join(parts)


def _found(outcome: CampaignOutcome) -> Iterator[str]:
    """Yield the results of a comparison of ECUs, a worst-case search or a failure probability, as lines."""
    from liftgate_hil.campaigns.folder import WORST_FILE, replay_line
    from liftgate_hil.campaigns.prepared import units_of

    found = outcome.analysis.content
    if outcome.is_complete and "against" in found:
        both = found["against"]
        pairs = ", ".join(f"{number} {pair}" for pair, number in both["verdicts"].items())
        differ = f"{both['differing']} of {number_of(both['variants'], 'variant')} differ"
        yield f"{' / '.join(both['ecus'])}: {differ}; verdicts: {pairs}"
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


def _summarise(outcome: CampaignOutcome, is_quiet: bool) -> None:
    """Print, unless quiet, how many variants have which verdict, and where the results are."""
    if is_quiet:
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
    from liftgate_hil.campaigns.folder import AGAINST, DIFFERENCES, MANIFEST, REPORT, RESULTS

    files = [REPORT, f"{RESULTS} with DATA.md", MANIFEST]
    if outcome.is_complete and outcome.prepared.against is not None:
        files += [AGAINST, DIFFERENCES]
    print(f"{printable(str(outcome.folder.path))}: {', '.join(files)}{state}", flush=True)


def _replay(call: Call) -> int:
    """Run a variant of a campaign again; exit code 0: its result is identical to the campaign's, bit by bit."""
    from liftgate_hil.campaigns.replay import replayed
    from liftgate_hil.cli.terminal.suite_teller import QuietListener
    from liftgate_hil.cli.terminal.teller import Teller

    record, teller = RunRequest.of(record=call.values["record"]).recordings, Teller(call.is_quiet)
    with teller.progress("replay"):
        found = replayed(Path(call.values["scenario"]), call.values["replay"], record, QuietListener(teller))
    for line in found.lines:
        print(printable(line), flush=True)
    return 0 if found.is_equal else 1
