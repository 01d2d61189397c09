"""Edges of the Hall sensors as programs have them."""

from __future__ import annotations

from typing import NamedTuple

from liftgate_plant.hall import EdgeRing, edges_after

DRIVES = ("left", "right")
CHANNELS = ("a", "b")


class Edge(NamedTuple):
    """One edge: model time [s], drive (`left`, `right`), channel (`a`, `b`) and the level after it."""

    time_s: float
    drive: str
    channel: str
    level: int


def edges_since(ring: EdgeRing, seen: int) -> list[Edge]:
    """The edges that came after so many."""
    return [
        Edge(time, DRIVES[drive], CHANNELS[channel], level)
        for time, drive, channel, level in edges_after(ring, seen).tolist()
    ]
