"""Import of python-can and cantools without asammdf, and collection of their log messages.

python-can imports asammdf, and with it pandas, if they are installed. That takes 0.6 s and serves its MF4 writer
only. `formats.mf4_file` writes MF4 files without python-can, so asammdf is hidden during the import.
"""

import contextlib
import logging
import pickle
import sys
from collections.abc import Iterator
from typing import Any

_hidden = "asammdf" not in sys.modules and "can" not in sys.modules
if _hidden:
    sys.modules["asammdf"] = None  # type: ignore[assignment]  # makes the import fail
try:
    import can
    import cantools
finally:
    if _hidden:
        del sys.modules["asammdf"]

__all__ = ["can", "cantools", "logged", "unpickled"]


def unpickled(content: bytes) -> Any:
    """Return an object from its pickled bytes; rigs are unpickled here, as their messages need cantools."""
    return pickle.loads(content)


@contextlib.contextmanager
def logged(library: str) -> Iterator[list[str]]:
    """Context in which a library's log messages are collected in a list instead of written to stderr."""
    logger, handler = logging.getLogger(library), _Collector()
    logger.addHandler(handler)
    try:
        yield handler.messages
    finally:
        logger.removeHandler(handler)


class _Collector(logging.Handler):
    """Logging handler that keeps all messages."""

    def __init__(self) -> None:
        super().__init__()
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())
