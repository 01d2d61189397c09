"""Commands and blocks of README.md, of the pages in docs, and of the output of `init`, and ways to test them
unchanged.

A plain `liftgate-hil` command is a call in this process, which spares its start; all others are processes.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import pytest
from c_ecu import BARE_CANTOOLS

from liftgate_hil.cli.main import main

ROOT = Path(__file__).parents[2]
BIN = Path(sys.executable).parent
PATIENCE = 300.0  # s until a command must have ended; nothing is judged by it
_PROGRAMS = (
    *("liftgate-hil", "make", "cc", "python", "candump", "cantools", "mkdir", "curl", "tools/"),
    *("sudo ", "uname ", "taskset "),
)
_CACHE = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")  # with the compiled model


# Pages that nobody can go through from top to bottom, with the reason; tests ask for their commands by `command`.
NOT_IN_ORDER = {
    "README.md": "its commands install, or are what CI runs",
    "bench.md": "its commands run beside each other on a bus, in real time, until they are stopped",
    "cluster.md": "scheduler, worker and campaign run beside each other",
    "machine.md": "the exit code depends on the machine",
    "operators-page.md": "curl commands a run with a page, beside it, in real time, until they are stopped",
    "real-time.md": "its command runs in real time on a bus until it is stopped",
    "real-time-kernel.md": "its commands need root, a CPU and a bus of this machine",
    "serial-line.md": "its commands run beside each other on a serial line, in real time, until they are stopped",
}
# Commands that no test runs as they stand there, by how they begin, with the reason or the test of the like.
ELSEWHERE = {
    "make demo": "installs; the demo is tests/hil/cli/test_demo.py",
    "make test": "is what CI runs",
    "make test-vcan": "is what CI runs",
    "liftgate-hil --bus slcan": "needs an adapter; tests/system/test_interfaces.py has one in software",
    "candump can0": "runs until it is stopped; tests/vcan/test_commands.py",
    "cantools monitor": "fills a terminal until it is stopped; tests/system/test_clients.py",
    "python -m distributed.cli.dask_scheduler": "tests/hil/campaigns/test_executors.py",
    "python -m distributed.cli.dask_worker": "tests/hil/campaigns/test_executors.py",
    "liftgate-hil campaign docs/examples/trap.toml --vary angle=20:60:9": "tests/hil/campaigns/test_executors.py",
    "liftgate-hil campaign docs/examples/trap.toml --probability": "long; tests/hil/cli/test_campaign_command.py",
    "liftgate-hil campaign pack:trap-matrix": "long; tests/hil/cli/test_campaign_command.py",
}


class Around(NamedTuple):
    """Context of a page's commands: commands run before them, and values shortened in tests."""

    before: tuple[str, ...] = ()
    places: Mapping[str, str] = {}


_ONE = " --jobs 1"  # processes of a campaign take 2 s each to start
_VARIANT = "import pyarrow.parquet as p; print(p.read_table('samples/results.parquet')['variant'][7].as_py()[:12])"
AROUND = {
    "campaigns.md": Around(
        places={
            "--samples 200": f"--samples 12{_ONE}",
            "VARIANT": f'"$(python -c "{_VARIANT}")"',
            "--evaluations 60": f"--evaluations 20{_ONE}",
            "--against reference": f"--against reference{_ONE}",
        }
    ),
    "measurements.md": Around(
        (
            "liftgate-hil simulate --voltage 10 --duration 3 --seed 1 --output opening.csv",
            "liftgate-hil simulate --voltage -10 --duration 3 --seed 2 --initial open --output closing.csv",
            "liftgate-hil simulate --voltage 9 --duration 3 --seed 3 --output other.csv",
            "liftgate-hil demo --clock free --output out",
        )
    ),
    "plant.md": Around((r"printf 'time_s,voltage_v\n0,0\n0.1,9\n1,9\n' > measured.csv",)),
    "recordings.md": Around(
        (
            "liftgate-hil demo --clock free --no-record --record run.csv --record run.blf",
            "liftgate-hil simulate --voltage 12 --duration 1 --output before.csv",
            "liftgate-hil simulate --voltage 12 --duration 1 --output after.csv",
        )
    ),
}
_WRITTEN = re.compile(r"--(?:output|record|results|html|junit|save-vehicle|save-inputs) (\S+)")


class Block(NamedTuple):
    """A block of a page: fenced with its stated language, or indented with a derived one."""

    page: str
    kind: str  # "commands", "python", "toml", another language of a fence, or "plain"
    text: str

    @property
    def file(self) -> str:
        """Name of the file that the block contains, by its first line; else empty."""
        match = re.match(r"(?:#|//) ([\w./-]+\.(?:toml|py|c|yml))$", self.text.split("\n", 1)[0])
        return match[1] if match else ""


def pages() -> list[Path]:
    """Paths of README and of the pages of docs."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def text() -> str:
    """Concatenated text of all pages."""
    return "\n".join(each.read_text(encoding="utf-8") for each in pages())


@functools.cache
def commands() -> tuple[str, ...]:
    """Every command of the pages, each once, without the comment after it."""
    found = [block for page in pages() for block in blocks(page) if block.kind == "commands"]
    return tuple(dict.fromkeys(line for block in found for line, _ in commands_in(block)))


def command(start: str) -> str:
    """Return the only command that begins with, or equals, this text."""
    found = [each for each in commands() if each == start]
    found = found or [each for each in commands() if each.startswith(start)]
    assert len(found) == 1, (start, found)
    return found[0]


def block(line: str) -> str:
    """Return the lines of the indented block with this line, up to the next command."""
    lines = text().splitlines()
    at = next(k for k, each in enumerate(lines) if each.startswith(f"    {line}"))
    kept = []
    for each in lines[at:]:
        if each and (not each.startswith("    ") or each[4:].startswith(_PROGRAMS)):
            break
        kept.append(each[4:])
    return "\n".join(kept) + "\n"


def blocks(page: Path) -> list[Block]:
    """All blocks of a page, in order."""
    return [Block(page.name, kind or _kind_of(text), text) for kind, text in _raw_blocks(page) if text.strip()]


def _raw_blocks(page: Path) -> Iterator[tuple[str, str]]:
    """Language (where a fence states it) and text of each block."""
    lines = page.read_text(encoding="utf-8").splitlines()
    kept: list[str] = []
    at = 0
    while at < len(lines):
        line = lines[at]
        if fence := re.match(r"```\s*(\S*)", line):
            yield "", "\n".join(kept)
            kept = []
            end = next(k for k in range(at + 1, len(lines)) if lines[k].startswith("```"))
            yield fence[1] or "text", "\n".join(lines[at + 1 : end]) + "\n"
            at = end + 1
            continue
        indented = line[4:] if line.startswith("    ") else ""
        is_command = indented.startswith(_PROGRAMS)
        goes_on = bool(kept) and kept[-1].endswith("\\")
        changes = bool(kept) and bool(indented) and not goes_on and is_command != kept[0].startswith(_PROGRAMS)
        if kept and ((line and not indented) or changes):
            yield "", "\n".join(kept).strip("\n") + "\n"
            kept = []
        if indented or kept:
            kept.append(indented)
        at += 1
    yield "", "\n".join(kept).strip("\n") + "\n"


def _kind_of(text: str) -> str:
    """Language of an indented block."""
    if text.startswith(_PROGRAMS):
        return "commands"
    try:
        if tomllib.loads(text):
            return "toml"
    except tomllib.TOMLDecodeError:
        pass
    try:
        nodes = ast.parse(text).body
    except SyntaxError:
        return "plain"
    statements = (ast.Import, ast.ImportFrom, ast.FunctionDef, ast.ClassDef, ast.With, ast.For, ast.Assign)
    return "python" if any(isinstance(node, statements) for node in nodes) else "plain"


def commands_in(block: Block) -> list[tuple[str, int]]:
    """Commands of a block, each with the exit code stated in the comment after it."""
    found = []
    for line in re.sub(r" *\\\n *", " ", block.text).splitlines():
        told = re.search(r" {2,}#.*exit code (\d)", line)
        found.append((re.split(r" {2,}#", line)[0].strip(), int(told[1]) if told else 0))
    return [each for each in found if each[0]]


def written_by(line: str) -> list[str]:
    """Files and folders that a command's options name as output."""
    return [each for each in _WRITTEN.findall(line) if each != "-"]


def in_order() -> list[str]:
    """Names of the pages that tests/system/test_manual_blocks.py runs from top to bottom."""
    kinds = {"commands", "python"}
    found = [page.name for page in pages() if any(block.kind in kinds for block in blocks(page))]
    return [name for name in found if name not in NOT_IN_ORDER]


@functools.cache
def asked_for() -> frozenset[str]:
    """Commands that tests request by `command` with a text and run in their own way."""
    found = set()
    for path in (ROOT / "tests").rglob("test_*.py"):
        source = path.read_text(encoding="utf-8")
        if re.search(r"^(?:import|from) readme\b", source, re.MULTILINE):
            found |= {command(each) for each in _texts_of_calls(ast.parse(source))}
    return frozenset(found)


def _texts_of_calls(tree: ast.AST) -> Iterator[str]:
    """Texts passed as arguments to calls of `command`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("command", "readme.command"):
            for each in node.args:
                if isinstance(each, ast.Constant):
                    yield each.value


@functools.cache
def run_elsewhere() -> frozenset[str]:
    """Commands that are skipped where a page is run from top to bottom."""
    return asked_for() | {command(each) for each in ELSEWHERE}


def fresh_folder(folder: Path) -> Path:
    """Make a folder with copies of the files of a checkout that README's commands use."""
    ignored = shutil.ignore_patterns("build", "__pycache__")
    for name in ("dbc", "docs/examples", "tools/ecu"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    for header in (ROOT / "hil/liftgate_hil").glob("*/*.h"):
        place = folder / header.relative_to(ROOT)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(header, place)
    (folder / ".venv").symlink_to(BIN.parent)
    return folder


# Of this environment, which a user need not have, and which double the time that a start of pytest takes.
_PLUGINS = ("anyio", "hypothesispytest", "pytest_cov")


def environment(folder: Path) -> dict[str, str]:
    """Environment of a user with this home folder, the virtual environment activated, no further plugins of
    pytest, and C compiled without optimization, which takes a third of the time; tests/hil/cli/test_init.py builds
    the ECU with the flags of its Makefile.
    """
    return {
        **os.environ,
        "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}",
        "HOME": str(folder),
        "XDG_CACHE_HOME": _CACHE,
        "PYTEST_ADDOPTS": " ".join(f"-p no:{each}" for each in _PLUGINS),
        "CFLAGS": "-Wall -Wextra -Wpedantic -Werror",
    }


def with_places(line: str, places: Mapping[str, str] | None) -> str:
    """Return a command with devices and addresses replaced by those of the test."""
    for theirs, here in (places or {}).items():
        line = line.replace(theirs, here)
    return line


def start(line: str, folder: Path, places: Mapping[str, str] | None = None, more: str = ""):
    """Start a command as a process, with devices and addresses replaced, and `more` appended."""
    line = with_places(line, places)
    given = environment(folder)
    if line.startswith(("make ", "cantools ", "python -m can")):
        given |= BARE_CANTOOLS
    return subprocess.Popen(
        ["bash", "-c", f"exec {line} {more}" if more or places else line],
        cwd=folder,
        env=given,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def outcome(
    line: str, folder: Path, places: Mapping[str, str] | None = None, more: str = ""
) -> tuple[int, str, str]:
    """Run a command; return its exit code, its standard output, and its error output."""
    if is_called(with_places(line, places)):
        _, *arguments = shlex.split(f"{with_places(line, places)} {more}")
        return called(lambda: main(arguments), folder)
    process = start(line, folder, places, more)
    try:
        out, complaints = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    return process.returncode, out, complaints


def is_called(line: str) -> bool:
    """Whether a command can be called in this process: one of this project without a shell or lasting effect."""
    name, *words = line.split()
    needs_process = {"compile", "doctor", "ecu", "--realtime", "--serial", "--dashboard"}
    return name == "liftgate-hil" and not re.search(r"[|&;<>$`*?]", line) and not needs_process.intersection(words)


def called(function: Callable[[], int], folder: Path) -> tuple[int, str, str]:
    """Run a function in this process as a program in the folder: with its environment and its own modules, and
    stdout and stderr inherited by child processes. Return its exit code, output and error output.
    """
    modules, path = set(sys.modules), [*sys.path]
    importlib.invalidate_caches()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name, value in environment(folder).items():
            patch.setenv(name, value)
        try:
            with _redirected("stdout") as out, _redirected("stderr") as complaints:
                code = function()
        finally:
            sys.path[:] = path
            for name in set(sys.modules) - modules:  # another folder's may have the same name
                if str(getattr(sys.modules[name], "__file__", None) or "").startswith(str(folder)):
                    del sys.modules[name]
    return code, *map(_content, (out, complaints))


@contextlib.contextmanager
def _redirected(name: str) -> Iterator[Path]:
    """Redirect a stream of this process, and of its children, to a file."""
    ours = getattr(sys, name)
    number = {"stdout": 1, "stderr": 2}[name]
    ours.flush()
    kept = os.dup(number)
    descriptor, path = tempfile.mkstemp()
    try:
        os.dup2(descriptor, number)
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            setattr(sys, name, stream)
            yield Path(path)
    finally:
        setattr(sys, name, ours)
        os.dup2(kept, number)
        os.close(kept)


def _content(path: Path) -> str:
    """Return the text of a file and delete the file."""
    text = path.read_text(encoding="utf-8")
    path.unlink()
    return text


def run(
    line: str, folder: Path, places: Mapping[str, str] | None = None, more: str = "", codes: tuple[int, ...] = (0,)
) -> str:
    """Run a command, assert that its exit code is one of `codes`, and return its output."""
    code, out, complaints = outcome(line, folder, places, more)
    assert code in codes, (line, out, complaints)
    assert "Traceback" not in complaints
    return out
