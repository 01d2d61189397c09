"""Paths of the keys of JSON, as the manual's pages name them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping


def written(value: object, known: Collection[str], at: str = "") -> Iterator[str]:
    """Yield the paths of the keys of a JSON value.

    `known` are the documented paths: a name that varies becomes the part in capitals that stands for it there.
    """
    if isinstance(value, Mapping):
        inside = {path: path.rpartition(".") for path in known}
        varying = [path for path, (above, _, last) in inside.items() if above == at and last.isupper()]
        assert len(varying) <= 1
        for name, each in value.items():
            path = varying[0] if varying else f"{at}.{name}".lstrip(".")
            yield path
            yield from written(each, known, path)
    elif isinstance(value, list):
        for each in value:
            yield from written(each, known, f"{at}[]")
