"""Everything around the plant: bus, loop, scenarios, recordings, the reference ECU and the commands."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str


def __getattr__(name: str) -> object:
    """What is looked up only where it is asked for, so that an import costs nothing."""
    if name == "__version__":
        from liftgate_hil.version import version

        return version()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
