"""`completion`: static shell scripts that complete subcommands, flags and shipped names."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from liftgate_hil.cli.commands import COMMANDS
from liftgate_hil.cli.completion import SHELLS
from liftgate_hil.cli.main import main, whole_parser
from liftgate_hil.config.shipped import shipped_names


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The completion script of each shell, in a file."""
    folder = tmp_path_factory.mktemp("scripts")
    found = {}
    for shell in SHELLS:
        with pytest.MonkeyPatch.context() as patch, (folder / shell).open("w") as stream:
            patch.setattr(sys, "stdout", stream)
            assert main(["completion", shell]) == 0
        found[shell] = folder / shell
    return found


def needs(shell: str) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell}")


def told(command: list[str], folder: Path) -> list[str]:
    """Return the words that a shell prints."""
    done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True, timeout=60)
    return [line.split("\t")[0] for line in done.stdout.splitlines()]


def bash(script: Path, folder: Path, *words: str) -> list[str]:
    code = (
        f'source {script}; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _shtab_liftgate_hil; '
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    return told(["bash", "--norc", "-c", code, "bash", *words], folder)


def fish(script: Path, folder: Path, *words: str) -> list[str]:
    code = f"source {script}; complete -C '{' '.join(words)}'"
    return told(["fish", "--no-config", "-c", code], folder)


@pytest.mark.parametrize("complete", [bash, fish])
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("ident",), ["identify"]),
        (("demo", "--no-rec"), ["--no-record"]),
        (("demo", "--clock", "f"), ["free"]),
        (("--rig", "l"), ["liftgate"]),
        (("simulate", "--scenario", "d"), ["demo"]),
        (("demo", "--ecu", "ref"), ["reference"]),
        (("rig", "check", "x.toml", "--vehicle", "c"), ["compact"]),
        (("simulate", "--vehicle", ""), ["compact", "heavy-suv", "suv", "mine.toml"]),
    ],
)
def test_a_shell_completes_subcommands_flags_names_and_files(
    scripts: dict[str, Path], tmp_path: Path, complete, words: tuple[str, ...], expected: list[str]
) -> None:
    needs(complete.__name__)
    (tmp_path / "mine.toml").write_text("")
    assert complete(scripts[complete.__name__], tmp_path, "liftgate-hil", *words)[: len(expected)] == expected


@pytest.mark.parametrize("shell", SHELLS)
def test_the_syntax_of_every_script_is_valid_in_its_shell(scripts: dict[str, Path], shell: str) -> None:
    needs(shell)
    subprocess.run([shell, "-n", scripts[shell]], check=True, timeout=60)


@pytest.mark.parametrize("shell", SHELLS)
def test_every_script_has_all_subcommands_flags_and_shipped_names(scripts: dict[str, Path], shell: str) -> None:
    text = scripts[shell].read_text()
    flags = {flag for action in whole_parser()._actions for flag in action.option_strings}
    assert "--overrun-limit" in flags
    for flag in flags:
        assert flag.lstrip("-") in text  # fish has them without
    for name in (*COMMANDS, *shipped_names("configs/vehicles"), *shipped_names("configs/rigs")):
        assert name in text


def test_other_subcommands_do_not_import_the_script_generator() -> None:
    code = (
        "import sys; from liftgate_hil.cli.main import main\n"
        "try: main(['demo', '--help'])\n"
        "except SystemExit: pass\n"
        "sys.exit('shtab' in sys.modules or 'liftgate_hil.cli.completion' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True)
    assert done.returncode == 0


def test_an_unsupported_shell_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "csh"]) == 2
    assert "invalid choice: 'csh'" in capsys.readouterr().err
