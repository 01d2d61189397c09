"""Signals of a database that the bench can send: all but those beyond the loop's table sizes."""

from __future__ import annotations

import cantools

from liftgate_hil.codec.messages import Messages
from liftgate_hil.config.restbus import sendable
from liftgate_hil.stimuli.restbus import BusTables


def message(number: int, name: str, length: int, signals: list[str]) -> str:
    lines = "".join(f' SG_ {each} (1,0) [0|255] "" Gate\n' for each in signals)
    return f"BO_ {number} {name}: {length} Car\n{lines}\n"


def pages(count: int) -> list[str]:
    return ["Page M : 0|8@1+", *(f"Cell{k} m{k} : 8|8@1+" for k in range(count))]


MESSAGES = {
    "Speed": message(0x100, "Speed", 8, ["Wheel : 0|8@1+"]),
    "Cells": message(0x101, "Cells", 8, pages(96)),
    "FewCells": message(0x102, "FewCells", 8, pages(3)),
    "Long": message(0x103, "Long", 32, ["Far : 100|8@1+"]),
}
DATABASE = (
    'VERSION ""\nNS_ :\nBS_:\nBU_: Car Gate\n' + "".join(MESSAGES.values())
    + 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;\nBA_DEF_DEF_ "GenMsgCycleTime" 100;\n'
)  # fmt: skip
TABLES = BusTables(Messages(cantools.database.load_string(DATABASE, "dbc").messages), (), {})


def test_messages_with_too_many_pages_or_for_another_kind_of_bus_are_left_out() -> None:
    few = ("FewCells.Cell0", "FewCells.Cell1", "FewCells.Cell2")
    assert sendable(TABLES, (), is_fd=False) == ("Speed.Wheel", *few)
    assert sendable(TABLES, ("FewCells",), is_fd=True) == ("Speed.Wheel", "Long.Far")
