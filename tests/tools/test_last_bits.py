"""The suite's switch that changes last bits: its effect, its exceptions, and a part of the suite with it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant.vehicle import Vehicle
from tests import last_bits
from tests.reference.event_solution import DriveInput, Obstacle, Phase

ROOT = Path(__file__).parents[2]
CANARIES = "tests/tools/last_bits_canary.py"
# A few seconds of what stands nearest to a change of regime, to a solver's tolerance, to a bound.
SOME = (
    "tests/reference/test_event_solution.py::test_the_latch_catches_a_gate_at_home_and_lets_go_when_released",
    "tests/reference/test_event_solution.py::test_a_coasting_current_reaches_exactly_zero",
    "tests/reference/test_pendulum.py",
    "tests/plant/test_options.py",
    "tests/hil/identification/test_descent.py",
)


def suite(seed: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run pytest as a process with LAST_BITS set to this seed."""
    environment = {**os.environ, last_bits.VARIABLE: seed}
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *arguments],
        cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=1200,
    )  # fmt: skip


@pytest.fixture
def active(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv(last_bits.VARIABLE, "3")
    monkeypatch.setattr(last_bits, "is_active", True)
    last_bits.factor.cache_clear()
    yield
    last_bits.factor.cache_clear()


def moved(before: float, after: float) -> bool:
    """Whether a number has changed by more than nothing and by no more than `last_bits.OFF`, relatively."""
    return 0.0 < abs(after / before - 1.0) < 1.01 * last_bits.OFF


def test_a_part_of_the_suite_passes_with_changed_last_bits() -> None:
    """The part takes most of the time; `make last-bits SEED=2` takes other bits."""
    done = suite("1", *SOME)
    assert done.returncode == 0, done.stdout


def test_a_test_that_depends_on_the_last_bits_fails_only_if_they_are_changed() -> None:
    count = (ROOT / CANARIES).read_text().count("\ndef test_")
    done = suite("", CANARIES)
    assert f"{count} passed" in done.stdout, done.stdout
    done = suite("4", CANARIES)
    assert re.search(rf"^{count} failed in", done.stdout, re.MULTILINE), done.stdout


def test_an_empty_seed_changes_no_last_bits_and_an_invalid_one_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for text, seed in (("", 0), ("7", 7)):
        monkeypatch.setenv(last_bits.VARIABLE, text)
        assert last_bits.seed() == seed
    for wrong in ("0", "yes", "-1", "1.5"):
        monkeypatch.setenv(last_bits.VARIABLE, wrong)
        with pytest.raises(SystemExit, match=f"{last_bits.VARIABLE}={wrong}: allowed: a seed"):
            last_bits.seed()


@pytest.mark.usefixtures("active")
def test_ends_of_ranges_and_flags_keep_their_values_and_equal_drives_stay_equal() -> None:
    vehicle: Vehicle = vehicle_from("suv", ["motor.efficiency=1", "thermal.enabled=1"])
    other = last_bits.off(vehicle.left, "drive")
    assert moved(vehicle.left.motor.resistance, other.motor.resistance)
    assert (other.motor.efficiency, other.thermal.enabled) == (1.0, 1.0)
    assert other.bridge.freewheeling == vehicle.left.bridge.freewheeling
    assert last_bits.off(vehicle.right, "drive") == other
    assert moved(vehicle.gate.gravity_point[0], last_bits.off(vehicle.gate, "gate").gravity_point[0])


@pytest.mark.usefixtures("active")
def test_last_bits_change_in_nested_values_and_arrays_but_not_of_0_1_integers_and_words() -> None:
    left, right, rod = DriveInput("open", 0.6), DriveInput("voltage", -6.0), Obstacle(0.5, 0.9, 2e4)
    phase = Phase(2.5, left, right, obstacle=rod, changes={"motor": {"resistance": 0.9}})
    other = last_bits.off(phase, "phase")
    assert other.obstacle is not None
    assert moved(0.5, other.obstacle.angle)
    assert moved(0.6, other.left.value)
    assert moved(0.9, other.changes["motor"]["resistance"])
    assert (other.left.mode, other.released, other.obstacle.closing) == ("open", True, True)
    array = np.array([0.0, 1.0, -1.0, 12.0, -9.0, np.nan, np.inf])
    found = last_bits.off(array, "volts")
    assert np.array_equal(found[[0, 1, 2, 5, 6]], array[[0, 1, 2, 5, 6]], equal_nan=True)
    assert all(moved(*pair) for pair in zip(array[3:5], found[3:5], strict=True))
    assert last_bits.off([2.0, (3.0, "x", 4)], "list")[1][1:] == ("x", 4)


def test_without_a_seed_values_are_unchanged() -> None:
    assert not last_bits.is_active
    value = {"a": 0.3}
    assert last_bits.off(value) is value


def test_only_tests_of_plant_reference_and_identification_run_with_changed_last_bits() -> None:
    tests = ROOT / "tests"
    assert last_bits.is_part(tests / "reference" / "test_statics.py")
    assert last_bits.is_part(tests / "hil" / "identification" / "test_search.py")
    assert not last_bits.is_part(tests / "hil" / "identification.py")
    assert not last_bits.is_part(tests / "hil" / "config" / "test_vehicle.py")
    assert not last_bits.is_part(ROOT / "tools" / "x.py")
