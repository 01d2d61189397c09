"""Output of the commands that report verdicts."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING

from liftgate_hil.cli import streams
from liftgate_hil.cli.options import as_flags
from liftgate_hil.errors import ConfigError, number_of, printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from liftgate_hil.testing.outcome import Outcome


class Output:
    """Lines to stdout; where nobody takes them, the program goes on, so that its reports are written."""

    def __init__(self) -> None:
        self._lost: OSError | None = None

    def put(self, lines: Iterable[str]) -> None:
        """Print lines at once."""
        text = "\n".join(lines)
        if text and self._lost is None:
            try:
                print(text, flush=True)
            except OSError as error:
                self._lost = error
                streams.abandon(sys.stdout)

    def raise_if_lost(self) -> None:
        """Raise the error with which stdout was lost: ConfigError, or BrokenPipeError where nobody reads."""
        if self._lost is not None and not isinstance(self._lost, BrokenPipeError):
            raise ConfigError(f"stdout: {self._lost.strerror}") from self._lost
        if self._lost is not None:
            raise self._lost


def report_flags(arguments: Sequence[str], message: str) -> None:
    """Write an error of the flags, which could not be parsed, into the reports that they name."""
    from liftgate_hil.testing import report_files
    from liftgate_hil.testing.request import ReportsChoice

    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    for name in ("json", "junit", "html", "results"):
        parser.add_argument(f"--{name}", nargs="?")  # the value may be what is missing
    with contextlib.suppress(argparse.ArgumentError, ConfigError):
        args, _ = parser.parse_known_args(arguments)
        others = list(arguments)
        for given in (args.json, args.junit, args.html):
            if given in others:
                others.remove(given)
        targets = report_files.targets_of(ReportsChoice(**vars(args)), as_flags, say)
        with report_files.reporting_issues(targets, as_flags, say):
            report_files.refuse_inputs(targets, others)
            raise ConfigError(message)


def put_whole(text: str) -> None:
    """Print a report. Raises as `Output.raise_if_lost`."""
    out = Output()
    out.put([text])
    out.raise_if_lost()


def say(text: str) -> None:
    """Print what becomes of files."""
    if sys.stderr is not None:
        print(printable(text), file=sys.stderr)


def summary_of(outcomes: Sequence[Outcome], what: str) -> list[str]:
    """Return the last line: how many expectations have which verdict.

    `what` names what was judged, in the plural: "scenarios", "recordings".
    """
    from liftgate_hil.testing.outcome import counts_of

    counts = counts_of(outcomes)
    text = ", ".join(f"{number} {name}" for name, number in counts.by_verdict().items() if number)
    runs, judged = number_of(len(outcomes), what.removesuffix("s")), number_of(counts.total, "expectation")
    return [f"{runs}, {judged}: {text}; {100.0 * counts.inconclusive_share:.0f} % inconclusive"]
