"""A run in a process of its own: the worker's side of `isolation`.

python -P -m liftgate_hil.worker ROWS FRAMES MEMORY ANSWER       sizes, then descriptors; the job is on stdin
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import sys
from pathlib import Path

from liftgate_hil.errors import LiftgateError
from liftgate_hil.loop.rings import Memory
from liftgate_hil.runs.in_process import run_job
from liftgate_hil.runs.job import Job

_PDEATHSIG = 1  # PR_SET_PDEATHSIG


def main() -> int:
    """Run the job; its result, or what was raised, is the answer."""
    ctypes.CDLL(None).prctl(
        _PDEATHSIG, signal.SIGKILL, 0, 0, 0
    )  # nobody is left who waits for the answer
    rows, frames, descriptor, answer = (int(each) for each in sys.argv[1:5])
    job: Job = pickle.loads(sys.stdin.buffer.read())
    for each in (descriptor, answer):
        os.set_inheritable(each, False)  # by what an ECU starts
    if ":" in str(job.ecu):
        sys.path.append(str(Path.cwd()))  # last, as for an ECU in the first process
    memory = Memory(rows, frames, descriptor)
    result: object
    try:
        result = run_job(job, (), lambda: bool(memory.shared.control.stop[0]), memory)
    except LiftgateError as error:
        result = error
    with os.fdopen(answer, "wb") as stream:
        pickle.dump(result, stream)
    return 0


if __name__ == "__main__":
    sys.exit(main())
