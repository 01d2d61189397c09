"""Randomly damaged files: a ConfigError or a valid result, never another exception."""

from __future__ import annotations

import contextlib
import copy
import logging
import random
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from liftgate_hil.config import rig as rig_file
from liftgate_hil.config.rig import load_rig
from liftgate_hil.config.scenario import load_scenario
from liftgate_hil.config.vehicle import load_vehicle
from liftgate_hil.errors import ConfigError
from tests.hil.config.mangled_lines import mangled
from tools.hostile.mangling import document, slots

ROOT = Path(__file__).parents[3]
FOREIGN = ROOT / "tests/system/foreign"

REMOVE = object()
ODD: list[Any] = [
    REMOVE, True, -1, 0, 1, 2.5, float("nan"), float("inf"), 10**400, "", "x", "open", "ä\n",
    "DriveCommand.LeftDuty", "KlappeIst.Riegel", [], [1], [[1, 2]], [[0, 1], [1, 2]], [{}], {},
    {"a": 1}, {"signal": "Gate.Angle"}, {"signal": "KlappeIst.Winkel", "values": {"open": 1}},
    1e300, -1e300, 1e-300,
]  # fmt: skip


def mutated(chance: random.Random, content: dict[str, Any]) -> dict[str, Any]:
    content = copy.deepcopy(content)
    for _ in range(chance.randint(1, 4)):
        places = list(slots(content))
        if not places:
            break
        container, key = chance.choice(places)
        other, at = chance.choice(places)
        value = chance.choice([*ODD, *[other[at]] * 8])
        if value is REMOVE:
            del container[key]
        elif isinstance(container, dict) and chance.random() < 0.15:
            container[chance.choice(["x", "", "a.b", "signal", "values"])] = copy.deepcopy(value)
        else:
            container[key] = copy.deepcopy(value)
    return content


@pytest.mark.parametrize(
    ("source", "load", "count"),
    [
        ("configs/vehicles/suv.toml", load_vehicle, 400),
        ("configs/scenarios/demo.toml", load_scenario, 400),
        ("configs/rigs/liftgate.toml", load_rig, 200),  # it takes longest
        ("tests/system/foreign/foreign.toml", load_rig, 400),
    ],
)
def test_a_damaged_file_is_refused_or_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, load: Callable[[Path], Any], count: int
):
    known: dict[Path, Any] = {}
    read = rig_file.load_messages

    def once(issues: Any, path: Path) -> Any:
        if path not in known:
            known[path] = read(issues, path)
        return known[path]

    monkeypatch.setattr(rig_file, "load_messages", once)
    (tmp_path / "foreign.dbc").write_bytes((FOREIGN / "foreign.dbc").read_bytes())
    content = tomllib.loads((ROOT / source).read_text(encoding="utf-8"))
    path = tmp_path / "file.toml"
    chance = random.Random(1)
    refused = 0
    for _ in range(count):
        path.write_text(document(mutated(chance, content)), encoding="utf-8")
        try:
            load(path)
        except ConfigError as error:
            refused += 1
            for fault in error.issues:
                assert fault.startswith(str(path))
                assert "\n" not in fault
    assert refused > count // 2


@pytest.mark.parametrize(
    ("database", "rig", "count"),
    [
        ("dbc/liftgate.dbc", "configs/rigs/liftgate.toml", 100),  # it takes longest
        ("tests/system/foreign/foreign.dbc", "tests/system/foreign/foreign.toml", 200),
    ],
)
def test_a_damaged_database_is_refused_or_read(tmp_path: Path, database: str, rig: str, count: int):
    text = (ROOT / database).read_text(encoding="utf-8")
    lines, words = text.splitlines(), re.findall(r"\w+", text)
    path = tmp_path / "rig.toml"
    path.write_bytes((ROOT / rig).read_bytes())
    chance = random.Random(2)
    taken = 0
    logging.disable(logging.CRITICAL)
    try:
        for _ in range(count):
            (tmp_path / Path(database).name).write_text(
                "\n".join(mangled(chance, lines, words)) + "\n", encoding="cp1252"
            )
            with contextlib.suppress(ConfigError):
                load_rig(path)
                taken += 1
    finally:
        logging.disable(logging.NOTSET)
    assert count // 10 < taken < count - count // 10
