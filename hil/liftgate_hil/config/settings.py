"""KEY=VALUE put over a vehicle file's content, by `set` or a scenario's [set]; faults name who said it."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from liftgate_hil.config.arguments import texts_of
from liftgate_hil.config.toml import Table, shortened
from liftgate_hil.errors import ConfigError

_DEEPEST = 3  # left.motor.resistance


class Setting(NamedTuple):
    """One value."""

    names: tuple[str, ...]
    value: Any
    source: str  # what stands before the key in messages

    @property
    def key(self) -> str:
        """Dotted."""
        return ".".join(self.names)


def settings_of(texts: object) -> list[Setting]:
    """The settings of KEY=VALUE texts; the values are TOML, as in the file. Raises ConfigError with all faults."""
    result, issues = [], []
    for text in texts_of("settings", texts):
        try:
            result.append(_setting_of(text))
        except ConfigError as error:
            issues += error.issues
    if issues:
        raise ConfigError(issues)
    return result


def _setting_of(text: str) -> Setting:
    key, equals, value = text.partition("=")
    try:
        content = tomllib.loads(f"value = {value}")
    except (ValueError, RecursionError):  # TOMLDecodeError is one
        content = {"value": _plain_number(value)}
    names = tuple(key.strip().split("."))
    if not equals or not all(names) or len(content) > 1:
        raise ConfigError(
            f"`set` {shortened(text)}: allowed: KEY=VALUE, e.g. environment.road_slope_deg=8"
        )
    if len(names) > _DEEPEST:
        raise ConfigError(
            f"`set` {shortened(key)}: {len(names)} parts; allowed: TABLE.KEY, or left.TABLE.KEY"
        )
    return Setting(names, content["value"], "`set` ")


def _plain_number(text: str) -> float | str:
    """`.5` and `5.` are no TOML, but mean what they say."""
    return float(text) if re.fullmatch(r"\s*[+-]?(\d+\.|\.\d+)([eE][+-]?\d+)?\s*", text) else text


def settings_in(table: Table, source: str) -> Iterator[Setting]:
    """The settings of a table of a file; dotted keys, quoted or not, and tables in it mean the same."""
    for key, value in table.items():
        if isinstance(value, dict) and value:
            for inner in settings_in(value, source):
                yield inner._replace(names=(*key.split("."), *inner.names))
        else:
            yield Setting(tuple(key.split(".")), value, source)


def applied(raw: Table, settings: Sequence[Setting]) -> dict[str, str]:
    """Put settings into a file's content; what is in it by them: dotted keys, and what messages call each. Raises
    ConfigError.
    """
    origins: dict[str, str] = {}
    for setting in settings:
        made = apply_setting(raw, setting)
        origins[made] = setting.source + made
    return origins


def apply_setting(raw: Table, setting: Setting) -> str:
    """Put one into a file's content; the dotted key of what is in it by that. Raises ConfigError."""
    place = raw
    made = ""
    for depth, name in enumerate(setting.names[:-1], start=1):
        if name not in place:
            made = made or ".".join(setting.names[:depth])
        inner = place.setdefault(name, {})
        if not isinstance(inner, dict):
            raise ConfigError(
                f"{setting.source}{setting.key}: {name} is not a table; allowed: a key of one"
            )
        place = inner
    place[setting.names[-1]] = setting.value
    return made or setting.key
