"""The commands of README.md, of the pages in docs, and of what `init` prints, as they stand there, and where they
can be tried.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).parents[2]
BIN = Path(sys.executable).parent
PATIENCE = 300.0  # s until a command must have ended; nothing is judged by it
_PROGRAMS = ("liftgate-hil", "make", "cc", "python", "candump", "cantools", "mkdir", "curl", "tools/")
_CACHE = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")  # with the compiled model


def pages() -> list[Path]:
    """README, and the pages of docs."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def text() -> str:
    """All of them, one after the other."""
    return "\n".join(each.read_text(encoding="utf-8") for each in pages())


def commands() -> list[str]:
    """Every command of their indented blocks, each once, without the comments behind."""
    joined = text().replace("\\\n", " ")
    lines = (line[4:].strip() for line in joined.splitlines() if line.startswith("    "))
    found = [re.split(r" {2,}#", line)[0].strip() for line in lines if line.startswith(_PROGRAMS)]
    return list(dict.fromkeys(found))


def command(start: str) -> str:
    """The one that begins so, or is all of this."""
    found = [each for each in commands() if each == start]
    found = found or [each for each in commands() if each.startswith(start)]
    assert len(found) == 1, (start, found)
    return found[0]


def block(line: str) -> str:
    """The lines of the indented block with this line, up to the next command."""
    lines = text().splitlines()
    at = next(k for k, each in enumerate(lines) if each.startswith(f"    {line}"))
    kept = []
    for each in lines[at:]:
        if each and (not each.startswith("    ") or each[4:].startswith(_PROGRAMS)):
            break
        kept.append(each[4:])
    return "\n".join(kept) + "\n"


def fresh_folder(folder: Path) -> Path:
    """A folder with what README's commands take from a checkout, as copies."""
    ignored = shutil.ignore_patterns("build", "__pycache__")
    for name in ("dbc", "docs/examples", "tools/ecu"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    for header in (ROOT / "hil/liftgate_hil").glob("*/*.h"):
        place = folder / header.relative_to(ROOT)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(header, place)
    (folder / ".venv").symlink_to(BIN.parent)
    return folder


def environment(folder: Path) -> dict[str, str]:
    """Of a user whose home is the folder and whose environment is activated."""
    path = f"{BIN}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "HOME": str(folder), "XDG_CACHE_HOME": _CACHE}


def start(line: str, folder: Path, places: Mapping[str, str] | None = None, more: str = ""):
    """The process of a command, with other places for those that are not here, and `more` behind it."""
    for theirs, here in (places or {}).items():
        line = line.replace(theirs, here)
    return subprocess.Popen(
        ["bash", "-c", f"exec {line} {more}" if more or places else line],
        cwd=folder,
        env=environment(folder),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def run(
    line: str, folder: Path, places: Mapping[str, str] | None = None, more: str = "", codes: tuple[int, ...] = (0,)
) -> str:
    """What a command prints."""
    process = start(line, folder, places, more)
    try:
        out, complaints = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode in codes, (line, out, complaints)
    assert "Traceback" not in complaints
    return out
