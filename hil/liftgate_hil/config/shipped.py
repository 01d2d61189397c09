"""Find the shipped files: inside the wheel, or in the checkout."""

from __future__ import annotations

import contextlib
from pathlib import Path

from liftgate_hil.config.files import is_there, issue_with
from liftgate_hil.config.toml import shortened
from liftgate_hil.errors import ConfigError

_SHOWN = 12  # names that a message lists
_SETS = ("pack",)  # sets of scenarios, each in a folder of its own

_PACKAGE = Path(__file__).resolve().parents[1]


def data_root() -> Path:
    """Return the folder with `dbc` and `configs`.

    It is `liftgate_hil/_data` of an installed wheel, else the top of the checkout. The wheel's layout is
    `[tool.hatch.build.targets.wheel.sources]` in pyproject.toml.
    """
    shipped = _PACKAGE / "_data"
    return shipped if shipped.is_dir() else _PACKAGE.parents[1]


def ecu_sources() -> list[Path]:
    """Return the files of the C ECU: its sources, its own headers and its Makefile."""
    shipped = data_root() / "ecu"
    folder = shipped if shipped.is_dir() else data_root() / "tools" / "ecu"
    return sorted([*folder.glob("*.c"), *folder.glob("*.h"), folder / "Makefile"])


def c_headers() -> list[Path]:
    """Return the C headers for an ECU, each beside the module that it is the counterpart of."""
    return sorted(path for path in _PACKAGE.glob("*/*.h") if path.parent.name != "_data")


def shipped_names(folder: str) -> list[str]:
    """Return the names of the shipped files in a folder, without suffix."""
    return sorted(path.stem for path in (data_root() / folder).glob("*.toml"))


def shipped_folder(kind: str, name: str) -> Path | None:
    """Return the shipped folder of a name below `kind`, such as the `pack` of scenarios; None if there is none."""
    folder = data_root() / "configs" / kind / name
    is_name = name and len(Path(name).parts) == 1 and not name.startswith(".")
    return folder if is_name and folder.is_dir() else None


def _listed(kind: str) -> str:
    """Return the shipped names of a kind and its folders, as a text."""
    folder = data_root() / "configs" / kind
    names = shipped_names(f"configs/{kind}")
    names = [*names[:_SHOWN], "…"] if len(names) > _SHOWN else names
    return ", ".join([*names, *(f"{name}/NAME" for name in _SETS if (folder / name).is_dir())])


def _near(path: Path) -> str:
    """Return which file beside a path that does not exist may have been meant, as the begin of a sentence."""
    from difflib import get_close_matches  # imported only where used, since the import takes time

    beside: list[str] = []
    with contextlib.suppress(OSError, ValueError):  # no such folder
        beside = [each.name for each in path.parent.iterdir() if each.suffix == path.suffix]
    near = get_close_matches(path.name, filter(str.isprintable, beside), 1, cutoff=0.8)
    return f"did you mean {path.parent / near[0]}? " if near else ""


def find_config(kind: str, name: str, called: str = "") -> Path:
    """Return the file for a `vehicle`, `rig` or `scenario` value: a shipped name or a path.

    `kind` is the folder under `configs`; `called` names the value in messages if it is none of these
    arguments. Raises ConfigError if there is no such file.
    """
    called = called or f"`{kind[:-1]}`"
    path = Path(name)
    is_name = not path.suffix and len(path.parts) == 1
    if len(path.parts) == 2 and not is_there(path) and shipped_folder(kind, path.parts[0]):
        return find_config(f"{kind}/{path.parts[0]}", path.stem, called)
    if is_name and name in shipped_names(f"configs/{kind}"):
        return data_root() / "configs" / kind / f"{name}.toml"
    issue = issue_with(path)
    if issue and not is_there(path):
        shipped = f"a shipped name ({_listed(kind)})"
        if is_name:
            issue = f"neither a file nor {shipped}"
        else:
            issue = f"{issue}; {_near(path)}allowed: a file, or {shipped}"
    if issue:
        raise ConfigError(f"{called} {shortened(name)}: {issue}")
    return path
