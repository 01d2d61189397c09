"""`--map` maps foreign column names and units to those of the catalogue."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from measurement_files import read, write_csv

from liftgate_hil.config.units import unit_in
from liftgate_hil.errors import ConfigError, allowed_names
from liftgate_hil.formats.recording import AS_IT_IS
from liftgate_hil.measurement.mapping import KNOWN, Theirs, conversion, parse_maps
from liftgate_hil.signals import COLUMNS
from liftgate_hil.testing.run_file import opened

TIMES = np.arange(25) * 0.01


@pytest.mark.parametrize(
    ("given", "ours", "theirs"),
    [
        ("left_current_a=Iq", "left_current_a", Theirs("Iq")),
        ("left_current_a=Iq[mA]", "left_current_a", Theirs("Iq", "mA")),
        (" left_current_a = Iq [mA] * -0.5", "left_current_a", Theirs("Iq", "mA", -0.5)),
        ("left_current_a=IqL*-1", "left_current_a", Theirs("IqL", None, -1.0)),
        ("left_current_a=Iq * 1e-3", "left_current_a", Theirs("Iq", None, 1e-3)),
        ("time_s=a=b*2[ms]", "time_s", Theirs("a=b*2", "ms")),
        ("voltage_v=U", "voltage_v", Theirs("U")),
    ],
)
def test_a_map_flag_sets_name_unit_and_scale(given: str, ours: str, theirs: Theirs) -> None:
    assert parse_maps([given]) == {ours: theirs}


def test_a_map_file_sets_name_unit_scale_and_offset(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text(
        '[columns]\nleft_current_a = { name = "Iq", unit = "mA", scale = 2.0, offset = -5 }\ntime_s = "t"\n'
    )
    assert parse_maps([str(path), "voltage_v=U"]) == {
        "left_current_a": Theirs("Iq", "mA", 2.0, -5.0),
        "time_s": Theirs("t"),
        "voltage_v": Theirs("U"),
    }


@pytest.mark.parametrize(
    ("column", "unit", "theirs", "ours"),
    [
        ("time_s", "ms", 250.0, 0.25),
        ("time_s", "us", 250.0, 250e-6),
        ("left_voltage_v", "mV", 12_000.0, 12.0),
        ("left_current_a", "kA", 0.5, 500.0),
        ("left_speed_rps", "1/min", 3000.0, 50.0),
        ("left_speed_rps", "rpm", 3000.0, 50.0),
        ("left_speed_rps", "rad/s", 4.0 * math.pi, 2.0),
        ("left_position_rev", "rad", math.pi, 0.5),
        ("left_position_rev", "deg", 90.0, 0.25),
        ("left_position_rev", "turns", 3.0, 3.0),
        ("gate_angle_deg", "rad", math.pi / 3.0, 60.0),
        ("left_duty", "%", -40.0, -0.4),
        ("ambient_temperature_degc", "K", 293.15, 20.0),
        ("ambient_temperature_degc", "degF", 68.0, 20.0),
        ("road_slope_deg", "mrad", 1000.0 * math.pi / 18.0, 10.0),
        ("hand_force_n", "kN", 0.2, 200.0),
        ("left_hall_count", "", 7.0, 7.0),
    ],
)
def test_units_of_mapped_columns_are_converted(column: str, unit: str, theirs: float, ours: float) -> None:
    factors = conversion(column, unit)
    assert factors is not None
    assert factors[0] * theirs + factors[1] == pytest.approx(ours, rel=1e-12)


@pytest.mark.parametrize("column", KNOWN)
def test_every_column_accepts_its_own_unit_and_refuses_unknown_ones(column: str) -> None:
    assert conversion(column, KNOWN[column].unit) == (1.0, 0.0)
    assert conversion(column, "") == conversion(column, column.rpartition("_")[2]) == (1.0, 0.0)
    assert conversion(column, "furlong") is None


def test_a_mapped_file_is_read_in_the_units_of_the_catalogue(tmp_path: Path) -> None:
    columns = {"t": TIMES * 1e3, "U": TIMES * 1e3, "Iq [mA]": TIMES * 1e3, "n": TIMES * 600.0}
    path = write_csv(tmp_path / "m.csv", columns)
    measurement = read(
        path, "time_s=t[ms]", "left_voltage_v=U[mV]*2", "left_current_a=Iq[mA]", "left_speed_rps=n[1/min]*-1"
    )
    assert np.allclose(measurement.times, TIMES, rtol=1e-12)
    assert np.allclose(measurement.columns["left_voltage_v"], 2.0 * TIMES, rtol=1e-12)
    assert np.allclose(measurement.columns["left_current_a"], TIMES, rtol=1e-12)
    assert np.allclose(measurement.columns["left_speed_rps"], -10.0 * TIMES, rtol=1e-12)


def test_a_unit_in_the_header_is_used_if_the_map_states_none(tmp_path: Path) -> None:
    columns = {
        "time_s": TIMES,
        "U [mV]": TIMES * 1e3,
        "Iq[mA]": TIMES * 1e3,
        "left_speed_rps [1/min]": TIMES * 600.0,
    }
    path = write_csv(tmp_path / "m.csv", columns)
    measurement = read(path, "left_voltage_v=U*-1", "left_current_a=Iq")
    assert np.allclose(measurement.columns["left_voltage_v"], -TIMES, rtol=1e-12)
    assert np.allclose(measurement.columns["left_current_a"], TIMES, rtol=1e-12)
    assert np.allclose(measurement.columns["left_speed_rps"], 10.0 * TIMES, rtol=1e-12)
    with pytest.raises(ConfigError, match=r"left_current_a .U .mV.*unit 'mV'; allowed: A, mA"):
        read(path, "left_current_a=U", "left_voltage_v=Iq[V]")


@pytest.mark.parametrize("header", ["time_s,voltage_v,Winkel [°]\n", "time_s,voltage_v,Winkel\ns,V,°\n"])
def test_a_unit_in_the_map_overrides_that_of_the_file(tmp_path: Path, header: str) -> None:
    path = tmp_path / "m.csv"
    path.write_text(header + "".join(f"{at},1,{at}\n" for at in TIMES), encoding="utf-8")
    file = tmp_path / "map.toml"
    for unit, factor in (("deg", 1.0), ("rad", 180.0 / math.pi)):
        file.write_text(f'[columns]\ngate_angle_deg = {{ name = "Winkel", unit = "{unit}" }}\n')
        for given in (f"gate_angle_deg=Winkel[{unit}]", str(file)):
            assert np.allclose(read(path, given).columns["gate_angle_deg"], factor * TIMES)


def test_a_map_prefers_the_exact_column_name_to_one_with_a_unit_or_a_catalogue_name(tmp_path: Path) -> None:
    columns = {"time_s": TIMES, "voltage_v": TIMES, "left_current_a": 2.0 * TIMES, "Iq [mA]": -TIMES, "Iq": TIMES}
    path = write_csv(tmp_path / "m.csv", columns)
    assert np.allclose(read(path, "left_current_a=Iq[A]").columns["left_current_a"], TIMES)


def test_brackets_without_a_unit_belong_to_the_name_and_names_may_differ_in_unit_alone(tmp_path: Path) -> None:
    columns = {"time_s": TIMES, "voltage_v": TIMES, "I[0]": TIMES, "Iq [A]": TIMES, "Iq [mA]": TIMES * 1e3}
    path = write_csv(tmp_path / "m.csv", columns)
    file = tmp_path / "map.toml"
    file.write_text('[columns]\nleft_current_a = "I[0]"\n')
    assert np.allclose(read(path, str(file)).columns["left_current_a"], TIMES)
    assert np.allclose(read(path, "left_current_a=Iq[mA]").columns["left_current_a"], TIMES)
    with pytest.raises(ConfigError, match=r"no column 'Iq'; allowed: .*Iq \[A\], Iq \[mA\]"):
        read(path, "left_current_a=Iq")


def test_a_map_flag_overrides_the_map_file(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "m.csv", {"time_s": TIMES, "voltage_v": TIMES, "a": TIMES, "b": -TIMES})
    file = tmp_path / "map.toml"
    file.write_text('[columns]\nleft_current_a = "a"\n')
    for maps in ((str(file), "left_current_a=b"), ("left_current_a=b", str(file))):
        assert np.allclose(read(path, *maps).columns["left_current_a"], -TIMES)


def test_a_road_slope_known_only_from_its_sensor_gets_a_note(tmp_path: Path) -> None:
    columns = {"time_s": TIMES, "voltage_v": TIMES, "left_current_a": TIMES}
    steep = {"sensed_road_slope_deg": np.full(len(TIMES), 8.0)}
    path = write_csv(tmp_path / "m.csv", columns | steep)
    (note,) = read(path).notes
    assert note.startswith("road_slope_deg is that of the vehicle, sensed_road_slope_deg 8 on average")
    assert read(path, "road_slope_deg=sensed_road_slope_deg").notes == ()


def test_a_missing_mapped_column_is_reported_with_the_existing_columns(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "m.csv", {"time_s": TIMES, "voltage_v": TIMES, "Iq": TIMES})
    with pytest.raises(ConfigError) as caught:
        read(path, "left_current_a=Id", "left_speed_rps=n")
    assert caught.value.issues == [
        f"{path}: left_current_a: no column 'Id'; allowed: time_s, voltage_v, Iq",
        f"{path}: left_speed_rps: no column 'n'; allowed: time_s, voltage_v, Iq",
    ]


def test_all_issues_of_all_maps_are_reported_at_once(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text('[columns]\nleft_current_a = { name = "I", unit = "V", skale = 1 }\n')
    with pytest.raises(ConfigError) as caught:
        parse_maps(["nothing", "left_speed_rps=n[mm]", "current=I", "time_s=t[s]*0", str(path)])
    assert caught.value.issues == [
        "`maps` nothing: allowed: OURS=THEIRS, OURS=THEIRS[unit], either with *scale, or FILE.toml",
        "`maps` left_speed_rps=n[mm]: left_speed_rps: unit 'mm'; allowed: rev/s, rpm, rad/s, deg/s, mdeg/s",
        f"`maps` current=I: current: unknown column; allowed: {allowed_names('current', KNOWN)}",
        "`maps` time_s=t[s]*0: time_s: scale '0'; allowed: -1e+09 to 1e+09, not 0",
        f"{path}: columns.left_current_a.skale: 1: unknown key; allowed: name, unit, scale, offset",
        f"{path}: left_current_a: unit 'V'; allowed: A, mA, µA, kA",
    ]


def test_a_column_may_be_mapped_once_only() -> None:
    with pytest.raises(ConfigError, match="left_current_a: mapped twice; allowed: once"):
        parse_maps(["left_current_a=a", "left_current_a=b"])


@pytest.mark.parametrize(
    ("header", "newtons"),
    [
        ("F [kN]", 350.0), ("F (kN)", 350.0), ("F(kN)", 350.0), ("F/kN", 350.0), ("<F>/kN", 350.0),
        ("F_kN", 350.0), ("F in kN", 350.0), ("F, kN", 350.0), ("F kN", 350.0), ("f_kn", 350.0), ("F", 0.35),
        ("Gate/Force/F", 0.35), ("F_min", 0.35), ("Motor/F (daN)", 3.5), ("F [kN] (2)", 350.0), ("[kN] F", 350.0),
        ("F {kN}", 350.0), ("F<kN>", 350.0), ("F: kN", 350.0), ("F|kN", 350.0),
    ],
)  # fmt: skip
def test_a_unit_in_a_column_name_is_used_in_every_usual_form(tmp_path: Path, header: str, newtons: float) -> None:
    assert _force_in(tmp_path, header, header) == pytest.approx([newtons, newtons])


@pytest.mark.parametrize("header", ["F [kW]", "F (filtered)", "F/kW", "F (kN/s)", "F [lb]", "F_kN_raw"])
def test_an_unknown_unit_in_a_column_name_is_refused(tmp_path: Path, header: str) -> None:
    with pytest.raises(ConfigError, match=r"unit .*; allowed: N, "):
        _force_in(tmp_path, header, header)
    assert _force_in(tmp_path, header, f"{header}[kN]") == pytest.approx([350.0, 350.0])


def _force_in(folder: Path, header: str, theirs: str) -> list[float]:
    """The pinch force of a file with this header, as `judge` reads it."""
    path = folder / "foreign.csv"
    path.write_text(f'time_s,"{header}"\n0,0.35\n1,0.35\n')
    mapping = parse_maps([f"pinch_force_n={theirs}"], COLUMNS)
    file, column = opened(path, AS_IT_IS), mapping["pinch_force_n"]
    name = column.found_in(file.names)
    assert name is not None
    issues: list[str] = []
    file.read([name], mapping, issues)
    _, values, unit = file.samples[name]
    found = column.converted(values, "pinch_force_n", name, unit, COLUMNS)
    if isinstance(found, str):
        raise ConfigError(found)
    return list(found)


@pytest.mark.parametrize(
    "header",
    ["w_rad_s", "w_radps", "w_rad_per_s", "w in rad/s", "w rad/s", "w/rad/s", "w (rad/s)", "w [rad/s] filtered"],
)
def test_units_of_rates_are_understood_in_all_usual_forms(header: str) -> None:
    assert conversion("left_speed_rps", unit_in(header, KNOWN["left_speed_rps"])) == conversion(
        "left_speed_rps", "rad/s"
    )
