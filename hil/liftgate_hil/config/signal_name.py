"""MESSAGE.SIGNAL: how files and programs name a signal of the rig's database."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from liftgate_hil.codec.messages import Messages
from liftgate_hil.config.toml import show
from liftgate_hil.errors import ConfigIssues

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can import Signal as DatabaseSignal

_MOST_NAMES = 20  # names that a message lists


def find_signal(
    issues: ConfigIssues,
    key: str,
    name: str,
    messages: Messages,
    offered: Collection[str] | None = None,
    left_out: Collection[str] = (),
) -> DatabaseSignal | None:
    """Return the signal of a name; None and an issue under `key` if there is none.

    The issue lists the messages that are `offered` (None: all), or the signals of the message without `left_out`.
    """
    message_name, _, signal_name = name.partition(".")
    message = messages.get(message_name)
    if why_not := messages.why_not(message_name):
        issues.add(key, f"{show(name)}: {why_not}")
        return None
    if message is None:
        names = listed(sorted(messages if offered is None else offered))
        issues.add(key, f"{show(name)}: no such message; allowed: MESSAGE.SIGNAL of {names}")
        return None
    for each in message.signals:
        if each.name == signal_name:
            return each
    issues.add(key, f"{show(name)}: no such signal; allowed: {listed_signals(message, left_out)}")
    return None


def listed_signals(message: Message, left_out: Collection[str] = ()) -> str:
    """Return the signals of a message without `left_out`, as a text."""
    names = [each.name for each in message.signals if each.name not in left_out]
    return f"{message.name}.{{{listed(names)}}}"


def listed(names: Sequence[str]) -> str:
    """Return names as a text; of many only the first ones."""
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return f"{', '.join(names[:_MOST_NAMES])}{more}" or "none"
