"""The exit codes of verdicts; one of a stop is in `stopping`."""

from __future__ import annotations

from liftgate_hil.judging.verdict import ERROR, FAIL, INCONCLUSIVE, PASS, STOPPED

EXIT_CODES = {PASS: 0, FAIL: 1, ERROR: 2, INCONCLUSIVE: 3}
RUN_EXIT_CODES = {PASS: 0, FAIL: 0, ERROR: 1, INCONCLUSIVE: 3, STOPPED: 0}  # of a run, whose verdict is no result
DEMO_EXIT_CODES = {PASS: 0, FAIL: 1, ERROR: 1, INCONCLUSIVE: 3}
