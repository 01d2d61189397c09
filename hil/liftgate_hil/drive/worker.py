"""Run in a process of its own: the worker's side of `isolation`.

python -P -m liftgate_hil.drive.worker ROWS FRAMES MEMORY TOLD CALLER      address and plan are on stdin

ROWS and FRAMES are sizes, MEMORY and TOLD descriptors (see `supervise`), CALLER is the id of the process that
waits. Before any foreign code runs, the process splits into a supervisor and the worker itself, and the worker
holds no descriptor that its caller reads from.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import sys
import threading
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING

from liftgate_hil.errors import EcuError, LiftgateError, is_of_this_program, place_in, place_of, text_of
from liftgate_hil.isolate.answers import PLACE, send_answer
from liftgate_hil.isolate.supervisor import dies_with_parent, supervise

if TYPE_CHECKING:
    from liftgate_hil.loop.rings import Memory

_CANNOT_ANSWER = 71  # exit code (EX_OSERR, sysexits.h)
_PULSE_S = 0.1
_dumps = pickle.dumps  # an ECU's code may put something else in its place


def main() -> int:
    """Run stdin's pickled plan, send its result or the error raised to the caller, and return the exit code."""
    rows, frames, descriptor, status_fd, caller = (int(each) for each in sys.argv[1:6])
    dies_with_parent(caller)  # nobody is left to wait for the answer
    supervise(ends_at_once=True, status_fd=status_fd)
    from liftgate_hil.loop.rings import Memory

    memory = Memory(rows, frames, descriptor, others_write=True)
    os.close(descriptor)
    address, path, plan = pickle.loads(sys.stdin.buffer.read())
    threading.Thread(target=_beat, args=(memory, address), daemon=True).start()
    # Appended last, so that a module of an ECU does not hide one that this program needs.
    sys.path += [each for each in (*path, str(Path.cwd())) if each and each not in sys.path]
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    result = _result_of(plan, memory)
    try:
        send_answer(address, _dumps(result))
    except OSError as error:
        print(f"liftgate-hil: the run's answer could not be sent: {error}", file=sys.stderr)
        return _CANNOT_ANSWER
    return 0


def _beat(memory: Memory, address: tuple[str, bytes]) -> None:
    """Count up in `memory` while the interpreter lock is free; when asked, answer once where the ECU's code is."""
    control = memory.shared.control[0]
    while not control.asked:
        control.pulse += 1
        time.sleep(_PULSE_S)
    main = threading.main_thread().ident
    with contextlib.suppress(OSError):
        place = place_in(traceback.extract_stack(sys._current_frames().get(main or 0)))  # "": it does not run
        send_answer(address, PLACE + place.encode(errors="backslashreplace"))


def _result_of(pickled: bytes, memory: Memory) -> object:
    """Return the result of a pickled plan, or the error that ended it."""
    from liftgate_hil.config.can_libraries import unpickled
    from liftgate_hil.drive.run import run_plan
    from liftgate_hil.plan.plan import Plan

    control = memory.shared.control

    def stopped() -> bool:
        control.beats += 1
        return bool(control.stop[0])

    rate = 1.0
    try:
        plan: Plan = unpickled(pickled)
        rate = plan.request.rate
        return run_plan(plan, (), stopped, memory)
    except LiftgateError as error:
        return error
    except BaseException as error:  # also an exit or an interrupt that foreign code raised
        text = f"{type(error).__name__}: {text_of(error)}".rstrip(": ")
        who = "the ECU"
        calls = traceback.extract_tb(error.__traceback__)
        if calls and is_of_this_program(Path(calls[-1].filename)):
            traceback.print_exception(error)
            who = "the run's process"
        ticks = int(control.tick[0])
        return EcuError(f"{who} at {ticks / rate:.3f} s: {text}{place_of(error)}", ticks)


if __name__ == "__main__":
    sys.exit(main())
