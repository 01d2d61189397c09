"""`--help` of each command: its usage line, its flags grouped by subject, and examples that are valid."""

from __future__ import annotations

import argparse
import re
import shlex

import pytest

from liftgate_hil.cli.commands import COMMANDS
from liftgate_hil.cli.help import Formatter, arrange
from liftgate_hil.cli.main import main, whole_parser


def helped(capsys: pytest.CaptureFixture[str], name: str) -> str:
    assert main([name, "--help"]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("name", COMMANDS)
def test_a_help_text_begins_with_usage_and_ends_with_examples(
    capsys: pytest.CaptureFixture[str], name: str
) -> None:
    text = helped(capsys, name)
    assert text.startswith("usage: liftgate-hil")
    assert len(text.splitlines()[0]) < 100
    examples = text.partition("\nexamples:\n")[2].splitlines()
    assert examples == [f"  {each}" for each in COMMANDS[name].examples]
    assert len(examples) >= 3


def test_flags_are_grouped_by_subject(capsys: pytest.CaptureFixture[str]) -> None:
    text = helped(capsys, "judge")
    assert text.startswith("usage: liftgate-hil judge RECORDING [RECORDING ...] --scenario NAME|FILE [FLAGS]\n")
    subjects = [line.removesuffix(":") for line in text.splitlines() if line.endswith(":") and line[0] != " "]
    assert subjects[0] == "what it needs"
    assert subjects[-2:] == ["others", "examples"]
    assert {"bus", "vehicle", "files that are read", "results"} < set(subjects)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_and_version_are_the_only_flags_without_a_subject(
    capsys: pytest.CaptureFixture[str], name: str
) -> None:
    others = helped(capsys, name).partition("\nothers:\n")[2].partition("\n\n")[0]
    assert re.findall("^  (-[^ ]+)", others, re.MULTILINE) == ["-h,", "--version"]


def test_a_flag_without_a_group_is_listed_in_the_group_of_the_flag_before_it() -> None:
    parser = argparse.ArgumentParser(prog="any", formatter_class=Formatter)
    for flag in ("--vehicle", "--new", "--output"):
        parser.add_argument(flag, metavar="X", help="what it is")
    arrange(parser, ())
    shown = parser.format_help()
    assert "\nvehicle:\n  --vehicle X " in shown
    assert shown.index("  --vehicle X ") < shown.index("  --new X ") < shown.index("\nresults:\n  --output X ")


@pytest.mark.parametrize("example", [each for command in COMMANDS.values() for each in command.examples])
def test_every_example_is_accepted_by_the_parser(example: str) -> None:
    words = shlex.split(example, comments=True)
    words = words[words.index("liftgate-hil") + 1 :]
    if ">" in words:
        words = words[: words.index(">")]
    whole_parser().parse_args(words)
