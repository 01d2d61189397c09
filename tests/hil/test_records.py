"""Records that compiled code and plain Python must read alike."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from types import ModuleType

import numpy as np

import liftgate_compiler
import liftgate_hil
import liftgate_plant


def modules() -> Iterator[ModuleType]:
    """Import and yield all modules of the three packages."""
    for package in (liftgate_compiler, liftgate_hil, liftgate_plant):
        for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            if not found.name.endswith("__main__"):
                yield importlib.import_module(found.name)


def test_no_record_field_has_the_name_of_an_attribute_of_numpy_records() -> None:
    """`row.sum` would be the field in compiled code but the method in plain Python."""
    taken = {*dir(np.record), *dir(np.recarray)}
    fields = {
        f"{module.__name__}.{name}": set(value.names or ())
        for module in modules()
        for name, value in vars(module).items()
        if isinstance(value, np.dtype)
    }
    assert "liftgate_hil.ecu.memory.GUARD" in fields
    assert {name: names & taken for name, names in fields.items() if names & taken} == {}
