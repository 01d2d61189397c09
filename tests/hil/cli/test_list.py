"""`list`, and the suggestions for a name that does not exist."""

from __future__ import annotations

import pytest

from liftgate_hil.cli.main import main
from liftgate_hil.config.shipped import CAMPAIGNS, KINDS, PACK, find_config, shipped_files
from liftgate_hil.ecu.mutants import MUTANTS


def listed(capsys: pytest.CaptureFixture[str], *prefix: str) -> dict[str, str]:
    """Return the listed names with their descriptions."""
    assert main(["list", *prefix]) == 0
    lines = [line.split(None, 1) for line in capsys.readouterr().out.splitlines() if line.startswith("  ")]
    return dict(lines)


def test_all_shipped_names_are_listed_with_a_description(capsys: pytest.CaptureFixture[str]) -> None:
    found = listed(capsys)
    for kind in KINDS:
        names = shipped_files(kind)
        assert names
        for name, path in names.items():
            assert found[f"{PACK if kind == CAMPAIGNS else ''}{name}"]
            assert find_config(kind, name) == path
    assert {"pack/crank_dip", "suv", "liftgate", "pack:trap-matrix", "reference"} <= set(found)
    assert {f"mutant:{name}" for name in MUTANTS} <= set(found)
    assert not [name for name in found if name.startswith(("parts/", "trap-matrix/"))]


@pytest.mark.parametrize("prefix", ["pack/trap_40", "trap_40"])
def test_list_selects_by_a_prefix(capsys: pytest.CaptureFixture[str], prefix: str) -> None:
    assert set(listed(capsys, prefix)) == {f"pack/trap_40deg_{rate}npmm" for rate in (10, 20, 65)}


def test_list_selects_by_a_kind_of_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(listed(capsys, "Vehicles")) == set(shipped_files("vehicles"))
    assert set(listed(capsys, "ECUs")) == {"reference", *(f"mutant:{name}" for name in MUTANTS)}


def test_a_prefix_without_a_match_is_refused_with_similar_names(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "pack/crnk"]) == 2
    assert "PREFIX pack/crnk: no name begins so; allowed: pack/crank_dip, " in capsys.readouterr().err


TRAPS = "did you mean pack/trap_40deg_10npmm or pack/trap_40deg_20npmm or pack/trap_40deg_65npmm?"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["test", "pack/trap_40deg"], TRAPS),
        (["demo", "--scenario", "trap_40deg"], TRAPS),
        (["demo", "--scenario", "crank_dip"], "did you mean pack/crank_dip?"),
        (["simulate", "--vehicle", "suvv"], "did you mean suv?"),
        (["simulate", "--set", "voltage=9"], "voltage: 9: unknown key; did you mean supply.voltage or "),
        (["simulate", "--set", "road_slope_deg=9"], "did you mean environment.road_slope_deg? allowed: "),
        (["demo", "--fault", "spring_lost"], "faults are [[fault]] of a scenario, or injected on the page"),
    ],
)
def test_an_unknown_name_is_answered_with_similar_names(
    capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    try:
        code = main(arguments)
    except SystemExit as ended:
        code = int(ended.code or 0)
    assert code == 2
    assert said in capsys.readouterr().err
