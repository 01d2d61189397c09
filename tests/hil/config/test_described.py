"""Records of described fields: validation, equality, and the signatures of commands that take them."""

import inspect
from pathlib import Path
from typing import Annotated, Any

import pytest
from hil_support import issues_of

from liftgate_hil.config.described import Field, Record, command, fields_of
from liftgate_hil.config.kinds import File, Flag, Number, Text, Texts
from liftgate_hil.errors import ConfigError


class Request(Record, kw_only=False):
    """An example record: a request to draw a rod."""

    source: Annotated[str | Path, Field(File(), "a recording", metavar="FILE")]
    angle_deg: Annotated[float, Field(Number(0.0, 90.0, "deg"), "angle of the rod", metavar="DEG")] = 35.0
    names: Annotated[tuple[str, ...], Field(Texts("a list of names"), "columns")] = ()
    title: Annotated[str | None, Field(Text(), "title of the picture", "the file's name")] = None
    is_small: Annotated[bool, Field(Flag(), "a small picture", needs="title")] = False


@command(Request)
def draw(request: Request) -> str:
    """Return a request as text."""
    return f"{request.source} {request.angle_deg:g} {','.join(request.names)} {request.title}"


def test_arguments_are_converted_to_the_types_of_their_fields() -> None:
    found = Request.of("run.csv", angle_deg=10, names=["a", "b"])
    assert found.source == Path("run.csv")
    assert isinstance(found.angle_deg, float)
    assert found.names == ("a", "b")
    assert found.title is None
    assert Request.of("run.csv").angle_deg == 35.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"angle_deg": 91}, "`angle_deg` 91: allowed: 0 to 90 deg"),
        ({"angle_deg": None}, "`angle_deg` None: allowed: 0 to 90 deg"),
        ({"source": 3}, "`source` 3: allowed: a path"),
        ({"source": ""}, "`source` '': allowed: a path"),
        ({"names": 3}, "`names` 3: allowed: a list of names"),
        ({"is_small": True}, "`is_small`: allowed: together with `title`"),
    ],
)
def test_an_invalid_argument_is_refused_with_the_allowed_values(given: Any, message: str) -> None:
    assert issues_of(Request.of, **{"source": "run.csv", **given}) == [message]


def test_an_argument_may_be_given_together_with_the_one_that_it_requires() -> None:
    assert Request.of("run.csv", title="x", is_small=True).is_small


@pytest.mark.parametrize("given", [{}, {"source": "run.csv", "angel_deg": 3}])
def test_unknown_or_missing_arguments_raise_type_error(given: Any) -> None:
    with pytest.raises(TypeError):
        Request.of(**given)


def test_a_command_accepts_arguments_or_a_request_record() -> None:
    assert draw("run.csv", 10.0) == "run.csv 10  None"
    assert draw(source="run.csv", title="x") == "run.csv 35  x"
    assert draw(Request(source="run.csv", names=("a",))) == "run.csv 35 a None"
    with pytest.raises(ConfigError, match="0 to 90 deg"):
        draw(Request(source="run.csv", angle_deg=91.0))


def test_a_command_has_the_parameters_of_its_request_and_the_docstring_of_its_function() -> None:
    assert list(inspect.signature(draw).parameters) == ["source", "angle_deg", "names", "title", "is_small"]
    assert inspect.signature(draw).parameters["angle_deg"].default == 35.0
    text = inspect.getdoc(draw)
    assert text is not None
    assert text.startswith("Return a request as text.\n\n- `source`: a recording; allowed: a path\n")
    assert "- `angle_deg`: angle of the rod; allowed: 0 to 90 deg; default: 35\n" in text
    assert inspect.isfunction(draw)
    with pytest.raises(TypeError, match=r"^draw\(\) got an unexpected keyword argument 'angel_deg'"):
        draw("run.csv", angel_deg=3)  # type: ignore[call-overload]


def test_records_are_equal_by_value_and_their_repr_omits_defaults() -> None:
    one = Request(source=Path("a"), angle_deg=35.0)
    assert one == Request(source=Path("a"))
    assert one != one.replaced(angle_deg=36.0)
    assert one != 35.0
    assert repr(one.replaced(title="x")) == f"Request(source={Path('a')!r}, title='x')"


def test_defaults_are_described_as_text() -> None:
    assert {each.name: each.default_text for each in fields_of(Request)} == {
        "source": "required", "angle_deg": "35", "names": "", "title": "the file's name", "is_small": "false",
    }  # fmt: skip
