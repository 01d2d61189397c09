"""A folder to start from: the shipped files that a user changes first, and the C ECU, ready to run."""

from __future__ import annotations

from pathlib import Path

from liftgate_hil.config.shipped import c_headers, data_root, ecu_sources
from liftgate_hil.errors import ConfigError

# Name in the new folder → what it is a copy of. The rig finds its database beside itself, by the name it has.
_FILES = {
    "liftgate.dbc": "dbc/liftgate.dbc",
    "vehicle.toml": "configs/vehicles/suv.toml",
    "rig.toml": "configs/rigs/liftgate.toml",
    "scenario.toml": "configs/scenarios/demo.toml",
    "test_gate.py": "configs/starter/test_gate.py",
    "test_reverses.toml": "configs/starter/test_reverses.toml",
    ".github/workflows/liftgate.yml": "configs/starter/workflow.yml",
}


def create_starter(folder: Path) -> list[Path]:
    """Fill `folder`, which is made where it does not exist; the files written, relative to it.

    The ECU's sources and the headers they need go to its subfolder `ecu`. Raises ConfigError where the folder is
    not empty, is no folder, or cannot be written to; then nothing that was there has changed.
    """
    sources = {Path(name): data_root() / source for name, source in _FILES.items()}
    for source in (*ecu_sources(), *c_headers()):
        sources[Path("ecu", source.name)] = source
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            kind = "is not empty" if folder.is_dir() else "is a file"
            raise ConfigError(f"{folder}: {kind}; allowed: a new or an empty folder")
        for name, source in sources.items():
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            # The content alone: an installed file may be read-only.
            target.write_bytes(source.read_bytes())
    except OSError as error:
        where = error.filename or folder
        raise ConfigError(f"{folder}: cannot be written: {where}: {error.strerror}") from error
    return list(sources)
