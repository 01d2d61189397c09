"""Look-up of MESSAGE.SIGNAL, and the messages for unknown names."""

from __future__ import annotations

import pytest
from cantools.database import Message, load_string

from liftgate_hil.codec.messages import Messages
from liftgate_hil.config.signal_name import find_signal
from liftgate_hil.errors import ConfigIssues

DATABASE = """VERSION ""
BS_:
BU_: ECU
BO_ 256 Body: 8 ECU
 SG_ Speed : 0|16@1+ (1,0) [0|0] "km/h" ECU
 SG_ Alive : 16|4@1+ (1,0) [0|15] "" ECU
BO_ 257 Axle: 8 ECU
 SG_ Load : 0|16@1+ (1,0) [0|0] "N" ECU
"""
MESSAGES = Messages(load_string(DATABASE, "dbc").messages)


def issue_with(name: str, **more: list[str]) -> str:
    issues = ConfigIssues("file")
    assert find_signal(issues, "key", name, MESSAGES, **more) is None
    (issue,) = issues.lines
    return issue.removeprefix("file: key: ")


def test_a_signal_is_found_by_its_name():
    issues = ConfigIssues("file")
    signal = find_signal(issues, "key", "Body.Speed", MESSAGES)
    assert signal is MESSAGES["Body"].get_signal_by_name("Speed")
    assert issues.count == 0


@pytest.mark.parametrize("name", ["Nope.Speed", "body.Speed", ".Speed", "."])
def test_an_unknown_message_is_reported_with_the_existing_ones(name: str):
    assert issue_with(name) == f"'{name}': no such message; allowed: MESSAGE.SIGNAL of Axle, Body"


@pytest.mark.parametrize("name", ["Body.Nope", "Body.speed", "Body.", "Body", "Body.Speed.x"])
def test_an_unknown_signal_is_reported_with_those_of_its_message(name: str):
    assert issue_with(name) == f"'{name}': no such signal; allowed: Body.{{Speed, Alive}}"


def test_suggestions_omit_messages_and_signals_not_available_to_the_caller():
    said = issue_with("Nope.X", offered=["Body"])
    assert said.endswith("no such message; allowed: MESSAGE.SIGNAL of Body")
    assert issue_with("Nope.X", offered=[]).endswith("MESSAGE.SIGNAL of none")
    assert issue_with("Body.X", left_out=["Alive"]).endswith("allowed: Body.{Speed}")


def test_at_most_twenty_existing_messages_are_listed():
    many = Messages(Message(number, f"M{number:02}", 8, []) for number in range(23))
    issues = ConfigIssues("file")
    find_signal(issues, "key", "X.Y", many)
    assert issues.lines[0].endswith("M17, M18, M19 and 3 more")
