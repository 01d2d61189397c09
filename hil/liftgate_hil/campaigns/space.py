"""The space of a campaign: what is varied, in which values, from texts such as `rod=10000,20000`; its designs.

    rod=10000,20000,65000                  these values
    angle=10:70:13                         13 values from 10 to 70
    rod~loguniform(5e3,1e5)                a distribution
    vehicle                                draws from the covariance of the vehicle file's [identification]

What a name stands for: a parameter of the scenario, `seed`, `draw` (a car of the vehicle file's [spread]), or a
key of the vehicle file.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from liftgate_hil.campaigns.distributions import Distribution, Floats, distribution_of
from liftgate_hil.config.kinds import SEED
from liftgate_hil.config.parameters import find_parameter, value_of
from liftgate_hil.config.toml import Table
from liftgate_hil.config.variant import key_of
from liftgate_hil.errors import ConfigError
from liftgate_plant.quantity import Quantity
from liftgate_plant.vehicle import Vehicle

PARAMETER, KEY, SEED_OF_RUN, DRAW = "parameter", "key", "seed", "draw"  # what a name may stand for
COVARIANCE = "vehicle"  # as a name: all parameters of the vehicle file's [identification]
MOST_VALUES = 100_000  # of a grid's axis
_FORM = "NAME=VALUE,VALUE,…, NAME=FIRST:LAST:COUNT, NAME~DISTRIBUTION, or vehicle"
MOST_VARIANTS = 1_000_000_000  # numbers of variants beyond are mistakes
_SLOW = (KEY, SEED_OF_RUN, DRAW)  # what a precondition depends on


class VariedTarget(NamedTuple):
    """Target of a varied name: a parameter of the scenario, a key of the vehicle file, the seed or a draw."""

    name: str
    kind: str  # PARAMETER, KEY, SEED_OF_RUN or DRAW
    quantity: Quantity | None = None  # of KEY
    point: tuple[float, float] | None = None  # of a coordinate: both of the file's, in the file's unit
    parameter_unit: str = ""  # of PARAMETER; "": none, or it is not known

    @property
    def unit(self) -> str:
        """Unit of the varied values; "": none, or unknown."""
        if self.quantity is None:
            return self.parameter_unit
        return "" if self.quantity.unit == "1" else self.quantity.unit

    @property
    def key(self) -> str:
        """Key of the vehicle file; for a coordinate, the key of its point."""
        return self.name.partition("[")[0]

    def limited(self, values: Floats) -> Floats:
        """Return values (n,) clipped to the target's range, whole ones rounded down, as draws of [spread] are."""
        if self.quantity is None:
            return values
        quantity = self.quantity
        within = np.clip(np.floor(values) if quantity.is_whole else values, quantity.low, quantity.high)
        return np.where((within > 0.0) & (within < quantity.least), quantity.least, within)


class Axis(NamedTuple):
    """Varied name with its values: a grid, or a distribution."""

    target: VariedTarget
    grid: tuple[float, ...] = ()
    distribution: Distribution | None = None

    @property
    def targets(self) -> tuple[VariedTarget, ...]:
        """The axis's only target, as a tuple of one."""
        return (self.target,)

    @property
    def levels(self) -> tuple[int, ...]:
        """Number of equally probable values of the axis, as a tuple of one; 0: continuous."""
        return (len(self.grid) or (self.distribution.levels if self.distribution else 0),)

    def values(self, shares: Floats) -> Floats:
        """Return the values (n, 1) at shares (n, 1) from 0 to 1: quantiles, or values of the grid in its order."""
        if self.distribution is not None:
            return self.target.limited(self.distribution.quantiles(shares[:, 0]))[:, None]
        count = len(self.grid)
        places = np.minimum((shares[:, 0] * count).astype(np.int64), count - 1)
        return np.array(self.grid)[places][:, None]

    def __str__(self) -> str:
        if self.distribution is not None:
            return f"{self.target.name}~{self.distribution}"
        return f"{self.target.name}={','.join(f'{each:.12g}' for each in self.grid)}"


class Covariance(NamedTuple):
    """Varied parameters of a vehicle, with the estimates and the covariance of an identification."""

    targets: tuple[VariedTarget, ...]
    means: tuple[float, ...]
    root: tuple[tuple[float, ...], ...]  # L of the covariance L Lᵀ

    @property
    def levels(self) -> tuple[int, ...]:
        """Zero for each parameter, as all are continuous."""
        return (0,) * len(self.targets)

    def values(self, shares: Floats) -> Floats:
        """Return parameter values (n, k), correlated, at shares (n, k) from 0 to 1 of independent variables."""
        normal = Distribution("normal", (0.0, 1.0))
        independent = np.column_stack([normal.quantiles(shares[:, k]) for k in range(len(self.targets))])
        found = np.array(self.means) + independent @ np.array(self.root).T
        return np.column_stack([each.limited(found[:, k]) for k, each in enumerate(self.targets)])

    def __str__(self) -> str:
        return COVARIANCE


class Space(NamedTuple):
    """Space of a campaign: all varied names with their grids and distributions."""

    factors: tuple[Axis | Covariance, ...]

    @property
    def targets(self) -> tuple[VariedTarget, ...]:
        """Targets of the space, one for each column of values."""
        return tuple(target for each in self.factors for target in each.targets)

    @property
    def names(self) -> tuple[str, ...]:
        """Varied names, one for each column of values."""
        return tuple(each.name for each in self.targets)

    @property
    def levels(self) -> tuple[int, ...]:
        """Number of equally probable values of each column; 0: it is continuous."""
        return tuple(level for each in self.factors for level in each.levels)

    @property
    def grids(self) -> tuple[Axis, ...]:
        """Axes of the space that have a grid."""
        return tuple(each for each in self.factors if isinstance(each, Axis) and each.grid)

    def values(self, shares: Floats) -> Floats:
        """Return the varied values (n, d) at points (n, d) of the unit cube."""
        found, first = [], 0
        for each in self.factors:
            count = len(each.targets)
            found.append(each.values(shares[:, first : first + count]))
            first += count
        return np.hstack(found) if found else np.zeros((len(shares), 0))


def space_of(texts: Sequence[str], parameters: Mapping[str, str], vehicle: Vehicle, content: Table) -> Space:
    """Parse the space of a campaign from texts such as `rod=1,2`.

    `parameters` are those of the scenario, with their units ("": unknown), `content` is the vehicle file's. Raises
    ConfigError with all issues.
    """
    factors: list[Axis | Covariance] = []
    issues: list[str] = []
    names: list[str] = []
    for text in texts:
        try:
            made = _factor_of(text, parameters, vehicle, content)
        except ConfigError as error:
            issues += error.issues
            continue
        again = [each.name for each in made.targets if each.name in names]
        if again:
            issues.append(f"`vary` {text}: {', '.join(again)}: varied twice; allowed: each name once")
        names += [each.name for each in made.targets]
        factors.append(made)
    if issues:
        raise ConfigError(issues)
    return Space(tuple(factors))


def _factor_of(text: str, parameters: Mapping[str, str], vehicle: Vehicle, content: Table) -> Axis | Covariance:
    if text.strip() == COVARIANCE:
        return _covariance_of(vehicle, content)
    place = min((at for at in (text.find("="), text.find("~")) if at > 0), default=-1)
    if place < 0:
        raise ConfigError(f"`vary` {text}: allowed: {_FORM}")
    name, given = text[:place].strip(), text[place + 1 :]
    target = _target_of(name, parameters, vehicle)
    if text[place] == "~":
        made = Axis(target, distribution=distribution_of(given, f"`vary` {name}"))
        if target.kind in (SEED_OF_RUN, DRAW) and not made.levels[0]:
            raise ConfigError(f"`vary` {text}: allowed: integer(low, high), or a grid of whole numbers")
        _check(target, made.values(np.array([[0.0], [1.0]]))[:, 0], text)
        return made
    grid = _grid_of(given, text)
    _check(target, np.array(grid), text)
    return Axis(target, grid)


def _target_of(name: str, parameters: Mapping[str, str], vehicle: Vehicle) -> VariedTarget:
    if name in parameters:
        return VariedTarget(name, PARAMETER, parameter_unit=parameters[name])
    if name in (SEED_OF_RUN, DRAW):
        return VariedTarget(name, name)
    try:
        return _key_target(name, vehicle)
    except ValueError as error:
        own = ", ".join([*parameters, SEED_OF_RUN, DRAW])
        keys = str(error).partition("allowed: ")[2]
        raise ConfigError(f"`vary` {name}: allowed: {own}, or a key of the vehicle file such as {keys}") from None


def _key_target(name: str, vehicle: Vehicle) -> VariedTarget:
    """Return the target of a key of the vehicle file, or of a coordinate of a point. Raises ValueError."""
    key = key_of(tuple(name.split(".")))
    if key is not None:
        return VariedTarget(name, KEY, key.quantity)
    parameter = find_parameter(vehicle, name)
    if parameter.coordinate < 0:
        return VariedTarget(name, KEY, parameter.quantity)
    both = (value_of(vehicle, parameter._replace(coordinate=k)) for k in (0, 1))
    return VariedTarget(name, KEY, parameter.quantity, (next(both), next(both)))


def _grid_of(given: str, text: str) -> tuple[float, ...]:
    parts = given.split(":")
    try:
        if len(parts) == 3:
            first, last, count = float(parts[0]), float(parts[1]), int(parts[2])
            if 2 <= count <= MOST_VALUES and math.isfinite(first) and math.isfinite(last) and first != last:
                return tuple(np.linspace(first, last, count).tolist())
        elif len(parts) == 1:
            values = tuple(float(each.replace("_", "")) for each in given.split(","))
            if len(values) <= MOST_VALUES and all(map(math.isfinite, values)):
                if len(set(values)) < len(values):
                    raise ConfigError(f"`vary` {text}: a value twice; allowed: each once")
                return values
    except ValueError:
        pass
    raise ConfigError(
        f"`vary` {text}: allowed: numbers as VALUE,VALUE,… or FIRST:LAST:COUNT with 2 to {MOST_VALUES} values"
    )


def _check(target: VariedTarget, values: Floats, text: str) -> None:
    """Raise ConfigError where a varied target does not allow the values."""
    is_seed = target.kind in (SEED_OF_RUN, DRAW)
    if is_seed and not all(each % 1.0 == 0.0 and SEED.low <= each <= SEED.high for each in values.tolist()):
        raise ConfigError(f"`vary` {text}: allowed: whole numbers from {SEED.low} to {SEED.high}")
    if target.quantity is not None:
        wrong = [each for each in values.tolist() if not target.quantity.allows(each)]
        if wrong:
            raise ConfigError(
                f"`vary` {text}: {wrong[0]:g}: allowed: {target.quantity.range} {target.unit}".rstrip()
            )


def _covariance_of(vehicle: Vehicle, content: Table) -> Covariance:
    own = content.get("identification")
    try:
        names = [str(each) for each in own["parameters"]]  # type: ignore[index]
        means = [float(each) for each in own["values"]]  # type: ignore[index]
        matrix = np.array(own["covariance"], dtype=np.float64)  # type: ignore[index]
    except (TypeError, KeyError, ValueError):
        raise ConfigError(
            f"`vary` {COVARIANCE}: allowed: a vehicle file with [identification] parameters, values and "
            "covariance, as `identify --save-vehicle` writes it"
        ) from None
    count = len(names)
    is_square = matrix.shape == (count, count) and len(means) == count > 0
    if len(set(names)) < count or not all(map(math.isfinite, means)):
        raise ConfigError(
            f"`vary` {COVARIANCE}: identification.parameters, values: allowed: each name once, finite numbers"
        )
    if not is_square or not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T, rtol=1e-6, atol=0.0):
        raise ConfigError(
            f"`vary` {COVARIANCE}: identification.covariance: allowed: a symmetric {count} × {count} matrix"
        )
    scale = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    safe = np.where(scale > 0.0, scale, 1.0)
    # Of the correlation, whose eigenvalues rounding may make slightly negative.
    values, vectors = np.linalg.eigh(matrix / np.outer(safe, safe))
    if values.min() < -1e-6 * count:
        raise ConfigError(f"`vary` {COVARIANCE}: identification.covariance: allowed: no negative eigenvalue")
    root = safe[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    targets = []
    for each in names:
        try:
            targets.append(_key_target(each, vehicle))
        except ValueError as error:
            raise ConfigError(f"`vary` {COVARIANCE}: identification.parameters: {each}: {error}") from None
    return Covariance(tuple(targets), tuple(means), tuple(tuple(row) for row in root.tolist()))


class Design:
    """Design of a campaign whose points are known beforehand (grids, samples), in the order of their evaluation.

    All combinations of the grids, each with the same `samples` of the distributions, where there are any. What the
    scenario's precondition depends on changes slowest, so that neighbours share it.
    """

    def __init__(self, space: Space, samples: int, method: str, seed: int) -> None:
        sampled = [each for each in space.factors if not (isinstance(each, Axis) and each.grid)]
        grids = space.grids
        if sampled and not samples:
            raise ConfigError(f"`samples`: missing; allowed: a number, as {sampled[0]} is a distribution")
        if samples and not sampled:
            raise ConfigError(f"`samples` {samples}: allowed: with a distribution, or vehicle, in `vary`")
        self.count = math.prod(len(each.grid) for each in grids) * (samples or 1)
        if self.count > MOST_VARIANTS:
            raise ConfigError(f"`vary`: {self.count:.4g} variants; allowed: up to {MOST_VARIANTS:.0e}")
        self._space = space
        self._samples: dict[str, Floats] = {}
        if sampled:
            own = Space(tuple(sampled))
            values = own.values(shares_of(len(own.targets), samples, method, seed))
            self._samples = {name: values[:, k] for k, name in enumerate(own.names)}
        self._slow = [each for each in grids if each.target.kind in _SLOW]
        self._fast = [each for each in grids if each.target.kind not in _SLOW]

    @property
    def is_sampled(self) -> bool:
        """Whether the points are a random sample: of distributions, or of seeds and drawn cars alone."""
        grids = [*self._slow, *self._fast]
        is_random = bool(grids) and all(each.target.kind in (SEED_OF_RUN, DRAW) for each in grids)
        return bool(self._samples) or is_random

    def values(self, first: int, count: int) -> Floats:
        """Return values (n, d) of up to `count` points of the design from number `first`; fewer at its end."""
        place = np.arange(first, min(first + count, self.count))
        found: dict[str, Floats] = {}
        for axis in reversed(self._fast):
            place, at = np.divmod(place, len(axis.grid))
            found[axis.target.name] = np.array(axis.grid)[at]
        if self._samples:
            place, at = np.divmod(place, len(next(iter(self._samples.values()))))
            found |= {name: each[at] for name, each in self._samples.items()}
        for axis in reversed(self._slow):
            place, at = np.divmod(place, len(axis.grid))
            found[axis.target.name] = np.array(axis.grid)[at]
        rows = min(count, max(self.count - first, 0))
        return np.column_stack([found[name] for name in self._space.names]) if found else np.zeros((rows, 0))


def shares_of(dimensions: int, samples: int, method: str, seed: int) -> Floats:
    """Return sample points (n, d) in the unit cube: `random`, `lhs` (Latin hypercube) or `sobol` (scrambled)."""
    from scipy.stats import qmc

    generator = np.random.default_rng(seed)
    if method == "random":
        return generator.random((samples, dimensions))
    if method == "lhs":
        found: Floats = qmc.LatinHypercube(dimensions, seed=generator).random(samples)
        return found
    with warnings.catch_warnings():  # its balance properties are best for powers of two: a matter of the user
        warnings.simplefilter("ignore", UserWarning)
        points: Floats = qmc.Sobol(dimensions, seed=generator).random(samples)
    return points
