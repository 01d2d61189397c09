"""Linking of compiled code: entry points with all that they call; helpers are inlined only."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from liftgate_compiler import CompileError, building, compilable, compiled, enabled, obtaining, outlined
from liftgate_compiler.kinds import NumberKind

pytestmark = pytest.mark.skipif(not enabled(), reason="needs the compiler")


@pytest.fixture(scope="module", autouse=True)
def empty_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Use an empty cache, so that everything is compiled."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@compilable
def deepest(x: float) -> float:
    if x > 1000.0:
        raise ValueError("too large")
    return x + 1.0


@compilable
def left(x: float) -> float:
    return deepest(2.0 * x)


@compilable
def right(x: float) -> float:
    return deepest(x) * left(x)


@compilable
def diamond(x: float) -> float:
    return left(x) + right(x)


@compilable
def other_entry(x: float) -> float:
    return right(x) - deepest(x)


@compilable
def never_compiled(x: float) -> float:
    return left(x) - 1.0


@outlined
def apart(x: float) -> float:
    return deepest(x) * 3.0


@compilable
def calling(x: float) -> float:
    return apart(x) + apart(2.0 * x) + apart(3.0 * x)


def made_object(function: Any) -> bytes:
    from liftgate_compiler import making

    return making.make(function, [NumberKind("f")], {deepest, left, right, apart}, {apart}).code


def made_code(function: Any) -> bytes:
    from llvmlite.binding import ObjectFileRef

    sections = ObjectFileRef.from_data(made_object(function)).sections()
    return b"".join(each.data() for each in sections if each.is_text())


def test_helpers_shared_by_entry_points_are_inlined_and_leave_no_code_or_names_behind():
    assert compiled(diamond)(3.0) == diamond(3.0) == 35.0
    assert compiled(other_entry)(3.0) == other_entry(3.0)
    assert len(made_code(diamond)) < 1000
    assert len(made_object(diamond)) < 5000  # numba's names for them are longer than the code


def absent(name: str) -> str:
    raise metadata.PackageNotFoundError(name)


def test_only_tested_versions_of_numba_are_allowed(monkeypatch: pytest.MonkeyPatch):
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lowest, highest = building.NUMBA
    assert f"numba>={lowest},<={highest}" in project["dependencies"]
    building.check_numba()
    for installed in ("0.65.1", "0.68.2", "0.69.0rc1", "1.0"):
        monkeypatch.setattr(building.metadata, "version", {"numba": installed}.__getitem__)
        with pytest.raises(CompileError) as told:
            obtaining.machine_code_of(never_compiled, (NumberKind("f"),))
        wanted = f"{lowest} to {highest} (python -m pip install 'numba>={lowest},<={highest}')"
        assert str(told.value) == f"numba {installed} is installed; allowed: {wanted}"
    monkeypatch.setattr(building.metadata, "version", absent)
    with pytest.raises(CompileError, match=r"^numba is not installed; allowed: 0\.66 to"):
        building.check_numba()


def test_outlined_code_is_a_separate_function():
    function = rb"\0_ZN[^\0]*5"  # a symbol
    assert re.search(function + b"apart", made_object(calling))
    assert not re.search(function + b"right", made_object(diamond))
    assert compiled(calling)(3.0) == calling(3.0) == 63.0
    with pytest.raises(RuntimeError, match="calling raised an exception"):
        compiled(calling)(500.0)


def test_an_exception_in_machine_code_is_reported_with_the_entry_points_name():
    with pytest.raises(RuntimeError, match="diamond raised an exception in machine code"):
        compiled(diamond)(1000.0)
    assert compiled(diamond)(3.0) == 35.0


def test_other_numba_code_can_call_helpers_too():
    import numba

    made_object(diamond)  # numba knows the helpers from now on
    theirs = numba.njit(lambda x: right(x) + 1.0)
    assert theirs(3.0) == right(3.0) + 1.0
