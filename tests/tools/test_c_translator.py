"""The plant translated to C equals the plant bit for bit; other constructs are refused."""

from __future__ import annotations

import ctypes
import functools
import math
import shutil
import textwrap
from pathlib import Path
from typing import NamedTuple

import pytest

from liftgate_compiler import compiled
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant.bridge import DriveInput
from liftgate_plant.dynamics import Inputs
from liftgate_plant.initial import initial_state
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.vehicle import load_of, plant_of
from tests.plant.runs import BRAKE, CLOSE, COAST, OPEN
from tools.c_translator.build import (
    BUILDS,
    USUAL,
    Build,
    Point,
    build,
    compare,
    many_steps,
    points,
    source,
    translated_steps,
)
from tools.c_translator.translate import NotInSubsetError, translate

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
STEPS, PLAIN_STEPS = 2500, 40


@functools.cache
def built(how: Build) -> ctypes.CDLL:
    """Library of a build, made once."""
    return build(how)


@pytest.fixture(scope="module")
def library() -> ctypes.CDLL:
    return built(USUAL)


FAIR = [
    pytest.param(each, id=each.name, marks=pytest.mark.skipif(
        not each.is_installed, reason=f"needs {each.compiler}"
    ))
    for each in BUILDS if each.is_fair
]  # fmt: skip


def phases() -> list[tuple[DriveInput, DriveInput, dict[str, object]]]:
    """Inputs of drives and surroundings that lead a gate through all regimes of the plant."""
    rod = Obstacle(math.radians(25.0), 0.8, 20e3, 100.0, 0.01, 1.0)
    free = {"latch_released": 1.0}
    return [
        (BRAKE, BRAKE, {}),
        (OPEN, OPEN, free),
        (DriveInput(0.4, 0.0, 0.0), OPEN, {**free, "ambient_temperature": -20.0}),
        (COAST, COAST, free),
        (BRAKE, COAST, {**free, "road_slope": math.radians(12.0), "snow_mass": 25.0}),
        (CLOSE, CLOSE, {**free, "obstacle": rod}),
        (CLOSE, CLOSE, {**free, "obstacle": rod, "hand_force": -50.0}),
        (DriveInput(0.0, -9.0, 0.0), CLOSE, {**free, "supply_voltage": 9.5}),
        (CLOSE, CLOSE, free),
        (CLOSE, CLOSE, free),
        (CLOSE, CLOSE, {"wind_pressure": 30.0}),
        (BRAKE, BRAKE, {}),
        (OPEN, OPEN, {}),
    ]


@needs_gcc
@pytest.mark.parametrize("step", [1e-3, 1e-4, 5e-3])
@pytest.mark.parametrize("vehicle_name", ["suv", "heavy-suv", "compact"])
def test_the_translation_equals_the_plant_bit_for_bit(
    library: ctypes.CDLL, vehicle_name: str, step: float
) -> None:
    """The plant is compiled twice, by numba and by gcc."""
    vehicle = vehicle_from(vehicle_name)
    plant = plant_of(vehicle)
    state = initial_state(plant, 0.0, latched=True)
    angles, latched = [], []
    for left, right, changes in phases():
        point = Point(plant, state, Inputs(left, right, load_of(vehicle)._replace(**changes)))
        if step == 1e-3:
            plain = many_steps(*point, step, PLAIN_STEPS)
            assert translated_steps(library, point, step, PLAIN_STEPS) == plain
        expected = compiled(many_steps)(*point, step, STEPS)
        assert translated_steps(library, point, step, STEPS) == expected
        state = expected
        angles.append(state.gate_angle)
        latched.append(state.latched)
    if step == 1e-3:  # long enough for the whole way
        assert max(angles) > 0.8
        assert latched[0] == latched[-1] == 1.0
        assert 0.0 in latched


@pytest.mark.parametrize("how", FAIR)
def test_every_compared_c_build_equals_the_plant_at_the_timed_points(how: Build) -> None:
    """Each build takes gcc some seconds."""
    library = built(how)
    for point in points().values():
        expected = compiled(many_steps)(*point, 1e-3, 2000)
        assert translated_steps(library, point, 1e-3, 2000) == expected


@needs_gcc
def test_the_c_comparison_has_a_ratio_for_every_point_and_build(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tools.c_translator.build.build", built)
    figures = compare(rounds=1, builds=BUILDS[:2])
    assert figures.keys() == points().keys()
    for each in figures.values():
        assert each.fastest() in {BUILDS[0].name, BUILDS[1].name}
        assert all(each.ratio(build.name) > 0.01 for build in BUILDS[:2])


def test_the_translated_source_is_readable_c() -> None:
    text = source()
    assert "static double gate_lever(const Linkage *link, double angle)\n{" in text
    assert "    const double s = link->body_radius;" in text
    assert max(map(len, text.splitlines())) <= 100


class Pair(NamedTuple):
    first: float
    second: float


ORIGIN = Pair(0.0, -1.5)
CODES = 3


def swapped(pair: Pair) -> tuple[float, float]:
    a, b = pair
    a, b = b, a
    return a, b


def everything(x: float, n: int, pair: Pair) -> Pair:
    total = 0.0
    for i in range(n):
        if i != 2:
            inner = x - (x - 1.0) - x if i == 1 or i == CODES else i / 2.0
            total += inner
    for down in range(3, 0, -1):
        last = total
        total = max(last, min(x, 5.0))
        total = max(total, -x) * (-1.0 if 0.0 < x <= 1.0 else 1.5)
        if total > 1e9:
            break
        if total < 0.0:
            low = down - x
        else:
            if x > 1.0:
                low = 1.0
            else:
                low = 2.0
            low *= 3.0 - x
        total -= low - x
    double = Pair(total, 2.0)
    first, _ = swapped(double)
    other = Pair(pair.first, first)
    return Pair(abs(total) + pair.first, other.second + ORIGIN.second)


def calls_everything(plant: Pair, state: Pair, inputs: Pair, step: float) -> Pair:
    pair = Pair(state.second, plant.first - inputs.first)
    return everything(state.first + step, 5, pair)


@needs_gcc
@pytest.mark.parametrize("x", [-1.0, 0.3, 1.0, 7.5])
def test_every_construct_of_the_subset_gives_the_same_result_in_c_and_python(
    x: float, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start, more = Pair(x, 1.0 / 3.0), Pair(0.1, 0.7)
    text = translate(calls_everything)
    loop = """
    void step_many(const Pair *plant, Pair *state, const Pair *inputs, double step, int64_t count)
    { *state = test_c_translator_calls_everything(plant, state, inputs, step); }
    void restart_many(void) { }
    """
    monkeypatch.setattr("tools.c_translator.build.source", lambda: text + loop)
    monkeypatch.setattr("tools.c_translator.build.State", Pair)
    result = translated_steps(build(), Point(more, start, more), 0.25, 1)  # type: ignore[arg-type]
    assert result == calls_everything(more, start, more, 0.25)


def power(x: float) -> float:
    return x**2


def calls(x: float) -> float:
    return power(x)


@pytest.mark.parametrize(
    ("signature", "body", "reason"),
    [
        ("(x: float) -> float", "return sum([x])", r"Call `sum\(\[x\]\)`"),
        ("(x: float) -> float", "return math.gamma(x)", r"Call `math.gamma\(x\)`"),
        ("(x: float) -> float", "return 1.0 if x else 0.0", "`x` is no bool"),
        ("(pair: Pair) -> Pair", "pair = Pair(1.0, 2.0)\nreturn pair", "struct parameter that is assigned: pair"),
        ("(x: float) -> float", "y = 1\ny = x\nreturn y", "float.* where .*int.* is needed"),
        ("(x: float) -> float", "for i in range(3):\n    x += i\nreturn x + i", "i has no value here"),
        ("(x) -> float", "return x", "parameter x without annotation"),
        ("(x: float) -> float", "return refused(x)", "a recursive call of refused"),
        ("(x: float) -> float", "try:\n    x = 1.0\nfinally:\n    x = 2.0\nreturn x", "Try"),
        ("(x: float) -> float", "name = 'x'\nreturn name", "a constant of type str"),
        ("(x: float) -> float", "while x < 1.0:\n    x += 1.0\nreturn x", "While"),
        ("(x: float) -> float", "for _ in range(3):\n    continue\nreturn x", "Continue"),
        ("(x: float) -> float", "y: float = x\nreturn y", "AnnAssign"),
        ("(x: float) -> bool", "return x in {1.0, 2.0}", r"Compare `x in \{1.0, 2.0\}`"),
        ("(pair: Pair) -> float", "return pair[0]", r"Subscript `pair\[0\]`"),
        ("(pair: Pair) -> Pair", "return pair._replace(second=0.0)", r"Call `pair._replace\(second=0.0\)`"),
        ("(x: float) -> Pair", "return Pair(second=x, first=x)", r"Call `Pair\(second=x, first=x\)`"),
        ("(x: float) -> Pair", "return Pair(x)", "1 values where 2 are needed"),
        ("(x: float = 0.0) -> float", "return x", "parameters other than plain ones"),
        ("(pair: Pair) -> Pair", "pair.first += 1.0\nreturn pair", r"AugAssign `pair.first \+= 1.0`"),
        ("(x: float) -> float", "return float(x)", r"Call `float\(x\)`"),
        ("(n: int) -> float", "return n / 2", "arithmetic of two ints: `n / 2`"),
        ("(x: float) -> float", "return max(x, 1.0, 2.0)", r"Call `max\(x, 1.0, 2.0\)`"),
        (
            "(x: float) -> tuple[float, float]",
            "return swapped(Pair(x, x))",
            "a struct without a name as an argument",
        ),
        ("(x: float) -> float", "return x + math.inf", "a constant of type float: inf"),
    ],
)
def test_constructs_outside_the_subset_are_refused_with_file_and_line(
    tmp_path: Path, signature: str, body: str, reason: str
) -> None:
    path, scope = tmp_path / "theirs.py", {"__name__": "theirs", "Pair": Pair, "swapped": swapped, "math": math}
    path.write_text(f"def refused{signature}:\n{textwrap.indent(body, '    ')}\n")
    exec(compile(path.read_text(), path, "exec"), scope)
    with pytest.raises(NotInSubsetError, match=rf"theirs.py:\d+: .*{reason}"):
        translate(scope["refused"])


def test_a_refused_construct_in_a_called_function_is_reported_at_its_own_line() -> None:
    line = power.__code__.co_firstlineno + 1
    for function in (power, calls):
        with pytest.raises(NotInSubsetError, match=rf"test_c_translator.py:{line}: .*BinOp `x \*\* 2`"):
            translate(function)
