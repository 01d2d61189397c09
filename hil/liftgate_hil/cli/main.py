"""`liftgate-hil`: which subcommand, and how errors leave it. Each subcommand is a file beside this one."""

from __future__ import annotations

import argparse
import contextlib
import errno
import functools
import importlib
import itertools
import shlex
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from liftgate_hil.cli import stopping
from liftgate_hil.cli.command import Call, as_flags, forget_flags
from liftgate_hil.cli.commands import COMMANDS
from liftgate_hil.cli.help import Formatter, arrange
from liftgate_hil.cli.terminal import streams
from liftgate_hil.errors import ConfigError, LiftgateError, allowed_names, causes

_WORDS = {"help": "this text, or that of a subcommand: help test", "version": "the version"}
_JUDGING = ("judge", "test")  # commands whose exit code 1 is a verdict
# What a call without any argument prints.
_FIRST_STEPS = (
    "liftgate-hil: --bus: missing; to see the gate move: liftgate-hil demo",
    "to play with it on a page: liftgate-hil --ecu reference --dashboard",
    "to test an ECU: liftgate-hil init my-gate",
    "to connect a bus: liftgate-hil --bus socketcan:can0",
    "all commands and flags: liftgate-hil help",
)
# Flags that other tools have, and what is typed here instead.
_ELSEWHERE = {
    "--fault": "faults are [[fault]] of a scenario, or injected on the page of a run (--dashboard); "
    "liftgate-hil list pack names scenarios with faults"
}


class Parser(argparse.ArgumentParser):
    """Parser that reports an error in one clear line instead of the whole usage."""

    on_error: Callable[[str], None] | None = None  # called with an error before it is printed

    def error(self, message: str) -> NoReturn:
        """Pass the usage error to `on_error`, if set, print it, and exit with code 2."""
        start, _, unknown = message.partition("unrecognized arguments: ")
        if not start and unknown.startswith("-"):
            flag = unknown.split()[0].partition("=")[0]
            message += f"; {_ELSEWHERE.get(flag) or f'allowed: {allowed_names(flag, self._flags())}'}"
        if self.on_error is not None:
            self.on_error(message)
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")

    def _flags(self) -> list[str]:
        """Return the flags of the command and of its actions, such as `rig check`."""
        nested = [each.choices.values() for each in self._actions if isinstance(each, argparse._SubParsersAction)]
        parsers = [self, *itertools.chain.from_iterable(nested)]
        found = itertools.chain.from_iterable(each._option_string_actions.items() for each in parsers)
        return list(dict.fromkeys(flag for flag, action in found if action.help != argparse.SUPPRESS))


class ShowVersion(argparse.Action):
    """Action of `--version`, which looks the version up only on request, as that doubles the start time."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """Print the version and exit with code 0."""
        from liftgate_hil.version import version

        print(f"liftgate-hil {version()}")
        parser.exit()


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line; return 0: done, 1: failed, 2: misuse, unjudged, 3: inconclusive, 128 + signal."""
    if argv is None:  # the program owns this process
        streams.buffer_stdout()
    streams.prepare()
    try:
        if argv is None:
            streams.hold_descriptors()
            signal.signal(signal.SIGINT, stopping.interrupt)
        code = _command(argv)
        fault = streams.written()
    except SystemExit as leaving:  # argparse has printed why
        code, fault = int(leaving.code or 0), streams.written()
    except KeyboardInterrupt:  # before there was anything to shut down
        return 130
    except BrokenPipeError:  # the reader of the output has gone
        streams.abandon(sys.stdout)
        return _error_code(argv)
    except OSError as error:
        code, fault = _error_code(argv), streams.written() or _fault_of(error)
    except MemoryError:
        code, fault = _error_code(argv), "not enough memory"
    if fault:
        streams.say(f"liftgate-hil: {fault}")
        return code or _error_code(argv)
    return code


def _error_code(argv: Sequence[str] | None) -> int:
    """Return the exit code for errors of a command: 2 where its code 1 means a failed expectation, else 1."""
    arguments = sys.argv[1:] if argv is None else argv
    return 2 if arguments and arguments[0] in _JUDGING else 1


def _command(argv: Sequence[str] | None) -> int:
    """Parse the command line, run the subcommand and return the exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    is_bare = not arguments
    if arguments[:1] == ["help"]:
        arguments = [*arguments[1:2], "--help"]
    elif arguments == ["version"]:
        arguments = ["--version"]
    is_named = bool(arguments) and arguments[0] in COMMANDS
    name = arguments.pop(0) if is_named else "run"
    module = importlib.import_module(f"liftgate_hil.cli.{name}")
    parser = Parser(
        prog="liftgate-hil" if name == "run" else f"liftgate-hil {name}",
        description=module.__doc__,
        formatter_class=Formatter,
        allow_abbrev=False,
    )
    forget_flags()
    _add_arguments(parser, module)
    words = {**{each: command.summary for each, command in COMMANDS.items()}, **_WORDS}
    lines = [f"  {each:<10} {text}" for each, text in words.items()]
    overview = "subcommands (each with its own --help):\n" + "\n".join(lines)
    arrange(parser, COMMANDS[name].examples, overview if name == "run" else "")
    if name in _JUDGING:
        parser.on_error = functools.partial(_report_flags, arguments)
    if name == "run" and arguments and not arguments[0].startswith("-"):
        if is_named:
            parser.error(
                f"unexpected argument {arguments[0]!r}; allowed: flags, for example --scenario {arguments[0]}"
            )
        allowed = allowed_names(arguments[0], [*COMMANDS, *_WORDS])
        parser.error(f"no subcommand {arguments[0]!r}; allowed: {allowed}")
    values = vars(parser.parse_args(arguments))
    if ":" in str(values.get("ecu")):
        sys.path.append(str(Path.cwd()))  # last, so that installed modules take precedence over a user's own
    whole_line = shlex.join(["liftgate-hil", *(sys.argv[1:] if argv is None else argv)])
    return _run(module, Call(values, argv is None, whole_line), is_bare, _error_code(argv))


def _run(module: ModuleType, call: Call, is_bare: bool, error_code: int) -> int:
    """Run a subcommand and return the exit code; errors that it raises are printed."""
    try:
        return int(module.run(call))
    except ConfigError as error:
        is_lost = is_bare and error.issues[0].startswith("`bus`: missing")
        issues = [f"liftgate-hil: {as_flags(fault)}" for fault in error.issues]
        for line in _FIRST_STEPS if is_lost else issues:
            streams.say(line)
        return 2
    except LiftgateError as error:
        for text in causes(error):
            streams.say(f"liftgate-hil: {as_flags(text)}")
        if isinstance(error, stopping.StoppedError):
            return error.exit_code
        return error_code
    except RuntimeError as error:
        from liftgate_compiler import CompileError

        if not isinstance(error, CompileError):
            raise
        streams.say(f"liftgate-hil: {error}")
        return error_code


def _report_flags(arguments: Sequence[str], message: str) -> None:
    """Write an error in parsing the flags into the reports that the flags request."""
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
        targets = report_files.targets_of(ReportsChoice(**vars(args)), as_flags, streams.say)
        with report_files.reporting_issues(targets, as_flags, streams.say):
            report_files.refuse_inputs(targets, others)
            raise ConfigError(message)


def _fault_of(error: OSError) -> str:
    """Return the reason and the file of an operating-system error, on one line."""
    if error.errno in (errno.EMFILE, errno.ENFILE):  # the file that was opened last is not the cause
        return f"{error.strerror}; allowed: a limit of 64 or more (ulimit -n)"
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror or error}"


def whole_parser() -> Parser:
    """Return one parser of all subcommands and flags; `main` loads only the requested subcommand."""
    root = Parser(prog="liftgate-hil")
    subcommands = root.add_subparsers()
    for name, command in COMMANDS.items():
        module = importlib.import_module(f"liftgate_hil.cli.{name}")
        _add_arguments(subcommands.add_parser(name, help=command.summary), module)
        if name == "run":
            _add_arguments(root, module)
    return root


def _add_arguments(parser: argparse.ArgumentParser, module: ModuleType) -> None:
    """Add the flags of a subcommand's module, and `--version`."""
    parser.add_argument("--version", action=ShowVersion, nargs=0, help="print the version and exit")
    module.add_arguments(parser)


if __name__ == "__main__":
    sys.exit(main())
