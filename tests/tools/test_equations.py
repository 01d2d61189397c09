"""The index of equations is whole."""

from tools import equations
from tools.equations import EQUATIONS, implementations, numbers


def test_every_equation_of_the_model_is_implemented_somewhere() -> None:
    assert [number for number, names in implementations().items() if not names] == []


def test_every_module_that_implements_an_equation_is_tested() -> None:
    used_by = equations.tests()
    modules = {
        ".".join(name.split(".")[:2]) for names in implementations().values() for name in names
    }
    assert sorted(module for module in modules if not used_by.get(module)) == []


def test_ranges_are_written_out() -> None:
    assert numbers("(3.5–3.11, 4.12)") == {
        "3.5", "3.6", "3.7", "3.8", "3.9", "3.10", "3.11", "4.12",
    }  # fmt: skip
    assert numbers("(4.11) to (4.13)") == {"4.12", "4.13"}
    assert len(EQUATIONS) == 29
