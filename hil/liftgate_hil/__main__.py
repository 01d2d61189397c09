"""`liftgate-hil` and `python -m liftgate_hil`: what has to be so before anything else is imported."""

import os
import sys

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
    from liftgate_hil.cli.main import main as command

    return command()


if __name__ == "__main__":
    sys.exit(main())
