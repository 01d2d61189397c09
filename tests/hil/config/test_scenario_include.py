"""Scenario files that include others, profiles from CSV files."""

from __future__ import annotations

from pathlib import Path

import pytest

from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.errors import ConfigError


def test_tables_merge_arrays_append_expectations_replace(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "my.toml").write_text("x = 1\n")
    (tmp_path / "parts" / "bench.toml").write_text(
        'vehicle = "my.toml"\nseed = 7\nduration = 3.0\n'
        "[parameters]\na = 1\nb = 2\n"
        '[set]\n"gate.mass" = 30\n"environment.road_slope_deg" = 5\n'
        '[[request]]\ntime = 1.0\naction = "close"\n'
        '[[expect]]\nname = "x"\nalways = "time_s < $b"\n'
        '[[expect]]\nname = "y"\nalways = "time_s < $a"\n'
    )
    path = tmp_path / "s.toml"
    path.write_text(
        'include = ["parts/bench.toml"]\nduration = 2.0\n[parameters]\nb = 5\n[set]\n"gate.mass" = 40\n'
        '[[request]]\ntime = "$a"\naction = "open"\n'
        '[[expect]]\nname = "x"\nnever = "time_s < $b"\n'
    )
    found = load_scenario(path, {"a": 0.5})
    assert (found.duration, found.seed) == (2.0, 7)
    assert found.vehicle == str(tmp_path / "parts" / "my.toml")
    assert dict(found.parameters) == {"a": 0.5, "b": 5.0}
    assert {each.key: each.value for each in found.settings} == {
        "gate.mass": 40, "environment.road_slope_deg": 5,
    }  # fmt: skip
    assert [(each.when.time, each.action) for each in found.requests] == [
        (0.5, "open"),
        (1.0, "close"),
    ]
    assert [(each.name, each.kind) for each in found.expectations] == [
        ("x", "never"),
        ("y", "always"),
    ]


def test_each_file_once_and_no_circles(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text('[[request]]\ntime = 1.0\naction = "open"\n')
    for name in ("a", "b"):
        (tmp_path / f"{name}.toml").write_text('include = "c.toml"\n')
    path = tmp_path / "s.toml"
    path.write_text('include = ["a.toml", "b.toml", "c.toml"]\n')
    assert len(load_scenario(path).requests) == 1
    (tmp_path / "c.toml").write_text('include = "s.toml"\n')
    with pytest.raises(
        ConfigError, match=r"c.toml: include\[0\]: 's.toml': includes this file itself"
    ):
        load_scenario(path)


def test_the_mistakes_of_all_files_come_at_once_each_with_its_file(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('duration = -1\n[[fault]]\nkind = "x"\n')
    path = tmp_path / "s.toml"
    path.write_text('include = ["a.toml", "nix.toml", 3]\nseed = -1\n')
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    path.write_text('include = ["a.toml", "nix.toml"]\nseed = -1\n')
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert [line.removeprefix(f"{tmp_path}/").split(": ")[:2] for line in caught.value.issues] == [
        ["a.toml", "duration"], ["a.toml", "fault[0].kind"], ["s.toml", "include[1]"], ["s.toml", "seed"],
    ]  # fmt: skip


def test_a_profile_from_a_csv_file(tmp_path: Path) -> None:
    (tmp_path / "volts.csv").write_text("supply_voltage_v,time_s,other\n12,0,x\n9.5,1.5,y\n")
    path = tmp_path / "s.toml"
    path.write_text('[[profile]]\nquantity = "supply_voltage_v"\ncsv = "volts.csv"\n')
    (profile,) = load_scenario(path).stimuli.profiles.values()
    assert profile.points == [(0.0, 12.0), (1.5, 9.5)]
    assert profile.is_linear


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (
            "time_s,volts\n0,12\n",
            "column supply_voltage_v 0 times in its first line; allowed: once",
        ),
        ("time_s,supply_voltage_v\n0,12\nx,3\n", "row 3: 'x,3'; allowed: a number in both columns"),
        (
            "time_s,supply_voltage_v\n0,12\n0,3\n",
            "profile[0].csv[1][0]: 0; allowed: later than the point before",
        ),
        ("time_s,supply_voltage_v\n0,1200\n", "profile[0].csv[0][1]: 1200.0 is out of range"),
        ("time_s,supply_voltage_v\n0,nan\n", "profile[0].csv[0][1]: nan is out of range"),
        ("", "column time_s 0 times"),
        ("time_s,supply_voltage_v\n", "profile[0].csv: []; allowed"),
        (None, "volts.csv: no such file"),
    ],
)
def test_what_is_wrong_with_a_csv_file(tmp_path: Path, content: str | None, said: str) -> None:
    if content is not None:
        (tmp_path / "volts.csv").write_text(content)
    path = tmp_path / "s.toml"
    path.write_text('[[profile]]\nquantity = "supply_voltage_v"\ncsv = "volts.csv"\n')
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert said in str(caught.value)
    assert len(caught.value.issues) == 1


def test_points_or_csv_not_both_not_none(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    for more in ("", 'csv = "x.csv"\npoints = [[0, 12]]\n'):
        path.write_text(f'[[profile]]\nquantity = "supply_voltage_v"\n{more}')
        with pytest.raises(ConfigError, match=r"profile\[0\].points: .*allowed: \[\[time, value\]"):
            load_scenario(path)
