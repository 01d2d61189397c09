"""Child process `liftgate-hil dashboard` that shows the run of this process."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING

from liftgate_hil.dashboard.listening import bound, new_token
from liftgate_hil.dashboard.opening import check_installed
from liftgate_hil.dashboard.request import LISTEN, RunPage, address_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.isolate.children import end, foreign_output
from liftgate_hil.isolate.supervisor import dies_with_parent

if TYPE_CHECKING:
    from liftgate_hil.loop.listener import Listener

_LEAVES_S = 2.0  # s for the process to end, from which nothing can be lost
_BEGIN_S = 600.0  # s until a run begins, which may have to be compiled before


@contextlib.contextmanager
def page_process(page: RunPage, clock: str, listener: Listener) -> Iterator[None]:
    """Context in which a child process shows the run of this process, if requested. Raises ConfigError."""
    if not page.dashboard:
        yield
        return
    if clock == "free":
        text = "a run on the free clock ends at once; allowed: clock realtime or lockstep"
        raise ConfigError(f"`dashboard`: {text}")
    check_installed()
    new_token()  # checks the token of the environment
    listen = page.listen or LISTEN
    wire = bound(address_of(listen))
    command = [sys.executable, "-P", "-m", "liftgate_hil", "dashboard", "--listen", listen]
    command += ["--attach", str(os.getpid()), "--patience", str(_BEGIN_S)]
    command += ["--descriptor", str(wire.fileno())]
    command += ["--read-only"] if page.read_only else []
    child = subprocess.Popen(
        command,
        stdout=foreign_output(),
        start_new_session=True,  # Ctrl-C shall reach only the run
        pass_fds=[wire.fileno()],
        preexec_fn=dies_with_parent,  # noqa: PLW1509
    )
    host, port = wire.getsockname()[:2]
    wire.close()
    again = f"liftgate-hil dashboard --attach {os.getpid()} --listen {f'[{host}]' if ':' in host else host}:{port}"
    again += " --read-only" if page.read_only else ""
    has_ended = threading.Event()  # the run

    def watch() -> None:
        code = child.wait()
        if not has_ended.is_set():
            listener.say(f"the page has ended (exit code {code}), the run goes on; to have one again: {again}")

    watcher = threading.Thread(target=watch, name="page", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        has_ended.set()
        end(child, _LEAVES_S)
        watcher.join(_LEAVES_S)
