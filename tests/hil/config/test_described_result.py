"""A described result: exactly the fields marked as shown are in its JSON and in the reference."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.described_result import DescribedResult, Shown, json_of, keys_of


class Errors(NamedTuple):
    rms: Annotated[float, Shown("rms")]
    hidden: int = 0

    @property
    def is_small(self) -> Annotated[bool, Shown("small", key="small")]:
        return self.rms < 1.0


@dataclass(frozen=True)
class Part(DescribedResult):
    name: str
    size: Annotated[float, Shown("size [m]")]
    errors: Annotated[Mapping[str, Mapping[str, Errors]], Shown("errors", keys={"COLUMN": "of", "PHASE": "in"})]


@dataclass(frozen=True)
class Whole(DescribedResult):
    parts: Annotated[tuple[Part, ...], Shown("parts", by="name", keys={"NAME": "a part"})]
    listed: Annotated[tuple[Errors, ...], Shown("list")]
    matrix: Annotated[NDArray[np.float64], Shown("matrix")]
    last: Annotated[Errors | None, Shown("the last")] = None


WHOLE = Whole(
    (Part("a", math.inf, {"x": {"rest": Errors(0.5)}}), Part("b", 1.0, {})),
    (Errors(2.0),),
    np.array([[1.0, math.nan]]),
)


def test_exactly_the_shown_fields_are_in_the_json() -> None:
    assert WHOLE.to_dict() == {
        "parts": {
            "a": {"size": None, "errors": {"x": {"rest": {"rms": 0.5, "small": True}}}},
            "b": {"size": 1.0, "errors": {}},
        },
        "listed": [{"rms": 2.0, "small": False}],
        "matrix": [[1.0, None]],
        "last": None,
    }
    assert json.loads(WHOLE.to_json()) == WHOLE.to_dict()


def test_the_reference_describes_each_json_key() -> None:
    assert keys_of(Whole) == {
        "parts": "parts",
        "parts.NAME": "a part",
        "parts.NAME.size": "size [m]",
        "parts.NAME.errors": "errors",
        "parts.NAME.errors.COLUMN": "of",
        "parts.NAME.errors.COLUMN.PHASE": "in",
        "parts.NAME.errors.COLUMN.PHASE.rms": "rms",
        "parts.NAME.errors.COLUMN.PHASE.small": "small",
        "listed": "list",
        "listed[].rms": "rms",
        "listed[].small": "small",
        "matrix": "matrix",
        "last": "the last",
        "last.rms": "rms",
        "last.small": "small",
    }
    assert not [key for key in keys_of(Whole, [Part]) if key.startswith("parts.NAME.")]


def test_plain_values_are_converted_to_json_types() -> None:
    assert json_of({1: [Path("a"), np.float64(2.0), np.bool_(True), None, "x", -math.inf]}) == {
        "1": ["a", 2.0, True, None, "x", None]
    }
