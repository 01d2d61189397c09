"""Settings KEY=VALUE that override values of a vehicle file: from the argument `settings`, or [set]."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from liftgate_hil.config.described import value_of
from liftgate_hil.config.kinds import Texts
from liftgate_hil.config.toml import Table, shortened
from liftgate_hil.errors import ConfigError

_DEEPEST = 3  # parts of a key, e.g. left.motor.resistance


class Setting(NamedTuple):
    """A value that overrides a key of a vehicle file."""

    names: tuple[str, ...]
    value: Any
    source: str  # prefix of the key in messages

    @property
    def key(self) -> str:
        """The dotted key that the setting overrides."""
        return ".".join(self.names)


def settings_of(texts: object) -> list[Setting]:
    """Return the settings of KEY=VALUE texts; the values are TOML. Raises ConfigError with all issues."""
    result, issues = [], []
    for text in value_of("settings", texts, Texts("a list of KEY=VALUE")):
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
    except (ValueError, RecursionError):  # TOMLDecodeError is a ValueError
        content = {"value": _plain_number(value)}
    names = tuple(key.strip().split("."))
    if not equals or not all(names) or len(content) > 1:
        raise ConfigError(f"`settings` {shortened(text)}: allowed: KEY=VALUE, e.g. environment.road_slope_deg=8")
    if len(names) > _DEEPEST:
        raise ConfigError(
            f"`settings` {shortened(key)}: {len(names)} parts; allowed: TABLE.KEY, or left.TABLE.KEY"
        )
    return Setting(names, content["value"], "`settings` ")


def _plain_number(text: str) -> float | str:
    """Return the float of a text such as `.5` or `5.`, which TOML does not allow; any other text as it is."""
    return float(text) if re.fullmatch(r"\s*[+-]?(\d+\.|\.\d+)([eE][+-]?\d+)?\s*", text) else text


def settings_in(table: Table, source: str) -> Iterator[Setting]:
    """Yield the settings in a table; dotted keys, quoted or not, and nested tables mean the same."""
    for key, value in table.items():
        if isinstance(value, dict) and value:
            for inner in settings_in(value, source):
                yield inner._replace(names=(*key.split("."), *inner.names))
        else:
            yield Setting(tuple(key.split(".")), value, source)


def applied(raw: Table, settings: Sequence[Setting]) -> dict[str, str]:
    """Apply settings to a file's content in place; return for each dotted key that was set its name in messages.

    Raises ConfigError.
    """
    origins: dict[str, str] = {}
    for setting in settings:
        made = apply_setting(raw, setting)
        origins[made] = setting.source + made
    return origins


def apply_setting(raw: Table, setting: Setting) -> str:
    """Apply a setting to a file's content in place; return the dotted key set. Raises ConfigError.

    If tables had to be created for it, the key of the outermost of them is returned.
    """
    place = raw
    made = ""
    for depth, name in enumerate(setting.names[:-1], start=1):
        if name not in place:
            made = made or ".".join(setting.names[:depth])
        inner = place.setdefault(name, {})
        if not isinstance(inner, dict):
            raise ConfigError(f"{setting.source}{setting.key}: {name} is not a table; allowed: a key of one")
        place = inner
    place[setting.names[-1]] = setting.value
    return made or setting.key
