"""The base of a campaign, what all its variants have in common, and the variants made from it."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from c_library import build, needs_compiler
from campaign_support import SHORT, silent_ecu

from liftgate_hil.campaigns.base import Base, base_of, settings_of
from liftgate_hil.campaigns.prepared import prepared
from liftgate_hil.campaigns.request import CampaignRequest
from liftgate_hil.campaigns.space import DRAW, KEY, PARAMETER, SEED_OF_RUN, VariedTarget
from liftgate_hil.config.vehicle import VehicleFile
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.plan import plan_of
from liftgate_hil.plan.request import Job
from liftgate_plant.quantity import Quantity

OWN = f"""
seed = 3
{SHORT}
[[expect]]
name = "never hot"
always = "left_current_a < 50"
"""
WHOLE = Quantity("", "", 0.0, 100.0, "", is_whole=True)
REAL = Quantity("", "m", -10.0, 10.0, "")


@pytest.fixture
def short(tmp_path: Path) -> str:
    path = tmp_path / "short.toml"
    path.write_text(OWN)
    return str(path)


def base_with(path: str, *vary: str, **more: object) -> Base:
    return prepared(CampaignRequest(path, vary, **more)).base  # type: ignore[arg-type]


def gravity_point_of(job: Job) -> tuple[float, float]:
    return plan_of(job).setup.vehicle.gate.gravity_point


FIRST, SECOND = (VariedTarget(f"a.place[{k}]", KEY, REAL, (0.25, 0.5)) for k in (0, 1))


@pytest.mark.parametrize(
    ("given", "settings"),
    [
        ([(VariedTarget("a.count", KEY, WHOLE), 24.0)], ["a.count=24"]),
        ([(VariedTarget("a.length", KEY, REAL), 24.0)], ["a.length=24.0"]),
        ([(VariedTarget("a.length", KEY, REAL), 0.10000000000000002)], ["a.length=0.10000000000000002"]),
        ([(SECOND, -1.0)], ["a.place=[0.25, -1.0]"]),  # the other coordinate is that of the file
        ([(SECOND, 2.0), (FIRST, 1.0)], ["a.place=[1.0, 2.0]"]),
        ([(VariedTarget("rod", PARAMETER), 1.0), (VariedTarget("seed", SEED_OF_RUN), 2.0)], []),
        ([(VariedTarget("draw", DRAW), 3.0)], []),
    ],
)
def test_varied_vehicle_keys_become_settings_with_numbers_written_as_in_the_vehicle_file(
    given: list[tuple[VariedTarget, float]], settings: list[str]
) -> None:
    assert settings_of(given) == settings


def test_each_varied_value_reaches_the_parameter_seed_draw_or_key_that_it_names(short: str) -> None:
    base = base_with(
        short, "rod=1,2", "seed=5,6", "draw=7,8", "supply.voltage=9,12", "gate.gravity_point[0]=0.4,0.5"
    )
    job = base.job_of([2.0, 6.0, 8.0, 9.5, 0.45])
    assert job.request.parameters == {"rod": 2.0}
    assert job.request.seed == 6
    assert job.request.draw == 8
    assert job.request.settings[0] == "supply.voltage=9.5"
    assert job.request.settings[1].startswith("gate.gravity_point=[0.45, ")


def test_fixed_parameters_settings_and_seed_remain_beside_the_varied_ones(short: str) -> None:
    more = {"parameters": {"angle": 60.0}, "settings": ("gate.mass=31",), "seed": 9}
    job = base_with(short, "rod=1,2", **more).job_of([2.0])
    assert job.request.parameters == {"angle": 60.0, "rod": 2.0}
    assert job.request.settings == ("gate.mass=31",)
    assert job.request.seed == 9


def test_varying_one_coordinate_of_a_point_keeps_the_other_one(short: str) -> None:
    base = base_with(short, "gate.gravity_point[1]=-0.1,0.1")
    before = gravity_point_of(base.job)
    assert gravity_point_of(base.job_of([0.07])) == (before[0], 0.07)


def test_a_job_needs_as_many_values_as_there_are_varied_names(short: str) -> None:
    with pytest.raises(ValueError, match="zip"):
        base_with(short, "rod=1,2").job_of([1.0, 2.0])


def test_a_pickled_base_makes_the_same_variants_after_its_files_are_deleted(short: str) -> None:
    base = base_with(short, "rod=1,2", "supply.voltage=9,12")
    content = pickle.dumps(base)
    Path(short).unlink()
    again = pickle.loads(content)
    assert again.variant([2.0, 9.0]) == base.variant([2.0, 9.0])
    assert plan_of(again.job_of([2.0, 9.0])).setup.scenario.parameters["rod"] == 2.0


def test_expectations_keep_the_order_of_the_scenario(short: str) -> None:
    assert base_with(short, "rod=1,2").expectations == ("stays open", "never hot")


def test_varying_the_draw_of_an_ideal_vehicle_is_refused(short: str) -> None:
    with pytest.raises(ConfigError, match="draw"):
        base_with(short, "draw=1,2", ideal=True)


def test_the_identity_depends_on_varied_names_but_not_on_values_or_file_paths(short: str, tmp_path: Path) -> None:
    other = tmp_path / "other" / "renamed.toml"
    other.parent.mkdir()
    shutil.copy(short, other)
    first = base_with(short, "rod=1,2")
    assert base_with(str(other), "rod=1,2").identity == first.identity
    assert base_with(short, "rod~uniform(5,6)", samples=4).identity == first.identity
    assert base_of(plan_of(first.job), first.targets).identity == first.identity
    assert base_with(short, "angle=1,2").identity != first.identity


@needs_compiler
def test_the_identity_depends_on_the_content_of_a_library_and_not_on_its_path(short: str, tmp_path: Path) -> None:
    library = build(tmp_path, silent_ecu())
    moved = tmp_path / "elsewhere" / "renamed.so"
    moved.parent.mkdir()
    shutil.copy(library, moved)
    other = build(tmp_path, silent_ecu("steps *= 2;"), "other.so")
    bases = [base_with(short, "rod=1,2", ecu=str(each)) for each in (library, moved, other)]
    assert bases[0].identity == bases[1].identity != bases[2].identity
    assert str(tmp_path) not in repr(bases[0].ecu)


def test_the_identity_depends_on_an_included_file(tmp_path: Path) -> None:
    part, path = tmp_path / "part.toml", tmp_path / "whole.toml"
    part.write_text(OWN)
    path.write_text('include = ["part.toml"]\n')
    first = base_with(str(path), "rod=1,2").identity
    part.write_text(OWN.replace('always = "left_current_a < 50"', 'always = "left_current_a < 49"'))
    assert isinstance(base_with(str(path), "rod=1,2").job.request.vehicle, VehicleFile)
    assert base_with(str(path), "rod=1,2").identity != first


def test_the_identity_depends_on_the_points_of_a_profile_in_a_csv_file(tmp_path: Path) -> None:
    path, points = tmp_path / "own.toml", tmp_path / "slope.csv"
    path.write_text(f'{OWN}\n[[profile]]\nquantity = "road_slope_deg"\ncsv = "slope.csv"\n')
    identities = set()
    for last in (3.0, 3.0000001):
        points.write_text(
            "time_s,road_slope_deg\n0,0\n" + "".join(f"{k},1\n" for k in range(1, 1500)) + f"1500,{last}\n"
        )
        identities.add(base_with(str(path), "rod=1,2").identity)
    assert len(identities) == 2


def test_names_of_batches_differ_with_values_their_order_and_the_base(short: str) -> None:
    base = base_with(short, "rod=1,2", "angle=1,2")
    other = base_with(short, "rod=1,2", "angle=1,2", seed=4)
    values = np.array([[1.0, 2.0], [3.0, 4.0]])
    changed = np.nextafter(values, 9.0)
    names = [
        base.variant(values), base.variant(values[::-1]), base.variant(values[:1]),
        base.variant(changed), other.variant(values),
    ]  # fmt: skip
    assert len(set(names)) == 5
    assert all(len(each) == 32 for each in names)


def test_the_name_of_a_batch_does_not_depend_on_the_memory_layout_of_its_values(short: str) -> None:
    base = base_with(short, "rod=1,2", "angle=1,2")
    values = np.arange(12.0).reshape(6, 2)
    expected = base.variant(values)
    assert base.variant(np.asfortranarray(values)) == expected
    assert base.variant(np.repeat(values, 2, axis=0)[::2]) == expected
    assert base.variant(values.astype(">f8")) == expected
