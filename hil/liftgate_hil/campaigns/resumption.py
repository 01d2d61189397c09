"""Resumption of a campaign: what was begun in a folder, and whether it is the same campaign."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from liftgate_hil.campaigns.folder import MANIFEST, Folder
from liftgate_hil.campaigns.prepared import Prepared
from liftgate_hil.errors import ConfigError


class Pace(NamedTuple):
    """Numbers from which the sizes of batches follow; a campaign that goes on has those that it began with."""

    seconds_each: float  # s that a variant takes
    workers: int


def pace_before(folder: Folder, found: Prepared, is_resumed: bool) -> Pace | None:
    """Return the pace of the campaign in a folder; None: there is none yet.

    Raises ConfigError where the folder has another campaign, or is not to be resumed.
    """
    if not folder.has_campaign:
        return None
    if not is_resumed:
        raise ConfigError(f"`output` {folder.path}: has a campaign; allowed: another folder, or `resume`")
    before = folder.manifest()
    wrong = differences(before, found)
    if wrong:
        raise ConfigError(
            f"`resume` {folder.path}: {', '.join(wrong)}: not as the campaign began; allowed: the same files, "
            "versions and arguments"
        )
    seconds, workers = before.get("seconds_each"), before.get("workers")
    is_pace = isinstance(seconds, float) and 0.0 < seconds < math.inf and type(workers) is int and workers > 0
    if not is_pace:
        raise ConfigError(
            f"{folder.path / MANIFEST}: seconds_each, workers: allowed: as the campaign has written them"
        )
    return Pace(before["seconds_each"], before["workers"])


def differences(before: dict[str, Any], found: Prepared) -> list[str]:
    """Return the files, packages and arguments that differ; empty: it is the same campaign."""
    files, known, theirs = (_table(before.get(name)) for name in ("files", "versions", "request"))
    sources = found.plan.sources
    wrong = [name for name, each in sources.items() if _table(files.get(name)).get("sha256") != each.sha256]
    wrong += [name for name, each in found.base.versions.items() if known.get(name) != each]
    own = found.request.kept()
    wrong += [name for name, each in own.items() if theirs.get(name) != each]
    if not wrong and before.get("identity") != found.base.identity:
        wrong.append("a file that the scenario names")
    return wrong


def _table(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
