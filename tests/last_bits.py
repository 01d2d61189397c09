"""The suite's switch LAST_BITS=SEED: numbers off by 1e-13, other tolerances and BLAS routines.

A processor with other vector instructions, another libm or another release of scipy gives other last bits. A test
that needs the bits of one machine passes there by luck. With the switch on, tests of the plant, of the reference
and of the identification show it anywhere: `LAST_BITS=3 python -m pytest tests/reference`. Without it all is as
it was.

What is off, by a factor 1 ± 1e-13 that the seed and the name of the number decide:

- numbers of a vehicle where its plant and its load are made from it (`plant_of`, `load_of`), and those of the
  event-located solution's tables and phases: the same all through a run, so that alike drives stay alike;
- voltages, loads and initial angles of the plant's tests (`tests/plant/runs.py`);
- inputs and outputs of what `identify` is given (`Problem`).

`solve_ivp` has 0.3 to 2 times the tolerances and 0.7 to 1 times the longest step that a test gives it. A search of
`identify` ends at 0.3 to 2 times the step at which it would.

Zero, one, and a value at an end of its range (which must not be left) stay; so do switches and counts.
"""

from __future__ import annotations

import functools
import math
import os
import random
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

Value = TypeVar("Value")

VARIABLE = "LAST_BITS"
PARTS = (
    "reference",
    "plant",
    "hil/identification",
    "tools/test_identification_tools.py",
    "tools/last_bits_canary.py",
)
OFF = 1e-13  # relative
TOLERANCES = (0.3, 2.0)  # a solver's tolerance, by that of the test
SHORTER = (0.7, 1.0)  # its longest step

_TESTS = Path(__file__).parent
_STAYS = (0.0, 1.0, -1.0)  # none, whole, and switches
_STILL = 5e-3  # standard deviations: `identify.descent.STILL`
# Each with what of /proc/cpuinfo it needs. OpenBLAS sums in another order in each of them.
_ROUTINES = {"Nehalem": "sse4_2", "Sandybridge": "avx", "Haswell": "avx2", "Zen": "avx2"}

is_active = False  # within a test of PARTS, with the switch on


def seed() -> int:
    """The switch's value, 0 when it is off. Raises SystemExit for what is no whole number above 0."""
    text = os.environ.get(VARIABLE, "")
    if not text:
        return 0
    if not text.isdecimal() or not int(text):
        raise SystemExit(f"{VARIABLE}={text}: allowed: a seed, a whole number from 1 on")
    return int(text)


def is_part(path: Path) -> bool:
    """Whether a test file is among those that run with other last bits."""
    inside = path.relative_to(_TESTS).as_posix() if path.is_relative_to(_TESTS) else ""
    return any(inside == part or inside.startswith(f"{part}/") for part in PARTS)


def choose_routines() -> None:
    """Have OpenBLAS take other routines; before numpy is loaded."""
    info = Path("/proc/cpuinfo")
    flags = info.read_text().split() if info.is_file() else []
    known = [name for name, flag in _ROUTINES.items() if flag in flags]
    if known:
        os.environ.setdefault("OPENBLAS_CORETYPE", _chance("routines").choice(known))


@functools.cache
def factor(name: str) -> float:
    """What a number of this name is multiplied with."""
    chance = _chance(name)
    return 1.0 + OFF * chance.choice((-1.0, 1.0)) * chance.uniform(0.5, 1.0)


def off(value: Value, name: str = "") -> Value:
    """The same value (a number, a NamedTuple, a dataclass, a mapping, a list, an array) with all of its floats a
    little off; the value itself when no test of PARTS runs with the switch on.
    """
    return _off(value, name) if is_active else value


def _off(value: Any, name: str) -> Any:
    import numpy as np

    if isinstance(value, float):
        return value if value in _STAYS or not math.isfinite(value) else value * factor(name)
    if isinstance(value, np.ndarray):
        stays = ~np.isfinite(value) | np.isin(value, _STAYS)
        return np.where(stays, value, value * factor(name))
    if isinstance(value, Mapping):
        return {key: _off(each, f"{name}.{key}") for key, each in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        named = {each.name: getattr(value, each.name) for each in fields(value) if each.init}
        return replace(value, **{key: _off(each, f"{name}.{key}") for key, each in named.items()})
    if hasattr(value, "_fields"):
        return value._make(
            each if _is_end(type(value), key, each) else _off(each, f"{name}.{key}")
            for key, each in zip(value._fields, value, strict=True)
        )
    if isinstance(value, list | tuple):
        return type(value)(_off(each, f"{name}[{place}]") for place, each in enumerate(value))
    return value


def _is_end(kind: type, key: str, value: Any) -> bool:
    """Whether a parameter of the plant lies at an end of its range."""
    quantity = _quantities(kind).get(key)
    return quantity is not None and value in (quantity.low * quantity.scale, quantity.high * quantity.scale)


@functools.cache
def _quantities(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind, include_extras=True)
    return {
        key: hint.__metadata__[0]
        for key, hint in hints.items()
        if hasattr(hint, "__metadata__") and hasattr(hint.__metadata__[0], "scale")
    }


def _chance(name: str) -> random.Random:
    return random.Random(f"{seed()} {name}")


def activate(is_on: bool) -> None:
    """Begin, or end, a test that runs with other last bits."""
    global is_active  # noqa: PLW0603
    is_active = is_on
    from liftgate_hil.identification import descent

    by = _chance("step that no longer counts").uniform(*TOLERANCES) if is_on else 1.0
    descent.STILL = _STILL * by


def install() -> None:
    """Put the switch where numbers go to the plant, to identification and to solvers."""
    import scipy.integrate

    from liftgate_hil.identification.problem import Problem
    from liftgate_plant import vehicle

    for function in (vehicle.plant_of, vehicle.load_of):
        _replace_everywhere(function, _of_another_vehicle(function))
    _replace_everywhere(scipy.integrate.solve_ivp, _less_exact(scipy.integrate.solve_ivp))
    prepare = Problem.__post_init__

    def prepare_others(problem: Problem) -> None:
        problem.data = [_data_off(each) for each in problem.data]
        prepare(problem)

    Problem.__post_init__ = prepare_others  # type: ignore[method-assign]


def _replace_everywhere(function: Callable[..., Any], other: Callable[..., Any]) -> None:
    """In every module that has it by now; those that come later take it from its own."""
    for module in list(sys.modules.values()):
        for name, value in list(getattr(module, "__dict__", {}).items()):
            if value is function:
                setattr(module, name, other)


def _of_another_vehicle(function: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(function)
    def other(vehicle: Any) -> Any:
        # Both drives' numbers by the same names, so that alike ones stay alike.
        sides = {side: off(getattr(vehicle, side), "drive") for side in ("left", "right")}
        bodies = ("gate", "seal", "latch", "supply", "environment")
        rest = {name: off(getattr(vehicle, name), name) for name in bodies}
        return function(vehicle._replace(**sides, **rest))

    return other


def _less_exact(solver: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(solver)
    def other(*arguments: Any, **options: Any) -> Any:
        if is_active:
            by = _chance("tolerance").uniform(*TOLERANCES)
            for name, usual in (("rtol", 1e-3), ("atol", 1e-6)):  # scipy's own, where none is given
                options[name] = options.get(name, usual) * by
            if "max_step" in options:
                options["max_step"] *= _chance("longest step").uniform(*SHORTER)
        return solver(*arguments, **options)

    return other


def _data_off(data: Any) -> Any:
    """Measured data with other last bits: a count stays one."""
    import numpy as np

    if not is_active:
        return data
    inputs = [off(column, f"input {k}") for k, column in enumerate(data.inputs.T)]
    outputs = {
        name: values if name.endswith("_position_rev") else off(values, name)
        for name, values in data.outputs.items()
    }
    return replace(data, inputs=np.column_stack(inputs), outputs=outputs)
