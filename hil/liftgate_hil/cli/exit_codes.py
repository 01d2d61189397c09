"""The exit codes of verdicts; one of a stop is in `stopping`."""

from __future__ import annotations

from liftgate_hil.judging.verdict import ERROR, FAIL, INCONCLUSIVE, PASS

EXIT_CODES = {PASS: 0, FAIL: 1, ERROR: 2, INCONCLUSIVE: 3}
