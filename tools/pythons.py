"""Try every Python that pyproject.toml names: `python -m tools.pythons [--short] [--others]`.

Each that this machine has gets an environment of its own with the installed package, and an empty cache of machine
code. Whole: `compile` of every entry point, an emulator, the demo, `simulate`, a campaign of two variants and the
compiler's tests. Short: an emulator in plain Python, as machine code of its loop takes a minute, and with the
newest Python `simulate`, which compiles the plant.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_CLASSIFIER = "Programming Language :: Python :: "
_PATIENCE_S = 1200.0  # for one step; nothing is judged by it

_EMULATOR = "liftgate-hil --bus virtual:x --ecu reference --duration 0.3 --quiet"
_SIMULATE = "liftgate-hil simulate --duration 1 --output opening.csv"
SHORT = (f"env LIFTGATE_COMPILE=0 {_EMULATOR}",)
SHORT_OF_NEWEST = (*SHORT, _SIMULATE)
WHOLE = (
    "liftgate-hil compile --quiet",
    _EMULATOR,
    "liftgate-hil demo --clock free --output demo --quiet",
    _SIMULATE,
    f"liftgate-hil campaign {ROOT}/docs/examples/trap.toml --vary rod=10000,20000 --output campaign --quiet",
    f"python -m pytest -q -p no:cacheprovider --rootdir {ROOT} {ROOT}/tests/compiler/test_linking.py "
    f"{ROOT}/tests/compiler/test_compiler.py {ROOT}/tests/compiler/test_machine_code.py",
)


def versions() -> list[str]:
    """Return the versions of Python that pyproject.toml names, such as 3.11."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = [each.removeprefix(_CLASSIFIER) for each in project["classifiers"] if each.startswith(_CLASSIFIER)]
    return [each for each in named if each.count(".") == 1]


def interpreter(version: str) -> str | None:
    """Return the program of a version of Python, on the path or kept by pyenv; None: this machine has none."""
    kept = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv") / "versions"
    found = sorted(kept.glob(f"{version}.*/bin/python"), reverse=True)
    for program in (sys.executable, shutil.which(f"python{version}"), *map(str, found)):
        if program is not None and _version_of(program) == version:
            return program
    return None


def _version_of(program: str) -> str:
    """Return a program's version of Python; "" where it does not run, as pyenv's stand-ins may not."""
    code = "import sys; print('%d.%d' % sys.version_info[:2])"
    try:
        done = subprocess.run([program, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip()


def main() -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true", help="only `simulate`, and an emulator in plain Python")
    parser.add_argument(
        "--others", action="store_true", help="leave out the Python that runs this, if there is another"
    )
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "pythons", help="folder of the environments")
    args = parser.parse_args()
    own = ".".join(map(str, sys.version_info[:2]))
    programs = {version: interpreter(version) for version in versions()}
    if args.others and any(program for version, program in programs.items() if version != own):
        programs.pop(own, None)
    here = [version for version, program in programs.items() if program is not None]
    failed = []
    for version, program in programs.items():
        if program is None:
            print(f"Python {version}: NOT HERE", flush=True)
            continue
        folder = args.output / version
        shutil.rmtree(folder, ignore_errors=True)
        (folder / "work").mkdir(parents=True)
        lines = (SHORT_OF_NEWEST if version == here[-1] else SHORT) if args.short else WHOLE
        if not _tried(version, program, folder, lines):
            failed.append(version)
    if failed:
        print(f"pythons: FAILED with {', '.join(failed)}")
    return 1 if failed else 0


def _tried(version: str, program: str, folder: Path, lines: Sequence[str]) -> bool:
    """Whether each step succeeds with a version of Python."""
    for command in _steps(program, folder, lines):
        began = time.monotonic()
        path = f"{folder / 'venv' / 'bin'}{os.pathsep}{os.environ['PATH']}"
        environment = {**os.environ, "PATH": path, "XDG_CACHE_HOME": str(folder / "cache")}
        environment.pop("PYTHONPATH", None)
        try:
            done = subprocess.run(
                command, cwd=folder / "work", env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT, text=True, errors="replace", check=False, timeout=_PATIENCE_S,
            )  # fmt: skip
            told, ending = done.stdout, f"exit code {done.returncode}"
            succeeds = done.returncode == 0 and "Traceback" not in told
        except (OSError, subprocess.TimeoutExpired) as error:
            told, ending, succeeds = "", str(error), False
        shown = " ".join(command).replace(f"{ROOT}/", "")
        print(f"Python {version}: {time.monotonic() - began:6.1f} s  {shown}", flush=True)
        if not succeeds:
            print(told, ending, sep="", flush=True)
            return False
    return True


def _steps(program: str, folder: Path, lines: Sequence[str]) -> Iterator[list[str]]:
    """Yield the commands to try."""
    pip = ["python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"]
    yield [program, "-m", "venv", str(folder / "venv")]
    yield [*pip, f"{ROOT}[all]", "pytest", "hypothesis"] if lines is WHOLE else [*pip, str(ROOT)]
    for line in lines:
        yield line.split()


if __name__ == "__main__":
    sys.exit(main())
