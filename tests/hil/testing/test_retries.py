"""Inconclusive scenarios are run again, up to the requested number of times."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import pytest

from liftgate_hil.cli.main import main
from liftgate_hil.judging.verdict import Verdict
from liftgate_hil.testing import suite
from liftgate_hil.testing.outcome import Case, Outcome

SCENARIO = 'duration = 0.1\n[[expect]]\nname = "rests"\nalways = "gate_angle_deg < 1"\n'


@pytest.fixture
def attempts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """List that the test fills with the verdicts of the next runs; each run takes the first one from it."""
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(SCENARIO)
    verdicts: list[str] = []
    ours = suite.run_case

    def run_case(case: Case, stopped: object = None) -> Outcome:
        outcome, verdict = ours(case), verdicts.pop(0)
        found = Verdict("rests", verdict, reason=f"it was {verdict}")
        return suite.replace(outcome, verdict=verdict, expectations=(found,))

    monkeypatch.setattr(suite, "run_case", run_case)
    return verdicts


@pytest.mark.parametrize(
    ("given", "retries", "code", "left"),
    [
        (["inconclusive", "pass"], 2, 0, 0),
        (["inconclusive", "inconclusive", "pass"], 1, 3, 1),
        (["inconclusive", "fail", "pass"], 5, 1, 1),  # a fail counts
        (["inconclusive", "error", "pass"], 5, 2, 1),
        (["fail", "pass"], 5, 1, 1),
        (["inconclusive", "pass"], 0, 3, 1),
    ],
)
def test_an_inconclusive_scenario_is_run_again_until_decided(
    attempts: list[str], given: list[str], retries: int, code: int, left: int
) -> None:
    attempts += given
    line = ["test", "s.toml", "--quiet", "--json", "out.json", "--junit", "out.xml"]
    line += ["--results", "results"]
    assert main([*line, "--retry-inconclusive", str(retries)]) == code
    assert len(attempts) == left
    told = json.loads(Path("out.json").read_text())["scenarios"][0]
    tried = given[: len(given) - left]
    assert [each["verdict"] for each in told["attempts"]] == tried[:-1]
    assert told["verdict"] == tried[-1]
    # Each attempt has left its recordings.
    kept = [each["recordings"] for each in told["attempts"]]
    files = {path for each in (*kept, told["recordings"]) for path in each}
    assert len(files) == 2 * len(tried)
    assert all(Path(path).stat().st_size > 100 for path in files)
    assert {str(Path(each).resolve()) for each in files} == {
        str(each.resolve()) for each in Path("results").iterdir() if each.suffix in (".csv", ".log")
    }
    for number in range(1, len(tried)):
        note = f"attempt {number}: rests: inconclusive: it was inconclusive"
        assert note in told["notes"]
        assert note in Path("out.xml").read_text()


def test_a_negative_number_of_retries_is_refused(attempts: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["test", "s.toml", "--retry-inconclusive", "-1"]) == 2
    assert "--retry-inconclusive" in capsys.readouterr().err


def test_an_attempt_whose_recordings_cannot_be_kept_is_reported(
    attempts: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(path: Path, target: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(suite, "rename_new", refuse)
    attempts += ["inconclusive", "pass"]
    line = ["test", "s.toml", "--results", "results", "--retry-inconclusive", "1"]
    assert main(line) == 0
    told = capsys.readouterr().err
    assert "the recording of attempt 1 is not kept" in told
    assert "No space left on device" in told
