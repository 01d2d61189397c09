"""`liftgate-hil init`: a starter folder that works anywhere without changes."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from c_ecu import BARE_CANTOOLS, needs_compiler

from liftgate_hil.cli.main import main
from liftgate_hil.config import shipped
from liftgate_hil.config.rig import load_rig
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.config.starter import create_starter
from liftgate_hil.config.vehicle import load_vehicle
from liftgate_hil.errors import ConfigError


def contents(folder: Path) -> dict[str, bytes]:
    """Return the contents of every file under a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_folder_is_created_with_its_parents_and_every_file_is_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder = tmp_path / "some where" / "gate"
    assert main(["init", str(folder)]) == 0
    out = capsys.readouterr().out
    written = contents(folder)
    assert {"liftgate.dbc", "vehicle.toml", "rig.toml", "scenario.toml", "test_gate.py"} < set(written)
    assert {"ecu/Makefile", "ecu/ecu.c", "ecu/liftgate_serial.h"} < set(written)
    assert all(Path(name).name in out for name in written)
    assert f"cd {shlex.quote(str(folder))}" in out


def test_an_empty_folder_is_accepted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    assert main(["init", ".", "--quiet"]) == 0
    assert (tmp_path / "rig.toml").is_file()


def test_a_nonempty_folder_is_refused_and_unchanged(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "mine.txt").write_text("mine")
    assert main(["init", str(tmp_path)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == (
        f"liftgate-hil: {tmp_path}: is not empty; allowed: a new or an empty folder, or a git repository\n"
    )
    assert contents(tmp_path) == {"mine.txt": b"mine"}


def repository(folder: Path, **files: str) -> Path:
    """Make a fresh git repository with these files."""
    subprocess.run(["git", "init", "--quiet", str(folder)], check=True, timeout=60)
    for name, text in files.items():
        (folder / name.replace("__", ".")).write_text(text)
    return folder


def test_a_fresh_git_repository_is_filled_and_its_files_are_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder = repository(tmp_path / "r", README__md="mine", LICENSE="mine", __gitignore="mine")
    (folder / ".github/workflows").mkdir(parents=True)
    (folder / ".github/workflows/other.yml").write_text("mine")
    before = contents(folder)
    assert main(["init", str(folder)]) == 0
    after = contents(folder)
    assert before.items() <= after.items()
    assert {"rig.toml", "ecu/ecu.c", ".github/workflows/liftgate.yml", "LIFTGATE.md"} < {*after}
    assert "LIFTGATE.md" in capsys.readouterr().out
    assert b"liftgate-hil init" in after["LIFTGATE.md"]


def test_a_repository_without_a_readme_gets_one(tmp_path: Path):
    create_starter(repository(tmp_path))
    assert "make -C ecu" in (tmp_path / "README.md").read_text()
    assert not (tmp_path / "LIFTGATE.md").exists()


def test_files_that_would_be_overwritten_are_listed_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder = repository(tmp_path, rig__toml="mine", readme__rst="mine", LIFTGATE__md="mine")
    (folder / "ecu").mkdir()
    (folder / "ecu/ecu.c").write_text("mine")
    (folder / "test_gate.py").symlink_to("nowhere")
    (folder / ".github").write_text("a file")
    before = contents(folder)
    assert main(["init", str(folder)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == (
        f"liftgate-hil: {folder}: would overwrite rig.toml, test_gate.py, .github, LIFTGATE.md, ecu/ecu.c; "
        "allowed: a folder without them (nothing was written)\n"
    )
    assert contents(folder) == before
    assert {each.name for each in folder.iterdir()} == {
        ".git", ".github", "LIFTGATE.md", "ecu", "readme.rst", "rig.toml", "test_gate.py",
    }  # fmt: skip


def test_every_command_of_the_readme_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["init", str(tmp_path / "gate")]) == 0
    out = capsys.readouterr().out
    text = (tmp_path / "gate/README.md").read_text()
    steps = [line[4:] for line in text.splitlines() if line.startswith("    ")]
    assert len(steps) == 12
    for step in steps:
        _, _, arguments = step.partition("  ")[0].partition(" ")
        assert f" {arguments}" in out, step


@pytest.mark.parametrize(
    ("name", "said"), [("file", "is a file"), ("file/gate", "Not a directory"), ("x" * 300, "long")]
)
def test_an_impossible_folder_is_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, said: str
):
    (tmp_path / "file").write_text("")
    assert main(["init", str(tmp_path / name)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert str(tmp_path / name) in line
    assert said in line


def test_quiet_prints_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["init", str(tmp_path / "gate"), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_every_copied_file_is_valid_and_the_rig_uses_the_copied_database(tmp_path: Path):
    create_starter(tmp_path / "gate")
    assert load_rig(tmp_path / "gate/rig.toml").database == tmp_path / "gate/liftgate.dbc"
    assert load_vehicle(tmp_path / "gate/vehicle.toml").drives == 2
    assert load_scenario(tmp_path / "gate/scenario.toml").requests
    compile((tmp_path / "gate/test_gate.py").read_text(), "test_gate.py", "exec")


def test_copies_are_writable_although_the_shipped_files_are_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    root = tmp_path / "installed"
    for name in ("dbc", "configs"):
        shutil.copytree(shipped.data_root() / name, root / name)
    for path in root.rglob("*.*"):
        path.chmod(0o444)
    monkeypatch.setattr("liftgate_hil.config.starter.data_root", lambda: root)
    create_starter(tmp_path / "gate")
    assert (tmp_path / "gate/rig.toml").stat().st_mode & 0o200


def test_a_failed_write_is_reported_with_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ConfigError, match=r"liftgate\.dbc: No space left on device"):
        create_starter(tmp_path / "gate")


def test_the_ecu_is_copied_without_build_products():
    names = [source.name for source in shipped.ecu_sources()]
    assert "Makefile" in names
    assert {Path(name).suffix for name in names} == {"", ".c", ".h"}


def test_no_two_files_of_the_ecu_have_the_same_name():
    names = [source.name for source in (*shipped.ecu_sources(), *shipped.c_headers())]
    assert len(names) == len(set(names))
    assert "liftgate_serial.h" in names


@needs_compiler
def test_the_copied_ecu_is_built_from_the_copies_alone(tmp_path: Path):
    folder = tmp_path / "gate"
    create_starter(folder)
    # The Makefile's places in a checkout, as somebody else's project may have them.
    theirs = tmp_path / "hil/liftgate_hil/transport"
    theirs.mkdir(parents=True)
    (theirs / "liftgate_serial.h").write_text("#error not ours\n")
    (tmp_path / "dbc").mkdir()
    (tmp_path / "dbc/liftgate.dbc").write_text("not ours")
    subprocess.run(
        ["make", "-C", str(folder / "ecu"), f"PYTHON={sys.executable}"],
        check=True, capture_output=True, timeout=300, env={**os.environ, **BARE_CANTOOLS},
    )  # fmt: skip
    for name in ("ecu-can", "ecu-serial"):
        done = subprocess.run([folder / "ecu/build" / name], capture_output=True, check=False)
        assert done.returncode == 2  # no wire named
        assert b"WIRE" in done.stderr


@needs_compiler
def test_the_copied_ecu_is_built_with_the_python_on_the_path(tmp_path: Path):
    create_starter(tmp_path / "gate")
    done = subprocess.run(
        ["make", "-n", "-C", str(tmp_path / "gate/ecu")],
        check=True, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert "\npython3 -m cantools" in done.stdout
    assert " ../liftgate.dbc" in done.stdout


@pytest.mark.parametrize("is_active", [True, False])
def test_the_next_steps_name_a_python_that_has_this_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], is_active: bool
):
    here = str(Path(sys.executable).with_name("python3"))
    monkeypatch.setattr(shutil, "which", lambda name: here if is_active else "/usr/bin/python3")
    assert main(["init", str(tmp_path / "gate")]) == 0
    out = capsys.readouterr().out
    assert ("  liftgate-hil demo" in out) == is_active
    assert (f"  {sys.executable} -m liftgate_hil demo" in out) != is_active
    assert (f"PYTHON={sys.executable}" in out) != is_active
