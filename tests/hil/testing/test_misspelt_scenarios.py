"""A scenario with misspelt expectations is an error and is not silently left out."""

from __future__ import annotations

from pathlib import Path

import pytest

from liftgate_hil.cli.main import main

GOOD = 'duration = 1.0\n[[expect]]\nname = "x"\nalways = "time_s >= 0"\n'
BAD = 'duration = 1.0\n[[request]]\ntime = 0.1\naction = "open"\n'
EXPECT = '\nname = "x"\nalways = "time_s >= 0"\n'


@pytest.mark.parametrize(
    "header", ["[[expects]]", "[[Expect]]", "[[expectation]]", "[[expcet]]", "[[expect]", "[expect]"]
)
def test_a_misspelt_header_is_reported(tmp_path: Path, header: str, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "good.toml").write_text(GOOD)
    (tmp_path / "bad.toml").write_text(BAD + header + EXPECT)
    assert main(["test", str(tmp_path)]) == 2
    assert "bad.toml" in capsys.readouterr().err


def test_a_misspelt_header_without_other_tables_is_reported_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "good.toml").write_text(GOOD)
    (tmp_path / "bad.toml").write_text("duration = 1.0\n[[expct]]" + EXPECT)
    assert main(["test", str(tmp_path)]) == 2
    assert "bad.toml: expct: unknown key; allowed: expect" in capsys.readouterr().err


def test_a_file_that_is_no_toml_is_left_out_with_a_note(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "good.toml").write_text(GOOD)
    (tmp_path / "bad.toml").write_text("duration = \n")
    assert main(["test", str(tmp_path)]) == 0
    assert f"note: left out: {tmp_path}/bad.toml: not valid TOML: " in capsys.readouterr().err


def test_other_tools_files_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "good.toml").write_text(GOOD)
    (tmp_path / "pyproject.toml").write_text('[tool.x]\nexpect = "y"\n')
    (tmp_path / "other.toml").write_text('expectations = 3\nduration = "long"\n')
    assert main(["test", str(tmp_path)]) == 0
