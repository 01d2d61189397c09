"""Opening of a dashboard page: its data source, and the starter of its runs."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.errors import ConfigError, printable
from liftgate_hil.formats.recording import read_options

if TYPE_CHECKING:
    from liftgate_hil.dashboard.live import Live
    from liftgate_hil.dashboard.recorded import RecordingSource
    from liftgate_hil.dashboard.request import DashboardRequest
    from liftgate_hil.dashboard.source import NoSource
    from liftgate_hil.dashboard.starting import Starter

_MISSING = "not installed; allowed: with pip install 'liftgate-hil[dashboard]'"


def check_installed() -> None:
    """Raise ConfigError where packages that the dashboard needs are missing."""
    missing = [name for name in ("starlette", "uvicorn", "websockets") if find_spec(name) is None]
    if missing:
        raise ConfigError(f"dashboard: {', '.join(missing)}: {_MISSING}")


def source_of(
    request: DashboardRequest, progress: Callable[[str], AbstractContextManager[Any]]
) -> Live | RecordingSource | NoSource:
    """Return the data source; `progress(what)` is the context in which a recording is read. Raises ConfigError."""
    if request.scenarios is not None:
        from liftgate_hil.dashboard.source import NoSource

        return NoSource()
    if request.recording is not None:
        from liftgate_hil.dashboard.recorded import RecordingSource

        how = read_options(request.recording_channel, request.timezone)
        with progress(f"reading {printable(str(request.recording))}"):
            rig, vehicle = (None if each is None else str(each) for each in (request.rig, request.vehicle))
            return RecordingSource(Path(request.recording), rig, vehicle, how)
    from liftgate_hil.dashboard.live import Live
    from liftgate_hil.operate.attachment.client import Client

    try:
        return Live(Client(_chosen() if request.attach is None else request.attach, request.patience))
    except ConfigError as error:
        if request.attach is None:
            raise
        raise ConfigError([f"{each}; {_running()}" for each in error.issues]) from error


def starter_of(request: DashboardRequest) -> Starter | None:
    """Return the starter of the scenarios in `--scenarios`; None: the page starts none. Raises ConfigError."""
    if request.scenarios is None:
        return None
    from liftgate_hil.config.shipped import shipped_folder
    from liftgate_hil.dashboard.starting import Starter

    flags = ["--bus", request.bus or f"virtual:page-{os.getpid()}"]
    flags += ["--ecu", request.ecu or "reference"]
    for name in ("rig", "vehicle"):
        flags += [] if getattr(request, name) is None else [f"--{name}", str(getattr(request, name))]
    folder, name = Path(request.scenarios), str(request.scenarios)
    return Starter(folder if folder.is_dir() else shipped_folder("scenarios", name) or folder, flags)


def _running() -> str:
    """Return a text that lists the process ids of the running emulators."""
    from liftgate_hil.operate.attachment import endpoint

    found = ", ".join(map(str, endpoint.runs()))
    return f"running: {found}" if found else "none is running"


def _chosen() -> int:
    """Return the process id of the only run. Raises ConfigError where there is none, or several."""
    from liftgate_hil.operate.attachment import endpoint

    found = endpoint.runs()
    if len(found) == 1:
        return found[0]
    if found:
        which = ", ".join(map(str, found))
        raise ConfigError(f"`attach` missing: several runs are active; allowed: one of {which}")
    raise ConfigError(
        f"no emulator of yours is running on this machine{endpoint.unusable()}: start one "
        "(liftgate-hil --bus …), or show `recording` FILE, or start `scenarios` FOLDER from the page"
    )
