"""Descent of cma from one point of the unit cube, asked and told batch by batch."""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from liftgate_hil.campaigns.distributions import Floats

# Chosen by measurement, as those of worst_search.py.
PATIENCE, DIP_PATIENCE = 10, 2  # generations without progress that end a descent; a false dip has to end soon
WANDER = 0.25  # distance at which a dip's descent is in a broader minimum; 0.15 equal


@contextlib.contextmanager
def _numpy_state(state: dict[str, Any]) -> Iterator[None]:
    """Lend numpy's global generator to cma, which draws from it, and give the caller's state back."""
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
    """A descent of cma from one point; discrete dimensions are integers in it, and snapped by the caller."""

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
        """Return the next generation, (n, d) in the unit cube."""
        with _numpy_state(self._state):
            self._raw = self._cma.ask()
        return ((np.array(self._raw) - self._low) / self._scale)[:, : len(self.place)]

    def tell(self, margins: Floats) -> None:
        """Take the finite margins of `asked`, NaN for no verdict."""
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
