"""Find and list the files shipped with this package: inside the wheel, or in the checkout."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from liftgate_hil.config.files import is_there, issue_with
from liftgate_hil.config.toml import read_toml, shortened
from liftgate_hil.errors import ConfigError, nearest

_SHOWN = 12  # names that a message lists
CAMPAIGNS, PACK = "campaigns", "pack:"  # the prefix is that of their names
KINDS = ("scenarios", "vehicles", "rigs", CAMPAIGNS)  # folders of shipped files, by what a name of theirs names
_PARTS = "parts"  # folder of scenarios that others include

_PACKAGE = Path(__file__).resolve().parents[1]
# Where nothing else is named.
DEFAULT_VEHICLE, DEFAULT_RIG = "suv", "liftgate"


def data_root() -> Path:
    """Return the folder that contains the shipped folders `dbc` and `configs`.

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
    """Return the C headers for an ECU, each stored beside the Python module that it mirrors."""
    return sorted(path for path in _PACKAGE.glob("*/*.h") if path.parent.name != "_data")


def shipped_names(folder: str) -> list[str]:
    """Return the names of the shipped TOML files in a folder below `data_root()`, without suffixes."""
    return sorted(path.stem for path in (data_root() / folder).glob("*.toml"))


def shipped_folder(kind: str, name: str) -> Path | None:
    """Return the shipped folder with a name below `kind`, such as the `pack` of scenarios; None: no such one."""
    folder = data_root() / "configs" / kind / name
    is_name = name and len(Path(name).parts) == 1 and not name.startswith(".")
    return folder if is_name and folder.is_dir() else None


def shipped_files(kind: str) -> dict[str, Path]:
    """Return the shipped files of a kind by the names that users give, such as `pack/crank_dip`, in order.

    A campaign's own scenarios, in a folder beside a file with the folder's name, are not among them.
    """
    top = data_root() / "configs" / kind
    sets = [each for each in sorted(top.iterdir()) if each.is_dir() and not each.with_suffix(".toml").exists()]
    names = {path.stem: path for path in sorted(top.glob("*.toml"))}
    for folder in sets:
        if folder.name != _PARTS:
            names |= {f"{folder.name}/{path.stem}": path for path in sorted(folder.glob("*.toml"))}
    return names


def _listed(names: Iterable[str]) -> str:
    """Return shipped names as one text, at most _SHOWN; all names in a folder appear as one, FOLDER/NAME."""
    shown = list(dict.fromkeys(f"{name.partition('/')[0]}/NAME" if "/" in name else name for name in names))
    return ", ".join([*shown[:_SHOWN], "…"] if len(shown) > _SHOWN else shown)


def _proposal(path: Path, names: Iterable[str]) -> str:
    """Return "did you mean …" with similar shipped names or files for a path that does not exist; "": none."""
    from difflib import get_close_matches  # imported only where used, since the import takes time

    near: list[str] = []
    if not path.suffix:
        near = nearest(str(path), names) or nearest(path.name, names)
    beside: list[str] = []
    with contextlib.suppress(OSError, ValueError):  # no such folder
        beside = [each.name for each in path.parent.iterdir() if each.suffix == path.suffix]
    files = get_close_matches(path.name, filter(str.isprintable, beside), 1, cutoff=0.8)
    near = near or [str(path.parent / each) for each in files]
    return f"did you mean {' or '.join(near)}? " if near else ""


def find_config(kind: str, name: str, called: str = "") -> Path:
    """Return the path of a `vehicle`, `rig` or `scenario` that is named by a shipped name or a path.

    `kind` is the folder under `configs`; `called` names the value in messages if it is none of these
    arguments. Raises ConfigError if there is no such file.
    """
    called = called or f"`{kind[:-1]}`"
    path = Path(name)
    is_name = not path.suffix and len(path.parts) == 1
    if is_name or (len(path.parts) == 2 and not is_there(path)):
        shipped = data_root() / "configs" / kind / f"{name.removesuffix('.toml')}.toml"
        with contextlib.suppress(OSError):  # too long a name
            if ".." not in path.parts and not path.is_absolute() and shipped.is_file():
                return shipped
    issue = issue_with(path)
    if issue and not is_there(path):
        names = shipped_files(kind)
        what = f"a shipped name ({_listed(names)})"
        if is_name:
            issue = f"neither a file nor {what}"
            proposal = _proposal(path, names).removesuffix(" ")
            issue += f"; {proposal}" if proposal else ""
        else:
            issue = f"{issue}; {_proposal(path, names)}allowed: a file, or {what}"
    if issue:
        raise ConfigError(f"{called} {shortened(name)}: {issue}")
    return path


_COMMENT = re.compile(r"\A(?:# ?.*\n)+")
_SENTENCE_END = re.compile(r"[.:;](?=\s|$)")


class Shipped(NamedTuple):
    """A shipped file: its kind in the plural, its name as a flag takes it, and its description.

    A name is that of a file, or SET/NAME of one in a set of scenarios.
    """

    kind: str
    name: str
    description: str


def shipped_list() -> list[Shipped]:
    """Return all shipped files, kind by kind in the order of KINDS, each in the order of `shipped_files`."""
    return [
        Shipped(kind, f"{PACK if kind == CAMPAIGNS else ''}{name}", _description(path))
        for kind in KINDS
        for name, path in shipped_files(kind).items()
    ]


def _description(path: Path) -> str:
    """Return the description in a shipped file, or the first sentence of the comment at its top."""
    description = read_toml(path).get("description")
    if description:
        return " ".join(str(description).split())
    comment = _COMMENT.match(path.read_text(encoding="utf-8"))
    text = " ".join(line.removeprefix("#").strip() for line in comment[0].splitlines()) if comment else ""
    return _SENTENCE_END.split(text, maxsplit=1)[0]
