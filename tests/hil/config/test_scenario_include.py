"""Scenario files that include others, and profiles from CSV files."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hil_support import issues_of, text_file

import liftgate_hil as lh
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.config.toml import read_toml
from liftgate_hil.errors import ConfigError
from liftgate_hil.testing.scenario_files import is_scenario


def test_including_merges_tables_appends_arrays_and_replaces_expectations(tmp_path: Path) -> None:
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
    path = text_file(
        tmp_path / "s.toml",
        'include = ["parts/bench.toml"]\nduration = 2.0\n[parameters]\nb = 5\n[set]\n"gate.mass" = 40\n'
        '[[request]]\ntime = "$a"\naction = "open"\n'
        '[[expect]]\nname = "x"\nnever = "time_s < $b"\n',
    )
    found = load_scenario(path, {"a": 0.5})
    assert (found.duration, found.seed) == (2.0, 7)
    assert found.vehicle == str(tmp_path / "parts" / "my.toml")
    assert dict(found.parameters) == {"a": 0.5, "b": 5.0}
    assert {each.key: each.value for each in found.settings} == {
        "gate.mass": 40, "environment.road_slope_deg": 5,
    }  # fmt: skip
    assert [(each.when.time, each.action) for each in found.requests] == [(0.5, "open"), (1.0, "close")]
    assert [(each.name, each.kind) for each in found.expectations] == [("x", "never"), ("y", "always")]


def test_a_file_is_included_once_and_a_circular_include_is_refused(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text('[[request]]\ntime = 1.0\naction = "open"\n')
    for name in ("a", "b"):
        (tmp_path / f"{name}.toml").write_text('include = "c.toml"\n')
    path = text_file(tmp_path / "s.toml", 'include = ["a.toml", "b.toml", "c.toml"]\n')
    assert len(load_scenario(path).requests) == 1
    (tmp_path / "c.toml").write_text('include = "s.toml"\n')
    with pytest.raises(ConfigError, match=r"c.toml: include\[0\]: 's.toml': includes this file itself"):
        load_scenario(path)


def test_mistakes_of_all_included_files_are_reported_at_once_each_with_its_file(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('duration = -1\n[[fault]]\nkind = "x"\n')
    path = text_file(tmp_path / "s.toml", 'include = ["a.toml", "nix.toml", 3]\nseed = -1\n')
    with pytest.raises(ConfigError):
        load_scenario(path)
    path.write_text('include = ["a.toml", "nix.toml"]\nseed = -1\n')
    assert [line.removeprefix(f"{tmp_path}/").split(": ")[:2] for line in issues_of(load_scenario, path)] == [
        ["a.toml", "duration"], ["a.toml", "fault[0].kind"], ["s.toml", "include[1]"], ["s.toml", "seed"],
    ]  # fmt: skip


BENCH = """
duration = 3.0
[parameters]
a = 10000
[[obstacle]]
angle_deg = 40
stiffness = "$a"
[[profile]]
quantity = "road_slope_deg"
points = [[0, 0], [1, "$b"]]
[[fault]]
kind = "parameter"
key = "gate.mass"
value = "$c"
[[signal]]
signal = "Body.VehicleSpeed"
value = "$d"
[set]
"gate.length" = "$e"
[[expect]]
name = "x"
always = "Nobody.X < 5"
[[request]]
time = "Nobody.Y > 1"
action = "open"
"""


def places_of_issues(path: Path, **parameters: float) -> list[str]:
    """Return the file names and keys of the issues of a scenario."""
    return [
        re.split(r": (?=[^:]*(?:allowed:|out of range))|: Nobody", line.replace(f"{path.parent}/", ""))[0]
        for line in issues_of(lh.run, path, parameters=parameters)
    ]


def test_an_invalid_value_is_reported_where_it_was_set(tmp_path: Path) -> None:
    """The issue names the including file's parameter or the flag, not the included file that only uses it."""
    (tmp_path / "bench.toml").write_text(BENCH)
    path = tmp_path / "s.toml"

    def told(a: float = 1e4, b: float = 0, c: float = 30, d: float = 0, e: float = 1) -> list[str]:
        values = {"b": b, "c": c, "d": d, "e": e}
        lines = "".join(f"{name} = {value}\n" for name, value in values.items())
        path.write_text(f'include = "bench.toml"\n[parameters]\na = {a}\n{lines}')
        return places_of_issues(path)

    here = ["bench.toml: expect[0].always", "bench.toml: request[0].time"]
    assert sorted(told(a=0.0, b=400)) == [
        "s.toml: parameters.a, as bench.toml: obstacle[0].stiffness",
        "s.toml: parameters.b, as bench.toml: profile[0].points[1][1]",
    ]
    assert told(e=-1) == ["s.toml: parameters.e, as bench.toml: set.gate.length"]
    assert [each for each in told(c=-1, d=-1) if each not in here] == [
        "s.toml: parameters.c, as bench.toml: fault[0].value",
        "s.toml: parameters.d, as bench.toml: signal[0].value",
    ]
    assert set(told()) <= set(here)
    assert told()
    assert places_of_issues(path, a=0.0) == ["`parameters` a, as bench.toml: obstacle[0].stiffness"]


def test_a_profile_is_read_from_a_csv_file(tmp_path: Path) -> None:
    (tmp_path / "volts.csv").write_text("supply_voltage_v,time_s,other\n12,0,x\n9.5,1.5,y\n")
    path = text_file(tmp_path / "s.toml", '[[profile]]\nquantity = "supply_voltage_v"\ncsv = "volts.csv"\n')
    (profile,) = load_scenario(path).stimuli.profiles.values()
    assert profile.points == [(0.0, 12.0), (1.5, 9.5)]
    assert profile.is_linear


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("time_s,volts\n0,12\n", "column supply_voltage_v 0 times in its first line; allowed: once"),
        ("time_s,supply_voltage_v\n0,12\nx,3\n", "row 3: 'x,3'; allowed: a number in both columns"),
        ("time_s,supply_voltage_v\n0,12\n0,3\n", "profile[0].csv[1][0]: 0; allowed: later than the point before"),
        ("time_s,supply_voltage_v\n0,1200\n", "profile[0].csv[0][1]: 1200.0 is out of range"),
        ("time_s,supply_voltage_v\n0,nan\n", "profile[0].csv[0][1]: nan is out of range"),
        ("", "column time_s 0 times"),
        ("time_s,supply_voltage_v\n", "profile[0].csv: []; allowed"),
        (None, "volts.csv: no such file"),
    ],
)
def test_an_invalid_csv_file_of_a_profile_is_reported(tmp_path: Path, content: str | None, said: str) -> None:
    if content is not None:
        (tmp_path / "volts.csv").write_text(content)
    path = text_file(tmp_path / "s.toml", '[[profile]]\nquantity = "supply_voltage_v"\ncsv = "volts.csv"\n')
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert said in str(caught.value)
    assert len(caught.value.issues) == 1


def test_a_profile_needs_either_points_or_a_csv_file(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    for more in ("", 'csv = "x.csv"\npoints = [[0, 12]]\n'):
        path.write_text(f'[[profile]]\nquantity = "supply_voltage_v"\n{more}')
        with pytest.raises(ConfigError, match=r"profile\[0\].points: .*allowed: \[\[time, value\]"):
            load_scenario(path)


def test_forty_nested_double_includes_are_read_once_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two to the power of forty paths lead through these files."""
    for k in range(40):
        (tmp_path / f"{k}.toml").write_text(f'include = ["{k + 1}.toml", "{k + 1}.toml"]\nduration = {k + 1}\n')
    (tmp_path / "40.toml").write_text('[[request]]\ntime = 1.0\naction = "open"\n')
    reads: list[Path] = []

    def read(path: Path) -> object:
        reads.append(path)
        return read_toml(path)

    monkeypatch.setattr("liftgate_hil.config.scenario.read_toml", read)
    monkeypatch.setattr("liftgate_hil.testing.scenario_files.read_toml", read)
    found = load_scenario(tmp_path / "0.toml")
    assert (len(found.included), found.duration, len(found.requests)) == (40, 1.0, 1)
    assert len(reads) == 41
    reads.clear()
    assert not is_scenario(tmp_path / "0.toml")
    assert len(reads) == 81  # each as often as it is included
