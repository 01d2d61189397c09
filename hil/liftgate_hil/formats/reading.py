"""Readers of other packages, whose errors are raised as ConfigError, and text files that were cut off."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from liftgate_hil.errors import ConfigError

DAMAGED = "truncated or damaged"


@contextmanager
def foreign_reader(path: Path, kind: str, package: str) -> Iterator[None]:
    """Raise errors in the context as ConfigError.

    Files of this kind need a package, which the extra with the name of the kind installs.
    """
    with as_config_errors(path):
        try:
            yield
        except ImportError as error:
            raise ConfigError(
                f"{path}: {kind} needs {package}; allowed after: pip install 'liftgate-hil[{kind.lower()}]'"
            ) from error


@contextmanager
def as_config_errors(path: Path) -> Iterator[None]:
    """Raise errors in the context, in which a file is read, as ConfigError."""
    try:
        yield
    except ConfigError:
        raise
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # readers raise errors of their own, or of their parsers
        raise ConfigError(f"{path}: cannot be read: {cause_text(error)}") from error


def cause_text(error: Exception) -> str:
    """Return what another package's reader has raised, in one line; of damage that it is some."""
    if isinstance(error, struct.error | EOFError | zlib.error):
        return DAMAGED
    return " ".join(str(error).split()) or type(error).__name__
