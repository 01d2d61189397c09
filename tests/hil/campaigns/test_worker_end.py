"""End of a campaign's worker: a signal that comes while it ends is no error."""

from __future__ import annotations

import os
import pickle
import socket
import subprocess
import sys

from liftgate_hil.campaigns.base import Base
from liftgate_hil.isolate.children import in_memory

SENDS_ITSELF_A_SIGNAL = """
import atexit, os, signal, sys
atexit.register(lambda: os.kill(os.getpid(), signal.SIGTERM))
from liftgate_hil.campaigns.executors.worker import main
sys.exit(main())
"""


def test_a_worker_that_ends_by_itself_does_not_heed_the_request_to_end(base: Base) -> None:
    """The caller closes the connection, at which it ends, and sends SIGTERM at the same time."""
    ours, theirs = socket.socketpair()
    given = in_memory(pickle.dumps((pickle.dumps(base), sys.path)))
    ours.close()
    with theirs:
        done = subprocess.run(
            [sys.executable, "-c", SENDS_ITSELF_A_SIGNAL, str(theirs.fileno()), str(given)],
            pass_fds=[theirs.fileno(), given], capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
    os.close(given)
    assert (done.returncode, done.stderr) == (0, "")
