"""Find the ECU for a value of `ecu`: "reference", the path of a C library, "module:Class", or an object."""

from __future__ import annotations

import functools
import importlib.machinery
import importlib.util
import re
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.ecu.adapter import Adapter, ReferenceEcu
from liftgate_hil.ecu.calibration import CALIBRATED, coded
from liftgate_hil.ecu.foreign import FOREIGN, NoAnswerError
from liftgate_hil.ecu.names import ON_A_BUS, REFERENCE
from liftgate_hil.errors import ConfigError, EcuError, place_of, text_of
from liftgate_plant.coding import UNCODED, Coding

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig

_LIBRARY = re.compile(r".+\.(so|dylib|dll)(\.[0-9.]+)?", re.DOTALL)
_CLASS = re.compile(r"\w+(\.\w+)*:\w+")
_COMPILERS = {".c": "cc", ".cc": "c++", ".cpp": "c++", ".cxx": "c++"}
_ALLOWED = "reference, the path of a shared library, MODULE:CLASS, or bus"


def adapter_for(ecu: Any, rig: Rig, drives: int, shares_clock: bool = True, coding: Coding = UNCODED) -> Adapter:
    """Return the adapter of an ECU, given by name or as an object. Raises ConfigError.

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
    check_ecu(name)
    if is_library(name):
        return LibraryEcu(Path(name), rig, drives, shares_clock)
    another = functools.partial(_instance_of, name)
    return PythonEcu(another(), rig, drives, shares_clock, another, name)


def check_ecu(ecu: Any) -> None:
    """Raise ConfigError if an ECU's name has no allowed form, or its library or module cannot be found."""
    if not is_foreign(ecu):
        return
    name = str(ecu)
    if is_library(name):
        if not Path(name).is_file():
            raise ConfigError(f"`ecu` {name}: no such file")
    elif _CLASS.fullmatch(name) and not _names_file(name):
        top = re.split("[.:]", name, maxsplit=1)[0]
        if not _is_module(top):
            if name.startswith("mutant:"):
                raise ConfigError(
                    f"`ecu` {name}: a mutant is run by liftgate-hil test and campaign; allowed: {_ALLOWED}"
                )
            raise ConfigError(f"`ecu` {name}: no module {top} in {Path.cwd()}, nor installed")
    else:
        raise ConfigError(f"`ecu` {name}: {_advice(name)}allowed: {_ALLOWED}")


def _names_file(name: str) -> bool:
    """Whether a name has the form FILE.py:CLASS, a Python file with a class in it."""
    return name.partition(":")[0].endswith(".py")


def _is_module(name: str) -> bool:
    """Whether a module without a dot in its name is loaded, installed, or in the working directory."""
    if name in sys.modules:
        return True
    found = importlib.util.find_spec(name) or importlib.machinery.PathFinder.find_spec(name, [str(Path.cwd())])
    return found is not None


def _advice(name: str) -> str:
    """Return a hint at what an invalid ECU name may have meant, as the start of a sentence; "": none."""
    path = Path(name)
    if path.suffix in _COMPILERS:
        compiler = _COMPILERS[path.suffix]
        return f"source code; its shared library is needed: {compiler} -shared -fPIC -o {path.stem}.so {name}; "
    if path.suffix == ".py" or _names_file(name):
        file, _, attribute = name.partition(":")
        path = Path(file)
        if not path.is_file():
            return f"{file}: no such file; "
        # Modules are found below the working directory.
        is_below = not path.is_absolute() and ".." not in path.parts
        module = ".".join(path.with_suffix("").parts) if is_below else path.stem
        if not all(map(str.isidentifier, module.split("."))):
            return "a Python file, but no module, for its name; rename it with letters, digits and _; "
        where = "" if is_below else f", with PYTHONPATH={shlex.quote(str(path.parent))}"
        name = attribute if attribute.isidentifier() else "CLASS"
        return f"a Python file; name its module and class: {module}:{name}{where}; "
    if all(map(str.isidentifier, name.split("."))) and Path(*name.split(".")).with_suffix(".py").is_file():
        return f"a module; name its class, too: {name}:CLASS; "
    if path.is_file():
        return "neither a shared library (.so) nor a Python class; a program of its own is reached by a bus; "
    from difflib import get_close_matches  # imported only where used, since the import takes time

    near = get_close_matches(name.lower(), (REFERENCE, ON_A_BUS), 1)
    return f"did you mean {near[0]}? " if near else ""


def is_library(ecu: Any) -> bool:
    """Whether an `ecu` names a shared library, whose code may crash or hang."""
    return isinstance(ecu, str | Path) and _LIBRARY.fullmatch(str(ecu)) is not None


def is_foreign(ecu: Any) -> bool:
    """Whether an `ecu` is the name of a user's code, a library or a Python class; False for an object."""
    return isinstance(ecu, str | Path) and str(ecu) not in (REFERENCE, ON_A_BUS)


def _instance_of(name: str) -> Any:
    """Return an instance of the class in "module:Class". Raises ConfigError; EcuError where its code hangs."""
    module, _, attribute = name.partition(":")
    try:
        with FOREIGN:
            loaded = importlib.import_module(module)
            if hasattr(loaded, attribute):
                return getattr(loaded, attribute)()
    except NoAnswerError:
        raise EcuError(f"`ecu` {name}: no response to the request to stop") from None
    except (Exception, SystemExit) as error:  # a user's module may raise anything
        raise ConfigError(
            f"`ecu` {name}: {type(error).__name__}: {text_of(error)}{place_of(error)}; allowed: MODULE:CLASS that "
            "can be imported and called without arguments"
        ) from error
    own = [key for key, each in vars(loaded).items() if isinstance(each, type) and each.__module__ == module]
    raise ConfigError(
        f"`ecu` {name}: {module} ({getattr(loaded, '__file__', None) or 'built in'}) has no {attribute}; allowed: "
        f"{', '.join(f'{module}:{each}' for each in own) or 'MODULE:CLASS that the module has'}"
    )
