"""A run in a process of its own, for ECUs that may crash, hang or keep statics: its library is loaded afresh.

    python -P -m liftgate_hil.worker ROWS FRAMES MEMORY ANSWER       descriptors; the job comes on stdin

The parent sees the loop's memory and so knows how far it has come.
"""

from __future__ import annotations

import os
import pickle
import select
import signal
import subprocess
import sys
import time
from contextlib import suppress

from liftgate_hil.errors import ConfigError, LiftgateError
from liftgate_hil.loop.closed_loop import FRAMES, ROWS
from liftgate_hil.loop.rings import Memory
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.runs import Job, Result, run_job

HANG_S = 10.0  # without a tick
_LOOK_S = 0.05


def run_in_worker(job: Job, hang_s: float = HANG_S) -> Result:
    """Run a job; a crash and a hang are its result's verdict. Raises ConfigError."""
    memory = Memory(ROWS, FRAMES)
    answer, given = os.pipe()
    command = [
        sys.executable, "-P", "-m", __name__,
        str(ROWS), str(FRAMES), str(memory.descriptor), str(given),
    ]  # fmt: skip
    try:
        child = subprocess.Popen(
            command, stdin=subprocess.PIPE, pass_fds=[memory.descriptor, given]
        )
        os.close(given)
        assert child.stdin is not None
        with suppress(BrokenPipeError):
            child.stdin.write(pickle.dumps(job))
            child.stdin.close()
        try:
            return _wait(child, answer, memory, job, hang_s)
        finally:
            child.kill()
            child.wait()
    finally:
        os.close(answer)
        memory.close()


def _wait(
    child: subprocess.Popen[bytes], answer: int, memory: Memory, job: Job, hang_s: float
) -> Result:
    """The worker's answer, or what became of it."""
    parts: list[bytes] = []
    control = memory.shared.control[0]
    ticked, since = -1, time.monotonic()
    while True:
        if select.select([answer], [], [], _LOOK_S)[0]:
            part = os.read(answer, 1 << 20)
            if not part:
                break
            parts.append(part)
            continue
        now = time.monotonic()
        if int(control.tick) != ticked:
            ticked, since = int(control.tick), now
        elif ticked > 0 and not parts and now - since > hang_s:
            return _failed(
                job, f"the ECU at {ticked / job.options.rate:.3f} s: no answer for {hang_s:g} s"
            )
    status = child.wait()
    if parts:
        result = pickle.loads(b"".join(parts))
        if isinstance(result, LiftgateError):
            raise result
        assert isinstance(result, Result)
        return result
    why = f"exit code {status}" if status >= 0 else signal.Signals(-status).name
    seconds = int(control.tick) / job.options.rate
    return _failed(job, f"the ECU at {seconds:.3f} s: its process ended ({why})")


def _failed(job: Job, reason: str) -> Result:
    return Result(
        verdict="error",
        reason=reason,
        maxima={},
        minima={},
        events=(),
        summary=Summary(clock=job.options.clock),
        recording=job.options.records,
    )


def main() -> int:
    """The worker's side."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C is for the parent
    rows, frames, descriptor, answer = (int(each) for each in sys.argv[1:5])
    job: Job = pickle.loads(sys.stdin.buffer.read())
    memory = Memory(rows, frames, descriptor)
    result: Result | ConfigError
    try:
        result = run_job(job, memory=memory)
    except LiftgateError as error:
        result = error  # type: ignore[assignment]
    with os.fdopen(answer, "wb") as stream:
        pickle.dump(result, stream)
    return 0


if __name__ == "__main__":
    sys.exit(main())
