"""Command-line flags shared by several subcommands, their validation, and the options made from them."""

from __future__ import annotations

import argparse
import contextlib
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.config.described import REQUIRED, Record, fields_of, signature_of
from liftgate_hil.config.kinds import Choice, Flag, Kind, Number, Paths, Whole
from liftgate_hil.config.vehicle_choice import SetupChoice, WireChoice
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.plan.request import RunRequest

if TYPE_CHECKING:
    from liftgate_hil.plan.setup import Setup

MACHINE = ("realtime", "cpu")  # options about what the program requests of the machine
LISTEN = "127.0.0.1:8765"
_PARSERS: Mapping[type, Callable[[str], Any]] = {Number: float, Whole: int}
_ARGUMENT = re.compile(r"`([a-z][a-z_]*)`")
_FLAGS: dict[str, str] = {}  # of the command whose flags were added last, by the names of their arguments


def forget_flags() -> None:
    """Forget what arguments are called: those of another command are added next."""
    _FLAGS.clear()


def as_flags(text: str) -> str:
    """Return a message of the API with its arguments, `so_named`, replaced by the command's flags: --so-named."""
    return _ARGUMENT.sub(lambda match: _FLAGS.get(match[1], "--" + match[1].replace("_", "-")), text)


def of_kind(kind: Kind) -> Callable[[str], Any]:
    """Return an argparse type that reads the values of a kind."""

    def convert(text: str) -> Any:
        value: Any = text
        with contextlib.suppress(ValueError):
            value = _PARSERS.get(type(kind), str)(text)
        issues = ConfigIssues("")
        found = kind.read(issues, "", value)
        if issues.count:
            raise argparse.ArgumentTypeError(f"{text!r}; allowed: {kind.allowed}")
        return found

    return convert


def bounded(low: float, high: float, unit: str) -> Callable[[str], float]:
    """Return an argparse type: a finite number within [low, high]."""
    return of_kind(Number(low, high, unit))


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return an argparse type: a whole number within [low, high]."""
    return of_kind(Whole(low, high))


def add_flags(
    parser: argparse.ArgumentParser, record: type[Record], *names: str, placed: str = "", **defaults: Any
) -> None:
    """Add a flag, or where it is required an argument, for fields of a record; `defaults` replace theirs.

    Without names all fields get theirs. The field `placed` is an argument, too, which may be left out. What is
    required and says how its flag is called is a flag nevertheless.
    """
    fields = {each.name: each for each in fields_of(record)}
    for name in names or signature_of(record).parameters:
        field = fields[name]._replace(default=defaults.get(name, fields[name].default))
        own, meta = "--" + (field.flag or name.replace("_", "-")), field.metavar
        letters = [each for each in field.also if not each.startswith("--")]
        flags = [*letters, own, *(each for each in field.also if each not in letters)]
        is_required = field.default is REQUIRED
        words = "" if is_required else field.default_text
        text = f"{field.meaning}; default: {words}" if words else field.meaning
        is_placed = name == placed or (is_required and not field.flag)
        _FLAGS[name] = (meta or name.upper()).partition("|")[0] if is_placed else own
        if isinstance(field.kind, Paths):
            parser.add_argument(name, nargs="*" if name == placed else "+", metavar=meta, help=field.meaning)
        elif is_required and field.flag:
            parser.add_argument(
                *flags, dest=name, required=True, metavar=meta, type=of_kind(field.kind), help=text
            )
        elif is_required:
            parser.add_argument(name, metavar=meta, type=of_kind(field.kind), help=field.meaning)
        elif name == placed:
            parser.add_argument(name, nargs="?", metavar=meta, type=of_kind(field.kind), help=field.meaning)
        elif isinstance(field.kind, Flag):
            either = argparse.BooleanOptionalAction if field.may_be_none else "store_true"
            parser.add_argument(*flags, dest=name, action=either, help=field.meaning)
        elif isinstance(field.kind, Choice):
            parser.add_argument(*flags, dest=name, choices=field.kind.words, default=field.default, help=text)
        elif field.default == ():
            parser.add_argument(*flags, dest=name, action="append", default=[], metavar=meta, help=text)
        else:
            kind, default = of_kind(field.kind), field.default
            parser.add_argument(*flags, dest=name, type=kind, default=default, metavar=meta, help=text)


def add_run(parser: argparse.ArgumentParser, ecu: str) -> None:
    """Add the flags of a run, in real time by default, of its page and of what is printed."""
    names = [each.name for each in fields_of(RunRequest) if each.name != "trace"]
    add_flags(parser, RunRequest, *names, ecu=ecu, clock="realtime")
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    parser.add_argument(
        "--dashboard",
        action="store_true",
        help="serve the operator's page of this run, see liftgate-hil dashboard",
    )
    add_listen(parser, None)


def wire_choice(args: argparse.Namespace) -> WireChoice:
    """Return the choice of bus or line from its flags. Raises ConfigError."""
    return WireChoice.of(**given_in(args, WireChoice))


def run_request(args: argparse.Namespace) -> RunRequest:
    """Return the request of a run, as far as the command has its flags. Raises ConfigError.

    A module of an ECU may also be in the working directory.
    """
    return RunRequest.of(**{**given_in(args, RunRequest), "ecu": ecu_of(args)})


def given_in(args: argparse.Namespace, record: type[Record]) -> dict[str, Any]:
    """Return the values of a record's fields among the arguments."""
    return {each.name: getattr(args, each.name) for each in fields_of(record) if hasattr(args, each.name)}


def setup_of(args: argparse.Namespace) -> Setup:
    """Return the setup from the flags of a run. Raises ConfigError."""
    from liftgate_hil.plan.setup import setup_for

    return setup_for(SetupChoice.of(**given_in(args, SetupChoice)))


def ecu_of(args: argparse.Namespace) -> str:
    """Return the value of `--ecu`; its module may also be in the working directory."""
    if ":" in args.ecu:
        # Last, so that installed modules take precedence.
        sys.path.append(str(Path.cwd()))
    return str(args.ecu)


def add_listen(parser: argparse.ArgumentParser, default: str | None = LISTEN) -> None:
    """Add the flags for the address of the page, and for read-only access."""
    parser.add_argument(
        "--listen",
        default=default,
        metavar="HOST:PORT",
        help=f"address of the page; port 0: any free port; default: {LISTEN}",
    )
    parser.add_argument("--read-only", action="store_true", help="the page cannot send commands")


def address_of(text: str) -> tuple[str, int]:
    """Return host and port of HOST:PORT. Raises ConfigError."""
    from liftgate_hil.errors import ConfigError

    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not host or not (port.isascii() and port.isdecimal()) or int(port) > 65535:
        raise ConfigError(f"`listen` {text}: allowed: HOST:PORT, such as {LISTEN}; port 0 to 65535")
    return host, int(port)
