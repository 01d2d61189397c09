"""Create a folder for a new project: copies of the shipped files that users change first, and the C ECU."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from liftgate_compiler.files import write_whole
from liftgate_hil.config.shipped import c_headers, data_root, ecu_sources
from liftgate_hil.errors import ConfigError

# Name in the new folder: the shipped file that is copied. The rig finds its database beside itself by this name.
_FILES = {
    "liftgate.dbc": "dbc/liftgate.dbc",
    "vehicle.toml": "configs/vehicles/suv.toml",
    "rig.toml": "configs/rigs/liftgate.toml",
    "scenario.toml": "configs/scenarios/demo.toml",
    "test_gate.py": "configs/starter/test_gate.py",
    "test_reverses.toml": "configs/starter/test_reverses.toml",
    ".github/workflows/liftgate.yml": "configs/starter/workflow.yml",
}


README = "README.md"
README_BESIDE = "LIFTGATE.md"  # if the folder has a README


def starter_readme() -> Path:
    """Return the path of the shipped README that explains the files in a starter folder."""
    return data_root() / "configs/starter" / README


def create_starter(folder: Path) -> list[Path]:
    """Fill `folder`, created if needed, with the starter files; return them, relative to the folder.

    It may be a new or an empty folder, or a git repository, of which all files are kept: if it has a README, ours
    gets another name. The ECU's sources and the headers they need go to its subfolder `ecu`. Raises ConfigError if
    the folder is none of these, if existing files would be overwritten (all of them are named), or if it cannot be
    written to; existing files are unchanged then.
    """
    try:
        _check(folder)
        sources = _sources(folder)
        taken = list(dict.fromkeys(_in_the_way(folder, name) for name in sources))
        if found := [str(each) for each in taken if each is not None]:
            raise ConfigError(
                f"{folder}: would overwrite {', '.join(found)}; allowed: a folder without them (nothing was "
                "written)"
            )
        for name, source in sources.items():
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            # Only the content is copied: an installed file may be read-only.
            write_whole(target, source.read_bytes(), is_new=True)
    except OSError as error:
        where = error.filename or folder
        raise ConfigError(f"{folder}: cannot be written: {where}: {error.strerror}") from error
    return list(sources)


def _check(folder: Path) -> None:
    """Raise ConfigError if the folder may not be filled with the starter files."""
    if not folder.exists():
        return
    allowed = "allowed: a new or an empty folder, or a git repository"
    if not folder.is_dir():
        raise ConfigError(f"{folder}: is a file; {allowed}")
    if any(folder.iterdir()) and not (folder / ".git").exists():
        raise ConfigError(f"{folder}: is not empty; {allowed}")


def _sources(folder: Path) -> dict[Path, Path]:
    """Return the source file of each file to create, by its name in the folder."""
    sources = {Path(name): data_root() / source for name, source in _FILES.items()}
    there = folder.iterdir() if folder.exists() else ()
    has_readme = any(each.stem.casefold() == "readme" for each in there)
    sources[Path(README_BESIDE if has_readme else README)] = starter_readme()
    for source in (*ecu_sources(), *c_headers()):
        sources[Path("ecu", source.name)] = source
    return sources


def _in_the_way(folder: Path, name: Path) -> Path | None:
    """Return the path, relative to `folder`, that prevents the creation of a file; None if there is none."""
    for part in reversed((name, *name.parents[:-1])):
        place = folder / part
        if os.path.lexists(place) and (part == name or not place.is_dir()):
            return part
    return None


def contents(folder: str, written: Sequence[Path]) -> list[str]:
    """Return the list of created files, one line for each folder."""
    names: dict[Path, list[str]] = {}
    for path in written:
        names.setdefault(Path(folder, path.parent), []).append(path.name)
    return [f"written: {parent}: {', '.join(each)}" for parent, each in names.items()]


def next_steps(folder: str) -> list[str]:
    """Return the next steps: the commands of the new folder's README, with the folder's name and this Python."""
    heading = ""
    program, pytest, make = "liftgate-hil", "python -m pytest", "make -C ecu"
    python = Path(sys.executable)
    if Path(shutil.which("python3") or "").parent != python.parent:
        # The environment is not activated: PATH leads to another Python, without this package.
        quoted = shlex.quote(str(python))
        program, pytest = f"{quoted} -m liftgate_hil", f"{quoted} -m pytest"
        make += f" PYTHON={quoted}"
    instead = {"liftgate-hil": program, "python -m pytest": pytest, "make -C ecu": make}
    steps = ["next:", f"  cd {shlex.quote(folder)}"]
    for line in starter_readme().read_text(encoding="utf-8").splitlines():
        step = line.removeprefix("    ")
        if line.startswith("## "):
            heading = line.removeprefix("## ")
        elif step != line:
            if heading:
                steps += ["", f"  # {heading}"]
                heading = ""
            start = next((each for each in instead if step.startswith(each)), "")
            steps.append(f"  {instead.get(start, start)}{step.removeprefix(start)}")
    return steps
