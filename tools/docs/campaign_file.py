"""Page docs/campaign-file.md: all keys of a campaign file, from the schema by which such files are read."""

from __future__ import annotations

from liftgate_hil.campaigns.file import CampaignTable, PartTable
from tools.docs.markdown import page
from tools.docs.schema import key_table

_INTRO = """\
A campaign file is written in TOML. It holds several [campaigns](campaigns.md) that share one report, and is given
to `liftgate-hil campaign` in place of a scenario. The shipped one, `pack:trap-matrix`, is
[`trap-matrix.toml`](../configs/campaigns/trap-matrix.toml).

Flags of the command apply to all parts: `--vary` replaces what a part varies under the same name, `--samples` the
number of samples of the parts that have a distribution, `--method` the method of all."""


def campaign_file_page() -> str:
    """Return the text of the page."""
    return page(
        "Campaign files", _INTRO, "## The file", key_table(CampaignTable), "## `[[part]]`", key_table(PartTable)
    )
