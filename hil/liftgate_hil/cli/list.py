"""What is shipped, with descriptions: scenarios, vehicles, rigs, campaigns and ECUs, as flags take their names."""

from __future__ import annotations

import argparse
import itertools

from liftgate_hil.cli.command import Call
from liftgate_hil.errors import ConfigError, allowed_names

_FLAGS = {
    "scenarios": "liftgate-hil test NAME, --scenario NAME",
    "vehicles": "--vehicle NAME",
    "rigs": "--rig NAME",
    "campaigns": "liftgate-hil campaign NAME",
    "ECUs": "--ecu NAME; mutant:NAME is the reference ECU with one defect, for `test` and `campaign`",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `list` to its parser."""
    parser.add_argument(
        "prefix",
        nargs="?",
        default="",
        metavar="PREFIX",
        help="only names that begin so, also behind a / or : (crank: pack/crank_dip); or one of scenarios, "
        "vehicles, rigs, campaigns, ECUs",
    )


def run(call: Call) -> int:
    """Run the subcommand `list` (print what is shipped) and return its exit code. Raises ConfigError."""
    from liftgate_hil.config.shipped import Shipped, shipped_list
    from liftgate_hil.ecu.mutants import MUTANTS
    from liftgate_hil.ecu.names import REFERENCE

    every = [*shipped_list(), Shipped("ECUs", REFERENCE, "the reference ECU")]
    every += [Shipped("ECUs", f"mutant:{name}", each.meaning) for name, each in MUTANTS.items()]
    prefix = str(call.values["prefix"])
    groups = {kind.casefold(): kind for kind in _FLAGS}
    kind = groups.get(prefix.casefold())
    found = [each for each in every if (each.kind == kind if kind else _begins(each.name, prefix))]
    if not found:
        kinds, names = ", ".join(_FLAGS), allowed_names(prefix, [each.name for each in every])
        raise ConfigError(f"PREFIX {prefix}: no name begins so; allowed: {names}, or one of {kinds}")
    width = max(len(each.name) for each in found)
    for number, (kind, those) in enumerate(itertools.groupby(found, lambda each: each.kind)):
        print(f"{chr(10) * bool(number)}{kind} ({_FLAGS[kind]})")
        for each in those:
            print(f"  {each.name:<{width}}  {each.description}".rstrip())
    return 0


def _begins(name: str, prefix: str) -> bool:
    """Whether a name, or its part after the first slash or colon, as in `mutant:NAME`, begins with a prefix."""
    return any(each.startswith(prefix) for each in (name, name.replace(":", "/").partition("/")[2]) if each)
