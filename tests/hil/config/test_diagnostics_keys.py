"""Keys of trouble codes in scenarios and of [diagnostics] in rigs: allowed values, and all issues at once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hil_support import issues_of, text_file

from liftgate_hil.cli.main import main
from liftgate_hil.codec.frames import EXTENDED
from liftgate_hil.config.rig import load_rig
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.config.shipped import find_config
from liftgate_hil.diagnostics.tester import Diagnostics
from liftgate_hil.errors import ConfigError
from liftgate_hil.judging.expectation import Expectation


def expect(folder: Path, text: str) -> Path:
    return text_file(folder / "stimuli.toml", f'duration = 1.0\n[[expect]]\nname = "x"\n{text}\n')


def check_issues(load: Callable[[Path], object], path: Path, prefix: str, expected: list[str]) -> None:
    """Check that a file has these issues and no others, each after this prefix."""
    told = [line.removeprefix(prefix) for line in issues_of(load, path)]
    assert len(told) == len(expected), told
    assert all(line.startswith(issue) for line, issue in zip(told, expected, strict=True)), told


def test_an_expectation_may_want_a_trouble_code_present_or_absent(tmp_path: Path) -> None:
    path = expect(tmp_path, 'dtc = "B1A01-62"\nstate = "absent"\nafter = 2\nwithin_s = 0.5')
    (found,) = load_scenario(path).expectations
    assert found == Expectation("x", "dtc", "B1A01-62", 2.0, 0.5, 0.0, "expect[0]", "absent")
    assert found.is_always
    (other,) = load_scenario(expect(tmp_path, 'dtc = "U0100"\nstate = "present"')).expectations
    assert not other.is_always


_CODES = "five characters such as B1A01 (P, C, B or U, a digit of 0 to 3, three hexadecimal ones)"
_STATES = "one of present, absent"


@pytest.mark.parametrize(
    ("text", "issues"),
    [
        ('dtc = "B1A01"', [f"expect[0].state: missing; allowed: {_STATES}"]),
        ('dtc = "B1A01"\nstate = "stored"', [f"expect[0].state: 'stored'; allowed: {_STATES}"]),
        ('dtc = "1234"\nstate = "there"',
         [f"expect[0].dtc: '1234'; allowed: {_CODES}", f"expect[0].state: 'there'; allowed: {_STATES}"]),
        ('dtc = 1234\nstate = "present"', [f"expect[0].dtc: 1234; allowed: {_CODES}"]),
        ('dtc = "B1A01"\nstate = "present"\nfor_s = 0.1', ["expect[0].for_s: 0.1; allowed: with eventually"]),
        ('dtc = "B1A01"\nstate = "present"\nnever = "time_s > 3"',
         ["expect[0]: never and dtc; allowed: one of always, eventually, never, dtc"]),
        ('never = "time_s > 3"\nstate = "present"', ["expect[0].state: 'present'; allowed: with dtc"]),
        ('state = "present"', ["expect[0]: nothing; allowed: one of always, eventually, never, dtc"]),
    ],
)  # fmt: skip
def test_invalid_keys_of_a_code_expectation_are_reported(tmp_path: Path, text: str, issues: list[str]) -> None:
    path = expect(tmp_path, text)
    check_issues(load_scenario, path, f"{path}: ", issues)


def rig(folder: Path, diagnostics: str) -> Path:
    text = find_config("rigs", "liftgate").read_text().split("[diagnostics]")[0]
    return text_file(folder / "rig.toml", f"{text}[diagnostics]\n{diagnostics}\n")


def test_diagnostic_identifiers_are_message_names_or_numbers(tmp_path: Path) -> None:
    named = load_rig(rig(tmp_path, 'request = "GateTestRequest"\nresponse = "GateTestResponse"'))
    names = ("GateTestRequest", "GateTestResponse")
    assert named.diagnostics == Diagnostics(0x7A0, 0x7A8, names=names)
    assert load_rig(find_config("rigs", "liftgate")).diagnostics == named.diagnostics
    given = rig(
        tmp_path,
        'request = 0x7E0\nresponse = 0x18DAF140\npadding = "none"\ncycle_ms = 20\ntimeout_ms = 150\n'
        "status_mask = 0x2F\nclear = false",
    )
    assert load_rig(given).diagnostics == Diagnostics(
        0x7E0, 0x18DAF140 | EXTENDED, -1, 0.02, 0.15, 0x2F, clears=False
    )


_WHO = "a message of the database, or an identifier, 0 to 536870911, above 0x7FF an extended one"


@pytest.mark.parametrize(
    ("text", "issues"),
    [
        ("", [f"request: missing; allowed: {_WHO}", f"response: missing; allowed: {_WHO}"]),
        ('request = "Nobody"\nresponse = -1',
         [f"response: -1; allowed: {_WHO}", f"request: 'Nobody': no such message; allowed: {_WHO}"]),
        ("request = 1e3\nresponse = true",
         [f"request: 1000.0; allowed: {_WHO}", f"response: True; allowed: {_WHO}"]),
        ("request = 0x20000000\nresponse = 0x7A8", [f"request: 536870912; allowed: {_WHO}"]),
        ("request = 0x7A8\nresponse = 0x7A8",
         ["response: 1960; allowed: an identifier other than that of request"]),
        ('request = 0x120\nresponse = "Gate"',
         ["request: 288: DriveCommand carries quantities; allowed: an identifier of its own",
          "response: 'Gate': Gate carries quantities; allowed: an identifier of its own"]),
        ("request = 1\nresponse = 2\npadding = 256\ncycle_ms = 0\ntimeout_ms = 1e9\nstatus_mask = 0\nclear = 1\n"
         "foo = 1",
         ["foo: 1: unknown key", 'padding: 256; allowed: a byte, 0 to 255, or "none"', "cycle_ms: 0",
          "timeout_ms: 1000000000.0",
          "status_mask: 0; allowed: a whole number from 1 to 255", "clear: 1; allowed: true or false"]),
    ],
)  # fmt: skip
def test_invalid_diagnostics_keys_are_reported(tmp_path: Path, text: str, issues: list[str]) -> None:
    path = rig(tmp_path, text)
    check_issues(load_rig, path, f"{path}: diagnostics.", issues)


def test_diagnostics_that_is_no_table_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    text = find_config("rigs", "liftgate").read_text().split("[diagnostics]")[0]
    path.write_text(text.replace("\n[inputs]", "\ndiagnostics = 5\n[inputs]"))
    with pytest.raises(ConfigError, match=r"diagnostics: 5; allowed: a table"):
        load_rig(path)


def test_rig_check_lists_the_diagnostic_identifiers_and_timing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rig", "check", "liftgate"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("diag")]
    assert line == (
        "diagnostics: request GateTestRequest 0x7A0, response GateTestResponse 0x7A8; cleared at time 0, read "
        "every 100 ms by the status mask 0x09"
    )
    assert main(["rig", "check", "liftgate", "--json"]) == 0
    assert '"response": 1960' in capsys.readouterr().out
