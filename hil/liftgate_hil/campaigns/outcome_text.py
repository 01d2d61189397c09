"""Text of a campaign: its state while it runs, and its outcome."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from liftgate_hil.campaigns.folder import AGAINST, DIFFERENCES, MANIFEST, REPORT, RESULTS, WORST_FILE, replay_line
from liftgate_hil.campaigns.prepared import units_of
from liftgate_hil.errors import number_of, printable, with_unit
from liftgate_hil.judging.verdict import ERROR

if TYPE_CHECKING:
    from liftgate_hil.campaigns.campaign import CampaignProgress
    from liftgate_hil.campaigns.run import CampaignOutcome


def progress_line(state: CampaignProgress) -> str:
    """Return the state of a campaign as one line of text."""
    parts = [f"{state.done}/{state.count or '?'} variants", f"{state.per_second:.1f} a second"]
    if state.retried:
        parts.append(f"{state.retried} tried again")
    return "  ".join(parts)


def _found(outcome: CampaignOutcome) -> Iterator[str]:
    """Yield the results of a comparison of ECUs, a worst-case search or a failure probability, as lines."""
    found = outcome.analysis.content
    if outcome.is_complete and "against" in found:
        both = found["against"]
        pairs = ", ".join(f"{number} {pair}" for pair, number in both["verdicts"].items())
        differ = f"{both['differing']} of {number_of(both['variants'], 'variant')} differ"
        yield f"{' / '.join(both['ecus'])}: {differ}; verdicts: {pairs}"
    if not outcome.is_complete or "expectation" not in found:
        return
    name = found["expectation"]
    if found.get("margin", found.get("probability")) is None:
        yield f"no variant has a margin of “{name}”: it is inconclusive in all of them"
    elif "margin" in found:
        units = units_of(outcome.prepared)
        values = ", ".join(
            f"{each} = {with_unit(f'{value:.6g}', units[each])}" for each, value in found["values"].items()
        )
        margin = with_unit(f"{found['margin']:.6g}", found["margin_unit"])
        yield f"smallest margin of “{name}”: {margin} with {values}"
        yield f"to run it again: {replay_line(outcome.folder.path, found['variant'])}"
        yield f"as a scenario for other ECUs: {outcome.folder.path / WORST_FILE}"
    else:
        chance, low, high = (found[each] for each in ("probability", "low", "high"))
        share = f"{chance:.3g} (95 %: {low:.3g} to {high:.3g})"
        yield f"probability that “{name}” fails: {share}; the variants above were chosen near failures"


def outcome_lines(outcome: CampaignOutcome) -> Iterator[str]:
    """Yield, as lines, how many variants have which verdict, what was found, and where the results are."""
    progress, known = outcome.progress, dict(outcome.counts)
    number = number_of(sum(known.values()), "variant")
    if not outcome.is_complete and outcome.prepared.against is None:  # what was not evaluated is an error there
        known[ERROR] = max(0, known.get(ERROR, 0) - (progress.count - progress.done))
        number = f"{progress.done} of {number_of(progress.count, 'variant')}"
    counts = ", ".join(f"{count} {name}" for name, count in sorted(known.items()) if count)
    yield f"{number}: {counts or 'none'}; {outcome.seconds:.1f} s"
    yield from map(printable, _found(outcome))
    state = "" if outcome.is_complete else "; incomplete: go on with --resume"
    files = [REPORT, f"{RESULTS} with DATA.md", MANIFEST]
    if outcome.is_complete and outcome.prepared.against is not None:
        files += [AGAINST, DIFFERENCES]
    yield f"{printable(str(outcome.folder.path))}: {', '.join(files)}{state}"
