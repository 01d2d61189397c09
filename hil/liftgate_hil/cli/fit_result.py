"""Output of the commands of identification: JSON, or a text for a person."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeVar

from liftgate_hil.errors import ConfigError

if TYPE_CHECKING:
    from liftgate_hil.described_result import DescribedResult

    Fit = TypeVar("Fit", bound=DescribedResult)


def add_printed(parser: argparse.ArgumentParser) -> None:
    """Add the flags for what is printed."""
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def deliver(args: argparse.Namespace, result: Fit, text: Callable[[Fit], str], issues: Sequence[str]) -> None:
    """Print a result as the flags ask; raise ConfigError with the issues of files that could not be written."""
    if args.json:
        print(result.to_json(), flush=True)
    elif not args.quiet:
        print(text(result), flush=True)
    if issues:
        raise ConfigError(list(issues))
