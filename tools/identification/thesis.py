"""Repetition of the thesis's three runs (§4.6) on generated data of known truth, beside its Tables 4.1 and 4.2."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import liftgate_hil as lh
from liftgate_hil.identification.result import Identification
from tools.identification.measurements import TRUTH

# The seal's phase is cut and the data are thinned out, as in §4.6.1.
CUT: dict[str, Any] = {"cut_angle": (1.0, 78.0), "decimate": 10}
# (estimate, standard deviation) of each parameter in the thesis.
TABLE_4_1 = {
    "motor.resistance": (2.12797, 0.0217914),
    "motor.inductance": (4.20318e-5, 61.14862e-5),
    "motor.rotor_inertia": (1.47e-5, 2.81633e-7),
    "motor.load_torque": (0.001, 0.000434814),
}
TABLE_4_2 = {
    "motor.resistance": (2.11041, 0.0387357),
    "motor.inductance": (2.47601e-5, 38.388e-5),
    "motor.torque_constant": (0.0118198, 0.00029829),
    "motor.speed_constant": (0.0776828, 0.000627679),
    "motor.efficiency": (0.960724, 0.0283763),
}
RUNS: dict[str, dict[str, tuple[float, float]]] = {"thesis-1": TABLE_4_1, "thesis-2": TABLE_4_2, "thesis-3": {}}


def run(folder: Path, preset: str, **more: Any) -> Identification:
    """Return the result of one run on `folder`'s opening.csv; `more` are arguments of `identify`."""
    return lh.identify(folder / "opening.csv", preset=preset, **more)


def table(result: Identification, thesis: dict[str, tuple[float, float]]) -> list[str]:
    """Return Markdown lines: a table of one run's estimates beside the thesis's, and the fits of the run."""
    lines = [
        "| parameter | truth | initial | found | std | identifiable | thesis found | std |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for each in result.parameters:
        name = each.name
        value, std = thesis.get(name, (None, None))
        identifiable = "yes" if each.identifiable else "**no**"
        lines.append(
            f"| `{name}` | {TRUTH[name]:.4g} | {each.initial:.4g} | {each.value:.4g} | "
            f"{_shown(each.std)} | {identifiable} | {_shown(value)} | {_shown(std)} |"
        )
    fits = ", ".join(f"{name} {fit:.1f} %" for name, fit in result.fit_percent.items())
    return [*lines, "", f"Fit: {fits}."]


def _shown(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else f"{value:.3g}"
