"""`--help` of each command: its usage line, its flags grouped by subject, and examples that are valid."""

from __future__ import annotations

import argparse
import shlex

import pytest

from liftgate_hil.cli.examples import EXAMPLES
from liftgate_hil.cli.help import subject_of
from liftgate_hil.cli.main import COMMANDS, main, whole_parser


def helped(capsys: pytest.CaptureFixture[str], name: str) -> str:
    assert main([name, "--help"]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("name", COMMANDS)
def test_a_help_text_begins_with_usage_and_ends_with_examples(
    capsys: pytest.CaptureFixture[str], name: str
) -> None:
    text = helped(capsys, name)
    assert len(text.splitlines()[0]) < 100
    examples = text.partition("\nexamples:\n")[2].splitlines()
    assert examples == [f"  {each}" for each in EXAMPLES[name]]
    assert len(examples) >= 3


def test_flags_are_grouped_by_subject(capsys: pytest.CaptureFixture[str]) -> None:
    text = helped(capsys, "judge")
    assert text.startswith("usage: liftgate-hil judge RECORDING [RECORDING ...] --scenario NAME|FILE [FLAGS]\n")
    subjects = [line.removesuffix(":") for line in text.splitlines() if line.endswith(":") and line[0] != " "]
    assert subjects[0] == "what it needs"
    assert subjects[-2:] == ["others", "examples"]
    assert {"bus", "vehicle", "files that are read", "results"} < set(subjects)


def test_every_flag_has_a_subject() -> None:
    found = next(each for each in whole_parser()._actions if isinstance(each, argparse._SubParsersAction))
    for name, parser in found.choices.items():
        shown = [each for each in parser._actions if each.help != argparse.SUPPRESS]
        flags = {each.dest: subject_of(each) for each in shown if each.option_strings and not each.required}
        assert {each for each, subject in flags.items() if not subject} <= {"help", "version"}, name


@pytest.mark.parametrize("example", [each for examples in EXAMPLES.values() for each in examples])
def test_every_example_is_accepted_by_the_parser(example: str) -> None:
    words = shlex.split(example, comments=True)
    words = words[words.index("liftgate-hil") + 1 :]
    if ">" in words:
        words = words[: words.index(">")]
    whole_parser().parse_args(words)
