"""Resumption of a campaign: what was begun in a folder, and whether it is the same campaign."""

from __future__ import annotations

from typing import Any, NamedTuple

from liftgate_hil.campaign.folder import MANIFEST, Folder
from liftgate_hil.campaign.request import Prepared, Request
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
    wrong = _differences(before, found)
    if wrong:
        raise ConfigError(
            f"`resume` {folder.path}: {', '.join(wrong)}: not as the campaign began; allowed: the same files, "
            "versions and arguments"
        )
    try:
        return Pace(float(before["seconds_each"]), int(before["workers"]))
    except (KeyError, TypeError, ValueError):
        raise ConfigError(f"{folder.path / MANIFEST}: seconds_each, workers: missing") from None


def _differences(before: dict[str, Any], found: Prepared) -> list[str]:
    """Return the files, packages and arguments that differ; empty: it is the same campaign."""
    files, known = before.get("files", {}), before.get("versions", {})
    wrong = [name for name, each in found.plan.sources.items() if files.get(name, {}).get("sha256") != each.sha256]
    wrong += [name for name, each in found.base.versions.items() if known.get(name) != each]
    theirs = before.get("request", {})
    own = as_json(found.request)
    wrong += [name for name, each in own.items() if theirs.get(name) != each]
    if not wrong and before.get("identity") != found.base.identity:
        wrong.append("an included file")
    return wrong


def as_json(request: Request) -> dict[str, Any]:
    """Return a request as JSON would give it back."""
    return {name: list(each) if isinstance(each, tuple) else each for name, each in request.as_dict().items()}
