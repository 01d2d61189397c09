"""Page docs/command-line.md: every subcommand with its flags, from the parsers that read them."""

from __future__ import annotations

import argparse
import importlib
import re

from liftgate_hil.cli.command import DEMO_EXIT_CODES, EXIT_CODES, RUN_EXIT_CODES
from liftgate_hil.cli.commands import COMMANDS
from liftgate_hil.cli.main import whole_parser
from liftgate_hil.judging.verdict import ERROR, FAIL, INCONCLUSIVE, PASS
from tools.docs.markdown import code, page, table

_INTRO = """\
`liftgate-hil SUBCOMMAND FLAGS`; without a subcommand it is `run`. Each has its own `--help`, and `completion`
makes bash, zsh or fish complete subcommands, flags and names. Flags are not abbreviated."""

_CODES = (
    ("0", "done; of `campaign`: complete, whatever its verdicts"),
    (
        "1",
        "failed: a bus, a device or a file failed while it ran; `compare`, `campaign --replay`: not equal; "
        "`doctor`: a problem; `replay`: frames were not sent",
    ),
    ("2", "wrong usage: a flag, a file or a value is not allowed, with one message for each; nothing was begun"),
    ("3", "inconclusive: the bench, not the ECU, has decided or ended the run; see the table below"),
    (
        "130, 143",
        "stopped by Ctrl-C, by SIGTERM before it was complete; a second signal ends it at once. `run`, `ecu` and "
        "`dashboard` run until they are stopped: 0",
    ),
)
_VERDICTS = """\
The worst verdict of a command that judges decides, in the order error, fail, inconclusive, pass. `run` and `demo`
report on the bench: with `run --scenario` a failed or undecided expectation is no failure of the bench; `test`
judges. 3 is also the code of a run that the bench has ended early, such as for a precondition not reached."""
_WORST = (ERROR, FAIL, INCONCLUSIVE, PASS)
_JUDGES = {"`test`, `judge`": EXIT_CODES, "`demo`": DEMO_EXIT_CODES, "`run`": RUN_EXIT_CODES}


def command_line_page() -> str:
    """Return the text of the page."""
    found = next(each for each in whole_parser()._actions if isinstance(each, argparse._SubParsersAction))
    rows = [(name, *(str(codes[verdict]) for verdict in _WORST)) for name, codes in _JUDGES.items()]
    return page(
        "Command line",
        _INTRO,
        table(
            ["subcommand", "what it does"], [(code(name), command.summary) for name, command in COMMANDS.items()]
        ),
        "## Exit codes",
        table(["code", "meaning"], _CODES),
        _VERDICTS,
        table(["worst verdict", *map(str, _WORST)], rows),
        *(part for name, parser in found.choices.items() for part in _subcommand(name, parser)),
    )


def _subcommand(name: str, parser: argparse.ArgumentParser) -> list[str]:
    """Return the section of a subcommand."""
    module = importlib.import_module(f"liftgate_hil.cli.{name}")
    flags = [each for each in parser._actions if each.help != argparse.SUPPRESS and not _is_common(each)]
    rows = [(_name_of(each), _words(each)) for each in flags]
    examples = "\n".join(["```text", *COMMANDS[name].examples, "```"])
    return [f"## {name}", *_paragraphs(module.__doc__ or ""), examples, table(["argument", "meaning"], rows)]


def _is_common(action: argparse.Action) -> bool:
    return bool({"-h", "--version"} & set(action.option_strings))


def _name_of(action: argparse.Action) -> str:
    """Return an argument as it is written, with what follows it."""
    value = ""
    if action.nargs != 0:
        names = "|".join(map(str, action.choices)) if action.choices else None
        metavar = action.metavar if isinstance(action.metavar, str) else None
        value = metavar or names or action.dest.upper()
    if not action.option_strings:
        return code(value)
    return ", ".join(code(f"{each} {value}".strip()) for each in action.option_strings)


def _words(action: argparse.Action) -> str:
    text = (action.help or "").replace("%%", "%").replace("%(default)s", str(action.default))
    return re.sub(r"(?<![`\w-])(--[a-z][a-z-]*)", r"`\1`", text).replace("<", "&lt;")


def _paragraphs(text: str) -> list[str]:
    """Return the parts of a module's docstring: its examples as a block, which is no Markdown."""
    found = []
    for part in text.strip().split("\n\n"):
        lines = [line.strip() for line in part.splitlines()]
        if all(line.startswith("liftgate-hil") for line in lines):
            found.append("```text\n" + "\n".join(lines) + "\n```")
        elif part.startswith("  "):
            found.append("```text\n" + part + "\n```")
        else:
            found.append("\n".join(lines).replace("<", "&lt;"))
    return found
