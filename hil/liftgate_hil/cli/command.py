"""Flags made from requests, the call of a command, and exit codes, for all subcommands."""

from __future__ import annotations

import argparse
import contextlib
import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from liftgate_hil.config.described import REQUIRED, Record, fields_of, signature_of
from liftgate_hil.config.kinds import Choice, Flag, Kind, Number, Paths, Whole
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.judging.verdict import ERROR, FAIL, GIVEN_UP, INCONCLUSIVE, PASS, STOPPED

if TYPE_CHECKING:
    from liftgate_hil.described_result import DescribedResult

    Made = TypeVar("Made", bound=DescribedResult)

EXIT_CODES = {PASS: 0, FAIL: 1, ERROR: 2, INCONCLUSIVE: 3}  # of verdicts; that of a stop is in `stopping`
# Of a run, which reports on the bench, not on the ECU.
RUN_EXIT_CODES = {PASS: 0, FAIL: 0, ERROR: 1, INCONCLUSIVE: 0, GIVEN_UP: 3, STOPPED: 0}
DEMO_EXIT_CODES = {PASS: 0, FAIL: 1, ERROR: 1, INCONCLUSIVE: 3, GIVEN_UP: 3}
_PARSERS: Mapping[type, Callable[[str], Any]] = {Number: float, Whole: int}
_ARGUMENT = re.compile(r"`([a-z][a-z_]*)`")
Asked = TypeVar("Asked", bound=Record)
_FLAGS: dict[str, str] = {}  # of the command whose flags were added last, by the names of their arguments


def forget_flags() -> None:
    """Clear the table of flag names before the flags of another command are added."""
    _FLAGS.clear()


def as_flags(text: str) -> str:
    """Return a message of the API with its argument names, `so_named`, replaced by the flags: --so-named."""
    return _ARGUMENT.sub(lambda match: _FLAGS.get(match[1], "--" + match[1].replace("_", "-")), text)


def of_kind(kind: Kind) -> Callable[[str], Any]:
    """Return an argparse type: a function that converts a text to a value of a kind, or refuses the text."""

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


def add_flags(
    parser: argparse.ArgumentParser, record: type[Record], *names: str, placed: str = "", **defaults: Any
) -> None:
    """Add a flag, or where required a positional argument, for fields of a record; `defaults` replace theirs.

    Without names all fields get theirs. The field `placed` is an argument, too, which may be left out. What is
    required and says how its flag is called is a flag nevertheless. A field without a meaning is not in the help.
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
        text = text if field.meaning else argparse.SUPPRESS
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


def add_printed(parser: argparse.ArgumentParser, quiet: str = "no messages but errors", json: str = "") -> None:
    """Add `--quiet`, and `--json` if `json` has a help text."""
    parser.add_argument("--quiet", action="store_true", help=quiet)
    if json:
        parser.add_argument("--json", action="store_true", help=json)


class Call(NamedTuple):
    """Call of a command: the values of its flags, its command line, and whether it owns the process."""

    values: Mapping[str, Any]
    owns_process: bool = False  # the program was started for it
    command_line: str = ""

    @property
    def is_quiet(self) -> bool:
        """Whether nothing but errors is printed."""
        return bool(self.values.get("quiet"))

    @property
    def is_json(self) -> bool:
        """Whether JSON is printed in place of texts."""
        return bool(self.values.get("json"))

    def request(self, record: type[Asked]) -> Asked:
        """Return a validated record made from the flags of the same names as its fields. Raises ConfigError."""
        return self.unchecked(record).validated()

    def unchecked(self, record: type[Asked]) -> Asked:
        """Return a record made from the flags of the same names, not validated: the caller reports the issues."""
        names = [each.name for each in fields_of(record) if each.name in self.values]
        return record(**{name: self.values[name] for name in names})

    def deliver(self, result: Made, text: Callable[[Made], str], issues: Sequence[str] = ()) -> None:
        """Print a result as `text(result)`, as JSON or not at all. Raises ConfigError with `issues`, if any."""
        if self.is_json:
            print(result.to_json(), flush=True)
        elif not self.is_quiet:
            print(text(result), flush=True)
        if issues:
            raise ConfigError(list(issues))
