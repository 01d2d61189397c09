"""Entry point of `liftgate-hil` and `python -m liftgate_hil`, with settings needed before other imports."""

import gc
import os
import sys

_FIRST, _LAST = (3, 11), (3, 13)  # Pythons that were tried; as requires-python of pyproject.toml
_OBJECTS = 200_000  # allocations before Python searches for cycles; a start makes half as many, without garbage

if not _FIRST <= sys.version_info[:2] <= _LAST:
    sys.stderr.write(f"liftgate-hil: Python {sys.version.split()[0]}; allowed: 3.{_FIRST[1]} to 3.{_LAST[1]}\n")
    sys.exit(2)

if __name__ == "__main__" and not sys.flags.safe_path:
    # `-m` puts the working directory first: a file there that is called numpy.py would be run. For the same reason
    # pathlib is not imported yet.
    _home = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if os.path.isdir(".") and sys.path[0] == os.getcwd() != _home:
        del sys.path[0]

try:
    import signal
except KeyboardInterrupt:  # the import of Python's own module takes a while
    sys.exit(130)


def main() -> int:
    """Run the command line; return the exit code."""
    # Until there is something to shut down, Ctrl-C ends the process: importing takes a while, and a
    # KeyboardInterrupt would be raised in the middle of it.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.set_threshold(_OBJECTS)
    from liftgate_hil.cli.main import main as command

    return command()


if __name__ == "__main__":
    sys.exit(main())
