"""Figures of vehicles, whose curves and areas are those of the plant's functions, and their files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from xml.dom import minidom

import numpy as np
import pytest
from matplotlib import colors
from test_figures_of_runs import curve, curves_differ_without_colour, legend_hides_nothing, recorded

from liftgate_hil.cli.main import main
from liftgate_hil.conversion.figures import static
from liftgate_hil.conversion.figures.subject import FigureSubject
from liftgate_hil.conversion.plot import drawn
from liftgate_hil.conversion.request import FIGURES
from liftgate_hil.conversion.sheet import write_picture
from liftgate_hil.conversion.table import open_table
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant import statics
from liftgate_plant.statics import CLOSING, OPENING, Rest

VEHICLES = ("suv", "compact", "heavy-suv")


def rest_of(name: str, *settings: str) -> Rest:
    return statics.rest_of(vehicle_from(name, settings))


def figure_of(figure: str, name: str, *settings: str) -> Any:
    vehicle = vehicle_from(name, settings)
    return drawn(figure, FigureSubject(name, vehicle=vehicle, vehicle_name=name)).figure


@pytest.mark.parametrize("name", VEHICLES)
def test_torque_curves_equal_the_torques_of_the_plant(name: str) -> None:
    rest, figure = rest_of(name), figure_of("forces", name)
    near, whole, drives_near, drives = figure.axes
    top = math.degrees(vehicle_from(name).gate.open_angle)
    assert whole.get_xlim() == pytest.approx((0.0, top))
    assert near.get_xlim()[1] < 0.1 * top
    assert near.get_ylim() == whole.get_ylim()
    for axis in (near, whole):
        angles = curve(axis, "sum of all")[0]
        expected = statics.balance_over(rest, np.radians(angles))
        for label, values in (
            ("weight", expected.weight), ("left spring", expected.left_spring), ("seal", expected.seal),
            ("sum of all", expected.net),
        ):  # fmt: skip
            assert curve(axis, label)[1] == pytest.approx(values, abs=1e-9)
        (band,) = axis.collections
        points = band.get_paths()[0].vertices
        assert points[:, 1].max() == pytest.approx(expected.held_opening.max())
        assert points[:, 1].min() == pytest.approx(-expected.held_closing.max())
        curves_differ_without_colour(axis)
    labels = [each.get_text() for each in whole.get_legend().get_texts()]
    assert ("right spring" in labels) == (name != "compact")
    assert "snow, wind, hand" not in labels
    for axis in (drives_near, drives):
        angles, needed = curve(axis, "to balance the sum")
        assert needed == pytest.approx(-statics.balance_over(rest, np.radians(angles)).net, abs=1e-9)
        curves_differ_without_colour(axis)
    assert whole.get_ylim()[1] > curve(near, "sum of all")[1][0]
    assert "[N m]" in near.get_ylabel()
    assert "[N m]" in drives_near.get_ylabel()
    assert drives.get_xlabel() == "gate angle [deg]"
    legend_hides_nothing(figure)


@pytest.mark.parametrize(("along", "word"), [(OPENING, "opening"), (CLOSING, "closing")])
def test_drive_torque_curves_equal_those_of_the_plant(along: float, word: str) -> None:
    rest, drives = rest_of("heavy-suv"), figure_of("forces", "heavy-suv").axes[-1]
    stalled, rated = statics.turning(rest, along), statics.most_efficient(rest)
    angles, values = curve(drives, f"{word}, stalled")
    for k in (0, 200, 400):
        angle = math.radians(angles[k])
        assert values[k] == pytest.approx(statics.drives_torque(rest, stalled.torques, angle, along))
        torques = (along * rated.torques[0], along * rated.torques[1])
        expected = statics.drives_torque(rest, torques, angle, along, rated.speed)
        assert curve(drives, f"{word}, rated")[1][k] == pytest.approx(expected)


def test_snow_and_latch_torques_are_drawn_where_present_and_enlarged_panels_only_with_a_seal() -> None:
    figure = figure_of("forces", "suv", "environment.snow_mass=10", "latch.half=0.012", "seal.force=0")
    whole, _ = figure.axes
    labels = [each.get_text() for each in whole.get_legend().get_texts()]
    assert {"snow, wind, hand", "latch"} < set(labels)
    assert "seal" not in labels
    curves_differ_without_colour(whole)


def area_at(axis: Any, place: tuple[float, float]) -> str:
    """Return the legend's text for the uppermost area at a point."""
    named = {
        (patch.get_facecolor(), patch.get_hatch()): text.get_text()
        for patch, text in zip(axis.get_legend().get_patches(), axis.get_legend().get_texts(), strict=True)
    }
    found = ""
    for each in axis.collections:
        hatches = getattr(each, "hatches", None)
        if hatches is not None and each.filled and any(path.contains_point(place) for path in each.get_paths()):
            found = named[tuple(each.get_facecolor()[0]), hatches[0]]
    return found


@pytest.mark.parametrize("name", VEHICLES)
def test_the_map_of_rest_and_motion_agrees_with_the_plant_at_each_point(name: str) -> None:
    rest, figure = rest_of(name, "spring.preload=250"), figure_of("static", name, "spring.preload=250")
    alone, driven = figure.axes
    top = math.degrees(vehicle_from(name).gate.open_angle)
    seen = set()
    for slope in (-19.0, -7.3, 0.4, 11.0, 19.0):
        own = rest._replace(load=rest.load._replace(road_slope=math.radians(slope)))
        for angle in (0.1, 7.0, 33.0, 0.8 * top, 0.97 * top):
            margins = [statics.margin(own, (0.0, 0.0), math.radians(angle), way) for way in (OPENING, CLOSING)]
            if min(map(abs, margins)) < 1.0:  # beside the line
                continue
            opens, closes = (each > 0.0 for each in margins)
            word = "opens by itself" if opens else "closes by itself" if closes else "stays where it is left"
            assert area_at(alone, (slope, angle)) == word
            seen.add(word)
        for voltage in (0.3, 2.2, 3.6, 5.1, 9.0, 15.0):
            fed = own._replace(load=own.load._replace(supply_voltage=voltage))
            starts = []
            for way in (OPENING, CLOSING):
                torques = statics.turning(fed, way).torques
                angles = np.radians(np.linspace(0.0, top, 300)).tolist()
                starts.append(min(statics.margin(own, torques, angle, way) for angle in angles))
            if min(map(abs, starts)) < 10.0:
                continue
            opens, closes = (each > 0.0 for each in starts)
            word = {
                (True, True): "starts opening and closing", (True, False): "starts opening only",
                (False, True): "starts closing only", (False, False): "starts neither",
            }[opens, closes]  # fmt: skip
            assert area_at(driven, (slope, voltage)) == word
            seen.add(word)
    assert {"stays where it is left", "starts opening and closing", "starts neither"} <= seen
    legend_hides_nothing(figure)


def test_areas_are_distinguished_without_colour() -> None:
    for areas in (static._ALONE, static._DRIVEN):
        assert len({hatch for _, _, hatch in areas}) == len(areas)
        lights = [np.dot(colors.to_rgb(colour), (0.3, 0.59, 0.11)) for _, colour, _ in areas]
        assert min(lights) > 0.8  # hatch and text are read on all of them


def test_the_map_marks_the_vehicles_own_slope_and_supply_voltage() -> None:
    driven = figure_of("static", "suv", "environment.road_slope_deg=30", "supply.voltage=24").axes[1]
    (mark,) = [each for each in driven.lines if each.get_marker() == "o"]
    assert (mark.get_xdata()[0], mark.get_ydata()[0]) == (pytest.approx(30.0), 24.0)
    assert area_at(driven, (31.0, 28.0)) == "starts opening and closing"  # the map reaches beyond it
    assert "the vehicle: 30 deg, 24 V" in [each.get_text() for each in driven.texts]


def test_the_map_of_a_self_locking_drive_can_be_drawn() -> None:
    alone, driven = figure_of("static", "suv", "spindle.load_friction=1").axes
    assert area_at(alone, (-19.0, 10.0)) == "stays where it is left"
    assert area_at(driven, (0.0, 0.1)) == "starts neither"
    assert area_at(driven, (0.0, 12.0)) == "starts opening and closing"
    lines = [each for each in driven.collections if not getattr(each, "filled", True)]
    assert all(np.isfinite(path.vertices).all() and len(path) for each in lines for path in each.get_paths())


# As files, by the command.


BEGINS = {".svg": b"<?xml", ".png": b"\x89PNG", ".pdf": b"%PDF", ".html": b"<!DOCTYPE html>"}


def call(figure: str, folder: Path, output: str, *more: str) -> bytes:
    """Return the content of a figure's file, written by the command."""
    kind, target = FIGURES[figure], folder / output
    source = [str(recorded(folder / "run.csv"))] if kind.of_recording else []
    assert main(["plot", *source, "--figure", figure, *more, "--output", str(target), "--quiet"]) == 0
    return target.read_bytes()


@pytest.mark.parametrize("figure", FIGURES)
def test_every_figure_is_written_in_every_format_with_quantities_and_units(tmp_path: Path, figure: str) -> None:
    """Drawn once for all formats; as SVG drawn and written again by the command, with the same bytes."""
    kind = FIGURES[figure]
    table = open_table(recorded(tmp_path / "run.csv")) if kind.of_recording else None
    vehicle = vehicle_from("suv") if kind.of_vehicle else None
    title = f"{'run.csv' if table else 'suv'}: {kind.meaning}" if figure != "columns" else "run.csv"
    made = drawn(figure, FigureSubject(title, table, vehicle=vehicle, vehicle_name="suv"))
    for suffix, begin in BEGINS.items():
        target = tmp_path / f"a{suffix}"
        write_picture(target, made.figure, figure, made.caption)
        assert target.read_bytes().startswith(begin)
    content = (tmp_path / "a.svg").read_bytes()
    assert minidom.parseString(content).documentElement.tagName == "svg"
    assert call(figure, tmp_path, "b.svg") == content
    for axis in made.figure.axes:
        shared = [*axis.get_shared_y_axes().get_siblings(axis)]
        assert any("[" in each.get_ylabel() for each in shared), figure
        across = [*axis.get_shared_x_axes().get_siblings(axis)]
        assert any("[" in each.get_xlabel() for each in across), figure


@pytest.mark.parametrize("suffix", BEGINS)
def test_a_figure_file_is_reproducible_in_every_format(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    """Also on another day, given to matplotlib by an environment variable."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    content = call("phase", tmp_path, f"a{suffix}")
    assert content.startswith(BEGINS[suffix])
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "100000")
    assert call("phase", tmp_path, f"b{suffix}") == content


def test_figure_files_are_named_after_recording_or_vehicle_and_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    recorded(tmp_path / "run.csv")
    assert main(["plot", "run.csv", "--figure", "phase"]) == 0
    assert main(["plot", "--figure", "forces", "--vehicle", "compact"]) == 0
    assert capsys.readouterr().out == "written: run.csv.phase.png\nwritten: compact.forces.png\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["plot"], "FILE: missing; allowed: a recording, for --figure columns"),
        (["plot", "--figure", "phase"], "FILE: missing; allowed: a recording, for --figure phase"),
        (["plot", "run.csv", "--figure", "forces"], "FILE: allowed with --figure columns, thesis, phase, pinch"),
        (
            ["plot", "--figure", "static", "--rig", "liftgate", "--to", "3"],
            "--to, --rig: allowed with --figure columns, thesis, phase, pinch",
        ),
        (
            ["plot", "run.csv", "--figure", "phase", "--vehicle", "suv", "--ideal"],
            "--vehicle, --ideal: allowed with --figure pinch, forces, static",
        ),
        (["plot", "run.csv", "--figure", "phase", "--columns", "x"], "--columns: allowed with --figure columns"),
        (["plot", "run.csv", "--figure", "nosuch"], "'nosuch'"),
        (["plot", "--figure", "forces", "--vehicle", "nosuch"], "nosuch"),
        (["plot", "--figure", "forces", "--set", "motor.volts=1"], "motor.volts"),
        (["plot", "--figure", "forces", "--output", "x.gif"], "allowed: a file of .png, .svg, .pdf, .html"),
        (["plot", "short.csv", "--figure", "phase"], "short.csv: gate_rate_degps: missing; allowed: "),
    ],
)
def test_wrong_usage_is_one_line_and_exit_code_2(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    recorded(tmp_path / "run.csv")
    recorded(tmp_path / "short.csv", ("time_s", "gate_angle_deg"))
    try:
        code = main(arguments)
    except SystemExit as leaving:
        code = int(leaving.code or 0)
    captured = capsys.readouterr()
    assert code == 2
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    assert said in captured.err
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize(
    ("figure", "more", "title", "caption"),
    [
        ("pinch", ["--set", "gate.pinch_limit=77"], "suv with gate.pinch_limit=77", "limit 77 N"),
        (
            "static",
            ["--set", "environment.snow_mass=9", "--draw", "3"],
            "suv, changed: ",
            "environment.snow_mass=9, draw 3.",
        ),
        ("static", ["--ideal"], "suv (ideal): ", "Vehicle: suv (ideal)."),
    ],
)
def test_a_figure_states_the_values_that_differ_from_the_vehicle_file(
    tmp_path: Path, figure: str, more: list[str], title: str, caption: str
) -> None:
    text = call(figure, tmp_path, "a.svg", *more).decode()
    assert title in text
    assert caption in text


def test_a_figure_without_its_recording_or_vehicle_is_an_error() -> None:
    with pytest.raises(ConfigError, match="`recording`: missing"):
        drawn("phase", FigureSubject("x"))
    with pytest.raises(ConfigError, match="`vehicle`: missing"):
        drawn("forces", FigureSubject("x"))
