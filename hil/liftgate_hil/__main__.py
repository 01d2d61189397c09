"""`liftgate-hil` and `python -m liftgate_hil`: what has to be so before anything else is imported."""

import gc
import os
import sys

_OBJECTS = 100_000  # before Python looks for cycles among them; as many as a start makes, and none is garbage

if __name__ == "__main__" and not sys.flags.safe_path:
    # `-m` puts the working directory first: a file there that is called numpy.py would be run. Nor has pathlib
    # been imported.
    _home = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if os.path.isdir(".") and sys.path[0] == os.getcwd() != _home:
        del sys.path[0]

try:
    import signal
except KeyboardInterrupt:  # it is Python's own module that takes a while
    sys.exit(130)


def main() -> int:
    """The command line; returns the exit code."""
    # Until there is something to end in order, Ctrl-C ends the process: importing takes a while, and a
    # KeyboardInterrupt would come out of the middle of it.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.set_threshold(_OBJECTS)
    from liftgate_hil.cli.main import main as command

    return command()


if __name__ == "__main__":
    sys.exit(main())
