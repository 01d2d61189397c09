"""UDS services (ISO 14229-1) as bytes: the tester's requests and their responses, by udsoncan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

MISSING = "need udsoncan; allowed after: pip install 'liftgate-hil[uds]'"

READ, CLEAR = 0x19, 0x14
RESETS = {"hardReset": 0x01, "keyOffOnReset": 0x02, "softReset": 0x03}  # ECUReset's sub-functions
_ALL = 0xFFFFFF  # group of all trouble codes


class DecodedResponse(NamedTuple):
    """A decoded response: the trouble codes with their status, or why the ECU refused a request."""

    codes: Mapping[int, int] | None  # status by number; None: no reading
    refused: str = ""  # which request and why; "": none was


def is_there() -> bool:
    """Whether the package udsoncan is installed."""
    try:
        import udsoncan  # noqa: F401
    except ImportError:
        return False
    return True


def read_request(status_mask: int) -> bytes:
    """Return the UDS request ReadDTCInformation (0x19), reportDTCByStatusMask."""
    from udsoncan.services.ReadDTCInformation import ReadDTCInformation

    kind = ReadDTCInformation.Subfunction.reportDTCByStatusMask
    return bytes(ReadDTCInformation.make_request(subfunction=kind, status_mask=status_mask).get_payload())


def clear_request() -> bytes:
    """Return the UDS request ClearDiagnosticInformation (0x14) for all groups of trouble codes."""
    from udsoncan.services.ClearDiagnosticInformation import ClearDiagnosticInformation

    return bytes(ClearDiagnosticInformation.make_request(_ALL).get_payload())


def reset_request(kind: str) -> bytes:
    """Return the UDS request ECUReset (0x11) of one of the types RESETS."""
    from udsoncan.services.ECUReset import ECUReset

    return bytes(ECUReset.make_request(reset_type=RESETS[kind]).get_payload())


def refusal_of(code: int) -> str:
    """Return a negative response code in words, such as ConditionsNotCorrect (0x22)."""
    from udsoncan.Response import Response

    return f"{Response.Code.get_name(code)} (0x{code:02X})"


def answer_of(message: bytes) -> DecodedResponse | None:
    """Return the decoded response about trouble codes in a message; None if it is no such response.

    Such messages are of another service, say that the response is pending, or are malformed.
    """
    from udsoncan.exceptions import InvalidResponseException
    from udsoncan.Response import Response
    from udsoncan.services.ReadDTCInformation import ReadDTCInformation

    try:
        response = Response.from_payload(message)
        service = response.service
        if not response.valid or service is None or service.request_id() not in (READ, CLEAR):
            return None
        if not response.positive:
            code = response.code
            if code in (None, Response.Code.RequestCorrectlyReceived_ResponsePending):
                return None
            return DecodedResponse(None, f"{service.get_name()}: {refusal_of(code)}")
        kind = ReadDTCInformation.Subfunction.reportDTCByStatusMask
        if service.request_id() != READ or not response.data or response.data[0] != kind:
            return None
        found = ReadDTCInformation.interpret_response(response, subfunction=kind).service_data
        return DecodedResponse({each.id: each.status.get_byte_as_int() for each in found.dtcs})
    except (InvalidResponseException, ValueError):  # an ECU may send anything
        return None
