"""Readers of other packages: what goes wrong in them is told as what goes wrong with a file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from liftgate_hil.errors import ConfigError


@contextmanager
def foreign_reader(path: Path, kind: str, package: str) -> Iterator[None]:
    """What goes wrong in here is told as ConfigError; files of that kind need a package, which the extra of the
    kind's name installs.
    """
    try:
        yield
    except ConfigError:
        raise
    except ImportError as error:
        raise ConfigError(
            f"{path}: {kind} needs {package}; allowed after: pip install 'liftgate-hil[{kind.lower()}]'"
        ) from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (
        Exception
    ) as error:  # such readers raise errors of their own, or what their parsers raise
        said = " ".join(str(error).split()) or type(error).__name__
        raise ConfigError(f"{path}: cannot be read: {said}") from error
