"""Single requests to the ECU under test and their responses, while a caller's own loop steps gate and ECU."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from liftgate_hil.diagnostics import services
from liftgate_hil.diagnostics.tester import (
    NO_FAILURE,
    NO_RESPONSE,
    Diagnostics,
    Tester,
    answer_in,
    asking_once,
    failure_of,
    is_asking_once,
    no_tester,
)
from liftgate_hil.diagnostics.trouble_code import text_of
from liftgate_hil.errors import ConfigError, DiagnosticsError

_READ, _CLEAR = "ReadDTCInformation", "ClearDiagnosticInformation"
_LONGEST = 60.0  # s, even if the ECU keeps responding "response pending"


class CallerLoop(NamedTuple):
    """A caller's loop and the gate in it."""

    put: Callable[[Tester], None]  # puts a tester on the gate's bus, in place of the one before
    cycle: Callable[[], object]  # runs the loop once
    now: Callable[[], float]  # the gate's model time [s]


def read_codes(diagnostics: Diagnostics, bench: CallerLoop) -> dict[str, int]:
    """Return the status bytes of trouble codes by their texts. Raises like `response_to`."""
    request = services.read_request(diagnostics.status_mask)
    response = response_to(_READ, asking_once(diagnostics, request), bench)
    answer = services.answer_of(response)
    if answer is None or answer.codes is None:
        raise DiagnosticsError(f"{_READ}: malformed response: {response.hex(' ') or 'nothing'}")
    return {text_of(code): status for code, status in answer.codes.items() if status & diagnostics.status_mask}


def clear_codes(diagnostics: Diagnostics, bench: CallerLoop) -> None:
    """Clear all trouble codes. Raises like `response_to`."""
    response_to(_CLEAR, asking_once(diagnostics, services.clear_request()), bench)


def response_to(service: str, tester: Tester, bench: CallerLoop) -> bytes:
    """Return the positive response to the single request of a tester for a service.

    Raises DiagnosticsError if there is none, ConfigError if a cycle takes no time, and what a cycle raises.
    """
    began = bench.now()
    bench.put(tester)
    try:
        while is_asking_once(tester):
            before = bench.now()
            if before - began > _LONGEST:
                raise DiagnosticsError(
                    f"{service}: no response within {_LONGEST:g} s but pending (0x78) or busy (0x21)"
                )
            bench.cycle()
            if bench.now() <= before:
                raise ConfigError(
                    "`cycle`: the gate's time stood still; allowed: a function that calls its `step`"
                )
    finally:
        bench.put(no_tester())
    failure = failure_of(tester)
    if failure == NO_RESPONSE:
        raise DiagnosticsError(f"{service}: no response within {bench.now() - began:.3g} s")
    if failure != NO_FAILURE:
        raise DiagnosticsError(f"{service} refused: {services.refusal_of(failure)}", failure)
    return answer_in(tester)
