"""Find the ECU that is meant by "reference", the path of a C library, "module:Class", or an object."""

from __future__ import annotations

import functools
import importlib
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.ecu.adapter import Adapter, ReferenceEcu
from liftgate_hil.ecu.calibration import CALIBRATED, coded
from liftgate_hil.ecu.foreign import FOREIGN, NoAnswerError
from liftgate_hil.ecu.names import ON_A_BUS, REFERENCE
from liftgate_hil.errors import ConfigError, EcuError, text_of
from liftgate_plant.coding import UNCODED, Coding

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig

_LIBRARY = re.compile(r".+\.(so|dylib|dll)(\.[0-9.]+)?$")
_CLASS = re.compile(r"[\w.]+:\w+$")


def adapter_for(ecu: Any, rig: Rig, drives: int, shares_clock: bool = True, coding: Coding = UNCODED) -> Adapter:
    """Return the adapter of an ECU. Raises ConfigError.

    With `shares_clock` the clock by which the ECU gets requests is the gate's; otherwise it begins when the ECU
    hears the gate. `coding` is the vehicle's, for the reference ECU.
    """
    # Imported only where used, since the import takes time.
    from liftgate_hil.ecu.library import LibraryEcu
    from liftgate_hil.ecu.python_object import PythonEcu

    if not isinstance(ecu, str | Path):
        return PythonEcu(ecu, rig, drives, shares_clock)
    name = str(ecu)
    if name == REFERENCE:
        return ReferenceEcu(rig, drives, shares_clock, coded(CALIBRATED, coding))
    if _LIBRARY.fullmatch(name):
        check_ecu(name)
        return LibraryEcu(Path(name), rig, drives, shares_clock)
    if _CLASS.fullmatch(name):
        another = functools.partial(_instance_of, name)
        return PythonEcu(another(), rig, drives, shares_clock, another)
    raise ConfigError(f"`ecu` {name}: allowed: reference, the path of a shared library, MODULE:CLASS, or bus")


def check_ecu(ecu: Any) -> None:
    """Raise ConfigError where an ECU is a library that does not exist."""
    if is_library(ecu) and not Path(ecu).is_file():
        raise ConfigError(f"`ecu` {ecu}: no such file")


def is_library(ecu: Any) -> bool:
    """Whether an `ecu` is a shared library, whose code may crash or hang."""
    return isinstance(ecu, str | Path) and _LIBRARY.fullmatch(str(ecu)) is not None


def is_foreign(ecu: Any) -> bool:
    """Whether an `ecu` names a user's code, a library or a Python class, which another process can load."""
    return isinstance(ecu, str | Path) and str(ecu) not in (REFERENCE, ON_A_BUS)


def _instance_of(name: str) -> Any:
    """Return an object of "module:Class". Raises ConfigError, EcuError."""
    module, _, attribute = name.partition(":")
    try:
        with FOREIGN:
            return getattr(importlib.import_module(module), attribute)()
    except NoAnswerError:
        raise EcuError(f"`ecu` {name}: no response to the request to stop") from None
    except (Exception, SystemExit) as error:  # a user's module may raise anything
        raise ConfigError(
            f"`ecu` {name}: {type(error).__name__}: {text_of(error)}; allowed: MODULE:CLASS that can be imported "
            "and called without arguments"
        ) from error
