"""The exit codes of verdicts; one of a stop is in `stopping`."""

from __future__ import annotations

from liftgate_hil.judging.verdict import ERROR, FAIL, GIVEN_UP, INCONCLUSIVE, PASS, STOPPED

EXIT_CODES = {PASS: 0, FAIL: 1, ERROR: 2, INCONCLUSIVE: 3}
# Of a run, which reports on the bench, not on the ECU.
RUN_EXIT_CODES = {PASS: 0, FAIL: 0, ERROR: 1, INCONCLUSIVE: 0, GIVEN_UP: 3, STOPPED: 0}
DEMO_EXIT_CODES = {PASS: 0, FAIL: 1, ERROR: 1, INCONCLUSIVE: 3, GIVEN_UP: 3}
