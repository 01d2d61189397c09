"""Results to report on, made once."""

from dataclasses import replace

import pytest
import report_support

from liftgate_hil.identification.reporting.findings import with_warnings


@pytest.fixture(scope="session")
def found():
    return with_warnings(report_support.identification())


@pytest.fixture(scope="session")
def judged():
    return with_warnings(report_support.validation())


@pytest.fixture(scope="session")
def hostile():
    """A result in which every name from a file has characters that could harm a page or a terminal."""
    bad = report_support.HOSTILE
    found = report_support.identification(300, names=(bad, "b" * 400))
    first = found.experiments[0]
    renamed = replace(first, series=(replace(first.series[0], output=f"{bad}_a"), *first.series[1:]))
    whole = replace(
        found,
        vehicle=bad,
        model=bad,
        outputs=(f"{bad}_a", *found.outputs[1:]),
        parameters=tuple(
            replace(each, name=f"{bad}{i}", unit=bad, remark=bad) for i, each in enumerate(found.parameters)
        ),
        profiles=tuple(replace(each, name=bad) for each in found.profiles),
        inseparable=(bad,),
        stop_reason=bad,
        covariance_kind=bad,
        experiments=(renamed, *found.experiments[1:]),
        notes=(bad,),
    )
    return with_warnings(whole)
