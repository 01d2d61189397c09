"""Units of parameters, derived from the keys that use them in a scenario."""

from __future__ import annotations

import tomllib

from liftgate_hil.config.parameter_units import parameter_units
from liftgate_hil.config.scenario import read_scenario
from liftgate_hil.config.shipped import data_root


def units(text: str) -> dict[str, str]:
    return parameter_units([tomllib.loads(text)])


def test_a_parameter_has_the_unit_of_the_key_that_uses_it() -> None:
    found = units(
        """
        duration = "$length"
        [set]
        "environment.road_slope_deg" = "$slope"
        "gear.ratio" = "$gears"
        [[obstacle]]
        angle_deg = "$angle"
        stiffness = "$rod"
        [[fault]]
        kind = "current_offset"
        value = "$offset"
        start = 1.0
        for_s = "$length"
        [[profile]]
        quantity = "supply_voltage_v"
        points = [[0.0, 12.0], ["$when", "$dip"]]
        """
    )
    expected = {
        "length": "s",
        "slope": "deg",
        "angle": "deg",
        "rod": "N/m",
        "offset": "A",
        "when": "s",
        "dip": "V",
    }
    assert {name: found[name] for name in expected} == expected
    assert found["gears"] == ""


def test_a_parameter_in_a_condition_has_the_unit_of_the_compared_columns() -> None:
    found = units(
        """
        [[expect]]
        name = "x"
        always = "pinch_force_n < $limit and not (gate_angle_deg > $angle + $more or sensed.left_current_a < $i)"
        after = "gate_rate_degps > 2 * $factor"
        [[expect]]
        name = "y"
        eventually = "Gate.Angle > $unknown"
        """
    )
    assert found == {"limit": "N", "angle": "deg", "more": "deg", "i": "A"}


def test_a_parameter_used_with_several_units_has_none() -> None:
    assert units('[[obstacle]]\nangle_deg = "$x"\nstiffness = "$x"\n') == {}


def test_parameters_of_the_trap_matrix_have_units_also_from_included_files() -> None:
    file = read_scenario(data_root() / "configs/campaigns/trap-matrix/rod.toml")
    found = parameter_units(part.raw for part in file.parts)
    assert {name: found[name] for name in ("rod", "angle", "limit", "away")} == {
        "rod": "N/m", "angle": "deg", "limit": "N", "away": "deg",
    }  # fmt: skip
