"""Cases with mangled files: each is a file, a way to mangle it, and a call that reads it."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from pathlib import Path

from liftgate_hil.formats.suffixes import RECORDED
from tools.hostile import mangling
from tools.hostile.bases import Bases
from tools.hostile.case import Case

_SHORT = ["--clock", "free", "--duration", "0.05"]


def config_case(bases: Bases, seed: int, number: int, folder: Path) -> Case:
    """Return a case with a mangled vehicle, rig, scenario or CAN database, which is written to `folder`."""
    chance = random.Random(f"{seed}/config/{number}")
    make: Callable[[Bases, random.Random, Path], tuple[str, list[str]]] = chance.choices(
        [_vehicle, _scenario, _rig, _database], [3, 3, 3, 3]
    )[0]
    what, arguments = make(bases, chance, folder)
    outputs = [name for name in ("out.csv", "out.log") if name in arguments]
    return Case(f"config-{number}", arguments, what, outputs)


def _toml(bases: Bases, chance: random.Random, texts: list[str], path: Path) -> tuple[str, str]:
    """Write a mangled TOML file; return (the name for the call, how it is mangled)."""
    text = chance.choice(texts)
    kind = chance.choices(["values", "lines", "bytes", "no file", "monster"], [10, 5, 3, 1, 1])[0]
    if kind == "no file":
        return mangling.no_file(chance, path)
    if kind == "values":
        tree = mangling.tree(chance, chance.choice(bases.trees([text])), bases.words)
        raw = mangling.document(tree).encode("utf-8", "surrogatepass")
    elif kind == "lines":
        raw = mangling.lines(chance, text, bases.words).encode()
    elif kind == "bytes":
        raw = mangling.content(chance, text.encode())
    else:
        raw = _monster(chance, text)
    path.write_bytes(raw)
    return path.name, kind


def _monster(chance: random.Random, text: str) -> bytes:
    """Return TOML text of a length or depth that no person writes."""
    many = chance.choice([300, 3000, 50_000])
    return chance.choice(
        [
            ".".join("a" * many) + " = 1\n" + text,
            "x = " + "[" * many + "]" * many + "\n" + text,
            "x = " + "{a=" * many + "1" + "}" * many + "\n" + text,
            "".join(f"k{k} = {k}\n" for k in range(many)) + text,
            text + "".join(f"[[request]]\ntime = {k}\naction = 'open'\n" for k in range(many // 10)),
            f"{'n' * many * 10} = 1\n{text}",
            text + "\n[" + ".".join("b" * many) + "]\n",
            "#" * many * 100 + "\n" + text,
        ]
    ).encode()


def _vehicle(bases: Bases, chance: random.Random, folder: Path) -> tuple[str, list[str]]:
    name, kind = _toml(bases, chance, bases.vehicles, folder / "vehicle.toml")
    vehicle = ["--vehicle", name]
    output = ["--output", "out.csv"]
    call = chance.choices(
        [
            ["simulate", "--voltage", chance.choice(["12", "-12", "0"]), "--duration", "0.2", *output],
            ["demo", *_SHORT, "--no-record", "--record", "out.csv"],
            ["run", "--bus", "virtual:x", *_SHORT, "--record", "out.csv"],
            ["validate", str(bases.folder / "m.csv"), "--json"],
        ],
        [6, 3, 2, 1],
    )[0]
    return f"vehicle: {kind}", [*call, *vehicle]


def _scenario(bases: Bases, chance: random.Random, folder: Path) -> tuple[str, list[str]]:
    name, kind = _toml(bases, chance, bases.scenarios, folder / "scenario.toml")
    call = chance.choice(
        [
            ["demo", *_SHORT, "--no-record", "--record", "out.csv"],
            ["run", "--bus", "virtual:x", *_SHORT],
            ["simulate", "--voltage", "12", "--duration", "0.05", "--output", "out.csv"],
        ]
    )
    return f"scenario: {kind}", [*call, "--scenario", name]


def _rig(bases: Bases, chance: random.Random, folder: Path) -> tuple[str, list[str]]:
    for name, text in bases.databases:
        (folder / name).write_bytes(text.encode("cp1252"))
    name, kind = _toml(bases, chance, bases.rigs, folder / "rig.toml")
    return f"rig: {kind}", [*_rig_call(bases, chance), "--rig", name]


def _rig_call(bases: Bases, chance: random.Random) -> list[str]:
    return chance.choice(
        [
            ["run", "--bus", "virtual:x", *_SHORT, "--record", "out.log", "--record", "out.csv"],
            ["demo", *_SHORT, "--no-record", "--record", "out.log"],
            ["validate", str(bases.folder / "demo.log"), "--json"],
        ]
    )


def _database(bases: Bases, chance: random.Random, folder: Path) -> tuple[str, list[str]]:
    which = chance.randrange(len(bases.databases))
    name, text = bases.databases[which]
    path = folder / name
    kind = chance.choices(["lines", "bytes", "no file"], [10, 3, 1])[0]
    if kind == "no file":
        _, kind = mangling.no_file(chance, path)
    elif kind == "lines":
        path.write_bytes(mangling.lines(chance, text, bases.words).encode("cp1252", "replace"))
    else:
        path.write_bytes(mangling.content(chance, text.encode("cp1252")))
    (folder / "rig.toml").write_text(bases.rigs[which], encoding="utf-8")
    return f"database: {kind}", [*_rig_call(bases, chance), "--rig", "rig.toml"]


def measurement_case(bases: Bases, seed: int, number: int, folder: Path) -> Case:
    """Return a case with a mangled measurement of any format, which is written to `folder`."""
    chance = random.Random(f"{seed}/measurement/{number}")
    source = chance.choice(chance.choices([bases.tables, bases.logs, bases.binaries], [5, 3, 2])[0])
    path = folder / f"data{source.suffix}"
    name, kind = path.name, "as it is"
    how = chance.random()
    if how < 0.04:
        name, kind = mangling.no_file(chance, path)
    elif source in bases.binaries or how < 0.2:
        path.write_bytes(mangling.content(chance, source.read_bytes()))
        kind = "bytes"
    elif source in bases.tables and how < 0.8:
        path.write_text(_table(chance, source.read_text()), encoding="utf-8")
        kind = "cells"
    elif source in bases.logs or how < 0.97:
        text = mangling.lines(chance, source.read_text(), ["time_s", "123#11", "voltage_v", "x"])
        path.write_text(text, encoding="utf-8", errors="replace")
        kind = "lines"
    else:
        shutil.copy(source, path.with_suffix(chance.choice([".csv", ".mf4", ".asc", ".xlsx", ".log"])))
        name, kind = next(each.name for each in folder.iterdir()), "another suffix"
    calls = [["validate", name, "--json"], ["validate", name, "--result", "r.json"]]
    if path.suffix in (".csv", ".mf4"):
        calls += [["simulate", "--input", name, "--output", "out.csv"]] * 3
    if chance.random() < 0.1:
        calls = [["identify", name, "--estimate", "motor.resistance", "--json"]]
    arguments = [*chance.choice(calls), *chance.choice(_FLAGS)]
    if arguments[0] == "simulate":
        arguments = [each for each in arguments if each not in ("--from", "--to", "0.2", "1e9")]
    outputs = [each for each in ("out.csv",) if each in arguments]
    return Case(f"measurement-{number}", arguments, f"{source.name}: {kind}", outputs)


def recording_case(bases: Bases, seed: int, number: int, folder: Path) -> Case:
    """Return a case with a mangled recording of any format, which is written to `folder`.

    The call converts, plots, compares, judges or replays it.
    """
    chance = random.Random(f"{seed}/recording/{number}")
    source = chance.choice(bases.recordings)
    path = folder / f"data{source.suffix}"
    name, kind = path.name, "bytes"
    how, is_text = chance.random(), source.suffix in (".csv", ".log", ".asc", ".trc")
    if how < 0.05:
        name, kind = mangling.no_file(chance, path)
    elif how < 0.1:
        kind = "another suffix"
        shutil.copy(source, folder / f"data{chance.choice(RECORDED)}")
        name = next(each.name for each in folder.iterdir())
    elif source.suffix == ".csv" and how < 0.8:
        kind = "cells"
        path.write_text(_table(chance, source.read_text()), encoding="utf-8")
    elif is_text and how < 0.9:
        kind = "lines"
        text = mangling.lines(chance, source.read_text(), ["time_s", "123#11", "x", "Rx", "d"])
        path.write_text(text, encoding="utf-8", errors="replace")
    else:
        path.write_bytes(mangling.content(chance, source.read_bytes()))
    rig = [[], [], ["--rig", "liftgate"], ["--rig", "liftgate"]]
    sound = str(source)
    calls = [
        ["convert", name, f"out{chance.choice(RECORDED)}", *chance.choice(rig)],
        ["compare", *chance.sample([name, sound], 2), *chance.choice([[], ["--json"]])],
        ["replay", name, *_PLAYED, *chance.choice(_PLAY_FLAGS)],
        ["plot", name, *chance.choice(_FIGURES), "--output", chance.choice(_PICTURES), *chance.choice(rig)],
        ["judge", name, "--scenario", str(bases.judged), "--rig", "liftgate"],
    ]
    arguments = chance.choices(calls, [4, 3, 4, 1, 1])[0]
    return Case(f"recording-{number}", arguments, f"{source.name}: {kind}")


_PICTURES = ["p.png", "p.svg", "p.pdf", "p.html"]
_FIGURES = [[], *(["--figure", each] for each in ("thesis", "phase", "pinch"))]
# The end is limited so that no call waits for a mangled time stamp that is hours away.
_PLAYED = ["--bus", "virtual:x", "--from", "0", "--to", "2", "--speed", "50"]
_PLAY_FLAGS: list[list[str]] = [
    [], ["--json"], ["--direction", "both"], ["--only", "0x200-0x2FF"], ["--except", "Gate,0x120"],
    ["--times", "2"], ["--quiet"],
]  # fmt: skip

_FLAGS: list[list[str]] = [
    [], [], [], [], ["--map", "voltage_v=left_voltage_v"], ["--map", "left_voltage_v=left_voltage_v"],
    ["--map", "time_s=time_s[ms]"], ["--from", "0.2"], ["--to", "1e9"], ["--vehicle", "compact"],
]  # fmt: skip


def _table(chance: random.Random, text: str) -> str:
    """Return a CSV table with some of its cells, columns, rows or times mangled."""
    rows = [line.split(",") for line in text.split("\n") if line]
    head, body = rows[0], rows[1:]
    for _ in range(chance.randint(1, 3)):
        kind = chance.randrange(7)
        column, row = chance.randrange(len(head)), chance.randrange(len(body))
        if kind == 0:
            body[row][column] = chance.choice([*mangling.NUMBERS, "", "x", '"', "1e5"])
        elif kind == 1:
            head[column] = chance.choice([*head, "", "left_current_ma", "voltage_v", "left_duty", "latched"])
        elif kind == 2:  # a clock that jumps
            jump = chance.choice(["36000", "1.7e9", "1e306", "-5", "0.3"])
            for each in body[row:]:
                each[0] = repr(float(each[0] or 0) + float(jump)) if _is_number(each[0]) else each[0]
        elif kind == 3:  # a column in another unit
            factor = chance.choice([1e-324, 1e-300, 1e-3, 1e3, 1e6, 1e300, -1.0, 0.0])
            for each in body:
                if _is_number(each[column]):
                    each[column] = repr(float(each[column]) * factor)
        elif kind == 4:
            body = body[: chance.choice([0, 1, 19, 20, len(body)])] or [body[0]]
        elif kind == 5:
            body[row] = body[row][: chance.randrange(len(head))]
        else:
            body[row], body[0] = body[0], body[row]
        body = [each if len(each) == len(head) else [*each, *[""] * len(head)][: len(head)] for each in body]
    separator = chance.choice([",", ",", ",", ";", "\t"])
    return "\n".join([separator.join(each) for each in [head, *body]]) + "\n"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
