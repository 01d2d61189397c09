"""Many variants of a scenario: all combinations, samples, a search for the worst, a probability.

Exit code 0: it is complete, whatever its verdicts.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.cli.command import Call, add_flags, add_printed
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.config.described import fields_of
from liftgate_hil.errors import ConfigError, LiftgateError, printable
from liftgate_hil.plan.request import RunRequest

if TYPE_CHECKING:
    from liftgate_hil.campaigns.campaign import CampaignProgress


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
    from liftgate_hil.campaigns.outcome_text import outcome_lines, progress_line
    from liftgate_hil.campaigns.results import arrow
    from liftgate_hil.campaigns.run import CampaignWatcher
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.plan.provenance import provenance_of

    if call.values["replay"] is not None:
        values = {each: call.values[each.name] for each in fields_of(CampaignRequest) if each.name != "scenario"}
        if given := [each.name for each, value in values.items() if value and each.is_given(value)]:
            raise ConfigError(f"`replay`: not together with {', '.join(f'`{name}`' for name in given)}")
        arrow()
        return _replay(call)
    if call.values["record"]:
        raise ConfigError("`record`: allowed together with `replay`")
    request, teller = call.request(CampaignRequest), Teller(call.is_quiet)
    stop = StopSignals()
    with _ended_in_order(stop), teller.progress("campaign") as progress:

        def show(state: CampaignProgress) -> None:
            progress.update(state.done, state.count, progress_line(state), before=state.found)

        watcher = CampaignWatcher(stop, show, teller.say)
        found = campaigned(request, provenance_of(call.command_line, {}), watcher)
    for line in [] if call.is_quiet else itertools.chain.from_iterable(map(outcome_lines, found.outcomes)):
        print(line, flush=True)
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
