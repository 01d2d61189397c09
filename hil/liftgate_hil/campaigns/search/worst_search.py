"""Search for the smallest margin of an expensive simulation, with a budget of some hundred evaluations."""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import qmc

from liftgate_hil.campaigns.distributions import Floats
from liftgate_hil.campaigns.search.surrogate import Surrogate
from liftgate_hil.errors import number_of

# Constants without another source were chosen by measurement: 16 to 40 seeds on pocket functions of 3 to 6
# dimensions (needles, slopes, shoulders, pockets beside a harmless minimum) and on analytic ones, 500 evaluations.
# START, MODEL_SLOTS, POOL and APART are first guesses that were kept.
START = 16  # first points: a slope is felt with so few, and sloped pockets are found after 30 to 60 evaluations
BATCH = 8  # points of a batch without a descent, the population of cma in 4 to 6 dimensions
MODEL_SLOTS = 5  # of a batch at most for the surrogate; it leaves those free that promise nothing
EXPLORE_MIN = 2  # well-spread points in every batch, also beside a descent
GAIN = 0.03  # of the spread of the margins: the improvement asked of the surrogate; at 0.05 it gave some slopes up
LATE_GAIN = 1e-3  # the same at the end, when the best margin is made exact
LATE = 0.75  # of the budget: from here the worst point is made exact; 0.65 lost needles, 0.85 Ackley's minimum
SIGMA, DIP_SIGMA, LATE_SIGMA = 0.12, 0.1, 0.05  # first steps: of 0.1 to 0.3, of 0.03 to 0.1, of 0.05 and 0.1
APART = 0.25  # largest coordinate difference below which two starts count as the same place
DIP_APART = 0.08  # the same for dips, about half the side of a pocket of 0.4 % in three dimensions
SKILLED = 0.5  # share of the variance predicted, from which the surrogate replaces most descents; 0.8 was slower
CHECKS = 24  # points that the surrogate has predicted, from which its skill is theirs, not a cross-validation's
EVERY, EVERY_SKILLED = 2, 16  # batches from one generation of a descent to the next; 8 needed more beside needles
SHARE, SHARE_FREE = 0.1, 60  # descents before `LATE`: a share and a sum; a share of 0.25 lost needles
DIP_SCORE, DIP_FLOOR = 6.0, 0.4  # a dip: so many robust deviations and so many spreads below the prediction
PATIENCE, DIP_PATIENCE = 10, 2  # generations without progress that end a descent; a false dip has to end soon
WANDER = 0.25  # distance at which a dip's descent is in a broader minimum; 0.15 equal
POOL = 256  # candidates over the whole space and again around the worst points


@contextlib.contextmanager
def _numpy_state(state: dict[str, Any]) -> Iterator[None]:
    """Context with cma's global numpy random state, without cma's warnings; the caller's state is restored."""
    callers = np.random.get_state()
    np.random.set_state(state["numpy"])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # cma warns of flat and of one-sided populations, which are usual here
            yield
    finally:
        state["numpy"] = np.random.get_state()
        np.random.set_state(callers)


class CmaDescent:
    """Descent by CMA-ES (package cma) from one point; discrete dimensions are integers, snapped by the caller."""

    def __init__(
        self, start: Floats, levels: Floats, sigma: float, seed: list[int], known: float = math.inf
    ) -> None:
        import cma

        self.dip = known < math.inf
        self.urgent = False
        self.best, self.place, self._start = known, start, start
        self.stale, self.over = 0, False
        self.asked: Floats = np.empty((0, len(start)))
        # cma refuses one dimension: an idle second one
        k = np.append(levels, [0.0] * (len(levels) == 1))
        self._scale = np.where(k > 0, k, 1.0)
        self._low = np.where(k > 0, -0.5, 0.0)
        centre = np.append(start, [0.5] * (len(k) - len(start))) * self._scale + self._low
        self._state = {"numpy": np.random.RandomState(np.random.MT19937(np.random.SeedSequence(seed))).get_state()}
        options = {
            "bounds": [list(self._low), list(self._low + self._scale)],
            "CMA_stds": list(self._scale),
            "integer_variables": [int(i) for i in np.flatnonzero(k > 0)],
            "seed": math.nan,  # nan: cma leaves the generator's state as it is
            "verbose": -9,
            "verb_log": 0,
        }
        with _numpy_state(self._state):
            self._cma = cma.CMAEvolutionStrategy(list(centre), sigma, options)

    def ask(self) -> Floats:
        """Return the next generation of points, (n, d) in the unit cube."""
        with _numpy_state(self._state):
            self._raw = self._cma.ask()
        return ((np.array(self._raw) - self._low) / self._scale)[:, : len(self.place)]

    def tell(self, margins: Floats) -> None:
        """Pass margins of the points `asked` to CMA-ES (NaN: as their median), and update `best` and `over`."""
        judged = ~np.isnan(margins)
        if not judged.any():
            self.over = True
            return
        # The median ranks a point without a verdict as neither good nor bad.
        filled = np.where(judged, margins, np.median(margins[judged]))
        with _numpy_state(self._state):
            self._cma.tell(self._raw, list(filled))
            self.over = bool(self._cma.stop())
        i = int(np.argmin(np.where(judged, margins, math.inf)))
        progress = margins[i] < self.best - 1e-3 * (abs(self.best) if self.best < math.inf else 0.0)
        self.stale = 0 if progress else self.stale + 1
        if margins[i] < self.best:
            self.best, self.place = float(margins[i]), self.asked[i]
        # A dip's descent that wanders off has left the dip for a broader minimum, which others see to.
        wandered = self.dip and bool(np.abs(self.place - self._start).max() > WANDER)
        self.over |= wandered or self.stale > (DIP_PATIENCE if self.dip else PATIENCE)


@dataclass(frozen=True)
class SearchEnd:
    """Outcome of a search: why it stopped and the evidence; `worst_margin` is NaN when no point had a verdict."""

    evaluations: int
    reason: str
    restarts: int
    worst_point: tuple[float, ...] | None
    worst_margin: float
    no_verdict: int
    evidence: str


def worst_search(levels: Sequence[int], budget: int, seed: int) -> Generator[Floats, Floats, SearchEnd]:
    """Generator that searches the unit cube for the smallest margin.

    Yields points (n, d) and is sent their margins (n,); NaN is no verdict, infinities are allowed. `levels` holds
    0 for a continuous dimension, k for one of k equally probable values. No point is evaluated twice.

    Raises ValueError for no dimension, a negative level, a negative budget or margins of another shape.
    """
    if not len(levels) or min(levels) < 0 or budget < 0:
        raise ValueError("the search needs at least one dimension, levels >= 0 and a budget >= 0")
    size = math.prod(map(int, levels))  # 0 with a continuous dimension
    search = _Search(levels, min(budget, size) if size else budget, seed)
    while len(search.margins) < search.budget:
        points = search.propose()
        margins = np.asarray((yield points.copy()), dtype=np.float64)
        if margins.shape != (len(points),):
            raise ValueError(f"{len(points)} points need as many margins, not an array of shape {margins.shape}")
        search.receive(points, margins)
    return search.end("all points of the discrete space evaluated" if 0 < size <= budget else "budget used")


class _Search:
    """State of a search: the points so far, the source of exploring points, the surrogate and the descent."""

    def __init__(self, levels: Sequence[int], budget: int, seed: int) -> None:
        self.budget = budget
        self.points: list[Floats] = []
        self.margins: list[float] = []
        self._seed = seed
        self._levels = np.array(levels, dtype=np.float64)
        self._rng = np.random.default_rng([seed, 1])
        # Keys are the snapped points; a point proposed and not yet judged has NaN.
        self._known: dict[bytes, float] = {}
        sobol_seed = int(np.random.default_rng([seed, 0]).integers(2**31))
        self._sobol = qmc.Sobol(len(levels), seed=sobol_seed)
        self._spare: list[Floats] = []
        self._surrogate = Surrogate(len(levels), np.random.default_rng([seed, 2]))
        self._predicted: dict[bytes, float] = {}
        self._checks: list[tuple[float, float, Floats]] = []  # predicted and warped margin of an exploring point
        self._descent: CmaDescent | None = None
        self._origins: list[Floats] = []
        self._ends: list[Floats] = []
        self._turn = self._restarts = self._descended = self._modelled = 0
        self._polished = self._is_late = self._is_skilled = False

    def propose(self) -> Floats:
        """Return the next batch of points (n, d) to evaluate, at most what is left of the budget."""
        room = self.budget - len(self.margins)
        self._turn += 1
        batch: list[Floats] = []
        margins = np.array(self.margins)
        judged = ~np.isnan(margins)
        x, f = np.array(self.points).reshape(-1, len(self._levels))[judged], self._finite(margins[judged])
        if len(f) and np.ptp(f) > 0:  # equal margins give neither a slope nor a spread
            if len(f) >= BATCH:
                self._surrogate.fit(x, f)
            self._is_skilled = self._skill() > SKILLED
            self._is_late = len(self.margins) > LATE * self.budget
            batch = [p for p in self._generation(x, f) if self._reserve(p)][:room]
            self._descended += len(batch)
            extra = [
                p for p in self._modelled_points(x, f, min(MODEL_SLOTS, room - len(batch))) if self._reserve(p)
            ]
            self._modelled += len(extra)
            batch += extra
        n = START if self._turn == 1 else max(BATCH - len(batch), EXPLORE_MIN)
        spread = [self._spread() for _ in range(min(n, room - len(batch)))]
        if spread and self._surrogate.fitted:
            means = self._surrogate.mean(np.array(spread))
            self._predicted = {p.tobytes(): float(m) for p, m in zip(spread, means, strict=True)}
        return np.array(batch + spread)

    def receive(self, points: Floats, margins: Floats) -> None:
        """Record the margins (n,) of a proposed batch (n, d), and pass the descent those of its generation."""
        for p, margin in zip(points, margins.tolist(), strict=True):
            key = p.tobytes()
            self._known[key] = margin
            self.points.append(p)
            self.margins.append(margin)
            predicted = self._predicted.pop(key, math.nan)
            if math.isfinite(predicted) and math.isfinite(margin):
                self._checks.append((predicted, float(self._surrogate.warp(margin)), p))
        if self._descent is not None and len(self._descent.asked):
            asked = self._descent.asked
            self._descent.tell(self._finite(np.array([self._known.get(p.tobytes(), math.nan) for p in asked])))
            self._descent.asked = asked[:0]

    def end(self, reason: str) -> SearchEnd:
        """Return the search's outcome, with the evidence in plain words."""
        f = np.array(self.margins)
        lost = int(np.isnan(f).sum())
        i = int(np.nanargmin(f)) if lost < len(f) else None
        ends = self._ends + ([] if self._descent is None else [self._descent.place])
        same = 0
        if i is not None:
            same = sum(bool(np.abs(p - self.points[i]).max() < APART) for p in ends)
        explored = len(f) - self._descended - self._modelled
        evidence = (
            f"{explored} evaluations explored, {self._modelled} were proposed by the surrogate, {self._descended} "
            f"belong to {number_of(self._restarts, 'descent')}; {same} ended near the worst point"
        )
        point = None if i is None else tuple(self.points[i].tolist())
        worst = math.nan if i is None else self.margins[i]
        return SearchEnd(len(f), reason, self._restarts, point, worst, lost, evidence)

    def _snap(self, u: Floats) -> Floats:
        k = np.where(self._levels > 0, self._levels, 1.0)
        cells = (np.minimum(np.floor(np.clip(u, 0.0, 1.0) * k), k - 1.0) + 0.5) / k
        return np.where(self._levels > 0, cells, np.clip(u, 0.0, 1.0))

    def _reserve(self, p: Floats) -> bool:
        """Record a point as proposed; return False if it was proposed before."""
        if p.tobytes() in self._known:
            return False
        self._known[p.tobytes()] = math.nan
        return True

    def _spread(self) -> Floats:
        """Return the next new point of the scrambled Sobol sequence, whose projections are well spread too."""
        while True:
            if not self._spare:
                self._spare = list(self._snap(self._sobol.random(64)))[::-1]
            p = self._spare.pop()
            if self._reserve(p):
                return p

    def _finite(self, margins: Floats) -> Floats:
        """Return margins with infinities replaced by values beyond the finite ones so far; NaN is kept."""
        f = np.array(self.margins)
        f = np.clip(f[np.isfinite(f)], -1e100, 1e100)  # their squares stay finite
        low, high = (float(f.min()), float(f.max())) if len(f) else (0.0, 0.0)
        beyond = (high - low) or 1.0
        return np.clip(margins, low - beyond, high + beyond)

    def _skill(self) -> float:
        """Return the share of recent exploring points' variance that was predicted; if few, `Surrogate.skill`."""
        recent = np.array([c[:2] for c in self._checks[-40:]])  # 40: follows the growth of the model
        if len(recent) < CHECKS:
            return self._surrogate.skill() if self._surrogate.fitted else 0.0
        if recent[:, 1].var() == 0.0:
            return 0.0
        return float(1.0 - ((recent[:, 0] - recent[:, 1]) ** 2).mean() / recent[:, 1].var())

    def _dip(self) -> Floats | None:
        """Return the exploring point farthest below its prediction, away from descents; None: none is far."""
        if len(self._checks) < 16:  # too few for a robust deviation
            return None
        errors = np.array([c[1] - c[0] for c in self._checks])
        deviation = 1.4826 * float(np.median(np.abs(errors - np.median(errors))))
        for i in np.argsort(errors, kind="stable"):
            if errors[i] > -max(DIP_SCORE * deviation, DIP_FLOOR):
                return None
            p: Floats = self._checks[i][2]
            if all(np.abs(p - o).max() >= DIP_APART for o in self._origins):
                return p
        return None

    def _generation(self, x: Floats, f: Floats) -> list[Floats]:
        """Return the next generation of a descent, which is begun or continued, if it is due; else []."""
        best, dip = float(f.min()), self._dip()
        d = self._descent
        if d is not None:
            polish = self._is_late and not self._polished and d.best > best
            if d.over or polish or (dip is not None and not d.dip):
                self._origins.append(d.place)
                self._ends.append(d.place)
                d = self._descent = None
        every = EVERY_SKILLED if self._is_skilled else EVERY
        # Once the worst point is exact, more descents would only end there again.
        polishing = self._is_late and (not self._polished or (d is not None and d.urgent and not d.dip))
        if dip is not None or (d is not None and d.dip) or polishing:
            every = 1
        spent = self._descended >= SHARE * len(f) + SHARE_FREE and best >= 0.0 and not polishing
        if self._turn % every or spent:
            return []
        if d is None:
            d = self._descent = self._start(x, f, dip)
        if d is None:
            return []
        d.asked = self._snap(d.ask())
        return list(d.asked)

    def _start(self, x: Floats, f: Floats, dip: Floats | None) -> CmaDescent | None:
        """Begin a descent in a dip, late at the worst point, else at a low one far from others; None: nowhere."""
        known, sigma, start = math.inf, SIGMA, None
        order = np.argsort(f, kind="stable")
        if dip is not None:
            known, sigma, start = self._known[dip.tobytes()], DIP_SIGMA, dip
        elif self._is_late and not self._polished:
            self._polished, sigma, start = True, LATE_SIGMA, x[order[0]]
        else:
            for i in order[: max(1, len(f) // 4)]:  # a start among the better three quarters is no start
                if f[i] < np.median(f) and all(np.abs(x[i] - o).max() > APART for o in self._origins):
                    start = x[i]
                    break
        if start is None:
            return None
        self._restarts += 1
        self._origins.append(start)
        descent = CmaDescent(start, self._levels, sigma, [self._seed, 3, self._restarts], known)
        descent.urgent = sigma != SIGMA
        return descent

    def _modelled_points(self, x: Floats, f: Floats, n: int) -> list[Floats]:
        """Return at most n points that the surrogate predicts to fail, or to be below the worst point."""
        if not self._surrogate.fitted:
            return []
        pool = self._pool(x[np.argsort(f, kind="stable")[:6]])
        if not len(pool):
            return []
        best = float(self._surrogate.warp(f.min()))
        below = best * (1.0 + (LATE_GAIN if self._is_late else GAIN))  # the warped median is 0, so best < 0
        zero = float(self._surrogate.warp(0.0)) if f.min() > 0.0 else below
        return self._surrogate.choose(pool, [(below, zero)[j % 2] for j in range(n)])

    def _pool(self, worst: Floats) -> Floats:
        """Return candidate points (n, d) not proposed yet: uniform ones, and steps of four sizes from `worst`."""
        d = len(self._levels)
        parts = [self._rng.random((POOL, d))]
        for size in (0.2, 0.07, 0.02, 0.005):
            centres = worst if size > 0.1 else worst[:2]
            start = centres[self._rng.integers(len(centres), size=POOL // 4)]
            # Steps in some dimensions only: in many, nearly every step in all of them is uphill.
            moved = self._rng.random(start.shape) < max(0.5, 1.5 / d)
            moved[np.arange(len(start)), self._rng.integers(d, size=len(start))] = True
            steps = start + moved * self._rng.normal(size=start.shape) * size
            jumps = (self._levels > 0) & (self._rng.random(start.shape) < 0.2)
            parts.append(np.where(jumps, self._rng.random(start.shape), steps))
        pool = self._snap(np.vstack(parts))
        return pool[[p.tobytes() not in self._known for p in pool]]
