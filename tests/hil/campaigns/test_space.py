"""The syntax of `--vary`, and the values that it stands for."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from liftgate_hil.campaigns.distributions import FAMILIES, Distribution
from liftgate_hil.campaigns.space import Axis, Covariance, Space, space_of
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant.vehicle import Vehicle

CALM = settings(deadline=None, derandomize=True, database=None, max_examples=60)

PARAMETERS = {"rod": "N/m", "angle": "deg"}
NUMBERS = "numbers as VALUE,VALUE,… or FIRST:LAST:COUNT with 2 to 100000 values"
FORM = "NAME=VALUE,VALUE,…, NAME=FIRST:LAST:COUNT, NAME~DISTRIBUTION, or vehicle"
SEEDS = "whole numbers from 0 to 4294967295"
NAMES = ["gate.mass", "gate.gravity_point[0]", "motor.resistance"]
MEANS = [31.0, 0.45, 0.32]
STANDARD = np.array([0.8, 0.02, 0.01])
CORRELATION = np.array([[1.0, -0.8, 0.3], [-0.8, 1.0, 0.1], [0.3, 0.1, 1.0]])
COVARIANCE = CORRELATION * np.outer(STANDARD, STANDARD)


@cache
def suv() -> Vehicle:
    return vehicle_from("suv")


def space(*texts: str, identification: object = None) -> Space:
    content = {} if identification is None else {"identification": identification}
    return space_of(texts, PARAMETERS, suv(), content)


def identified(names: object = NAMES, values: object = MEANS, covariance: object = None) -> dict[str, object]:
    matrix = COVARIANCE.tolist() if covariance is None else covariance
    return {"parameters": names, "values": values, "covariance": matrix}


def refusal(*texts: str, identification: object = None) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        space(*texts, identification=identification)
    return list(caught.value.issues)


def draws(made: Space, count: int = 4001) -> np.ndarray:
    shares = np.linspace(0.0, 1.0, count)[:, None]
    return made.values(np.repeat(shares, len(made.targets), axis=1))


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("rod=10000", (10000.0,)),
        ("rod=10000,20000,65000", (10000.0, 20000.0, 65000.0)),
        ("rod=65_000,1e4", (65000.0, 10000.0)),
        (" rod = 1 , -2.5 ", (1.0, -2.5)),
        ("angle=10:70:13", tuple(range(10, 71, 5))),
        ("angle=70:10:3", (70.0, 40.0, 10.0)),
        ("seed=1:5:5", (1.0, 2.0, 3.0, 4.0, 5.0)),
        ("draw=0,4294967295", (0.0, 4294967295.0)),
        ("supply.voltage=9.5,12,15", (9.5, 12.0, 15.0)),
        ("gate.gravity_point[1]=-0.1,0.1", (-0.1, 0.1)),
        ("friction.cycles=0,20000", (0.0, 20000.0)),
        ("sensors.commutator_segments=20,24", (20.0, 24.0)),
    ],
)
def test_a_grid_has_the_values_of_its_text_in_their_order(text: str, values: tuple[float, ...]) -> None:
    made = space(text)
    assert made.grids[0].grid == values
    assert made.levels == (len(values),)
    assert made.names == (text.partition("=")[0].strip(),)


@pytest.mark.parametrize(
    ("text", "allowed"),
    [
        ("rod", f"`vary` rod: allowed: {FORM}"),
        ("", f"`vary` : allowed: {FORM}"),
        ("=5", f"`vary` =5: allowed: {FORM}"),
        ("~uniform(0,1)", f"`vary` ~uniform(0,1): allowed: {FORM}"),
        *(
            (text, f"`vary` {text}: allowed: {NUMBERS}")
            for text in (
                "rod=", "rod=1,", "rod=x", "rod=nan", "rod=1,inf", "rod=1e999", "rod=0x10", "rod=1:2",
                "rod=1:2:3:4", "rod=1:2:1", "rod=1:2:0", "rod=1:2:-3", "rod=1:2:100001", "rod=1:2:3.5",
                "rod=3:3:2", "rod=0:inf:3",
            )
        ),
        ("rod=1,2,1", "`vary` rod=1,2,1: a value twice; allowed: each once"),
        ("rod=0,-0.0", "`vary` rod=0,-0.0: a value twice; allowed: each once"),
        ("seed=-1,2", f"`vary` seed=-1,2: allowed: {SEEDS}"),
        ("seed=1.5", f"`vary` seed=1.5: allowed: {SEEDS}"),
        ("draw=1:2:3", f"`vary` draw=1:2:3: allowed: {SEEDS}"),
        ("draw=4294967296", f"`vary` draw=4294967296: allowed: {SEEDS}"),
        ("seed~integer(-1,5)", f"`vary` seed~integer(-1,5): allowed: {SEEDS}"),
        *(
            (text, f"`vary` {text}: allowed: integer(low, high), or a grid of whole numbers")
            for text in ("seed~normal(5,1)", "seed~uniform(0,10)", "draw~triangular(0,5,10)")
        ),
        ("supply.voltage=12,500", "`vary` supply.voltage=12,500: 500: allowed: 0 to 60 V"),
        ("friction.cycles=-5", "`vary` friction.cycles=-5: -5: allowed: 0 to 1e+07"),
        ("gate.gravity_point[0]=0.3,99", "`vary` gate.gravity_point[0]=0.3,99: 99: allowed: -10 to 10 m"),
        (
            "sensors.commutator_segments=20:21:3",
            "`vary` sensors.commutator_segments=20:21:3: 20.5: allowed: a whole number from 2 to 200",
        ),
        (
            "bridge.pwm_frequency=0,500",
            "`vary` bridge.pwm_frequency=0,500: 500: allowed: 0, or 1000 to 1e+06 Hz",
        ),
        *(
            (f"rod~{own}", f"`vary` rod: {own}: allowed: {own.partition('(')[0]}({arguments}) with {allowed}")
            for own, arguments, allowed in (
                ("uniform(2,1)", "low, high", "low < high"),
                ("uniform(1)", "low, high", "low < high"),
                ("uniform(1,2,3)", "low, high", "low < high"),
                ("uniform(0,inf)", "low, high", "low < high"),
                ("uniform(a,b)", "low, high", "low < high"),
                ("uniform()", "low, high", "low < high"),
                ("loguniform(0,1)", "low, high", "0 < low < high"),
                ("normal(0,0)", "mean, std", "std > 0"),
                ("normal(nan,1)", "mean, std", "std > 0"),
                ("lognormal(-1,1)", "median, sigma", "median > 0, sigma > 0 (std of the logarithm)"),
                ("triangular(0,2,1)", "low, mode, high", "low <= mode <= high, low < high"),
                ("triangular(1,1,1)", "low, mode, high", "low <= mode <= high, low < high"),
                ("integer(0,0.5)", "low, high", "whole numbers, low < high, up to 4294967295 of them"),
                ("integer(0,1e12)", "low, high", "whole numbers, low < high, up to 4294967295 of them"),
            )
        ),
    ],
)  # fmt: skip
def test_an_invalid_vary_is_refused_with_the_allowed_form(text: str, allowed: str) -> None:
    assert refusal(text) == [allowed]


@pytest.mark.parametrize(
    "given", ["", "cauchy(0,1)", "uniform", "uniform(0,1", "uniform(0,1) x", "uniform((0,1))"]
)
def test_an_unknown_distribution_is_refused_with_the_existing_ones(given: str) -> None:
    (message,) = refusal(f"rod~{given}")
    assert message.startswith(f"`vary` rod: {given}: allowed: uniform(low, high), loguniform(low, high)")
    assert all(name in message for name in FAMILIES)


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("rods", "motor.resistance"),
        ("gate.masses", "motor.resistance"),
        ("motor.commutator_segments", "sensors.commutator_segments"),
        ("gate.gravity_point", "gate.gravity_point[0], gate.gravity_point[1]"),
        ("gate.gravity_point[2]", "gate.gravity_point[0], gate.gravity_point[1]"),
    ],
)
def test_an_unknown_name_is_refused_with_the_allowed_names(name: str, near: str) -> None:
    (message,) = refusal(f"{name}=1")
    start = f"`vary` {name}: allowed: rod, angle, seed, draw, or a key of the vehicle file such as "
    assert message.startswith(f"{start}{near}")


def test_all_issues_of_vary_are_reported_at_once() -> None:
    assert len(refusal("rod=x", "seed=-1", "angle", "supply.voltage=500")) == 4


@pytest.mark.parametrize(
    ("first", "second", "name"),
    [
        ("rod=1,2", "rod~uniform(1,2)", "rod"),
        ("vehicle", "gate.mass=30,31", "gate.mass"),
        ("gate.mass=30,31", "vehicle", "gate.mass"),
    ],
)
def test_varying_a_name_twice_is_refused(first: str, second: str, name: str) -> None:
    assert refusal(first, second, identification=identified()) == [
        f"`vary` {second}: {name}: varied twice; allowed: each name once"
    ]


SHARES = np.linspace(0.0005, 0.9995, 1999)


@pytest.mark.parametrize(
    ("text", "reference"),
    [
        ("uniform(-3, 7)", stats.uniform(-3.0, 10.0)),
        ("loguniform(5e3, 1e5)", stats.loguniform(5e3, 1e5)),
        ("normal(20, 4)", stats.norm(20.0, 4.0)),
        ("lognormal(8000, 0.1)", stats.lognorm(0.1, scale=8000.0)),
        ("triangular(1, 2, 5)", stats.triang(0.25, 1.0, 4.0)),
        ("triangular(1, 1, 5)", stats.triang(0.0, 1.0, 4.0)),
        ("triangular(1, 5, 5)", stats.triang(1.0, 1.0, 4.0)),
        ("integer(-2, 8)", stats.randint(-2, 9)),
    ],
)
def test_quantiles_are_those_of_the_distribution(text: str, reference: object) -> None:
    found = space(f"rod~{text}").values(SHARES[:, None])[:, 0]
    np.testing.assert_allclose(found, reference.ppf(SHARES), rtol=1e-12, atol=1e-12)  # type: ignore[attr-defined]


bounds = st.tuples(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6)).map(lambda pair: (pair[0], pair[0] + pair[1]))
distributions = st.one_of(
    bounds.map(lambda b: Distribution("uniform", b)),
    st.tuples(st.floats(1e-6, 1e3), st.floats(1.001, 1e6)).map(
        lambda p: Distribution("loguniform", (p[0], p[0] * p[1]))
    ),
    st.tuples(st.floats(-1e6, 1e6), st.floats(1e-3, 1e3)).map(lambda p: Distribution("normal", p)),
    st.tuples(st.floats(1e-3, 1e6), st.floats(1e-3, 2.0)).map(lambda p: Distribution("lognormal", p)),
    st.tuples(bounds, st.floats(0.0, 1.0)).map(
        lambda p: Distribution("triangular", (p[0][0], p[0][0] + p[1] * (p[0][1] - p[0][0]), p[0][1]))
    ),
    st.tuples(st.integers(-1000, 1000), st.integers(1, 1000)).map(
        lambda p: Distribution("integer", (float(p[0]), float(p[0] + p[1])))
    ),
)  # fmt: skip


@CALM
@given(distributions, st.lists(st.floats(0.0, 1.0), min_size=2, max_size=20))
def test_quantiles_are_finite_and_nondecreasing(distribution: Distribution, shares: list[float]) -> None:
    found = distribution.quantiles(np.sort(shares))
    assert np.isfinite(found).all()
    slack = 1e-12 * np.abs(found).max()
    assert (np.diff(found) >= -slack).all()


@CALM
@given(distributions)
def test_a_distribution_reads_back_the_same_from_its_text(distribution: Distribution) -> None:
    arguments = ",".join(repr(each) for each in distribution.arguments)
    (axis,) = space(f"rod~{distribution.family}({arguments})").factors
    assert isinstance(axis, Axis)
    assert axis.distribution == distribution


def test_only_grids_and_integer_distributions_have_a_number_of_levels() -> None:
    assert space("rod~integer(3,12)", "angle~uniform(3,12)", "seed=1,5,9").levels == (10, 0, 3)


@pytest.mark.parametrize(
    ("text", "values"), [("rod~integer(1,4)", [1.0, 2.0, 3.0, 4.0]), ("rod=5,1,3", [5.0, 1.0, 3.0])]
)
def test_integers_and_values_of_a_grid_are_equally_probable(text: str, values: list[float]) -> None:
    found = draws(space(text), 1000 * len(values))[:, 0]
    assert found.tolist() == np.repeat(values, 1000).tolist()  # in their order


def test_draws_of_a_vehicle_key_are_limited_to_its_range_and_those_of_a_parameter_are_not() -> None:
    volts = draws(space("supply.voltage~normal(55,10)"))[:, 0]
    assert (volts.min(), volts.max()) == (0.0, 60.0)
    assert (volts == 60.0).mean() == pytest.approx(stats.norm.sf(0.5), abs=1e-3)
    segments = draws(space("sensors.commutator_segments~uniform(1.5,9.5)"))[:, 0]
    assert np.unique(segments).tolist() == list(range(2, 10))
    frequency = draws(space("bridge.pwm_frequency~uniform(-500,2000)"))[:, 0]  # 0, or 1000 at least
    assert not ((frequency > 0.0) & (frequency < 1000.0)).any()
    assert frequency[0] == 0.0
    assert (frequency == 1000.0).mean() == pytest.approx(0.4, abs=1e-3)
    assert draws(space("rod~uniform(-1e9,1e9)"))[[0, -1], 0].tolist() == [-1e9, 1e9]


def test_columns_are_in_the_order_of_the_vary_texts() -> None:
    made = space("angle=1,2", "vehicle", "rod~uniform(0,1)", identification=identified())
    assert made.names == ("angle", *NAMES, "rod")
    assert made.levels == (2, 0, 0, 0, 0)
    assert made.values(np.full((7, 5), 0.5)).shape == (7, 5)
    assert space().values(np.zeros((3, 0))).shape == (3, 0)


def test_a_factor_is_written_like_its_vary_text() -> None:
    made = space("rod=1e4,20000", "angle~uniform(20,60)", "vehicle", identification=identified())
    assert [str(each) for each in made.factors] == ["rod=10000,20000", "angle~uniform(20, 60)", "vehicle"]


def test_varied_values_have_the_units_of_their_parameters_and_keys() -> None:
    made = space(
        "rod=1", "supply.voltage=12", "environment.ambient_temperature_degc=20", "gate.gravity_point[0]=0.4"
    )
    assert [each.unit for each in made.targets] == ["N/m", "V", "°C", "m"]


def test_draws_of_a_vehicle_have_the_mean_and_the_covariance_of_its_identification() -> None:
    made = space("vehicle", identification=identified())
    count = 200_000
    found = made.values(np.random.default_rng(5).random((count, 3)))
    assert (np.abs(found.mean(axis=0) - MEANS) < 5.0 * STANDARD / math.sqrt(count)).all()
    np.testing.assert_allclose(np.corrcoef(found.T), CORRELATION, atol=0.01)
    np.testing.assert_allclose(found.std(axis=0), STANDARD, rtol=0.01)


def test_a_drawn_coordinate_of_a_vehicle_point_keeps_the_other_coordinate_of_the_file() -> None:
    target = space("vehicle", identification=identified()).targets[1]
    assert target.key == "gate.gravity_point"
    assert target.point == suv().gate.gravity_point


def test_draws_of_a_vehicle_are_limited_to_the_ranges_of_its_keys() -> None:
    wide = identified(["motor.efficiency"], [0.95], [[0.04]])
    found = draws(space("vehicle", identification=wide))[:, 0]
    assert found.max() == 1.0
    assert (found == 1.0).mean() == pytest.approx(stats.norm.sf(0.25), abs=1e-3)


def test_a_parameter_without_variance_keeps_its_estimate() -> None:
    own = identified(NAMES[:2], MEANS[:2], [[0.64, 0.0], [0.0, 0.0]])
    found = draws(space("vehicle", identification=own))
    assert np.unique(found[:, 1]).tolist() == [0.45]
    assert found[:, 0].std() > 0.7


def test_a_covariance_of_full_correlation_moves_its_parameters_together() -> None:
    own = identified(NAMES[:2], MEANS[:2], [[0.64, 0.016], [0.016, 0.0004]])
    found = space("vehicle", identification=own).values(np.random.default_rng(2).random((500, 2)))
    assert np.corrcoef(found.T)[0, 1] == pytest.approx(1.0, abs=1e-6)


@CALM
@given(
    st.lists(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3), min_size=3, max_size=3),
    st.lists(st.floats(1e-3, 1e3), min_size=3, max_size=3),
)
def test_a_root_times_its_transpose_gives_the_covariance(rows: list[list[float]], scales: list[float]) -> None:
    half = np.array(rows) * np.array(scales)[:, None]
    matrix = half @ half.T
    (made,) = space("vehicle", identification=identified(covariance=matrix.tolist())).factors
    assert isinstance(made, Covariance)
    root = np.array(made.root)
    standard = np.sqrt(np.diag(matrix))
    np.testing.assert_allclose(root @ root.T, matrix, atol=1e-6 * float(standard.max()) ** 2)


NO_IDENTIFICATION = (
    "`vary` vehicle: allowed: a vehicle file with [identification] parameters, values and covariance, "
    "as `identify --save-vehicle` writes it"
)


@pytest.mark.parametrize(
    "own",
    [
        None, 5, {}, {"parameters": NAMES, "values": MEANS}, identified(names=7), identified(values=["a"] * 3),
        identified(covariance=[[1.0, 0.0, 0.0], [0.0, 1.0], [0.0]]), identified(covariance="none"),
    ],
)  # fmt: skip
def test_varying_a_vehicle_without_an_identification_is_refused(own: object) -> None:
    assert refusal("vehicle", identification=own) == [NO_IDENTIFICATION]


@pytest.mark.parametrize(
    ("own", "allowed"),
    [
        (identified(values=[31.0, math.nan, 0.32]), "parameters, values: allowed: each name once, finite numbers"),
        (identified(["gate.mass"] * 3), "parameters, values: allowed: each name once, finite numbers"),
        (identified(values=MEANS[:2]), "covariance: allowed: a symmetric 3 × 3 matrix"),
        *(
            (identified(covariance=each), "covariance: allowed: a symmetric 3 × 3 matrix")
            for each in (
                [[1.0]],
                [[1.0, 0.5, 0.0], [0.4, 1.0, 0.0], [0.0, 0.0, 1.0]],
                [[1.0, math.nan, 0.0], [math.nan, 1.0, 0.0], [0.0, 0.0, 1.0]],
                [1.0, 1.0, 1.0],
            )
        ),
        *(
            (identified(covariance=each), "covariance: allowed: no negative eigenvalue")
            for each in (
                [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                [[1.0, 1.5, 0.0], [1.5, 1.0, 0.0], [0.0, 0.0, 1.0]],
                [[0.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 1.0]],
                [[1.0, 0.9, 0.9], [0.9, 1.0, -0.9], [0.9, -0.9, 1.0]],
            )
        ),
    ],
)
def test_invalid_estimates_or_an_invalid_covariance_are_refused(own: object, allowed: str) -> None:
    assert refusal("vehicle", identification=own) == [f"`vary` vehicle: identification.{allowed}"]


def test_an_identification_of_unknown_parameters_is_refused() -> None:
    (message,) = refusal("vehicle", identification=identified(["gate.mass", "gate.masses", "motor.resistance"]))
    assert message.startswith("`vary` vehicle: identification.parameters: ")
    assert "gate.masses" in message
    assert "allowed: " in message
