"""Multiplexed messages: with which multiplexer values a signal is in the frame, and the pages of a message."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cantools.database.can import Message

MAX_PAGES = 62  # bits used of SIGNAL's `pages`


def multiplexer_values(message: Message, signal: str) -> list[dict[str, int]]:
    """Return the alternative sets of multiplexer values, by name, with which a signal is in the frame."""
    found = message.get_signal_by_name(signal)
    if found.multiplexer_signal is None or not found.multiplexer_ids:
        return [{}]
    return [
        {found.multiplexer_signal: int(value), **above}
        for value in found.multiplexer_ids
        for above in multiplexer_values(message, found.multiplexer_signal)
    ]


def pages_of(message: Message, mapped: Iterable[str]) -> list[dict[str, int]]:
    """Return the sets of multiplexer values with which a message is sent in turn, its pages.

    Each mapped signal is on at least one page.
    """
    pages: list[dict[str, int]] = []
    places = [multiplexer_values(message, signal) for signal in mapped]
    for chains in sorted(places, key=len):  # signals with the fewest alternatives come first
        if any(is_on(page, chains) for page in pages):
            continue
        free = [(page, chain) for chain in chains for page in pages if not _contradicts(page, chain)]
        if free:
            page, chain = free[0]
            page |= chain
        else:
            pages.append(dict(chains[0]))
    return sorted(pages, key=lambda page: sorted(page.items())) or [{}]


def is_on(page: Mapping[str, int], chains: Iterable[Mapping[str, int]]) -> bool:
    """Whether a signal that is in the frame with the multiplexer values `chains` is on a page."""
    return any(page.items() >= chain.items() for chain in chains)


def _contradicts(page: Mapping[str, int], chain: Mapping[str, int]) -> bool:
    return any(page.get(name, value) != value for name, value in chain.items())
